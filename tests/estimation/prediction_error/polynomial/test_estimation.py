"""ARX, ARMAX, OE and BJ by prediction error: consistent where theory says so, biased where not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scipy.stats import chi2

from casid.data.record import Record
from casid.errors import DataError, SolveError
from casid.estimation.prediction_error.polynomial.estimation import (
    Orders,
    armax,
    arx,
    bj,
    oe,
    prediction_error,
)
from casid.estimation.prediction_error.polynomial.records import stretches
from tests.support.polynomial_systems import STRUCTURES, A, D, coloured, record
from tests.support.recursion import simulated


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
