"""Whether the effects found are causes, or a random disturbance explains the misfit as well.

Where the noise of sensors and measured inputs explains little of the residual, the search takes no
misfit for noise: it finds causes even if they are large, and also effects that imitate the motion
by a sea or a road. Its causes are therefore compared with a disturbance in their place, and with
those of a second search in which disturbances with spectra of their own count as noise. Each model
is fitted under the disturbance that its own residual shows. The likelihoods decide; causes are the
best of many tested, and are penalised for that choice as well (extended BIC: Chen and Chen,
Biometrika 95 (2008) 759-771).

A disturbance is an explanation only if the residual under it is stationary, and depends on no state
or input.

The held-out part has another realisation of a disturbance, which therefore explains nothing that
causes predict there (`is_predicted`). Where causes predict nearly all of it, and the rest is no
disturbance, no second search is made.

Of several causes, each is compared with a disturbance in its place beside the others: the first may
be a law, and the second an imitation of the disturbance. Where a disturbance remains, the extended
model has it as `beside`, and rivals are compared by their likelihoods there.

p-values under the noise of sensors alone assume that there is no disturbance: in a sea they are as
small as the sea is large. The p-value of a cause is therefore at least that of all causes together
against a disturbance in their place (Wilks 1938; Bonferroni over the effects tested).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from scipy.stats import chi2

from casid.diagnosis.evidence.baseline import Baseline
from casid.diagnosis.evidence.whitening.holding_bounds import held_beyond_chance
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted, minus_log_likelihood
from casid.diagnosis.search.adoption.baseline_refinement import baseline_refinement
from casid.diagnosis.search.adoption.refinement import Adoption
from casid.diagnosis.search.candidates import Adopted, Candidate, null_values
from casid.diagnosis.search.comparison.alternatives import is_imitator
from casid.diagnosis.search.comparison.simulation_errors import (
    SimulationErrors,
    Soundness,
    is_all_but_predicted,
    is_predicted,
    simulation_errors,
    why_not_adopted,
)
from casid.diagnosis.search.disturbance.disturbance_price import (
    as_white,
    is_no_disturbance,
    price_of,
)
from casid.diagnosis.search.disturbance.sole_disturbance import pays_beside, sole_disturbance
from casid.diagnosis.search.refusals import ACCEPTED, RANDOM, Refusal
from casid.diagnosis.search.residual_check import is_more_than_noise
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.search.selection import adopt_causes
from casid.diagnosis.settings import DiagnosisSettings
from casid.diagnosis.thresholds import ROUNDS
from casid.estimation.holdout import Split
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """The result of a search with disturbances in the noise of the model.

    Attributes
    ----------
    of : the model without causes, under the disturbance beside which effects were sought.
    found, score : the causes found, and their score; infinite where there are none.
    bare : the model without causes, under the disturbance that the causes leave.
    """

    search: Search
    of: Weighted
    found: Adoption
    score: float
    bare: Weighted

    @property
    def is_likelier(self) -> bool:
        """True if the causes are likelier than none beside the same disturbance."""
        return self.score < _score(self.bare, search=self.search, counted=self.bare.criterion)


def weighed_against_disturbances(
    search: Search,
    found: Adoption,
    baseline: Baseline,
    settings: DiagnosisSettings,
    before: Beside | None = None,
) -> tuple[Search, Weighted, Adoption]:
    """The likeliest explanation with disturbances: its search, model without causes, and causes.

    Those given where nothing looks like a disturbance, or a bound holds a parameter under a
    disturbance, too, which leaves misfit of its own. Where one shows only beside the first cause,
    the later ones alone are compared with it.

    Parameters
    ----------
    before : a search beside the disturbances of the model as it is, if there was one.
    """
    base, start, split = baseline.fit, baseline.start, baseline.split
    held, again = bool(base.solution.active), search.with_disturbances()
    if not start.noise_absorbs_misfit and (found.adopted or not held_beyond_chance(start.fit)):
        if any(_is_found_beside_misfit(a) for a in found.adopted[1:]):
            found = without_replaceable(again, found, baseline, search, settings)
        return search, start, found
    settings.progress("compare what was found with a random disturbance in its place")
    bare = search.under_disturbance(base)
    score_of = partial(_score, search=search, counted=bare.criterion)
    if minus_log_likelihood(bare) > as_white(base):
        return search, start, found
    start = replace(start, beside=bare)
    if held and (bare.unbiased is None or held_beyond_chance(bare.unbiased)):
        return search, start, _significant(found, bare, search, start)
    if held and score_of(bare) >= score_of(start):
        return search, start, found
    start = replace(start, noise_absorbs_misfit=True)  # a bound may have hidden it
    found = found if found.adopted else replace(found, at=start)
    score, is_random, nothing = math.inf, False, score_of(bare)
    found = without_replaceable(again, found, baseline, search, settings)
    own: Weighted | None = None
    if found.adopted and found.fit is not None:
        if not found.at.noise_absorbs_misfit and score_of(found.at, found.adopted) < nothing:
            return search, start, _charged(found, bare, search)  # likelier with no disturbance
        fit = found.fit
        own = search.under_disturbance(fit)
        bare = again.weighing.from_disturbance_of(bare, own)
        start, nothing = replace(start, beside=bare), score_of(bare)
        found = replace(found, at=replace(found.at, beside=own))
        least = minus_log_likelihood_beside(again.weighing, found, own, bare)
        score = 2 * least + _charge(bare, found.adopted, search)
        errors = _errors(base, fit, split)
        may_be_random = not (is_predicted(*errors) or is_more_than_noise(bare, again))
        charged = _charged(found, bare, search, least) if may_be_random else found
        is_random = (may_be_random and nothing <= score) or not _is_significant(charged, search)
        if not found.at.noise_absorbs_misfit and not is_random:
            return search, start, charged
        found = charged
        if not is_random and is_all_but_predicted(*errors) and is_more_than_noise(own, again):
            # What little is left is no disturbance: no search beside one is made for it.
            is_named = before is not None and before.is_likelier and before.score < score
            if before is None or not is_named or not _predicts_better(found, before.found, split):
                return search, start, found
            return replace(before.search, refused=search.refused), before.bare, before.found
    beside = before if before is not None and before.of is bare else None
    if beside is None:
        if own is not None and not is_random and _is_complete(found, own, again):
            again = replace(again, max_causes=min(again.max_causes, len(found.adopted)))
        beside = searched_beside(again, bare, baseline, settings)
    _add_refused(search, beside.search.refused)
    other = beside.found
    if beside.is_likelier and beside.score < min(score, nothing):
        if is_random or takes_place_of(found, other, search, again, split):
            return replace(beside.search, refused=search.refused), beside.bare, other
    if is_random:
        _add_refused(search, [(a.candidate, RANDOM) for a in found.adopted])
        return search, start, Adoption((), start, None)
    return search, start, found


def _is_found_beside_misfit(cause: Adopted) -> bool:
    """True of a cause found where the noise held misfit, which the causes before it had hidden."""
    return cause.before is not None and cause.before.noise_absorbs_misfit


def _is_complete(found: Adoption, own: Weighted, again: Search) -> bool:
    """True if nothing is left to name beside causes, and beside the disturbance that they leave.

    What is likelier then has as many causes at most: more of them are not sought in their place.
    """
    if is_more_than_noise(own, again):
        return False
    table = again.table(own, [a.candidate for a in found.adopted])
    return not again.has_alarm(own, table) and not pays_beside(again, own, table)


def takes_place_of(
    found: Adoption, other: Adoption, search: Search, again: Search, split: Split
) -> bool:
    """True if likelier causes beside a disturbance are to be named in the place of those found.

    Where they leave misfit, too, causes under the noise of the sensors stay: unless time ended
    their search, or the others predict better what was held out.

    Parameters
    ----------
    search, again : those of `found` and of `other`.
    """
    if not found.adopted or search.attempts.not_done:
        return True
    return not is_more_than_noise(other.at, again) or _predicts_better(found, other, split)


def _predicts_better(found: Adoption, other: Adoption, split: Split) -> bool:
    """True if the errors of other causes are less by more than chance, as an extension's are."""
    if found.fit is None or other.fit is None:
        return False
    return not why_not_adopted(*_errors(found.fit, other.fit, split))


def searched_beside(
    again: Search, bare: Weighted, baseline: Baseline, settings: DiagnosisSettings
) -> Beside:
    """Search beside disturbances.

    Parameters
    ----------
    again : a search with disturbances in the noise.
    bare : the model as it is, under the disturbances of its residual.
    """
    settings.progress("treat the remainder as a disturbance, and test every effect in its presence")
    of, other = bare, adopt_causes(again, bare, baseline.fit, baseline.split, settings.refit)
    if other.fit is not None:
        # It was extended under the disturbance of the model as it is; its own may be another one.
        own = again.under_disturbance(other.fit)
        if minus_log_likelihood(own) < minus_log_likelihood(other.at):
            other = replace(other, at=own)
            bare = again.weighing.from_disturbance_of(bare, own)
    other = _significant(other, bare, again, bare)
    score = math.inf
    if other.adopted:
        score = _score(other.at, other.adopted, search=again, counted=bare.criterion)
    return Beside(again, of, other, score, bare)


def searched_beside_first(
    search: Search, bare: Weighted, baseline: Baseline, settings: DiagnosisSettings
) -> Beside | None:
    """Search for few causes beside disturbances; None where more are to be named beside them.

    Misfit that passes for a disturbance is made of one law after the other there.
    """
    again = search.with_disturbances()
    few = replace(again, max_causes=min(again.max_causes, ROUNDS.beside))
    beside = searched_beside(few, bare, baseline, settings)
    found = beside.found
    if few.max_causes < again.max_causes and len(found.adopted) == few.max_causes:
        return beside if _is_complete(found, found.at, again) else None
    return beside


def leaves_only_disturbance(search: Search, beside: Beside) -> bool:
    """True if a random disturbance explains all that the causes of a second search do not.

    Any further effect that a search under the sensors' noise finds would raise the likelihood there
    by more than its penalty.
    """
    fit = beside.found.fit
    if fit is None or not beside.is_likelier:
        return False
    start = search.weighing.weigh(fit.criterion.model, fit, rounds=1)
    causes = [a.candidate for a in beside.found.adopted]
    return sole_disturbance(search, start, fit, causes) is not None


def minus_log_likelihood_beside(
    weighing: Weighing, found: Adoption, own: Weighted, bare: Weighted
) -> float:
    """Minus the log-likelihood of the extended model under the disturbance that remains.

    The model without causes (`bare`) is a special case of it, and can be no likelier. Where the fit
    under the disturbance of its own residual (`own`) is less likely all the same, the gain of the
    effects under the disturbance of `bare` counts, fitted from their null values.
    """
    of = bare.criterion
    if not bare.noise.spectra:
        return minus_log_likelihood(own, of)
    model, values = own.model, dict(bare.fit.values)
    for a in found.adopted:
        for name, null in null_values(a.candidate).items():
            p = model.parameters[name]  # of what an input does or does not, the one alone
            values[name] = min(max(null, p.lower), p.upper)
    there = replace(bare, fit=weighing.fitted(model, bare, values))
    under_one = [minus_log_likelihood(replace(at, unbiased=None), of) for at in (bare, there)]
    gain = max(under_one[0] - under_one[1], 0.0)
    return min(minus_log_likelihood(own, of), minus_log_likelihood(bare) - gain)


def without_replaceable(
    again: Search,
    found: Adoption,
    baseline: Baseline,
    search: Search,
    settings: DiagnosisSettings,
) -> Adoption:
    """The causes found, without those that a disturbance can replace beside the others.

    The first cause may be a law, and a later one may fit a disturbance. A single cause is compared
    with a disturbance elsewhere, as all causes together are. Where all causes leave only noise,
    only changes in time are tested: they may have followed a slow disturbance through the record.

    Parameters
    ----------
    again : the search with disturbances in the noise.
    """
    is_open = found.at.noise_absorbs_misfit
    doubted = [a for a in found.adopted if is_open or is_imitator(a.candidate)]
    if len(found.adopted) < 2 or not doubted:
        return found
    base, split = baseline.fit, baseline.split
    refine = baseline_refinement(search, baseline, settings)
    is_sound = Soundness(base, split)

    def why(cause: Adopted, fit: Fit, without: Fit) -> Refusal:
        """Why a cause is not needed beside a disturbance, if it is not."""
        if cause not in doubted or _foresees(without, fit, split) or not is_sound(without):
            return ACCEPTED
        if is_no_disturbance(search, without):
            return ACCEPTED
        beside, instead = search.under_disturbance(fit), search.under_disturbance(without)
        score_of = partial(_score, search=search, counted=base.criterion)
        is_needed = score_of(beside, [cause]) < score_of(instead)
        return ACCEPTED if is_needed or is_more_than_noise(instead, again) else RANDOM

    settings.progress("compare each cause with a random disturbance in its place")
    what = "the comparison of each cause with a random disturbance"
    return search.attempts.attempt(what, partial(refine.without_unneeded, found, why)) or found


def _foresees(before: Fit, after: Fit, split: Split) -> bool:
    """True if most of what one model leaves of what was held out is foreseen by another."""
    return is_predicted(*_errors(before, after, split))


def _errors(before: Fit, after: Fit, split: Split) -> tuple[SimulationErrors, SimulationErrors]:
    """The errors of a model and of another, in units of the other's."""
    units = after.criterion.weights
    return simulation_errors(before, split, units), simulation_errors(after, split, units)


def _significant(found: Adoption, bare: Weighted, search: Search, start: Weighted) -> Adoption:
    """The causes found, if significant against disturbances alone; else `start` without causes."""
    charged = _charged(found, bare, search)
    if not charged.adopted or _is_significant(charged, search):
        return charged
    search.refused += [(a.candidate, RANDOM) for a in found.adopted]
    return Adoption((), start, None)


def _is_significant(found: Adoption, search: Search) -> bool:
    return any(a.p_value < search.alpha for a in found.adopted)


def _charged(
    found: Adoption, bare: Weighted, search: Search, beside: float | None = None
) -> Adoption:
    """The causes found, their p-values at least that of all against a disturbance instead.

    Parameters
    ----------
    bare : the model as it is under the disturbance.
    beside : minus the log-likelihood of the extended model under what is left for one; default as
        it was found.
    """
    if not found.adopted or found.fit is None:
        return found
    if beside is None and found.at.noise_absorbs_misfit:
        own = found.at.beside or search.under_disturbance(found.fit)
        beside = minus_log_likelihood_beside(search.weighing.with_disturbances(), found, own, bare)
    left = minus_log_likelihood(found.at, bare.criterion) if beside is None else beside
    gain = minus_log_likelihood(bare) - left
    effects = [a.candidate.effect for a in found.adopted]
    logs = len(effects) * math.log(search.count_tested)
    logs += float(chi2.logsf(2 * max(gain, 0.0), sum(e.cost for e in effects)))
    p = math.exp(min(logs, 0.0))
    return replace(
        found, adopted=tuple(replace(a, p_value=max(a.p_value, p)) for a in found.adopted)
    )


def _score(
    at: Weighted, adopted: Sequence[Adopted] = (), *, search: Search, counted: SimulationError
) -> float:
    """The extended Bayesian information criterion, less what all models have in common."""
    return 2 * minus_log_likelihood(at, counted) + _charge(at, adopted, search)


def _charge(at: Weighted, adopted: Sequence[Adopted], search: Search) -> float:
    """Penalty of effects chosen among all that were tested, and of disturbances.

    A disturbance has parameters as well: its variance, and those of its spectrum. A band narrower
    than a record resolves would otherwise be preferred to the line that it is there.
    """
    n = at.criterion.n_samples
    spectra = at.noise.spectra.values()
    shapes = sum(2 + (s.damping is not None) + max(len(s.parts) - 1, 0) for s in spectra)
    charged = sum(price_of(a.candidate.effect.cost, n, search.count_tested) for a in adopted)
    return shapes * math.log(n) + charged


def _add_refused(search: Search, rows: Sequence[tuple[Candidate, Refusal]]) -> None:
    known = {c.effect.key for c, _ in search.refused}
    search.refused += [row for row in rows if row[0].effect.key not in known]
