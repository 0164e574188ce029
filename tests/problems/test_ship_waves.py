"""Waves, wind and current are what their spectra say, at rest and under way."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.stats import chi2

from casid.errors import DataError, SolveError
from problems.ship_4dof import Ship, simulate
from problems.ship_simulator.waves import (
    Current,
    Encounter,
    G,
    Jonswap,
    PiersonMoskowitz,
    Sea,
    ShapingFilter,
    TabulatedSpectrum,
    WaveLoads,
    Wind,
    fit_shaping_filter,
    gauss_markov,
    require_unfolded,
    sample_sea,
    variance,
)

BAND = (0.05, 40.0)
MODEL = Jonswap(0.0125, 5.9)  # 0.3 m and 1.2 rad/s at 1:24


def m0(spectrum) -> float:
    """int S dw, by scipy, split where JONSWAP has its edge."""
    parts = ((1e-3, 0.4), (0.4, 0.8), (0.8, 4.0), (4.0, math.inf))
    return sum(quad(lambda w: float(spectrum(np.array(w))), *p, limit=200)[0] for p in parts)


# -- spectra -------------------------------------------------------------------------------------


def test_jonswap_has_its_published_peak_and_height():
    """S(w0) = 0.2 exp(-1.25) gamma Hs^2/w0 = 0.4727 and 4 sqrt(m0) = 0.988 Hs (A.26)."""
    S = Jonswap(1.0, 0.4, 3.3)
    assert float(S(np.array(0.4))) == pytest.approx(0.4727, abs=5e-5)
    assert float(S(np.array(0.4))) == pytest.approx(0.2 * math.exp(-1.25) * 3.3 / 0.4, rel=1e-14)
    assert 4 * math.sqrt(m0(S)) == pytest.approx(0.988, abs=5e-4)
    assert variance(S, BAND) == pytest.approx(m0(S), rel=1e-5)


def test_without_a_peak_jonswap_has_four_fifths_of_the_height():
    """int 0.2 w0^4 w^-5 exp(-1.25 (w0/w)^4) dw = 0.2/5."""
    assert 4 * math.sqrt(m0(Jonswap(1.0, 0.4, 1.0))) == pytest.approx(0.8, rel=1e-8)


def test_pierson_moskowitz_has_the_height_and_the_peak_it_is_given():
    S = PiersonMoskowitz(2.0, 0.4)
    assert 4 * math.sqrt(m0(S)) == pytest.approx(2.0, rel=1e-8)
    w = np.linspace(0.3, 0.5, 20_001)
    assert w[np.argmax(S(w))] == pytest.approx(0.4, abs=1e-5)
    assert float(S(np.array(0.0))) == 0.0


def test_a_spectrum_with_negative_energy_is_refused():
    w = np.linspace(0.1, 2.0, 20)
    S = np.ones(20)
    S[[4, 7]] = -0.1
    message = r"negative at 2 of 20 frequencies, S = -0.1 .* at w = 0.5 rad/s.*to zero"
    with pytest.raises(DataError, match=message):
        TabulatedSpectrum(w, S)
    with pytest.raises(DataError, match=r"negative at \d+ of .*Correct the table"):
        sample_sea(lambda w: 1.0 - w, (0.1, 2.0), seed=1)
    with pytest.raises(DataError, match="not finite"):
        TabulatedSpectrum(w, np.full(20, np.nan))
    with pytest.raises(DataError, match="Sort them"):
        TabulatedSpectrum(w[::-1], np.ones(20))
    with pytest.raises(DataError, match="Hs = -1.0. Give a positive number"):
        Jonswap(-1.0, 0.4)


# -- sampling ------------------------------------------------------------------------------------


def test_a_sampled_sea_has_the_variance_of_its_spectrum():
    """Places at random in n cells: the error of the sum is of the order 1/n^(3/2)."""
    sea = sample_sea(MODEL, (2.0, 40.0), seed=1)
    assert sea.variance == pytest.approx(variance(MODEL, (2.0, 40.0)), rel=0.02)
    t = 0.02 * np.arange(100_000)
    assert sea.elevation(t).var() == pytest.approx(sea.variance, rel=0.02)


def test_the_elevation_is_the_sum_of_its_waves():
    """Whatever the blocks it is computed in."""
    sea = sample_sea(MODEL, (2.0, 30.0), seed=2, n=7, U=1.0, beta=2.0)
    t = 5.0 + 0.05 * np.arange(5000)
    theta = np.outer(t, sea.w - sea.w**2 * math.cos(2.0) / G) + sea.phase
    np.testing.assert_allclose(sea.elevation(t), np.cos(theta) @ sea.amplitude, rtol=0, atol=1e-11)
    kappa = sea.w**2 / G
    np.testing.assert_allclose(
        sea.slope(t, 0.1),
        np.sin(theta) @ (sea.amplitude * kappa * np.exp(-0.1 * kappa)),
        atol=1e-11,
    )


@pytest.mark.slow
def test_the_spectrum_of_the_elevation_lies_in_its_confidence_band():
    """Windowed periodograms of K Gaussian seas: K I/E(I) is chi2_2K/2 at each frequency.

    E(I) is the spectrum seen through the window, int S(v) |W(w - v)|^2 dv/2. The 19 frequencies are
    farther apart than the window is wide, so independent: 99.9 % for all together.
    """
    K, N, Ts = 60, 2048, 0.1
    t, window = Ts * np.arange(N), np.hanning(N)
    w = np.arange(3.0, 12.5, 0.5)  # 16 cells of 2 pi/(N Ts) apart; Hann's main lobe is 4 wide
    E = window[:, None] * np.exp(-1j * np.outer(t, w))
    power = np.zeros(w.size)
    for seed in range(K):
        sea = sample_sea(MODEL, (2.0, 14.0), seed=seed, n=1500, gaussian=True)
        power += np.abs(sea.elevation(t) @ E) ** 2
    fine, dw = np.linspace(2.0, 14.0, 6001, retstep=True)
    # |DFT of the window| at every difference of frequency; one-sided density, half of it at +w
    seen = np.empty(w.size)
    differences = np.arange(0.0, 12.0 + dw / 2, dw)
    W2 = np.array([np.abs(window @ np.exp(1j * d * t)) ** 2 for d in differences[:200]])
    for i, at in enumerate(w):
        near = np.abs(fine - at) < 199 * dw
        distance = np.rint(np.abs(fine[near] - at) / dw).astype(int)
        seen[i] = np.sum(MODEL(fine[near]) * W2[distance]) * dw / 2
    ratio = power / (K * seen)
    level = 1e-3 / w.size
    low, high = chi2.ppf([level / 2, 1 - level / 2], 2 * K) / (2 * K)
    assert low < ratio.min()
    assert ratio.max() < high
    assert high < 1.8  # the band says something


# -- encounter -----------------------------------------------------------------------------------


@pytest.mark.parametrize("beta", [math.pi, 2.2, math.pi / 2], ids=["head", "bow", "beam"])
def test_the_spectrum_of_encounter_conserves_variance_in_head_seas(beta):
    S = Jonswap(1.0, 0.8)
    met = Encounter(S, 8.0, beta)
    parts = [met.a * -(w**2) + w for w in (0.1, 0.8, 1.6, 40.0)]
    total = sum(
        quad(lambda w: float(met(np.array(w))), *p, limit=400)[0]
        for p in zip(parts, parts[1:], strict=False)
    )
    assert total == pytest.approx(variance(S, (0.1, 40.0)), rel=1e-5)


@pytest.mark.parametrize("beta", [0.0, 0.8], ids=["following", "quartering"])
def test_a_folded_spectrum_conserves_variance_when_it_is_split(beta):
    """All three branches; the pole at w_e = 1/(4 a) is integrable, so quadrature ends there."""
    S = Jonswap(1.0, 0.8)
    met = Encounter(S, 8.0, beta, folded="split")
    top = met.highest
    assert 0.3 < top < 0.5
    # the pole is of order -1/2: w_e = top (1 - x^2) takes it away
    below = quad(lambda x: 2 * x * top * float(met(np.array(top * (1 - x**2)))), 0, 1, limit=800)[0]
    above = quad(lambda w: float(met(np.array(w))), top, 3 * top, limit=400)[0]
    above += quad(lambda w: float(met(np.array(w))), 3 * top, 60.0**2, limit=800)[0]
    assert below + above == pytest.approx(variance(S, (0.05, 60.0)), rel=1e-4)


def test_the_branches_are_the_frequencies_that_are_met_alike():
    met = Encounter(Jonswap(1.0, 0.8), 8.0, 0.3, folded="split")
    for w_e in (0.1, 0.25):
        for w, jacobian in met.branches(np.array(w_e)):
            assert abs(w - met.a * w**2) == pytest.approx(w_e, rel=1e-12)
            assert 1 / jacobian == pytest.approx(abs(1 - 2 * met.a * w), rel=1e-12)
    slow, mid, fast = met.branches(np.array(2.0))
    assert math.isnan(slow[0])
    assert math.isnan(mid[0])
    assert fast[0] > 1 / met.a


def test_a_course_that_folds_the_spectrum_is_refused_with_what_to_do():
    S = Jonswap(1.0, 0.8)
    with pytest.raises(SolveError, match=r"beta = 20.0 deg.*folds.*w = 0.653") as refusal:
        Encounter(S, 8.0, math.radians(20.0))
    for mend in ("folded='split'", "Sea", "lower speed", "another course"):
        assert mend in str(refusal.value)
    require_unfolded(S, 8.0, math.radians(90.0))
    require_unfolded(S, 8.0, math.radians(160.0))
    require_unfolded(S, 0.5, 0.0)  # w = 9.8 rad/s: 1e-5 of the variance lies beyond


def test_a_sea_under_way_has_the_spectrum_of_encounter():
    """Sum over waves whose |w_e| falls in a bin, against int S_e dw_e: folded or not.

    A bin at the edge of which a wave stands holds it or not: errors up to a_i^2/2 at each of its
    up to six edges in w.
    """
    S = Jonswap(1.0, 0.8)
    for U, beta in ((8.0, math.pi), (8.0, 0.4)):
        sea = sample_sea(S, (0.2, 8.0), seed=3, n=40_000, U=U, beta=beta)
        met = Encounter(S, U, beta, folded="split")
        edges = np.array([0.15, 0.25, 0.3, 0.5, 0.9, 1.4])
        for low, high in zip(edges, edges[1:], strict=False):
            inside = (np.abs(sea.w_e) >= low) & (np.abs(sea.w_e) < high)
            share = np.sum(sea.amplitude[inside] ** 2) / 2
            points = [met.highest] if low < met.highest < high else None
            expected = quad(
                lambda w, met=met: float(met(np.array(w))), low, high, points=points, limit=400
            )[0]
            atol = 6 * sea.amplitude.max() ** 2 / 2
            assert share == pytest.approx(expected, rel=2e-3, abs=atol), (U, beta, low)


# -- the shaping filter --------------------------------------------------------------------------


def test_the_shaping_filter_has_its_published_peak_and_variance():
    """|V(j wa)|^2 = (K0/(2 zeta wa))^2 and int |V|^2 = pi K0^2/(4 zeta wa) (A.27)."""
    V = ShapingFilter(0.3, 0.1, 0.8)
    assert float(V(np.array(0.8))) == pytest.approx((0.3 / 0.16) ** 2, rel=1e-14)
    parts = ((0.0, 0.8), (0.8, 3.0), (3.0, math.inf))
    total = sum(quad(lambda w: float(V(np.array(w))), *p, limit=200)[0] for p in parts)
    assert V.variance == pytest.approx(total, rel=1e-8)


def test_the_fitted_filter_is_the_nearest_of_its_variance():
    """Against scipy's simplex search; and a filter's own spectrum gives that filter again."""
    S, band = Jonswap(1.0, 0.8), (0.2, 4.0)
    found = fit_shaping_filter(S, band)
    assert found.variance == pytest.approx(variance(S, band), rel=1e-5)
    w = np.geomspace(*band, 4001)
    dw = np.gradient(w)

    def cost(theta):
        zeta, wa = np.exp(theta)
        K0 = math.sqrt(4 * zeta * wa * found.variance / math.pi)
        return float(np.sum((ShapingFilter(K0, zeta, wa)(w) - S(w)) ** 2 * dw))

    best = minimize(cost, np.log([0.2, 0.7]), method="Nelder-Mead", options={"xatol": 1e-8})
    np.testing.assert_allclose([found.zeta, found.wa], np.exp(best.x), rtol=1e-3)
    assert 0.78 < found.wa < 0.86
    V = ShapingFilter(0.3, 0.1, 0.8)
    wide = (1e-4, 1e4)
    again = fit_shaping_filter(V, wide, n=20_000)
    np.testing.assert_allclose([again.K0, again.zeta, again.wa], [0.3, 0.1, 0.8], rtol=2e-3)
    with pytest.raises(SolveError, match="Widen the band"):
        fit_shaping_filter(lambda w: 0.0 * w, band)


@pytest.mark.parametrize("zeta", [0.1, 2.0])
def test_the_filter_makes_a_process_with_its_spectrum(zeta):
    """Its covariance at lag tau is int |V|^2 cos(w tau) dw, here over 2000 independent records.

    A sample variance of 2000 has the relative deviation (2/2000)^(1/2); four of them are allowed.
    """
    V, Ts, lag = ShapingFilter(0.3, zeta, 0.8), 0.5, 3
    rng = np.random.default_rng(4)
    starts = np.array([V.simulate(lag + 1, Ts, rng)[[0, lag]] for _ in range(2000)])
    w = np.linspace(1e-4, 400.0, 800_001)
    expected = float(np.sum(V(w) * np.cos(w * lag * Ts)) * (w[1] - w[0]))
    deviation = 4 * math.sqrt(2 / 2000)
    assert np.mean(starts**2, axis=0) == pytest.approx(np.full(2, V.variance), rel=deviation)
    covariance = float(np.mean(starts[:, 0] * starts[:, 1]))
    assert covariance == pytest.approx(expected, abs=deviation * V.variance)


# -- forces --------------------------------------------------------------------------------------


def one_wave(beta: float, w: float = 4.0, U: float = 0.0) -> Sea:
    return Sea(np.array([w]), np.array([0.01]), np.array([0.3]), U, beta)


def test_long_beam_waves_lay_the_ship_as_the_surface():
    """K = -(k + S g) slope sin(beta): the roll follows the surface where the wave is slow."""
    t = 0.05 * np.arange(2000)
    sea = one_wave(math.pi / 2, w=0.5)
    forces = sea.forces(t, WaveLoads(c_K=10.38 - 22.04 * 0.028 * 9.82, depth=0.0), drift=False)
    forces[:, [0, 1, 3]] = 0.0  # the torque alone
    ramp = np.minimum(t / 20.0, 1.0)[:, None]
    phi = simulate(np.zeros(2000), forces=forces * ramp, Ts=0.05, substeps=4)["phi"]
    # (w/5.3)^2 = 1 % dynamic amplification, and what sway and damping add
    late = t > 60.0
    slope = sea.slope(t)
    assert np.abs(phi[late] + slope[late]).max() < 0.06 * np.abs(slope).max()


def test_the_sea_pushes_down_the_slope():
    """A wave that runs to starboard, where the surface rises to starboard, pushes to port."""
    t = 0.01 * np.arange(400)
    forces = one_wave(math.pi / 2).forces(t, drift=False)
    slope = one_wave(math.pi / 2).slope(t)
    assert np.all(forces[:, 1] * slope <= 0.0)
    np.testing.assert_allclose(forces[:, 0], 0.0, atol=1e-13)
    # elevation at y is cos(w t - kappa y + eps): its slope in y at 0 is +kappa sin
    kappa, h = 16.0 / G, 1e-6
    rise = (np.cos(4 * t - kappa * h + 0.3) - np.cos(4 * t + kappa * h + 0.3)) * 0.01 / (2 * h)
    np.testing.assert_allclose(slope, rise, atol=1e-9)


def test_slow_drift_has_the_difference_frequencies_and_its_mean():
    """Two waves: D (a1^2 + a2^2 + 2 a1 a2 cos((w1 - w2) t + eps1 - eps2)) (Newman)."""
    sea = Sea(np.array([4.0, 4.5]), np.array([0.01, 0.02]), np.array([0.3, 1.0]), 0.0, 2.0)
    t = 0.1 * np.arange(1000)
    loads = WaveLoads(D_X=100.0, D_Y=300.0, D_N=40.0)
    drift = sea.forces(t, loads) - sea.forces(t, loads, drift=False)
    envelope = 1e-4 + 4e-4 + 4e-4 * np.cos(-0.5 * t - 0.7)
    for i, D in ((0, 100 * math.cos(2.0)), (1, 300 * math.sin(2.0)), (3, 40 * math.sin(4.0))):
        np.testing.assert_allclose(drift[:, i], D * envelope, rtol=1e-9)
    np.testing.assert_array_equal(drift[:, 2], 0.0)


def test_the_drift_slows_the_ship_and_the_waves_roll_it():
    sea = sample_sea(MODEL, (2.0, 20.0), seed=5, U=1.0, beta=math.radians(120))
    t = 0.02 * np.arange(1500)
    motion = simulate(np.zeros(1500), forces=sea.forces(t), substeps=2)
    assert 0.005 < motion["phi"].std() < 0.2
    assert motion["u"][-1] < 1.0


def test_times_that_are_not_uniform_are_refused():
    with pytest.raises(DataError, match="not uniform"):
        one_wave(0.0).elevation(np.array([0.0, 0.1, 0.3, 0.4]))


# -- wind and current ----------------------------------------------------------------------------


def test_gusts_have_the_variance_and_the_memory_they_are_given():
    """First order: covariance s^2 exp(-tau/T). N Ts/(2 T) = 10 000 independent samples."""
    x = gauss_markov(200_000, 0.1, deviation=2.0, time_constant=1.0, rng=np.random.default_rng(6))
    four = 4 * math.sqrt(2 / 10_000)
    assert x.var() == pytest.approx(4.0, rel=four)
    assert np.mean(x[:-10] * x[10:]) == pytest.approx(4.0 * math.exp(-1.0), abs=4.0 * four)


def test_a_beam_wind_heels_the_ship_to_leeward():
    wind = Wind(speed=3.0, beta=math.pi / 2)  # from port
    forces = wind.forces(2000, 0.02, U=1.0, seed=1)
    assert forces[0, 1] > 0.0
    assert forces[0, 0] < 0.0  # the ship's own way is against it
    assert forces[0, 2] == pytest.approx(0.1 * forces[0, 1])
    forces[:, [0, 1, 3]] = 0.0
    phi = simulate(np.zeros(2000), forces=forces, substeps=2)["phi"]
    body = Ship()
    assert body.restoring(float(phi[-1])) == pytest.approx(forces[0, 2], rel=1e-3)


def test_the_winds_forces_are_those_of_its_relative_speed():
    """4 m/s towards 120 deg at 1 m/s of way: V_x = -3, V_y = 12^(1/2), |V_r| = 21^(1/2)."""
    w = Wind(speed=4.0, beta=math.radians(120.0))
    q, V_x, V_y, V_r = 1.225 / 2, -3.0, math.sqrt(12.0), math.sqrt(21.0)
    Y = q * w.C_Y * w.A_L * V_y * V_r
    N = q * w.C_N * w.A_L * w.L * math.sin(2 * math.atan2(V_y, V_x)) * V_r**2
    expected = [q * w.C_X * w.A_F * V_x * V_r, Y, w.height * Y, N]
    np.testing.assert_allclose(w.forces(3, 0.1, U=1.0, seed=1), np.tile(expected, (3, 1)))


def test_wind_from_astern_at_the_ships_speed_is_not_felt():
    np.testing.assert_allclose(
        Wind(speed=1.0, beta=0.0).forces(5, 0.1, U=1.0, seed=1), 0.0, atol=1e-15
    )


def test_a_current_has_its_mean_and_its_course():
    velocity = Current(0.3, math.pi / 2).velocity(10, 0.1, seed=1)
    np.testing.assert_allclose(velocity, np.tile([0.0, 0.3], (10, 1)), atol=1e-15)
    changing = Current(0.3, 0.0, deviation=0.1, time_constant=1.0).velocity(50_000, 0.1, seed=1)
    np.testing.assert_allclose(changing.std(axis=0), 0.1, rtol=0.1)
