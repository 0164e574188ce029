"""What a fitted model holds beside its equations: records, causes, settings, channels, noise."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from casid.arrays import Array
from casid.data.reading.file_format import FileFormat
from casid.data.record import Record
from casid.model.effects.effect import ON_THE_CLOCK
from casid.model.effects.names import effect_words
from casid.model.model import Model

if TYPE_CHECKING:
    from casid.linear.filtering.noisy_model import White

COMPARED = 100
"""Samples at the start of a record that it is known again by."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedRecord:
    """A record that was fitted: what holds in it alone, in SI units.

    Attributes
    ----------
    Ts, t0 : sample time and time of the first sample on the record's clock [s].
    N : samples fitted; a record may go on after them.
    known : parameter -> value known for this record alone (its load case), or estimated for it.
    nodes : (segments, nx) states where each shooting segment starts; the first is the initial
        state. One segment but for multiple shooting.
    fingerprint : of its inputs and of its outputs, by which the record is known again.
    clock : that of the record, which other windows of its file have too (`Record.clock`).
    operating_point : state or input -> where the record works, SI (`operating_point`); of the first
        record alone.
    """

    name: str
    Ts: float
    t0: float
    N: int
    known: Mapping[str, float]
    nodes: Array
    fingerprint: tuple[str, str] = ("", "")
    clock: str = ""
    operating_point: Mapping[str, float] = field(default_factory=dict)

    @property
    def cuts(self) -> Array:
        """(segments,) the sample that each segment starts at."""
        return np.linspace(0, self.N, len(self.nodes) + 1).astype(int)[:-1]

    def is_start_of(self, model: Model, record: Record) -> bool:
        """True if `record` has this clock and begins with these samples.

        Inputs alone are known again by the record's name as well.
        """
        if abs(record.Ts / self.Ts - 1) > 1e-9 or abs(record.t0 - self.t0) > 1e-6 * self.Ts:
            return False
        inputs, outputs = fingerprint(model, record)
        if inputs != self.fingerprint[0]:
            return False
        return outputs == self.fingerprint[1] if outputs else record.name == self.name


def operating_point(signals: Mapping[str, Array]) -> dict[str, float]:
    """Where a record works: 0 for a signal that passes through it, else the mean of the signal.

    What swings about 0 is a deviation already; a level, a speed or an absolute temperature is not.

    Parameters
    ----------
    signals : input, or state as simulated, -> (N,) SI; samples that are missing are NaN.
    """
    found = {}
    for name, values in signals.items():
        given = values[np.isfinite(values)]
        stays_away = given.size > 0 and bool((given > 0).all() or (given < 0).all())
        found[name] = float(given.mean()) if stays_away else 0.0
    return found


def fingerprint(model: Model, record: Record) -> tuple[str, str]:
    """sha256 of the first samples of a record's inputs and of its outputs; empty without them."""
    inputs = [n for n, u in model.inputs.items() if u.kind != "generated"]
    return _hash(record, inputs), _hash(record, model.outputs)


def _hash(record: Record, names: Iterable[str]) -> str:
    names = list(names)
    if any(name not in record for name in names):
        return ""
    text = hashlib.sha256()
    for name in names:
        text.update(np.ascontiguousarray(record[name][:COMPARED]).tobytes())
    return text.hexdigest()


@dataclass(frozen=True, slots=True, eq=False)
class AddedCause:
    """A cause that a diagnosis added to the model.

    Attributes
    ----------
    kind, where : as `diagnosis.json` names them.
    parameters : names, in the model, of what it is described by.
    constants : what was chosen rather than estimated, SI units: `speed` below which dry friction is
        smoothed, `time` of a jump, `start` and `stop` of a drift, `mean` of a channel.
    shape, description : what distinguishes it within its kind, in words where it has no name.
    """

    kind: str
    where: str
    parameters: tuple[str, ...]
    constants: Mapping[str, float] = field(default_factory=dict)
    shape: str = ""
    description: str = ""

    @property
    def words(self) -> str:
        """The cause and its place, as an engineer says it."""
        return effect_words(self.kind, self.where, description=self.description)

    @property
    def is_on_the_clock(self) -> bool:
        """True of what has an instant, a span or a phase on the clock of the fitted record."""
        return self.kind in ON_THE_CLOCK or bool({"time", "start"} & set(self.constants))

    @property
    def words_in_time(self) -> str:
        """The cause and its place, and the instant at which it sets in, where it has one."""
        time = self.constants.get("time")
        return self.words if time is None else f"{self.words} from t = {time:.6g} s on"


@dataclass(frozen=True, slots=True, eq=False)
class SimulationSettings:
    """How the model was simulated when it was fitted.

    Attributes
    ----------
    substeps : Runge-Kutta steps a sample, at the sample time of the fit.
    segments : shooting segments a record.
    weights : (ny,) of the outputs' errors, one over their units.
    """

    substeps: int = 1
    segments: int = 1
    weights: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """Where the problem's signals are found in a file or table.

    Attributes
    ----------
    columns : signal -> column, with its unit after a colon ("roll_deg:deg").
    recorded : channels recorded beside the model's, name -> SI unit.
    derived : signal that no file has -> how it is computed, in words.
    time : the time column; empty where it is found by name.
    form : how the problem's files are written, where they leave it open.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    recorded: Mapping[str, str] = field(default_factory=dict)
    derived: Mapping[str, str] = field(default_factory=dict)
    time: str = ""
    form: FileFormat | None = None


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """White noise of the outputs and on the process, as a prediction-error fit has it.

    Attributes
    ----------
    sources : each with its known standard deviation.
    rest : state or input -> its value at the rest that the model was linearised about, SI.
    initial : state -> standard deviation of its initial value; None for a steady-state predictor.
    is_extended : predicted by an extended Kalman filter; states without a standard deviation in
        `initial` then have none.
    shaped : states of disturbances: zero where none acts.
    """

    sources: tuple[White, ...]
    rest: Mapping[str, float] = field(default_factory=dict)
    initial: Mapping[str, float] | None = None
    is_extended: bool = False
    shaped: tuple[str, ...] = ()
