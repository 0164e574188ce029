"""The stages of an estimation: which records give which parameters, in which order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.data.experiment import Experiment
from casid.errors import ModelError
from casid.estimation.moments.equations.parts import Part
from casid.estimation.moments.stages.moment_settings import MomentSettings


@dataclass(frozen=True, slots=True)
class StageSpec:
    """One stage: which records, and which parameters they give.

    Attributes
    ----------
    free : parameters estimated here; those of earlier stages are taken from there.
    records : names of experiments; None: all.
    settings : None: those of the whole estimation.
    """

    free: Sequence[str]
    records: Sequence[str] | None = None
    settings: MomentSettings | None = None


@dataclass(frozen=True, slots=True, eq=False)
class StageRecords:
    """The records of one stage, read.

    Attributes
    ----------
    number : of the stage, from 0.
    free : parameters estimated in it.
    """

    number: int
    free: tuple[str, ...]
    settings: MomentSettings
    experiments: tuple[Experiment, ...]
    parts: tuple[Part, ...]

    @property
    def question(self) -> tuple[Any, ...]:
        """What identifiability depends on: the stage, and the load cases of its records."""
        return (self.number, *((e.name, tuple(e.known.items())) for e in self.experiments))


def refuse_undetermined(
    specs: Sequence[StageSpec], i: int, parts: Sequence[Part], undetermined: set[str]
) -> None:
    """Refuse stage i if its records depend on parameters neither known nor estimated yet."""
    later = {f for s in specs[i + 1 :] for f in s.free}
    for p in parts:
        slope = np.asarray(p.equation.jacobian([p.values[q] for q in p.equation.parameters])[1])
        acting = {
            q
            for q, column in zip(p.equation.parameters, slope.T, strict=True)
            if np.any(np.abs(column) > 1e-12)  # where no load is on, its height has no effect
        }
        missing = sorted(((undetermined | later) - p.known) & acting)
        waiting = [q for q in missing if q in later]
        if waiting:
            raise ModelError(
                f"stage {i + 1}, record {p.record}: {', '.join(waiting)} is estimated only in a "
                f"later stage and not known here; give its value in the record's load case "
                f"(Experiment(record, {{{waiting[0]!r}: ...}})), or reorder the stages"
            )
        if missing:
            raise ModelError(
                f"record {p.record}: {', '.join(missing)} is neither known nor estimated; give it "
                "a value (prior=, a load case, model.with_known), or free it in a stage"
            )
