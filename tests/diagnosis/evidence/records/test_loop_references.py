"""The reference of a control loop is no input of the system: it acts through the measured one."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.records.loop_references import loop_references
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.rounds import Search
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.effect import KINDS

Ts = 0.02
SOURCES = {"cross_axis", "extra_input"}  # kinds by which a channel acts


@functools.cache
def rail(*, dry: float = 0.8, seed: int = 6, N: int = 1500) -> casid.Record:
    """A cart with dry friction follows `x_ref` under a proportional-integral-derivative drive.

    Simulated in 20 steps a sample; the drive holds its force between samples, and its encoder, not
    the cart, has noise. `aside` moves like a position and drives nothing.
    """
    rng = np.random.default_rng(seed)
    t = Ts * np.arange(N)
    r = 0.3 * np.sin(0.7 * t) + 0.15 * np.sin(1.9 * t + 1)
    x = v = total = last = 0.0
    measured, force = np.empty(N), np.empty(N)
    for i in range(N):
        measured[i] = x + 1e-4 * rng.standard_normal()
        error = r[i] - measured[i]
        total += Ts * error
        force[i] = 60 * error + 20 * total + 12 * (error - last) / Ts
        last = error
        for _ in range(20):
            push = force[i] - 4.0 * v
            sticks = v == 0.0 and abs(push) <= dry
            side = np.sign(v) if v != 0.0 else np.sign(push)
            after = 0.0 if sticks else v + Ts / 20 * (push - dry * side) / 2.0
            v = 0.0 if v * after < 0.0 else after
            x += Ts / 20 * v
    channels = {"x": measured, "F": force, "x_ref": r, "aside": 0.2 * np.cos(0.4 * t)}
    units = {"x": "m", "F": "N", "x_ref": "m", "aside": "m"}
    return casid.Record(channels, units, Ts=Ts, name="rail")


def cart(*, known: bool = False) -> casid.Model:
    m = casid.Model("cart")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold="zoh", known=known)
    mass = m.parameter("mass", "kg", start=1.5, lower=0.1, upper=20.0)
    d = m.parameter("d", "N s/m", start=3.0, lower=0.0, upper=50.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[F, -d * v], unit="N")
    m.output("x", x, "m")
    return m


@pytest.mark.parametrize(("dry", "known"), [(0.0, False), (0.8, False), (0.8, True)])
def test_the_reference_is_found_and_what_drives_nothing_is_not(dry, known):
    """Also of a drive whose force is recorded without errors."""
    data = casid.Experiment(rail(dry=dry), {}, "rail")
    assert loop_references([data], cart(known=known), ("x_ref", "aside")) == ("x_ref",)


def test_a_reference_that_the_output_follows_from_afar_is_one_too():
    """A drive of 20 N/m, 4 N s/m of drag: the output lags a reference of 7 rad/s by more than its
    size, and the drive is an exact function of both, rounded to a newton in a thousand."""
    rng, N = np.random.default_rng(4), 1500
    t = Ts * np.arange(N)
    r, aside = 0.3 * np.sin(7.0 * t) + 0.1 * np.sin(4.0 * t), 0.2 * np.cos(6.5 * t)
    x = v = 0.0
    rows = np.empty((N, 2))
    for i in range(N):
        seen = x + 1e-4 * rng.standard_normal()
        rows[i] = seen, round(20.0 * (r[i] - seen), 3)
        for _ in range(20):
            v += Ts / 20 * (rows[i, 1] - 4.0 * v) / 2.0
            x += Ts / 20 * v
    channels = {"x": rows[:, 0], "F": rows[:, 1], "x_ref": r, "aside": aside}
    assert np.var(rows[:, 0] - r) > np.var(r)
    units = {"x": "m", "F": "N", "x_ref": "m", "aside": "m"}
    data = casid.Experiment(casid.Record(channels, units, Ts=Ts, name="slow"), {}, "slow")
    assert loop_references([data], cart(), ("x_ref", "aside")) == ("x_ref",)


def test_a_reference_acts_neither_on_the_balance_nor_on_the_sensor():
    """It acts through the drive alone; a channel beside the loop may act on either."""
    m = cart()
    data = casid.Experiment(rail(), {}, "rail")
    fit = minimize_simulation_error(SimulationError(m, [data], substeps=1), check_rank=False)
    weighing = Weighing([data])
    search = Search(weighing, {"x_ref": "m", "aside": "m"}, without=KINDS - SOURCES)
    table = search.table(weighing.weigh(m, fit), [])
    assert {s.effect.kind for s in table.scores} == SOURCES
    assert {s.effect.parameters[0].name.split("_")[-1] for s in table.scores} == {"aside"}
    assert search.memory.references == ("x_ref",)


def test_without_a_loop_no_channel_is_a_reference():
    """The same cart driven by a force of its own: the output follows nothing."""
    rng = np.random.default_rng(2)
    record = rail()
    push = np.convolve(rng.standard_normal(record.N), np.ones(20) / 20, mode="same")
    open_ = casid.Record(
        {"x": record["x"], "F": push, "x_ref": record["x_ref"]},
        {"x": "m", "F": "N", "x_ref": "m"},
        Ts=Ts,
        name="open",
    )
    assert loop_references([casid.Experiment(open_, {}, "open")], cart(), ("x_ref",)) == ()


@pytest.mark.slow
def test_a_recorded_reference_is_no_candidate_and_the_friction_is_named():
    problem = casid.Problem("cart", cart(), recorded={"x_ref": "m"})
    data = casid.Experiment(rail(), {}, "rail")
    d = casid.diagnose(problem, data, starts=1, advise=False, max_causes=1)
    assert d.causes[0].kind == "coulomb_friction"
    assert "extra_input" not in {r.kind for r in d.ranking}
    assert any("x_ref" in note and "control loop" in note for note in d.notes)
