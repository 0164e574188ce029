"""A simulation from its sources of noise on, linearised at every sample of a record.

Where a model's response changes along a record, `varying_innovations` filters along these.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import TINY, Array
from casid.estimation.noise.forces import places_of_forces
from casid.estimation.noise.noise_response import (
    linearised,
    on_lines,
    slopes_of_samples,
)
from casid.estimation.simulation.simulation_error import SimulationError


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """The simulation of one record from its noise sources on, linearised at every sample.

    Attributes
    ----------
    a, c : (N, nx, nx), (N, ny, nx).
    b0, b1 : (N, nx, ns) of the sources at a sample and at the next one.
    d : (N, ny, ns).
    """

    sources: tuple[str, ...]
    Ts: float
    a: Array
    b0: Array
    b1: Array
    c: Array
    d: Array


def steps_along(
    criterion: SimulationError,
    x: Array,
    experiment: int,
    off: Mapping[str, Array] | None = None,
) -> Steps:
    """The steps of a record at every sample.

    With the lags of sensors; what else sensors and actuators do to noise is left out.

    Parameters
    ----------
    off : input -> (N,) by how much it was more than recorded, as far as is known.
    """
    d = criterion.data[experiment]
    disturbed, e, *_ = linearised(criterion, d.Ts, 1)
    u = criterion.acting_inputs(x, experiment, d)
    for name, more in (off or {}).items():
        u[:, list(criterion.model.inputs).index(name)] += more
    ahead = np.vstack([u[1:], u[-1:]])
    states = criterion.simulated(x, experiment).x
    a, b0, b1, inside, c, dd = slopes_of_samples(criterion, x, experiment, states, u, ahead)
    # What a band-limited input does between its samples is taken as on a straight line here.
    b0, b1 = on_lines(b0, b1, inside)
    a, b0, b1, c, dd = (np.ascontiguousarray(m.swapaxes(0, 1)) for m in (a, b0, b1, c, dd))
    forced = places_of_forces(criterion.model)
    measured = [n for n in e.inputs if disturbed.inputs[n].kind == "measured"]
    of = [e.inputs.index(n) for n in measured]
    of += range(len(e.inputs) - len(forced), len(e.inputs))
    steps = Steps((*measured, *forced), d.Ts, a, b0[:, :, of], b1[:, :, of], c, dd[:, :, of])
    for s in criterion.model.stages:
        if s.kind in ("lag", "filter"):
            r = criterion.value_of(s.parameter, x, experiment) / d.Ts
            steps = _behind_lag(steps, criterion.outputs.index(s.channel), s.kind, r)
    # What moved a state before does not reach the one in which the next window begins.
    if criterion.is_cut(experiment):
        before = criterion.starts_anew(experiment) - 1
        steps.a[before] = steps.b0[before] = steps.b1[before] = 0.0
    return steps


def _behind_lag(steps: Steps, output: int, kind: str, r: float) -> Steps:
    """The steps with an output behind a lag or a filter, which has a state of its own.

        z_{k+1} = E z_k + w_0 y_k + w_1 y_{k+1},    E = exp(-1 / r)                            (1)

    is exact behind a lag of an output y that is a straight line in each sample, with
    w_1 = 1 - r (1 - E) and w_0 = 1 - E - w_1. A digital filter has E = r / (1 + r) and w_0 = 0.

    Parameters
    ----------
    r : the time constant over the sample time.
    """
    decay = float(np.exp(-1 / max(r, TINY))) if kind == "lag" else r / (1 + r)
    last = 1 - r * (1 - decay) if kind == "lag" else 1 - decay
    first = 1 - decay - last
    shown, direct = steps.c[:, output], steps.d[:, output]
    next_shown, next_direct = (np.vstack([m[1:], m[-1:]]) for m in (shown, direct))
    reached = [
        first * now + last * np.einsum("ki,kij->kj", next_shown, moved)
        for now, moved in ((shown, steps.a), (direct, steps.b0))
    ]
    ahead = last * (np.einsum("ki,kij->kj", next_shown, steps.b1) + next_direct)
    N, nx = shown.shape
    a = np.zeros((N, nx + 1, nx + 1))
    a[:, :nx, :nx], a[:, nx, :nx], a[:, nx, nx] = steps.a, reached[0], decay
    b0, b1 = (
        np.concatenate([m, row[:, None]], axis=1)
        for m, row in ((steps.b0, reached[1]), (steps.b1, ahead))
    )
    c, d = np.concatenate([steps.c, np.zeros((*steps.c.shape[:2], 1))], axis=2), steps.d.copy()
    c[:, output], d[:, output] = 0.0, 0.0
    c[:, output, nx] = 1.0
    return replace(steps, a=a, b0=b0, b1=b1, c=c, d=d)
