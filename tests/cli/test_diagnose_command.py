"""`casid diagnose` as a user types it: several records, kinds left out, calibration, refusals."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from casid.data.record import Record
from problems import pendulum
from tests.cli.test_main import casid, refused
from tests.support.shared import ROOT

PENDULUM = str(ROOT / "problems" / "pendulum.py")
QUICK = ("--starts", "1", "--max-causes", "1", "--quiet", "--json")


def write(record: Record, path: str, **columns: Any) -> None:
    """A record as a CSV file, with further columns."""
    table = {"t": record.t, **record.channels, **columns}
    rows = zip(*(np.asarray(v).tolist() for v in table.values()), strict=True)
    text = "\n".join(",".join("" if x != x else f"{x:.9g}" for x in row) for row in rows)
    Path(path).write_text(",".join(table) + "\n" + text + "\n")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("records")
    back = Path.cwd()
    os.chdir(folder)
    try:
        for name, m, seed in (("nominal", 0.0, 1), ("loaded", 0.2, 2), ("other", 0.0, 3)):
            write(pendulum.simulate(duration=12.0, m=m, d_2=0.4, seed=seed), f"{name}.csv")
        write(pendulum.simulate(duration=8.0), "plain.csv")
    finally:
        os.chdir(back)
    return folder


@pytest.fixture(autouse=True)
def here(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for path in folder.iterdir():
        Path(path.name).symlink_to(path)


def answer(*arguments: str) -> dict[str, Any]:
    result = casid("diagnose", PENDULUM, *arguments, *QUICK)
    assert result.exit_code == 0, result.stderr
    assert result.stderr == ""
    return json.loads(result.stdout)  # and nothing else stands there


@pytest.mark.slow
def test_several_records_are_diagnosed_jointly_and_several_held_out_each_with_its_load_case() -> (
    None
):
    held = ("--hold-out", "other.csv@0:6", "--hold-out", "loaded=loaded.csv@6:12")
    d = answer("nominal=nominal.csv", "loaded=loaded.csv@0:6", *held)
    assert d["verdict"] == "deficient"
    assert d["causes"][0]["kind"] == "quadratic_damping"
    assert d["settings"]["fitted records"] == "nominal:nominal, loaded:loaded@0:6"
    assert d["settings"]["held out"] == "other@0:6, loaded:loaded@6:12"
    before, after = (d["held_out"][k]["gyro"] for k in ("baseline_rmse", "extended_rmse"))
    assert after < before
    assert Path("reports/pendulum-1/diagnosis.json").exists()


@pytest.mark.slow
def test_kinds_are_left_out_of_the_catalogue() -> None:
    d = answer("nominal.csv", "--without", "quadratic_damping", "--without", "parameter_jump")
    kinds = {row["kind"] for row in d["ranking"]}
    assert "coulomb_friction" in kinds
    assert not kinds & {"quadratic_damping", "parameter_jump"}


def test_the_help_tells_every_option_in_its_own_words() -> None:
    text = casid("diagnose", "--help").output
    for option in ("--calibrate [N]", "--false-alarm-rate", "--max-causes", "--without KIND"):
        assert option in text


@pytest.mark.slow
def test_a_calibration_from_the_command_line_stands_in_the_json() -> None:
    d = answer("plain.csv", "--calibrate", "3", "--jobs", "1")
    assert d["calibration"]["runs"] == 3
    assert d["calibration"]["threshold"] == 0.05
    assert "3 null records (this one simulated" in d["calibration"]["sentence"]


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Ctrl-C is another signal there")
def test_ctrl_c_ends_the_calibration_and_not_the_diagnosis() -> None:
    command = [sys.executable, "-m", "casid", "diagnose", PENDULUM, "plain.csv", "--starts", "1"]
    command += ["--max-causes", "1", "--calibrate", "500", "--jobs", "1"]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if "one null record took" in line:
                break
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        said = process.stderr.read()
        assert process.stdout is not None
        assert process.stdout.read().startswith("Diagnosis of pendulum")
    assert process.returncode == 0
    assert "the diagnosis continues with" in said
    assert "of 500 null records" in said
    assert "Traceback" not in said
    found = json.loads(Path("reports/pendulum-1/diagnosis.json").read_text())["calibration"]
    assert found["is_interrupted"]
    assert 1 <= found["runs"] < found["asked"] == 500
    assert Path("reports/pendulum-1/report.html").exists()


# -- refusals -------------------------------------------------------------------------------------

REFUSALS: dict[str, tuple[list[str], list[str]]] = {
    "no such kind": (["--without", "ofset"], ["'ofset'", "did you mean 'offset'?"]),
    "no rate": (["--false-alarm-rate", "1.5"], ["between 0 and 1", "--false-alarm-rate 0.05"]),
    "a negative number of records": (["--calibrate", "-3"], ["'-3'", "--help"]),
    "no records": (["--calibrate", "0"], ["'0'", "--calibrate 200"]),
    "jobs for nothing": (["--jobs", "2"], ["--jobs belongs to --calibrate"]),
    "two channels of one column": (
        ["--map", "accel=gyro"],
        ["accel", "gyro", "would both be column 'gyro'", "another column"],
    ),
    "a channel twice": (
        ["--map", "gyro=yaw_rate", "--map", "gyro=gyro"],
        ["'gyro' twice", "keep one"],
    ),
    "a channel of the clock": (
        ["--map", "gyro=t:s"],
        ["gyro and the time stamps", "--map t=COLUMN"],
    ),
    "a share beyond the record": (["--hold-out", "-0.2"], ["between 0", "0.9", "name a file"]),
}


@pytest.mark.parametrize("fault", REFUSALS)
def test_what_cannot_be_meant_is_refused_with_the_mend(fault: str) -> None:
    options, words = REFUSALS[fault]
    refused(casid("diagnose", PENDULUM, "plain.csv", *options), *words)


def test_calibrate_before_the_problem_says_where_it_belongs() -> None:
    text = refused(casid("diagnose", "--calibrate", PENDULUM, "plain.csv"), "behind the data")
    assert "pendulum.py" in text


@pytest.mark.slow
def test_a_channel_of_a_slower_clock_counts_at_its_instants_or_is_left_out_with_a_note() -> None:
    """Every other sample of the gyro is enough for it; a recorded channel has to be complete."""
    record = pendulum.simulate(duration=8.0)
    half = np.array(record["gyro"])
    half[1::2] = np.nan
    slow = np.full(record.N, np.nan)
    slow[::20] = 1.0 + 0.1 * np.arange(len(slow[::20]))
    write(record, "slow.csv", gyro=half, speed=slow)
    d = answer("slow.csv")
    assert {row["where"] for row in d["ranking"]} & {"torque", "gyro"}
    assert not any("speed" in row["where"] for row in d["ranking"])
    assert any("column 'speed' has a value in one row of 20 alone" in s for s in d["provenance"])


def test_an_effect_of_the_user_without_a_null_value_is_refused() -> None:
    text = (ROOT / "problems" / "pendulum.py").read_text()
    Path("mine.py").write_text(
        text + "\neffect = casid.Effect(\n"
        "    'my_drag', 'torque', (casid.Parameter('c', 'N m s/rad', 0.0),),\n"
        "    lambda m, names: m.add_term(\n"
        "        'torque', (m.symbol('d') + m.symbol(names[0])) * m.symbol('p')\n"
        "    ),\n"
        ")\nproblem = dataclasses.replace(problem, effects=[effect])\n"
    )
    refused(casid("diagnose", "mine.py", "plain.csv"), "my_drag", "null value")


def test_the_default_solver_is_left_to_the_library_that_tunes_it() -> None:
    """Ipopt from its own large barrier would leave the minimum that a refit starts beside."""
    from casid.cli.options import DEFAULT_SOLVER, FitOptions

    assert FitOptions(None, DEFAULT_SOLVER, 0).own_solver() is None
    other = FitOptions(None, "sqpmethod", 0).own_solver()
    assert other is not None
    assert other.name == "sqpmethod"
