"""Whether a model that leaves noise of what was fitted fails in what was held out."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import name_of
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
        return unlike_under_disturbance(found, beside)
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


def other_clocks(found: Findings) -> tuple[str, ...]:
    """A note on records held out as a whole that no model with a change at an instant is judged by.

    None without such a change, or where all of them are on the clock of what was fitted.
    """
    split, model = found.baseline.split, found.best_fit.criterion.model
    apart = " and ".join(e.name for e in split.apart if not split.judges(model, e))
    if not apart:
        return ()
    rows = (a.candidate.effect for a in (*found.adopted, *found.remainders))
    what = " and ".join(dict.fromkeys(name_of(e) for e in rows if e.is_on_the_clock))
    fitted = " and ".join(e.name for e in split.whole)
    return (
        f"{what} was found on the clock of {fitted}. {apart} is not known to be on that clock, and "
        "is simulated without it: it neither confirms nor refutes a model with it, and no error "
        f"of it is stated. A later window of the file that was fitted would (--hold-out "
        "FILE@START:STOP)",
    )


def by_estimates(
    found: Findings, fit: Fit, held: Errors, estimate: Estimate
) -> Mapping[str, float]:
    """Error that the estimates' standard errors may add to the held-out part of a fitted model."""
    if not held:
        return {}
    floor = held["noise_floor"]
    split = found.baseline.split.judging(found.best_fit.criterion.model)
    of = partial(chance_by_estimates, fit, estimate.covariance, split, floor)
    return found.search.attempts.attempt("what the estimates add to what was held out", of) or {}
