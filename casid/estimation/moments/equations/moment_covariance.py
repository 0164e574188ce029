"""The covariance of moment equations: of all stacked means of instruments times equation errors.

Instruments that are lags of one signal are nearly dependent, so a combination of them is a filter
with notches where the signal has its peaks. The spectrum of a short record, smeared over a notch
by its few segments, dominates the result there; so the instruments of short records are combined
first, and their spectra computed afterwards (`combined_covariance`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from casid.arrays import Array
from casid.estimation.covariance import bartlett_lags, long_run_covariance
from casid.estimation.moments.equations.long_run_covariance import (
    LONGEST_SEGMENT,
    independent_covariances,
    positive_part,
    segments,
)
from casid.estimation.moments.equations.moment_equations import MomentEquations
from casid.linear.sampled.lagged_columns import Column

Covariance = Literal["independent", "scores", "white"]


def moment_covariance(
    equations: Sequence[MomentEquations],
    thetas: Sequence[Array],
    records: Sequence[str],
    *,
    how: Covariance | None = None,
) -> Array:
    """Covariance of all stacked means Y - Phi theta, (sum nz, sum nz), at thetas.

    Parts of one record share its noise and are correlated; records are independent.

    Parameters
    ----------
    how : ``"independent"``: instruments independent of the error, see `long_run`; default for
        instrumental variables. ``"scores"``: autocorrelation-robust from the products themselves
        (Newey and West 1987), the only choice where the regressors are their own instruments.
        ``"white"``: sigma^2 mean zeta zeta', all that sums without their samples can give.
    """
    sizes = [len(e.Z) for e in equations]
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
    total = np.zeros((offsets[-1], offsets[-1]))
    errors = [
        e.error(t) if e.signals else np.zeros(0) for e, t in zip(equations, thetas, strict=True)
    ]
    for record in dict.fromkeys(records):
        index = [i for i, r in enumerate(records) if r == record]
        if how == "white" or not all(equations[i].signals for i in index):
            for i in index:  # parts of a record whose samples are gone: no correlation between them
                at = slice(int(offsets[i]), int(offsets[i + 1]))
                total[at, at] = (
                    equations[i].error_power(thetas[i]) * equations[i].Z / equations[i].N
                )
            continue
        chosen = how or (
            "scores" if any(equations[i].is_least_squares for i in index) else "independent"
        )
        length = min(len(errors[i]) for i in index)
        where = np.concatenate([np.arange(offsets[i], offsets[i + 1]) for i in index])
        n = min(equations[i].N for i in index)
        if chosen == "scores":
            scores = np.column_stack(
                [
                    c.samples(equations[i].signals, equations[i].start)[-length:]
                    * errors[i][-length:]
                    for i in index
                    for c in equations[i].instruments
                ]
            )
            block = long_run_covariance(scores, bartlett_lags(scores)) / length
        else:
            # The instruments have mean zero, so a constant error moves nothing and spreads nothing.
            block = independent_covariances(
                [errors[i][-length:] - errors[i][-length:].mean() for i in index],
                [equations[i].instruments for i in index],
                [{k: v[len(v) - length :] for k, v in equations[i].signals.items()} for i in index],
            )
        total[np.ix_(where, where)] = positive_part(block) / n
    return total


def are_short(equations: Sequence[MomentEquations]) -> bool:
    """True for instruments, not least squares, of records whose segments are shorter than allowed.

    Only there is the resolution of a spectrum in question.
    """
    return all(e.signals and not e.is_least_squares for e in equations) and any(
        segments(e.N) < LONGEST_SEGMENT for e in equations
    )


def combined_covariance(
    equations: Sequence[MomentEquations],
    thetas: Sequence[Array],
    records: Sequence[str],
    weights: Array,
) -> Array:
    """Covariance of weights (m, sum nz) times the stacked means Y - Phi theta at thetas, (m, m).

    As `moment_covariance` for instruments that are independent of the error, but the m combinations
    of each part's instruments are made in time, before a spectrum smears them.
    """
    m = len(weights)
    names = [str(j) for j in range(m)]
    columns = [Column(name, ((name, 0, 1.0),)) for name in names]
    offsets = np.concatenate([[0], np.cumsum([len(e.Z) for e in equations])]).astype(int)
    total = np.zeros((m, m))
    for record in dict.fromkeys(records):
        index = [i for i, r in enumerate(records) if r == record]
        errors = [equations[i].error(thetas[i]) for i in index]
        made = [_combined(equations[i], weights[:, offsets[i] : offsets[i + 1]]) for i in index]
        length = min(len(a) for a in (*errors, *made))
        block = independent_covariances(
            [e[-length:] - e[-length:].mean() for e in errors],
            [columns] * len(index),
            [dict(zip(names, z[-length:].T, strict=True)) for z in made],
        )
        summed = block.reshape(len(index), m, len(index), m).sum(axis=(0, 2))
        total += positive_part(summed) / min(equations[i].N for i in index)
    return total


def _combined(e: MomentEquations, weights: Array) -> Array:
    """Combinations of the instruments of a part, weights (m, nz), at every sample, (N, m)."""
    taps: dict[tuple[str, int], Array] = {}
    for column, weight in zip(e.instruments, weights.T, strict=True):
        for channel, lag, value in column.taps:
            taps[channel, lag] = taps.get((channel, lag), 0.0) + value * weight
    shifted = [
        e.signals[channel][e.start - lag : len(e.signals[channel]) - lag] for channel, lag in taps
    ]
    return np.asarray(np.column_stack(shifted) @ np.array(list(taps.values())))
