"""What keeps a file from being a record."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from casid.data.record import FloatArray, Record


@dataclass(frozen=True, slots=True)
class Fault:
    """Something in a file that keeps it from being a record: what, where, and how to mend it."""

    kind: str
    text: str
    mend: str
    column: str | None = None

    def __str__(self) -> str:
        return f"{self.text} {self.mend}"


@dataclass(slots=True)
class Survey:
    """What was found in a file: the record where there is one, and every fault met on the way."""

    path: Path
    record: Record | None = None
    faults: list[Fault] = field(default_factory=list)
    times: FloatArray | None = None

    def with_fault(self, fault: Fault) -> Survey:
        """Itself, one fault more noted."""
        self.faults.append(fault)
        return self
