"""How often does the diagnosis name what is hidden, and how often something that is not there?

    python -m analysis.diagnosis_power [--part PART ...] [--count N] [--jobs N] [--out DIR]
                                       [--quick] [--summary] [--save]

Cases are drawn by number and made by simulators that share no code with casid. Every finished case
is a line of DIR/cases.jsonl at once: a run that was stopped goes on where it was, and parts can be
run apart. Tables, figures and targets are made from that file; `targets` lists what is wanted,
`judgement` what counts as right. `--summary` judges the cases there are again and runs none:
energies of outliers are then those of the present definition.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from analysis.common.case_file import Row, finished, last_rows
from analysis.common.output import Output
from analysis.common.runner import Run, Study, jobs
from analysis.common.targets import Target
from analysis.diagnosis_power.energy import with_energy
from analysis.diagnosis_power.figures import figures_of
from analysis.diagnosis_power.judgement import is_flagged, is_right, is_wrong_name
from analysis.diagnosis_power.runs import diagnosed, gained, judged_by_oracles, judged_by_peers
from analysis.diagnosis_power.tables import summary_of
from analysis.diagnosis_power.targets import targets_of

COUNTS = {
    "nulls": 1200,
    "single": 500,
    "pairs": 120,
    "unlisted": 200,
    "gain": 500,
    "peers": 500,
    "oracle": 500,
    "roll": 80,
    "ship": 100,
}
"""Cases of each part of the full study."""

QUICK = {"nulls": 2, "single": 4}
"""Cases of the short study."""

RESULTS = Path(__file__).with_name("results.json")
"""The numbers of this release: what the manual shows."""


def rows_of(file: Path) -> list[Row]:
    """The last row of every case, energies of outliers as they are defined now."""
    return [with_energy(row) for row in last_rows(file, key_of)]


def key_of(row: Row) -> tuple[str, str, int]:
    """What identifies a row."""
    return str(row["part"]), str(row.get("of", row["part"])), int(row["number"])


Task = tuple[str, str, int]  # part, part whose case it is, number


def tasks_of(part: str, first: int, count: int) -> list[Task]:
    """What a part has to do; gain, peers and oracle judge the cases of other parts again."""
    again = {
        "gain": ("single",),
        "peers": ("nulls", "single"),
        "oracle": ("single", "roll", "ship"),
    }
    of = again.get(part, (part,))
    most = {name: min(count, COUNTS[name]) if part in again else count for name in of}
    return [(part, name, n) for name in of for n in range(first, first + most[name])]


def do(task: Task) -> Row:
    """One row of the file."""
    part, of, number = task
    again = {"gain": gained, "peers": judged_by_peers, "oracle": judged_by_oracles}
    work = again.get(part, diagnosed)
    return work(of, number)


def run_cases(file: Path, tasks: Sequence[Task], jobs: int) -> Iterator[Row]:
    """Do the tasks that the file lacks or that failed; yields each row once it is written."""
    return finished(file, key_of, {task: task for task in tasks}, do, jobs)


def line_of(row: Row) -> str:
    """One line for a finished case."""
    if row["part"] in ("gain", "peers", "oracle"):
        named = "{}({})".format(*row["oracle_2"]) if "oracle_2" in row else ""
        return f"{row['part']} of {row['of']} {row['number']:>4} {row.get('kind', '')} {named}"
    hidden = f"{row['kind']}({row['where']})"
    energy = f"{row['energy']:.0f}"
    if "second" in row:
        hidden += f" + {row['second']['kind']}({row['second']['where']})"
        energy += f", {row['second_energy']:.0f}"
    if "error" in row:
        return f"{row['part']} {row['number']:>4} {hidden} {energy}: {row['error']}"
    found = "; ".join(
        f"{c['kind']}({c['where']})"
        + "".join(f" or {kind}({where})" for kind, where, _ in c["alternatives"])
        for c in row["causes"]
    )
    if row["kind"] == "none" or row["part"] in ("nulls", "pairs", "unlisted"):
        word = ""
    else:
        word = "right" if is_right(row) else "WRONG" if is_wrong_name(row) else "missed"
    flag = " FLAG" if is_flagged(row) else ""
    return (
        f"{row['part']} {row['number']:>4} {hidden:<34} {energy:>6}  {row['verdict']:<10}"
        f"{word:<7}{row['cpu']:5.1f} s  {found}{flag}"
    )


def study(run: Run) -> Iterator[Target]:
    """Run the requested cases, a line for each; targets, tables and figures of all."""
    options = run.options
    with tempfile.TemporaryDirectory() as scratch:
        file = (run.folder or Path(scratch)) / "cases.jsonl"
        counts = QUICK if run.quick else COUNTS
        for part in () if options.summary else options.part or counts:
            count = options.count or counts.get(part, 1)
            for row in run_cases(file, tasks_of(part, options.first, count), options.jobs):
                print(line_of(row), flush=True)
        summary = summary_of(rows_of(file))
    write(summary, run.output)
    targets = targets_of(summary, quick=run.quick or options.count is not None)
    if options.save:
        rows = [asdict(target) for target in targets]
        text = json.dumps({**summary, "targets": rows}, indent=1) + "\n"
        RESULTS.write_text(text, encoding="utf-8")
    yield from targets


def write(summary: Row, output: Output) -> None:
    """The summary, its figures and its tables."""
    output.json("summary", summary)
    if output.folder is not None:
        for name, figure in figures_of(summary).items():
            output.figure(name, figure)
    if "single" in summary:
        output.table("confusion_matrix", summary["single"]["confusion"])
    if "nulls" in summary:
        output.table("false_alarms", summary["nulls"]["cells"])


STUDY = Study(
    study,
    quick="a dozen cases, judged by what chance",
    out="folder for cases.jsonl, tables and figures",
    options={
        "--part": {"action": "append", "choices": COUNTS, "help": "default: all of them"},
        "--count": {"type": int, "help": "cases of each part"},
        "--first": {"type": int, "default": 0, "help": "number of the first case"},
        **jobs(1),
        "--summary": {"action": "store_true", "help": "of the cases there are; run none"},
        "--save": {"action": "store_true", "help": f"write {RESULTS.name} for the manual"},
    },
)
