"""What is doubtful in a problem as it is written, before anything is fitted."""

from __future__ import annotations

from collections.abc import Sequence

from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.identification.inertia_sides import note_on_sides
from casid.identification.stated_noise import notes_on_stated_noise


def problem_notes(problem: Problem, experiments: Sequence[Experiment]) -> list[str]:
    """What its equations and its records say against its bounds and the noise that it states."""
    sides = note_on_sides(problem, experiments)
    return [*sides, *notes_on_stated_noise(problem, experiments)]
