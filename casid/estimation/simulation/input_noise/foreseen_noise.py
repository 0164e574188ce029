"""A bound on an input's white noise from what foretells the input: its past, and the outputs.

White noise of a sensor is independent of what the channel read before and of the other sensors.
However an input is foretold from these, the error of the prediction contains that noise in full:
its power bounds that of the noise from above. What a controller made of the noise of an output is
in the input's spectrum as well, and real; the output foretells it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.stats import norm

from casid.arrays import Array, BoolArray
from casid.estimation.simulation.thresholds import FORESEEN

_known: dict[bytes, float] = {}
"""What was found of the last records: every model of them has the same bound."""


def foreseen_noise(
    inputs: Sequence[Array], outputs: Sequence[Array], used: Sequence[BoolArray]
) -> float:
    """Standard deviation of the error of a linear one-step prediction, pooled over records.

    A median counts where it is lower, as where a reference steps now and then, and coefficients are
    found without the samples whose error is far larger. Infinite where there are few samples for
    the coefficients.

    Parameters
    ----------
    inputs, outputs, used : (N,), (N, ny) and (N, ny) of each record; samples that are not used, and
        those soon after them, are left out.
    """
    records = hashlib.blake2b()
    for array in (*inputs, *outputs, *used):
        records.update(f"{array.shape}{array.dtype}".encode() + array.tobytes())
    key = records.digest()
    if key not in _known:
        if len(_known) >= FORESEEN.kept:
            _known.clear()
        _known[key] = _foreseen(inputs, outputs, used)
    return _known[key]


def _foreseen(
    inputs: Sequence[Array], outputs: Sequence[Array], used: Sequence[BoolArray]
) -> float:
    foretelling = ~_is_same(inputs, outputs)
    records = zip(inputs, outputs, used, strict=True)
    rows = [_rows(u, y[:, foretelling], s) for u, y, s in records]
    rows = [r for r in rows if len(r)]
    count = sum(len(r) - 1 for r in rows)  # a mean of each record
    if not rows or count < FORESEEN.samples * rows[0].shape[1]:
        return float("inf")
    table = np.concatenate([r - r.mean(axis=0) for r in rows])
    size = np.sqrt(np.mean(table**2, axis=0))
    regressors = table[:, 1:] / np.where(size[1:] > 0, size[1:], 1.0)
    degrees, kept, least = count - regressors.shape[1], np.ones(len(table), dtype=bool), np.inf
    for _ in range(FORESEEN.rounds):
        coefficients = np.linalg.lstsq(regressors[kept], table[kept, 0], rcond=FORESEEN.rank)[0]
        error = np.abs(table[:, 0] - regressors @ coefficients)
        middle = float(np.median(error) / norm.ppf(0.75)) * float(np.sqrt(len(error) / degrees))
        whole = float(np.sqrt(error @ error / degrees))
        if min(middle, whole) >= least:
            break
        least = min(middle, whole)
        kept = error <= FORESEEN.far * middle
    return least


def _rows(u: Array, y: Array, used: BoolArray) -> Array:
    """(rows, 1 + regressors): the input, its last values, and the outputs then and now."""
    lags = FORESEEN.lags
    if len(u) <= lags:
        return np.zeros((0, 1))
    own = sliding_window_view(u, lags + 1)
    table = [own[:, ::-1], *(sliding_window_view(c, lags + 1) for c in y.T)]
    whole = sliding_window_view(used.all(axis=1), lags + 1).all(axis=1)
    return np.asarray(np.column_stack(table)[whole])


def _is_same(inputs: Sequence[Array], outputs: Sequence[Array]) -> BoolArray:
    """(ny,) which outputs are the input's own channel, on whatever scale: their noise is the same.

    All records decide together: in one where the input rests it is like any output.
    """
    a = np.concatenate([u - u.mean() for u in inputs])
    b = np.concatenate([y - y.mean(axis=0) for y in outputs])
    return np.asarray((a @ b) ** 2 >= (1 - FORESEEN.same) * (a @ a) * np.sum(b**2, axis=0))
