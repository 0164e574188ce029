"""Whether what was found are causes, or what a random disturbance leaves as well.

Where sensors and measured inputs leave much unexplained, the search takes no misfit for noise: it
finds causes even where they are large, and imitations of what a sea or a road moves. Its causes are
therefore compared with a disturbance in their place, and with those of a second search in which
disturbances with spectra of their own count as noise. Each model is fitted under the disturbance
that its own residual shows. The likelihoods decide; causes, the best of all that were tested, are
charged for that choice as well (extended BIC: Chen and Chen, Biometrika 95 (2008) 759-771).

A disturbance is an explanation only where the residual under it is one: stationary, and dependent
on no state or input.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from casid.diagnosis.evidence.baseline import Baseline
from casid.diagnosis.evidence.prewhitening import Weighted, minus_log_likelihood
from casid.diagnosis.search.candidates import Adopted, Candidate
from casid.diagnosis.search.refinement import Adoption
from casid.diagnosis.search.residual_check import is_more_than_noise
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.search.selection import adopt_causes
from casid.diagnosis.settings import DiagnosisSettings

RANDOM = "an unrecorded random disturbance explains the misfit as well"


def weighed_against_disturbances(
    search: Search, found: Adoption, baseline: Baseline, settings: DiagnosisSettings
) -> tuple[Search, Weighted, Adoption]:
    """The search, the model as it is, and what was found, that are likeliest beside disturbances.

    The same as given where nothing would pass for a disturbance, or a parameter is held at its
    bound: that leaves misfit of its own.
    """
    base, start = baseline.fit, baseline.start
    held = base.solution.at_lower or base.solution.at_upper
    if held or not start.noise_absorbs_misfit:
        return search, start, found
    settings.progress("compare what was found with a random disturbance in its place")
    weighing = search.weighing.with_disturbances()
    again = replace(search, weighing=weighing, tested=None, refused=[])
    bare = weighing.weigh(start.model, base, rounds=1)
    score, is_random = math.inf, False
    if found.adopted and found.fit is not None:
        nothing = _score(bare, (), search)
        is_clean = not found.at.noise_absorbs_misfit
        if is_clean and _score(found.at, found.adopted, search) < nothing:
            return search, start, found  # likelier, even with no disturbance beside the causes
        score = _score(weighing.weigh(found.fit.criterion.model, found.fit), found.adopted, search)
        is_random = nothing <= score and not is_more_than_noise(bare, again)
        if is_clean and not is_random:
            return search, start, found
    settings.progress("treat the remainder as a disturbance, and test every effect in its presence")
    other = adopt_causes(again, bare, base, baseline.split, settings.fit)
    _add_refused(search, again.refused)
    if other.fit is not None and _score(other.at, other.adopted, again) < score:
        if is_random or not found.adopted or not is_more_than_noise(other.at, again):
            return replace(again, refused=search.refused), bare, other
    if is_random:
        _add_refused(search, [(a.candidate, RANDOM) for a in found.adopted])
        return search, start, Adoption((), start, None)
    return search, start, found


def _score(at: Weighted, adopted: Sequence[Adopted], search: Search) -> float:
    """The extended Bayesian information criterion, less what all models have in common."""
    table = search.first_table
    choice = 2 * math.log(len(table.tested)) if table is not None and table.tested else 0.0
    samples = math.log(at.criterion.n_samples)
    charge = sum(a.candidate.effect.cost * samples + choice for a in adopted)
    return 2 * minus_log_likelihood(at) + charge


def _add_refused(search: Search, rows: Sequence[tuple[Candidate, str]]) -> None:
    known = {c.effect.key for c, _ in search.refused}
    search.refused += [row for row in rows if row[0].effect.key not in known]
