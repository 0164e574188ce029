"""What a monitor is set to, and what it reports: intervals, statuses and alarms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from casid.model.quantities import p_statement

Function = Callable[[Mapping[str, float]], float]


@dataclass(frozen=True, slots=True)
class Derived:
    """A number that follows from all parameters, with the limit it should not fall below.

    Attributes
    ----------
    function : of a mapping of every parameter of the model to its value, in its unit.
    unit : of its value.
    limit : alarm when the lower end of its interval is below; None: no alarm.
    """

    function: Function
    unit: str
    limit: float | None = None


@dataclass(frozen=True, slots=True)
class Interval:
    """A number with its standard error and a two-sided interval."""

    value: float
    std_error: float
    lower: float
    upper: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value:.4g} [{self.lower:.4g}, {self.upper:.4g}] {self.unit}"


@dataclass(frozen=True, slots=True, eq=False)
class Status:
    """What is known at one time.

    Attributes
    ----------
    time : end of the last window [s], from the first sample that entered the sums.
    estimates : free parameter or derived number -> interval.
    windows : that the estimate comes from.
    statistic : T^2 of the detector; nan while it learns. p_value : of it.
    """

    time: float
    estimates: Mapping[str, Interval]
    windows: int
    statistic: float
    p_value: float

    def __getitem__(self, name: str) -> Interval:
        """The interval of a free parameter or a derived number."""
        return self.estimates[name]

    def __str__(self) -> str:
        found = ", ".join(f"{n} {i}" for n, i in self.estimates.items())
        return f"t = {self.time:.0f} s, {self.windows} windows: {found}"


@dataclass(frozen=True, slots=True, eq=False)
class Alarm:
    """What was found, when, and how sure it is.

    Attributes
    ----------
    kind : "change" of the free parameters, or "limit": a derived number is near its limit.
    what : the free parameters, or the derived number.
    time : of the alarm; since : when the change is thought to have been [s].
    statistic, p_value : of the detector for a change; for a limit, standard errors from the limit,
        and the probability of a smaller number.
    before, after : estimates on either side of a change; equal for a limit.
    """

    kind: Literal["change", "limit"]
    what: str
    time: float
    since: float
    statistic: float
    p_value: float
    before: Mapping[str, Interval]
    after: Mapping[str, Interval]

    def __str__(self) -> str:
        if self.kind == "limit":
            return f"t = {self.time:.0f} s: {self.what} is small: {self.after[self.what]}"
        moved = "; ".join(f"{n} from {i} to {self.after[n]}" for n, i in self.before.items())
        return (
            f"t = {self.time:.0f} s: {self.what} changed at about {self.since:.0f} s "
            f"(T^2 = {self.statistic:.1f}, {p_statement(self.p_value)}): {moved}"
        )


@dataclass(frozen=True, slots=True)
class MonitorSettings:
    """How a stream is watched.

    Attributes
    ----------
    every : windows from one status to the next.
    span : windows in the estimate; it never reaches back beyond a change that was found.
    forgetting : weight of a window relative to the next one, instead of `span`.
    differential : subtract s_0 of the reference stretch.
    level : of the intervals, two-sided.
    power_memory : windows over which the power of the equation error is followed, by forgetting.
        The variance of u_c is taken as proportional to it, or to the window's own power where that
        is larger: a window's own is too noisy to call it a quiet one, but a sea that grows rough at
        once must not look like a change. A heuristic.
    method : discretisation of the model.
    """

    every: int = 3
    span: int = 15
    forgetting: float | None = None
    differential: bool = True
    level: float = 0.95
    power_memory: float = 15.0
    method: str = "bilinear"
