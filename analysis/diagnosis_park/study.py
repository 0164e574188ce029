"""How often is the diagnosis right on systems of all kinds, and how often would an oracle be?

    python -m analysis.diagnosis_park [--systems a,b] [--records N] [--first N] [--seed S]
                                      [--jobs N] [--out DIR] [--quick] [--without-oracles]
                                      [--summary]

Every system has a simulator of its own in `tests/support/park`, which shares no code with casid,
and a problem file in `problem_files`, written from the manual; `random_mechanical` and
`random_thermal` are networks drawn anew for every record. A record hides one effect (lambda 100 to
3000, or beyond 1e5), nothing, or something that no catalogue has (`cases`). The oracles of `oracle`
judge the same records. Each finished record is a line of DIR/cases.jsonl at once; a run that was
stopped goes on.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from analysis.common.case_file import Row, finished, last_rows
from analysis.common.output import aligned
from analysis.common.runner import Run, Study, jobs
from analysis.common.targets import Target
from analysis.diagnosis_park.cases import Case
from analysis.diagnosis_park.judgement import (
    first,
    has_truth,
    is_misnamed,
    is_right,
    is_wrong,
)
from analysis.diagnosis_park.runs import NAMES, row_of
from analysis.diagnosis_park.tables import (
    COSINES,
    ENERGIES,
    by_range,
    by_system,
    confusions,
    targets_of,
)
from analysis.diagnosis_power.judgement import is_alarm, is_flagged

RECORDS, QUICK_RECORDS = 80, 2
QUICK_SYSTEMS = ("motor", "rooms")


def key_of(row: Row) -> tuple[str, int, int]:
    """What identifies a row."""
    return row["system"], row["seed"], row["number"]


def rows_of(file: Path) -> list[Row]:
    """The last row of every case."""
    return last_rows(file, key_of)


def run_cases(
    file: Path, cases: Sequence[Case], n_jobs: int = 1, *, oracles: bool = True
) -> Iterator[Row]:
    """Do what the file lacks or what failed; yields each row once it is written."""
    tasks = {(c.system, c.seed, c.number): c for c in cases}
    return finished(file, key_of, tasks, partial(row_of, oracles=oracles), n_jobs)


def line_of(row: Row) -> str:
    """One line for a finished record."""
    if row["part"] == "null":
        word = "ALARM" if is_alarm(row) else "quiet"
    else:
        word = "right" if is_right(row) else "set" if has_truth(row) else "missed"
        is_error = is_misnamed if row["part"] == "unlisted" else is_wrong
        word = "WRONG" if is_error(row) else word
    named = first(row)
    found = row.get("error") or ("-" if named is None else "{}({})".format(*named))
    flag = " FLAG" if is_flagged(row) else ""
    hidden = f"{row['kind']}({row['where']})"
    return (
        f"{row['system']:<14}{row['number']:>4} {row['part']:<9}{hidden:<36}"
        f"{row['energy']:>10.0f} {word:<7}{row['cpu']:6.1f} s  {found}{flag}"
    )


def study(run: Run) -> Iterator[Target]:
    """Run the requested records, a line for each; tables and targets of all."""
    o = run.options
    systems = o.systems.split(",") if o.systems else QUICK_SYSTEMS if run.quick else NAMES
    records = o.records or (QUICK_RECORDS if run.quick else RECORDS)
    cases = [Case(s, o.seed, n) for n in range(o.first, o.first + records) for s in systems]
    with tempfile.TemporaryDirectory() as scratch:
        file = (run.folder or Path(scratch)) / "cases.jsonl"
        for row in run_cases(
            file, () if o.summary else cases, o.jobs, oracles=not o.without_oracles
        ):
            print(line_of(row), flush=True)
        rows = rows_of(file)
    tables = {
        "systems": by_system(rows),
        "lambda": by_range(rows, "energy", ENERGIES),
        "cosine": by_range(rows, "cosine", COSINES),
    }
    for name, table in tables.items():
        if table:
            print(f"\n{aligned(list(table[0]), [list(line.values()) for line in table])}")
            run.output.table(name, table)
    print("\nwent wrong:", *confusions(rows), sep="\n")
    yield from targets_of(rows, quick=run.quick or o.records is not None)


STUDY = Study(
    study,
    quick="two records of two systems, judged by what chance allows",
    out="folder for cases.jsonl and tables",
    options={
        "--systems": {"help": "names, separated by commas; default all"},
        "--records": {"type": int, "help": f"of each system (default {RECORDS})"},
        "--first": {"type": int, "default": 0, "help": "number of the first record"},
        "--seed": {"type": int, "default": 1, "help": "of the draw (default 1)"},
        **jobs(1),
        "--without-oracles": {"action": "store_true", "help": "name what casid says alone"},
        "--summary": {"action": "store_true", "help": "of the records there are; run none"},
    },
)
