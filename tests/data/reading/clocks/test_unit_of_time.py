"""The unit of a clock of plain numbers: read from its name, assumed with a word, or doubted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import casid
from casid.data.quality import check
from casid.data.reading.record_file import read_record


def file_of(folder: Path, header: str, times: np.ndarray) -> Path:
    path = folder / "run.csv"
    rows = [f"{t:.12g},{np.sin(k):.6f}" for k, t in enumerate(times)]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("name", "second"),
    [("time_hours", 3600), ("Time h", 3600), ("hours", 3600), ("minutes", 60), ("seconds", 1),
     ("time_seconds", 1), ("elapsed seconds", 1), ("timestamp_millis", 1e-3), ("millis()", 1e-3),
     ("timeMillis", 1e-3), ("time (millis)", 1e-3), ("time_usec", 1e-6), ("timeMicros", 1e-6),
     ("Time of day", 1)],
)  # fmt: skip
def test_a_unit_of_time_at_the_end_of_a_name_is_read(
    tmp_path: Path, name: str, second: float
) -> None:
    record = read_record(file_of(tmp_path, f"{name},x", 20.0 * np.arange(30)))
    assert record.Ts == pytest.approx(20 * second)


def test_seconds_are_said_to_be_assumed(tmp_path: Path) -> None:
    """Hours of a drug in the blood were taken as seconds without a word."""
    path = file_of(tmp_path, "Time,x", np.array([0, 0.27, 0.58, 1.15, 2.03, 3.57, 5, 7, 9.2, 24]))
    (said,) = [f for f in check(path).findings if "no unit of time" in f.text]
    assert said.severity == "note"
    assert "'Time' is read in seconds, 24 s in all (--map t=Time:h where it counts" in said.text
    given = check(path, time=("Time", "h"))  # type: ignore[arg-type]
    assert not [f for f in given.findings if "no unit of time" in f.text]


def test_counts_that_step_as_those_of_milliseconds_are_doubted(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    counts = 1003 + np.cumsum(20 + rng.choice([-1, 0, 0, 1], 200))
    (said,) = [
        f for f in check(file_of(tmp_path, "time,x", counts)).findings if f.remedy[:4] == "Give"
    ]
    assert said.severity == "warning"
    assert "step unevenly, by 19 to 21, as counts of milliseconds do" in said.text
    assert said.remedy == (
        "Give the unit with --map t=time:ms, or --map t=time:s where it counts seconds."
    )
    even = check(file_of(tmp_path, "time,x", 20 * np.arange(200)))
    assert not [f for f in even.findings if f.severity == "warning"]


def test_a_problem_file_keeps_the_unit_of_its_clock_and_doubts_an_assumed_one(
    tmp_path: Path,
) -> None:
    path = file_of(tmp_path, "Time,x", 0.5 * np.arange(60))
    assert any("no unit of time" in text for text in casid.new_problem(path).checks.values())
    found = casid.new_problem(path, "free", tmp_path / "run.py", mapping={"t": "Time:h"})
    assert not any("no unit of time" in text for text in found.checks.values())
    problem = casid.load_problem(tmp_path / "run.py")
    assert problem.read(path).record.Ts == pytest.approx(1800)


def test_an_estimate_says_that_seconds_were_assumed(tmp_path: Path) -> None:
    t = 0.5 * np.arange(60)
    path = tmp_path / "run.csv"
    noise = 0.01 * np.random.default_rng(2).standard_normal(60)
    rows = [f"{a},{x}" for a, x in zip(t, np.exp(-t / 7) + noise, strict=True)]
    path.write_text("\n".join(["Time,x", *rows]) + "\n")
    casid.new_problem(path, "free", tmp_path / "run.py")
    problem = casid.load_problem(tmp_path / "run.py")
    told = str(casid.identify(problem, problem.read(path)))
    assert "run: no unit of time: column 'Time' is read in seconds" in told
