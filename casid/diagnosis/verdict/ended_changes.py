"""Changes for a while that end where a record is held out, or where nothing shows their end.

The fitted part knows such a change as one that lasts, which what was held out refuses: a load that
is taken off there, or a pump that failed at the last dose that was fitted and did not at the next.
Whole records show both its instants.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from casid.diagnosis.search.adoption.refinement import weighed_whole, whole_fit
from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.search.findings import Findings
from casid.diagnosis.search.residual_check import is_noise_alone
from casid.diagnosis.thresholds import RESTARTS
from casid.estimation.noise.variances import error_over_noise
from casid.estimation.simulation.fit import FitSettings


def may_be_over(found: Findings, settings: FitSettings) -> bool:
    """True if what was held out refused a change that explains all of a large misfit before it.

    Parameters
    ----------
    settings : of the fits.
    """
    if found.baseline.why_undecided or found.baseline.split.is_empty:
        return False
    refused = [c for c, why in found.search.refused if c.effect.sets_in and why.error == "held-out"]
    best = max(refused, key=lambda c: c.gain, default=None)
    if best is None:
        return False
    what = "the test whether a change is over where the record is held out"
    once = replace(settings, starts=1)
    return bool(found.search.attempts.attempt(what, partial(_explains_all, found, best, once)))


def _explains_all(found: Findings, change: Candidate, settings: FitSettings) -> bool:
    """True if the fitted part is noise alone with the change, and far more without it."""
    baseline, start = found.baseline, change.fit.values
    units = baseline.fit.criterion.weights
    fit = whole_fit(change.model, baseline.split, settings, units, start)
    at = weighed_whole(baseline.weighing, fit, settings)[1]
    is_far = error_over_noise(found.base_fit, at.noise) > RESTARTS.explained
    return is_far and is_noise_alone(at, found.search)
