"""The criterion of polynomial models, held against independent implementations."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from casid.estimation.nlp.solver import Solver
from casid.estimation.prediction_error.polynomial.criterion import PredictionErrors
from casid.estimation.prediction_error.polynomial.estimation import (
    Orders,
    arx,
    bj,
    prediction_error,
)
from casid.estimation.prediction_error.polynomial.orders import Layout
from tests.support.polynomial_systems import STRUCTURES, B, D, coloured, record
from tests.support.recursion import predicted_errors, simulated


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
