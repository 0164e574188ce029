"""Cogging: a force that is periodic in a position, of unknown period, amplitude and phase."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from casid.model.declarations import Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.effect import Effect
from casid.model.effects.places.place import Place
from casid.model.effects.places.places import place_named
from casid.model.effects.search_ranges import PERIODIC_FORCES
from casid.model.model import Model
from casid.model.units import same_dimension


def cogging(
    model: Model, where: str | Place, pitch: float, span: float, middle: float = 0.0
) -> Effect | None:
    """a_cos cos(2 pi (q - q_0) / pitch) + a_sin sin(..) along a place with a position q.

    Slots of a motor, teeth of a gear, a screw that is not straight. The period of an angle with a
    whole number of teeth in a turn is known; any other is estimated near `pitch`, within half a
    line, pitch^2 / (2 span), more than which would be another period. Without amplitudes it does
    nothing: start them from their score. It costs as much as a sinusoid in time, the searched
    period as three parameters (`periodic_disturbance`).

    Parameters
    ----------
    pitch, span, middle : period, range of the motion and its middle q_0 (position's SI unit).
    """
    place = place_named(model, where)
    if place.position is None:
        return None
    q = place.position - carrying_unit(middle) if middle else place.position
    half = 0.5 * pitch**2 / span

    def apply(new: Model, names: Sequence[str]) -> None:
        a, b, period = (new.symbol(n) for n in names)
        turn = 2 * ca.pi * q / period
        place.add(new, a * ca.cos(turn) + b * ca.sin(turn))

    lower = max(pitch - half, PERIODIC_FORCES.lowest * pitch)
    teeth = 2 * np.pi / pitch
    is_angle = same_dimension(place.position_unit, "rad")
    whole = pitch if is_angle and abs(teeth - round(teeth)) < 1e-9 * teeth else None
    parameters = (
        Parameter("a_cos", place.unit, 0.0),
        Parameter("a_sin", place.unit, 0.0),
        Parameter("pitch", place.position_unit, pitch, lower, pitch + half, whole),
    )
    return Effect(
        "cogging",
        place.where,
        parameters,
        apply,
        test="peak",
        variant=pitch,
        cost=PERIODIC_FORCES.cost,
        description=place.words,
        constants={"middle": middle, "pitch": pitch},
    )
