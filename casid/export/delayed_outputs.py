"""Delays of sensors in the step of a sampled model: past outputs as a memory, interpolated.

A fit delays a simulated column by cubic convolution (`delay_columns`): the delayed output is a sum
of four samples around the instant at which it was sensed. A step keeps as many past samples as
that takes and gives the same sum. Before its first sample a column is on the straight line through
its first two samples, with which the first step fills the memory; an output that was at rest is
constant there.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from casid.estimation.simulation.channels.sensor_dynamics import delay_weights

Expr = Any  # a CasADi SX expression


@dataclass(frozen=True, slots=True)
class SampledDelay:
    """A delay of the output at `place`, in samples.

    Attributes
    ----------
    whole, weights : the delayed sample k is the sum of weights[i] y[k - whole - 2 + i], i = 0..3.
    at_rest : before the first sample the output was what it is there.
    """

    place: int
    whole: int
    weights: tuple[float, ...]
    at_rest: bool = False

    @property
    def kept(self) -> int:
        """Number of past samples that it takes."""
        return self.whole + 2


def sampled_delays(
    outputs: Sequence[str], delays: Mapping[str, float], Ts: float, at_rest: Collection[str]
) -> list[SampledDelay]:
    """The delays [s] of `delays` at the sample time Ts [s], in the order of `outputs`."""
    found = []
    for place, name in enumerate(outputs):
        if name in delays:
            whole, weights = delay_weights(delays[name] / Ts)
            numbers = tuple(float(w) for w in weights)
            found.append(SampledDelay(place, whole, numbers, name in at_rest))
    return found


def delayed(
    y: Expr, y_next: Expr, past: Expr, has_begun: Expr, delays: Sequence[SampledDelay]
) -> tuple[Expr, list[Expr]]:
    """Outputs (ny,) as the sensors give them, and the memory after this sample.

    Parameters
    ----------
    y, y_next : (ny,) what arrives at the sensors at this sample and the next.
    past : as many numbers as all `kept` together, or more.
    has_begun : 1 after the first sample.
    """
    out, first = ca.vertsplit(y), 0
    kept: list[Expr] = []
    for d in delays:
        now, after = y[d.place], y_next[d.place]
        rise = 0.0 if d.at_rest else after - now
        before = [
            ca.if_else(has_begun > 0.5, past[first + j], now - (j + 1) * rise)
            for j in range(d.kept)
        ]
        first += d.kept
        around = [*reversed(before), now, after]  # from y[k - whole - 2] to y[k + 1]
        out[d.place] = sum(w * around[i] for i, w in enumerate(d.weights))
        kept += [now, *before[:-1]]
    return ca.vertcat(*out), kept
