"""Steps of held inputs in gaps of their record: where they fall, the outputs behind the gap show.

A held input changes at its samples. If it has another value behind a gap than before it, it stepped
at one of the samples that are lost, or at the first that is not. What the model would do from the
gap on is simulated for each of them, and compared with what was recorded:

    j = arg min sum_k | W (r_k - d_k(j)) |^2                                                   (1)

with r the residual, d(j) how far a step at sample j moves the outputs, and k the samples behind the
gap. The input is then filled accordingly.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import TINY, Array, BoolArray
from casid.data.experiment import Experiment
from casid.data.sampling import stretches_of
from casid.diagnosis.thresholds import STEPS_IN_GAPS
from casid.estimation.holdout import Split, simulate_apart, whole_simulation
from casid.estimation.simulation.known_simulation import KnownSimulation
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.signals import Signals


@dataclass(frozen=True, slots=True)
class _Step:
    """A step of an input somewhere in a gap: lost samples first..stop - 1."""

    channel: str
    first: int
    stop: int


def with_steps_in_gaps(fit: Fit, split: Split) -> tuple[Split, int]:
    """The records with inputs filled by (1), and how many steps were moved.

    Inputs that have another level at most samples have no steps in gaps (`levels_in_gaps`).
    A model that prepares its input columns is left alone: what it does depends on the whole column.
    """
    model = fit.criterion.model
    if any(stage.is_of_input for stage in model.stages):
        return split, 0
    whole, apart, moved = list(split.whole), list(split.apart), 0
    for _ in range(STEPS_IN_GAPS.rounds):
        changed = 0
        now = replace(split, whole=whole, apart=apart)
        for i, e in enumerate(whole):
            whole[i], n = _filled(fit, e, *whole_simulation(fit, now, i), place=i)
            changed += n
        for i, e in enumerate(apart):
            apart[i], n = _filled(fit, e, *simulate_apart(fit, e), place=0)
            changed += n
        moved = max(moved, changed)
        if not changed:
            break
    if not moved:
        return split, 0
    fitted = [begun_as(f, e) for f, e in zip(split.fitted, whole, strict=True)]
    return Split(fitted, whole, split.held, apart), moved


def _filled(
    fit: Fit, experiment: Experiment, d: Signals, y: Array, x: Array, *, place: int
) -> tuple[Experiment, int]:
    """An experiment with the steps of its held inputs where they fit best, and how many moved."""
    model = fit.criterion.model
    steps = _steps_of(fit, d, experiment.record.late)
    if not steps or not (np.all(np.isfinite(y)) and np.all(np.isfinite(x))):
        return experiment, 0
    residual = np.where(d.used, d.y - y, np.nan)
    weights = 1 / np.maximum(1.4826 * np.nanmedian(np.abs(residual), axis=0), TINY)
    simulation = KnownSimulation(model, d.Ts, fit.criterion.substeps)
    values = {n: fit.criterion.value_of(n, fit.x, place) for n in model.parameters}
    values |= dict(d.known)
    columns: dict[str, Array] = {}
    places = list(model.inputs)
    u, moved = d.u.copy(), 0
    for step in steps:
        i, (a, b) = places.index(step.channel), (step.first, step.stop)
        end = min(b + STEPS_IN_GAPS.samples, d.N)
        old = u[a:b, i].copy()
        before, after = u[a - 1, i], u[b, i]

        def outputs(column: Array, i: int = i, a: int = a, b: int = b, end: int = end) -> Array:
            part = u[a:end].copy()
            part[: b - a, i] = column
            return simulation.run(part, values, x[a : a + 1])[0]

        base, r = outputs(old), residual[a:end]
        best, least = old, np.nansum((r * weights) ** 2)
        for j in range(b - a + 1):
            column = np.where(np.arange(b - a) < j, before, after)
            loss = np.nansum(((r - outputs(column) + base) * weights) ** 2)
            if loss < least:
                best, least = column, loss
        if not np.array_equal(best, old):
            u[a:b, i] = best
            columns[step.channel] = u[:, i]
            moved += 1
    if not moved:
        return experiment, 0
    note = f"{', '.join(columns)} filled by steps in gaps, where the outputs behind them show"
    return with_columns(experiment, columns, [note]), moved


def _steps_of(fit: Fit, d: Signals, late: Collection[str]) -> list[_Step]:
    """Gaps of held inputs with another value behind them than before, in the order of time.

    Parameters
    ----------
    late : inputs whose stamps run unevenly: between two of them no sample is lost, unless they are
        far apart.
    """
    model = fit.criterion.model
    out = []
    for i, name in enumerate(model.inputs):
        if name not in d.filled or model.acting_hold(name) != "zoh":
            continue
        if is_busy(d.u[:, i], d.filled[name]):
            continue
        longest = 0.0
        if name in late:
            there = np.flatnonzero(~d.filled[name])
            longest = STEPS_IN_GAPS.lost * float(np.median(np.diff(there)))
        for first, stop in zip(*stretches_of(d.filled[name]), strict=True):
            is_lost = stop - first + 1 > longest
            if is_lost and 0 < first and stop < d.N and d.u[first - 1, i] != d.u[stop, i]:
                out.append(_Step(name, int(first), int(stop)))
    return sorted(out, key=lambda step: step.first)


def is_busy(u: Array, gone: BoolArray) -> bool:
    """True for an input (N,) that has another level at most samples: no steps, a control."""
    both = ~(gone[1:] | gone[:-1])
    return bool(both.any() and np.mean(np.diff(u)[both] != 0.0) > STEPS_IN_GAPS.busy)


def with_columns(
    experiment: Experiment, columns: Mapping[str, Array], notes: Sequence[str]
) -> Experiment:
    """An experiment with other samples of some inputs; `notes` are added to its provenance."""
    record = experiment.record
    history = (*(line for line in record.provenance if line not in notes), *notes)
    channels = {**record.channels, **columns}
    return replace(experiment, record=replace(record, channels=channels, provenance=history))


def begun_as(fitted: Experiment, whole: Experiment) -> Experiment:
    """The fitted part of a record with the inputs of the whole, and the history of those."""
    columns = {
        name: whole.record[name][: fitted.record.N]
        for name in whole.filled
        if not np.array_equal(whole.record[name][: fitted.record.N], fitted.record[name])
    }
    notes = [n for n in whole.record.provenance if n not in fitted.record.provenance]
    return with_columns(fitted, columns, notes) if columns else fitted
