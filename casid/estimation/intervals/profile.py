"""The interval of an unknown by the profile of the criterion.

The values that the records cannot reject: those at which the drop of `scaled_criterion` is below
the quantile of chi squared with one degree of freedom. The signed root of the drop is close to
linear in the unknown however skewed the interval is, so that each end takes a few refits.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.stats import norm

from casid.arrays import Array
from casid.estimation.intervals.scaled_criterion import ScaledCriterion
from casid.estimation.intervals.thresholds import PROFILE_SEARCH


@dataclass(frozen=True, slots=True)
class ProfileInterval:
    """The ends, infinite where the records set no limit, and what was seen on the way.

    Attributes
    ----------
    lower, upper : NaN where the refits next to the estimate ended short of their minima: all that
        was found beside it would be rejected.
    lower_minimum : where the criterion is lower than at the estimate, the value of the unknown.
    """

    lower: float
    upper: float
    lower_minimum: float | None = None

    @property
    def is_found(self) -> bool:
        """False where an end is not a number."""
        return not (np.isnan(self.lower) or np.isnan(self.upper))


def profile_interval(scaled: ScaledCriterion, name: str) -> ProfileInterval:
    """The 95 % interval of one unknown, within its bounds.

    At a bound it covers at least as often: there the drop is smaller than chi squared (Self and
    Liang 1987).
    """
    search = _Search(scaled, scaled.names.index(name))
    lower, upper = (search.end(side) for side in (-1.0, 1.0))
    return ProfileInterval(lower, upper, search.lower_minimum)


@dataclass(slots=True)
class _Search:
    """The ends of one profile."""

    scaled: ScaledCriterion
    i: int
    lower_minimum: float | None = None
    _lowest: float = -1e-3  # of the drop: less is rounding
    _known: list[Array] = field(default_factory=list)

    def root(self, held: float) -> float:
        """The root of the drop, from the nearest point known."""
        scaled, i = self.scaled, self.i
        near = min((scaled.x, *self._known), key=lambda x: abs(x[i] - held))
        _, direction = scaled.path(i)
        drop, x = scaled.refit(i, held, near + (held - near[i]) * direction)
        if np.isfinite(drop):
            self._known.append(x)
            if drop < self._lowest:
                self._lowest, self.lower_minimum = drop, held
        return float(np.sqrt(max(drop, 0.0)))

    def end(self, side: float) -> float:
        """Where the root is that of the quantile, on one side; the bound where it comes first.

        NaN where the root leaps over it next to the estimate.
        """
        target = float(norm.ppf(0.5 + 0.5 * PROFILE_SEARCH.level))
        middle = float(self.scaled.x[self.i])
        limit = float((self.scaled.lower if side < 0 else self.scaled.upper)[self.i])
        if limit == middle:
            return limit
        inner, outer = (middle, 0.0), (side * np.inf, np.inf)  # value and root
        held = middle + side * target * self.scaled.std_error(self.i)
        kept = 0  # times that one end of the bracket stayed, positive of the outer one
        for _ in range(PROFILE_SEARCH.refits):
            held = side * min(side * held, side * limit)
            root = self.root(held)
            if abs(root - target) <= PROFILE_SEARCH.converged * target:
                return held
            if root > target:
                outer, kept = (held, root), min(kept, 0) - 1
            elif held == limit:
                return limit
            else:
                inner, kept = (held, root), max(kept, 0) + 1
            held = _next(middle, inner, outer, target, kept)
        least = PROFILE_SEARCH.nearest * self.scaled.std_error(self.i)
        leaps = outer[1] - inner[1] > PROFILE_SEARCH.leap * target
        if leaps and abs(outer[0] - middle) < least:
            return np.nan
        return outer[0] if np.isfinite(outer[1]) else side * np.inf


def _next(
    middle: float, inner: tuple[float, float], outer: tuple[float, float], target: float, kept: int
) -> float:
    """The next value to try: on the line through the roots, or outside by what they have grown.

    Of an end of the bracket that stays, the distance from the target counts by half each time
    (Dowell and Jarratt, BIT 11 (1971) 168-174): a root that rises late comes no nearer otherwise.

    Parameters
    ----------
    kept : times in a row that the outer end stayed, or as a negative number the inner one.
    """
    way = inner[0] - middle
    if not np.isfinite(outer[0]):
        factor = target / inner[1] if inner[1] > 0 else PROFILE_SEARCH.growth
        return middle + way * float(np.clip(factor, 1 + 1e-3, PROFILE_SEARCH.growth))
    if not np.isfinite(outer[1]):
        return 0.5 * (inner[0] + outer[0])
    below, above = target - inner[1], outer[1] - target
    below *= 0.5 ** max(-kept - 1, 0)
    above *= 0.5 ** max(kept - 1, 0)
    share = below / (below + above)
    return inner[0] + float(np.clip(share, 0.05, 0.95)) * (outer[0] - inner[0])
