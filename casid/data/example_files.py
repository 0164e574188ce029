"""A problem's own example records as files that the problem reads."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from casid.data.experiment import Experiment, listed_experiments
from casid.data.problem import Problem
from casid.data.reading.columns import ColumnSpec, clock_and_unit
from casid.data.record import Record
from casid.data.record_files import write_record
from casid.errors import DataError


def write_examples(problem: Problem, path: str | Path, *, force: bool = False) -> dict[str, Path]:
    """Write the problem's example records in the columns and units that it reads.

    Parameters
    ----------
    path : ends with .csv or .parquet; of several records each gets its name behind the file's.
    force : write over files that exist.

    Returns
    -------
    dict of what a command takes (`run.csv`, with its load case `nominal=run.csv`) to the path

    Raises
    ------
    DataError
        If the problem has no example, a record lacks a channel that no file of it could do without,
        or a file exists.
    """
    path = Path(path)
    experiments = _raw_examples(problem)
    time = clock_and_unit(problem.time)[0] if isinstance(problem.time, str) else "t"
    if isinstance(problem.time, ColumnSpec):
        time = problem.time.column
    names = _file_names(path, experiments)
    present = [name for name in names if name.exists()]
    if present and not force:
        raise DataError(f"{present[0]} exists; name another file with --out, or add --force")
    written = {}
    for name, experiment in zip(names, experiments, strict=True):
        columns = _columns(problem, experiment.record)
        write_record(experiment.record, name, columns, time=time, force=force)
        case = _load_case(problem, experiment.known)
        written[f"{case}={name}" if case else str(name)] = name
    return written


def _raw_examples(problem: Problem) -> list[Experiment]:
    """The example before channels are derived: a file holds what they are derived from."""
    if problem.example is None:
        return problem.examples()  # refuses it
    given = listed_experiments(problem.example(), f"the example of problem {problem.name}")
    return [Experiment(e) if isinstance(e, Record) else e for e in given]


def _file_names(path: Path, experiments: list[Experiment]) -> list[Path]:
    """The path itself for one record; with the record's name, and a number, for several."""
    if len(experiments) == 1:
        return [path]
    names: list[Path] = []
    for experiment in experiments:
        label = re.sub(r"[^\w.]+", "-", experiment.name).strip("-")
        stem = f"{path.stem}-{label}"
        name, n = path.with_name(f"{stem}{path.suffix}"), 2
        while name in names:
            name, n = path.with_name(f"{stem}-{n}{path.suffix}"), n + 1
        names.append(name)
    return names


def _columns(problem: Problem, record: Record) -> dict[str, ColumnSpec]:
    """The columns that the problem reads, of channels that the record has."""
    specs = problem.columns()
    needed = {*problem.model.inputs, *problem.model.outputs}
    lacking = [n for n in specs if n not in record and n in needed]
    if lacking:
        raise DataError(
            f"problem {problem.name}: its example {record.name} has no channel {lacking[0]}; "
            "return records with every input and output of the model, or with what they are "
            "derived from"
        )
    return {n: spec for n, spec in specs.items() if n in record}


def _load_case(problem: Problem, known: Mapping[str, float]) -> str | None:
    """The load case that has just these values."""
    cases = [case for case, values in problem.load_cases.items() if dict(values) == dict(known)]
    return cases[0] if cases and known else None
