"""Whether what was measured at a limit is a limit: a sensor that is clipped shows it, and noise.

Where little is clipped, a limit of the simulated output makes up for anything that lowers a peak:
a valve that was still closed as the record began, or a force that nobody recorded. What is measured
there goes on beyond the limit, and the simulation errs more at it than elsewhere.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import f as fisher

from casid.arrays import TINY
from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.thresholds import JUDGING
from casid.estimation.simulation.minimization import Fit


def why_no_limit(fit: Fit, c: Candidate, level: float) -> str:
    """Why a clipping is none: its readings scatter more at the limit than below; or an empty text.

    Parameters
    ----------
    fit : of the model with it.
    level : of Fisher's test that both scatter alike.
    """
    if c.effect.test != "clip":
        return ""
    channel, limit = c.effect.where, fit.values[c.names[0]]
    i = list(fit.criterion.model.outputs).index(channel)
    at_limit, below = [], []
    for e, data in enumerate(fit.criterion.data):
        simulated = fit.criterion.simulated(fit.x, e)
        is_used = data.used[:, i] > 0
        is_clipped = np.isclose(np.abs(simulated.y[:, i]), limit)
        at_limit.append(simulated.residual[is_used & is_clipped, i])
        below.append(simulated.residual[is_used & ~is_clipped, i])
    errors, others = np.concatenate(at_limit), np.concatenate(below)
    if not (errors.size and others.size):
        return ""
    ratio = float(np.mean(errors**2)) / max(float(np.mean(others**2)), TINY)
    p = float(fisher.sf(ratio, errors.size, others.size))
    if p >= level or ratio <= JUDGING.unlike**2:
        return ""
    return f"{channel} goes on beyond that limit: it scatters more there than below"
