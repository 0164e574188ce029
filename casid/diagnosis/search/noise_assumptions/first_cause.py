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
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.adoption.baseline_refinement import baseline_refinement
from casid.diagnosis.search.adoption.powers_of_signals import with_better_powers
from casid.diagnosis.search.adoption.refinement import (
    Adoption,
    weighed_whole,
    whole_fit,
)
from casid.diagnosis.search.candidates import Adopted, Candidate
from casid.diagnosis.search.disturbance.disturbance_price import under_likelier_disturbance
from casid.diagnosis.search.rounds import Search, scores_to_refit
from casid.diagnosis.search.selection import POWERS
from casid.diagnosis.settings import DiagnosisSettings
from casid.diagnosis.thresholds import SHORTLIST
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.parameter_effects import is_scheduled_by_channel
from casid.model.effects.state_schedules import is_scheduled_by_state


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

    None where the sensors' noise holds no misfit, where no disturbance is likelier than that noise,
    or where many effects are seen beside it.
    """
    base, again = baseline.fit, search.with_disturbances()
    bare = under_likelier_disturbance(search, baseline.start, base)
    if bare is None:
        return None
    settings.progress("look for effects beside a random disturbance")
    table = again.table(bare, [])
    if len(scores_to_refit(bare, table)) > SHORTLIST.few:
        return None
    found = again.refits(bare, table, [])
    best = max(found, key=lambda c: c.merit, default=None)
    if best is None or best.merit <= 0.0:
        return None
    units, values = base.criterion.weights, best.fit.values
    fit = whole_fit(best.model, baseline.split, settings.refit, units, values)
    is_alone = leaves_noise(search, fit, settings)
    has_other_laws = is_scheduled_by_state(best.effect) or is_scheduled_by_channel(best.effect)
    if has_other_laws and not is_alone:
        # The law was chosen beside the disturbance, which is what the right one leaves none of.
        at = weighed_whole(search.weighing, fit, settings.refit)[1]
        refine = baseline_refinement(search, baseline, settings)
        by_own = Adoption((Adopted(best, 1.0, ()),), at, fit)
        other = search.attempts.attempt(POWERS, lambda: with_better_powers(refine, by_own))
        is_alone = other is not None and not other.at.noise_absorbs_misfit
    return EffectsBesideDisturbance(bare, found, is_alone)


def leaves_noise(search: Search, fit: Fit, settings: DiagnosisSettings) -> bool:
    """Whether an extended model leaves no misfit to the noise of the sensors."""
    return not weighed_whole(search.weighing, fit, settings.refit)[1].noise_absorbs_misfit
