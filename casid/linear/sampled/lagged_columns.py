"""Columns of a regression: linear combinations of lagged samples.

A regressor such as u_t - u_{t-2} is written down once, as taps on channels, and read by whoever
needs it: cross moments, instruments, simulations of the equation error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array


@dataclass(frozen=True, slots=True)
class Column:
    """sum_i weight_i * channel_i[t - lag_i].

    Attributes
    ----------
    name : what it is called in tables, as ``-y[t-1]`` or ``u[t] - u[t-2]``.
    taps : (channel, lag >= 0, weight), one for each term.
    """

    name: str
    taps: tuple[tuple[str, int, float], ...]

    @property
    def order(self) -> int:
        """The largest lag."""
        return max((lag for _, lag, _ in self.taps), default=0)

    def samples(self, signals: Mapping[str, Array], start: int) -> Array:
        """The column at t = start .. N-1, (N - start,), from signals of N samples each."""
        total: Array | None = None
        for channel, lag, weight in self.taps:
            signal = signals[channel]
            part = signal[start - lag : len(signal) - lag]
            total = weight * part if total is None else total + weight * part
        if total is None:
            raise ValueError(f"column {self.name} has no taps")
        return np.asarray(total)


def lagged(channel: str, lags: range, weight: float = 1.0) -> tuple[Column, ...]:
    """One column for each lag of a channel."""
    return tuple(Column(f"{channel}[t-{i}]", ((channel, i, weight),)) for i in lags)
