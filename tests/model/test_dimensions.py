"""Units of a model: like is added to like, functions take numbers, and a slip is named."""

from __future__ import annotations

import casadi as ca
import pytest

from casid.errors import ModelError
from casid.model.dimensions import check_units, dimension_of
from casid.model.model import Model
from casid.model.units import parse_unit


def dimension(make, **units):
    symbols = {name: ca.SX.sym(name) for name in units}
    return dimension_of(make(**symbols), list(symbols.values()), units)


@pytest.mark.parametrize(
    ("make", "units", "result"),
    [
        (lambda m, a: m * a, {"m": "kg", "a": "m/s^2"}, "N"),
        (lambda k, x: k * x**2 / 2, {"k": "N/m", "x": "m"}, "J"),
        (lambda k, m: ca.sqrt(k / m), {"k": "N/m", "m": "kg"}, "rad/s"),
        (lambda v, c: c * ca.fabs(v) * v, {"v": "m/s", "c": "N s^2/m^2"}, "N"),
        (lambda F, v, w: F * ca.tanh(v / w), {"F": "N", "v": "m/s", "w": "m/s"}, "N"),
        (lambda x, y: ca.atan2(x, y), {"x": "m", "y": "m"}, "1"),
        (lambda x, y: ca.fmax(x, 0.0) + y, {"x": "m", "y": "m"}, "m"),
        (lambda x, n: ca.if_else(n > 0, x, -x), {"x": "m", "n": "1"}, "m"),
    ],
)
def test_the_dimension_of_an_expression_follows_from_its_symbols(make, units, result):
    assert dimension(make, **units) == tuple(parse_unit(result).dimension)


def test_a_number_with_many_digits_may_carry_any_dimension():
    """9.81 may be gravity; 2 or 1/2 is a number."""
    assert dimension(lambda x: 9.81 * x, x="m") is None
    assert dimension(lambda x: 2 * x, x="m") == tuple(parse_unit("m").dimension)


def model(term, *, inertia=None, position_rate=None, output_unit="rad") -> Model:
    m = Model("pendulum")
    phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    symbols = {
        "phi": phi,
        "p": p,
        "k": m.parameter("k", "N m/rad"),
        "d": m.parameter("d", "N m s/rad"),
        "I": m.parameter("I", "kg m^2"),
        "M": m.parameter("M", "kg"),
    }
    m.derivative(phi, p if position_rate is None else position_rate(symbols))
    m.balance(
        p,
        "torque",
        inertia=symbols["I"] if inertia is None else inertia(symbols),
        terms=[-symbols["k"] * phi, term(symbols)],
    )
    m.output("angle", phi, output_unit)
    return m


def test_a_consistent_model_passes():
    check_units(model(lambda s: -s["d"] * s["p"]))


@pytest.mark.parametrize(
    ("build", "what"),
    [
        (lambda: model(lambda s: -s["d"] * s["phi"]), r"term 2 of balance 'torque'.*should be in"),
        (lambda: model(lambda s: -s["k"] * s["p"]), r"term 2 of balance 'torque'.*correct the"),
        (
            lambda: model(lambda s: -s["d"] * s["p"], inertia=lambda s: s["M"]),
            r"inertia times d\(p\)/dt.*balance 'torque'.*correct the",
        ),
        (
            lambda: model(lambda s: -s["d"] * s["p"], position_rate=lambda s: s["phi"]),
            r"the derivative of phi.*correct the expression or a declared unit",
        ),
        (
            lambda: model(lambda s: -s["d"] * s["p"], output_unit="m"),
            r"output 'angle'.*should be in m",
        ),
        (
            lambda: model(lambda s: s["d"] * s["p"] + s["k"] * s["p"]),
            r"term 2 of balance 'torque' adds .* to .*check the units of its symbols",
        ),
        (
            lambda: model(lambda s: s["k"] * ca.sin(s["M"])),
            r"term 2 of balance 'torque' takes sin of .*check the units",
        ),
        (
            lambda: model(lambda s: s["k"] * s["M"] ** s["phi"]),
            r"raises .* to a power that is not a number",
        ),
    ],
)
def test_a_slip_in_the_units_is_refused_with_its_place(build, what):
    with pytest.raises(ModelError, match=what):
        check_units(build())


def valve(least, of_c="m^3/(s Pa)"):
    """A flow that follows the square root of a pressure, which stands twice in its balance."""
    m = Model("valve")
    p = m.state("p", "Pa")
    C, c = m.parameter("C", "m^3/Pa"), m.parameter("c", of_c)
    kept = ca.fmax(p, least)
    m.balance(p, "flow", inertia=C, terms=[-c * kept * kept / (kept + p)], unit="m^3/s")
    m.output("pressure", p, "Pa")
    return m


def test_a_bare_number_beside_a_pressure_is_named_with_the_way_to_give_it_a_unit():
    remedy = (
        r"term 1 of balance 'flow' takes the maximum of kg/\(m s\^2\) and the bare number 1000: "
        r".*; a bare number is dimensionless.*m.constant\(\"name\", 1000, \"Pa\"\)"
    )
    with pytest.raises(ModelError, match=remedy) as refused:
        check_units(valve(1e3))
    assert "max(p, 1000) + p" in str(refused.value)


def test_messages_show_an_expression_whole_where_a_part_stands_in_it_twice():
    """CasADi prints such a part as @1, which is none of the user's names."""
    assert "max(p, 0) ^ 2 / (max(p, 0) + p)" in str(valve(0.0))
    with pytest.raises(ModelError, match=r"max\(p, 0\) \^ 2 / \(max\(p, 0\) \+ p\); correct"):
        check_units(valve(0.0, of_c="m^3/s"))


def test_a_slip_in_an_eliminating_output_is_refused():
    m = Model("cart")
    v, w = m.state("v", "m/s"), m.unknown_input("w", "N")
    M = m.parameter("M", "kg")
    m.balance(v, "force", inertia=M, terms=[w])
    m.output("v", v, "m/s")
    m.output("gauge", w + v, "N")
    with pytest.raises(ModelError, match=r"output 'gauge' that eliminates w adds"):
        check_units(m.eliminate(w, using="gauge"))
