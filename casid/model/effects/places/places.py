"""Where a missing force may act: in one balance, or on a relative motion between several.

A term that stands in two balances up to a constant factor (-1, a gear ratio, a lever arm) is an
element: a spring, a damper, a conductance between two bodies or stores. Its argument is the
coordinate of the element, x1 - x2 or T1 - T2, and whatever else acts there acts in the same
balances with the same factors. A term of one balance in a motion relative to an input that moves
(a road, an ambient temperature), or to another body, has such a coordinate too.
"""

from __future__ import annotations

from casid.errors import ModelError, nearest
from casid.model.effects.places.elements import elements_of
from casid.model.effects.places.place import Place, balance_place
from casid.model.effects.places.planes import planes_of
from casid.model.model import Model


def places_of(model: Model) -> list[Place]:
    """Every balance, and every relative motion that a term of the model acts on."""
    return [*(balance_place(model, name) for name in model.balances), *elements_of(model)]


def place_named(model: Model, where: str | Place) -> Place:
    """The place of this name in a model.

    Raises
    ------
    ModelError
        If the model has no such balance and no such relative motion.
    """
    if isinstance(where, Place):
        return where
    if where in model.balances:
        return balance_place(model, where)
    elements = elements_of(model)
    found = {p.where: p for p in (*elements, *planes_of(model, elements))}
    if where not in found:
        places = [*model.balances, *found]
        raise ModelError(
            f"{model.name} has no balance and no relative motion {where!r}{nearest(where, places)}"
        )
    return found[where]
