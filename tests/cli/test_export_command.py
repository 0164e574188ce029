"""`casid export`: a saved result taken away in each form."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from numpy.testing import assert_allclose

import casid
from casid.cli.main import main
from casid.compiler import compiler
from problems import roll_decay
from tests.support.fitted_models import delayed_pendulum, extended_emps, extended_pendulum


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["export", *map(str, arguments)])


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The extended pendulum as a saved model."""
    return extended_pendulum().save(tmp_path_factory.mktemp("saved") / "pendulum.casid")


@pytest.mark.parametrize(
    ("target", "ending", "words"),
    [
        ("problem", ".py", "quadratic damping in the torque balance, found by the diagnosis"),
        ("casadi", ".casadi", ""),
        ("c", ".c", "model_c_step"),
        ("control", ".py", "control.StateSpace"),
        ("modelica", ".mo", "model model_modelica"),
        ("fmu", ".fmu", ""),
    ],
)
def test_every_target_is_written(
    saved: Path, tmp_path: Path, target: str, ending: str, words: str
) -> None:
    if target == "fmu" and compiler() is None:
        pytest.skip("no C compiler is found here")
    result = run(saved, "--as", target, "--out", tmp_path / f"model_{target}")
    assert result.exit_code == 0, result.output
    written = tmp_path / f"model_{target}{ending}"
    assert f"wrote {written}" in result.output
    assert words in written.read_text("utf-8", "ignore")


def test_a_folder_of_identify_is_exported(tmp_path: Path) -> None:
    """From the command line: identify, export as a problem, and the same fit again."""
    # Without drag: the spectrum that would weight its misfit is found to a slope of 1e-2 alone.
    record = roll_decay.simulate(duration=10.0, B_2=0.0)
    rows = np.column_stack([record.t, record["phi"]])
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header="t_s,phi_rad", comments="")
    runner, out = CliRunner(), tmp_path / "result"
    source = str(Path(roll_decay.__file__))
    options = ["--starts", "1", "--quiet"]
    data = str(tmp_path / "run.csv")
    fitted = runner.invoke(main, ["identify", source, data, "--out", str(out), *options])
    assert fitted.exit_code == 0, fitted.output
    exported = run(out, "--as", "problem", "--out", tmp_path / "kept.py")
    assert exported.exit_code == 0, exported.output
    again = runner.invoke(
        main, ["identify", str(tmp_path / "kept.py"), data, "--out", f"{out}-2", *options]
    )
    assert again.exit_code == 0, again.output
    before, after = (casid.load(folder) for folder in (out, f"{out}-2"))
    assert_allclose(
        list(after.model.values.values()), list(before.model.values.values()), rtol=1e-6
    )


def test_a_state_space_has_its_operating_point(tmp_path: Path) -> None:
    extended_emps().save(tmp_path / "rail.casid")
    result = run(
        tmp_path / "rail.casid", "--as", "control", "--out", tmp_path / "s", "--at", "v=0.1"
    )
    assert result.exit_code == 0, result.output
    assert "linearised at v = 0.1 m/s; matrices in SI units" in (tmp_path / "s.py").read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--as", "fmi", "--out", "x"], "no export as 'fmi'.*did you mean 'fmu'"),
        (["--as", "simulink", "--out", "x"], "no export as 'simulink'; it is one of [^;]*$"),
        (["--as", "c", "--out", "x.py"], r"C is written to a file that ends with .c"),
        (["--as", "c", "--out", "no/where/x"], "there is no folder"),
        (["--as", "c", "--out", "x", "--at", "p=1"], "export it as control"),
        (["--as", "control", "--out", "x", "--at", "psi=1"], "no state or input 'psi'"),
        (["--as", "problem", "--out", "x", "--without-delays"], "keeps the delays"),
        (["--as", "c", "--out", "x", "--pade", "3"], "--pade is for a state space"),
    ],
)
def test_what_cannot_be_is_refused(
    saved: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    result = run(saved, *arguments)
    assert result.exit_code == 2
    assert re.search(message, result.output.replace("\n", " ")), result.output


def test_a_problem_file_is_no_result(tmp_path: Path) -> None:
    result = run(roll_decay.__file__, "--as", "c", "--out", tmp_path / "x")
    assert result.exit_code == 2
    assert "is a problem file; fit it first, casid identify" in result.output


def test_a_file_that_exists_is_kept_without_force(saved: Path, tmp_path: Path) -> None:
    there = tmp_path / "model.c"
    there.write_text("mine")
    refused = run(saved, "--as", "c", "--out", there)
    assert (refused.exit_code, there.read_text()) == (2, "mine")
    assert run(saved, "--as", "c", "--out", there, "--force").exit_code == 0
    assert there.read_text() != "mine"


def test_the_delay_of_a_sensor_is_kept_approximated_or_left_out(tmp_path: Path) -> None:
    path = delayed_pendulum(2.3).save(tmp_path / "late.casid")
    assert run(path, "--as", "c", "--out", tmp_path / "late").exit_code == 0
    assert "Sensors are delayed (gyro by 0.023 s)" in (tmp_path / "late.h").read_text()
    without = ["--as", "c", "--out", tmp_path / "prompt", "--without-delays"]
    assert run(path, *without).exit_code == 0
    assert "sensor of gyro is delayed by 0.023 s" in (tmp_path / "prompt.h").read_text()
    assert run(path, "--as", "modelica", "--out", tmp_path / "late").exit_code == 0
    assert "gyro = delay(p, 0.023);" in (tmp_path / "late.mo").read_text()
    refused = run(path, "--as", "control", "--out", tmp_path / "late")
    assert refused.exit_code == 2
    assert "gyro by 0.023 s" in refused.output
    assert "--pade 3" in refused.output
    assert run(path, "--as", "control", "--out", tmp_path / "late", "--pade", "3").exit_code == 0
    assert "Pade approximations of order 3" in (tmp_path / "late.py").read_text()
