"""A force that is a few per cent of the noise may be the misfit of a cause, or be no white one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.estimation.simulation.fit import FitSettings, fit_model

ROOM, NOISE = 293.0, 0.05


def chain() -> casid.Model:
    """Three bodies in a row, heated at one end, which lose heat at the other."""
    m = casid.Model("chain")
    power = m.input("P", "W", hold="zoh", known=True)
    T = [m.state(f"T{i}", "K", start=ROOM) for i in range(3)]
    G = [m.parameter(f"G{i}", "W/K", start=3.0, lower=0.1, upper=100.0) for i in range(3)]
    flow = [G[0] * (T[0] - T[1]), G[1] * (T[1] - T[2])]
    flow.append(G[2] * (T[2] - m.constant("room", ROOM, "K")))
    for i, into in enumerate((power, *flow[:2])):
        C = m.parameter(f"C{i}", "J/K", start=180.0, lower=1.0, upper=1e5)
        m.balance(T[i], f"node{i}", inertia=C, terms=[into, -flow[i]], unit="W")
        m.output(f"temperature{i}", T[i], "K")
    return m


def heated(seed: int, cut: float) -> tuple[casid.Record, float]:
    """The chain, exactly, under a heater that saturates, and its limit [W].

    It is commanded to 100 levels of a minute each, and lacks a share `cut` of the highest.
    """
    rng = np.random.default_rng(seed)
    power = np.repeat(rng.uniform(20.0, 180.0, 100), 12)
    limit = float(power.max() * (1 - cut))
    rates = np.array([[-3.2, 3.2, 0.0], [3.2, -6.0, 2.8], [0.0, 2.8, -4.7]]) / 200.0
    F = expm(5.0 * rates)
    step = np.linalg.solve(rates, (F - np.eye(3)) @ np.array([1.0, 0.0, 0.0]) / 200.0)
    above, measured = np.array([87.0, 57.0, 27.0]), []
    for P in np.minimum(power, limit):
        measured.append(ROOM + above)
        above = F @ above + step * P
    y = np.array(measured) + NOISE * rng.standard_normal((len(power), 3))
    channels = {"P": power} | {f"temperature{i}": y[:, i] for i in range(3)}
    units = {"P": "W"} | {f"temperature{i}": "K" for i in range(3)}
    return casid.Record(channels, units, Ts=5.0), limit


def oven() -> casid.Model:
    """C dT/dt = P - h (T - room), P as commanded."""
    m = casid.Model("oven")
    T, P = m.state("T", "K", start=330.0), m.input("P", "W", hold="zoh", known=True)
    C = m.parameter("C", "J/K", start=150.0, lower=1.0, upper=1e5)
    h = m.parameter("h", "W/K", start=1.5, lower=0.01, upper=100.0)
    m.balance(T, "heat", inertia=C, terms=[P, -h * (T - m.parameter("room", "K", start=290.0))])
    m.output("T", T, "K")
    return m


def disturbed(seed: int, sd: float = 0.15, memory: float = 300.0) -> casid.Record:
    """An oven whose room draws a heat flow of `sd` [W] that wanders with a memory [s]."""
    rng, dt, samples = np.random.default_rng(seed), 0.5, 1000
    decay = np.exp(-dt / memory)
    power = np.repeat(rng.uniform(20.0, 180.0, samples // 12 + 1), 12)[:samples]
    T, force, measured = 330.0, sd * rng.standard_normal(), []
    for P in power:
        measured.append(T)
        for _ in range(10):
            force = decay * force + np.sqrt(1 - decay**2) * sd * rng.standard_normal()
            T += dt * (P + force - 2.0 * (T - ROOM)) / 200.0
    y = np.array(measured) + 0.15 * rng.standard_normal(samples)
    return casid.Record({"P": power, "T": y}, {"P": "W", "T": "K"}, Ts=5.0)


def weighed(record: casid.Record) -> tuple[Weighing, Weighted]:
    made, model = [casid.Experiment(record)], chain()
    weighing = Weighing(made)
    return weighing, weighing.weigh(model, fit_model(model, made, FitSettings(starts=1)))


def test_forces_in_the_noise_are_doubted_where_they_are_likelier_than_none():
    """Those of a sound model are chance; of a heater that saturates in one minute of 100, not."""
    for cut, is_doubted in ((0.0, False), (0.004, True)):
        weighing, at = weighed(heated(1, cut)[0])
        assert not at.noise_absorbs_misfit
        alone = weighing.without_forces(at)
        assert (alone is not None) is is_doubted
    assert alone is not None
    assert at.full.forces(at.model.inputs)
    assert not alone.full.forces(at.model.inputs)


@pytest.mark.slow
def test_a_cause_that_acts_in_one_minute_of_100_is_found_where_forces_explain_it_as_well():
    record, limit = heated(1, 0.004)
    found = casid.diagnose(casid.Problem("chain", chain()), record, advise=False)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("actuator_saturation", "P")
    size = next(p for p in cause.parameters if p.name == "limit_P")
    assert size.std_error is not None
    assert size.value == pytest.approx(limit, abs=3 * size.std_error)


@pytest.mark.slow
def test_a_slow_disturbance_below_the_noise_is_no_jump():
    """Under a white force in its place a jump of the room's temperature had p = 0.004."""
    found = casid.diagnose(casid.Problem("oven", oven()), disturbed(3), advise=False)
    assert found.verdict != "deficient", found.sentence
