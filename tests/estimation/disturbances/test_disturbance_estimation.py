"""The spectrum of a force that nobody recorded, from the residual that it leaves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import rfft
from scipy.linalg import expm
from scipy.signal import lfilter

import casid
from casid.estimation.disturbances.disturbance_estimation import FINER, with_disturbance_spectra
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum
from casid.estimation.noise.forces import places_of_forces
from casid.estimation.noise.variances import estimate_noise
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.rate_laws import with_balances

TS, N = 0.1, 4000
SD = {"position": 0.001, "speed": 0.002}
OMEGA = np.linspace(0.0, np.pi, 4001)


@pytest.mark.parametrize(
    "spectrum",
    [
        DisturbanceSpectrum(2.0),
        DisturbanceSpectrum(2.0, 0.3),
        DisturbanceSpectrum(2.0, 0.1, is_band=True),
    ],
)
def test_a_spectrum_has_unit_variance_and_its_peak_where_it_says(spectrum):
    s = spectrum.at(OMEGA, TS)
    assert np.mean(s) == pytest.approx(1.0, rel=1e-12)
    top = OMEGA[np.argmax(s)] / TS
    if spectrum.damping is None:
        assert top == 0.0
    else:
        peak = 2.0 if spectrum.is_band else 2.0 * np.sqrt(1 - 2 * spectrum.damping**2)
        assert top == pytest.approx(peak, abs=0.02)


def oscillator() -> casid.Model:
    m = casid.Model("oscillator")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    k, d = m.parameter("k", "1/s^2", start=4.0), m.parameter("d", "1/s", start=0.3)
    m.derivative(x, v)
    m.balance(v, "force", inertia=1, terms=[-k * x, -d * v], unit="m/s^2")
    m.output("position", x, "m")
    m.output("speed", v, "m/s")
    return m


def noise_under(force: np.ndarray, rng: np.random.Generator, missing: float = 0.0, enters: int = 1):
    """White and coloured noise of a record whose only cause is `force`, held between its samples.

    Those of the force may be some times as many as those of the record.

    `missing` is the share of samples of the speed that there are not; the force enters the rate of
    the state `enters`.
    """
    a = np.zeros((3, 3))
    a[:2, :2] = [[0.0, 1.0], [-4.0, -0.3]]
    a[enters, 2] = 1.0
    per = len(force) // N
    step = expm(a * TS / per)
    x = np.zeros((per * N + 1, 2))
    x[0] = 0.5, 0.0
    for i in range(per * N):
        x[i + 1] = step[:2, :2] @ x[i] + step[:2, 2] * force[i]
    y = x[: per * N : per] + rng.standard_normal((N, 2)) * list(SD.values())
    channels = dict(zip(SD, y.T, strict=True))
    record = casid.Record(channels, {"position": "m", "speed": "m/s"}, Ts=TS)
    if missing:
        record = record.mark_missing("speed", rng.random(N) < missing)
    fit = fit_model(oscillator(), [casid.Experiment(record, {}, "r")], FitSettings(starts=1))
    white = estimate_noise(fit.criterion, fit.x)
    return fit, white, with_disturbance_spectra(white, fit.criterion, fit.x)


def test_a_first_order_force_is_found_with_its_corner_and_the_sensors_keep_their_noise():
    rng = np.random.default_rng(1)
    a = np.exp(-0.8 * TS)  # corner 0.8 rad/s
    force = lfilter([1.0], [1.0, -a], 0.05 * np.sqrt(1 - a * a) * rng.standard_normal(N))
    _, _, noise = noise_under(force, rng)
    spectrum = noise.spectra["force"]
    # T / (2 time constants) = 160 independent pieces.
    assert noise.source_sd["force"] == pytest.approx(0.05, rel=4 / np.sqrt(2 * 160))
    low = DisturbanceSpectrum(0.8).at(OMEGA, TS)
    assert np.mean(abs(spectrum.at(OMEGA, TS) - low)) < 4 / np.sqrt(160)
    for sd, true in zip(noise.output_sd, SD.values(), strict=True):
        assert sd == pytest.approx(true, rel=4 / np.sqrt(2 * N) + 0.03)


def test_the_ground_that_moves_enters_the_stated_rate_of_a_travel_and_no_balance():
    """x' = v - (the ground's speed): a force in the balance moves both outputs in proportion."""
    rng = np.random.default_rng(4)
    a = np.exp(-0.8 * TS / 5)
    ground = lfilter([1.0], [1.0, -a], 0.05 * np.sqrt(1 - a * a) * rng.standard_normal(5 * N))
    _, white, noise = noise_under(ground, rng, enters=0)
    assert set(noise.spectra) == {"x"}
    assert white.source_sd["x"] == 0.0  # white in a rate is a random walk: any slow error is one
    assert noise.source_sd["x"] == pytest.approx(0.05, rel=4 / np.sqrt(2 * 160))
    assert noise.source_sd["force"] < 0.1 * 0.05 * 2.0  # what moves as much, at the resonance
    assert noise.output_sd[0] == pytest.approx(SD["position"], rel=0.15)  # beside its last decades
    assert noise.output_sd[1] == pytest.approx(SD["speed"], rel=4 / np.sqrt(2 * N) + 0.03)


def test_a_stated_rate_has_a_force_only_where_outputs_are_more_than_balances():
    model = oscillator()
    assert places_of_forces(model) == ("force", "x")
    del model.outputs["speed"]
    assert places_of_forces(model) == ("force",)


@pytest.mark.parametrize(
    "spectrum", [DisturbanceSpectrum(2.0), DisturbanceSpectrum(2.0, 0.1, is_band=True)]
)
def test_a_force_is_drawn_with_its_spectrum(spectrum):
    """A mean of 40 periodograms in bands of 40 lines, each exponential about the spectrum."""
    rng = np.random.default_rng(5)
    n, window = 3200, np.hanning(3200)
    power = np.mean(
        [
            abs(rfft(spectrum.draw(n, TS, rng) * window)[1:1601]) ** 2 / np.sum(window**2)
            for _ in range(40)
        ],
        axis=0,
    )
    expected = spectrum.at(np.linspace(0.0, np.pi, 1601), TS)[1:]
    ratio = np.sum(power.reshape(-1, 40), axis=1) / np.sum(expected.reshape(-1, 40), axis=1)
    # Hann's lines are correlated, and a band's power may lie in a few of them.
    assert ratio == pytest.approx(1.0, abs=5 * np.sqrt(2.0 / (40 * 10)))
    assert np.mean(power) == pytest.approx(1.0, abs=5 * np.sqrt(2.0 / (40 * 10)))


@pytest.mark.parametrize("missing", [pytest.param(0.02, marks=pytest.mark.slow), 0.3])
def test_missing_samples_lend_no_part_of_a_slow_force_to_a_quiet_sensor(missing: float):
    """Through gaps it leaks over all frequencies, some hundred times the sensor's variance."""
    rng = np.random.default_rng(1)
    a = np.exp(-0.8 * TS)
    force = lfilter([1.0], [1.0, -a], np.sqrt(1 - a * a) * rng.standard_normal(N))
    _, _, whole = noise_under(force, np.random.default_rng(1))
    fit, _, noise = noise_under(force, np.random.default_rng(1), missing)
    left = np.nanstd(fit.criterion.simulated(fit.x, 0).residual[:, 1])
    assert missing * left**2 > 20 * whole.output_sd[1] ** 2
    count = (1 - missing) * N
    assert noise.output_sd[1] == pytest.approx(whole.output_sd[1], rel=4 / np.sqrt(2 * count))


def test_white_noise_gets_no_spectrum_of_its_own():
    rng = np.random.default_rng(2)
    _, _, noise = noise_under(0.05 * rng.standard_normal(N), rng)
    assert noise.spectra == {}


def test_outputs_that_one_force_moves_are_whitened_together():
    """To white noise of unit size, and of no correlation from one output to the other."""
    rng = np.random.default_rng(3)
    a = np.exp(-0.8 * TS)
    force = lfilter([1.0], [1.0, -a], 0.05 * np.sqrt(1 - a * a) * rng.standard_normal(N))
    fit, _, noise = noise_under(force, rng)
    residual = fit.criterion.simulated(fit.x, 0).residual * fit.criterion.weights
    e = noise.whiten(residual[:, :, None], 0)[:, :, 0]
    assert e.T @ e / N == pytest.approx(np.eye(2), abs=5 / np.sqrt(N))
    marginal = residual / residual.std(axis=0)
    assert abs(marginal[:-1].T @ marginal[1:] / N).max() > 0.5


def tank_under(seed: int, known: dict[str, float] | None = None):
    """A level whose output has the name of its state, under a flow of first order (0.1 rad/s)."""
    n, per, tau = 1500, 5, 8.0
    rng = np.random.default_rng(seed)
    a = np.exp(-0.1 / per)
    w = lfilter([1.0], [1.0, -a], 0.02 * np.sqrt(1 - a * a) * rng.standard_normal(n * per))
    h = lfilter([1.0 / per], [1.0, -(1.0 - 1.0 / (tau * per))], w)[::per]
    m = casid.Model("tank")
    level, T = m.state("level", "m"), m.parameter("T", "s", start=8.0, lower=1.0, upper=100.0)
    m.derivative(level, -level / T)
    m.output("level", level, "m")
    y = 1.0 * np.exp(-np.arange(n) / tau) + h + 0.005 * rng.standard_normal(n)
    record = casid.Record({"level": y}, {"level": "m"}, Ts=1.0)
    fit = fit_model(with_balances(m), [casid.Experiment(record, {}, "r")], FitSettings(starts=1))
    white = estimate_noise(fit.criterion, fit.x, known=known)
    return white, with_disturbance_spectra(white, fit.criterion, fit.x, known)


def test_an_output_by_the_name_of_its_balance_keeps_its_noise_apart_from_the_force():
    """The spectrum is that of the force; the sensor stays white."""
    white, noise = tank_under(2)
    assert noise.output_sd[0] == pytest.approx(0.005, rel=0.25)  # seen above the corner alone
    assert noise.source_sd["level"] == pytest.approx(0.02, rel=4 / np.sqrt(150))
    assert 0.05 < noise.spectra["level"].frequency < 0.2
    errors = {key for key, _ in white.covariance}
    assert ("source", "level") in errors
    assert white.variance_error("level") > 0.0


def test_known_noise_of_an_output_is_not_that_of_the_force_by_its_name():
    white, noise = tank_under(2, {"level": 0.005})
    assert white.output_sd[0] == noise.output_sd[0] == pytest.approx(0.005, rel=1e-9)
    assert white.source_sd["level"] > 0.02  # white, it has to be the larger
    assert noise.source_sd["level"] == pytest.approx(0.02, rel=4 / np.sqrt(150))


def motor_under(seed: int, *, is_simple: bool = False):
    """A speed with a gain, a time constant (20 s) and an offset, fitted by least squares.

    Under a disturbance of 60 s; the record is 15 time constants long.
    """
    n, per, tau = 300, 5, 20.0
    rng = np.random.default_rng(seed)
    a = np.exp(-1 / (60.0 * per))
    e = rng.standard_normal(n * per)
    e[0] /= np.sqrt(1 - a * a)
    force = lfilter([0.02 * np.sqrt(1 - a * a)], [1.0, -a], e)
    u = np.repeat(rng.uniform(-1, 1, n // 25 + 1), 25)[:n]
    drive = np.repeat(u, per) * 0.05 + force
    speed = lfilter([1 / per], [1.0, -(1 - 1 / (tau * per))], drive)
    y = np.r_[0.0, speed[:-1]][::per] + 0.01 * rng.standard_normal(n)
    m = casid.Model("motor")
    v, U = m.state("speed", "m/s"), m.input("U", "V", hold="zoh")
    K = m.parameter("K", "m/(s V)", start=1.0, lower=0.01)
    T = m.parameter("T", "s", start=15.0, lower=1.0, upper=200.0)
    v0 = m.parameter("v0", "m/s", start=0.0)
    m.derivative(v, (K * U + v0 - v) / T)
    m.output("speed", v, "m/s")
    record = casid.Record({"speed": y, "U": u}, {"speed": "m/s", "U": "V"}, Ts=1.0)
    fit = fit_model(with_balances(m), [casid.Experiment(record, {}, "r")], FitSettings(starts=1))
    white = estimate_noise(fit.criterion, fit.x)
    return with_disturbance_spectra(white, fit.criterion, fit.x, is_simple=is_simple)


@pytest.mark.parametrize("seed", [8, 13])
def test_what_a_fit_took_out_of_a_residual_speaks_for_no_band(seed: int):
    """Least squares leaves no power at the lowest frequencies; a force without any is none here."""
    noise = motor_under(seed)
    assert not noise.spectra["speed"].is_band
    assert noise.source_sd["speed"] > 0.0


def test_a_force_slower_than_a_quarter_of_the_record_is_found_as_slow():
    found = motor_under(3).spectra["speed"]
    assert found.damping is None
    assert found.frequency < 2 * np.pi * 2 / 300  # half of the record; the true one is 0.8 of it


def test_a_simple_spectrum_has_no_peak():
    """Where the likelihood of this short record prefers one by chance."""
    assert motor_under(1).spectra["speed"].damping is not None
    assert motor_under(1, is_simple=True).spectra["speed"].damping is None


@pytest.mark.parametrize("near", [DisturbanceSpectrum(0.5), DisturbanceSpectrum(1.4)])
def test_a_spectrum_close_by_is_adjusted_to_the_one_that_a_whole_search_finds(near):
    rng = np.random.default_rng(1)
    a = np.exp(-0.8 * TS)
    force = lfilter([1.0], [1.0, -a], 0.05 * np.sqrt(1 - a * a) * rng.standard_normal(N))
    fit, white, whole = noise_under(force, rng)
    adjusted = with_disturbance_spectra(white, fit.criterion, fit.x, near={"force": near})
    assert adjusted.spectra["force"].frequency == pytest.approx(
        whole.spectra["force"].frequency, rel=FINER[-1]
    )
    assert adjusted.source_sd["force"] == pytest.approx(whole.source_sd["force"], rel=FINER[-1])


def test_a_spectrum_close_by_is_dropped_where_white_noise_is_as_likely():
    rng = np.random.default_rng(2)
    fit, white, whole = noise_under(np.zeros(N), rng)
    near = {"force": DisturbanceSpectrum(0.8)}
    assert not whole.spectra
    assert not with_disturbance_spectra(white, fit.criterion, fit.x, near=near).spectra


@pytest.mark.parametrize(("width", "is_random"), [(0.0, False), (0.3, True)])
def test_a_band_is_wider_than_a_line(width: float, is_random: bool):
    """A line is 1.44/T wide under Hann's window; 0.3 rad/s are 19 times as much in these 400 s."""
    rng = np.random.default_rng(4)
    if is_random:
        r, w = np.exp(-0.5 * width * TS), 3.0 * TS
        force = lfilter([1.0], [1.0, -2 * r * np.cos(w), r * r], rng.standard_normal(N))
        force *= 0.05 / np.std(force)
    else:
        force = 0.05 * np.sqrt(2) * np.sin(3.0 * TS * np.arange(N))
    _, _, found = noise_under(force, rng)
    peaks = [s for s in found.spectra.values() if s.damping is not None]
    assert bool(peaks) == is_random
