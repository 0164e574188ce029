"""Inputs with missing samples: short gaps are filled as the input is held, long ones cut a record.

Between its samples an input is what the model declares: held, or joined by straight lines. Over a
gap that is an assumption about what was not recorded, which a few samples bear. A simulation cannot
go on over a long gap: the record ends before it, and another begins behind it, from initial states
of its own. A file of events has a row for every step of a command: between two rows it stood.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import Array, BoolArray
from casid.data.experiment import Experiment
from casid.data.record import Record
from casid.data.sampling import Gaps, gaps_of, stretches_of
from casid.errors import DataError
from casid.estimation.simulation.channels.own_instants import lateness_of_steps
from casid.estimation.simulation.thresholds import INPUT_GAPS
from casid.model.declarations import Hold
from casid.model.model import Model
from casid.model.quantities import count_text, window_text

_CUT = "remark: cut at long gaps of "
FILLED = "remark: filled: "
"""What the line of a record's history begins with that warns of an input that was filled."""


def filled(record: Record, name: str, hold: Hold) -> Array:
    """(N,) samples of an input, missing ones as `hold` has it: the last value, or a straight line.

    At the beginning of the record the first value stands for those before it, at its end the last.
    A held input that steps between two instants has in the sample of that interval its mean over
    it: what flows in while it acts is then what did.
    """
    if name not in record.missing or not record.missing[name].any():
        return record[name]
    if hold != "zoh":
        return record.filled(name)
    there = ~record.missing[name]
    last = np.maximum.accumulate(np.where(there, np.arange(record.N), -1))
    held = np.asarray(record[name][np.where(last < 0, np.argmax(there), last)])
    return held if name not in record.late else _stepping_late(held, record, name)


def _stepping_late(held: Array, record: Record, name: str) -> Array:
    """A held input (N,) whose steps are where its samples were taken, beside their instants."""
    step = np.diff(held, prepend=held[:1])
    late = record.late[name] / record.Ts
    after = np.maximum(late, 0.0) * step  # of the interval that the step's sample begins
    after[-1] = 0.0  # no interval: what the outputs have there is from the step on
    before = np.maximum(-late, 0.0) * step  # of the one that it ends
    return np.asarray(held - after + np.append(before[1:], 0.0))


def recorded_inputs(model: Model, record: Record) -> list[str]:
    """The inputs of a model that a record has, those with missing samples alone."""
    return [
        name
        for name, entry in model.inputs.items()
        if entry.kind not in {"generated", "unknown"}
        and name in record.missing
        and bool(record.missing[name].any())
    ]


def doubtful_inputs(model: Model, record: Record) -> list[str]:
    """The `recorded_inputs` that may have moved where they have no sample."""
    return [
        name
        for name in recorded_inputs(model, record)
        if not has_row_at_every_step(model, record, name)
    ]


def long_gaps(record: Record, name: str) -> BoolArray:
    """(N,) True in gaps of a channel that are longer than a few of its own intervals.

    What is usual is an interval that few exceed: of samples at random instants, not the median.
    """
    missing = record.is_missing(name)
    there = np.flatnonzero(~missing)
    if len(there) < 2:
        return missing
    usual = float(np.quantile(np.diff(there), INPUT_GAPS.usual))
    out = np.zeros(record.N, dtype=bool)
    for first, stop in zip(*stretches_of(missing), strict=True):
        if stop - first + 1 > INPUT_GAPS.longest * usual:
            out[first:stop] = True
    return out


def filling_error(record: Record, name: str, hold: Hold) -> float:
    """The rms error that filling may leave in an input, over the input's standard deviation.

    A gain estimated from the input is then biased by that share at most (Cauchy-Schwarz). A held
    input may have stepped anywhere in a gap between two levels, and has not between two equal ones.
    A straight line over an interval h is off by u'' h^2 / 8 at most, u'' by second differences; of
    an input that has no three samples in a row it may be off by any amount.

    Parameters
    ----------
    name : an input that the record has, with missing samples in short gaps.
    """
    u, missing = record[name], record.is_missing(name)
    if np.ptp(u[~missing]) == 0.0:
        return 0.0
    spread = float(np.std(u[~missing]))
    bends = np.diff(u, 2)[~(missing[:-2] | missing[1:-1] | missing[2:])]
    bend = float(np.sqrt(np.mean(bends**2))) if bends.size else np.inf
    total = 0.0
    for first, stop in zip(*stretches_of(missing), strict=True):
        if first == 0 or stop == record.N:
            error = spread  # known from one side alone
        elif hold == "zoh":
            error = abs(float(u[stop] - u[first - 1]))
        else:
            error = bend * (stop - first + 1) ** 2 / 8
        total += (stop - first) * error**2
    return float(np.sqrt(total / record.N) / spread)


def has_row_at_every_step(model: Model, record: Record, name: str) -> bool:
    """True of a held command in a file of events, which has rows for its steps alone.

    Doses are written so: a row for each sample that was taken, and one for each change of the
    command, in which nothing was measured. A command without a row has then not changed. A file
    that a logger wrote has no such rows, or rows of the command at which no column stepped; of
    these a file of events has a few, of samples that failed or were set aside.

    Parameters
    ----------
    name : an input that the record has, with missing samples.
    """
    entry = model.inputs[name]
    measured = [record.is_missing(output) for output in model.outputs if output in record]
    rows = np.flatnonzero(~record.is_missing(name))
    if entry.hold != "zoh" or entry.kind != "known" or not measured or len(rows) <= 2:
        return False
    is_alone = np.all(measured, axis=0)[rows]
    steps = np.diff(record[name][rows], prepend=record[name][rows[0]]) != 0
    alone_at_step = int(np.sum(is_alone & steps))
    at_rest = is_alone & ~steps & ~_step_of_another(record, rows, {name, *model.outputs})
    return bool(
        alone_at_step > 0
        and 2 * alone_at_step >= steps.sum()
        and 2 * steps.sum() <= len(rows)
        and at_rest[1:-1].sum() <= INPUT_GAPS.at_rest * alone_at_step
    )


def _step_of_another(record: Record, rows: Array, but: Collection[str]) -> BoolArray:
    """Rows at which another column of events steps, which does so in half of its own at most."""
    stepping = np.zeros(record.N, dtype=bool)
    for other in [name for name in record.channels if name not in but]:
        own = np.flatnonzero(~record.is_missing(other))
        steps = own[1:][np.diff(record[other][own]) != 0]
        if 2 * len(steps) <= len(own):
            stepping[steps] = True
    return stepping[rows]


def require_short_gaps(record: Record, names: Sequence[str]) -> None:
    """Refuse inputs with gaps too long to be filled.

    Raises
    ------
    DataError
        With the first of them.
    """
    for name in names:
        gone = long_gaps(record, name)
        if not gone.any():
            continue
        found, k = gaps_of(gone), int(np.argmax(gone))
        raise DataError(
            f"{record.name}: input {name} misses {count_text(found.missing, 'sample')} in "
            f"{count_text(found.stretches, 'gap')} longer than "
            f"{INPUT_GAPS.longest} of its intervals, the first at t = {record.t[k]:g} s; over so "
            "long a gap an input must be complete. Cut the record there with a window (identify "
            "and diagnose do by themselves), or interpolate the channel beforehand"
        )


def with_gaps_treated(
    model: Model, experiments: Sequence[Experiment], beside: Collection[str] = ()
) -> list[Experiment]:
    """The experiments with complete inputs: short gaps filled, and records cut at long ones.

    Every stretch between long gaps is an experiment with the same known values and initial states
    of its own. The records say what was done. Outputs keep their gaps.

    Parameters
    ----------
    beside : channels that a model may have for inputs, filled by straight lines where no gap is
        long; otherwise left as they are.

    Raises
    ------
    DataError
        If a record has no stretch that is long enough.
    """
    out = []
    for e in (part for each in experiments for part in _parts(model, each)):
        record = _complete(model, e.record, beside)
        filled = {n: e.record.missing[n] for n in doubtful_inputs(model, e.record)} or e.filled
        joined = {n: mask for n, mask in record.missing.items() if n in model.outputs}
        out.append(replace(e, record=record, filled=filled, joined=joined))
    return out


def _complete(model: Model, record: Record, beside: Collection[str]) -> Record:
    """A record whose inputs are filled, with numbers under the marks of its outputs."""
    if not any(mask.any() for mask in record.missing.values()):
        return record
    alike: dict[tuple[str, Gaps, bool], list[str]] = {}
    channels, missing, late = dict(record.channels), dict(record.missing), dict(record.late)
    doubtful, lines = doubtful_inputs(model, record), []
    for name in recorded_inputs(model, record):
        own = model.inputs[name].hold
        hold = "held" if own == "zoh" else "joined by straight lines"
        if name in doubtful and name in late:
            lines.append(f"remark: {name} is {hold} between its own instants, which are uneven")
        elif name in doubtful:
            is_warned = filling_error(record, name, own) > INPUT_GAPS.error
            alike.setdefault((hold, gaps_of(record.missing[name]), is_warned), []).append(name)
        else:
            lines.append(f"remark: {name} has a row at each of its steps: it is held between them")
        channels[name] = filled(record, name, own)
        if name in late and own == "zoh":
            late[name] = lateness_of_steps(record, name)
        del missing[name]
    for (hold, gaps, is_warned), names in alike.items():
        lines.append((FILLED if is_warned else "remark: ") + _filling(names, hold, gaps, record))
    for name in [n for n in missing if n in beside and n not in model.outputs]:
        gone = missing[name]
        if gone.any() and not long_gaps(record, name).any():
            lines.append(f"{FILLED}{name}, recorded beside, is joined by straight lines in gaps")
            channels[name] = record.filled(name)
            del missing[name]
    for name in [n for n in missing if not missing[n].all()]:
        channels[name] = record.filled(name)
    provenance = (*record.provenance, *lines)
    return replace(record, channels=channels, missing=missing, provenance=provenance, late=late)


def _filling(names: Sequence[str], how: str, found: Gaps, record: Record) -> str:
    """How inputs with the same gaps were filled, for the record's history."""
    *first, last = names
    who = f"{', '.join(first)} and {last}" if first else last
    has, misses, are = ("have", "miss", "they are") if first else ("has", "misses", "it is")
    if found.rate is not None:
        return f"{who} {has} a value in one sample of {found.rate} alone: {are} {how} between them"
    return (
        f"{who} {misses} {count_text(found.missing, 'sample')} "
        f"({100 * found.missing / record.N:.2g} %) in {count_text(found.stretches, 'gap')}"
        f" of up to {found.longest * record.Ts:.3g} s: {are} "
        f"{how} there"
    )


def _parts(model: Model, experiment: Experiment) -> list[Experiment]:
    record = experiment.record
    names = doubtful_inputs(model, record)
    gone = np.zeros(record.N, dtype=bool)
    causes = []
    for name in names:
        if (long := long_gaps(record, name)).any():
            gone |= long
            causes.append(name)
    if not causes:
        return [experiment]
    stretches = [
        (int(a), int(b))
        for a, b in zip(*stretches_of(~gone), strict=True)
        if b - a >= INPUT_GAPS.shortest
    ]
    if not stretches:
        require_short_gaps(record, causes)
    kept, parts = sum(b - a for a, b in stretches), []
    for i, (a, b) in enumerate(stretches):
        part = record.between(float(record.t[a]), float(record.t[b - 1]))
        text = (
            f"{_CUT}{', '.join(causes)}: part {i + 1} of {len(stretches)}, with initial states of "
            f"its own; {record.N - kept} of {record.N} samples lie in the gaps or beside them"
        )
        part = replace(part, provenance=(*part.provenance, text))
        name = f"{experiment.name}@{window_text(part.t[0], part.t[-1])}"
        parts.append(replace(experiment, record=part, name=name))
    return parts


def gap_notes(experiments: Sequence[Experiment]) -> list[str]:
    """Warnings of inputs that filling may have left in error, and of records that were cut."""
    return [
        f"{e.name}: {line.removeprefix('remark: ')}".replace(FILLED.removeprefix("remark: "), "")
        for e in experiments
        for line in e.record.provenance
        if line.startswith((_CUT, FILLED))
    ]
