"""ARX, ARMAX, OE and BJ by prediction error: consistent where theory says so, biased where not."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scipy.stats import chi2

from casid.data.experiment import Experiment
from casid.data.record import Record
from casid.errors import DataError, IdentifiabilityError, ModelError, SolveError
from casid.estimation.covariance import whiteness
from casid.estimation.nlp.solver import Solver
from casid.estimation.prediction_error.polynomial import estimation as polynomial
from casid.estimation.prediction_error.polynomial.criterion import PredictionErrors
from casid.estimation.prediction_error.polynomial.estimation import (
    Orders,
    armax,
    arx,
    bj,
    oe,
    prediction_error,
)
from casid.estimation.prediction_error.polynomial.misfit import residual_input_correlation
from casid.estimation.prediction_error.polynomial.orders import Layout, reflected
from casid.estimation.prediction_error.polynomial.records import stretches
from casid.estimation.prediction_error.polynomial.start_values import candidates, steiglitz_mcbride
from tests.support.recursion import filtered, predicted_errors, simulated

A, B, C, D = (1.0, -1.5, 0.7), (0.0, 1.0, 0.5), (1.0, -0.6, 0.2), (1.0, -0.8)

# Structure: the system, its orders, and the coefficients in casid's order.
SYSTEMS = {
    "ARX": (dict(A=A, B={"u": B}), Orders(na=2, nb=2), [-1.5, 0.7, 1.0, 0.5]),
    "ARMAX": (
        dict(A=A, B={"u": B}, C=C),
        Orders(na=2, nb=2, nc=2),
        [-1.5, 0.7, 1.0, 0.5, -0.6, 0.2],
    ),
    "OE": (dict(B={"u": B}, F={"u": A}), Orders(nb=2, nf=2), [1.0, 0.5, -1.5, 0.7]),
    "BJ": (
        dict(B={"u": B}, C=C, D=D, F={"u": A}),
        Orders(nb=2, nc=2, nd=1, nf=2),
        [1.0, 0.5, -0.6, 0.2, -0.8, -1.5, 0.7],
    ),
}
STRUCTURES = pytest.mark.parametrize("structure", list(SYSTEMS))


def coloured(rng: np.random.Generator, n: int) -> np.ndarray:
    """An input with memory: AR(1), 0.5."""
    return filtered((1.0,), (1.0, -0.5), rng.normal(size=n))


def record(structure: str, n: int, seed: int, noise: float = 0.5):
    rng = np.random.default_rng(seed)
    system, orders, theta = SYSTEMS[structure]
    u = coloured(rng, n)
    return simulated(noise * rng.normal(size=n), {"u": u}, **system), u, orders, np.array(theta)


# -- consistency --------------------------------------------------------------------------------


@STRUCTURES
def test_data_without_noise_return_the_coefficients(structure):
    """Signals are at rest before the record, so there is no transient either."""
    y, u, orders, theta = record(structure, 300, seed=3, noise=0.0)
    model = prediction_error(y, u, orders)
    told = [i for i, name in enumerate(model.names) if name[0] in "abf"]
    assert model.theta[told] == pytest.approx(theta[told], abs=1e-9)
    assert model.structure == structure
    if structure in ("ARMAX", "BJ"):
        assert any("C and D mean nothing" in note for note in model.notes)


@STRUCTURES
def test_errors_shrink_with_the_record_and_stay_within_their_covariance(structure):
    """N (theta - theta0)' P^-1 (theta - theta0) is chi-squared (Ljung 1999, section 9.6)."""
    for n, seed in ((1000, 3), (8000, 4)):
        y, u, orders, theta = record(structure, n, seed)
        model = prediction_error(y, u, orders)
        error = model.theta - theta
        assert model.is_converged
        assert error @ np.linalg.solve(model.covariance, error) < chi2.ppf(0.999, model.n)
        largest = max(model.std_errors.values())
        assert model.noise_variance == pytest.approx(0.25, abs=4 * 0.25 * np.sqrt(2 / n))
        if n == 1000:
            before = largest
    assert largest == pytest.approx(before / np.sqrt(8), rel=0.25)  # P itself is an estimate


def test_several_inputs_have_their_own_dynamics_and_delays():
    rng = np.random.default_rng(5)
    n = 4000
    u = {"aileron": coloured(rng, n), "gust": rng.normal(size=n)}
    y = simulated(
        0.3 * rng.normal(size=n),
        u,
        B={"aileron": (0.0, 1.0, 0.5), "gust": (0.0, 0.0, 0.0, 0.8)},
        F={"aileron": A, "gust": (1.0, -0.9)},
        D=D,
    )
    model = bj(
        y,
        u,
        nb={"aileron": 2, "gust": 1},
        nf={"aileron": 2, "gust": 1},
        nk={"aileron": 1, "gust": 3},
        nc=0,
        nd=1,
    )
    theta = np.array([1.0, 0.5, 0.8, -0.8, -1.5, 0.7, -0.9])
    assert model.names == (
        "b1[aileron]", "b2[aileron]", "b3[gust]", "d1", "f1[aileron]", "f2[aileron]", "f1[gust]",
    )  # fmt: skip
    error = model.theta - theta
    assert error @ np.linalg.solve(model.covariance, error) < chi2.ppf(0.999, model.n)
    assert list(model.B["gust"][:3]) == [0.0, 0.0, 0.0]
    assert model["b3[gust]"] == model.B["gust"][3]


def test_a_polynomial_with_everything_is_fitted_too():
    rng = np.random.default_rng(8)
    n = 6000
    u = coloured(rng, n)
    system = dict(A=(1.0, -0.5), B={"u": (0.0, 1.0)}, C=(1.0, 0.4), D=D, F={"u": (1.0, 0.6)})
    y = simulated(0.3 * rng.normal(size=n), {"u": u}, **system)
    model = prediction_error(y, u, Orders(na=1, nb=1, nc=1, nd=1, nf=1))
    error = model.theta - np.array([-0.5, 1.0, 0.4, -0.8, 0.6])
    assert model.structure == "polynomial"
    assert error @ np.linalg.solve(model.covariance, error) < chi2.ppf(0.999, model.n)


@pytest.mark.slow
@pytest.mark.parametrize("structure", ["ARMAX", "BJ"])
def test_standard_errors_are_those_of_repeated_experiments(structure):
    """Mean of (theta - theta0)' P^-1 (theta - theta0) / n over R runs is 1 +/- sqrt(2 / (n R))."""
    runs, distance = 40, 0.0
    for seed in range(runs):
        y, u, orders, theta = record(structure, 500, seed)
        model = prediction_error(y, u, orders)
        error = model.theta - theta
        distance += error @ np.linalg.solve(model.covariance, error) / model.n / runs
    # Four standard deviations; the asymptotic P lacks terms of relative size n / N = 0.014.
    assert distance == pytest.approx(1.0, abs=4 * np.sqrt(2 / (model.n * runs)) + 0.03)


def test_white_standard_errors_fail_for_coloured_noise_as_predicted_and_robust_ones_do_not():
    """y = b u + v, u and v AR(1) with poles p, r: var b is (1 + p r)/(1 - p r) times that for
    white v (sum of the product of the autocorrelations)."""
    rng = np.random.default_rng(6)
    n, p, r = 100_000, 0.8, 0.7
    u, v = (lfilter([1.0], [1.0, -pole], rng.normal(size=n)) for pole in (p, r))
    white, robust = (oe(u + v, u, nb=1, nf=0, nk=0, errors=kind) for kind in ("white", "robust"))
    ratio = (robust.covariance[0, 0]) / (white.covariance[0, 0])
    # Bartlett's window of about 60 lags loses a share of about 1/60 p r/(1 - p r)^2 .. = 5 %.
    assert ratio == pytest.approx((1 + p * r) / (1 - p * r), rel=0.12)
    assert robust.theta == pytest.approx(white.theta, rel=1e-12)
    assert "short memory" in robust.assumes
    assert "white innovations" in white.assumes


@STRUCTURES
def test_start_values_are_consistent(structure):
    """Hannan-Rissanen and Steiglitz-McBride after a long ARX: the search starts near the truth."""
    y, u, orders, theta = record(structure, 5000, seed=40)
    points = candidates([(y, {"u": u})], Layout.of(orders, ["u"]))
    model = prediction_error(y, u, orders)
    sigma = np.sqrt(np.diag(model.covariance))
    nearest = min(float(np.max(np.abs(point - theta) / sigma)) for _, point, _ in points)
    # Consistent, not efficient: a few times the efficient error, 4 of them to cover the worst.
    assert nearest < 12


def test_steiglitz_mcbride_is_exact_without_noise():
    u = coloured(np.random.default_rng(41), 200)
    b, f, out = steiglitz_mcbride([(filtered(B, A, u), u)], 2, 2, 1)
    assert b == pytest.approx(B, abs=1e-9)
    assert f == pytest.approx(A, abs=1e-9)
    assert out == ()


def test_steiglitz_mcbride_is_consistent_in_white_output_noise_and_least_squares_is_not():
    """Least squares of z_t = -f z_{t-1} + b x_{t-1}: f is attenuated by r/(r + noise variance)."""
    rng = np.random.default_rng(43)
    n, f = 20_000, -0.8
    x = rng.normal(size=n)
    z = filtered((0.0, 1.0), (1.0, f), x) + rng.normal(size=n)
    r = 1 / (1 - f**2)  # variance of the noise-free output
    attenuated = arx(z, x, na=1, nb=1)["a1"]
    assert attenuated == pytest.approx(f * r / (r + 1), abs=0.02)
    b, poly, _ = steiglitz_mcbride([(z, x)], 1, 1, 1)
    sigma = oe(z, x, nb=1, nf=1).std_errors
    assert poly[1] == pytest.approx(f, abs=8 * sigma["f1[u]"])
    assert b[1] == pytest.approx(1.0, abs=8 * sigma["b1[u]"])


def test_without_noise_every_start_of_two_inputs_is_the_truth():
    rng = np.random.default_rng(44)
    u = {"a": coloured(rng, 400), "g": rng.normal(size=400)}
    parts = dict(B={"a": B, "g": (0.0, 0.8)}, F={"a": A, "g": (1.0, -0.3)})
    y = simulated(np.zeros(400), u, **parts)
    orders = Orders(nb={"a": 2, "g": 1}, nf={"a": 2, "g": 1})
    points = candidates([(y, u)], Layout.of(orders, ["a", "g"]))
    assert len(points) == 3
    for _, theta, _ in points:
        assert theta == pytest.approx([1.0, 0.5, 0.8, -1.5, 0.7, -0.3], abs=1e-6)


# -- closed loop --------------------------------------------------------------------------------


def closed_loop(n: int, seed: int, c: float, k: float, variance: float):
    """y_t = 0.9 y_{t-1} + u_{t-1} + e_t + c e_{t-1}, u = r - k y, r white with variance 1."""
    rng = np.random.default_rng(seed)
    e, r = np.sqrt(variance) * rng.normal(size=n), rng.normal(size=n)
    y, u = np.zeros(n), np.zeros(n)
    y[0] = e[0]
    u[0] = r[0] - k * y[0]
    for t in range(1, n):
        y[t] = 0.9 * y[t - 1] + u[t - 1] + e[t] + c * e[t - 1]
        u[t] = r[t] - k * y[t]
    return y, u


def test_in_closed_loop_direct_prediction_error_needs_the_right_noise_model():
    """ARMAX is consistent; least squares and OE go where theory sends them (Ljung 1999, 13.4)."""
    c, k, variance, n = 0.7, 0.5, 1.0, 20_000
    y, u = closed_loop(n, 7, c, k, variance)
    truth = np.array([-0.9, 1.0])

    right = armax(y, u, na=1, nb=1, nc=1)
    error = right.theta - [-0.9, 1.0, c]
    assert error @ np.linalg.solve(right.covariance, error) < chi2.ppf(0.999, 3)

    # Least squares: theta0 + R^-1 E phi v, phi = [-y_{t-1}, u_{t-1}], v = e_t + c e_{t-1}.
    alpha = 0.9 - k  # the loop's pole
    s = (1 + variance * (1 + c**2 + 2 * alpha * c)) / (1 - alpha**2)  # variance of y
    R = np.array([[s, k * s], [k * s, 1 + k**2 * s]])
    limit = truth + np.linalg.solve(R, [-c * variance, -k * c * variance])
    wrong = arx(y, u, na=1, nb=1, errors="robust")
    sigma = np.sqrt(np.diag(wrong.covariance))
    assert np.all(np.abs(wrong.theta - limit) < 4 * sigma)
    assert np.max(np.abs(limit - truth) / sigma) > 20

    # OE: the minimum of the integral of |(1 + k G) y - G r|^2 over frequency.
    z = np.exp(-2j * np.pi * (np.arange(4096) + 0.5) / 4096)

    def spectrum(theta):
        g = theta[0] * z / (1 + theta[1] * z)
        of_r = (1 + k * g) * z / (1 - alpha * z) - g
        of_e = (1 + k * g) * (1 + c * z) / (1 - alpha * z) * np.sqrt(variance)
        return np.concatenate([of_r.real, of_r.imag, of_e.real, of_e.imag])

    limit = least_squares(spectrum, [1.0, -0.9], xtol=1e-12, ftol=1e-14).x
    wrong = oe(y, u, nb=1, nf=1, errors="robust")
    sigma = np.sqrt(np.diag(wrong.covariance))
    assert np.all(np.abs(wrong.theta - limit) < 4 * sigma)
    assert np.max(np.abs(limit - [1.0, -0.9]) / sigma) > 20


def test_a_plant_that_is_unstable_without_its_loop_is_found_by_armax():
    """The predictor divides by C alone; A may be unstable. OE divides by it and is refused."""
    rng = np.random.default_rng(1)
    n = 3000
    e, r = 0.3 * rng.normal(size=n), rng.normal(size=n)
    y, u = np.zeros(n), np.zeros(n)
    for t in range(1, n):
        y[t] = 1.2 * y[t - 1] + u[t - 1] + e[t] - 0.4 * e[t - 1]
        u[t] = r[t] - 0.6 * y[t]
    model = armax(y, u, na=1, nb=1, nc=1)
    error = model.theta - [-1.2, 1.0, -0.4]
    assert error @ np.linalg.solve(model.covariance, error) < chi2.ppf(0.999, 3)
    assert not model.is_stable
    assert any(f"A has a root of modulus {-model['a1']:.4f}" in note for note in model.notes)
    with pytest.raises(SolveError, match=r"root of modulus 1\..*use predict"):
        model.simulate(u)
    with pytest.raises(SolveError, match=r"root of F\[u\] .* unit circle.*use A in place of F"):
        bj(y, u, nb=1, nc=1, nd=1, nf=1)


# -- held against independent implementations ---------------------------------------------------


def test_arx_is_linear_least_squares():
    y, u, _, _ = record("ARX", 400, seed=2)
    t = np.arange(3, 400)
    phi = np.column_stack([-y[t - 1], -y[t - 2], u[t - 2], u[t - 3]])
    theta, square, *_ = np.linalg.lstsq(phi, y[t], rcond=None)
    model = arx(y, u, na=2, nb=2, nk=2)
    assert model.theta == pytest.approx(theta, rel=1e-12)
    assert 2 * model.loss * model.N == pytest.approx(float(square[0]), rel=1e-12)
    covariance = float(square[0]) / (len(t) - 4) * np.linalg.inv(phi.T @ phi)
    assert model.covariance == pytest.approx(covariance, rel=1e-9)
    assert model.status == "closed form"
    assert model.discarded == (3,)


@pytest.mark.parametrize("solver", [Solver("ipopt"), Solver("sqpmethod")], ids=repr)
@STRUCTURES
def test_every_solver_finds_the_same_optimum(structure, solver):
    y, u, orders, _ = record(structure, 500, seed=9)
    reference = prediction_error(y, u, orders)
    model = prediction_error(y, u, orders, solver=solver)
    # A thousandth of a standard error; the criterion is then flat to 1e-6 / (2 N).
    assert np.all(np.abs(model.theta - reference.theta) < 1e-3 * np.sqrt(np.diag(model.covariance)))
    assert model.loss == pytest.approx(reference.loss, rel=1e-8)


@pytest.mark.parametrize("structure", ["ARMAX", "OE", "BJ"])
def test_a_general_least_squares_solver_on_recursive_predictions_agrees(structure):
    """scipy's trust region on errors computed sample by sample, derivatives by differences."""
    y, u, orders, theta = record(structure, 150, seed=11)
    layout = Layout.of(orders, ["u"])

    def errors(x):
        p = layout.split(x)
        return predicted_errors(y, {"u": u}, A=p.A, B={"u": p.B[0]}, C=p.C, D=p.D, F={"u": p.F[0]})

    reference = least_squares(errors, theta, xtol=1e-14, ftol=1e-14, gtol=1e-12)
    model = prediction_error(y, u, orders, discard=0)
    sigma = np.sqrt(np.diag(model.covariance))
    assert model.N == 150
    assert np.all(np.abs(model.theta - reference.x) < 1e-3 * sigma)
    assert model.loss * model.N == pytest.approx(reference.cost, rel=1e-8)


def test_armax_is_the_maximum_of_a_kalman_filters_likelihood():
    """statsmodels' Kalman filter on the state-space form, started from rest as casid does."""
    pytest.importorskip("statsmodels")
    from statsmodels.tsa.statespace.mlemodel import MLEModel

    y, u, orders, theta = record("ARMAX", 400, seed=12)

    class Armax(MLEModel):
        """Harvey's form: alpha_1 = y, its next value driven by B u and e."""

        start_params = [*theta, 0.3]
        param_names = [*Layout.of(orders, ["u"]).names, "variance"]

        def __init__(self):
            super().__init__(y, k_states=3, k_posdef=1)
            self["design"] = np.array([[1.0, 0.0, 0.0]])
            self["transition"] = np.eye(3, k=1)

        def update(self, params, **options):
            a1, a2, b1, b2, c1, c2, variance = super().update(params, **options)
            self["transition", 0, 0], self["transition", 1, 0] = -a1, -a2
            selection = np.array([[1.0], [c1], [c2]])
            self["selection"], self["state_cov"] = selection, np.array([[variance]])
            drive = np.r_[b1 * np.r_[0.0, u[:-1]] + b2 * np.r_[0.0, 0.0, u[:-2]], 0.0]
            self["state_intercept"] = np.vstack([drive[1:], np.zeros((2, len(u)))])
            self.ssm.initialize_known(np.r_[drive[0], 0, 0], variance * selection @ selection.T)

    reference = Armax()
    model = prediction_error(y, u, orders, discard=0)
    ours = np.r_[model.theta, 2 * model.loss]
    assert reference.loglike(ours) == pytest.approx(1 + model.n - model.aic / 2, rel=1e-9)
    fit = reference.fit(method="bfgs", disp=0, maxiter=200, gtol=1e-7)
    # Its derivatives are differences: a hundredth of a standard error.
    sigma = np.sqrt(np.diag(model.covariance))
    assert np.all(np.abs(fit.params[:-1] - model.theta) < 1e-2 * sigma)
    assert fit.llf <= reference.loglike(ours) + 1e-8


def test_finite_responses_with_arma_noise_are_statsmodels_regressions():
    """BJ with F = 1 is a regression on lagged inputs with ARMA errors (SARIMAX, exog)."""
    pytest.importorskip("statsmodels")
    from tests.estimation.prediction_error.polynomial.test_arma import FromRest

    rng = np.random.default_rng(14)
    n = 500
    u = coloured(rng, n)
    y = simulated(0.5 * rng.normal(size=n), {"u": u}, B={"u": B}, C=(1.0, 0.5), D=D)
    model = bj(y, u, nb=2, nc=1, nd=1, nf=0, discard=0)
    exog = np.column_stack([np.r_[0.0, u[:-1]], np.r_[0.0, 0.0, u[:-2]]])
    reference = FromRest(y, exog=exog, order=(1, 0, 1))
    ours = np.r_[model["b1[u]"], model["b2[u]"], -model["d1"], model["c1"], 2 * model.loss]
    assert reference.loglike(ours) == pytest.approx(1 + model.n - model.aic / 2, rel=1e-9)
    fit = reference.fit(ours * 1.05, method="bfgs", disp=0, maxiter=200, gtol=1e-7)
    sigma = np.sqrt(np.diag(model.covariance))
    assert np.all(np.abs(fit.params[:2] - ours[:2]) < 1e-2 * sigma[:2])
    assert fit.llf <= reference.loglike(ours) + 1e-8


# -- the criterion ------------------------------------------------------------------------------


def test_the_gradient_is_the_derivative_of_the_recursion():
    """CasADi differentiates the errors written out sample by sample, every polynomial present."""
    rng = np.random.default_rng(4)
    n = 30
    orders = Orders(na=2, nb={"a": 2, "g": 1}, nc=2, nd=1, nf={"a": 1, "g": 2}, nk={"a": 0, "g": 3})
    layout = Layout.of(orders, ["a", "g"])
    parts = [
        (rng.normal(size=m), {"a": rng.normal(size=m), "g": rng.normal(size=m)}) for m in (n, 20)
    ]
    theta = 0.4 * rng.uniform(-1, 1, size=layout.n)
    symbol = ca.SX.sym("theta", layout.n)
    place = {name: symbol[i] for i, name in enumerate(layout.names)}

    def apply(b, a, x):  # lists of (lag, coefficient)
        out = []
        for t in range(len(x)):
            terms = [c * x[t - k] for k, c in b if t >= k] + [
                -c * out[t - k] for k, c in a if t >= k
            ]
            out.append(sum(terms, ca.SX(0)))
        return out

    def lags(letter, mark=""):
        names = [f"{letter}{k}{mark}" for k in range(9)]
        return [(k, place[name]) for k, name in enumerate(names) if name in place]

    discard, eps = (4, 7), []
    for (y, u), first in zip(parts, discard, strict=True):
        v = apply([(0, 1.0), *lags("a")], [], list(y))
        for name in ("a", "g"):
            x = apply(lags("b", f"[{name}]"), lags("f", f"[{name}]"), list(u[name]))
            v = [p - q for p, q in zip(v, x, strict=True)]
        eps += apply([(0, 1.0), *lags("d")], lags("c"), v)[first:]
    vector = ca.vertcat(*eps)
    jacobian = ca.Function("j", [symbol], [vector, ca.jacobian(vector, symbol)])
    e, j = (np.array(m) for m in jacobian(theta))
    at = PredictionErrors(layout, parts, discard).evaluate(theta)
    assert at.value == pytest.approx(0.5 * float(np.sum(e**2)), rel=1e-12)
    assert at.gradient == pytest.approx((j.T @ e).ravel(), rel=1e-10, abs=1e-10)
    assert at.hessian == pytest.approx(j.T @ j, rel=1e-10, abs=1e-10)


def test_the_criterion_is_infinite_where_the_predictor_is_unstable():
    y, u, orders, theta = record("BJ", 100, seed=1)
    criterion = PredictionErrors(Layout.of(orders, ["u"]), [(y, {"u": u})], [0])
    assert np.isfinite(criterion.evaluate(theta).value)
    for place, value in ((3, 1.1), (6, 1.1)):  # c2 and f2: the product of the roots
        outside = theta.copy()
        outside[place] = value
        assert criterion.evaluate(outside).value == np.inf
    unstable_noise = theta.copy()
    unstable_noise[4] = -1.1  # D multiplies: no root of it is in the predictor's way
    assert np.isfinite(criterion.evaluate(unstable_noise).value)


def test_long_records_are_summed_in_pieces():
    """The sums over chunks of samples are those of the stacked derivative."""
    rng = np.random.default_rng(2)
    y, u = rng.normal(size=40_000), rng.normal(size=40_000)
    criterion = PredictionErrors(Layout.of(Orders(nb=1, nf=1, nc=1), ["u"]), [(y, {"u": u})], [5])
    theta = np.array([1.0, 0.3, -0.5])
    at = criterion.evaluate(theta)
    j, e = criterion.jacobian(theta)
    assert criterion.N == len(e) == 39_995
    assert at.hessian == pytest.approx(j.T @ j, rel=1e-11)
    assert at.gradient == pytest.approx(j.T @ e, rel=1e-11)
    assert criterion.scores(theta).sum(axis=0) == pytest.approx(at.gradient, rel=1e-11)


# -- records ------------------------------------------------------------------------------------


def test_records_share_their_coefficients_and_nothing_crosses_a_gap():
    """Least squares stacked over the stretches, each with its own first rows left out."""
    y, u, _, _ = record("ARX", 500, seed=13)
    ys, us = [y[:200], y[260:]], [u[:200], u[260:]]
    rows, target = [], []
    for one_y, one_u in zip(ys, us, strict=True):
        t = np.arange(2, len(one_y))
        rows.append(np.column_stack([-one_y[t - 1], -one_y[t - 2], one_u[t - 1], one_u[t - 2]]))
        target.append(one_y[t])
    theta = np.linalg.lstsq(np.vstack(rows), np.concatenate(target), rcond=None)[0]
    model = arx(ys, us, na=2, nb=2)
    assert model.theta == pytest.approx(theta, rel=1e-12)
    assert model.N == 198 + 238
    assert [len(r) for r in model.residuals] == [200, 240]


@pytest.mark.parametrize("structure", ["ARMAX", "BJ"])
def test_the_order_of_records_does_not_matter(structure):
    y, u, orders, _ = record(structure, 900, seed=15)
    ys, us = [y[:300], y[300:550], y[550:]], [u[:300], u[300:550], u[550:]]
    forward = prediction_error(ys, us, orders)
    backward = prediction_error(ys[::-1], us[::-1], orders)
    sigma = np.sqrt(np.diag(forward.covariance))
    assert np.all(np.abs(forward.theta - backward.theta) < 1e-3 * sigma)


def test_a_record_is_cut_at_its_missing_samples():
    y, u, _, _ = record("ARX", 300, seed=16)
    mask = np.zeros(300, dtype=bool)
    mask[[100, 101, 250]] = True
    whole = Record({"roll": y, "rudder": u}, {"roll": "rad", "rudder": "rad"}, 0.1)
    ys, us = stretches(whole.mark_missing("roll", mask), "roll", ["rudder"], shortest=100)
    assert [len(part) for part in ys] == [100, 148]
    assert arx(ys, us, na=2, nb=2, Ts=0.1).inputs == ("rudder",)
    with pytest.raises(DataError, match="no stretch of 200 samples.*lower `shortest`"):
        stretches(whole.mark_missing("roll", mask), "roll", ["rudder"], shortest=200)
    with pytest.raises(DataError, match="no channel sway; it has roll, rudder"):
        stretches(whole, "sway")


def test_discarding_the_start_up_spares_the_bias_of_a_record_cut_out_of_a_longer_one():
    """The filters start from rest; a slow system cut out at an offset does not."""
    n, first = 1200, 800
    rng = np.random.default_rng(17)
    u = np.where(np.arange(n) < first, 5.0, rng.normal(size=n))
    y = simulated(0.05 * rng.normal(size=n), {"u": u}, B={"u": (0.0, 0.1)}, F={"u": (1.0, -0.95)})
    theta = np.array([0.1, -0.95])
    late = oe(y[first:], u[first:], nb=1, nf=1)
    every = oe(y[first:], u[first:], nb=1, nf=1, discard=0)
    # The transient 10 * 0.95^t has fallen to 0.16 of the noise's level only after the discard.
    assert late.discarded[0] >= 79
    assert np.max(np.abs(late.theta - theta)) < 0.2 * np.max(np.abs(every.theta - theta))


# -- what a model can do ------------------------------------------------------------------------


@STRUCTURES
def test_prediction_and_simulation_are_the_recursions(structure):
    """(2.19), computed sample by sample."""
    y, u, orders, _ = record(structure, 200, seed=18)
    model = prediction_error(y, u, orders)
    fresh_y, fresh_u, *_ = record(structure, 80, seed=19)
    parts = dict(A=model.A, B=model.B, F=model.F)
    eps = predicted_errors(fresh_y, {"u": fresh_u}, C=model.C, D=model.D, **parts)
    assert model.predict(fresh_y, fresh_u) == pytest.approx(fresh_y - eps, abs=1e-11)
    expected = simulated(np.zeros(80), {"u": fresh_u}, **parts)
    assert model.simulate({"u": fresh_u}) == pytest.approx(expected, abs=1e-11)
    assert model.residuals[0] == pytest.approx(y - model.predict(y, u), abs=1e-11)
    assert len(model.residual) == model.N
    counted = y[model.discarded[0] :]
    size = np.linalg.norm(model.residual) / np.linalg.norm(counted - counted.mean())
    assert model.fit == pytest.approx(100 * (1 - size), rel=1e-9)
    assert model.loss == pytest.approx(float(model.residual @ model.residual) / 2 / model.N)
    assert model.bic - model.aic == pytest.approx((model.n + 1) * (np.log(model.N) - 2))


def test_frequency_responses_are_those_of_python_control():
    y, u, orders, _ = record("BJ", 400, seed=20)
    model = prediction_error(y, u, orders, Ts=0.05)
    omega = np.array([0.1, 3.0, 40.0])
    system = model.to_control(noise=True)
    assert system.dt == 0.05
    at = system(np.exp(1j * omega * 0.05))
    assert model.response(omega)["u"] == pytest.approx(at[0, 0], rel=1e-9)
    assert model.spectrum(omega) == pytest.approx(
        model.noise_variance * np.abs(at[0, 1]) ** 2, rel=1e-9
    )
    assert model.to_control().ninputs == 1


def test_the_mean_of_the_spectrum_is_the_disturbances_variance():
    """Parseval; for C/D = 1/(1 - d q^-1) the variance is lambda / (1 - d^2)."""
    y, _, _, _ = record("ARX", 2000, seed=21)
    grid = (np.arange(4096) + 0.5) / 4096 * np.pi / 0.1
    for orders, name in ((Orders(nd=1), "d1"), (Orders(na=1), "a1")):
        model = prediction_error(y, None, orders, Ts=0.1)
        variance = model.noise_variance / (1 - model[name] ** 2)
        assert np.mean(model.spectrum(grid)) == pytest.approx(variance, rel=1e-6)


def test_the_table_shows_coefficients_with_their_errors():
    y, u, orders, _ = record("BJ", 500, seed=22)
    model = prediction_error(y, u, orders, Ts=0.1)
    text = str(model)
    assert text.startswith("BJ model: y(t) = [B(q)/F(q)] u(t) + [C(q)/D(q)] e(t), Ts = 0.1 s")
    error = model.std_errors["f1[u]"]
    assert f"F(q) = 1 - {abs(model['f1[u]']):.5g} (+/- {error:.2g}) q^-1" in text
    assert f"N = {model.N}" in text
    assert "white innovations" in text
    assert "Linder 2017, (2.54)" in text
    outside = int(np.sum(np.abs(model.input_correlation["u"]) > 1))
    assert (
        f"residual tests  whiteness: {whiteness(model.residual)} of 20 lags outside 95 %; "
        f"correlation with u: {outside} of 21 lags outside"
    ) in text
    assert (
        repr(model) == f"<PolynomialModel BJ: 7 coefficients, N = {model.N}, fit {model.fit:.1f} %>"
    )
    with pytest.raises(KeyError, match="no coefficient 'b9'; there are b1"):
        model["b9"]


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_one_in_twenty_correlations_of_independent_signals_lies_outside_its_bound(pole):
    """Bartlett: coloured signals correlate more by chance, and the bound grows with it.

    Lags of one pair are dependent, so the spread over pairs is measured: its mean of 200 within
    four standard errors, and 0.02 for the estimated autocorrelations.
    """
    rng = np.random.default_rng(41)
    share = []
    for _ in range(200):
        e, u = (lfilter([1.0], [1.0, -pole], rng.normal(size=1500))[200:] for _ in range(2))
        whole = residual_input_correlation([e], [u])
        assert len(whole) == 21
        share.append(np.mean(np.abs(whole) > 1))
    assert np.mean(share) == pytest.approx(0.05, abs=4 * np.std(share) / np.sqrt(200) + 0.02)


def test_what_the_model_leaves_of_the_input_is_seen_in_the_correlation():
    """G one lag short: the residual holds b2 u(t - 2), of correlation b2 / |(b2, sd)|, and no more.

    A finite response to white noise: the lags fitted are orthogonal to the residual.
    """
    rng = np.random.default_rng(42)
    u, N = rng.normal(size=4000), 4000
    y = np.r_[0.0, u[:-1]] + 0.3 * np.r_[0.0, 0.0, u[:-2]] + 0.4 * rng.normal(size=N)
    short, right = arx(y, u, na=0, nb=1), arx(y, u, na=0, nb=2)
    ratio = short.input_correlation["u"]
    # sqrt(N) rho is normal with a variance below one.
    assert ratio[2] == pytest.approx(0.6 * np.sqrt(N) / 1.96, abs=4 / 1.96 * 1.2)
    assert np.all(np.abs(np.delete(ratio, 2)) < 4 / 1.96)
    assert np.all(np.abs(right.input_correlation["u"]) < 4 / 1.96)
    # Records of their own length, the shorter than the lags, and an input that does not move.
    parts = [(y[:3000], u[:3000]), (y[3000:3010], u[3000:3010])]
    cut = arx(
        [p[0] for p in parts],
        [{"u": p[1], "one": np.ones(len(p[0]))} for p in parts],
        na=0,
        nb={"u": 2, "one": 1},
    )
    assert np.all(np.abs(cut.input_correlation["u"]) < 4 / 1.96)
    assert not np.any(cut.input_correlation["one"])


@settings(max_examples=25, deadline=None)
@given(of_y=st.floats(1e-9, 1e9), of_u=st.floats(1e-9, 1e9))
def test_estimates_follow_the_units(of_y, of_u):
    """a, c, d, f have no unit; b carries output per input."""
    y, u, _, _ = record("ARX", 120, seed=23)
    base, model = arx(y, u, na=2, nb=2), arx(of_y * y, of_u * u, na=2, nb=2)
    assert model.theta[:2] == pytest.approx(base.theta[:2], rel=1e-9)
    assert model.theta[2:] * of_u / of_y == pytest.approx(base.theta[2:], rel=1e-9)
    assert model.noise_variance == pytest.approx(base.noise_variance * of_y**2, rel=1e-9)
    assert model.fit == pytest.approx(base.fit, rel=1e-9)


def test_a_program_in_any_units_is_solved_alike():
    y, u, orders, _ = record("BJ", 400, seed=24)
    base, model = prediction_error(y, u, orders), prediction_error(1e-9 * y, 1e6 * u, orders)
    sigma = np.sqrt(np.diag(model.covariance))
    factor = np.where([name[0] == "b" for name in model.names], 1e-15, 1.0)
    assert np.all(np.abs(model.theta - base.theta * factor) < 1e-3 * sigma)


def test_a_given_start_is_used():
    y, u, orders, _ = record("ARMAX", 500, seed=25)
    first = prediction_error(y, u, orders)
    again = prediction_error(y, u, orders, start=first, discard=first.discarded[0])
    assert again.start == "the model given"
    assert np.all(np.abs(again.theta - first.theta) < 1e-3 * np.sqrt(np.diag(first.covariance)))
    with pytest.raises(ModelError, match="start has the coefficients a1.*give a model of the same"):
        prediction_error(y, u, Orders(nb=2, nf=2), start=first)


def test_a_given_start_is_in_the_units_of_the_data():
    """b of 1000 per input: the search is there at once."""
    y, u, orders, _ = record("BJ", 500, seed=25)
    first = prediction_error(1000 * y, u, orders)
    again = prediction_error(1000 * y, u, orders, start=first, discard=first.discarded[0])
    assert again.iterations <= 2


def test_a_local_optimum_beside_a_lower_end_on_the_unit_circle_is_said_to_be_local(monkeypatch):
    """One start ends at a root of C on the circle, with a lower loss; the next converges."""
    y, u, orders, _ = record("ARMAX", 300, seed=42)
    solve, calls = polynomial._minimise, []

    def first_at_the_circle(criterion, theta, solver):
        calls.append(theta)
        solution = solve(criterion, theta, solver)
        if len(calls) > 1:
            return solution
        x = np.r_[solution.x[:4], -1.0 + 1e-5, 0.0]
        return replace(solution, x=x, value=0.5 * solution.value, scaled_gradient=1.0)

    monkeypatch.setattr(polynomial, "_minimise", first_at_the_circle)
    model = prediction_error(y, u, orders)
    assert model.is_converged
    assert len(calls) == 2
    assert any("root of C of modulus 0.99999" in n and "a local one" in n for n in model.notes)


def test_the_predictor_reaches_back_over_the_product_of_its_polynomials():
    """D A y reaches nd + na, D B u reaches nd + nk + nb - 1."""
    assert Layout.of(Orders(na=1, nb=2, nk=3, nd=2), ["u"]).longest_lag == 2 + 3 + 2 - 1
    assert Layout.of(Orders(na=5, nb=2, nd=2), ["u"]).longest_lag == 2 + 5


def test_more_parameters_than_the_system_has_are_said_to_cancel():
    y, u, _, _ = record("OE", 300, seed=26, noise=0.0)
    model = oe(y, u, nb=3, nf=3)
    assert any("orders are too high" in note for note in model.notes)
    assert max(model.std_errors.values()) > 1e3 * min(
        prediction_error(y, u, Orders(nb=2, nf=2)).std_errors.values()
    )


def test_signals_with_an_offset_are_said_to_have_one():
    """The model has none; an input of ones, one coefficient, takes it."""
    y, u, _, _ = record("OE", 600, seed=27)
    assert not oe(y, u, nb=2, nf=2).notes
    lifted = y + 40.0
    assert any("y has mean" in note for note in oe(lifted, u, nb=2, nf=2, throw=False).notes)
    ones = {"u": u, "one": np.ones(600)}
    model = oe(lifted, ones, nb={"u": 2, "one": 1}, nf={"u": 2, "one": 0}, nk=1)
    assert model["b1[one]"] == pytest.approx(40.0, abs=4 * model.std_errors["b1[one]"])
    assert model["f1[u]"] == pytest.approx(-1.5, abs=4 * model.std_errors["f1[u]"])


def test_a_record_too_short_for_its_transient_is_said_to_be():
    rng = np.random.default_rng(28)
    u = coloured(rng, 1500)
    y = simulated(
        0.01 * rng.normal(size=1500), {"u": u}, B={"u": (0.0, 1.0)}, F={"u": (1.0, -0.99)}
    )
    model = oe(y[:150], u[:150], nb=1, nf=1)
    assert any(r"transient of 1/F[u]" in note and "150" in note for note in model.notes)
    assert not oe(y, u, nb=1, nf=1).notes


def test_a_reflected_polynomial_has_the_same_spectrum():
    """|1 - r/z| = |r| |1 - 1/(r* z)| on the unit circle."""
    z = np.exp(1j * np.linspace(0.1, 3.0, 7))
    for roots in ([1.5, 0.3], [1.2 * np.exp(0.5j), 1.2 * np.exp(-0.5j), -2.0], [0.5, 0.9]):
        before = np.real(np.poly(roots))
        after, out = reflected(before)
        assert np.max(np.abs(np.roots(after))) < 1
        ratio = np.abs(np.polyval(before, z)) / np.abs(np.polyval(after, z))
        assert ratio == pytest.approx(np.prod([max(abs(r), 1.0) for r in roots]), rel=1e-9)
        assert len(out) == sum(1 for r in roots if abs(r) > 1 and np.imag(r) >= 0)


# -- bad input ----------------------------------------------------------------------------------


def test_a_constant_input_is_named_with_the_direction_it_leaves_open():
    y, _, _, _ = record("ARX", 100, seed=30)
    with pytest.raises(
        IdentifiabilityError,
        match=r"excite 1 of the 2 lags that B needs: 1 u\[t-1\] - 1 u\[t-2\] = 0"
        r".*input u is constant \(2\).*richer input, or lower",
    ):
        arx(y, np.full(100, 2.0), na=1, nb=2)
    assert arx(y, np.full(100, 2.0), na=1, nb=1).n == 2  # one coefficient: an offset, and told


def test_a_sine_tells_two_coefficients_and_no_more():
    """Persistently exciting of order two (Ljung 1999, section 13.2)."""
    y, _, _, _ = record("OE", 200, seed=31)
    u = np.sin(0.3 * np.arange(200))
    oe(y, u, nb=1, nf=1, throw=False)
    with pytest.raises(IdentifiabilityError, match=r"excite 2 of the 3 lags that B and F need"):
        oe(y, u, nb=2, nf=1)


def test_two_inputs_that_are_one_cannot_be_told_apart():
    y, u, _, _ = record("ARX", 200, seed=32)
    with pytest.raises(IdentifiabilityError, match=r"1 left\[t-1\] - 0.5 right\[t-1\] = 0"):
        arx(y, {"left": u, "right": 2 * u}, na=1, nb=1)


def test_orders_too_high_for_data_without_noise_are_refused():
    y, u, _, _ = record("ARX", 200, seed=33, noise=0.0)
    refusal = "determines 5 of 6 coefficients.*Lower the orders"
    with pytest.raises(IdentifiabilityError, match=refusal):
        arx(y, u, na=3, nb=3)


def test_an_optimum_on_the_unit_circle_is_refused_with_the_polynomial():
    """An integrator with white output noise is ARMAX with A = C = 1 - q^-1."""
    rng = np.random.default_rng(34)
    u = rng.normal(size=400)
    y = 0.1 * np.r_[0.0, np.cumsum(u)[:-1]] + 0.1 * rng.normal(size=400)
    with pytest.raises(SolveError, match=r"root of C of modulus 0\.999.*unit circle.*Lower nc"):
        armax(y, u, na=1, nb=1, nc=1)
    assert not armax(y, u, na=1, nb=1, nc=1, throw=False).is_converged


BAD = [
    (dict(na=-1, nb=1), ModelError, "order na = -1: give a whole number of at least 0"),
    (dict(na=1.5, nb=1), ModelError, "order na = 1.5"),
    (dict(na=1, nb=0), ModelError, "input u has nb = 0.*leave the input out"),
    (dict(na=1, nb={"v": 1}), ModelError, "nb names v, the data have u"),
    (dict(na=1, nb=1, nk=-1), ModelError, r"order nk = -1"),
    (dict(na=1, nb=1, discard=-2), DataError, "discard = -2; give the whole number"),
    (dict(na=1, nb=1, discard=98), DataError, "2 residuals are too few for 2.*longer records"),
    (dict(na=1, nb=1, discard=100), DataError, "100 samples, but.*first 100 do not count"),
    (dict(na=1, nb=1, errors="hac"), ModelError, "errors = 'hac'; choose 'white' or 'robust'"),
    (dict(na=1, nb=1, Ts=0.0), DataError, "sample time Ts = 0.0; give"),
    (dict(na=1, nb=1, Ts="0.01"), DataError, "Ts = '0.01'; give a number of seconds above 0"),
    (dict(na=None, nb=1), ModelError, "order na = None: give a whole number of at least 0"),
    (dict(na=1, nb=1, discard="3"), DataError, "discard = '3'; give the whole number"),
    (dict(na=1, nb=1, solver=3.0), SolveError, r"a float is no solver; give Solver\('ipopt'\)"),
]


@pytest.mark.parametrize(("options", "error", "message"), BAD)
def test_impossible_requests_are_refused_with_a_mend(options, error, message):
    y, u, _, _ = record("ARX", 100, seed=35)
    with pytest.raises(error, match=message):
        arx(y, u, **options)


def test_a_record_is_refused_with_what_makes_lists_of_it():
    y, u, _, _ = record("ARX", 100, seed=36)
    held = Record({"y": y, "u": u}, {"y": "m", "u": "N"}, Ts=0.1)
    mend = (
        r"y, u = casid\.estimation\.prediction_error\.polynomial\.records\.stretches"
        r"\(record, output, inputs\)"
    )
    for given_, what in (
        (held, "a record"),
        ([held, held], "a record"),
        ([Experiment(held, {}, "first")] * 2, "a list of records"),
        (Experiment(held, {}, "first"), "a record"),
    ):
        with pytest.raises(DataError, match=f"y is {what}; give its channels.*{mend}"):
            arx(given_, na=1, nb=1)
    with pytest.raises(DataError, match=f"u is a record.*{mend}"):
        arx(y, held, na=1, nb=1)
    ys, us = stretches(held, "y", ["u"])
    model, plain = arx(ys, us, na=1, nb=1), arx(y, u, na=1, nb=1)
    np.testing.assert_array_equal(model.theta, plain.theta)
    with pytest.raises(DataError, match=mend):
        model.predict(held)
    with pytest.raises(DataError, match="y is a list that holds what is no real number; give an"):
        arx(["a", "b"], na=1)
    with pytest.raises(DataError, match="y is a NoneType that holds"):
        arx(None, na=1)
    for wrong, what in ((None, "None"), (held, "a record")):
        with pytest.raises(DataError, match=rf"u is {what}; give .* u=\{{'u': record\['u'\]\}}"):
            model.simulate(wrong)
    np.testing.assert_array_equal(model.simulate({"u": held["u"]}), model.simulate(u))
    with pytest.raises(DataError, match="u has shape"):
        model.simulate(3.0)


def test_a_solver_is_taken_by_its_name_and_a_start_that_is_none_is_refused():
    y, u, orders, _ = record("OE", 300, seed=37)
    by_name = prediction_error(y, u, orders, solver="ipopt")
    np.testing.assert_array_equal(
        by_name.theta, prediction_error(y, u, orders, solver=Solver("ipopt")).theta
    )
    with pytest.raises(ModelError, match="start is a list; give a model as prediction_error"):
        prediction_error(y, u, orders, start=[0.0])
    with pytest.raises(ModelError, match=r"orders = \(2, 2\); give Orders\(na=..,"):
        prediction_error(y, u, (2, 2))


def test_data_that_cannot_be_used_are_refused_with_place_and_mend():
    y, u, _, _ = record("ARX", 100, seed=36)
    broken = y.copy()
    broken[7] = np.nan
    with pytest.raises(DataError, match="y holds 1 samples that are not finite.* at k = 7"):
        arx(broken, u, na=1, nb=1)
    with pytest.raises(DataError, match="record 2: y holds 1.*give the parts as a list"):
        arx([y, broken], [u, u], na=1, nb=1)
    with pytest.raises(DataError, match="give u as a list of 2 entries"):
        arx([y, y], u, na=1, nb=1)
    with pytest.raises(DataError, match=r"u has shape \(99,\), y has \(100,\); cut both"):
        arx(y, u[:-1], na=1, nb=1)
    with pytest.raises(DataError, match=r"y has shape \(100, 1\); give one output"):
        arx(y[:, None], u, na=1, nb=1)
    with pytest.raises(DataError, match=r"u has shape \(2, 100\) beside 100 samples"):
        arx(y, np.stack([u, u]), na=1, nb=1)
    with pytest.raises(DataError, match="y is constant .*nothing to fit"):
        arx(np.ones(100), u, na=1, nb=1)
    with pytest.raises(DataError, match="1 residuals are too few for 5 coefficients"):
        armax(y[:3], u[:3], na=2, nb=2, nc=1)
    with pytest.raises(DataError, match="2 samples, but the predictor reaches back 2"):
        arx(y[:2], u[:2], na=2, nb=1)
    with pytest.raises(ModelError, match="every order is 0"):
        prediction_error(y, None, Orders())
    with pytest.raises(ModelError, match="without an input; give u"):
        prediction_error(y, None, Orders(na=1, nb=1))
    with pytest.raises(ModelError, match="only the product A D acts"):
        prediction_error(y, None, Orders(na=1, nd=1))
    model = arx(y, u, na=1, nb=1)
    with pytest.raises(DataError, match="inputs are wind, the model has u"):
        model.predict(y, {"wind": u})
    with pytest.raises(ModelError, match="no input to simulate from"):
        prediction_error(y, None, Orders(na=1)).simulate(u)
