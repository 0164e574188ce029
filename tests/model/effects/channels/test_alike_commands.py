"""Commands that act by one law have actuators of one make: what one does, all of them do."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.verdict.sentences import says
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.catalogue import catalogue
from casid.model.effects.channels.actuator_effects import actuator_lag
from casid.model.effects.channels.alike_commands import alike_commands
from casid.model.effects.channels.delays import dead_time
from casid.model.effects.effect import Sizes

SIZES = Sizes({"w": 1.0, "q": 1.0}, {}, (0.0, 10.0), 0.1)


def beam(gains: str = "one") -> casid.Model:
    """A beam that two rotors lift and tilt, its thrusts the squares of the commands."""
    m = casid.Model("beam")
    w, q = m.state("w", "m/s"), m.state("q", "rad/s")
    front, rear = (m.input(n, "1", hold="zoh", known=True) for n in ("front", "rear"))
    a, b = m.constant("a", 0.2, "m"), m.constant("b", 0.3, "m")
    K = m.parameter("K", "N", start=10.0)
    K_2 = {
        "one": lambda: K,
        "known": lambda: K * m.constant("share", 0.9, "1"),
        "two": lambda: m.parameter("K_2", "N", start=10.0),
    }[gains]()
    m.balance(w, "lift", inertia=1.2, terms=[K * front**2, K_2 * rear**2], unit="N")
    m.balance(q, "tilt", inertia=0.1, terms=[a * K * front**2, -b * K_2 * rear**2], unit="N m")
    m.output("climb", w, "m/s")
    m.output("gyro", q, "rad/s")
    return m


@pytest.mark.parametrize(
    ("gains", "groups"),
    [("one", [("front", "rear")]), ("known", [("front", "rear")]), ("two", [])],
)
def test_commands_are_alike_whose_effects_differ_by_known_factors(gains, groups):
    assert alike_commands(beam(gains), ["front", "rear"]) == groups


def test_commands_of_different_laws_equations_or_holds_are_not_alike():
    """A square and a line, a force on each of two bodies, a held command and a joined one."""
    m = casid.Model("bodies")
    v, w = m.state("v", "m/s"), m.state("w", "m/s")
    inputs = {n: m.input(n, "N", hold="zoh", known=True) for n in ("on_v", "also_on_v", "on_w")}
    joined, twice = (
        m.input("joined", "N", known=True),
        m.input("twice", "N", hold="zoh", known=True),
    )
    law = twice * m.parameter("c", "1/N", start=1.0) * twice
    forces = [inputs["on_v"], 0.5 * inputs["also_on_v"], joined, law]
    m.balance(v, "one", inertia=1.0, terms=forces, unit="N")
    m.balance(w, "other", inertia=1.0, terms=[inputs["on_w"]], unit="N")
    m.output("v", v, "m/s")
    m.output("w", w, "m/s")
    assert alike_commands(m, list(m.inputs)) == [("on_v", "also_on_v")]


def test_alike_commands_may_lag_or_act_late_together_and_each_alone():
    found = catalogue(beam(), SIZES, {})
    for kind in ("actuator_lag", "time_delay"):
        places = [e.where for e in found if e.kind == kind]
        assert {"front", "rear", "front, rear"} <= set(places)
        assert not any(", " in e.where for e in catalogue(beam("two"), SIZES, {}) if e.kind == kind)


@pytest.mark.parametrize("effect_of", [actuator_lag, dead_time])
def test_what_alike_commands_do_together_is_what_each_does_with_one_time(effect_of):
    """Lags, or dead times, of 0.13 s: simulated with one parameter, and with one each."""
    m, rng = beam(), np.random.default_rng(3)
    together = effect_of(m, ["front", "rear"], 0.5).extend(m)
    (time,) = set(together.parameters) - set(m.parameters)
    once = effect_of(m, "front", 0.5).extend(m)
    each = effect_of(once, "rear", 0.5).extend(once)
    names = set(each.parameters) - set(m.parameters)
    held = {n: np.repeat(rng.uniform(0.3, 0.7, 40), 10) for n in ("front", "rear")}
    record = casid.Record(
        held | {"climb": np.zeros(400), "gyro": np.zeros(400)},
        {"front": "1", "rear": "1", "climb": "m/s", "gyro": "rad/s"},
        Ts=0.02,
    )

    def simulated(model: casid.Model, times: dict[str, float]) -> np.ndarray:
        criterion = SimulationError(model, [casid.Experiment(record)])
        x = np.array([times.get(v.name, v.start) for v in criterion.variables])
        return criterion.simulate(x, 0)[0]

    expected = simulated(each, dict.fromkeys(names, 0.13))
    assert simulated(together, {time: 0.13}) == pytest.approx(expected, abs=1e-12)
    assert np.abs(expected - simulated(m, {})).max() > 0.1


def test_several_commands_act_in_the_plural():
    lag, late = (f(beam(), ["front", "rear"], 0.5) for f in (actuator_lag, dead_time))
    assert says(lag) == "the inputs front, rear act with one first-order lag"
    assert says(late) == "the inputs front, rear act late, by a dead time"
    assert says(dead_time(beam(), "front", 0.5)) == "the input front acts late, by a dead time"
