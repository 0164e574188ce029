"""A quadratic loss of a store goes to a level of its own, which is estimated."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.model.effects.balances.balance_effects import quadratic_damping
from casid.model.effects.catalogue import catalogue
from casid.model.effects.effect import Sizes
from casid.model.rate_laws import with_balances

ONCE = casid.FitSettings(starts=1)
LOSS, LEVEL = 0.05, 300.0  # W/K^2, K


def vessel() -> casid.Model:
    """C dT/dt = P - h (T - room)."""
    m = casid.Model("vessel")
    T, P = m.state("T", "K", start=320.0), m.input("P", "W", hold="zoh")
    C = m.parameter("C", "J/K", start=400.0, lower=10.0, upper=1e5)
    h = m.constant("h", 1.5, "W/K")
    m.balance(T, "heat", inertia=C, terms=[P, -h * (T - m.constant("room", 293.0, "K"))])
    m.output("T", T, "K")
    return m


def heated() -> casid.Record:
    """The vessel with a loss of LOSS |T - LEVEL| (T - LEVEL), by Heun's method."""
    rng, dt = np.random.default_rng(3), 1.0
    power = np.repeat(rng.uniform(0.0, 200.0, 20), 20)

    def rate(T: float, P: float) -> float:
        return (P - 1.5 * (T - 293.0) - LOSS * abs(T - LEVEL) * (T - LEVEL)) / 300.0

    T, measured = 320.0, []
    for P in power:
        measured.append(T)
        for _ in range(5):
            first = rate(T, P)
            T += 0.5 * dt * (first + rate(T + dt * first, P))
    y = np.array(measured) + 0.02 * rng.standard_normal(len(measured))
    return casid.Record({"P": power, "T": y}, {"P": "W", "T": "K"}, Ts=5 * dt)


def test_loss_and_level_are_estimated_from_the_mean_of_the_record():
    record = heated()
    loss = quadratic_damping(vessel(), "heat", float(record["T"].mean()))
    extended, _ = loss.extended(vessel(), starts={"d_2": 0.5 * LOSS})
    found = casid.identify(extended, record, settings=ONCE)
    for name, true in (("d_2", LOSS), ("level_T", LEVEL)):
        p = found.parameter(name)
        assert p.std_error is not None
        assert abs(p.value - true) < 3 * p.std_error
    assert found.parameter("level_T").std_error < 2.0


def test_the_level_is_shown_in_the_unit_of_the_state():
    m = casid.Model("vessel")
    T = m.state("T", "degC", start=40.0)
    C = m.parameter("C", "J/K", start=400.0)
    m.derivative(T, m.input("P", "W") / C)
    m.output("T", T, "degC")
    extended, names = quadratic_damping(with_balances(m), "T", 320.0).extended(with_balances(m))
    assert extended.declared_units[names[1]] == "degC"


@pytest.mark.parametrize("level", [200.0, 310.0, 320.0, 330.0, 340.0, 350.0, 500.0])
def test_one_of_those_of_the_catalogue_acts_much_as_any_other(level: float):
    """By the angle between the losses over what T ranges evenly over, up to a constant and a line.

    What the parameters of the model absorb is no loss of any level.
    """
    sizes = Sizes({"T": 330.0}, {"T": 340.0}, (0.0, 200.0), 5.0, ranges={"T": (320.0, 340.0)})
    losses = [e for e in catalogue(vessel(), sizes, {}) if e.key == ("quadratic_damping", "heat")]
    T = np.linspace(320.0, 340.0, 201)
    known = np.column_stack([np.ones_like(T), T - 330.0])

    def acts(about: float) -> np.ndarray:
        of = np.abs(T - about) * (T - about)
        left = of - known @ np.linalg.lstsq(known, of, rcond=None)[0]
        return left / np.linalg.norm(left)

    levels = [e.parameters[1].start for e in losses]
    assert len(levels) == 3
    assert max(abs(float(acts(level) @ acts(each))) for each in levels) > np.cos(np.radians(35.0))


def test_a_loss_of_what_all_of_the_balance_vanishes_with_goes_to_zero():
    """The parabola of a level far below all that there is would be the line of a death rate."""
    m = casid.Model("cells")
    X, D = m.state("X", "kg/m^3", start=2.0), m.input("D", "1/s")
    m.balance(X, "growth", inertia=1, terms=[m.parameter("mu", "1/s", start=1e-4) * X, -D * X])
    m.output("cells", X, "kg/m^3")
    sizes = Sizes({"X": 2.0}, {"cells": 4.0}, (0.0, 1e4), 10.0, ranges={"X": (1.0, 4.0)})
    losses = [e for e in catalogue(m, sizes, {}) if e.kind == "quadratic_damping"]
    assert [[p.name for p in e.parameters] for e in losses] == [["d_2"]]
