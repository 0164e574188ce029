"""Cases of a study, each a row of a file of JSON lines as soon as it is finished."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Iterator, Mapping
from pathlib import Path
from typing import Any

import joblib

import casid

Row = dict[str, Any]
Key = Callable[[Row], Hashable]
"""What identifies a row."""


def last_rows(file: Path, key: Key) -> list[Row]:
    """The last row of every case; a line that was cut off when a run was killed is left out."""
    rows: dict[Hashable, Row] = {}
    for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        rows[key(row)] = row
    return list(rows.values())


def finished(
    file: Path, key: Key, tasks: Mapping[Any, Any], work: Callable[[Any], Row], jobs: int
) -> Iterator[Row]:
    """Do what the file lacks or what failed; yields each row once it is written.

    Parameters
    ----------
    tasks : key of a row -> what `work` makes it from.
    """
    done = {key(row) for row in last_rows(file, key) if "error" not in row}
    if file.exists() and not file.read_bytes().endswith(b"\n"):
        with file.open("a", encoding="utf-8") as stream:
            stream.write("\n")  # a line was cut off when a run was killed
    parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
    for row in parallel(joblib.delayed(work)(t) for k, t in tasks.items() if k not in done):
        with file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(row) + "\n")
        yield row


def of_diagnosis(d: casid.Diagnosis) -> Row:
    """Verdict, causes with alternatives, what it calls unexplained, and rms errors."""
    return {
        "verdict": d.verdict,
        "causes": [
            {
                "kind": c.kind,
                "where": c.where,
                "p": c.p_value,
                "alternatives": [[a.kind, a.where, a.p_value] for a in c.alternatives],
                "values": {p.name: p.value for p in c.parameters},
            }
            for c in d.causes
        ],
        "unexplained": None if d.unexplained is None else " ".join(d.unexplained.sentences),
        "disturbances": [x.where for x in d.disturbances],
        "candidates": len(d.ranking),
        "fitted": _plain(d.fitted),
        "held_out": _plain(d.held_out),
    }


def _plain(errors: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    return {name: {k: float(v) for k, v in values.items()} for name, values in errors.items()}
