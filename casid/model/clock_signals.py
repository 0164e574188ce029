"""Signals that are functions of the clock of a record: a step, a ramp, the time itself.

They are what generated inputs are made of. Each is a value, so that a model with them can be
saved, compared and written into another language; calling one gives its samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array


@dataclass(frozen=True, slots=True)
class StepAt:
    """0 before `time` and 1 after it, seconds of the record's clock.

    One sample is a fraction, so that the instant moves smoothly: that around it where samples are
    joined by straight lines, whose mean is the step's then. A sample that `is_held` until the next
    is the mean of the step from the one to the other; a held step at a sample is 1 from it on.
    """

    time: float
    is_held: bool = False

    def __call__(self, t: Array) -> Array:
        """Samples (N,) at the times t (N,) [s]."""
        return np.asarray(np.clip((t - self.time) / (t[1] - t[0]) + self._ahead, 0.0, 1.0))

    def expression(self, t: Any, Ts: float) -> Any:
        """The sample that begins at the time `t`, a CasADi symbol; Ts [s]."""
        return ca.fmin(ca.fmax((t - self.time) / Ts + self._ahead, 0.0), 1.0)

    @property
    def _ahead(self) -> float:
        """Samples by which a sample's value is that of a time after it."""
        return 1.0 if self.is_held else 0.5


@dataclass(frozen=True, slots=True)
class RampOver:
    """(t - t_mid) / (stop - start), t_mid in the middle: -1/2 at `start`, 1/2 at `stop` [s]."""

    start: float
    stop: float

    def __call__(self, t: Array) -> Array:
        """Samples (N,) at the times t (N,) [s]."""
        return np.asarray((t - 0.5 * (self.start + self.stop)) / (self.stop - self.start))

    def expression(self, t: Any, Ts: float) -> Any:
        """The value at the time `t`, a CasADi symbol."""
        return (t - 0.5 * (self.start + self.stop)) / (self.stop - self.start)


@dataclass(frozen=True, slots=True)
class TimeSince:
    """Seconds since `origin` of the record's clock."""

    origin: float

    def __call__(self, t: Array) -> Array:
        """Samples (N,) at the times t (N,) [s]."""
        return np.asarray(t - self.origin)

    def expression(self, t: Any, Ts: float) -> Any:
        """The value at the time `t`, a CasADi symbol."""
        return t - self.origin


@dataclass(frozen=True, slots=True)
class Always:
    """1 on the record's own clock; as every generated signal, 0 in a record apart."""

    def __call__(self, t: Array) -> Array:
        """Samples (N,) at the times t (N,) [s]."""
        return np.ones_like(t)

    def expression(self, t: Any, Ts: float) -> Any:
        """1."""
        return ca.SX(1)


ClockSignal = StepAt | RampOver | TimeSince | Always
