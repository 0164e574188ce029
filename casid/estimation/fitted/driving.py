"""What a fitted model is driven with: records, tables, or arrays of its inputs."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.data.reading.columns import ColumnSpec
from casid.data.reading.frames import is_frame, open_frame, record_of_frame, table_of
from casid.data.reading.survey import ReadingOptions, survey
from casid.data.record import Record
from casid.errors import DataError
from casid.estimation.fitted.parts import AddedCause, Channels, FittedRecord
from casid.estimation.simulation.records.signals import clock_inputs, input_columns
from casid.model.model import Model
from casid.model.units import to_si


@dataclass(frozen=True, slots=True, eq=False)
class Driving:
    """Inputs over N samples, and the record that they come from.

    Attributes
    ----------
    t : (N,) s, on the record's clock. u : (N, nu) in the model's order, SI.
    known : parameter -> value known for this record, SI.
    record : None for arrays alone. fitted : the fitted record that it begins as.
    is_on_clock : whether it is on the clock of a fitted record, as another window of its file is.
    """

    name: str
    t: Array
    Ts: float
    u: Array
    known: Mapping[str, float] = field(default_factory=dict)
    record: Record | None = None
    fitted: FittedRecord | None = None
    is_on_clock: bool = False

    @property
    def t0(self) -> float:
        """Time of the first sample [s]."""
        return float(self.t[0])


def driving_of(
    model: Model,
    fitted: Sequence[FittedRecord],
    inputs: Any,
    Ts: float | None,
    channels: Channels,
    *,
    needs_outputs: bool = True,
) -> Driving:
    """Inputs in any form, in the order and units of `model`; those that are so already as they are.

    Outputs of a table that cannot be read are left out where nothing needs them.

    Raises
    ------
    DataError
        For inputs that are missing or incomplete, or a sample time that is not positive or belongs
        to a record.
    """
    if isinstance(inputs, Driving):
        return inputs
    if Ts is not None and not (np.isfinite(Ts) and Ts > 0):
        raise DataError(f"{model.name}: Ts = {Ts!r} s; give a positive number of seconds")
    if is_frame(inputs):
        inputs = _record_of(inputs, model, channels, needs_outputs=needs_outputs)
    if isinstance(inputs, Record):
        inputs = Experiment(inputs)
    if isinstance(inputs, Experiment):
        record = inputs.record
        if Ts is not None and abs(Ts / record.Ts - 1) > 1e-9:
            raise DataError(
                f"{record.name} is sampled every {record.Ts:g} s, not every {Ts:g} s; leave Ts "
                "out, or resample the record"
            )
        known_again = [f for f in fitted if f.is_start_of(model, record)]
        is_on_clock = bool(known_again) or any(f.clock == record.clock for f in fitted)
        return Driving(
            inputs.name,
            record.t,
            record.Ts,
            input_columns(model, record),
            model.in_si(inputs.known),
            record,
            known_again[0] if known_again else None,
            is_on_clock,
        )
    return _of_arrays(model, inputs, fitted[0].Ts if Ts is None else float(Ts))


def silent_causes(
    model: Model,
    causes: Sequence[AddedCause],
    fitted: Sequence[FittedRecord],
    given: Driving,
    remedy: str = "on_clock=True",
) -> str:
    """What is on the clock of the fitted records and does not act under these inputs, or nothing.

    Parameters
    ----------
    remedy : what makes it act.
    """
    names = clock_inputs(model)
    if given.is_on_clock or not names:
        return ""
    names = [c.words_in_time for c in causes if c.is_on_the_clock] or names
    return (
        f"{' and '.join(dict.fromkeys(names))}: belongs to the clock of "
        f"{' and '.join(f.name for f in fitted)}, and does not act in {given.name}, which is not "
        f"known to be on that clock; {remedy} makes it act at its time there"
    )


def warn_of(*texts: str) -> None:
    """Warn whoever called the caller of what a simulation leaves out; of no empty text."""
    for text in filter(None, texts):
        warnings.warn(text, UserWarning, stacklevel=3)


def _record_of(frame: Any, model: Model, channels: Channels, *, needs_outputs: bool) -> Record:
    """The model's signals from a table, each from its column; outputs may be absent."""
    there = {str(column) for column in table_of(frame).columns}
    units = {n: u.unit for n, u in model.inputs.items() if u.kind != "generated"}
    specs = {}
    for name, unit in {**units, **{n: u for n, (_, u) in model.outputs.items()}}.items():
        text = channels.columns.get(name, name)
        column, given = text.rsplit(":", 1) if ":" in text else (text, "")
        if name in channels.derived and column not in there:
            raise DataError(
                f"{model.name}: {name} is computed from other channels ({channels.derived[name]}), "
                f"which a table does not show; give problem.read_frame(frame), or a column {name}"
            )
        if name in units or (column or name) in there:
            specs[name] = ColumnSpec(column or name, given or None, model.unit_of(name) or unit)
    options = ReadingOptions(time=channels.time or None, form=channels.form)
    if not needs_outputs and units:
        found = survey(open_frame(frame, form=channels.form), specs, options, describe=False)
        unread = {f.column for f in found.faults}
        specs = {n: s for n, s in specs.items() if n in units or s.column not in unread}
    return record_of_frame(frame, specs, options=options)


def _of_arrays(model: Model, inputs: Any, Ts: float) -> Driving:
    """A mapping of input to samples, or the number of samples of a model without inputs."""
    needed = [name for name, entry in model.inputs.items() if entry.kind != "generated"]
    if isinstance(inputs, int | np.integer) and not isinstance(inputs, bool):
        if needed:
            raise DataError(
                f"{model.name}: {inputs} samples of what? It has the inputs {', '.join(needed)}; "
                "give a mapping of each to its samples"
            )
        N, arrays = int(inputs), {}
    elif isinstance(inputs, Mapping):
        arrays = {name: np.asarray(value, dtype=float) for name, value in inputs.items()}
        N = _length(model, arrays, needed)
        arrays = {name: to_si(values, model.unit_of(name)) for name, values in arrays.items()}
    else:
        raise DataError(
            f"{model.name}: cannot be driven with {type(inputs).__name__}; give a casid.Record, an "
            "experiment, a DataFrame, or a mapping of input to samples"
        )
    if N < 2:
        raise DataError(f"{model.name}: {N} samples; give at least 2")
    t: Array = Ts * np.arange(N)
    columns = {name: np.broadcast_to(arrays[name], (N,)) for name in needed}
    units = {name: model.inputs[name].unit for name in needed}
    record = Record({"t": t, **columns}, {"t": "s", **units}, Ts, name="inputs")
    return Driving("inputs", record.t, Ts, input_columns(model, record))


def _length(model: Model, arrays: Mapping[str, Array], needed: Sequence[str]) -> int:
    """The number of samples of all arrays; numbers hold for all samples."""
    lacking = [name for name in needed if name not in arrays]
    foreign = [name for name in arrays if name not in needed]
    if lacking or foreign:
        raise DataError(
            f"{model.name}: inputs are {', '.join(needed) or 'none'}; "
            + (f"samples of {', '.join(lacking)} are missing" if lacking else "")
            + (" and " if lacking and foreign else "")
            + (f"{', '.join(foreign)} is no input" if foreign else "")
        )
    lengths = {a.size for a in arrays.values() if a.ndim == 1}
    if any(a.ndim > 1 for a in arrays.values()) or len(lengths) != 1:
        shapes = ", ".join(f"{n} {a.shape}" for n, a in arrays.items())
        raise DataError(
            f"{model.name}: give each input as (N,) samples, all of one length, or as a number "
            f"beside one that has samples; got {shapes or 'nothing'}"
        )
    return lengths.pop()
