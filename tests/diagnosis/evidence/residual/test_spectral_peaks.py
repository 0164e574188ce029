"""Lines in a residual's spectrum: the false alarms are as many as said, the frequency is found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter
from scipy.stats import binom

import casid
from casid.diagnosis.evidence.residual.spectral_peaks import (
    find_peaks,
    peaks_of,
    periodic_candidates,
    tail,
)
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.estimation.simulation.fit import FitSettings, fit_model
from problems import pendulum
from tests.support import truth

Ts = 0.02


def coloured(rng: np.random.Generator, N: int, pole: float) -> np.ndarray:
    return lfilter([1.0], [1.0, -pole], rng.standard_normal(N + 200))[200:, None]


@pytest.mark.parametrize(
    ("pole", "seed"), [(0.0, 1), pytest.param(0.5, 2, marks=pytest.mark.slow), (0.8, 3)]
)
def test_false_alarms_are_as_frequent_as_their_p_value_says(pole: float, seed: int):
    """White noise and first-order colour: counts inside 99.9 % of a binomial, either side.

    From below with half the rate: the bound of crossings is an upper one.
    """
    rng, runs = np.random.default_rng(seed), 250
    p = np.array(
        [
            find_peaks([coloured(rng, 512, pole)], [Ts], alpha=2.0, most=1)[0].p_value
            for _ in range(runs)
        ]
    )
    for rate in (0.05, 0.2):
        count = int(np.sum(p < rate))
        assert count <= binom.ppf(0.9995, runs, rate)
        assert count >= binom.ppf(0.0005, runs, 0.5 * rate)


def test_outputs_and_records_share_one_rate_of_false_alarms():
    rng, runs = np.random.default_rng(5), 100
    alarms = 0
    for _ in range(runs):
        residuals = [rng.standard_normal((256, 2)), rng.standard_normal((200, 2))]
        alarms += bool(find_peaks(residuals, [Ts, Ts], alpha=0.1))
    assert alarms <= binom.ppf(0.9995, runs, 0.1)


def test_the_tail_of_a_known_level_is_exponential_and_heavier_where_it_is_estimated():
    """(1) tends to exp(-x) for many neighbours, with 1 + x^2 / (2 n) / ln(2)^2 to first order."""
    assert tail(3.0, 200_000, 100_000) == pytest.approx(np.exp(-3.0), rel=1e-3)
    n = 20_000
    excess = tail(5.0, n, n // 2) / np.exp(-5.0) - 1.0
    assert excess == pytest.approx(25.0 / (2 * n) / np.log(2.0) ** 2, rel=0.02)
    assert tail(10.0, 80, 40) > 2.0 * np.exp(-10.0)


@pytest.mark.parametrize("off", [0.0, 0.5])
def test_a_sinusoid_is_found_between_the_lines_as_well_as_on_them(off: float):
    """Rife and Boorstyn (1974): sd of f is sqrt(6 / SNR N) / (pi T), SNR = a^2 / 2 sigma^2."""
    rng, N, a = np.random.default_rng(6), 1000, 0.35
    f = (137 + off) / (N * Ts)
    e = a * np.cos(2 * np.pi * f * Ts * np.arange(N) + 1.0) + rng.standard_normal(N)
    (peak,) = find_peaks([e[:, None]], [Ts])
    sd = np.sqrt(6.0 / (a**2 / 2 * N)) / (np.pi * N * Ts)
    assert peak.p_value < 1e-6
    assert peak.frequency == pytest.approx(f, abs=3 * sd)
    assert peak.amplitude == pytest.approx(a, abs=3 * np.sqrt(2 / N))


def test_two_sinusoids_are_two_peaks_and_the_greater_does_not_hide_the_other():
    rng, N = np.random.default_rng(7), 1000
    t = Ts * np.arange(N)
    e = 3.0 * np.sin(2 * np.pi * 4.01 * t) + 0.5 * np.sin(2 * np.pi * 9.3 * t)
    found = find_peaks([(e + rng.standard_normal(N))[:, None]], [Ts])
    assert [p.frequency for p in found] == pytest.approx([4.01, 9.3], abs=0.02)


def test_an_output_with_a_slower_clock_has_no_peak_beyond_half_its_own_rate():
    """Zeros between its samples repeat a line of 0.4 Hz at 4.6, 5.4 and 9.6 Hz, as high."""
    rng, N, every = np.random.default_rng(9), 4000, 4
    t = 0.05 * np.arange(N)
    e = 1.5 * np.sin(2 * np.pi * 0.4 * t + 0.3) + rng.standard_normal(N)
    e[np.arange(N) % every != 0] = 0.0
    found = find_peaks([e[:, None]], [0.05])
    assert [p.frequency for p in found] == pytest.approx([0.4], abs=0.01)
    assert find_peaks([e[: 60 * every, None]], [0.05]) == []


def test_a_short_record_or_nothing_at_all_has_no_peak():
    assert find_peaks([np.ones((40, 1))], [Ts]) == []
    assert find_peaks([np.zeros((400, 1))], [Ts]) == []


@pytest.mark.slow
def test_a_periodic_torque_is_found_and_recovered_from_a_record():
    """From its peak: frequency within 1/(10 T), amplitude within a tenth of the truth."""
    record = truth.cart_pendulum("periodic_disturbance", 0.5, 3, duration=40.0, Ts=Ts)
    channels = {n: v for n, v in record.columns.items() if n != "t"}
    units = {n: u for n, u in record.units.items() if n != "t"}
    experiments = [casid.Experiment(casid.Record(channels, units, Ts=Ts), {}, "record")]
    model = pendulum.problem.model.with_known(m=0.0)
    weighing = Weighing(experiments)
    at = weighing.weigh(model, fit_model(model, experiments, FitSettings(starts=1)))
    (found,) = periodic_candidates(at.fit, peaks_of(at.fit), (0.0, 40.0))
    assert found.peak.p_value < 1e-6
    extended, names = found.effect.extended(model, starts=found.starts)
    fit = weighing.minimum(weighing.criterion(extended, at.noise, at.fit.values, at.criterion))
    a, b, f = (fit.values[n] for n in names)
    assert f == pytest.approx(record.truth["frequency"], abs=0.1 / 40.0)
    assert np.hypot(a, b) == pytest.approx(abs(record.truth["size"]), rel=0.1)
    # The start was there already: the score of a linear effect is its estimate.
    assert [found.starts[n] for n in ("a_cos", "a_sin")] == pytest.approx([a, b], rel=0.1)
    # The likelihood falls by half the Lagrange multiplier statistic, whose frequency is the peak's.
    gain = 2 * (at.fit.solution.value - fit.solution.value)
    assert gain == pytest.approx(found.statistic, rel=0.02)


def test_a_record_without_a_line_gives_no_candidate():
    record = pendulum.simulate(duration=20.0, seed=4)
    experiments = [casid.Experiment(record, {}, "record")]
    model = pendulum.problem.model.with_known(m=0.0)
    weighing = Weighing(experiments)
    at = weighing.weigh(model, fit_model(model, experiments, FitSettings(starts=1)))
    assert peaks_of(at.fit, alpha=0.01) == []


@pytest.mark.slow
def test_a_flow_to_and_fro_between_two_stores_is_one_disturbance_and_not_two():
    """Exactly, by the step of the linear system: what the one store gains the other loses."""
    Ts, N, C1, C2, G, H = 60.0, 1500, 3e4, 9e4, 40.0, 25.0
    A = np.array([[-(G + H) / C1, G / C1], [G / C2, -G / C2]])
    B = np.array([[1 / C1, 1 / C1], [0.0, -1 / C2]])  # power, and what flows through the wall
    both = expm(np.block([[A, B], [np.zeros((2, 4))]]) * Ts)
    rng, t = np.random.default_rng(3), Ts * np.arange(N)
    u = np.column_stack([400.0 * (np.sin(t / 5e3) > 0), 30.0 * np.cos(2 * np.pi * 4e-4 * t)])
    x, y = np.zeros(2), np.empty((N, 2))
    for k in range(N):
        y[k] = x
        x = both[:2, :2] @ x + both[:2, 2:] @ u[k]
    y += 0.02 * rng.standard_normal((N, 2))
    m = casid.Model("two stores")
    T, W = m.state("T", "K"), m.state("W", "K")
    g, h = (m.parameter(n, "W/K", start=30.0, lower=1.0) for n in "gh")
    c1, c2 = (m.parameter(n, "J/K", start=5e4, lower=1e3) for n in ("c1", "c2"))
    P = m.input("P", "W", hold="zoh", known=True)
    m.balance(T, "air", inertia=c1, terms=[P, g * (W - T), -h * T])
    m.balance(W, "wall", inertia=c2, terms=[g * (T - W)])
    m.output("air", T, "K")
    m.output("inside", W, "K")
    channels = {"air": y[:, 0], "inside": y[:, 1], "P": u[:, 0]}
    record = casid.Record(channels, {"air": "K", "inside": "K", "P": "W"}, Ts)
    found = casid.diagnose(casid.Problem("two stores", m), record, advise=False)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("periodic_disturbance", "T-W")
    assert cause.sentence.endswith("disturbance acts in the relative motion T-W")
    size = {p.name: p for p in cause.parameters}
    assert size["frequency"].value == pytest.approx(4e-4, abs=4 * size["frequency"].std_error)
    amplitude = np.hypot(size["a_cos"].value, size["a_sin"].value)
    assert amplitude == pytest.approx(30.0, abs=4 * size["a_cos"].std_error)
