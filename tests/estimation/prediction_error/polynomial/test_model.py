"""What an estimated polynomial model can do, and what it notes of its data."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from casid.estimation.covariance import whiteness
from casid.estimation.prediction_error.polynomial.estimation import (
    Orders,
    arx,
    oe,
    prediction_error,
)
from casid.estimation.prediction_error.polynomial.misfit import residual_input_correlation
from casid.estimation.prediction_error.polynomial.orders import Layout, reflected
from tests.support.polynomial_systems import STRUCTURES, coloured, record
from tests.support.recursion import predicted_errors, simulated


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
