"""Resistances that grow with the flow: eddies in a pipe, an airway or an orifice.

Where a model has a flow as a drop over a resistance, q = dp / R, both in a balance and in what a
meter shows, no term of the balance alone changes both. With dp = R q + R_2 |q| q (Forchheimer's
law of porous media, Rohrer's of airways) the resistance is

    R + R_2 |q| = R/2 + (R^2/4 + R_2 |dp|)^(1/2)                                               (1)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import casadi as ca

from casid.model.declarations import Parameter
from casid.model.effects.effect import Effect
from casid.model.effects.places.place import in_symbols_of, is_zero
from casid.model.model import Model
from casid.model.units import declared_quotient, same_dimension, unit_quotient


def growing_resistance(model: Model, name: str) -> Effect | None:
    """(1) for a parameter R, or its inverse for a conductance k of q = k dp.

    None where the parameter is in no balance, in more than one flow, or no output shows the flow.
    """
    p, symbol = model.parameters[name], model.symbol(name)
    slopes = {n: ca.jacobian(ca.SX(b.total), symbol) for n, b in model.balances.items()}
    inside = [n for n, slope in slopes.items() if slope.nnz()]
    shown = _showing(model, name)
    if not inside or not shown:
        return None
    first = slopes[inside[0]]
    is_conductance = not any(ca.which_depends(first, symbol))
    drop = first if is_conductance else first * symbol**2
    if any(ca.which_depends(drop, symbol)) and not is_zero(ca.jacobian(drop, symbol)):
        return None
    if not all(is_zero(slopes[n] - first) or is_zero(slopes[n] + first) for n in inside[1:]):
        return None
    flow, unit, own = model.balances[inside[0]].unit, p.unit, model.unit_of(name)
    if is_conductance:
        unit, own = unit_quotient("1", unit), declared_quotient("1", own)
    R_2 = Parameter(f"slope_{name}_{shown}", unit_quotient(unit, flow), 0.0, lower=0.0)
    is_shown_as_it_flows = same_dimension(model.outputs[shown][1], flow)

    def apply(new: Model, names: Sequence[str]) -> None:
        value, r = new.symbol(name), new.symbol(names[0])
        dp = in_symbols_of(new, ca.fabs(drop))
        if is_conductance:
            law = 2 * value / (1 + ca.sqrt(1 + 4 * r * dp * value**2))
        else:
            law = value / 2 + ca.sqrt(value**2 / 4 + r * dp)
        new.substitute_symbol(name, law)

    resistance = f"1/{name}" if is_conductance else name
    return Effect(
        "scheduled_parameter",
        f"{name}~{shown}",
        (R_2,),
        apply,
        sided="positive",
        priority=-1,  # the law of a flow, as a power law
        description=f"the resistance {resistance} grows with the size of the flow, {shown}",
        declared_units={R_2.name: declared_quotient(own, model.unit_of(shown))}
        if is_shown_as_it_flows
        else {},
    )


def growing_resistances_of(model: Model) -> Iterator[Effect]:
    """Those of all parameters that are not exact."""
    found = (growing_resistance(model, n) for n, p in model.parameters.items() if not p.is_constant)
    return (effect for effect in found if effect is not None)


def _showing(model: Model, name: str) -> str | None:
    """The first output that is a flow with states in it over a resistance, or by a conductance."""
    symbol = model.symbol(name)
    states = ca.vertcat(*[model.symbol(n) for n in model.states])
    for output, (expression, _) in model.outputs.items():
        e = ca.SX(expression)
        slope = ca.jacobian(e, symbol)
        if slope.nnz() and any(ca.which_depends(slope, states)):
            if is_zero(e + slope * symbol) or is_zero(e - slope * symbol):
                return output
    return None
