"""Plants that a controller alone holds: segments chosen by themselves, errors in short windows."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.estimation.simulation.fit import FitSettings
from casid.estimation.simulation.instability import growth_rate, segments_for, window_for
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.simulation.thresholds import INSTABILITY
from casid.identification.short_windows import short_windows

TRUE = {"a": 900.0, "b": 25.0}  # z'' = a z + b u + w
TS, N, NOISE = 0.002, 2000, 1e-5


@cache
def levitated(disturbance: float, seed: int = 1, N: int = N) -> casid.Record:
    """A ball under a magnet, its controller beside it; w of first order, corner 20 rad/s; exact."""
    rng, corner = np.random.default_rng(seed), 20.0
    A = np.array([[0.0, 1.0, 0.0], [TRUE["a"], 0.0, 1.0], [0.0, 0.0, -corner]])
    B = np.array([[0.0], [TRUE["b"]], [0.0]])
    push = np.diag([0.0, 0.0, 2 * corner * disturbance**2])
    both = expm(np.block([[-A, push], [np.zeros((3, 3)), A.T]]) * TS)  # Van Loan
    F = both[3:, 3:].T
    Q = F @ both[:3, 3:]
    G = expm(np.block([[A, B], [np.zeros((1, 4))]]) * TS)[:3, 3]
    root = np.linalg.cholesky(0.5 * (Q + Q.T) + 1e-20 * np.eye(3))
    x, before, rows = np.array([0.0, 0.0, disturbance * rng.standard_normal()]), 0.0, []
    for r in np.repeat(1e-3 * rng.choice([-1, 1], N // 50), 50):
        seen = x[0] + NOISE * rng.standard_normal()
        u = 120.0 * (r - seen) - 3.0 * (seen - before) / TS
        before = seen
        rows.append((r, u, seen))
        x = F @ x + G * u + root @ rng.standard_normal(3)
    ref, u, z = np.array(rows).T
    return casid.Record({"ref": ref, "u": u, "z": z}, {"ref": "m", "u": "A", "z": "m"}, Ts=TS)


def problem(a: float = 700.0, *, has_rate: bool = False) -> casid.Problem:
    m = casid.Model("levitated ball")
    z, v = m.state("z", "m"), m.state("v", "m/s")
    u = m.input("u", "A", hold="zoh", known=True)
    stiffness = m.parameter("a", "1/s^2", start=a, lower=-5000.0, upper=5000.0)
    gain = m.parameter("b", "m/(s^2 A)", start=20.0, lower=1.0, upper=200.0)
    m.derivative(z, v)
    m.balance(v, "force", inertia=1, terms=[stiffness * z, gain * u], unit="m/s^2")
    m.output("z", z, "m")
    if has_rate:
        m.output("rate", v, "m/s")
    return casid.Problem("levitation", m, recorded={"ref": "m"}, starts=1)


def criterion(a: float) -> SimulationError:
    return SimulationError(problem(a).model, [casid.Experiment(levitated(0.0), {}, "r")])


def test_errors_grow_by_the_unstable_pole():
    """z'' = a z has the poles +-sqrt(a), and an oscillator none in the right half plane."""
    assert growth_rate(criterion(700.0)) == pytest.approx(np.sqrt(700.0))
    assert growth_rate(criterion(-700.0)) == pytest.approx(0.0, abs=1e-9)
    assert segments_for(criterion(-700.0)) == 1
    assert segments_for(criterion(1.0)) == 1  # e^4 over the record
    assert segments_for(criterion(700.0)) == np.ceil(np.sqrt(700.0) * N * TS / 3.0)


def test_a_fit_in_short_windows_begins_at_a_given_start():
    """Where the declared start is a stable model, there are no windows to fit from it."""
    c, settings = criterion(-700.0), FitSettings(starts=1)
    assert short_windows(c, settings, str).values == {}
    found = short_windows(
        c.of_records(c.experiments, start={"a": 700.0}), settings, str, {"a": 700.0}
    )
    assert found.values["a"] == pytest.approx(TRUE["a"], rel=0.05)


def test_windows_are_no_longer_than_a_few_in_which_the_model_follows_the_record():
    """What pushes the ball by turns is missing: it is followed in half of the first windows."""
    c, settings = criterion(700.0), FitSettings(starts=1)
    tried: list[str] = []
    found = short_windows(c, settings, tried.append)
    assert found.samples == window_for(c.of_records(c.experiments, start=found.values))
    assert len(tried) == 1
    record = levitated(0.0)
    pushed = record.channels["u"] + 0.04 * np.sign(np.sin(2 * np.pi * np.arange(N) / 200))
    other = casid.Record({**record.channels, "u": pushed}, record.units, Ts=TS)
    c = SimulationError(c.model, [casid.Experiment(other, {}, "r")])
    tried.clear()
    found = short_windows(c, settings, tried.append)
    assert len(tried) == 2
    assert found.samples == INSTABILITY.followed * (window_for(c) // 2)
    assert found.samples < window_for(c.of_records(c.experiments, start=found.values))


def test_segments_are_chosen_and_what_is_held_out_is_simulated_in_windows():
    """The parameters within 3.5 standard errors, and errors as large as the noise of the sensor.

    Two of 85 samples of a window go into its initial state: the error of the rest is that of the
    noise, whose RMS over 600 samples has a standard deviation of 3 %.
    """
    found = casid.identify(problem(), levitated(0.0), hold_out=0.3)
    assert found.method.startswith("simulation error, multiple shooting (")
    assert "held out in windows of" in found.method
    for name, true in TRUE.items():
        p = found.parameter(name)
        assert abs(p.value - true) < 3.5 * p.std_error
    (error,) = (row["z"] for row in found.held_out.rmse.values())
    assert error == pytest.approx(NOISE, rel=4 * 0.03)
    assert not any("follows the residual" in w for w in found.warnings)


def test_a_disturbance_that_the_controller_answers_is_estimated_with_the_parameters():
    """Least squares takes what the controller does about it for the plant's; a filter does not."""
    record = levitated(0.3)
    found = casid.identify(problem(), record, intervals="quick")
    assert found.method.endswith("disturbances in force (first)")
    assert "as by --disturbance force:first" in found.evidence["disturbances"]
    for name, true in TRUE.items():
        p = found.parameter(name)
        assert abs(p.value - true) < 3.5 * p.std_error
    size = found.parameter("size of disturbance in force")
    assert size.value == pytest.approx(0.3, rel=0.4)


@pytest.mark.slow
def test_a_disturbance_may_be_requested_as_well():
    record = levitated(0.3)
    own = casid.identify(problem(), record, intervals="quick")
    found = casid.identify(problem(), record, disturbances="force:first", intervals="quick")
    for name in TRUE:
        p = found.parameter(name)
        assert own.parameter(name).value == pytest.approx(p.value, abs=0.01 * p.std_error)


@pytest.mark.parametrize("segments", [1, 40])  # chosen, and requested
def test_a_noisy_output_takes_nothing_from_what_an_exact_one_tells(segments: int):
    """In segments as in one piece, outputs count in units of the errors that they leave.

    A standard error of an estimate of the noise of 2000 samples scatters by some per cent.
    """
    record, rng = levitated(0.0), np.random.default_rng(5)
    z = record["z"]
    v = np.gradient(z, TS)
    noisy = v + 0.5 * np.std(v) * rng.standard_normal(N)
    both = casid.Record(
        {"ref": record["ref"], "u": record["u"], "z": z, "rate": noisy},
        {**record.units, "rate": "m/s"},
        Ts=TS,
    )
    settings = FitSettings(segments=segments, starts=1)
    one = casid.identify(problem(), record, settings=settings, intervals="quick")
    two = casid.identify(problem(has_rate=True), both, settings=settings, intervals="quick")
    for name, true in TRUE.items():
        p = two.parameter(name)
        assert abs(p.value - true) < 3.5 * p.std_error
        assert p.std_error < 1.1 * one.parameter(name).std_error


def test_a_motion_that_leaves_an_unstable_equilibrium_once_is_simulated_whole():
    """A limit cycle forgets where it began: no segments, whatever the poles at the origin are."""
    m = casid.Model("oscillator")
    x, v = m.state("x", "1", start=1.0), m.state("v", "1/s")
    mu = m.parameter("mu", "1/s", start=1.5, lower=0.1, upper=5.0)
    m.derivative(x, v)
    m.derivative(v, mu * (1 - x**2) * v - m.constant("k", 1.0, "1/s^2") * x)
    m.output("x", x, "1")
    rng = np.random.default_rng(2)
    state, values = np.array([0.5, 0.0]), []

    def slope(s: np.ndarray) -> np.ndarray:
        return np.array([s[1], 2.0 * (1 - s[0] ** 2) * s[1] - s[0]])

    for _ in range(600):
        values.append(state[0] + 0.02 * rng.standard_normal())
        for _ in range(20):
            h = 0.05 / 20
            one = slope(state)
            two = slope(state + h / 2 * one)
            three = slope(state + h / 2 * two)
            state = state + h / 6 * (one + 2 * two + 2 * three + slope(state + h * three))
    record = casid.Record({"x": np.array(values)}, {"x": "1"}, Ts=0.05)
    found = casid.identify(m, record, settings=FitSettings(starts=1), intervals="quick")
    assert found.method == "simulation error, single shooting"
    p = found.parameter("mu")
    assert abs(p.value - 2.0) < 3.5 * p.std_error
