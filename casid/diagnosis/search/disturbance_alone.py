"""Whether a random disturbance is all that a model leaves: then no cause has to be sought.

A search beside a sea finds many effects that imitate it, refits them, and refuses them all against
the disturbance in their place. Three looks foretell that: the residual under the disturbance is
random, no effect scores beside it, and none of those that score best, beside it or under the
sensors' noise, lets the disturbance explain so much less that its likelihood would pay for it.
"""

from __future__ import annotations

from dataclasses import replace

from casid.diagnosis.evidence.gain_beside import gain_beside, unwhitened
from casid.diagnosis.evidence.prewhitening import Weighted, minus_log_likelihood
from casid.diagnosis.evidence.score_tests import ScoreTable
from casid.diagnosis.evidence.signature_columns import extended_columns
from casid.diagnosis.search.disturbance_price import as_white, is_held, price_of
from casid.diagnosis.search.residual_check import is_more_than_noise
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import DISTURBED
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.effect import Effect


def disturbance_alone(search: Search, start: Weighted, base: Fit) -> Weighted | None:
    """The model as it is, under the disturbance that is all it leaves; None where more is left.

    Parameters
    ----------
    start, base : the model as it is, under the sensors' noise and by its simulation error.
    """
    if not start.noise_absorbs_misfit or is_held(base):
        return None
    search.progress("test whether a random disturbance explains all that the model leaves")
    beside = search.with_disturbances()
    bare = search.under_disturbance(base)
    if minus_log_likelihood(bare) > as_white(base) or is_more_than_noise(bare, beside):
        return None
    table = beside.table(bare, [])
    if table.smallest is not None and table.smallest.adjusted < search.alpha:
        return None
    alone = search.table(start, [])
    effects = list(dict.fromkeys([*_best(table), *_best(alone)]))
    if not effects:
        return None
    at = replace(bare, fit=bare.unbiased or bare.fit)
    columns = extended_columns(replace(at.fit, criterion=unwhitened(at)), effects)
    least = min(effect.cost for effect in effects)
    needed = 0.5 * price_of(least, start.criterion.n_samples, len(alone.tested))
    gain = gain_beside(
        at,
        columns,
        range(len(columns.effects)),
        known=search.weighing.known_noise,
        passing=needed,
    )
    if gain > DISTURBED.share * needed:
        return None
    search.first_table = table
    return bare


def _best(table: ScoreTable) -> list[Effect]:
    """The effects that score best, without lines: those are estimates, and were tested as such."""
    scored = [s for s in table.tested if s.effect.test != "peak"]
    scored.sort(key=lambda s: -s.unrobust)
    return [s.effect for s in scored[: DISTURBED.looked_at]]
