"""The law by which an output shows a state: a straight line in the model, a bend at one end of it.

What a sensor shows has physics of its own where the output has a parameter that no equation of
motion has: the voltage of a cell is E_0 + k z of its charge z, and falls off steeply as the cell
runs empty. An error of the sensor would go with what it reads; this goes with the state, whatever
else the output shows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import casadi as ca

from casid.model.declarations import Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.effect import Effect, Motion, Sizes, known_while_null
from casid.model.effects.search_ranges import BENDS, UNNAMED_EFFECTS
from casid.model.model import Model

Expr = Any  # a CasADi expression


def bend(
    model: Model, channel: str, state: str, motion: Motion, share: float, *, is_at_least: bool
) -> Effect:
    """An output that also shows c exp(-(x - x_e)/w) of a state x: a knee, or a gentle curve.

    x_e is the least value of x in the records, or its largest, with exp((x - x_e)/w) there, so that
    c is what the output shows more at that end. A w far beyond the range of x makes a parabola of
    it. Beyond `BENDS.grows` the exponential goes on straight: no simulation overflows. The null
    value is c = 0. Without an established name: a kind of its own would say what physics it is.

    Parameters
    ----------
    motion : of x in the records.
    share : of the range of x, from which w is searched.
    is_at_least : whether x_e is the least value of x.
    """
    unit, of = model.outputs[channel][1], model.symbol_units[state]
    reach = motion.high - motion.low
    end = carrying_unit(motion.low if is_at_least else motion.high)
    low, high = (bound * reach for bound in BENDS.widths)
    size = Parameter(f"bend_{channel}_{state}", unit, 0.0)
    width = Parameter(f"width_{channel}_{state}", of, share * reach, lower=low, upper=high)

    def apply(new: Model, names: Sequence[str]) -> None:
        known_while_null(new, names)
        expression, own = new.outputs[channel]
        x, w = new.symbol(state), new.symbol(names[1])
        beyond = ((end - x) if is_at_least else (x - end)) / w
        capped = ca.fmin(beyond, BENDS.grows)
        shown = ca.exp(capped) * (1 + beyond - capped)
        new.replace_output(channel, expression + new.symbol(names[0]) * shown, own)

    sign, where = ("-", "least") if is_at_least else ("", "largest")
    return Effect(
        "unknown",
        channel,
        (size, width),
        apply,
        priority=UNNAMED_EFFECTS.priority,
        cost=2,
        shape=f"exp({sign}{state}/w)",
        description=f"what {channel} shows of {state} bends at the {where} {state}, by "
        f"exp({sign}{state}/{width.name}); {size.name} is what it does there",
        constants={"edge": motion.low if is_at_least else motion.high},
        declared_units={width.name: model.declared_units.get(state, of)},
    )


def bends_of(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """The bends of what outputs show of states by parameters of their own, at either end."""
    for channel in model.outputs:
        for state in _shown_by_own_parameters(model, channel):
            motion = sizes.motion_of(model.symbol(state))
            if motion.high > motion.low:
                for is_at_least in (True, False):
                    for share in BENDS.starts:
                        yield bend(model, channel, state, motion, share, is_at_least=is_at_least)


def _shown_by_own_parameters(model: Model, channel: str) -> list[str]:
    """States that an output shows by a factor that no equation of motion has."""
    moving = [*model._rates.values(), *(b.inertia for b in model.balances.values())]
    moving += [b.total for b in model.balances.values()]
    shared = {s.name() for s in ca.symvar(ca.SX(ca.vertcat(*moving)))}
    shown = ca.SX(model.outputs[channel][0])
    own = [model.symbol(n) for n in model.parameters if n not in shared]
    states = ca.vertcat(*(model.symbol(n) for n in model.states))
    slopes = ca.jacobian(shown, states)
    felt = [slopes[0, i] for i in range(len(model.states))]
    return [
        name
        for name, slope in zip(model.states, felt, strict=True)
        if any(any(ca.which_depends(slope, p)) for p in own)
    ]
