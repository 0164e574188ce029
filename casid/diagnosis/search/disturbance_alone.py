"""Whether a random disturbance is all that a model leaves: then no cause has to be sought.

A search beside a sea finds many effects that imitate it, refits them, and refuses them all against
the disturbance in their place. Three looks foretell that: the residual under the disturbance is
random, no effect scores beside it, and none of those that score best, beside it or under the
sensors' noise, lets the disturbance explain so much less that its likelihood would pay for it.

A model that errs by many times the sensors' noise is searched: of its effects the tangents there
say little. So is one beside a band as narrow as a line.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from casid.diagnosis.evidence.gain_beside import gain_beside, unwhitened
from casid.diagnosis.evidence.prewhitening import Weighted, minus_log_likelihood
from casid.diagnosis.evidence.score_tests import ScoreTable
from casid.diagnosis.evidence.signature_columns import extended_columns
from casid.diagnosis.evidence.sufficiency import error_over_noise
from casid.diagnosis.search.disturbance_price import as_white, is_held, price_of
from casid.diagnosis.search.residual_check import is_more_than_noise
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.search.temporary_changes import temporary_changes
from casid.diagnosis.thresholds import DISTURBED, RESTARTS
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
    if error_over_noise(base, start.noise) > RESTARTS.far:
        return None
    search.progress("test whether a random disturbance explains all that the model leaves")
    beside = search.with_disturbances()
    bare = search.under_disturbance(base)
    if minus_log_likelihood(bare) > as_white(base) or is_more_than_noise(bare, beside):
        return None
    if not is_resolved(bare):
        return None
    table = beside.table(bare, [])
    if table.smallest is not None and table.smallest.adjusted < search.alpha:
        return None
    alone = search.table(start, [])
    needed = 0.5 * price_of(1, start.criterion.n_samples, len(alone.tested))
    at = replace(bare, fit=bare.unbiased or bare.fit)
    plain = replace(at.fit, criterion=unwhitened(at))
    for effects, noise in ((_best(bare, table), bare.noise), (_best(start, alone), start.noise)):
        columns = extended_columns(plain, effects)
        gain = gain_beside(
            at,
            columns,
            range(len(columns.effects)),
            known=search.weighing.known_noise,
            passing=needed,
            under=noise,
        )
        if gain > DISTURBED.share * needed:
            return None
    search.first_table = table
    return bare


def is_resolved(bare: Weighted) -> bool:
    """False of a band that the record resolves no better than a line, which may be one."""
    longest = max(d.N * d.Ts for d in bare.criterion.data)
    widths = [
        2 * shape.damping * shape.frequency / (2 * np.pi)
        for shape in bare.noise.spectra.values()
        if shape.damping is not None
    ]
    return all(width * longest > 1.0 for width in widths)


def _best(at: Weighted, table: ScoreTable) -> list[Effect]:
    """The effects that score best, and the changes that are over before the record is.

    Without lines: those are estimates, and were tested as such.
    """
    scored = [s for s in table.tested if s.effect.test != "peak"]
    scored.sort(key=lambda s: -s.unrobust)
    best = [*scored[: DISTURBED.looked_at], *temporary_changes(at, table)]
    return [s.effect for s in best]
