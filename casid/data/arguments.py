"""A problem and its records as callers give them, in the one form that the library works with."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.data.reading.frames import is_frame
from casid.data.record import Record
from casid.errors import DataError, ModelError
from casid.model.model import Model

if TYPE_CHECKING:
    import pandas as pd

Recorded: TypeAlias = "Experiment | Record | pd.DataFrame"
"""What a record can be given as; a DataFrame is read through the problem's channels."""


def problem_of(problem: Problem | Model) -> Problem:
    """The problem, or that of a model alone."""
    return Problem(problem.name, problem) if isinstance(problem, Model) else problem


def in_si(
    problem: Problem | Model,
    experiments: Sequence[Recorded] | Recorded | None,
) -> tuple[Problem, list[Experiment]]:
    """Problem and experiments as the library's own functions take them: every number in SI.

    Parameters
    ----------
    problem : or its model alone, where there is nothing to add to it.
    experiments : values known in them in the units that the model declares; default the problem's
        own example. Names are made unique.

    Raises
    ------
    DataError
        If there is no record.
    ModelError
        If `problem` is none.
    """
    problem = problem_of(problem)
    chosen = experiments_of(problem, experiments)
    converted = [replace(e, known=problem.model.in_si(e.known)) for e in chosen]
    return problem.in_si(), converted


def experiments_of(
    problem: Problem, experiments: Sequence[Recorded] | Recorded | None
) -> list[Experiment]:
    """What the caller gave as a list of experiments, names made unique; the example by default.

    A DataFrame is read through the problem's channels, as a file is.
    """
    if not isinstance(problem, Problem):
        what = f"model {problem.name}" if isinstance(problem, Model) else repr(problem)
        raise ModelError(
            f"{what} is no problem; give casid.Problem(name, model), or "
            "casid.load_problem(path) of a file"
        )
    chosen: list[Experiment]
    if experiments is None:
        chosen = problem.examples()
    else:
        alone = isinstance(experiments, Record | Experiment) or is_frame(experiments)
        given: Any = [experiments] if alone else experiments
        if isinstance(given, str) or not isinstance(given, Iterable):
            given = [given]
        chosen = [_experiment(problem, e) for e in given]
    if not chosen:
        raise DataError("no record given; name at least one")
    seen: dict[str, int] = {}
    out = []
    for e in chosen:
        n = seen.get(e.name, 0)
        seen[e.name] = n + 1
        out.append(e if n == 0 else replace(e, name=f"{e.name}#{n + 1}"))
    return out


def _experiment(problem: Problem, given: Recorded) -> Experiment:
    if isinstance(given, Experiment):
        return given
    if isinstance(given, Record):
        return problem.experiment(given)
    if not is_frame(given):
        raise DataError(
            f"{given!r} is no record; give one that casid.read_record(path) or "
            "Problem.read(path) returns, a casid.Record of arrays, or a pandas DataFrame"
        )
    return problem.read_frame(given)
