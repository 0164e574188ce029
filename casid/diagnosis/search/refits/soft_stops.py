"""Stops that are far softer than the spring beside them.

Usually such a stop imitates a spring that hardens, like the righting arm of a ship. A real stop has
a corner where its force begins: it is likelier than the same stop with a rounded corner, and than
all other laws of its place. While the noise model absorbs the misfit of something else, a corner
may compensate that: such a stop is a cause only if the residual with it is noise alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate, found_values, name_of
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.diagnosis.settings import Progress
from casid.diagnosis.thresholds import COMPARISON, STOPS
from casid.model.effects.balances.balance_effects import stiffness_of
from casid.model.effects.balances.contact_effects import rounded_stop
from casid.model.effects.places.places import place_named


def is_soft_stop(at: Weighted, found: Candidate) -> bool:
    """True of a stop that is far softer than the spring beside it.

    Both in the unit of the place over its position's; at the parameters found.
    """
    if found.effect.kind != "end_stop":
        return False
    place = place_named(at.model, found.effect.where)
    spring = stiffness_of(at.model, place) if place.is_mechanical else None
    if spring is None:
        return False
    symbols = ca.symvar(spring)
    values = [found.fit.values.get(s.name(), 0.0) for s in symbols]
    own = float(ca.substitute(spring, ca.vertcat(ca.SX(0, 1), *symbols), ca.DM(values)))
    return found.fit.values[found.names[0]] < STOPS.soft * own


def without_soft_stops(
    refitting: Refitting, at: Weighted, found: Sequence[Candidate], progress: Progress
) -> list[Candidate]:
    """Candidates without the soft stops that have no corner: springs that harden."""

    def has_corner(stop: Candidate) -> bool:
        """True if the stop with a rounded corner, or another effect there, gains clearly less."""
        others = [c for c in found if c.effect.where == stop.effect.where and c is not stop]
        least = stop.merit - COMPARISON.strong
        if any(c.merit > least for c in others):
            return False
        progress(f"round the corner of {name_of(stop.effect)}")
        values = found_values(stop)
        first, limit, *_ = stop.effect.parameters
        smooth = rounded_stop(at.model, stop.effect, STOPS.rounded * abs(values[limit.name]))
        step = values[first.name] - first.start
        other = refitting.refit(at, smooth, step, starts=values, near=True)
        return other is not None and other.merit < least

    return [c for c in found if not is_soft_stop(at, c) or has_corner(c)]
