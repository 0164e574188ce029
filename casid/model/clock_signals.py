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

    In the sample around it the value is a fraction, so that a held signal has its mean there and
    the instant moves smoothly.
    """

    time: float

    def __call__(self, t: Array) -> Array:
        """Samples (N,) at the times t (N,) [s]."""
        return np.asarray(np.clip((t - self.time) / (t[1] - t[0]) + 0.5, 0.0, 1.0))

    def expression(self, t: Any, Ts: float) -> Any:
        """The sample that begins at the time `t`, a CasADi symbol; Ts [s]."""
        return ca.fmin(ca.fmax((t - self.time) / Ts + 0.5, 0.0), 1.0)


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
