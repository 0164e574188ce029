"""Neighbours without a name: each is the model at its null value, and none another's double."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.records.signal_sizes import sizes_of
from casid.diagnosis.evidence.scores.score_tests import score_test
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.dimensions import check_units
from casid.model.effects.balances.flow_laws import power_law
from casid.model.effects.balances.unnamed_effects import (
    linear_loss,
    missing_links,
    saturating_force,
    unnamed_effects,
    uptakes_of,
)
from casid.model.effects.catalogue import catalogue
from casid.model.effects.effect import KINDS, Effect, Sizes
from casid.model.effects.places.elements import elements_of
from casid.model.units import unit_quotient
from problems import pendulum
from tests.model.effects.balances.test_flow_laws import LEVEL, tanks


def both() -> list[tuple[casid.Model, Effect]]:
    model, system = pendulum.problem.model, tanks()
    out = [(model, e) for e in unnamed_effects(model, "torque", 0.01)]
    out += [(system, e) for b in system.balances for e in unnamed_effects(system, b, 0.01)]
    laws = [power_law(system, h, LEVEL) for h in ("h1", "h2")]
    return out + [(system, law) for law in laws if law is not None]


@pytest.mark.parametrize(("model", "effect"), both(), ids=repr)
def test_at_its_null_value_a_decoy_is_nothing_and_its_units_agree(
    model: casid.Model, effect: Effect
):
    extended = model.extend(effect)
    check_units(extended)
    e, base = extended.explicit(), model.explicit()
    rng = np.random.default_rng(2)
    x, u, p = (rng.uniform(0.2, 1.5, v.numel()) for v in (base.x, base.u, base.p))
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])(x, u, [*p, effect.parameters[0].start])
    before = ca.Function("f", [base.x, base.u, base.p], [base.f])(x, u, p)
    assert np.allclose(f.full(), before.full(), rtol=1e-13, atol=1e-13)


def test_decoys_are_unknown_each_by_its_shape():
    for _, effect in both():
        assert effect.kind == "unknown"
        assert effect.shape
        assert effect.description.startswith(("a torque ", "a flow "))
    found = unnamed_effects(pendulum.problem.model, "torque", 0.01)
    assert len({e.key for e in found}) == len(found) == 5
    assert found[0].key == ("unknown", "torque: p^2")
    assert "unknown" in KINDS


def test_a_tank_has_no_position_and_no_decoys_of_one():
    shapes = {e.shape for e in unnamed_effects(tanks(), "upper", 0.01)}
    assert shapes == {"h1^2", "sqrt|h1|"}


def test_no_two_effects_of_the_pendulums_torque_have_one_signature():
    """Cosines of whitened signatures, the baseline's tangent projected off: |c| = 1 is a double."""
    record = pendulum.simulate(duration=20.0, seed=3)
    experiments = [casid.Experiment(record, {}, "r")]
    model = pendulum.problem.model.with_known(m=0.0)
    fit = fit_model(model, experiments, FitSettings(starts=1))
    at = Weighing(experiments).weigh(model, fit, rounds=1)
    every = [e for e in catalogue(model, sizes_of(at, {}), {}) if e.key[1].startswith("torque")]
    every = [e for e in every if e.kind != "offset"]  # the initial angle absorbs it
    table = score_test(at.fit, every, input_sd=at.input_sd, draws=200)
    assert len(every) >= 11
    assert min(s.visible for s in table.scores) > 1e-4
    c = np.abs(table.cosines - np.eye(len(every)))
    assert np.max(c) < 0.99


@pytest.mark.parametrize(
    ("unit", "inertia", "words"),
    [("mol/m^3", "m^3", "an amount flow in"), ("K", "J/K", "a heat flow in")],
)
def test_a_loss_has_the_article_of_its_quantity(unit: str, inertia: str, words: str):
    m = casid.Model("store")
    x = m.state("x", unit)
    flow = m.input("flow", "mol/s" if unit == "mol/m^3" else "W")
    m.balance(x, "content", inertia=m.constant("V", 1.0, inertia), terms=[flow])
    m.output("y", x, unit)
    loss = linear_loss(m, "content", 0.0)
    assert loss is not None
    assert loss.description.startswith(words)


@pytest.mark.parametrize("room", [-200.0, 290.0, 320.0, 330.0, 338.0, 345.0, 900.0])
def test_one_of_the_losses_acts_much_as_any_other_wherever_it_vanishes(room: float):
    """The angle of T - room and T - level over what T ranges evenly over, for the nearest level."""
    m = casid.Model("vessel")
    T = m.state("T", "K")
    C = m.constant("C", 8e4, "J/K")
    m.balance(T, "vessel", inertia=C, terms=[m.input("P", "W")])
    m.output("T_m", T, "K")
    course = np.linspace(320.0, 340.0, 201)
    sizes = Sizes({"T": 330.0}, {"T_m": 340.0}, (0.0, 1e4), 10.0, ranges={"T": (320.0, 340.0)})
    losses = [e for e in catalogue(m, sizes, {}) if e.key == ("unknown", "vessel: T")]
    levels = [e.parameters[1].start for e in losses]
    wanted = (course - room) / np.linalg.norm(course - room)
    acts = [(course - level) / np.linalg.norm(course - level) for level in levels]
    assert max(abs(float(wanted @ each)) for each in acts) > np.cos(np.radians(22.0))


@pytest.mark.parametrize("has_zero", [True, False])
def test_what_leaks_from_a_store_with_a_natural_zero_is_a_loss_of_one_number(has_zero: bool):
    """A term of the balance that vanishes with the pressure tells that its zero means empty."""
    m = casid.Model("receiver")
    p, u, q = m.state("p", "Pa"), m.input("u", "%"), m.input("q", "m^3/s")
    K = m.parameter("K", "m^3/(s Pa)", start=1e-9)
    ambient = 0.0 if has_zero else m.constant("p_a", 1e5, "Pa")
    V = m.constant("V", 1e-7, "m^3/Pa")
    m.balance(p, "mass", inertia=V, terms=[q, -K * u * (p - ambient)])
    m.output("p_m", p, "Pa")
    sizes = Sizes({"p": 5e5}, {"p_m": 6e5}, (0.0, 1e2), 1.0, ranges={"p": (4e5, 6e5)})
    losses = [e for e in catalogue(m, sizes, {}) if e.key == ("unknown", "mass: p")]
    assert any(len(e.parameters) == 1 for e in losses) is has_zero


def belt() -> casid.Model:
    """Two pulleys and a belt that drives the second in proportion to its slip."""
    m = casid.Model("belt")
    w1, w2 = m.state("w1", "rad/s"), m.state("w2", "rad/s")
    T = m.input("T", "N m", hold="zoh", known=True)
    b, d = (m.parameter(n, "N m s/rad", start=0.5, lower=0.0) for n in ("b", "d"))
    m.balance(w1, "motor", inertia=m.constant("J1", 0.02, "kg m^2"), terms=[T, -b * (w1 - w2)])
    m.balance(w2, "load", inertia=m.constant("J2", 0.1, "kg m^2"), terms=[b * (w1 - w2), -d * w2])
    m.output("n1", w1, "rad/s")
    m.output("n2", w2, "rad/s")
    return m


def test_the_torque_of_a_slipping_belt_levels_off_in_both_balances():
    model = belt()
    effect = saturating_force(model, "w1-w2", 4.0)
    assert effect is not None
    assert effect.key == ("unknown", "w1-w2: (w1-w2)/sqrt(1+r(w1-w2)^2)")
    check_units(model.extend(effect))
    extended, (r,) = effect.extended(model)
    e = extended.explicit()
    values = {"J1": 0.02, "J2": 0.1, "b": 0.5, "d": 0.0, r: 0.03}
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    for slip in (4.0, -9.0, 1e4):
        torque = 0.5 * slip * np.sqrt((1 + 0.03 * 16.0) / (1 + 0.03 * slip**2))
        found = np.ravel(f([slip, 0.0], [0.0], [values[n] for n in e.parameters]))
        assert found == pytest.approx([-torque / 0.02, torque / 0.1], rel=1e-9)


def test_only_damping_between_two_bodies_has_a_torque_that_levels_off():
    assert saturating_force(belt(), "load", 4.0) is None
    assert saturating_force(tanks(), "upper", 4.0) is None
    sizes = Sizes({"w1": 9.0, "w2": 5.0}, {"n1": 9.0, "n2": 9.0}, (0.0, 9.0), 1.0)
    keys = {e.key for e in catalogue(belt(), sizes, {})}
    assert ("unknown", "w1-w2: (w1-w2)/sqrt(1+r(w1-w2)^2)") in keys


@pytest.mark.parametrize(("least", "rate"), [(0.0, 0.0), (2.0, -0.05 * 5.0)])
def test_what_cells_use_beside_growth_ends_where_the_sugar_is_used_up(least: float, rate: float):
    """Concentrations are nonnegative: at zero their rate is not below it (Chellaboina et al. 2009).

    Where the record stays away from zero the uptake is in proportion to the cells alone.
    """
    m = casid.Model("batch")
    X, S = m.state("X", "kg/m^3"), m.state("S", "kg/m^3")
    mu, K, Y = m.parameter("mu", "1/s"), m.parameter("K", "kg/m^3"), m.parameter("Y", "1")
    growth = mu * S / (K + S) * X
    m.balance(X, "biomass", inertia=1, terms=[growth], unit="kg/(m^3 s)")
    m.balance(S, "sugar", inertia=1, terms=[-growth / Y], unit="kg/(m^3 s)")
    m.output("X", X, "kg/m^3")
    (effect,) = (e for e in uptakes_of(m, {"X": (0.5, 60.0), "S": (least, 18.0)}) if e.shape == "X")
    assert effect.where == "sugar"
    e = m.extend(effect).explicit()
    f = ca.Function("f", [e.x, e.p], [e.f])
    assert f([5.0, 0.0], [0.3, 0.5, 0.4, 0.05]).full().ravel() == pytest.approx([0.0, rate])
    # Of a fiftieth of the largest amount the part that is left out is 1 %: 1 - (1 + 0.15^2)^-1/2.
    growing = 0.3 * 0.36 / 0.86 * 5.0
    used = f([5.0, 0.36], [0.3, 0.5, 0.4, 0.05]).full()[1]
    assert used == pytest.approx(-growing / 0.4 - 0.05 * 5.0, abs=0.25 * 0.0112)


def stores(level: str, flow: str, *, joined: bool = False) -> casid.Model:
    """Two stores that are filled each by itself, joined by a conductance where that is asked."""
    m = casid.Model("two stores")
    a, b = m.state("a", level), m.state("b", level)
    u, w = m.input("u", flow, known=True), m.input("w", flow, known=True)
    one, other = (
        m.parameter(c, unit_quotient(flow, unit_quotient(level, "s")), start=2.0)
        for c in ("C_a", "C_b")
    )
    G = m.parameter("G", unit_quotient(flow, level), start=0.1)
    leak = G * (a - b) if joined else 0.0
    m.balance(a, "first", inertia=one, terms=[u, -leak], unit=flow)
    m.balance(b, "second", inertia=other, terms=[w, leak], unit=flow)
    m.output("a", a, level)
    m.output("b", b, level)
    return m


@pytest.mark.parametrize(("level", "flow"), [("Pa", "m^3/s"), ("K", "W"), ("m", "m^3/s")])
def test_stores_that_nothing_joins_may_exchange_from_the_higher_level_to_the_lower(level, flow):
    """What leaves the one arrives in the other: the sum of both balances is the model's."""
    m = stores(level, flow)
    (link,) = missing_links(m, elements_of(m))
    assert (link.kind, link.where, link.sided) == ("unknown", "a-b", "positive")
    check_units(m.extend(link))
    (base, f), (_, g) = (
        (e, ca.Function("f", [e.x, e.u, e.p], [e.f]))
        for e in (m.explicit(), m.extend(link).explicit())
    )
    x, u, p = [5.0, 2.0], [0.3, 0.7], [2.0, 4.0, 0.1][: base.p.numel()]
    change = (g(x, u, [*p, 0.5]) - f(x, u, p)).full().ravel()
    assert p[0] * change[0] == pytest.approx(-0.5 * (5.0 - 2.0))
    assert p[0] * change[0] + p[1] * change[1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    "model",
    [stores("K", "W", joined=True), stores("kg/m^3", "kg/s"), stores("K", "K"), stores("K", "K/s"),
     stores("A", "V"), stores("m/s", "N")],
)  # fmt: skip
def test_bodies_concentrations_lags_and_stores_that_are_joined_have_no_missing_link(model):
    """The amounts in which concentrations, lags or rates of change are exchanged are not known."""
    assert not list(missing_links(model, elements_of(model)))
