"""The actual false-alarm rate of a diagnosis on one record, and the level to judge at."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.stats import binomtest

from casid.arrays import Array
from casid.deprecation import renamed
from casid.presentation import Presented, present

SOURCES = (
    "G. A. Barnard, J. R. Stat. Soc. B 25 (1963) 294: Monte Carlo tests",
    "A. C. Davison, D. V. Hinkley, Bootstrap Methods and their Application, Cambridge 1997",
    "C. J. Clopper, E. S. Pearson, Biometrika 26 (1934) 404-413: interval of a share",
)
"""Papers behind a calibration."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration(Presented):
    """The actual rate of a false-alarm level on one record.

    Attributes
    ----------
    alpha : the family-wise rate that was requested.
    requested : null records requested; `runs` are those diagnosed.
    levels : (runs,) the level at which each null record becomes an alarm: its cause's p-value, or
        the smallest adjusted p, but no less than `alpha`, where there was none.
    smallest : (runs,) smallest adjusted p of each record's first table of scores, 1 without one.
    alarms : (runs,) bool, called deficient at `alpha`.
    seed : of all drawings.
    undecided : null records that could not support an answer.
    failures : message -> null records whose diagnosis failed with it; they count for nothing.
    is_interrupted : True if fewer were done than requested.
    """

    problem: str
    alpha: float
    requested: int
    levels: Array
    smallest: Array
    alarms: Array
    seed: int = 0
    undecided: int = 0
    failures: Mapping[str, int] = field(default_factory=dict)
    is_interrupted: bool = False

    asked = renamed("asked", "requested")

    @property
    def runs(self) -> int:
        """Null records that were diagnosed."""
        return len(self.levels)

    @property
    def rate(self) -> float:
        """Share of the null records that were called deficient at `alpha`."""
        return float(np.mean(self.alarms))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the rate (Clopper and Pearson 1934), exact for a binomial count."""
        found = binomtest(int(np.sum(self.alarms)), self.runs).proportion_ci(0.95, "exact")
        return float(found.low), float(found.high)

    @property
    def threshold(self) -> float:
        """The level to judge the record at, (1) of `false_alarm_rate`.

        It is `alpha` where the runs are too few to say.
        """
        k = self._rank
        return min(self.alpha, float(np.sort(self.levels)[k - 1])) if k else self.alpha

    @property
    def is_corrected(self) -> bool:
        """True if the threshold is stricter than the level requested."""
        return self.threshold < self.alpha

    @property
    def quantile(self) -> float:
        """The alpha-quantile of `smallest`: alpha, if scores alone decided and were exact."""
        k = self._rank
        return float(np.sort(self.smallest)[k - 1]) if k else math.nan

    @property
    def _rank(self) -> int:
        """k of (1) in `false_alarm_rate`."""
        return math.floor(self.alpha * (self.runs + 1) * (1 + 1e-12))

    def p_value(self, level: float) -> float:
        """The calibrated p-value of an alarm at `level`: its rank among the null records.

        (1 + number of null records at that level or below) / (runs + 1).
        """
        return float((1 + np.sum(self.levels <= level)) / (self.runs + 1))

    @property
    def sentence(self) -> str:
        """The rate found and its interval, in a sentence."""
        low, high = (100 * x for x in self.interval)
        text = (
            f"Of {self.runs} null records (this one simulated with the fitted model), "
            f"{int(np.sum(self.alarms))} ({100 * self.rate:.3g} %, 95 % interval {low:.2g} to "
            f"{high:.2g} %) were called deficient, where {100 * self.alpha:g} % was requested"
        )
        if not self._rank:
            needed = math.ceil(1 / self.alpha - 1e-9) - 1
            return (
                f"{text}; the threshold is unchanged, since correcting it needs at least {needed} "
                "null records"
            )
        if self.is_corrected:
            return f"{text}; judged at the stricter level {self.threshold:.2g} instead"
        return f"{text}; the threshold is unchanged"

    @property
    def notes(self) -> tuple[str, ...]:
        """Reasons to trust the rate less."""
        out = []
        if self.is_interrupted:
            out.append(f"interrupted: {self.runs} of {self.requested} null records were done")
        if self.undecided:
            out.append(f"undecided null records, not counted as alarms: {self.undecided}")
        out += [f"{n} null records failed: {message}" for message, n in self.failures.items()]
        return tuple(out)

    def to_json(self) -> dict[str, Any]:
        """Every number, for `diagnosis.json`."""
        return {
            "alpha": self.alpha,
            "asked": self.requested,
            "runs": self.runs,
            "alarms": int(np.sum(self.alarms)),
            "rate": self.rate,
            "interval": list(self.interval),
            "threshold": self.threshold,
            "is_corrected": self.is_corrected,
            "levels": self.levels.tolist(),
            "smallest_adjusted_p": self.smallest.tolist(),
            "quantile": None if math.isnan(self.quantile) else self.quantile,
            "seed": self.seed,
            "undecided": self.undecided,
            "failures": dict(self.failures),
            "is_interrupted": self.is_interrupted,
            "sentence": self.sentence,
        }

    def __repr__(self) -> str:
        return (
            f"<Calibration {self.problem}: {self.runs} runs, rate {self.rate:.3g} at "
            f"{self.alpha:g}, threshold {self.threshold:.2g}>"
        )

    def plot(self) -> Any:
        """Histogram of the smallest adjusted p against the uniform, as a Plotly figure."""
        return present(self, "figure")

    def references(self) -> tuple[str, ...]:
        """The papers behind the method."""
        return SOURCES
