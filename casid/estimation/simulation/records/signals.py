"""The signals of one experiment in the order and units of a model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from casid.arrays import Array, BoolArray
from casid.data.channel_quality import quantisation_step
from casid.data.experiment import Experiment
from casid.data.record import Record
from casid.errors import DataError, ModelError, UnitError
from casid.estimation.simulation.channels.own_instants import Instants, own_instants
from casid.estimation.simulation.records.input_gaps import (
    doubtful_inputs,
    filled,
    require_short_gaps,
)
from casid.estimation.simulation.thresholds import READINGS
from casid.model.model import Model
from casid.model.units import describe_dimension, parse_unit, to_si

SMALLEST = 1e-100
"""Smallest size of a channel, SI, and 1 over its largest: squares of sums stay numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """Inputs and outputs of one experiment, in model order and SI units."""

    name: str
    t: Array  # (N,)
    u: Array  # (N, nu)
    y: Array  # (N, ny)
    used: Array  # (N, ny) bool
    Ts: float
    known: Mapping[str, float]
    filled: Mapping[str, BoolArray] = field(default_factory=dict)  # input -> (N,) not recorded
    rounding: Mapping[str, float] = field(default_factory=dict)  # input -> sd of its rounding
    instants: Instants | None = None  # where they were taken, of a record with an irregular clock
    sizes: Array | None = None  # (N, ny) of the noise, relative; None: all of one size

    @property
    def N(self) -> int:
        """Number of samples."""
        return len(self.t)

    @property
    def relative_sizes(self) -> Array:
        """(N, ny) of the noise at each sample, over its RMS size."""
        return np.ones(self.y.shape) if self.sizes is None else self.sizes

    def in_sizes(self, columns: Array) -> Array:
        """Errors (N, ny), or columns of them (N, ny, m), over the size of the noise at each."""
        if self.sizes is None:
            return columns
        return np.asarray(columns / (self.sizes if columns.ndim == 2 else self.sizes[:, :, None]))

    def errors(self, simulated: Array) -> Array:
        """(N, ny) measured less simulated, `in_sizes`, zero where a sample is not used."""
        return self.in_sizes(np.where(self.used, self.y - simulated, 0.0))


def signals_of(model: Model, experiment: Experiment) -> Signals:
    """The inputs and outputs of `model` taken from a record.

    Raises
    ------
    DataError
        If a channel is missing or in a unit of another dimension than the model's, or an input has
        long gaps; short ones are filled as the input is held.
    """
    record = experiment.record
    u = input_columns(model, record)
    _require_channels(model, record, model.outputs)
    n = record.N
    y = np.column_stack([record[name] for name in model.outputs])
    used = np.column_stack(
        [
            ~record.missing[name] if name in record.missing else np.ones(n, dtype=bool)
            for name in model.outputs
        ]
    )
    return Signals(
        name=experiment.name,
        t=np.asarray(record.t),
        u=u,
        y=np.where(used, y, 0.0),
        used=used,
        Ts=record.Ts,
        known=model.in_si(experiment.known),
        filled={name: mask for name, mask in experiment.filled.items() if len(mask) == n},
        rounding={
            name: sd
            for i, (name, entry) in enumerate(model.inputs.items())
            if entry.kind == "measured" and (sd := rounding_of(u[:, i])) > 0.0
        },
        instants=own_instants(
            record,
            list(model.outputs),
            [name for name, entry in model.inputs.items() if entry.hold == "zoh"],
        ),
        sizes=_sizes_of(experiment, list(model.outputs)),
    )


def _sizes_of(experiment: Experiment, outputs: Sequence[str]) -> Array | None:
    """(N, ny) relative sizes of the outputs' noise, None where all samples have one."""
    sizes, t = experiment.noise_sizes, np.asarray(experiment.record.t)
    if not any(name in sizes for name in outputs):
        return None
    return np.column_stack(
        [sizes[name].at(t) if name in sizes else np.ones(len(t)) for name in outputs]
    )


def output_spread(data: Sequence[Signals]) -> Array:
    """(ny,) standard deviation of what was recorded of each output; of a constant, its size."""
    total = np.zeros(data[0].y.shape[1])
    for i in range(len(total)):
        values = np.concatenate([d.y[d.used[:, i], i] for d in data])
        total[i] = float(np.std(values)) if len(values) > 1 else 0.0
        if total[i] == 0.0:
            total[i] = float(np.max(np.abs(values), initial=0.0)) or 1.0
    return total


def window_cuts(N: int, window: int) -> Array:
    """(windows + 1,) where windows begin, and N: as many as have `window` samples or more each.

    Their lengths differ by one sample at most; a record shorter than `window` is one window.
    """
    return np.linspace(0, N, max(N // window, 1) + 1).astype(int)


def require_samples_for_segments(data: Sequence[Signals], segments: int, states: int) -> None:
    """Refuse records with fewer samples than their segments have initial states.

    Raises
    ------
    DataError
        With the number of segments that a record may have.
    """
    per_segment = max(states, 1)
    for d in data:
        if segments > 1 and segments * per_segment >= d.N:
            raise DataError(
                f"{d.name}: {d.N} samples cannot be cut into {segments} segments, each of "
                f"which has {per_segment} initial states to estimate; give {d.N // 100 + 1} "
                "segments or so"
            )


def input_columns(model: Model, record: Record) -> Array:
    """(N, nu) what a record has of the inputs of `model`, generated ones by the record's clock.

    Short gaps are filled as the input is held (`filled`).

    Raises
    ------
    DataError
        As `signals_of`.
    ModelError
        If an input is unknown.
    """
    for name, entry in model.inputs.items():
        if entry.kind == "unknown":
            raise ModelError(
                f"{model.name}: input {name} is unknown; eliminate it with an output "
                f"that it acts on (model.eliminate({name!r}, using=...)) before estimating, or let "
                f"a disturbance stand for it in identify (--disturbance {name}:first)"
            )
    recorded = [name for name, entry in model.inputs.items() if entry.kind != "generated"]
    _require_channels(model, record, recorded)
    require_short_gaps(record, doubtful_inputs(model, record))
    columns = []
    for name, entry in model.inputs.items():
        if entry.kind == "generated":
            made = np.zeros(record.N) if entry.signal is None else entry.signal(record.t)
            columns.append(made)
            continue
        columns.append(filled(record, name, entry.hold))
    return np.column_stack(columns) if columns else np.zeros((record.N, 0))


def off_the_clock(model: Model) -> Model:
    """The model in a record of another clock: what has an instant on the one is zero there."""
    names = clock_inputs(model)
    new = model.copy() if names else model
    for name in names:
        new.inputs[name] = replace(new.inputs[name], signal=None)
    return new


def clock_inputs(model: Model) -> list[str]:
    """The inputs that are functions of the clock of a record."""
    return [name for name, entry in model.inputs.items() if entry.signal is not None]


def require_sizes(record: Record, names: Iterable[str]) -> None:
    """Refuse channels so large or so small that their squares are no numbers.

    Raises
    ------
    DataError
        With the largest value.
    """
    for name in names:
        values = record[name]
        if name in record.missing:
            values = values[~record.missing[name]]
        size = float(np.max(np.abs(values), initial=0.0))
        if not (size == 0.0 or SMALLEST <= size <= 1 / SMALLEST):
            raise DataError(
                f"{record.name}: the largest value of channel {name} is {size:.3g} "
                f"{record.units[name]}, of which squares cannot be summed; correct its unit "
                f"(--map {name}=COLUMN:UNIT), or the file"
            )


def _require_channels(model: Model, record: Record, names: Iterable[str]) -> None:
    """Channels are there, and measure what the model says: another unit is another quantity."""
    units = {n: e.unit for n, e in model.inputs.items()}
    units |= {n: unit for n, (_, unit) in model.outputs.items()}
    names = list(names)
    for name in names:
        if name not in record.channels:
            raise DataError(
                f"{record.name}: no channel {name!r} for {model.name}; it has "
                f"{', '.join(record.channels)}. Map one of them: --map {name}=column"
            )
    require_sizes(record, names)
    for name in names:
        unit = units[name]
        own = record.units[name]
        if own == unit:
            continue
        try:
            expected = parse_unit(unit)
        except UnitError:
            continue  # the model's own affair
        try:
            to_si(np.zeros(0), own, unit)
        except UnitError:
            raise DataError(
                f"{record.name}: channel {name} is in {own!r}, but {model.name} has it in {unit!r} "
                f"({describe_dimension(parse_unit(own).dimension)} against "
                f"{describe_dimension(expected.dimension)} in base units); map the channel that "
                f"measures it, or give its true unit: Record(..., units={{{name!r}: {unit!r}}})"
            ) from None


def rounding_of(values: Array) -> float:
    """Standard deviation of the rounding of a measured input (N,), 0 where it is not rounded so.

    A channel that repeats most of its readings shows no noise near Nyquist, and is not exact for
    that: its error is uniform within a step (Widrow and Kollar, Quantization Noise, Cambridge 2008,
    chapter 5). Near rest it is a part of the signal, and passes for dry friction or a dead zone
    where it is taken for none.

    A command has levels of its own and no error: it goes from one to another by many steps at once,
    or at a rate of its own (a rudder that its gear turns), one equal step after the other.
    """
    step = quantisation_step(values)
    if step is None or np.mean(np.diff(values) != 0.0) >= 1 - READINGS.repeated:
        return 0.0
    counts = np.round((values - values.min()) / step)
    if len(np.unique(counts)) < READINGS.levels:
        return 0.0
    moves = np.diff(counts)
    is_alone = np.abs(moves) == 1
    is_alone[1:] &= moves[1:] != moves[:-1]
    is_alone[:-1] &= moves[:-1] != moves[1:]
    share = is_alone.sum() / max(np.count_nonzero(moves), 1)
    return step / float(np.sqrt(12.0)) if share >= READINGS.single else 0.0
