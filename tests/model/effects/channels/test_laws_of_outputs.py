"""What an output shows of a state may bend at one end of it."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

import casid
from casid.model.effects.channels.laws_of_outputs import bend, bends_of
from casid.model.effects.effect import Motion, Sizes


def cell() -> casid.Model:
    """A cell of 2000 A s whose voltage is a straight line of its charge, behind one pair."""
    m = casid.Model("cell")
    current = m.input("I", "A", hold="zoh", known=True)
    z, v = m.state("z", "1", start=0.9), m.state("v", "V", initial=0.0)
    R_0 = m.parameter("R_0", "ohm", start=0.02, lower=0.001)
    R_1 = m.parameter("R_1", "ohm", start=0.02, lower=0.001)
    C = m.parameter("C", "A s/V", start=1500.0, lower=10.0)
    k = m.parameter("k", "V", start=0.4, lower=0.0)
    m.balance(z, "charge", inertia=m.constant("Q", 2000.0, "A s"), terms=[-current], unit="A")
    m.balance(v, "pair", inertia=C, terms=[current, -v / R_1])
    m.output("V", m.constant("E", 3.5, "V") + k * z - R_0 * current - v, "V")
    m.output("charge", z, "1")
    return m


def test_an_output_bends_in_what_a_parameter_of_its_own_shows():
    """k multiplies z in the voltage alone; v is shown by no parameter, the charge by none."""
    sizes = Sizes({"z": 0.6, "v": 0.02}, {}, (0.0, 9.0), 1.0, ranges={"z": (0.2, 0.9)})
    found = {e.key for e in bends_of(cell(), sizes)}
    assert found == {("unknown", "V: exp(-z/w)"), ("unknown", "V: exp(z/w)")}


@pytest.mark.parametrize(("is_at_least", "end"), [(True, 0.2), (False, 0.9)])
def test_the_size_of_a_bend_is_what_it_does_at_its_end(is_at_least: bool, end: float) -> None:
    """c = 3 V at the end, 3 V / e one width inside, and finite however far outside."""
    effect = bend(cell(), "V", "z", Motion(0.6, 0.2, 0.9, 0.5), 0.1, is_at_least=is_at_least)
    assert effect.parameters[1].start == pytest.approx(0.07)
    new, names = effect.extended(cell(), starts={"bend_V_z": 3.0})
    e = new.explicit()
    p = [dict(zip(names, (3.0, 0.07), strict=True)).get(n, 0.0) for n in e.parameters]
    shown = ca.Function("h", [e.x, e.u, e.p], [e.h])
    inside = -0.07 if not is_at_least else 0.07
    for x, expected in ((end, 3.0), (end + inside, 3.0 / math.e)):
        assert float(shown([x, 0.0], [0.0], p)[0]) == pytest.approx(expected)
    assert math.isfinite(float(shown([end - 1e3 * inside, 0.0], [0.0], p)[0]))


def drained(seed: int) -> casid.Record:
    """1500 samples of 1 s; the voltage falls off by 0.25 V exp(-10 z) as the cell runs empty."""
    rng, n, Q = np.random.default_rng(seed), 1500, 2000.0
    current = np.repeat(rng.uniform(-2.0, 4.5, n // 25), 25)
    current *= 0.8 * Q / current.sum()
    z = 0.9 - np.concatenate([[0.0], np.cumsum(current)[:-1]]) / Q
    v, decay = np.zeros(n), math.exp(-1.0 / 20.0)
    for k in range(n - 1):
        v[k + 1] = decay * v[k] + (1 - decay) * 0.015 * current[k]
    voltage = 3.5 + 0.5 * z - 0.25 * np.exp(-10 * z) - 0.03 * current - v
    channels = {
        "I": current,
        "V": voltage + 1e-3 * rng.standard_normal(n),
        "charge": z + 1e-3 * rng.standard_normal(n),
    }
    return casid.Record(channels, {"I": "A", "V": "V", "charge": "1"}, Ts=1.0)


@pytest.mark.slow
def test_a_voltage_that_falls_off_as_a_cell_runs_empty_bends_with_the_charge():
    """The width of exp(-10 z) is 0.1."""
    found = casid.diagnose(casid.Problem("cell", cell()), drained(2), hold_out=0, advise=False)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("unknown", "V")
    size, width = cause.parameters
    assert width.std_error is not None
    assert abs(width.value - 0.1) < 4 * width.std_error < 0.02
