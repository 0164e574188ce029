"""The experiment: a record with its load case."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from casid.argument_types import methods_name_wrong_types
from casid.arrays import Array, BoolArray
from casid.data.record import Record
from casid.errors import DataError
from casid.pickling import PickledByFields
from casid.presentation import Viewed


@dataclass(frozen=True, slots=True, eq=False)
class NoiseSizes:
    """How large the noise of an output is at each instant, relative to its RMS size.

    Attributes
    ----------
    t : (M,) instants of the record's clock [s].
    relative : (M,) size there; its mean square is 1.
    per_reading : what `relative` adds per unit of the reading (SI), where noise grows with it.
    at_zero : `relative` where nothing is read.
    """

    t: Array
    relative: Array
    per_reading: float = 0.0
    at_zero: float = 1.0

    def at(self, t: Array) -> Array:
        """(N,) the size at other instants."""
        return np.asarray(np.interp(t, self.t, self.relative))


@methods_name_wrong_types()
@dataclass(frozen=True, slots=True, eq=False)
class Experiment(Viewed, PickledByFields):
    """A record with its load case.

    Attributes
    ----------
    record : Record
    known : mapping of parameter name to value, in the unit that the model declares
        Values known for this record alone.
    name : str
        The record's name where none is given.
    unused : mapping of channel to column
        Channels of the record that are columns of its file which the problem does not use; the
        diagnosis tests them as missing inputs.
    window : int
        Samples that are simulated from one initial state, each such window of the record from its
        own; 0: the whole record from one. For unstable models, which no record is simulated with.
    filled : mapping of input to (N,) bool array
        Samples of inputs that were not recorded, but are filled in the record.
    joined : mapping of output to (N,) bool array
        Samples of the record's outputs where straight lines stand in the place of readings.
    noise_sizes : mapping of output to NoiseSizes
        Of outputs whose noise has another size from sample to sample. Errors count in units of it.
    """

    record: Record
    known: Mapping[str, float] = field(default_factory=dict)
    name: str = ""
    unused: Mapping[str, str] = field(default_factory=dict)
    window: int = 0
    filled: Mapping[str, BoolArray] = field(default_factory=dict)
    joined: Mapping[str, BoolArray] = field(default_factory=dict)
    noise_sizes: Mapping[str, NoiseSizes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.record, Record):
            raise DataError(
                f"an experiment needs a Record, got {type(self.record).__name__}. "
                "Read one with casid.read_record(path)."
            )
        known: dict[str, float] = {}
        for parameter, value in self.known.items():
            try:
                known[str(parameter)] = float(value)
            except (TypeError, ValueError):
                known[str(parameter)] = float("nan")
            if not np.isfinite(known[str(parameter)]):
                raise DataError(
                    f"experiment {self.name or self.record.name}: known value {parameter} = "
                    f"{value!r} is not a finite number. Give it as a number in the "
                    "unit that the model declares."
                )
        object.__setattr__(self, "known", MappingProxyType(known))
        object.__setattr__(self, "name", self.name or self.record.name)
        object.__setattr__(self, "unused", MappingProxyType(dict(self.unused)))
        object.__setattr__(self, "filled", MappingProxyType(dict(self.filled)))
        object.__setattr__(self, "joined", MappingProxyType(dict(self.joined)))
        object.__setattr__(self, "noise_sizes", MappingProxyType(dict(self.noise_sizes)))

    def __repr__(self) -> str:
        known = ", ".join(f"{n} = {v:g}" for n, v in self.known.items()) or "nothing known"
        return f"<Experiment {self.name}: {known}; {self.record!r}>"


Given = Sequence[Experiment | Record] | Experiment | Record
"""What a function that makes experiments may return."""


def listed_experiments(given: Given, what: str) -> list[Experiment | Record]:
    """Experiments and records that a function returned, one or several.

    Parameters
    ----------
    what : the function, in words.

    Raises
    ------
    DataError
        If there is none, or anything else.
    """
    every = [given] if isinstance(given, Record | Experiment) else list(given)
    if not every or not all(isinstance(e, Record | Experiment) for e in every):
        raise DataError(
            f"{what} returns no experiment; return a list of casid.Experiment or casid.Record"
        )
    return every
