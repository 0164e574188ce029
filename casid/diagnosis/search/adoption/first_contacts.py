"""Where a command with play stands in it when the records begin.

No sample shows it: what acts may stand anywhere between the two contacts until the command has
crossed the play for the first time, and a slow system remembers where it stood. Play is first found
as if the command had been in its middle; what that errs by at the beginning looks like a further
part.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from casid.diagnosis.search.adoption.refinement import Adoption, Refinement
from casid.diagnosis.search.candidates import name_of
from casid.model.effects.channels.actuator_effects import input_backlash
from casid.model.effects.effect import Effect
from casid.model.effects.search_ranges import ACTUATORS
from casid.model.model import Model


def with_first_contact(refine: Refinement, found: Adoption) -> Adoption:
    """With the play adopted last begun where that is likeliest, by Schwarz's criterion.

    `found` itself where the last cause is no play of a command, or its middle is as likely.
    """
    last = found.adopted[-1].candidate
    if found.fit is None or not _is_played(refine.start.model, last.effect):
        return found
    refine.search.progress(f"place {name_of(last.effect)} when the record begins")
    if refine.search.weighing.takes_disturbances:
        return refine.if_likelier(found, partial(_begun_where_likeliest, refine))
    return _begun_where_likeliest(refine, found)


def _begun_where_likeliest(refine: Refinement, found: Adoption) -> Adoption:
    """Of the least simulation error, where that pays for one more number."""
    last, fit = found.adopted[-1].candidate, found.fit
    assert fit is not None
    causes = [a.candidate for a in found.adopted]
    begun = []
    for begins in ACTUATORS.begins:
        effect = _begun_at(refine.start.model, last.effect, begins)
        begun.append(refine.with_causes([*causes[:-1], replace(last, effect=effect)], fit))
    placed, best = min(begun, key=lambda tried: tried[1].solution.value)
    if not best.solution.value < fit.solution.value:
        return found
    return refine.if_worth(found, placed, best, 1)


def _is_played(model: Model, effect: Effect) -> bool:
    """True of play that a command of the model acts through."""
    return effect.kind == "backlash" and effect.where in model.inputs


def _begun_at(model: Model, effect: Effect, begins: float) -> Effect:
    """The same play, with what acts so many gaps beside the command as the records begin."""
    assert effect.limit is not None
    least = effect.constants["least"]
    return input_backlash(model, effect.where, effect.limit, least=least, begins=begins)
