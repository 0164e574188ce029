"""Steps of held inputs in gaps of their record: where they fall, the outputs behind the gap show.

A held input changes at its samples. If it has another value behind a gap than before it, it stepped
at one of the samples that are lost, or at the first that is not. What the model would do from the
gap on is simulated for each of them, and compared with what was recorded:

    j = arg min sum_k | W (r_k - d_k(j)) |^2                                                   (1)

with r the residual, d(j) how far a step at sample j moves the outputs, and k the samples behind the
gap. The input is then filled accordingly.

On an irregular clock a step at a row falls beside the row's place on the even clock, where the
input has its mean over the interval; a step in the gap before leaves none there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import TINY, Array, BoolArray
from casid.data.experiment import Experiment
from casid.data.record import Record
from casid.data.sampling import stretches_of
from casid.diagnosis.thresholds import STEPS_IN_GAPS
from casid.estimation.holdout import Split, simulate_apart, whole_simulation
from casid.estimation.simulation.channels.own_instants import lateness_of_steps
from casid.estimation.simulation.known_simulation import outputs_by
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.records.signals import Signals


@dataclass(frozen=True, slots=True)
class _Step:
    """A step of an input somewhere in a gap: lost samples first..stop - 1.

    `late` is by how many samples the row behind the gap was taken after its place on the clock.
    `soonest` is the first sample of the gap that it may step at: the one behind a row that steps
    after its own place shows the level of that row.
    """

    channel: str
    first: int
    stop: int
    before: float
    after: float
    late: float = 0.0
    soonest: int = 0

    @property
    def columns(self) -> Iterator[Array]:
        """The input for each sample that it may have stepped at, as of `column`."""
        return map(self.column, range(self.soonest, self.stop - self.first + 1))

    def column(self, j: int) -> Array:
        """The input from the first lost sample to the one behind the gap, with its step at j."""
        n = self.stop - self.first
        column = np.where(np.arange(n + 1) < j, self.before, self.after)
        if j == n:  # at the row itself: means over the intervals beside its place
            rise = self.after - self.before
            column[n] -= max(self.late, 0.0) * rise
            column[n - 1] += max(-self.late, 0.0) * rise
        return column


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
    return replace(split, fitted=fitted, whole=whole, apart=apart), moved


def _filled(
    fit: Fit, experiment: Experiment, d: Signals, y: Array, x: Array, *, place: int
) -> tuple[Experiment, int]:
    """An experiment with the steps of its held inputs where they fit best, and how many moved."""
    steps = _steps_of(fit, d, experiment.record)
    if not steps or not (np.all(np.isfinite(y)) and np.all(np.isfinite(x))):
        return experiment, 0
    residual = np.where(d.used, d.y - y, np.nan)
    weights = 1 / np.maximum(1.4826 * np.nanmedian(np.abs(residual), axis=0), TINY)
    simulated = outputs_by(fit, d, place)
    columns: dict[str, Array] = {}
    places = list(fit.criterion.model.inputs)
    u, moved = d.u.copy(), 0
    for step in steps:
        i, (a, b) = places.index(step.channel), (step.first, step.stop)
        end = min(b + STEPS_IN_GAPS.samples, d.N)
        old = u[a : b + 1, i].copy()

        def outputs(column: Array, step: _Step = step, i: int = i, end: int = end) -> Array:
            part = u[step.first : end].copy()
            part[: len(column), i] = column
            part[len(column) - 1, i] = step.after  # outputs of the row have all of the step
            return simulated(part, x[step.first])

        base, r = outputs(old), residual[a:end]
        best, least = old, np.nansum((r * weights) ** 2)
        for column in step.columns:
            loss = np.nansum(((r - outputs(column) + base) * weights) ** 2)
            if loss < least:
                best, least = column, loss
        if not np.array_equal(best, old):
            u[a : b + 1, i] = best
            r -= outputs(best) - base  # in place: steps behind this one see what it leaves
            columns[step.channel] = u[:, i]
            moved += 1
    if not moved:
        return experiment, 0
    note = f"{', '.join(columns)} filled by steps in gaps, where the outputs behind them show"
    return with_columns(experiment, columns, [note]), moved


def _steps_of(fit: Fit, d: Signals, record: Record) -> list[_Step]:
    """Gaps of held inputs with another value behind them than before, in the order of time.

    Where the stamps of an input run unevenly no sample is lost between two of them, unless they
    are far apart.
    """
    model = fit.criterion.model
    out = []
    for i, name in enumerate(model.inputs):
        if name not in d.filled or model.acting_hold(name) != "zoh":
            continue
        if is_busy(d.u[:, i], d.filled[name]):
            continue
        levels, late, longest = d.u[:, i], np.zeros(d.N), 0.0
        own = late  # of the steps alone
        if name in record.late:
            late = record.late[name] / record.Ts
            own = lateness_of_steps(record, name) / record.Ts
            levels = _levels(levels, d.filled[name], own)
            there = np.flatnonzero(~d.filled[name])
            longest = STEPS_IN_GAPS.lost * float(np.median(np.diff(there)))
        for first, stop in zip(*stretches_of(d.filled[name]), strict=True):
            is_lost = stop - first + 1 > longest
            if is_lost and 0 < first and stop < d.N and levels[first - 1] != levels[stop]:
                ends = float(levels[first - 1]), float(levels[stop])
                soonest = int(own[first - 1] > 0.0)
                out.append(
                    _Step(name, int(first), int(stop), *ends, float(late[stop]), soonest=soonest)
                )
    return sorted(out, key=lambda step: step.first)


def _levels(u: Array, gone: BoolArray, late: Array) -> Array:
    """An input (N,) with what each row read, where its step makes its sample a mean (N,) of two.

    Parameters
    ----------
    gone : (N,) samples that are no rows. late : (N,) by how many samples each step comes after its
        row's place.
    """
    levels = u.copy()
    for k in np.flatnonzero((late > 0.0) & ~gone):
        before = levels[k - 1]
        levels[k] = before + (u[k] - before) / (1.0 - late[k])
    return levels


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
