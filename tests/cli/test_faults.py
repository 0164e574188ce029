"""What nobody should type, and files that nobody should have: an error at once, and no more.

Each of these once ended in a traceback, never ended, or left something half done.
"""

from __future__ import annotations

import contextlib
import errno
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
from click.testing import CliRunner, Result

from casid.cli.main import main
from problems import roll_decay
from tests.support.shared import ROOT

PROBLEM = """
import casid

m = casid.Model("oscillator")
x, v = m.state("x", "m"), m.state("v", "m/s")
F = m.input("F", "N", hold="zoh", known=True)
d = m.parameter("d", "N s/m", start=0.3, lower=0.0, upper=50.0)
M = m.constant("M", 1.0, "kg")
k = m.parameter("k", "N/m", start=3.0, lower=0.01, upper=100.0)
m.derivative(x, v)
m.balance(v, "force", inertia=M, terms=[F, -k * x, -d * v])
m.output("x", x, "m")
problem = casid.Problem("oscillator", m, channels={"F": "F [N]", "x": "x [m]"}, starts=1)
"""
T = 0.02 * np.arange(400)
FORCE = np.repeat(np.random.default_rng(0).normal(size=40), 10)


def motion() -> np.ndarray[Any, Any]:
    """Of a mass of 1 kg on 4 N/m with 0.5 N s/m, and noise of 1 mm."""
    x, v, out = 0.0, 0.0, np.empty(len(T))
    for i, force in enumerate(FORCE):
        out[i] = x
        v += 0.02 * (force - 4 * x - 0.5 * v)
        x += 0.02 * v
    return out + 1e-3 * np.random.default_rng(1).normal(size=len(T))


def write(path: Path, scale: float = 1.0, header: str = "t [s],F [N],x [m]") -> Path:
    rows = np.column_stack([T, scale * FORCE, scale * motion()]).tolist()
    path.write_text("\n".join([header, *(",".join(map(repr, row)) for row in rows)]) + "\n")
    return path


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with a problem and a record that fit."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "osc.py").write_text(PROBLEM)
    write(tmp_path / "run.csv")
    return tmp_path


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, list(arguments))


def refused(*arguments: str) -> str:
    """The message of a command that is refused, with no traceback."""
    result = run(*arguments)
    assert result.exit_code == 2, result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return " ".join(result.stderr.split())


# -- files ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("row", [2, 300], ids=["among the first lines", "further down"])
def test_a_cell_of_200_kB_is_named_by_its_line(folder: Path, row: int) -> None:
    lines = (folder / "run.csv").read_text().splitlines()
    lines[row] = lines[row].replace(",", "," + 200_000 * "a", 1)
    (folder / "run.csv").write_text("\n".join(lines))
    message = refused("identify", "osc.py", "run.csv")
    assert f"the first at line {row + 1}: 'aaaa" in message
    assert len(message) < 2000


def test_a_name_of_200_kB_is_no_name(folder: Path) -> None:
    write(folder / "run.csv", header=f"t [s],{200_000 * 'F'},x [m]")
    assert "a column is named by 200000 characters, 'FFFF" in refused("new", "run.csv")


def test_a_pipe_is_no_file(folder: Path) -> None:
    """It would be waited for, without end."""
    os.mkfifo(folder / "pipe.csv")
    message = "pipe.csv is a pipe or a device, which can be read once alone"
    assert message in refused("new", "pipe.csv")
    assert message in refused("identify", "osc.py", "pipe.csv")
    assert message in run("check", "pipe.csv").stdout.replace("\n", " ")
    assert "problem file pipe.csv is no file" in refused("identify", "pipe.csv", "run.csv")


@pytest.mark.parametrize("scale", [1e-160, 1e160])
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_values_whose_squares_are_no_numbers(folder: Path, scale: float, command: str) -> None:
    write(folder / "run.csv", scale)
    message = refused(command, "osc.py", "run.csv")
    assert "the largest value of channel" in message
    assert "=COLUMN:UNIT" in message


def test_values_far_from_one_are_fitted(folder: Path) -> None:
    write(folder / "run.csv", 1e-7)
    result = run("identify", "osc.py", "run.csv", "--json", "--quiet", "--out", "o")
    estimate = json.loads(result.stdout)["parameters"]
    assert estimate["k"]["value"] == pytest.approx(4.0, rel=0.05)


def test_control_characters_in_names_are_shown_and_not_obeyed(folder: Path) -> None:
    write(folder / "run.csv", header="t [s],\x1b[31mF [N],x\x1b]0;title\x07\u202e [m]")
    for result in (run("check", "run.csv"), run("identify", "osc.py", "run.csv")):
        assert r"\x1b[31mF" in result.output
        assert r"\x07\u202e" in result.output
        assert not set(result.output) & set("\x1b\x07\u202e")


# -- problem files --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "class Bad(BaseException): pass\nraise Bad('boom')",
            "problem file bad.py fails to load at line 2: Bad: boom",
        ),
        ("import casid\ncasid.Model(3)", "line 2: ModelError: the model: name 3 is no text"),
        ("import casid\ncasid.Model('a').state(5, 'm')", "state 5: name 5 is no text"),
        ("import casid\ncasid.Model('a').state('x', 1)", "a: 'x': unit 1 is no text"),
        ("import casid\ncasid.Model('a').input(None, 'm')", "name None is no text"),
        ("import casid\ncasid.Model('a').output(7, 1, 'm')", "output 7: name 7 is no text"),
        (
            "import casid\ncasid.Model('a').constant('g', 'm/s^2', 9.81)",
            "'m/s^2' and unit 9.81 seem to be swapped; write constant('g', 9.81, 'm/s^2')",
        ),
        (PROBLEM.replace('"oscillator", m', "9, m"), "problem 9: name 9 is no text"),
        (PROBLEM.replace('"F [N]"', "4"), "channels 4 is no text"),
        (
            PROBLEM.replace("starts=1", 'noise={"x": float("nan")}'),
            "noise of 'x' = nan is no standard deviation",
        ),
    ],
)
def test_a_problem_file_with_a_fault_is_refused_with_its_line(
    folder: Path, text: str, message: str
) -> None:
    (folder / "bad.py").write_text(text)
    assert message in refused("identify", "bad.py", "run.csv")


def test_a_problem_without_parameters_is_simulated_and_tested(folder: Path) -> None:
    """Nothing is estimated but the initial states; a diagnosis of it is in its room's tests."""
    text = PROBLEM.replace("m.parameter", "m.constant")
    text = text.replace('"N s/m", start=0.3, lower=0.0, upper=50.0', '0.5, "N s/m"')
    text = text.replace('"N/m", start=3.0, lower=0.01, upper=100.0', '4.0, "N/m"')
    (folder / "none.py").write_text(text)
    result = run("identify", "none.py", "run.csv", "--quiet")
    assert result.exit_code == 0, result.output
    assert "N/m                         4" in result.output
    structural = run("identifiability", "none.py", "run.csv", "--structural", "--quiet")
    assert "The model has no unknown parameters." in structural.output


# -- options --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["identify", "osc.py", "run.csv", "--segments", "100000"],
            "400 samples cannot be cut into 100000 segments, each of which has 2 initial states",
        ),
        (
            ["identify", "osc.py", "run.csv", "--method", "instruments", "--reference", "F"]
            + ["--lag", "nan"],
            "--lag nan: give a finite number of seconds",
        ),
        (["identify", "osc.py", "run.csv", "--resample", "1e-5"], "make 7.98e+05 samples of 400"),
        (["identify", "osc.py", "run.csv", "--resample", "1e-300"], "samples of 400"),
        (
            ["identifiability", "osc.py", "run.csv", "--replicas", "100000"],
            "there are 2 unknown parameters, and each replica determines one more at least",
        ),
        (["identifiability", "osc.py", "run.csv", "--time-limit", "nan"], "give a number of"),
        (["diagnose", "osc.py", "run.csv", "--budget", "nan"], "budget = nan s is no time"),
    ],
)
def test_an_option_out_of_all_proportion_is_refused(
    folder: Path, arguments: list[str], message: str
) -> None:
    assert message in refused(*arguments, "--out", "o")
    assert not (folder / "o").exists()


def test_300_states_are_answered_within_the_time_given(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CASID_TIME_FACTOR", "1")
    n = 300
    system = {
        "states": [f"x{i}" for i in range(n)],
        "params": [f"p{i}" for i in range(n)],
        "equations": {f"x{i}": f"-p{i}*x{i}+x{(i + 1) % n}" for i in range(n)},
        "outputs": {"y": "x0"},
    }
    (folder / "large.json").write_text(json.dumps(system))
    result = run("identifiability", "large.json", "--structural", "--time-limit", "0.5")
    assert result.exit_code == 0, result.output
    assert "Time ran out: 0 of 300 parameters are proven identifiable" in result.output


# -- processes and files --------------------------------------------------------------------------


def children(pid: int) -> set[int]:
    """All processes that a process has started, and those of theirs."""
    tree: dict[int, list[int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            name, _, rest = stat.read_text().rpartition(")")
            tree.setdefault(int(rest.split()[1]), []).append(int(name.split()[0]))
    found, new = set(), {pid}
    while new:
        found |= new
        new = {child for parent in new for child in tree.get(parent, [])} - found
    return found - {pid}


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are counted in /proc")
@pytest.mark.parametrize(
    "kind", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.slow)]
)
def test_workers_end_with_the_command(tmp_path: Path, kind: signal.Signals) -> None:
    command = [sys.executable, "-m", "casid", "montecarlo", roll_decay.__file__, "--runs", "9999"]
    command += ["--starts", "1", "--jobs", "2", "--out", str(tmp_path / "study")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, stderr=subprocess.PIPE, env=environment) as process:
        deadline = time.monotonic() + 600
        while len(workers := children(process.pid)) < 3 and time.monotonic() < deadline:
            time.sleep(0.2)  # two workers, and what keeps track of their memory
        time.sleep(1.0)
        process.send_signal(kind)
        said = process.communicate(timeout=600)[1].decode()
    assert process.returncode == 130
    assert "error: interrupted;" in said
    assert len(workers) >= 3
    gone = time.monotonic() + 600
    while any(Path(f"/proc/{w}").exists() for w in workers) and time.monotonic() < gone:
        time.sleep(0.2)
    assert not [w for w in workers if Path(f"/proc/{w}").exists()]


def test_more_jobs_than_cores_can_work_are_announced(folder: Path, capfd: Any) -> None:
    import joblib

    from casid.cli.terminal import workers

    with workers(100_000, None):
        used = joblib.parallel.get_active_backend()[1]
    assert used == 4 * joblib.cpu_count()
    assert f"--jobs 100000: {used} processes work, 4 for every core" in capfd.readouterr().err


@pytest.mark.parametrize(
    "full", ["report.html", pytest.param("result.casid", marks=pytest.mark.slow)]
)
def test_a_full_disk_leaves_the_results_of_one_run(
    folder: Path, monkeypatch: pytest.MonkeyPatch, full: str
) -> None:
    """The files of a run replace those of another together, or not at all."""
    assert run("identify", "osc.py", "run.csv", "--out", "o", "--quiet").exit_code == 0
    before = {p.name: p.read_bytes() for p in (folder / "o").iterdir()}
    assert set(before) == {"estimate.json", "report.html", "result.casid"}
    fdopen = os.fdopen

    def write(handle: int, *rest: Any) -> Any:
        if full in os.readlink(f"/proc/self/fd/{handle}"):
            os.close(handle)
            raise OSError(errno.ENOSPC, "No space left on device", full)
        return fdopen(handle, *rest)

    monkeypatch.setattr("os.fdopen", write)
    arguments = ["identify", "osc.py", "run.csv@0:5", "--out", "o", "--force", "--quiet"]
    assert "No space left on device" in refused(*arguments)
    assert {p.name: p.read_bytes() for p in (folder / "o").iterdir()} == before
    monkeypatch.setattr("os.fdopen", fdopen)
    assert run(*arguments).exit_code == 0
    after = {p.name: p.read_bytes() for p in (folder / "o").iterdir()}
    assert set(after) == set(before)
    assert all(after[name] != before[name] for name in before)
