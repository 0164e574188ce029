"""Forces that nobody recorded: where they may act in a model, and what they are called.

A force acts in a balance. Where outputs are more than balances, it may act in a stated rate as
well: the height of a road moves the travel of a suspension, z' = v - (its rate), beside the body's
speed. Whatever acts in one balance alone moves two outputs in proportion, frequency by frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from casid.model.declarations import Input
from casid.model.model import Model
from casid.model.units import difference_from_si, unit_quotient


def places_of_forces(model: Model) -> tuple[str, ...]:
    """The balances; with more outputs than these, the states of stated rates, too."""
    if len(model.outputs) <= max(len(model.balances), 1):
        return tuple(model.balances)
    taken = {*model.balances, *model.inputs, *model.outputs}
    rates = [n for n in model._rates if n not in taken and not model.states[n].is_added]
    return (*model.balances, *rates)


def unit_of_force(model: Model, place: str) -> str:
    """The unit of what acts in a balance, beside an input, or in the rate of a state."""
    if place in model.balances:
        return model.balances[place].unit
    if place in model.inputs:
        return model.inputs[place].unit
    return unit_quotient(model.states[place].unit, "s")


def shown_force(model: Model, place: str, size: float) -> tuple[float, str]:
    """The size of what acts there, given in SI, and its unit as the model declares it."""
    unit = unit_of_force(model, place)
    if place in model.balances:
        unit = model.balances[place].shown_unit
    elif place in model.inputs:
        unit = model.unit_of(place)
    return float(difference_from_si(size, unit)), unit


def name_of_force(place: str) -> str:
    """The input that `with_forces` adds for a place."""
    return f"disturbance of {place}"


def with_forces(model: Model, places: Sequence[str], kind: Literal["measured", "unknown"]) -> Model:
    """A copy with one more input in each of these balances and rates, in their order."""
    new = model.copy()
    for place in places:
        w = new.add_input(Input(name_of_force(place), unit_of_force(model, place), kind))
        if place in model.balances:
            new.add_term(place, w)
        else:
            new.add_rate(place, w)
    return new
