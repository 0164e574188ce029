"""What the search finds: the causes adopted, and the model extended by them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from casid.data.problem import Problem
from casid.diagnosis.attempts import Attempts
from casid.diagnosis.evidence.baseline import Baseline
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.adoption.baseline_refinement import baseline_refinement
from casid.diagnosis.search.adoption.feigned_causes import without_feigned
from casid.diagnosis.search.adoption.promotion import with_likelier_rivals
from casid.diagnosis.search.adoption.reconsideration import reconsidered
from casid.diagnosis.search.adoption.refinement import Adoption
from casid.diagnosis.search.candidates import Adopted, Candidate, name_of
from casid.diagnosis.search.comparison.simulation_errors import Soundness
from casid.diagnosis.search.comparison.sizes_by_record import SizesByRecord, with_sizes_by_record
from casid.diagnosis.search.disturbance.sole_disturbance import sole_disturbance
from casid.diagnosis.search.instants.instant_errors import with_instant_errors
from casid.diagnosis.search.noise_assumptions.disturbance_rival import (
    Beside,
    leaves_only_disturbance,
    searched_beside_first,
    weighed_against_disturbances,
)
from casid.diagnosis.search.noise_assumptions.first_cause import (
    leaves_noise,
    seen_beside_disturbance,
)
from casid.diagnosis.search.noise_assumptions.forces_in_noise import found_without_forces
from casid.diagnosis.search.refusals import Refusal
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.search.selection import adopt_causes
from casid.diagnosis.settings import DiagnosisSettings
from casid.diagnosis.thresholds import BUDGET, BURSTS
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
    specific: tuple[SizesByRecord, ...] = ()
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
        spikes=instants_of_spikes(baseline),
        effects=problem.effects,
        progress=settings.progress,
        attempts=Attempts(settings.search_ends),
    )
    # With a wrong sign, or absolute values, the model of the channel is an extension by itself.
    own_fit = baseline.fit if baseline.is_extended else None
    if baseline.why_undecided:
        return Findings(baseline, search, baseline.start, own_fit)
    search, start, found = _found(search, baseline, settings)
    baseline = replace(baseline, start=start)
    last = _LastSteps(search, baseline, settings, Soundness(baseline.fit, baseline.split))
    found = last.weighted_by_errors(last.sound(found))
    if not found.adopted:
        baseline = replace(baseline, why_undecided=_why_open(search))
    found = last.by_likelier_rivals(last.judged_again(found))
    specific, found = last.with_sizes_by_record(found)
    found, corrected = last.without_input_noise(problem, found, own_fit)
    extended = found.fit or own_fit
    if corrected is not None and extended is not None:
        extended = corrected.fit
    adopted = with_instant_errors(search.attempts, found.adopted, extended)
    return Findings(
        baseline, search, found.at, extended, adopted, specific, found.remainders, corrected
    )


def instants_of_spikes(baseline: Baseline) -> tuple[float, ...]:
    """When the fitted records have spikes [s], where they are few.

    What is fast shows a jump of a parameter for a sample, as a spike, and is as before afterwards.
    No instant of a coarse grid is near enough to it.
    """
    data = baseline.fit.criterion.data
    found = [
        float(t)
        for spikes in baseline.corrupted.spikes
        for d, mask in zip(data, spikes.masks, strict=False)
        for t in d.t[mask[: len(d.t)]]
    ]
    return tuple(found) if len(found) <= BURSTS.spikes else ()


@dataclass(frozen=True, slots=True)
class _LastSteps:
    """The last steps, when all causes are found; a step that makes the fit worse is undone."""

    search: Search
    baseline: Baseline
    settings: DiagnosisSettings
    is_sound: Soundness

    def sound(self, found: Adoption) -> Adoption:
        """The causes found, or none where the model simulates worse with them."""
        if found.fit is None or self.is_sound(found.fit):
            return found
        why = Refusal("its simulation is worse than that of the model as it is")
        self.search.refused += [(a.candidate, why) for a in found.adopted]
        return replace(found, adopted=(), at=self.baseline.start, fit=None)

    def weighted_by_errors(self, found: Adoption) -> Adoption:
        """The fit in units of its own errors."""
        fit = found.fit
        if fit is None or fit.criterion.whiten is not None:
            return found
        again = self.search.attempts.attempt(
            "the last fit of the extended model",
            lambda: weighted_by_errors(fit, self.settings.fit),
        )
        return found if again is None or not self.is_sound(again) else replace(found, fit=again)

    def judged_again(self, found: Adoption) -> Adoption:
        """The causes with the rivals that cannot be rejected in the end."""
        if not found.adopted:
            return found
        at = _with_likelihoods(self.search, found.at)
        adopted = reconsidered(self.search, found.adopted, self.baseline.start, at.likelihoods)
        return replace(found, adopted=tuple(adopted), at=at)

    def by_likelier_rivals(self, found: Adoption) -> Adoption:
        """Every cause by its rival that is likelier in the end."""
        start, split = self.baseline.start, self.baseline.split
        likelier = self.search.attempts.attempt(
            "the exchange of causes for likelier rivals",
            lambda: with_likelier_rivals(self.search, found, start, split, self.settings.refit),
        )
        if likelier is None or not (likelier.fit is None or self.is_sound(likelier.fit)):
            return found
        return likelier

    def with_sizes_by_record(self, found: Adoption) -> tuple[tuple[SizesByRecord, ...], Adoption]:
        """Causes whose size differs from record to record, and the fit with sizes of their own."""
        fit, split = found.fit, self.baseline.split
        if fit is None or fit.criterion.whiten is not None or len(split.fitted) < 2:
            return (), found
        what, of = "test whether one size of each cause explains every record", self.settings
        of.progress(what)
        own = partial(with_sizes_by_record, self.baseline.weighing, found.adopted, fit, found.at)
        apart = self.search.attempts.attempt(f"the {what}", lambda: own(split, of.fit))
        if apart is None:
            return (), found
        specific, fit, at = apart
        return specific, replace(found, at=at, fit=fit)

    def without_input_noise(
        self, problem: Problem, found: Adoption, own_fit: Fit | None
    ) -> tuple[Adoption, Corrected | None]:
        """The last fit without the bias of noise on measured inputs, and what is a cause there.

        No such fit of one under a disturbance, and of an extended model that simulates worse
        without it.
        """
        extended = found.fit or own_fit
        fit = extended or self.baseline.fit
        if fit.criterion.whiten is not None:
            return found, None
        self.settings.progress("remove the bias of noise on measured inputs")
        correct = partial(self._corrected, problem)
        corrected = correct(fit)
        if extended is not None and corrected is not None and not self.is_sound(corrected.fit):
            return found, None
        if corrected is None or not corrected.is_removed or found.fit is None:
            return found, corrected
        refine = baseline_refinement(self.search, self.baseline, self.settings, fit)
        left = self.search.attempts.attempt(
            "the test whether noise on inputs feigns a cause",
            lambda: without_feigned(refine, found, corrected, correct),
        )
        return left or (found, corrected)

    def _corrected(self, problem: Problem, fit: Fit) -> Corrected | None:
        """A fit without the bias of noise on its inputs; None where that fails."""
        return self.search.attempts.attempt(
            "the removal of the bias of noise on inputs",
            lambda: without_input_noise(fit, problem.noise, seed=self.settings.fit.seed),
        )


def _found(
    search: Search, baseline: Baseline, settings: DiagnosisSettings
) -> tuple[Search, Weighted, Adoption]:
    """The search, the model as it is, and the causes that no random disturbance explains."""
    fit, start, attempt = baseline.fit, baseline.start, search.attempts.attempt
    what = "the test whether a random disturbance explains all that the model leaves"
    alone = attempt(what, lambda: sole_disturbance(search, start, fit))
    if alone is not None:
        start = replace(start, beside=alone)
        return search, start, Adoption((), start, None)
    beside: Beside | None = None
    first: Sequence[Candidate] = ()
    with search.attempts.within(BUDGET.adoption):
        what = "the search for effects beside a random disturbance"
        seen = attempt(what, lambda: seen_beside_disturbance(search, baseline, settings))
        if seen is not None and seen.leaves_noise:
            first = seen.effects
        elif seen is not None:
            first_few = partial(searched_beside_first, search, seen.at, baseline, settings)
            beside = attempt(what, first_few)
            if beside and attempt(what, lambda: leaves_only_disturbance(search, beside)):
                return beside.search, beside.bare, beside.found
            if beside and beside.found.fit is not None:
                leaves = partial(leaves_noise, search, beside.found.fit, settings)
                first = seen.effects if attempt(what, leaves) else ()
        found = adopt_causes(search, start, fit, baseline.split, settings.refit, first)
    what = "the search without forces in the noise"
    alone = attempt(what, lambda: search.weighing.without_forces(start))
    if alone is not None:
        if not found.adopted:
            without = partial(found_without_forces, search, alone, baseline, settings)
            if (other := attempt(what, without)) is not None:
                return other
        baseline = replace(baseline, start=replace(start, noise_absorbs_misfit=True))
    what = "the comparison of what was found with a random disturbance"
    compared = attempt(
        what, lambda: weighed_against_disturbances(search, found, baseline, settings, beside)
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
