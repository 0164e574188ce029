"""A model under a disturbance: what a large slow force hides is found beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.estimation.simulation.fit import FitSettings, fit_model, weighted_by_errors
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError

TS, N = 0.05, 3000
J1, J2, K, C, D = 60.0, 7.0, 4000.0, 20.0, 1.5


def drive() -> casid.Model:
    """Two inertias and a shaft between them; a torque on the second is known."""
    m = casid.Model("drive")
    e, w1, w2 = m.state("e", "rad"), m.state("w1", "rad/s"), m.state("w2", "rad/s")
    T = m.input("T", "N m", hold="zoh", known=True)
    j1 = m.parameter("J1", "kg m^2", start=50.0, lower=5.0, upper=500.0)
    k = m.parameter("K", "N m/rad", start=3000.0, lower=100.0, upper=1e5)
    c = m.parameter("C", "N m s/rad", start=10.0, lower=0.0, upper=500.0)
    d = m.parameter("D", "N m s/rad", start=1.0, lower=0.0, upper=50.0)
    shaft = k * e + c * (w1 - w2)
    m.derivative(e, w1 - w2)
    m.balance(w1, "rotor", inertia=j1, terms=[-d * w1, -shaft])
    m.balance(w2, "generator", inertia=m.constant("J2", J2, "kg m^2"), terms=[shaft, -T])
    m.output("w1", w1, "rad/s")
    m.output("w2", w2, "rad/s")
    return m


def record(seed: int) -> casid.Record:
    """Steps of the known torque, and gusts of two seconds on the rotor that nobody measures."""
    rng = np.random.default_rng(seed)
    T = np.repeat(rng.uniform(-30.0, 30.0, N // 60), 60)
    gust, share = np.zeros(N), np.exp(-TS / 2.0)
    for i in range(1, N):
        gust[i] = share * gust[i - 1] + 6.0 * np.sqrt(1 - share**2) * rng.standard_normal()
    a = np.array([[0, 1, -1], [-K / J1, -(C + D) / J1, C / J1], [K / J2, C / J2, -C / J2]])
    b = np.array([[0, 0], [0, 1 / J1], [-1 / J2, 0]])
    step = expm(np.block([[a, b], [np.zeros((2, 5))]]) * TS)
    x, out = np.zeros(3), np.empty((N, 2))
    for i in range(N):
        out[i] = x[1:]
        x = step[:3, :3] @ x + step[:3, 3:] @ [T[i], gust[i]]
    out += 0.005 * rng.standard_normal(out.shape)
    columns = {"T": T, "w1": out[:, 0], "w2": out[:, 1]}
    return casid.Record(columns, {"T": "N m", "w1": "rad/s", "w2": "rad/s"}, Ts=TS)


@pytest.mark.slow
def test_what_a_bound_holds_under_a_large_force_is_fitted_under_that_force_from_its_start():
    """Gusts move the rotor far more than its shaft twists: where it is rigid, nothing says so."""
    experiment = casid.Experiment(record(1), {}, "r")
    model = drive()
    criterion = SimulationError(model, [experiment], substeps=4)
    fit = minimize_simulation_error(criterion)
    x = fit.x.copy()
    x[fit.criterion.names.index("K")] = 1e5 * (1 - 1e-9)  # as near as a barrier lets it
    held = replace(fit, solution=replace(fit.solution, x=x))
    at = Weighing([experiment]).with_disturbances().weigh(model, held)
    assert at.unbiased is not None
    assert abs(at.unbiased.values["K"] / K - 1) < 0.05
    assert abs(at.full.source_sd["rotor"] / 6.0 - 1) < 0.3  # 150 s are 75 of its time constants


def slow_tank(seed: int, N: int = 720) -> tuple[casid.Model, casid.Experiment]:
    """A tank of 1500 s behind a measured temperature of the inflow with noise of 0.1 K.

    T' = (T_in - T) / tau, exact for straight lines between samples.
    """
    m = casid.Model("tank")
    T, inflow = m.state("T", "K"), m.input("T_in", "K")
    tau = m.parameter("tau", "s", start=1000.0, lower=10.0)
    m.balance(T, "heat", inertia=tau, terms=[inflow - T])
    m.output("T", T, "K")
    rng, h = np.random.default_rng(seed), 10.0 / 1500.0
    u = np.repeat(rng.uniform(-4.0, 4.0, N // 40), 40)
    keep = np.exp(-h)
    now, after = (1 - keep) / h - keep, 1 - (1 - keep) / h
    y = lfilter([after, now], [1.0, -keep], u) - after * u[0]
    columns = {"T_in": u + 0.1 * rng.standard_normal(N), "T": y + 0.05 * rng.standard_normal(N)}
    record = casid.Record(columns, {"T_in": "K", "T": "K"}, Ts=10.0)
    return m, casid.Experiment(record, {}, f"r{seed}")


def test_the_noise_of_an_input_that_the_residual_hides_is_that_of_its_own_spectrum():
    """The noise moves the output within a few lines, of which initial state and tau take most.

    By the residual alone two of the four would have less than half of it.
    """
    found = []
    for seed in range(4):
        model, experiment = slow_tank(seed)
        fit = minimize_simulation_error(SimulationError(model, [experiment], substeps=2))
        found.append(Weighing([experiment]).weigh(model, fit).input_sd["T_in"])
    assert min(found) > 0.08, found
    assert max(found) < 0.14, found


def shaken(seed: int, *, gust: float = 0.0) -> casid.Record:
    """A pushed sledge, 5 v' = F - 20 v + a white force, whose accelerometer feels every force."""
    rng = np.random.default_rng(seed)
    n, h, mass, drag = 600, 0.02, 5.0, 20.0
    push = np.repeat(rng.uniform(-10, 10, n // 20), 20)
    force = push + gust * rng.standard_normal(n)
    v, a = 0.0, 0.05 * rng.standard_normal(n)
    for i, f in enumerate(force):
        a[i] += (f - drag * v) / mass
        v = f / drag + (v - f / drag) * np.exp(-drag / mass * h)
    return casid.Record({"F": push, "a": a}, {"F": "N", "a": "m/s^2"}, Ts=h)


def sledge_with_accelerometer() -> casid.Model:
    m = casid.Model("sledge")
    F, v = m.input("F", "N", hold="zoh", known=True), m.state("v", "m/s")
    d = m.parameter("d", "N s/m", start=15.0, lower=0.0, upper=100.0)
    inertia = m.parameter("M", "kg", start=4.0, lower=0.1, upper=100.0)
    m.balance(v, "force", inertia=inertia, terms=[F, -d * v])
    m.output("a", m.der(v), "m/s^2")
    return m


def weighed(record: casid.Record) -> Weighted:
    model, experiments = sledge_with_accelerometer(), [casid.Experiment(record, {}, "run")]
    settings = FitSettings(starts=1)
    fit = weighted_by_errors(fit_model(model, experiments, settings), settings)
    return Weighing(experiments).weigh(model, fit)


def test_an_accelerometers_own_noise_is_no_force_by_chance():
    """White either way; by chance a force is a little likelier in nine of the first 24 records."""
    for seed in (2, 3, 4, 9):
        at = weighed(shaken(seed))
        assert not at.noise_absorbs_misfit
        assert at.full.output_sd[0] == pytest.approx(0.05, rel=0.1)


def test_a_force_that_the_residual_shows_stays_one():
    at = weighed(shaken(1, gust=1.0))
    assert at.noise_absorbs_misfit
    assert at.full.source_sd["force"] == pytest.approx(1.0, rel=0.2)
