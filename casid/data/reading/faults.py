"""What is found in a file: its columns, its record, and what keeps it from being one."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from casid.arrays import FloatArray
from casid.data.record import Record

Kind = Literal["numeric", "time", "text", "empty"]


@dataclass(frozen=True, slots=True)
class Fault:
    """Something in a file that keeps it from being a record: what, where, and how to correct it.

    Attributes
    ----------
    detail : what is wrong with the column alone, where `text` names file and column as well.
    """

    kind: str
    text: str
    remedy: str
    column: str | None = None
    detail: str = ""

    def __str__(self) -> str:
        return f"{self.text} {self.remedy}".rstrip()


@dataclass(frozen=True, slots=True)
class ColumnSurvey:
    """One column of a file.

    Attributes
    ----------
    name : as written in the file.
    unit : the unit read from its name or the file, a unit of `casid.model.units`; None where there
        is none that can be read in one way.
    kind : "numeric", "time" (the time stamps, and dates), "text" or "empty".
    Ts : sample time [s] of its values, longer than the file's where only every k-th row has one;
        None where there are no time stamps, or they are irregular.
    remarks : sentences: constant, a copy of another column, cells without a value ...
    written : the unit as the file has it where it cannot be read in one way; empty otherwise.
    doubt : why it cannot, a sentence that is one of the remarks as well; empty otherwise.
    """

    name: str
    unit: str | None
    kind: Kind
    Ts: float | None
    remarks: tuple[str, ...] = ()
    written: str = ""
    doubt: str = ""


@dataclass(slots=True)
class Survey:
    """What was found in a file: its columns, the record where there is one, and every fault.

    Attributes
    ----------
    record : None where the clock cannot be used.
    times : the time stamps [s], None where they cannot be read.
    columns : every column of the file, in order; empty where the file is no table.
    clock : name of the time column; None where there is none.
    notes : what was read and how, where it is not plain: time stamps, lines that are not read ...
    doubts : what keeps no record from being read, but may be a mistake.
    units : channel -> the unit in which the file has it.
    counted : from when the times count, where they are dates or times of day; empty for numbers.
    """

    path: Path
    record: Record | None = None
    faults: list[Fault] = field(default_factory=list)
    times: FloatArray | None = None
    columns: tuple[ColumnSurvey, ...] = ()
    clock: str | None = None
    notes: list[str] = field(default_factory=list)
    doubts: list[Fault] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)
    counted: str = ""

    def with_fault(self, fault: Fault) -> Survey:
        """Itself, one fault more noted."""
        self.faults.append(fault)
        return self
