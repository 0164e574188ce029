"""Dry friction among the adopted causes, as sharp as the whole records show.

Effects that are not there compensate a reversal that is too blunt or too sharp: Stribeck's
friction, a wrong scale of a sensor. Where the sharpness was estimated together with Stribeck's
friction, neither looks superfluous: dry friction of another sharpness is tried without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from casid.diagnosis.search.adoption.refinement import Adoption, Refinement
from casid.diagnosis.search.candidates import Adopted, as_placed, name_of
from casid.diagnosis.search.refits.friction_speeds import likeliest_speed, steps_needed
from casid.diagnosis.search.refusals import SUPERFLUOUS
from casid.diagnosis.thresholds import FRICTION
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.thresholds import STEPS
from casid.model.effects.balances.balance_effects import coulomb_friction

STRIBECK = "stribeck_friction"


def with_sharp_friction(
    refine: Refinement, found: Adoption, most: int = FRICTION.in_the_end
) -> Adoption:
    """With dry friction that reverses as sharply as the whole records show.

    Parameters
    ----------
    most : steps of a simulation that it may take.
    """
    adopted, fit = list(found.adopted), found.fit
    assert fit is not None
    for i, a in enumerate(adopted):
        if _is_dry(a):
            adopted, fit = _sharpened(refine, adopted, i, fit, most)
    if fit is found.fit:
        return replace(found, adopted=tuple(adopted))
    return refine.reweighed(found, adopted, fit)


def with_sharp_friction_beside(refine: Refinement, found: Adoption) -> Adoption:
    """With sharper friction of causes found beside a disturbance, where that is likelier.

    The disturbance takes up what a blunt reversal leaves, and the gain beside it hardly shows the
    sharpness: without a spring each reversal leaves a step of the position behind.
    """
    if not any(map(_is_dry, found.adopted)):
        return found
    return refine.if_likelier(found, partial(with_sharp_friction, refine))


def without_blunt_reversals(refine: Refinement, found: Adoption) -> Adoption:
    """Without Stribeck's friction that dry friction of another sharpness replaces."""
    dry = {a.candidate.effect.where for a in found.adopted if _is_dry(a)}
    for where in sorted(dry):
        added = [a for a in found.adopted if a.candidate.effect.key == (STRIBECK, where)]
        for a in added:
            c, fit = a.candidate, found.fit
            assert fit is not None
            kept = [b for b in found.adopted if b is not a]
            lean = with_sharp_friction(
                refine, refine.rebuilt(found, kept, refine.fit_without(fit, c, found.adopted))
            )
            if lean.fit is not None and not refine.is_missed(fit, lean.fit):
                refine.search.refused.append((c, SUPERFLUOUS))
                found = lean
    return found


def _is_dry(a: Adopted) -> bool:
    return a.candidate.effect.kind == "coulomb_friction"


def _sharpened(
    refine: Refinement, adopted: list[Adopted], i: int, fit: Fit, most: int
) -> tuple[list[Adopted], Fit]:
    """With the likeliest smoothing speed of one of the causes."""
    own = adopted[i].candidate.effect
    refine.search.progress(f"choose how sharply {name_of(own)} reverses")
    affordable = min(STEPS.last, most // fit.criterion.n_samples)
    placed: dict[float, list[Adopted]] = {}

    def doubled(k: float, near: Fit) -> Fit | None:
        """The fit with 2^k times the smoothing speed; None where it needs too many steps."""
        speed = own.constants["speed"] * 2.0**k
        last = replace(adopted[i].candidate, fit=near, model=near.criterion.model)
        needed = steps_needed(last, speed)
        if needed > affordable:
            return None
        steps = max(fit.criterion.substeps, min(round(FRICTION.resolved * needed), affordable))
        placed[k], new = _at_speed(refine, adopted, i, speed, near, steps)
        return new

    likeliest = likeliest_speed(doubled, fit)
    if likeliest is None:
        return adopted, fit
    new = placed[likeliest.doublings]
    new[i] = replace(new[i], rounding=likeliest.rounding)
    if likeliest.doublings == 0.0 and not _is_of(refine, fit, adopted):
        return new, fit
    return new, likeliest.fit


def _is_of(refine: Refinement, fit: Fit, adopted: Sequence[Adopted]) -> bool:
    """False of a model in which further effects stay that are no causes."""
    names = {name for a in adopted for name in a.candidate.names}
    return set(fit.criterion.model.parameters) <= names | set(refine.start.model.parameters)


def _at_speed(
    refine: Refinement, adopted: Sequence[Adopted], i: int, speed: float, near: Fit, substeps: int
) -> tuple[list[Adopted], Fit]:
    """The causes with another smoothing speed of one, and their fit."""
    causes = [a.candidate for a in adopted]
    effect = coulomb_friction(refine.start.model, causes[i].effect.where, speed)
    is_same = effect.constants == causes[i].effect.constants and _is_of(refine, near, adopted)
    if is_same and substeps <= near.criterion.substeps:
        return list(adopted), near
    causes[i] = replace(causes[i], effect=effect)
    placed, fit = refine.with_causes(causes, near, substeps)
    return as_placed(adopted, placed), fit
