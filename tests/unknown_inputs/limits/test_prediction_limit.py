"""Where prediction-error estimates go and how they vary: closed forms and identities."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.signal
from numpy.typing import NDArray

from casid.errors import IdentifiabilityError, ModelError
from casid.estimation.prediction_error.polynomial.orders import Orders
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.prediction_criterion import step_down, step_up
from casid.unknown_inputs.limits.prediction_limit import prediction_error_limit
from casid.unknown_inputs.limits.regression import Regression, arx
from casid.unknown_inputs.limits.regression_limit import regression_limit

Array = NDArray[np.float64]


def test_output_error_of_first_order_varies_as_by_hand() -> None:
    """y = b q^-1/(1 + f q^-1) u + e, u and e white: P = se (E psi psi')^-1 (Ljung 1999, 9.4).

    psi = [q^-1/F u, -b q^-2/F^2 u], whose moments are geometric series.
    """
    b, f, su, se = 1.5, -0.8, 2.0, 0.3
    system = LinearSignals.of(
        {"u": {"w": 1}, "y": {"u": ([0, b], [1, f]), "e": 1}}, {"w": su, "e": se}
    )
    truth = {"b1[u]": b, "f1[u]": f}
    found = prediction_error_limit(system, "y", ["u"], Orders(nb=1, nf=1), truth)
    g = 1 - f**2
    moments = su * np.array([[1 / g, b * f / g**2], [b * f / g**2, b**2 * (1 + f**2) / g**3]])
    np.testing.assert_allclose(found.limit, [b, f], atol=1e-8)
    np.testing.assert_allclose(found.covariance, se * np.linalg.inv(moments), rtol=1e-6)
    assert found.residual_variance == pytest.approx(se, rel=1e-9)


def test_arma_1_1_varies_as_box_and_jenkins_say() -> None:
    """(1 - phi B) z = (1 - theta B) a: Box and Jenkins (1976), section 7.2.6."""
    phi, theta = 0.8, 0.3
    system = LinearSignals.of({"z": {"a": ([1, -theta], [1, -phi])}}, {"a": 0.7})
    found = prediction_error_limit(system, "z", [], Orders(na=1, nc=1))
    expected = (1 - phi * theta) / (phi - theta) ** 2 * np.array(
        [[(1 - phi**2) * (1 - phi * theta), (1 - phi**2) * (1 - theta**2)],
         [(1 - phi**2) * (1 - theta**2), (1 - theta**2) * (1 - phi * theta)]]
    )  # fmt: skip
    np.testing.assert_allclose(found.limit, [-phi, -theta], atol=1e-8)
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-6)


def test_a_linear_predictor_has_the_limit_and_covariance_of_least_squares() -> None:
    """ARX by the program equals ARX by normal equations, outside the model set as well."""
    system = LinearSignals.of(
        {
            "u": {"w": ([1], [1, -0.6])},
            "y": {"u": ([0, 1.0, 0.3], [1, -0.7]), "e": ([1, 0.5], [1, -0.8])},
        },
        {"w": 1.0, "e": 0.3},
    )
    one = prediction_error_limit(system, "y", ["u"], Orders(na=1, nb=1))
    two = regression_limit(system, Regression("y", arx("y", ["u"], 1, 1)))
    np.testing.assert_allclose(one.limit, two.limit, rtol=1e-7)
    np.testing.assert_allclose(one.covariance, two.covariance, rtol=1e-6)
    assert one.residual_variance == pytest.approx(two.residual_variance, rel=1e-9)


def test_output_error_is_unbiased_under_coloured_noise_and_a_noise_model_varies_less() -> None:
    """Ljung (1999), 8.5: independently parameterised modules in open loop are consistent."""
    system = LinearSignals.of(
        {
            "u": {"w": ([1], [1, -0.6])},
            "y": {"u": ([0, 1.0], [1, -0.7]), "e": ([1], [1, -0.8])},
        },
        {"w": 1.0, "e": 0.3},
    )
    truth = {"b1[u]": 1.0, "f1[u]": -0.7}
    plain = prediction_error_limit(system, "y", ["u"], Orders(nb=1, nf=1), truth)
    modelled = prediction_error_limit(
        system, "y", ["u"], Orders(nb=1, nf=1, nd=1), {**truth, "d1": -0.8}
    )
    for name in truth:
        assert plain.bias(name) == pytest.approx(0, abs=1e-8)
        assert modelled.bias(name) == pytest.approx(0, abs=1e-8)
    both = modelled.covariance[np.ix_([0, 2], [0, 2])]
    assert modelled.names == ("b1[u]", "d1", "f1[u]")
    assert np.linalg.eigvalsh(plain.covariance - both).min() > 0
    assert modelled.variance("d1") == pytest.approx(1 - 0.8**2, rel=1e-6)  # an autoregression's


@pytest.mark.slow
def test_monte_carlo_of_output_error_of_too_low_an_order_has_limit_and_covariance() -> None:
    """A second-order system fitted by a first-order module: biased, residuals coloured.

    400 runs of N = 1500, Gauss-Newton in plain numpy; 3.5 standard errors, and the estimates' own
    O(1/N).
    """
    G = ([0, 1.0, 0.5], [1, -1.2, 0.45])
    system = LinearSignals.of({"u": {"w": 1}, "y": {"u": G, "e": ([1], [1, -0.5])}},
                              {"w": 1.0, "e": 0.5})  # fmt: skip
    theory = prediction_error_limit(system, "y", ["u"], Orders(nb=1, nf=1))
    rng, runs, N = np.random.default_rng(4), 400, 1500
    u, e = (
        rng.standard_normal((N + 100, runs)),
        math.sqrt(0.5) * rng.standard_normal((N + 100, runs)),
    )
    y = scipy.signal.lfilter(*G, u, axis=0) + scipy.signal.lfilter([1], [1, -0.5], e, axis=0)
    b, f = np.full(runs, theory["b1[u]"]), np.full(runs, theory["f1[u]"])
    for _ in range(15):
        b, f, step = gauss_newton_step(y[100:], u[99:-1], b, f)
        if step < 1e-5:
            break
    estimates = np.array([b, f]).T
    sd = np.sqrt(np.diag(theory.covariance) / N)
    assert np.all(
        np.abs(estimates.mean(axis=0) - theory.limit) < 3.5 * sd / math.sqrt(runs) + 3 / N
    )
    ratio = estimates.var(axis=0, ddof=1) / sd**2
    assert np.all(np.abs(ratio - 1) < 3.5 * math.sqrt(2 / runs))


def gauss_newton_step(y: Array, before: Array, b: Array, f: Array) -> tuple[Array, Array, float]:
    """One step of output error for every run: yhat(t) = -f yhat(t-1) + b u(t-1)."""
    yhat = psi_b = psi_f = np.zeros_like(b)
    bb = bf = ff = rb = rf = np.zeros_like(b)
    for y_t, u_t in zip(y, before, strict=True):
        psi_b, psi_f = -f * psi_b + u_t, -f * psi_f - yhat
        yhat = -f * yhat + b * u_t
        e = y_t - yhat
        bb, bf, ff = bb + psi_b * psi_b, bf + psi_b * psi_f, ff + psi_f * psi_f
        rb, rf = rb + psi_b * e, rf + psi_f * e
    det = bb * ff - bf * bf
    db, df = (ff * rb - bf * rf) / det, (bb * rf - bf * rb) / det
    return b + db, f + df, float(max(np.abs(db).max(), np.abs(df).max()))


def test_a_prefilter_that_whitens_is_as_good_as_the_noise_model_that_says_so() -> None:
    """OE with L = D varies as BJ with D free: the noise model costs the module nothing."""
    system = LinearSignals.of(
        {
            "u": {"w": ([1], [1, -0.6])},
            "y": {"u": ([0, 1.0], [1, -0.7]), "e": ([1], [1, -0.8])},
        },
        {"w": 1.0, "e": 0.3},
    )
    whitened = prediction_error_limit(
        system, "y", ["u"], Orders(nb=1, nf=1), prefilter=([1, -0.8], [1])
    )
    modelled = prediction_error_limit(system, "y", ["u"], Orders(nb=1, nf=1, nd=1))
    both = modelled.covariance[np.ix_([0, 2], [0, 2])]
    np.testing.assert_allclose(whitened.covariance, both, rtol=1e-7)


@pytest.mark.parametrize("roots", [[0.9, -0.5], [0.8 + 0.5j, 0.8 - 0.5j, 0.1], [0.3]])
def test_reflection_coefficients_are_another_name_for_a_stable_polynomial(
    roots: list[complex],
) -> None:
    a = np.real(np.poly(roots))[1:]
    k = step_down(a)
    assert np.all(np.abs(k) < 1)
    np.testing.assert_allclose(step_up(list(k)), a, atol=1e-12)


def test_orders_too_high_are_refused_with_the_direction() -> None:
    system = LinearSignals.of({"u": {"w": 1}, "y": {"u": ([0, 1.0], [1]), "e": 1}},
                              {"w": 1.0, "e": 0.1})  # fmt: skip
    with pytest.raises(IdentifiabilityError, match=r"the minimum is no point.*Lower the orders"):
        prediction_error_limit(system, "y", ["u"], Orders(nb=1, nc=1, nd=1))


def test_letters_and_wrong_names_are_refused() -> None:
    system = LinearSignals.of({"u": "w", "y": "b*u + e"}, {"w": 1, "e": 1})
    with pytest.raises(ModelError, match=r"needs numbers; give system.at\(\{\.\.\}\) for b"):
        prediction_error_limit(system, "y", ["u"], Orders(nb=1))
    with pytest.raises(ModelError, match=r"b is no coefficient .* it has b1\[u\]"):
        prediction_error_limit(system.at({"b": 1}), "y", ["u"], Orders(nb=1), {"b": 1})
