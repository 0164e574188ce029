"""Parts that swing along, and may already do so when a record begins."""

from __future__ import annotations

from collections.abc import Sequence

from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate, found_values, name_of
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.diagnosis.settings import Progress
from casid.model.effects.balances.missing_parts import missing_mode
from casid.model.effects.effect import Effect
from casid.model.effects.search_ranges import MISSING_MODES
from casid.model.model import Model


def is_swinging_from_rest(effect: Effect) -> bool:
    """True of a part that swings, and is taken to be at rest when a record begins."""
    return effect.kind == "missing_mode" and effect.cost == MISSING_MODES.cost


def may_move(found: Candidate) -> bool:
    """True of a part, found at rest, that has a motion: without a mass it has no frequency."""
    return is_swinging_from_rest(found.effect) and found.names[1] in found.fit.values


def in_motion(model: Model, found: Candidate) -> Effect:
    """The part with a free initial motion, starting from the frequency that was found."""
    omega = found.fit.values[found.names[1]]
    return missing_mode(model, found.effect.where, omega, at_rest=False)


def beside_lines(
    refitting: Refitting, at: Weighted, found: Sequence[Candidate], progress: Progress
) -> list[Candidate]:
    """Candidates with parts in motion, where a line of the spectrum explains more than at rest.

    A part that swung before the record rings at its own frequency, as a periodic force does.
    Elsewhere it begins at rest: free to begin anyhow, it imitates laws by its own decay. A part
    that was found without a mass has no frequency, and stays as it is.
    """
    if max(found, key=lambda c: c.merit).effect.kind != "periodic_disturbance":
        return list(found)
    out = []
    for c in found:
        if may_move(c):
            progress(f"let {name_of(c.effect)} move when the record begins")
            values = found_values(c)
            free = in_motion(at.model, c)
            step = values[free.parameters[0].name]
            new = refitting.refit(at, free, step, starts=values, near=True)
            c = new if new is not None and new.merit > c.merit else c
        out.append(c)
    return out
