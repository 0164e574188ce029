"""Effects that are significant beside a random disturbance: the first candidates for a cause.

Under the sensors' noise a large misfit raises the scores of all effects that act in the same place:
dozens are refitted, and laws that imitate the cause explain parts of it one after the other. A
disturbance explains the misfit of most of them as well. An effect that is significant beside it is
the cause, or looks like the cause in these records; and if no disturbance is needed with it,
nothing else has to be refitted for the first cause.
"""

from __future__ import annotations

from dataclasses import dataclass

from casid.diagnosis.evidence.baseline import Baseline
from casid.diagnosis.evidence.scores.score_tests import ScoreTable
from casid.diagnosis.evidence.whitening.weighted_model import Weighted, minus_log_likelihood
from casid.diagnosis.search.adoption.powers_of_signals import with_better_powers
from casid.diagnosis.search.adoption.refinement import (
    Adoption,
    Refinement,
    weighed_whole,
    whole_fit,
)
from casid.diagnosis.search.candidates import Adopted, Candidate
from casid.diagnosis.search.disturbance.disturbance_price import (
    price_of,
    under_likelier_disturbance,
)
from casid.diagnosis.search.instants.jump_times import placed
from casid.diagnosis.search.residual_check import is_more_than_noise
from casid.diagnosis.search.rounds import Search, scores_to_refit, strongest_of_each
from casid.diagnosis.search.selection import POWERS
from casid.diagnosis.settings import DiagnosisSettings
from casid.diagnosis.thresholds import SHORTLIST
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.parameter_effects import is_scheduled_by_state


@dataclass(frozen=True, slots=True)
class EffectsBesideDisturbance:
    """The few effects that are significant beside a disturbance, as refitted there.

    Attributes
    ----------
    at : the model as it is under the disturbance.
    leaves_noise : whether the best of them leaves no misfit to the noise of the sensors.
    """

    at: Weighted
    effects: list[Candidate]
    leaves_noise: bool


def seen_beside_disturbance(
    search: Search, baseline: Baseline, settings: DiagnosisSettings
) -> EffectsBesideDisturbance | None:
    """Effects that are significant beside a disturbance, if they are few and worth their penalty.

    None where the sensors' noise holds no misfit, or where no disturbance is likelier than that
    noise, or where many effects are seen beside it: unless a change in time, placed to its instant,
    leaves nothing but a disturbance. At any other instant many effects seem to explain it.
    """
    base, again = baseline.fit, search.with_disturbances()
    bare = under_likelier_disturbance(search, baseline.start, base)
    if bare is None:
        return None
    settings.progress("look for effects beside a random disturbance")
    table = again.table(bare, [])
    if len(scores_to_refit(bare, table)) > SHORTLIST.few:
        change = _change_beside(search, bare, table)
        return None if change is None else EffectsBesideDisturbance(bare, [change], False)
    found = again.refits(bare, table, [])
    best = max(found, key=lambda c: c.merit, default=None)
    if best is None or best.merit <= 0.0:
        return None
    units, values = base.criterion.weights, best.fit.values
    fit = whole_fit(best.model, baseline.split, settings.refit, units, values)
    is_alone = leaves_noise(search, fit, settings)
    if not is_alone and is_scheduled_by_state(best.effect):
        # The law was chosen beside the disturbance, which is what the right one leaves none of.
        at = weighed_whole(search.weighing, fit, settings.refit)[1]
        refine = Refinement(search, baseline.split, settings.refit, units, baseline.start, base)
        by_own = Adoption((Adopted(best, 1.0, ()),), at, fit)
        other = search.attempts.attempt(POWERS, lambda: with_better_powers(refine, by_own))
        is_alone = other is not None and not other.at.noise_absorbs_misfit
    return EffectsBesideDisturbance(bare, found, is_alone)


def _change_beside(search: Search, bare: Weighted, table: ScoreTable) -> Candidate | None:
    """The change that stays, among the best scored, that leaves nothing but a disturbance."""
    again = search.with_disturbances()
    lasting = [s for s in table.tested if s.effect.sets_in and s.effect.end is None]
    best = list(strongest_of_each(lasting).values())[: SHORTLIST.few]
    found = placed(again.refitting, bare, again.refits_of(bare, best), [], search.progress)
    top = max(found, key=lambda c: c.gain, default=None)
    if top is None or top.merit <= 0.0:
        return None
    own = search.under_disturbance(top.fit)
    gain = minus_log_likelihood(bare) - minus_log_likelihood(own, bare.criterion)
    price = price_of(top.effect.cost, bare.criterion.n_samples, len(table.tested))
    return top if 2 * gain > price and not is_more_than_noise(own, again) else None


def leaves_noise(search: Search, fit: Fit, settings: DiagnosisSettings) -> bool:
    """Whether an extended model leaves no misfit to the noise of the sensors."""
    return not weighed_whole(search.weighing, fit, settings.refit)[1].noise_absorbs_misfit
