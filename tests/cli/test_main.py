"""The command line: what it writes, where it speaks, and how it refuses."""

from __future__ import annotations

import json
import os
import re
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
from casid.cli.request import Request, parse_mapping, parse_setting
from casid.errors import DataError
from tests.support.shared import ROOT
from tests.support.truth import TruthRecord, mass_spring_damper, write_csv

MASS = """\
import casid

m = casid.Model("mass on a spring")
x, v = m.state("x", "m"), m.state("v", "m/s")
F = m.input("force", "N", hold="zoh")
M = m.parameter("m", "kg", start=1.5, lower=0.1, upper=20)
d = m.parameter("d", "N s/m", start=1.0, lower=0.0, upper=50)
k = m.parameter("k", "N/m", start=40.0, lower=1.0, upper=500)
m.derivative(x, v)
m.balance(v, "force", inertia=M, terms=[-k * x, -d * v, F])
m.output("position", x, "m")
problem = casid.Problem(
    "mass", m, load_cases={"heavy": {"m": 2.5}}, recorded={"wind": "m/s"}, starts=1
)
"""


@pytest.fixture(scope="module")
def truth() -> TruthRecord:
    return mass_spring_damper(duration=12.0, Ts=0.02, seed=3)


@pytest.fixture
def here(tmp_path: Path, truth: TruthRecord, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a problem, `mass.py`, and a record of it, `run.csv`."""
    monkeypatch.chdir(tmp_path)
    Path("mass.py").write_text(MASS)
    write_csv(truth, "run.csv")
    return tmp_path


def casid(*arguments: str) -> Result:
    result = CliRunner().invoke(main, list(arguments))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception  # a traceback: a fault of casid
    return result


def process(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **options.pop("env", {})}
    return subprocess.run(
        [sys.executable, "-m", "casid", *arguments],
        capture_output=True,
        text=True,
        timeout=6000,
        env=environment,
        **options,
    )


def refused(result: Result, *words: str) -> str:
    """The message of a refusal, which names `words`, and nothing else stands anywhere."""
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    messages = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert len(messages) == 1
    text = result.stderr[result.stderr.index("error: ") :]
    assert "Traceback" not in text
    for word in words:
        assert word in text
    assert not Path("reports").exists()
    return text


def rewrite(source: str, target: str, change: Any) -> None:
    """Write `target`: the rows of `source` after `change` (header, rows of text)."""
    header, *rows = (line.split(",") for line in Path(source).read_text().splitlines())
    header, rows = change(header, rows)
    Path(target).write_text("\n".join(",".join(row) for row in [header, *rows]) + "\n")


# ---------------------------------------------------------------------- what the commands do


def test_identify_finds_the_parameters_of_an_independent_simulator(
    here: Path, truth: TruthRecord
) -> None:
    """Simulation error with the model in the set is consistent (Ljung 1999, ch. 8)."""
    result = casid("identify", "mass.py", "run.csv", "--json", "--quiet")
    assert result.exit_code == 0
    assert result.stderr == ""
    estimate = json.loads(result.stdout)
    assert estimate["schema"] == "casid.estimate/1"
    for name, value in truth.truth.items():
        if name in estimate["parameters"]:
            found = estimate["parameters"][name]
            # Four standard errors, and 1 % for the noise of the measured force: it biases.
            assert abs(found["value"] - value) < 4 * found["std_error"] + 0.01 * value
            assert found["unit"] == {"m": "kg", "d": "N s/m", "k": "N/m"}[name]
    written = json.loads((here / "reports/mass-1/estimate.json").read_text())
    assert written == estimate
    assert "<html" in (here / "reports/mass-1/report.html").read_text()


def test_diagnose_writes_both_files_says_where_and_prints_the_diagnosis(here: Path) -> None:
    result = casid("diagnose", "mass.py", "run.csv", "--out", "found")
    assert result.exit_code == 0
    assert result.stdout.startswith("Diagnosis of mass: ")
    assert "found" in result.stderr.splitlines()[-1]
    diagnosis = json.loads(Path("found/diagnosis.json").read_text())
    assert diagnosis["schema"] == "casid.diagnosis/1"
    assert diagnosis["verdict"] in {"adequate", "deficient", "undecided"}
    assert diagnosis["held_out"]["baseline_rmse"].keys() == {"position"}
    assert sorted(p.name for p in Path("found").iterdir()) == [
        "diagnosis.json",
        "report.html",
        "result.casid",
    ]


def test_a_problem_without_data_uses_its_own_example(here: Path) -> None:
    Path("example.py").write_text(
        MASS.replace("starts=1", "starts=1, example=lambda: [mass_experiment()]")
        + "\ndef mass_experiment():\n"
        "    record = casid.read_record('run.csv', {'force': ('force', 'N'),"
        " 'position': ('position', 'm')})\n"
        "    return casid.Experiment(record)\n"
    )
    result = casid("identify", "example.py", "--json", "--quiet", "--detrend", "--decimate", "2")
    assert result.exit_code == 0
    provenance = " ".join(json.loads(result.stdout)["provenance"])
    assert provenance.index("decimated: 1 in 2") < provenance.index("mean subtracted")


def test_a_problem_without_data_or_example_asks_for_a_record(here: Path) -> None:
    refused(casid("identify", "mass.py"), "no example", "data.csv")


def test_check_reports_and_says_usable(here: Path) -> None:
    result = casid("check", "run.csv", "--problem", "mass.py")
    assert result.exit_code == 0
    assert result.stdout.startswith("Check of run")
    report = json.loads(casid("check", "run.csv", "--json").stdout)
    assert report["schema"] == "casid.check/1"
    assert report["usable"]
    both = json.loads(casid("check", "run.csv@0:6", "run.csv@6:", "--json").stdout)
    assert [r["N"] for r in both] == [301, 301]


def test_check_refuses_a_problem_file_in_the_place_of_a_record(here: Path) -> None:
    result = casid("check", "problem.py", "run.csv@1:", "--sample-time", "0.01")
    refused(
        result,
        "problem.py is a problem file, and no record; casid check takes it by --problem",
        "casid check run.csv@1: --problem problem.py",
    )


def test_check_of_an_unusable_file_is_still_a_whole_report(here: Path) -> None:
    rewrite("run.csv", "bad.csv", lambda h, r: (h, r[:100] + r[90:]))
    result = casid("check", "bad.csv", "--json")
    assert result.exit_code == 2
    assert not json.loads(result.stdout)["usable"]
    assert result.stderr.startswith("error: cannot be used: bad.csv")
    assert casid("check", "absent.csv").exit_code == 2


@pytest.mark.slow
def test_units_windows_cases_and_known_values_reach_the_estimate(
    here: Path, truth: TruthRecord
) -> None:
    """Millimetres in the file are metres in the model; a known mass is not estimated."""
    rewrite(
        "run.csv",
        "mm.csv",
        lambda h, rows: (["clock", "F", "pos"], [[a, b, str(1e3 * float(c))] for a, b, c in rows]),
    )
    maps = ["--map", "position=pos:mm", "--map", "force=F", "--map", "t=clock"]
    m = f"m={truth.truth['m']!r}"
    plain = casid("identify", "mass.py", "run.csv@0:8", "--json", "--set", m, "--quiet")
    mapped = casid(
        "identify", "mass.py", "mm.csv", *maps, "--window", "0:8", "--json", "--set", m, "--quiet"
    )
    assert plain.exit_code == mapped.exit_code == 0
    first, second = (json.loads(r.stdout)["parameters"] for r in (plain, mapped))
    assert first["m"]["known"]
    # The files agree to nine digits; Ipopt stops within its own tolerance of 1e-9.
    assert second["k"]["value"] == pytest.approx(first["k"]["value"], rel=1e-6)
    case = json.loads(casid("identify", "mass.py", "heavy=run.csv", "--json").stdout)
    # Only k/m is known of an unforced system; the force fixes k: the load case moves nothing else.
    assert "m" not in case["parameters"] or case["parameters"]["m"]["known"]


def test_the_window_is_not_for_the_held_out_file(here: Path) -> None:
    result = casid(
        "identify", "mass.py", "run.csv", "--window", "0:6", "--hold-out", "run.csv@6.01:11.9",
        "--json", "--quiet",
    )  # fmt: skip
    assert result.exit_code == 0
    fit = json.loads(result.stdout)["fit"]
    assert list(fit["rmse"]) == ["run@0:6"]
    assert list(fit["held_out_rmse"]) == ["run@6.01:11.9"]


def test_default_folders_are_counted_and_a_full_one_needs_force(here: Path) -> None:
    run = ("identify", "mass.py", "run.csv", "--quiet")
    for n in (1, 2):
        assert casid(*run).exit_code == 0
        assert Path(f"reports/mass-{n}/estimate.json").exists()
    text = casid(*run, "--out", "reports/mass-1")
    assert text.exit_code == 2
    assert "not empty" in text.stderr
    assert "--force" in text.stderr
    before = Path("reports/mass-1/estimate.json").stat().st_mtime_ns
    assert casid(*run, "--out", "reports/mass-1", "--force").exit_code == 0
    assert Path("reports/mass-1/estimate.json").stat().st_mtime_ns > before
    Path("empty").mkdir()
    assert casid(*run, "--out", "empty").exit_code == 0


def test_what_a_problem_file_prints_does_not_spoil_the_json(here: Path) -> None:
    Path("loud.py").write_text("print('hello')\n" + MASS)
    result = casid("identify", "loud.py", "run.csv", "--json")
    assert json.loads(result.stdout)["schema"] == "casid.estimate/1"
    assert "hello" in result.stderr


# ---------------------------------------------------------------------- refusals: the file


def repeated(n: int, value: str) -> Any:
    def change(header: list[str], rows: list[list[str]]) -> Any:
        rows[n][2] = value
        return header, rows

    return change


def irregular(header: list[str], rows: list[list[str]]) -> Any:
    rng = np.random.default_rng(3)
    for row in rows:
        row[0] = f"{float(row[0]) + 0.004 * rng.random():.6f}"
    return header, rows


def constant(header: list[str], rows: list[list[str]]) -> Any:
    return header, [[row[0], "0", row[2]] for row in rows]


BAD_FILES = {
    "text in a number column": (repeated(40, "n/a?"), ["position", "line 42", "n/a?"]),
    "Inf": (repeated(40, "inf"), ["position", "line 42", "window"]),
    "no such column": (
        lambda h, r: (["t", "force", "positoin"], r),
        ["'position'", "did you mean 'positoin'?", "--map position=positoin"],
    ),
    "doubled stamps": (
        lambda h, r: (h, [*r[:100], [r[99][0], *r[100][1:]], *r[100:]]),
        ["duplicate", "drop doubled rows"],
    ),
    "backward stamps": (lambda h, r: (h, r[:100] + r[50:]), ["backward", "Sort the file"]),
    "too short": (lambda h, r: (h, r[:4]), ["too short", "are too few for", "samples"]),
    "header alone": (lambda h, r: (h, []), ["no samples", "another file"]),
    "a broken row": (
        lambda h, r: (h, [*r[:50], [*r[50], "7", "8"], *r[51:]]),
        ["line 52", "header"],
    ),
}


@pytest.mark.parametrize("command", ["identify", "diagnose"])
@pytest.mark.parametrize("fault", BAD_FILES)
def test_a_file_that_cannot_be_used_is_refused_with_the_mend(
    here: Path, command: str, fault: str
) -> None:
    change, words = BAD_FILES[fault]
    rewrite("run.csv", "bad.csv", change)
    text = refused(casid(command, "mass.py", "bad.csv", "--out", "new"))
    assert "bad" in text
    found = [word for word in words if word.casefold() in text.casefold()]
    if fault == "too short":
        assert found, text
    else:
        assert found == words, text
    assert not Path("new").exists()


def test_files_that_are_none_are_refused(here: Path) -> None:
    Path("empty.csv").touch()
    Path("folder").mkdir()
    Path("binary.csv").write_bytes(b"\x00\x01\x02" * 100)
    refused(casid("identify", "mass.py"), "name a record behind the problem: mass.py data.csv")
    refused(casid("identify", "mass.py", "rum.csv"), "did you mean 'run.csv'?".capitalize()[1:])
    refused(casid("identify", "mass.py", "empty.csv"), "the file is empty", "Export")
    refused(casid("identify", "mass.py", "folder"), "is a folder", "CSV")
    refused(casid("identify", "mass.py", "binary.csv"), "not a text file", "Parquet")
    refused(casid("identify", "mass.py", "run.csv@20:30"), "20:30", "0 to 12 s")
    refused(casid("identify", "mass.py", "run.csv", "--resample", "0"), "resample", "positive")


def test_an_input_that_never_moves_is_refused_or_undecided(here: Path) -> None:
    """Without force only k/m and d/m are known: in m x'' + d x' + k x = F the mass has no scale."""
    rewrite("run.csv", "still.csv", constant)
    refused(casid("identify", "mass.py", "still.csv"), "rank", "m/k", "is constant", "mapping")
    result = casid("diagnose", "mass.py", "still.csv", "--json")
    if result.exit_code == 0:
        assert json.loads(result.stdout)["verdict"] == "undecided"
    else:
        refused(result, "rank", "m/k")


# ---------------------------------------------------------------------- refusals: the options


BAD_OPTIONS: dict[str, tuple[list[str], list[str]]] = {
    "unit of another dimension": (["--map", "position=position:s"], ["position", "'s'"]),
    "ambiguous unit": (["--map", "position=position:mil"], ["mil"]),
    "unknown unit": (["--map", "position=position:metrs"], ["metrs"]),
    "no such signal": (["--map", "positon=position"], ["'positon'", "did you mean 'position'?"]),
    "no such column": (["--map", "force=forze"], ["'forze'", "Did you mean 'force'?"]),
    "not a mapping": (["--map", "position"], ["signal=column", "--map phi=roll:deg"]),
    "mapped twice": (
        ["--map", "force=force", "--map", "force=position"],
        ["'force' twice", "keep one"],
    ),
    "no such parameter": (["--set", "mm=2"], ["'mm'", "did you mean 'm'?"]),
    "not a number": (["--set", "m=two"], ["name=value", "in the unit"]),
    "not finite": (["--set", "m=nan"], ["finite"]),
    "outside the bounds": (["--set", "k=-50"], ["bounds of k", "1 to 500 N/m", "widen"]),
    "set twice": (["--set", "m=2", "--set", "m=3"], ["twice", "keep one"]),
    "window backward": (["--window", "9:3"], ["backward", "earlier"]),
    "window of words": (["--window", "start:end"], ["12:194"]),
    "share too large": (["--hold-out", "30"], ["30", "0.3"]),
    "share not a number": (["--hold-out", "nan"], ["0.3"]),
    "share and file": (["--hold-out", "0.2", "--hold-out", "run.csv"], ["contradict"]),
    "held out what is fitted": (["--hold-out", "run.csv@3:5"], ["given twice", "run.csv@0:40"]),
    "no such held-out file": (["--hold-out", "rub.csv"], ["no such file", "'run.csv'"]),
    "no such solver": (["--solver", "snopt9"], ["'snopt9'", "ipopt"]),
    "no starts": (["--starts", "0"], ["--starts", "x>=1"]),
    "decimated away": (["--decimate", "500"], ["samples"]),
    "cut-off beyond Nyquist": (["--lowpass", "80"], ["cut-off", "25 Hz"]),
    "no such option": (["--frce"], ["--frce", "--force", "--help"]),
    "out is a file": (["--out", "run.csv"], ["is a file", "--out"]),
    "out below a file": (["--out", "run.csv/new"], ["run.csv", "--out"]),
}


@pytest.mark.parametrize("fault", BAD_OPTIONS)
def test_options_that_cannot_be_meant_are_refused_with_the_mend(here: Path, fault: str) -> None:
    options, words = BAD_OPTIONS[fault]
    before = sorted(Path().iterdir())
    refused(casid("identify", "mass.py", "run.csv", *options), *words)
    assert sorted(Path().iterdir()) == before


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "every sample counts at its own instant"),
        (("--resample", "0.02"), "resampled by PCHIP"),
    ],
)
def test_an_irregular_clock_is_taken_as_it_is_or_resampled_on_request(
    here: Path, truth: TruthRecord, options: tuple[str, ...], said: str
) -> None:
    """The provenance says which."""
    rewrite("run.csv", "bad.csv", irregular)
    result = casid("identify", "mass.py", "bad.csv", *options, "--json", "--quiet")
    estimate = json.loads(result.stdout)
    assert any(said in line for line in estimate["provenance"])
    # Stamps late by 2 ms on average in a period of 1 s: 1 % of phase at most.
    assert estimate["parameters"]["k"]["value"] == pytest.approx(truth.truth["k"], rel=0.05)


def test_one_record_counts_once(here: Path) -> None:
    text = refused(casid("identify", "mass.py", "run.csv@0:8", "run.csv@6:"), "given twice")
    assert "run.csv@0:40" in text
    assert casid("identify", "mass.py", "run.csv@0:6", "run.csv@6.01:").exit_code == 0


def test_load_cases_are_the_problems_and_not_contradicted(here: Path) -> None:
    refused(casid("identify", "mass.py", "heavi=run.csv"), "did you mean 'heavy'?")
    refused(casid("identify", "mass.py", "heavy=run.csv", "--set", "m=2"), "contradicts", "'heavy'")


def test_options_about_a_file_need_one(here: Path) -> None:
    for option in (["--map", "force=F"], ["--window", "1:2"], ["--resample", "0.1"]):
        refused(casid("identify", "mass.py", *option), option[0], "none is given", "leave")


def test_false_alarm_rates_are_between_none_and_all(here: Path) -> None:
    run = ("diagnose", "mass.py", "run.csv")
    for rate in ("1", "0", "-0.1", "nan"):
        refused(casid(*run, "--false-alarm-rate", rate), "between 0 and 1", "0.05")
    refused(casid(*run, "--max-causes", "0"), "x>=1")


# ---------------------------------------------------------------------- refusals: the problem


BAD_PROBLEMS: dict[str, tuple[str, str, list[str]]] = {
    "start outside its bounds": (
        "start=1.5, lower=0.1",
        "start=1.5, lower=2.0",
        ["line 6", "start 1.5", "move the start"],
    ),
    "a fault in the file": ("-k * x", "-k * y", ["line 10", "'y'"]),
    "not Python": ("F = m.input(", "F = = m.input(", ["line 5"]),
    "no problem": ("problem = casid", "probelm = casid", ["defines no `problem`", "rename"]),
    "units that do not add up": (
        '"k", "N/m"',
        '"k", "N/kg"',
        ["m^2/s^2", "correct the expression"],
    ),
    "an end of the program": ("import casid\n", "import casid, sys\nsys.exit(3)\n", ["exit"]),
    "a simulation that runs away": (
        "[-k * x, -d * v, F]",
        "[1e4 * k * x, 1e3 * d * v, F]",
        ["diverges", "start"],
    ),
    "an unidentifiable parameter": (
        'm.output("position", x, "m")',
        's = m.parameter("s", "1", start=1.2)\nm.output("position", s * x, "m")',
        ["rank", "known"],
    ),
}


@pytest.mark.parametrize("fault", BAD_PROBLEMS)
def test_a_problem_that_cannot_be_used_is_refused_with_the_place(here: Path, fault: str) -> None:
    old, new, words = BAD_PROBLEMS[fault]
    assert old in MASS
    Path("bad.py").write_text(MASS.replace(old, new))
    refused(casid("identify", "bad.py", "run.csv"), *words)


def test_what_is_identifiable_is_named_with_what_is_not(here: Path) -> None:
    """In m x'' + d x' + k x = F and y = s x only d/m, k/m and s/m are identifiable."""
    old, new, _ = BAD_PROBLEMS["an unidentifiable parameter"]
    Path("bad.py").write_text(MASS.replace(old, new))
    text = refused(casid("identify", "bad.py", "run.csv"))
    assert re.search(r"\b[dkms]/[dkms]\b", text), text


def test_problem_files_that_are_none_are_refused(here: Path) -> None:
    refused(casid("identify", "mas.py", "run.csv"), "does not exist", "'mass.py'")
    refused(casid("identify", "run.csv"), "not a problem file", "Python")
    refused(casid("identify"), "PROBLEM", "--help")
    refused(casid("identfy", "mass.py"), "did you mean 'identify'?")


# ---------------------------------------------------------------------- as a process


def test_no_command_prints_the_help() -> None:
    result = casid()
    assert result.exit_code == 0
    assert "diagnose" in result.stdout
    assert casid("--version").stdout.startswith("casid ")


def test_a_terminal_without_umlauts_gets_escapes(here: Path) -> None:
    Path("masse_größe.py").write_text(MASS.replace('"mass"', '"Maß"'), encoding="utf-8")
    done = process(
        "identify", "masse_größe.py", "run.csv", cwd=here, env={"PYTHONIOENCODING": "ascii"}
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(r"Estimate of Ma\xdf")
    assert (here / "reports" / "Maß-1" / "estimate.json").exists()


def test_a_reader_that_goes_away_is_no_error(here: Path) -> None:
    """As in `casid check run.csv --json | head`: the pipe is closed before it is written."""
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as closed:
        done = subprocess.run(
            [sys.executable, "-m", "casid", "check", *["run.csv"] * 20],
            cwd=here,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=closed,
            stderr=subprocess.PIPE,
            text=True,
            timeout=600,
        )
    assert done.returncode == 0
    assert done.stderr == ""


def started(here: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "casid", *arguments],
        cwd=here,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_an_interrupted_command_says_so_and_leaves_nothing(here: Path) -> None:
    Path("slow.py").write_text(
        MASS + "\nimport time\nclass Slow:\n    pass\n"
        "def example():\n    import sys\n    print('waiting', flush=True)\n    time.sleep(60)\n"
        "import dataclasses\nproblem = dataclasses.replace(problem, example=example)\n"
    )
    running = started(here, "identify", "slow.py")
    assert running.stderr is not None
    assert running.stderr.readline().strip() == "waiting"
    running.send_signal(signal.SIGINT)
    stdout, stderr = running.communicate(timeout=600)
    assert running.returncode == 130
    assert stdout == ""
    assert "error: interrupted" in stderr
    assert "Traceback" not in stderr
    assert not (here / "reports").exists()


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize(
    ("command", "after"),
    [
        ("identify", 0.29),
        pytest.param("identify", 0.0, marks=pytest.mark.slow),
        pytest.param("diagnose", 0.13, marks=pytest.mark.slow),
        pytest.param("diagnose", 0.61, marks=pytest.mark.slow),
    ],
)
def test_a_fit_ends_at_ctrl_c_wherever_it_is(here: Path, command: str, after: float) -> None:
    """CasADi's solvers take it for a failed evaluation, and a million starts would go on."""
    running = started(here, command, "mass.py", "run.csv", "--starts", "1000000")
    assert running.stderr is not None
    while not (line := running.stderr.readline()).startswith("fit "):
        assert line, "the command ended before its fit"
    time.sleep(after)  # anywhere in the fit
    running.send_signal(signal.SIGINT)
    try:
        stdout, stderr = running.communicate(timeout=600)
    finally:
        running.kill()
    assert running.returncode == 130
    assert stdout == ""
    said = [line for line in stderr.splitlines() if line and not line.startswith("fit ")]
    assert said[-1:] == ["error: interrupted; nothing was written"]
    assert not any("Traceback" in line or "CasADi" in line for line in said)
    assert not (here / "reports").exists()


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root writes anywhere")
def test_a_folder_that_cannot_be_written_is_refused(here: Path) -> None:
    Path("locked").mkdir(mode=0o500)
    refused(casid("identify", "mass.py", "run.csv", "--out", "locked"), "locked", "--out")


# ---------------------------------------------------------------------- instruments


PENDULUM = str(ROOT / "problems" / "pendulum.py")
BY_INSTRUMENTS = ("--method", "instruments", "--reference", "ref", "--lag", "0.1", "--quiet")


@pytest.fixture
def pendulum(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Two records of the pendulum as experiments, and as files `nominal.csv` and `loaded.csv`."""
    from problems.pendulum import experiments

    monkeypatch.chdir(tmp_path)
    made = experiments(duration=60.0)
    for e in made:
        r = e.record
        columns = np.column_stack([r.t, *(r[name] for name in ("gyro", "accel", "ref"))])
        header = "t,gyro,accel,ref"
        np.savetxt(f"{e.name}.csv", columns, "%.17g", ",", header=header, comments="")
    return made


def test_identify_by_instruments_is_the_call_of_the_library(pendulum: list[Any]) -> None:
    """Files with 17 digits hold the same numbers, and the same numbers give the same estimate."""
    from casid.estimation.moments.instruments.instruments import Instruments
    from casid.estimation.moments.instruments.reference_filter import ReferenceFilter
    from casid.identification.moment_estimators import instrumental_variables
    from problems.pendulum import indirect_model

    free = ("--free", "I_x,d,m=0.1,z_m", "--set", "k=10.39")
    files = ("nominal=nominal.csv", "loaded.csv")
    result = casid("identify", PENDULUM, *files, *BY_INSTRUMENTS, *free, "--json", "--out", "o")
    assert result.exit_code == 0, result.stderr
    model = indirect_model().with_known(k=10.39).with_unknown("I_x", "d", "z_m", m=0.1)
    expected = instrumental_variables(
        model, pendulum, Instruments("ref", ReferenceFilter.lag(0.1)), free=("I_x", "d", "m", "z_m")
    )
    found = json.loads(result.stdout)
    for name in expected.names:
        row = found["parameters"][name]
        assert row["value"] == pytest.approx(expected[name], rel=1e-6)
        assert row["std_error"] == pytest.approx(expected.std_error(name), rel=1e-4)
    assert found["overidentification"]["degrees_of_freedom"] == expected.propagated.degrees
    assert json.loads(Path("o/estimate.json").read_text()) == found
    page = Path("o/report.html").read_text()
    assert "instrumental variables, joint, eliminated form" in page
    assert "Measured outputs and free simulation; choose one of 2 records below the figure" in page
    assert "only its initial state is fitted" in page
    nominal = casid("identify", PENDULUM, "nominal=nominal.csv", *BY_INSTRUMENTS, "--out", "n")
    assert re.search(r"^  k .*\n  d .*\n  I_x ", nominal.stdout, re.MULTILINE)  # the unknown ones


def test_instruments_that_cannot_be_meant_are_refused_with_the_mend(pendulum: list[Any]) -> None:
    one = ("identify", PENDULUM, "nominal=nominal.csv")
    iv = (*one, *BY_INSTRUMENTS)
    for arguments, words in {
        (*one, "--method", "instruments"): ("no disturbance reaches", "--reference ref"),
        (*one, "--lag", "0.1"): ("--lag belongs to instruments", "add --method instruments"),
        (*iv, "--reference", "rf"): ("did you mean 'ref'?", "recorded={'rf': unit}"),
        (*iv, "--starts", "3"): ("--starts has no meaning", "leave --starts out"),
        (*iv, "--hold-out", "0.2"): ("leave --hold-out out",),
        (*iv, "--segments", "2"): ("leave --segments out",),
        (*iv, "--own", "d"): ("leave --own out",),
        (*iv, "--free", "mass"): ("no parameter 'mass'", "known are: I_x"),
        (*iv, "--free", "d=x"): ("NAME=START",),
        (*iv, "--free", "m"): ("its known value is 0", "--free m=0.1"),
        (*iv, "--free", "d=0.1", "--set", "d=0.1"): ("contradict", "leave one of them out"),
        (*iv, "--free", "k,d"): ("leaves out I_x", "--set I_x="),
        (*iv, "loaded=loaded.csv", "--free", "k,d,I_x,m=0.1"): ("without its load case", "b.csv"),
    }.items():
        refused(casid(*arguments), *words)


def test_every_record_has_its_own_of_what_the_command_line_says(here: Path) -> None:
    halves = ("identify", "mass.py", "run.csv@0:6", "run.csv@6:12", "--json", "--quiet")
    refused(casid(*halves, "--own", "e"), "'e'")
    refused(casid(*halves, "--own", "d", "--set", "d=1"), "its known value is 1", "leave it out")
    found = json.loads(casid(*halves, "--own", " d, ").stdout)["parameters"]
    owned = [name for name in found if name.startswith("d@")]
    assert len(owned) == 2
    assert "d" not in found
    assert "k" in found


# ---------------------------------------------------------------------- the parts


def test_a_mapping_is_signal_column_and_perhaps_unit() -> None:
    assert parse_mapping("phi=roll:deg") == ("phi", "roll", "deg")
    assert parse_mapping("gyro=a=b") == ("gyro", "a=b", None)
    assert parse_setting("M=22.04") == ("M", 22.04)
    for text in ("phi=roll:", "=roll", "phi=", ""):
        with pytest.raises(DataError, match="--map phi=roll:deg"):
            parse_mapping(text)


def test_preparation_has_one_order(truth: TruthRecord) -> None:
    from casid.data.record import Record

    columns = {k: v for k, v in truth.columns.items() if k != "t"}
    record = Record(columns, {k: truth.units[k] for k in columns}, truth.Ts)
    request = Request(data=["x.csv"], lowpass=5.0, decimate=2, detrend=True)
    steps = request.prepare(record).provenance
    order = [next(i for i, s in enumerate(steps) if w in s) for w in ("5 Hz", "1 in 2 k", "mean")]
    assert order == sorted(order)
    assert Request(data=["x.csv"]).prepare(record) is record
