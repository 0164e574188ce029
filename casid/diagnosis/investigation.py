"""Diagnose, design what decides, record, diagnose again: until no tie between causes is left."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

from casid.argument_types import names_wrong_types
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.data.record import Record
from casid.diagnosis.diagnose import diagnose
from casid.diagnosis.diagnosis import Diagnosis
from casid.errors import CasidError, DataError
from casid.experiment_design.aim import Aim, tie_of
from casid.experiment_design.design import design_experiment
from casid.experiment_design.designed_experiment import DesignedExperiment
from casid.experiment_design.limits import Range
from casid.experiment_design.options import DesignOptions
from casid.experiment_design.shortest_record import Duration
from casid.presentation import Presented, write
from casid.saving.archive import RESULT_FILE

Measure = Callable[[DesignedExperiment], Record]
"""Takes the record of a designed experiment: plays `input.csv`, returns what was measured."""


@dataclass(frozen=True, slots=True, eq=False)
class Investigation(Presented):
    """Records, what was diagnosed from them, and the experiments that were designed.

    Attributes
    ----------
    records : all of them, those at hand and those taken, in their order.
    diagnoses : of the records at hand, and again after every record that was taken.
    designs : after every diagnosis that ended in a tie, as far as one could be made.
    ending : why it ended, in words.
    """

    problem: str
    records: tuple[Record | Experiment, ...]
    diagnoses: tuple[Diagnosis, ...]
    designs: tuple[DesignedExperiment, ...]
    ending: str

    @property
    def diagnosis(self) -> Diagnosis:
        """The last one, of all records."""
        return self.diagnoses[-1]

    @property
    def next(self) -> DesignedExperiment | None:
        """The experiment that is still to be recorded; None where none is."""
        return self.designs[-1] if len(self.designs) == len(self.diagnoses) else None

    @property
    def is_decided(self) -> bool:
        """True where the last diagnosis has no tie between causes that have a name."""
        return not tie_of(self.diagnosis)

    def __repr__(self) -> str:
        return f"<Investigation {self.problem}: {len(self.records)} records, {self.ending}>"

    def to_json(self) -> dict[str, Any]:
        """Plain data of all diagnoses and designs."""
        return {
            "schema": "casid.investigation/1",
            "problem": self.problem,
            "ending": self.ending,
            "is_decided": self.is_decided,
            "records": [record.name for record in self.records],
            "diagnoses": [found.to_json() for found in self.diagnoses],
            "designs": [found.to_json() for found in self.designs],
        }

    def write(self, folder: str | Path) -> Path:
        """Write the page, the numbers, and a folder each: `diagnosis-1`, `design-1`, ...

        With the experiment that is still to be recorded as `input.csv`; returns `folder`.
        """
        folder = Path(folder)
        every: list[tuple[str, Diagnosis | DesignedExperiment]] = [
            *((f"diagnosis-{i}", found) for i, found in enumerate(self.diagnoses, 1)),
            *((f"design-{i}", design) for i, design in enumerate(self.designs, 1)),
        ]
        for name, result in every:
            (folder / name).mkdir(parents=True, exist_ok=True)
            result.write(folder / name)
            with suppress(DataError):  # a model of its own functions has its page alone
                result.save(folder / name / RESULT_FILE)
        write(self, folder)
        if self.next is not None:
            self.next.write_csv(folder / "input.csv", force=True)
        return folder


@names_wrong_types()
def investigate(
    problem: Problem,
    records: Sequence[Record | Experiment],
    limits: Mapping[str, Range],
    duration: Duration,
    *,
    measure: Measure | None = None,
    most: int = 3,
    diagnosis: Mapping[str, Any] | None = None,
    progress: Callable[[str], None] | None = None,
    **options: Unpack[DesignOptions],
) -> Investigation:
    """Diagnose records and, while causes are tied, design and take the one that separates them.

    Without `measure` it ends at the first design: record it, and call again with all records.

    Parameters
    ----------
    records : at hand, at least one, in the problem's channels (SI); an experiment has its load
        case with it.
    limits, duration, options : of every experiment, as `casid.design_experiment` takes them.
    measure : takes the record of a designed experiment; `most` of them.
    diagnosis : options of `casid.diagnose`, by name.
    progress : called with a line of text before what may take seconds.

    Returns
    -------
    Investigation; values, sizes and noise of every design come from the diagnosis before it.

    Raises
    ------
    DataError
        If there is no record to begin with, or `measure` gives none.
    CasidError
        What the first diagnosis raises.

    Source: Box and Hill, Discrimination among mechanistic models, Technometrics 9 (1967) 57-71,
    on sequential design.
    """
    taken = _at_hand(problem, records)
    say = progress or (lambda _: None)
    diagnoses: list[Diagnosis] = []
    designs: list[DesignedExperiment] = []
    ending = ""
    while not ending:
        say(f"diagnose {len(taken)} record{'s' * (len(taken) > 1)}")
        found = diagnose(problem, taken, **{"advise": False, **(diagnosis or {})})
        diagnoses.append(found)
        if not tie_of(found):
            ending = "decided"
            break
        try:
            designs.append(
                design_experiment(found, Aim.of(found), limits, duration, progress=say, **options)
            )
        except CasidError as error:
            ending = f"tied, and no experiment separates the causes: {error}"
            break
        ending = _why_to_end(measure, len(designs), most)
        if not ending and measure is not None:
            taken.append(_measured(measure, designs[-1], len(taken) + 1))
    return Investigation(problem.name, tuple(taken), tuple(diagnoses), tuple(designs), ending)


def _at_hand(problem: Problem, records: Sequence[Record | Experiment]) -> list[Record | Experiment]:
    """The records to begin with; refuses none."""
    if not len(records):
        raise DataError(
            f"{problem.name}: no record to begin with; design the first experiment for the causes "
            "that are possible, casid.design_experiment(problem, Aim.separate(a, b), ...)"
        )
    return list(records)


def _why_to_end(measure: Measure | None, designs: int, most: int) -> str:
    """Why the last design is not recorded; empty where it is."""
    if measure is None:
        return "tied; record the designed experiment, and call again with all records"
    return f"tied after {most} record{'s' * (most > 1)} that it may take" * (designs > most)


def _measured(measure: Measure, design: DesignedExperiment, number: int) -> Record:
    record = measure(design)
    if not isinstance(record, Record):
        raise DataError(
            f"measure gave {type(record).__name__} for record {number}; it has to return a "
            "casid.Record"
        )
    return record
