"""How the records of a fleet are processed: settings, references, and the row of an outcome.

Processes that only hand out records load this and none of the diagnosis.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypedDict

import numpy as np

from casid.fleets.record_list import FleetRecord
from casid.fleets.thresholds import SCREENING

Row = dict[str, Any]

REFUSED: Row = {"stage": "refused", "verdict": "", "p": 1.0, "parameters": "[]", "causes": "[]"}
"""What a record without an outcome has, beside `refusal`."""

REFERENCES = SCREENING.references
"""First records of an asset that its reference is made of."""


@dataclass(frozen=True, slots=True)
class FleetSettings:
    """How the records of a fleet are diagnosed.

    Attributes
    ----------
    level : of false discoveries over the fleet, and of false alarms in one record.
    screen : whether score tests at the asset's reference decide which records are searched.
    hold_out, max_causes, without, starts, seed : as `casid.diagnose` takes them.
    mapping : signal -> column, as `casid.Problem.read` takes it; window : seconds of each record.
    ignore : columns of the files that are no signals, or are not to be tested as missing inputs.
    """

    level: float = 0.05
    screen: bool = True
    hold_out: float = 0.3
    max_causes: int = 4
    without: tuple[str, ...] = ()
    starts: int | None = None
    seed: int = 0
    mapping: Mapping[str, str] = field(default_factory=dict)
    window: tuple[float, float] | None = None
    ignore: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.without, str):  # one text is refused, with what to write instead
            object.__setattr__(self, "without", tuple(self.without))
        object.__setattr__(self, "mapping", dict(self.mapping))


class FleetOptions(TypedDict, total=False):
    """Options of `fleet` beside its records; the attributes of `FleetSettings` have their meaning.

    budget, memory : seconds and megabytes that one record may take; one that takes more is
        refused, and its row says why.
    """

    level: float
    screen: bool
    budget: float
    memory: float
    hold_out: float
    max_causes: int
    without: Iterable[str]
    starts: int | None
    seed: int
    mapping: Mapping[str, str]
    window: tuple[float, float] | None
    ignore: Iterable[str]


@dataclass(frozen=True, slots=True)
class Reference:
    """A fit to the first records of an asset.

    Attributes
    ----------
    path : of the record whose signals scale the catalogue.
    values : parameter -> value in SI.
    """

    path: str
    values: tuple[tuple[str, float], ...]


def reference_of(fits: Sequence[tuple[FleetRecord, Mapping[str, float]]]) -> Reference | None:
    """The median of some records' fits, at the signals of the record nearest to it.

    A median, since one of the first records may lack what the others have.
    """
    if not fits:
        return None
    names = list(fits[0][1])
    values = np.array([[fit[n] for n in names] for _, fit in fits])
    middle = np.median(values, axis=0)
    spread = np.median(np.abs(values - middle), axis=0)
    distance = np.sum(np.abs(values - middle) / np.where(spread > 0, spread, 1.0), axis=1)
    nearest = fits[int(np.argmin(distance))][0]
    return Reference(nearest.path, tuple(zip(names, middle.tolist(), strict=True)))
