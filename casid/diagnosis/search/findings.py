"""What the search finds: the causes adopted, and the model extended by them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from casid.data.problem import Problem
from casid.diagnosis.attempts import Attempts
from casid.diagnosis.evidence.baseline import Baseline
from casid.diagnosis.evidence.prewhitening import Weighted
from casid.diagnosis.search.candidates import Adopted, name_of
from casid.diagnosis.search.disturbance_alone import disturbance_alone
from casid.diagnosis.search.disturbance_rival import weighed_against_disturbances
from casid.diagnosis.search.first_cause import seen_beside_disturbance
from casid.diagnosis.search.instant_errors import with_instant_errors
from casid.diagnosis.search.promotion import with_likelier_rivals
from casid.diagnosis.search.reconsideration import reconsidered
from casid.diagnosis.search.record_specific import Specific, record_specific
from casid.diagnosis.search.refinement import Adoption
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.search.selection import adopt_causes
from casid.diagnosis.search.simulation_errors import Soundness
from casid.diagnosis.settings import DiagnosisSettings
from casid.diagnosis.thresholds import BUDGET
from casid.estimation.errors_in_variables.removal import Corrected, without_input_noise
from casid.estimation.simulation.fit import weighted_by_errors
from casid.estimation.simulation.minimization import Fit


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """Everything that a verdict is made of.

    Attributes
    ----------
    at : the model as extended, under the noise found there; the baseline where nothing was adopted.
    extended_fit : its simulation-error fit, without the bias of noise on measured inputs where that
        can be removed; None where nothing was adopted and no sign is wrong.
    corrected : what became of that bias, in the extended fit or else in the baseline's.
    specific : causes whose size differs from record to record.
    remainders : effects that are significant but explain too little to be causes.
    """

    baseline: Baseline
    search: Search
    at: Weighted
    extended_fit: Fit | None = None
    adopted: tuple[Adopted, ...] = ()
    specific: tuple[Specific, ...] = ()
    remainders: tuple[Adopted, ...] = ()
    corrected: Corrected | None = None

    @property
    def base_fit(self) -> Fit:
        """The model as it is, fitted to the records as they were recorded."""
        return self.baseline.reported_fit

    @property
    def best_fit(self) -> Fit:
        """The extended model's fit, or the baseline's."""
        return self.extended_fit or self.base_fit


def search_causes(problem: Problem, baseline: Baseline, settings: DiagnosisSettings) -> Findings:
    """Look for what the baseline is missing, and adopt what is borne out."""
    search = Search(
        baseline.weighing,
        baseline.channels,
        alpha=settings.alpha,
        max_causes=settings.max_causes,
        without=settings.without,
        effects=problem.effects,
        progress=settings.progress,
        attempts=Attempts(settings.search_ends),
    )
    # With a wrong sign, the model fitted to the negated channel is an extension by itself.
    negated_fit = baseline.fit if baseline.negated is not None else None
    if baseline.why_undecided:
        return Findings(baseline, search, baseline.start, negated_fit)
    fit, split, start = baseline.fit, baseline.split, baseline.start
    search, start, found = _found(search, baseline, settings)
    baseline = replace(baseline, start=start)
    is_sound = Soundness(fit, split)
    if found.fit is not None and not is_sound(found.fit):
        why = "its simulation is worse than that of the model as it is"
        search.refused += [(a.candidate, why) for a in found.adopted]
        found = replace(found, adopted=(), at=start, fit=None)
    adopted, at, extended = list(found.adopted), found.at, found.fit
    if extended is not None and extended.criterion.whiten is None:
        whole = extended
        reweighted = search.attempts.attempt(
            "the last fit of the extended model", lambda: weighted_by_errors(whole, settings.fit)
        )
        extended = reweighted if reweighted is not None and is_sound(reweighted) else extended
    if not adopted:
        baseline = replace(baseline, why_undecided=_why_open(search))
    at = _with_likelihoods(search, at) if adopted else at
    adopted = reconsidered(search, adopted, start, at.likelihoods)
    once = replace(settings.fit, starts=1)
    named = replace(found, adopted=tuple(adopted), at=at, fit=extended)
    likelier = search.attempts.attempt(
        "the exchange of causes for likelier rivals",
        lambda: with_likelier_rivals(search, named, start, split, once),
    )
    if likelier is not None and (likelier.fit is None or is_sound(likelier.fit)):
        named = likelier
    adopted, at, extended = list(named.adopted), named.at, named.fit
    specific: tuple[Specific, ...] = ()
    if extended is not None and extended.criterion.whiten is None and len(split.fitted) > 1:
        settings.progress("test whether one size of each cause explains every record")
        whole, noise = extended, at
        apart = search.attempts.attempt(
            "the test whether one size of each cause explains every record",
            lambda: record_specific(baseline.weighing, adopted, whole, noise, split, settings.fit),
        )
        specific, extended, at = apart or (specific, extended, at)
    extended = extended or negated_fit
    corrected = _corrected(search, problem, extended or fit, settings)
    if extended is not None and corrected is not None:
        if is_sound(corrected.fit):
            extended = corrected.fit
        else:
            corrected = None
    return Findings(
        baseline,
        search,
        at,
        extended,
        with_instant_errors(search.attempts, adopted, extended),
        specific,
        found.remainders,
        corrected,
    )


def _found(
    search: Search, baseline: Baseline, settings: DiagnosisSettings
) -> tuple[Search, Weighted, Adoption]:
    """The search, the model as it is, and the causes that no random disturbance explains."""
    fit, start, attempt = baseline.fit, baseline.start, search.attempts.attempt
    what = "the test whether a random disturbance explains all that the model leaves"
    alone = attempt(what, lambda: disturbance_alone(search, start, fit))
    if alone is not None:
        start = replace(start, beside=alone)
        return search, start, Adoption((), start, None)
    with search.attempts.within(BUDGET.adoption):
        what = "the search for effects beside a random disturbance"
        first = attempt(what, lambda: seen_beside_disturbance(search, baseline, settings)) or ()
        found = adopt_causes(search, start, fit, baseline.split, settings.fit, first)
    what = "the comparison of what was found with a random disturbance"
    compared = attempt(
        what, lambda: weighed_against_disturbances(search, found, baseline, settings)
    )
    return compared or (search, start, found)


def _with_likelihoods(search: Search, at: Weighted) -> Weighted:
    """An extended model, weighed beside a disturbance as well where misfit is left."""
    if not at.noise_absorbs_misfit or at.beside is not None:
        return at
    what = "the fit of the extended model beside a random disturbance"
    return replace(
        at, beside=search.attempts.attempt(what, lambda: search.under_disturbance(at.fit))
    )


def _corrected(
    search: Search, problem: Problem, fit: Fit, settings: DiagnosisSettings
) -> Corrected | None:
    """A fit without the bias of noise on measured inputs; None of one under a disturbance."""
    if fit.criterion.whiten is not None:
        return None
    settings.progress("remove the bias of noise on measured inputs")
    return search.attempts.attempt(
        "the removal of the bias of noise on inputs",
        lambda: without_input_noise(fit, problem.noise, seed=settings.fit.seed),
    )


def _why_open(search: Search) -> str:
    """Why a search that adopted nothing is no answer, or an empty text."""
    attempts = search.attempts
    if attempts.not_done:
        best = next(iter(search.first_candidates), None)
        so_far = f", when {name_of(best.effect)} explained most" if best is not None else ""
        return (
            f"the budget of time ended before the search{so_far}: fit a shorter window (--window), "
            "or raise the budget (--budget)"
        )
    if search.first_table is None:
        return f"no effect could be tested, since {attempts.reasons()}"
    return ""
