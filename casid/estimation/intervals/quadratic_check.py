"""Whether the criterion is a parabola near its minimum, as a normal interval assumes.

It is evaluated two standard errors to either side of the estimate, along the direction in which the
other unknowns follow, and from there with a Gauss-Newton step of these: to second order its value
with the unknown held, for one pass over the records. A parabola has risen by four there, in the
units of `scaled_criterion`. What has risen by another amount is curved (both sides) or skewed (one
more than the other).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casid.estimation.intervals.scaled_criterion import ScaledCriterion
from casid.estimation.intervals.thresholds import QUADRATIC_TEST


@dataclass(frozen=True, slots=True)
class NotQuadratic:
    """Why a normal interval of an unknown means little.

    Attributes
    ----------
    reason : what unknowns may have in common.
    detail : what is this one's own.
    """

    reason: str
    detail: str = ""

    def __str__(self) -> str:
        return f"{self.reason} ({self.detail})" if self.detail else self.reason


def why_not_quadratic(scaled: ScaledCriterion, name: str) -> NotQuadratic | None:
    """Why a normal interval of an unknown means little; None where it is as good as any.

    Of a fit in segments or under constraints the bounds alone are looked at.
    """
    i = scaled.names.index(name)
    if not scaled.free[i]:
        return NotQuadratic("it is at a bound")
    reach = QUADRATIC_TEST.at * scaled.std_error(i)
    for side, bound in ((-1, scaled.lower[i]), (1, scaled.upper[i])):
        if side * (bound - scaled.x[i]) < reach:
            off = abs(bound - scaled.x[i]) / scaled.std_error(i)
            return NotQuadratic("a bound is near", f"{off:.2g} standard errors away")
    if scaled.tied.size:
        return None
    rises = [_rise(scaled, i, side * reach) for side in (-1, 1)]
    roots = np.sqrt(np.maximum(rises, 0.0)) / QUADRATIC_TEST.at
    if np.all(np.abs(roots - 1) <= QUADRATIC_TEST.half_length):
        return None
    low, high = (f"{r:.2g}" if np.isfinite(r) else "no number" for r in rises)
    return NotQuadratic(
        f"the criterion does not rise as a parabola does, by {QUADRATIC_TEST.at**2:g} at "
        f"{QUADRATIC_TEST.at:g} standard errors below and above the estimate",
        f"by {low} and {high}",
    )


def _rise(scaled: ScaledCriterion, i: int, way: float) -> float:
    """The drop with an unknown held so far from the estimate, to second order."""
    _, direction = scaled.path(i)
    x = np.clip(scaled.x + way * direction, scaled.lower, scaled.upper)
    at = scaled.criterion.evaluate(x)
    if not (np.isfinite(at.value) and np.all(np.isfinite(at.hessian))):
        return np.inf
    others = scaled.free.copy()
    others[i] = False
    slope, matrix = at.gradient[others], at.hessian[np.ix_(others, others)]
    fall = 0.5 * float(slope @ np.linalg.pinv(matrix, hermitian=True) @ slope)
    return scaled.drop(at.value - fall, i)
