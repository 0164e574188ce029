"""What an estimate is to be of: the problem, its records, and how the fit is to go about it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from casid.data.problem import Problem
from casid.estimation.estimate import Estimate
from casid.estimation.holdout import Split
from casid.estimation.intervals.choice import (
    Estimation,
    chosen_intervals,
    patience_since,
    with_intervals,
)
from casid.estimation.simulation.fit import FitSettings
from casid.time_limit import Undone, wall_clock


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """The request of an estimate, as every step of `identify` takes it.

    Attributes
    ----------
    problem, settings, intervals, budget : as `identify` has them.
    split : the records, as fitted and as held out, with gaps of their inputs treated.
    start : variable -> start value, SI units, over the model's own.
    say : is called with a line of text before what may take seconds.
    began : when, by `wall_clock`.
    undone : what no time was left for.
    """

    problem: Problem
    split: Split
    settings: FitSettings
    start: Mapping[str, float] = field(default_factory=dict)
    intervals: str = "auto"
    budget: float | None = None
    say: Callable[[str], None] = lambda _: None
    began: float = field(default_factory=wall_clock)
    undone: Undone = field(default_factory=Undone)

    def with_intervals(
        self, estimate: Estimate, estimation: Estimation, kind: str | None = None
    ) -> Estimate:
        """The estimate with intervals of a kind, that requested by default, as time allows."""
        patience = patience_since(self.began, self.budget)
        kind = kind or self.intervals
        chosen = chosen_intervals(estimation, kind, self.undone, self.say, patience)
        return with_intervals(estimate, chosen)

    @property
    def is_free(self) -> bool:
        """Whether the fit has neither constraints nor a requested number of segments."""
        return not self.settings.constraints and self.settings.segments == 1
