"""Causes that noise on measured inputs feigns.

A least-squares fit to noisy inputs is biased, and an effect may make up for that: a recorded
channel that predicts the input, and carries other noise, takes a part of the input's work. Beside
all causes such an effect is significant by the biased fit, and nothing by the estimate without the
bias.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from casid.diagnosis.search.adoption.refinement import Adoption, Refinement
from casid.diagnosis.search.candidates import Adopted, null_values
from casid.diagnosis.search.refusals import FEIGNED
from casid.diagnosis.thresholds import ROUNDS
from casid.estimation.errors_in_variables.removal import Corrected
from casid.estimation.simulation.minimization import Fit


def without_feigned(
    refine: Refinement,
    found: Adoption,
    corrected: Corrected,
    correct: Callable[[Fit], Corrected | None],
) -> tuple[Adoption, Corrected]:
    """The causes that are significant without the bias, and their estimate; one cause stays.

    A cause that the unbiased simulation misses stays too: it may be ill determined.

    Parameters
    ----------
    corrected : the fit of `found` without the bias of noise on its inputs.
    correct : takes that bias out of another fit; None where the result is no better.
    """
    while len(found.adopted) > 1 and found.fit is not None:
        feigned = _least_significant(found.adopted, corrected)
        if feigned is None:
            break
        fit = refine.fit_without(found.fit, feigned.candidate, found.adopted)
        kept = [a for a in found.adopted if a is not feigned]
        lean = refine.rebuilt(found, kept, fit)
        again = correct(lean.fit) if lean.fit is not None else None
        if again is None or not again.is_removed or refine.is_missed(corrected.fit, again.fit):
            break
        refine.search.refused.append((feigned.candidate, FEIGNED))
        found, corrected = lean, again
    return found, corrected


def _least_significant(adopted: tuple[Adopted, ...], corrected: Corrected) -> Adopted | None:
    """The cause of one size that is least of all significant without the bias, if one is not."""
    if not corrected.is_removed or corrected.covariance is None:
        return None
    fit = corrected.fit
    names, sd = fit.criterion.names, np.sqrt(np.diag(corrected.covariance).clip(min=0.0))
    distances = {}
    for k, a in enumerate(adopted):
        c = a.candidate
        if c.effect.test != "score" or c.effect.cost > 1 or c.names[0] not in names:
            continue
        i = names.index(c.names[0])
        if sd[i] > 0.0:
            distances[k] = abs(fit.x[i] - null_values(c)[c.names[0]]) / sd[i]
    least = min(distances, key=lambda k: distances[k], default=None)
    if least is None or distances[least] > ROUNDS.backward_wald:
        return None
    return adopted[least]
