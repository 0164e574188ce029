"""Levels that an input had in gaps of its record, where it has another one at every sample.

A thermostat's power in a lost row is neither the one before nor the one behind. What the outputs
did behind the gap shows it, as far as they are more exact than what the samples around it say:

    min over c of  | W (r - D c) |^2 + sum_g ((c_g - m_g) / s_g)^2                            (1)

with r the residual, W what makes it white, D what a change of the level in each gap does to the
outputs from the gap on, m the change that the samples around a gap make expect, and s how far off
that is where samples were recorded: the most probable levels, were both normal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_array

from casid.arrays import TINY, Array, BoolArray
from casid.data.experiment import Experiment
from casid.data.sampling import gaps_of, stretches_of
from casid.diagnosis.evidence.recording_faults.steps_in_gaps import begun_as, is_busy, with_columns
from casid.diagnosis.thresholds import STEPS_IN_GAPS
from casid.estimation.holdout import Split, simulate_apart, whole_simulation
from casid.estimation.simulation.known_simulation import outputs_by
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.records.input_gaps import FILLED
from casid.estimation.simulation.records.signals import Signals


@dataclass(frozen=True, slots=True)
class _Gap:
    """Lost samples first..stop - 1 of an input, the level expected there, and how exactly."""

    channel: str
    first: int
    stop: int
    expected: float
    spread: float


def with_levels_in_gaps(fit: Fit, split: Split, *, by_outputs: bool = True) -> tuple[Split, int]:
    """The records with inputs filled by (1), and in how many gaps.

    `by_outputs`: else by the samples around the gaps alone, which takes up nothing of what the
    model is missing.
    A model that prepares its input columns is left alone: what it does depends on the whole column.
    """
    if any(stage.is_of_input for stage in fit.criterion.model.stages):
        return split, 0
    whole, apart, count = list(split.whole), list(split.apart), 0
    for i, e in enumerate(split.whole):
        whole[i], n = _filled(
            fit, e, *whole_simulation(fit, split, i), place=i, by_outputs=by_outputs
        )
        count += n
    for i, e in enumerate(split.apart):
        apart[i], n = _filled(fit, e, *simulate_apart(fit, e), place=0, by_outputs=by_outputs)
        count += n
    if not count:
        return split, 0
    fitted = [begun_as(f, e) for f, e in zip(split.fitted, whole, strict=True)]
    return replace(split, fitted=fitted, whole=whole, apart=apart), count


def _filled(
    fit: Fit,
    experiment: Experiment,
    d: Signals,
    y: Array,
    x: Array,
    *,
    place: int,
    by_outputs: bool,
) -> tuple[Experiment, int]:
    """An experiment with the likeliest levels in the gaps of its inputs, and how many gaps."""
    gaps = _gaps_of(fit, d)
    if not gaps or not (np.all(np.isfinite(y)) and np.all(np.isfinite(x))):
        return experiment, 0
    places = list(fit.criterion.model.inputs)
    now = [d.u[g.first : g.stop, places.index(g.channel)].mean() for g in gaps]
    change = np.array([g.expected for g in gaps]) - now
    if by_outputs:
        residual = np.where(d.used, d.y - y, 0.0)
        white = _whitener(residual, d.used)
        effects = white @ _effects(fit, d, x, gaps, place)
        precision = np.array([g.spread**-2.0 for g in gaps])
        normal = (effects.T @ effects).toarray() + np.diag(precision)
        seen = effects.T @ (white @ residual.ravel(order="F"))
        change = np.linalg.solve(normal, seen + precision * change)
    columns: dict[str, Array] = {}
    for gap, c in zip(gaps, change, strict=True):
        i = places.index(gap.channel)
        column = columns.setdefault(gap.channel, d.u[:, i].copy())
        there = np.delete(d.u[:, i], np.flatnonzero(d.filled[gap.channel]))
        level = column[gap.first : gap.stop] + c
        column[gap.first : gap.stop] = np.clip(level, there.min(), there.max())
    by = " and the outputs behind them" if by_outputs else ""
    note = (
        f"{FILLED}{', '.join(columns)}: its level in a gap is the likeliest by the samples around "
        f"it{by}, as it has another one at every sample"
    )
    return with_columns(experiment, columns, [note]), len(gaps)


def _gaps_of(fit: Fit, d: Signals) -> list[_Gap]:
    """Gaps of held inputs that have another level at every sample."""
    model = fit.criterion.model
    out = []
    for i, name in enumerate(model.inputs):
        gone = d.filled.get(name)
        if gone is None or not is_busy(d.u[:, i], gone) or gaps_of(gone).rate is not None:
            continue
        if model.acting_hold(name) != "zoh":
            continue
        for first, stop in zip(*stretches_of(gone), strict=True):
            if 0 < first and stop < d.N:
                expected, spread = _expected(d.u[:, i], gone, int(first), int(stop))
                if spread > 0.0:
                    out.append(_Gap(name, int(first), int(stop), expected, spread))
    return out


def _expected(u: Array, gone: BoolArray, first: int, stop: int) -> tuple[float, float]:
    """The mean level in a gap by the samples around it, and its error where all were recorded.

    The last sample before the gap or the mean of those on both sides, whichever errs less.
    """
    n = stop - first
    whole = np.convolve(gone, np.ones(n + 2), "valid") == 0  # by its sample before the gap
    before, behind = u[: len(u) - n - 1], u[n + 1 :]
    level = np.convolve(u, np.ones(n) / n, "valid")[1:-1]
    best, least = 0.0, np.inf
    for guess, here in (
        (before, u[first - 1]),
        ((before + behind) / 2, (u[first - 1] + u[stop]) / 2),
    ):
        error = float(np.sqrt(np.mean((level - guess)[whole] ** 2))) if whole.any() else 0.0
        if error < least:
            best, least = float(here), error
    return best, least


def _whitener(residual: Array, used: BoolArray) -> csc_array:
    """(samples read, N ny) what makes a residual white that is one of first order.

    What the model misses moves the residual slowly, so that it is not taken for levels in gaps,
    which move it at once.
    """
    rows, columns, entries, n = [], [], [], 0
    for i, (r, there) in enumerate(zip(residual.T, used.T, strict=True)):
        at = np.flatnonzero(there)
        after = at[1:][np.diff(at) == 1]
        size = max(float(np.mean(r[at] ** 2)) if at.size else 0.0, TINY)
        phi = float(np.mean(r[after] * r[after - 1])) / size if after.size else 0.0
        kept = np.clip(phi, 0.0, STEPS_IN_GAPS.memory) ** np.diff(at)  # of the sample before
        scale = 1 / np.sqrt(size * np.concatenate(([1.0], 1 - kept**2))[: at.size])
        order = n + np.arange(at.size)
        rows += [order, order[1:]]
        columns += [i * len(r) + at, i * len(r) + at[:-1]]
        entries += [scale, -kept * scale[1:]]
        n += at.size
    where = np.concatenate(rows), np.concatenate(columns)
    return csc_array((np.concatenate(entries), where), shape=(n, residual.size))


def _effects(fit: Fit, d: Signals, x: Array, gaps: list[_Gap], place: int) -> csc_array:
    """(N ny, gaps) what a level higher by one in each gap does to the outputs that were read."""
    outputs = outputs_by(fit, d, place)
    places, ny = list(fit.criterion.model.inputs), d.y.shape[1]
    reach = max(STEPS_IN_GAPS.samples, STEPS_IN_GAPS.simulated // len(gaps))
    rows, columns, entries = [], [], []
    for k, gap in enumerate(gaps):
        end = min(gap.stop + reach, d.N)
        part = d.u[gap.first : end].copy()
        base = outputs(part, x[gap.first])
        part[: gap.stop - gap.first, places.index(gap.channel)] += gap.spread
        change = (outputs(part, x[gap.first]) - base) / gap.spread
        change = np.where(d.used[gap.first : end] & np.isfinite(change), change, 0.0)
        for i in range(ny):
            rows.append(i * d.N + np.arange(gap.first, end))
            columns.append(np.full(end - gap.first, k))
            entries.append(change[:, i])
    where = np.concatenate(rows), np.concatenate(columns)
    return csc_array((np.concatenate(entries), where), shape=(d.N * ny, len(gaps)))
