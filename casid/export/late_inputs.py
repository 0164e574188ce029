"""Inputs that act late in the step of a sampled model: past commands as a memory.

A fit has a late input act as a line in each sample (`delayed_lines`): value, begin and end of the
line are sums of three samples around the instant at which the input was given. A step keeps as many
past samples as that takes. Before its first sample the input was what the rest that the model
begins in says, or what it is there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.estimation.simulation.channels.sample_lines import delayed_lines
from casid.model.declarations import Hold

Expr = Any  # a CasADi SX expression


@dataclass(frozen=True, slots=True)
class DeadTime:
    """How much later the input at `place` acts, in samples.

    Attributes
    ----------
    whole, weights : value at sample k, begin and end of the line are three sums (rows) of weights
        times u[k - whole - 1 + j], j = 0..2.
    rest : what the input was before the first sample, where that is known, SI.
    """

    place: int
    whole: int
    weights: tuple[tuple[float, ...], ...]
    rest: float | None = None

    @property
    def kept(self) -> int:
        """Number of past samples that it takes."""
        return self.whole + 1

    def acting(self, past: Sequence[Expr], now: Expr, after: Expr) -> list[Expr]:
        """Value, begin and end of the line; `past` has the last sample first."""
        around = [*reversed(past), now, after]  # from u[k - whole - 1] to u[k + 1]
        return [sum(w * u for w, u in zip(row, around, strict=False)) for row in self.weights]


def sampled_dead_times(
    inputs: Sequence[str],
    dead_times: Mapping[str, float],
    holds: Mapping[str, Hold],
    Ts: float,
    rest: Mapping[str, float],
) -> list[DeadTime]:
    """The dead times [s] at the sample time Ts [s], in the order of `inputs`.

    What is band-limited is joined by straight lines. `rest` has what inputs were before, if known.
    """
    found = []
    for place, name in enumerate(inputs):
        if name in dead_times:
            samples = dead_times[name] / Ts
            whole = int(np.floor(samples))
            pulses = np.eye(3, 7, k=2)  # at u[k - 1], u[k] and u[k + 1] of the sample k = 3
            lines = [delayed_lines(u, samples - whole, holds[name])[0][3] for u in pulses]
            rows = tuple(tuple(row) for row in np.array(lines).T.tolist())
            found.append(DeadTime(place, whole, rows, rest.get(name)))
    return found


def acting_late(
    u: Expr, u_next: Expr, past: Expr, has_begun: Expr, dead_times: Sequence[DeadTime]
) -> tuple[tuple[Expr, Expr, Expr, Expr], list[Expr]]:
    """The inputs (nu,) at this sample, at begin and end of its line, at the next, and the memory.

    Parameters
    ----------
    u, u_next : (nu,) what is given at this sample and the next.
    past : as many numbers as all `kept` together, or more.
    has_begun : 1 after the first sample.
    """
    now, begin, end, later = (ca.vertsplit(each) for each in (u, u, u_next, u_next))
    kept: list[Expr] = []
    for d in dead_times:
        first = len(kept)
        given, after = u[d.place], u_next[d.place]
        until = given if d.rest is None else d.rest
        before = [ca.if_else(has_begun > 0.5, past[first + j], until) for j in range(d.kept)]
        now[d.place], begin[d.place], end[d.place] = d.acting(before, given, after)
        before = [given, *before[:-1]]
        # No sample after the next is known: its value does not depend on it.
        later[d.place] = d.acting(before, after, after)[0]
        kept += before
    return (ca.vertcat(*now), ca.vertcat(*begin), ca.vertcat(*end), ca.vertcat(*later)), kept
