"""How well a study estimates each parameter: bias, spread and coverage over its runs."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.campaigns.campaign import Campaign
from casid.data.problem import Problem
from casid.model.quantities import count_text

STD_ERROR = ".std_error"
"""Behind a parameter's name: the column of its standard errors."""
ENDS = (".lower", ".upper")
"""The columns of the ends of its intervals, of whatever kind they are."""
MISLEADING = 0.42
"""Spreads of a bias that misleads: 95 % intervals of the right length hold the truth 93 times in a
hundred, Phi(1.96 - b) - Phi(-1.96 - b)."""
_TAIL = 0.00135  # probability beyond three standard errors of a normal mean, on either side


@dataclass(frozen=True, slots=True)
class Accuracy:
    """How well one parameter is estimated, in its unit.

    Attributes
    ----------
    truth : the simulator's value, None where it is not given.
    n : runs with an estimate.
    mean, spread : mean and standard deviation (divisor n - 1) of the estimates.
    mean_std_error : mean of the standard errors that the estimates report.
    intervals, covered : runs with an interval, and those whose 95 % interval holds the truth.
    """

    name: str
    unit: str
    truth: float | None
    n: int
    mean: float
    spread: float
    mean_std_error: float
    intervals: int
    covered: int

    @property
    def bias(self) -> float | None:
        """Mean minus truth."""
        return None if self.truth is None else self.mean - self.truth

    @property
    def bias_std_error(self) -> float:
        """Standard error of the mean, and so of the bias: spread / sqrt(runs)."""
        return self.spread / math.sqrt(self.n) if self.n > 1 else math.nan

    @property
    def spread_std_error(self) -> float:
        """Standard error of the spread of normal estimates: spread / sqrt(2 (n - 1))."""
        return self.spread / math.sqrt(2 * (self.n - 1)) if self.n > 1 else math.nan

    @property
    def coverage(self) -> float | None:
        """Share of the intervals that hold the truth; 0.95 were everything as assumed."""
        if self.truth is None or not self.intervals:
            return None
        return self.covered / self.intervals

    @property
    def coverage_interval(self) -> tuple[float, float] | None:
        """95 % interval of the coverage (Wilson, JASA 22 (1927) 209-212), binomial."""
        if self.coverage is None:
            return None
        z2, n, share = 1.96**2, self.intervals, self.coverage
        middle = (share + z2 / (2 * n)) / (1 + z2 / n)
        half = math.sqrt(z2 * (share * (1 - share) / n + z2 / (4 * n**2))) / (1 + z2 / n)
        return max(0.0, middle - half), min(1.0, middle + half)

    @property
    def is_biased(self) -> bool:
        """True of a bias that chance explains in 0.27 % of studies, by Student's t."""
        from scipy.special import stdtrit

        if self.bias is None or self.n < 2:
            return False
        return abs(self.bias) > float(stdtrit(self.n - 1, 1 - _TAIL)) * self.bias_std_error

    @property
    def is_misled(self) -> bool:
        """True of a bias that costs intervals of the right length two points of their coverage."""
        return self.is_biased and abs(self.bias or 0.0) > MISLEADING * self.spread

    @property
    def mean_text(self) -> str:
        """The mean with the digits that the finite number of runs leaves meaningful."""
        error = self.bias_std_error
        if not (math.isfinite(error) and error > 0):
            return f"{self.mean:.6g}"
        places = 1 - math.floor(math.log10(error))
        return f"{self.mean:.{max(places, 0)}f}" if -2 <= places <= 8 else f"{self.mean:.6g}"

    @property
    def remarks(self) -> tuple[str, ...]:
        """What differs from what the standard errors promise by more than chance would explain.

        Chance alone gives each in 0.27 % of studies, as three standard errors of a normal mean.
        """
        from scipy.special import bdtr, bdtrc

        out = []
        if self.is_biased:
            size = abs(self.bias or 0.0)
            spreads = f"{size / self.spread:.2g}" if self.spread else "infinitely many"
            out.append(f"biased by {spreads} standard deviations")
        if self.coverage is not None:  # binomial
            if bdtr(self.covered, self.intervals, 0.95) < _TAIL:
                out.append("95 % intervals contain the truth too rarely")
            if self.covered and bdtrc(self.covered - 1, self.intervals, 0.95) < _TAIL:
                out.append("95 % intervals contain the truth too often")
        if self.intervals < self.n:
            out.append(f"{count_text(self.n - self.intervals, 'run')} without interval")
        return tuple(out)

    def to_json(self) -> dict[str, Any]:
        """The fields as `montecarlo.json` holds them."""
        return {
            **asdict(self),
            "bias": self.bias,
            "bias_std_error": self.bias_std_error,
            "spread_std_error": self.spread_std_error,
            "coverage": self.coverage,
            "coverage_interval": self.coverage_interval,
            "remarks": list(self.remarks),
        }


def accuracy(problem: Problem, done: Campaign) -> list[Accuracy]:
    """The columns of a study, compared with the problem's truth."""
    model, columns = problem.model, done.table.columns
    return [
        accuracy_of(
            column,
            model.unit_of(column) if column in model.parameters else "",
            problem.truth.get(column),
            done.column(column).astype(float),
            done.column(column + STD_ERROR).astype(float),
            tuple(done.column(column + end).astype(float) for end in ENDS)
            if all(column + end in columns for end in ENDS)
            else (),
        )
        for column in columns
        if column + STD_ERROR in columns
    ]


def accuracy_of(
    name: str,
    unit: str,
    truth: float | None,
    value: Array,
    error: Array,
    ends: tuple[Array, ...] = (),
) -> Accuracy:
    """Accuracy of estimates (n,) in `unit` with standard errors (n,), NaN where there is none.

    Parameters
    ----------
    ends : lower and upper (n,) of their intervals; by default the normal ones.
    """
    lower, upper = ends or (value - 1.96 * error, value + 1.96 * error)
    is_there = np.isfinite(value)
    has_error = is_there & np.isfinite(error)
    has_interval = is_there & ~np.isnan(lower) & ~np.isnan(upper)
    n = int(is_there.sum())
    inside = has_interval & (lower <= (truth or 0.0)) & ((truth or 0.0) <= upper)
    return Accuracy(
        name=name,
        unit=unit,
        truth=truth,
        n=n,
        mean=float(value[is_there].mean()) if n else math.nan,
        spread=float(value[is_there].std(ddof=1)) if n > 1 else math.nan,
        mean_std_error=float(error[has_error].mean()) if has_error.any() else math.nan,
        intervals=int(has_interval.sum()),
        covered=0 if truth is None else int(inside.sum()),
    )
