"""Rivals that are likelier than a cause in the complete model, and replace it.

A cause is chosen while others are missing, or while the noise model absorbs misfit. With all of
them in the model, and under the noise that is then left, gains are likelihoods.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.adoption.refinement import Adoption, whole_fit
from casid.diagnosis.search.candidates import (
    Adopted,
    Candidate,
    as_placed,
    extended_by,
    is_needed,
    name_of,
    values_by_new_names,
)
from casid.diagnosis.search.comparison.simulation_errors import on_common_samples, simulation_errors
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import COMPARISON, JUDGING
from casid.estimation.holdout import Split, why_no_better
from casid.estimation.simulation.fit import FitSettings


def with_likelier_rivals(
    search: Search, found: Adoption, start: Weighted, split: Split, settings: FitSettings
) -> Adoption:
    """The causes, each replaced by a rival that is better by strong evidence and predicts as well.

    Parameters
    ----------
    found : the causes with the rivals that cannot be rejected beside the others in the end.
    start : the model as it is.
    """
    if found.fit is None or found.at.likelihoods.noise_absorbs_misfit:
        return found
    for i in range(len(found.adopted)):
        rival = likelier_rival(found.adopted, i)
        others = [a.candidate for a in (*found.adopted[:i], *found.adopted[i + 1 :])]
        if rival is not None and not is_needed(start.model, others):
            found = _in_its_place(search, found, i, rival, start, split, settings)
    return found


def likelier_rival(adopted: Sequence[Adopted], i: int) -> Candidate | None:
    """The best named rival, where it is better than a cause by strong evidence.

    A temporary change does not replace a law: it fits anything that passes a level once, an
    overflow as closely as a window that was open.
    """
    own = adopted[i].candidate
    taken = {a.candidate.effect.key for a in adopted}
    named = [
        r.candidate
        for r in adopted[i].rivals
        if r.candidate.effect.kind != "unknown" and r.candidate.effect.key not in taken
    ]
    if not own.effect.is_on_the_clock:
        named = [c for c in named if c.effect.end is None]
    best = max(named, key=lambda c: c.merit, default=None)
    return best if best is not None and best.merit > own.merit + COMPARISON.strong else None


def _in_its_place(
    search: Search,
    found: Adoption,
    i: int,
    rival: Candidate,
    start: Weighted,
    split: Split,
    settings: FitSettings,
) -> Adoption:
    """The causes with a rival in the place of one, unless it predicts or simulates worse."""
    fit, own = found.fit, found.adopted[i].candidate
    assert fit is not None
    search.progress(f"take {name_of(rival.effect)} in the place of {name_of(own.effect)}")
    causes = [a.candidate for a in found.adopted]
    causes[i] = rival
    model, placed = extended_by(start.model, causes)
    values = {**fit.values, **values_by_new_names(placed, causes)}
    units = fit.criterion.weights
    other = whole_fit(model, split, settings, units, values)
    before, after = on_common_samples(*(simulation_errors(f, split, units) for f in (fit, other)))
    if len(before.continued) and not why_no_better(after.continued, before.continued):
        return found  # the cause predicts better, by more than chance
    if after.square > (1 + JUDGING.practical) * before.square:
        return found  # likelier beside a disturbance, and yet it simulates worse
    adopted = as_placed(found.adopted, placed)
    least = rival.merit - COMPARISON.strong
    left = (r for r in adopted[i].rivals if r.candidate.effect.key != rival.effect.key)
    adopted[i] = replace(adopted[i], rivals=tuple(r for r in left if r.candidate.merit > least))
    at = search.weighing.weigh(model, other, rounds=1)
    return replace(found, adopted=tuple(adopted), at=at, fit=other)
