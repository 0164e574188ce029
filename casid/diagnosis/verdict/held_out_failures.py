"""Whether a model that leaves noise of what was fitted fails in what was held out."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.findings import Findings
from casid.diagnosis.verdict.gain import (
    Errors,
    chance_by_estimates,
    unlike_held_out,
    unlike_under_disturbance,
)
from casid.diagnosis.verdict.tested_remainder import Remainder
from casid.estimation.estimate import Estimate
from casid.estimation.simulation.minimization import Fit


def unlike_where_held_out(
    found: Findings, fitted: Errors, held: Errors, baseline: Estimate, beside: Weighted | None
) -> str:
    """Why what was held out contradicts a model that the fitted part does not."""
    if beside is not None and beside.unbiased is not None:
        return unlike_under_disturbance(beside, found.baseline.split)
    added = by_estimates(found, found.base_fit, held, baseline)
    return unlike_held_out(found, fitted, held, added)


def failing_where_held_out(
    found: Findings,
    fitted: Errors,
    held: Errors,
    extended: Estimate | None,
    remainder: Remainder | None,
) -> str:
    """How causes that leave noise of what was fitted fail in what was held out, or empty."""
    if extended is None or remainder is None or not remainder.is_noise or not held:
        return ""
    added = by_estimates(found, found.best_fit, held, extended)
    return unlike_held_out(found, fitted, held, added, "extended_rmse")


def by_estimates(
    found: Findings, fit: Fit, held: Errors, estimate: Estimate
) -> Mapping[str, float]:
    """Error that the estimates' standard errors may add to the held-out part of a fitted model."""
    if not held:
        return {}
    split, floor = found.baseline.split, held["noise_floor"]
    of = partial(chance_by_estimates, fit, estimate.covariance, split, floor)
    return found.search.attempts.attempt("what the estimates add to what was held out", of) or {}
