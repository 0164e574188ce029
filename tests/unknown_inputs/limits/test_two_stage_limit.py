"""Two stages by prediction error, instruments for modules, and inputs recovered from the future."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.signal

from casid.errors import IdentifiabilityError, ModelError
from casid.estimation.prediction_error.polynomial.estimation import prediction_error
from casid.estimation.prediction_error.polynomial.orders import Orders
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.module_remedies import compare_module_remedies
from casid.unknown_inputs.limits.prediction_limit import prediction_error_limit
from casid.unknown_inputs.limits.regression import FirstStage, Regression, lags
from casid.unknown_inputs.limits.regression_limit import regression_limit
from casid.unknown_inputs.limits.remedies import compare_remedies
from casid.unknown_inputs.limits.two_stage_limit import two_stage_limit

Array = np.ndarray


def closed_loop() -> LinearSignals:
    """An input that the output's disturbance enters, and a reference that reaches it late."""
    return LinearSignals.of(
        {
            "u": {"r": ([1, 0.5, 0.25], [1]), "v": ([0.8], [1])},
            "y": {"u": ([0, 1.0], [1, -0.6]), "v": ([1, 0.3], [1])},
        },
        {"r": 1.0, "v": 0.5},
    )


def test_in_a_linear_structure_it_is_least_squares_with_a_first_stage() -> None:
    """The two theories, stacked estimating equations and adjoint filters, agree in every digit.

    Three lags of r make u's part exactly; with two the model is wrong, and both say how much.
    """
    system = closed_loop()
    for stage in (2, 3, 5):
        regression = Regression(
            "y", {"b1[u]": ("u made", 1), "b2[u]": ("u made", 2)},
            generated={"u made": FirstStage("u", lags("r", 0, stage - 1))},
        )  # fmt: skip
        stacked = regression_limit(system, regression)
        found = two_stage_limit(system, "y", {"u": "u"}, ["r"], Orders(nb=2), lags=stage)
        np.testing.assert_allclose(found.limit, stacked.limit, rtol=1e-9)
        np.testing.assert_allclose(found.covariance, stacked.covariance, rtol=1e-9)
        assert found.residual_variance == pytest.approx(stacked.residual_variance, rel=1e-9)


@pytest.mark.slow
def test_two_stages_are_those_of_a_simulation() -> None:
    """150 runs of N = 1500, both stages estimated; 3.5 Monte Carlo standard errors and O(1/N)."""
    orders, runs, N = Orders(nb=1, nf=1), 150, 1500
    truth = {"b1[u]": 1.0, "f1[u]": -0.6}
    limit = two_stage_limit(closed_loop(), "y", {"u": "u"}, ["r"], orders, truth, lags=3)
    direct = prediction_error_limit(closed_loop(), "y", ["u"], orders, truth)
    for name in truth:
        assert limit.bias(name) == pytest.approx(0, abs=1e-7)
    assert abs(direct.bias("b1[u]")) > 0.01
    rng, f, n = np.random.default_rng(17), scipy.signal.lfilter, N + 60
    found = np.empty((runs, 2))
    for k in range(runs):
        r, v = rng.standard_normal(n), math.sqrt(0.5) * rng.standard_normal(n)
        u = f([1, 0.5, 0.25], [1], r) + 0.8 * v
        y = f([0, 1.0], [1, -0.6], u) + f([1, 0.3], [1], v)
        Z = np.stack([r[60 - m : n - m] for m in range(3)], axis=1)
        made = Z @ np.linalg.lstsq(Z, u[60:], rcond=None)[0]
        found[k] = prediction_error(y[60:], {"u": made}, orders).theta
    P = np.diag(limit.covariance)
    error = np.abs(found.mean(axis=0) - limit.limit)
    assert np.all(error < 3.5 * np.sqrt(P / N / runs) + 2 * P / N)
    ratio = N * found.var(axis=0, ddof=1) / P
    # Starting from rest costs some samples of either stage.
    assert np.all(np.abs(ratio - 1) < 3.5 * math.sqrt(2 / runs) + 20 / N)


def test_a_reference_that_reaches_nothing_is_refused() -> None:
    system = closed_loop().with_signals({"z": {"v": 1.0}})
    with pytest.raises(IdentifiabilityError, match=r"no reference \(r\) reaches z.*excite a node"):
        two_stage_limit(system, "y", {"u": "z"}, ["r"], Orders(nb=1))
    with pytest.raises(ModelError, match="reference u is no external; choose among r, v"):
        two_stage_limit(system, "y", {"u": "u"}, ["u"], Orders(nb=1))


# -- modules of a user's own system --------------------------------------------------------------


def sensed() -> LinearSignals:
    """u_U drives y, and y_I a sample late; its slow part d nobody knows."""
    return LinearSignals.of(
        {
            "u_K": {"r": 1, "d": ([0, 0.6], [1, -0.7])},
            "u_U": {"r": ([0, 0.5], [1]), "s": 1, "d": ([1], [1, -0.8])},
            "y": {"u_K": ([0, 1.0], [1]), "u_U": ([0, -0.7], [1]), "v": 1},
            "y_U": {"u_U": 1, "e": 1},
            "y_I": {"u_U": ([0, 0.5], [1, -0.6]), "e": 1},
        },
        {"r": 1.0, "s": 1.0, "d": 0.4, "v": 0.2, "e": 0.2},
        Ts=0.1,
    )


def recovered() -> LinearSignals:
    """With u_U = (q - 0.6)/0.5 y_I, which sees a sample of the future."""
    return sensed().with_signals({"u_hat": {"y_I": ([1, -0.6], [0, 0.5])}}, noncausal=True)


def test_an_input_recovered_from_a_late_sensor_may_see_the_future() -> None:
    """u_hat = u_U + (e(t+1) - 0.6 e)/0.5: (3.55) for least squares, none for instruments."""
    system = recovered()
    regressors = {"bK": ("u_K", 1), "bU": ("u_U", 1)}
    found = compare_remedies(
        system, "y", regressors, "u_U", {"bK": 1.0, "bU": -0.7},
        known=[("r", 1), ("r", 2), ("s", 1)], explain=[], eliminated={"u_U": "u_hat"},
    )  # fmt: skip
    exact = found["eliminate with u_hat, IV"]
    assert exact.bias("bK") == pytest.approx(0, abs=1e-12)
    assert exact.bias("bU") == pytest.approx(0, abs=1e-12)
    rng, f, N = np.random.default_rng(3), scipy.signal.lfilter, 400_000
    r, s, d, v, e = (math.sqrt(p) * rng.standard_normal(N) for p in (1, 1, 0.4, 0.2, 0.2))
    uK = r + f([0, 0.6], [1, -0.7], d)
    uU = f([0, 0.5], [1], r) + s + f([1], [1, -0.8], d)
    y = f([0, 1.0], [1], uK) + f([0, -0.7], [1], uU) + v
    yI = f([0, 0.5], [1, -0.6], uU) + e
    u_hat = (yI[1:] - 0.6 * yI[:-1]) / 0.5
    Phi = np.stack([uK[99:-1], u_hat[99:]], axis=1)
    theta = np.linalg.lstsq(Phi, y[100:], rcond=None)[0]
    biased = found["eliminate with u_hat, LS"]
    P = np.diag(biased.covariance)
    assert np.all(np.abs(theta - biased.limit) < 3.5 * np.sqrt(P / N))
    with pytest.raises(ModelError, match="begins with 0, so the filter needs the future"):
        sensed().with_signals({"u_hat": {"y_I": ([1, -0.6], [0, 0.5])}})


def test_prediction_error_takes_an_input_that_sees_the_future() -> None:
    """In a linear structure it is least squares on the same regressors."""
    system = recovered()
    pem = prediction_error_limit(system, "y", ["u_K", "u_hat"], Orders(nb=1))
    terms = {"b1[u_K]": ("u_K", 1), "b1[u_hat]": ("u_hat", 1)}
    ls = regression_limit(system, Regression("y", terms))
    np.testing.assert_allclose(pem.limit, ls.limit, rtol=1e-9)
    np.testing.assert_allclose(pem.covariance, ls.covariance, rtol=1e-9)


def test_modules_have_two_stages_instruments_and_explanations_too() -> None:
    truth = {"b1[u_K]": 1.0, "b1[u_U]": -0.7}
    found = compare_module_remedies(
        recovered(), "y", ["u_K", "u_U"], "u_U", Orders(nb=1), truth, known=["r", "s"],
        explain={"r": 3, "s": 2}, measured={"u_U": "y_U"}, eliminated={"u_U": "u_hat"},
    )  # fmt: skip
    names = [r.name for r in found.rows]
    assert names == [
        "all inputs known, PEM", "all inputs known, IV", "neglect, PEM", "neglect, IV",
        "predict from y_U, two-stage", "measure y_U, PEM", "measure y_U, IV",
        "eliminate with u_hat, PEM", "eliminate with u_hat, IV", "explain by r, s, PEM",
    ]  # fmt: skip
    rows = {r.name: r for r in found.rows}
    for name in ("measure y_U, IV", "eliminate with u_hat, IV", "all inputs known, IV"):
        assert rows[name].bias("b1[u_U]") == 0
        assert rows[name].bias("b1[u_K]") == 0
    assert rows["measure y_U, PEM"].bias("b1[u_U]") > 0.05  # (3.55): drawn to zero
    # d is in u_K and in what is left of u_U: two stages are biased in b_K, (3.50) and after.
    assert rows["predict from y_U, two-stage"].bias("b1[u_K]") < -0.01
    best = found.best("b1[u_U]")
    assert best is not None
    assert best.remedy == "measure y_U, IV"


def test_an_instrument_for_a_module_with_a_denominator_estimates_its_coefficients() -> None:
    """One input with F: (3.53) with A = F."""
    system = closed_loop()
    truth = {"b1[u]": 1.0, "f1[u]": -0.6, "b1[w]": 0.0}
    wide = system.with_signals({"w": {"v": ([0, 1.0], [1])}})
    orders = Orders(nb=1, nf={"u": 1, "w": 0})
    found = compare_module_remedies(wide, "y", ["u", "w"], "w", orders, truth, known=["r"])
    neglected = found["neglect, IV"]
    assert neglected.names == ("f1[u]", "b1[u]")
    assert neglected.bias("f1[u]") == pytest.approx(0, abs=1e-9)
    assert neglected.bias("b1[u]") == pytest.approx(0, abs=1e-9)
    refused = next(r.refused for r in found.rows if r.name == "all inputs known, IV")
    assert "give na in place of nf" in refused


def test_a_pole_that_rounds_to_one_is_told_in_more_digits() -> None:
    near = ([1.0], [1.0, -(1 - 1e-10)])
    with pytest.raises(ModelError, match="modulus 1 - 1e-10, within 1e-09 of the unit circle"):
        LinearSignals.of({"y": {"e": near}}, {"e": 1})
    with pytest.raises(ModelError, match="eigenvalue 1, modulus 1 - 1e-10, within 1e-09"):
        LinearSignals.of_state_space(([[1 - 1e-10]], [[1]], [[1]], [[0]]), {"e": 1}, signals=["y"])
