"""`casid simulate`: a problem or a saved result, driven by a file of inputs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner, Result
from numpy.testing import assert_allclose

import casid
from casid.arrays import Array
from casid.cli.main import main
from casid.estimation.fitted import driving
from problems import pendulum, roll_decay
from tests.support.fitted_models import (
    Simulated,
    extended_pendulum,
    extended_roll_decay,
    simulated,
)

PENDULUM, ROLL_DECAY = (str(Path(module.__file__)) for module in (pendulum, roll_decay))


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["simulate", *map(str, arguments)])


def table(path: Path) -> pd.DataFrame:
    """A written file, without its row of units."""
    if path.suffix == ".parquet":
        return pd.read_parquet(path)
    return pd.read_csv(path, skiprows=[1])


@pytest.fixture(scope="module")
def driven() -> Simulated:
    """The extended pendulum, simulated."""
    return simulated(extended_pendulum())


@pytest.fixture
def files(driven: Simulated, tmp_path: Path) -> tuple[Path, Path]:
    """The saved model, and a file of nothing but its input."""
    frame = pd.DataFrame({"t": driven.t, "accel": driven.inputs["accel"]})
    frame.to_csv(tmp_path / "inputs.csv", index=False)
    return driven.fitted.save(tmp_path / "pendulum.casid"), tmp_path / "inputs.csv"


def test_the_note_about_silent_causes_and_the_simulation_share_their_inputs(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []
    of_model = driving.input_columns

    def counted(model: casid.Model, record: casid.Record) -> Array:
        made.append(record.name)
        return of_model(model, record)

    monkeypatch.setattr(driving, "input_columns", counted)
    assert run(*files, "--out", tmp_path / "out.csv").exit_code == 0
    assert made == ["inputs"]


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_saved_model_is_driven_by_a_file_of_inputs(
    driven: Simulated, files: tuple[Path, Path], tmp_path: Path, ending: str
) -> None:
    out = tmp_path / f"out{ending}"
    result = run(*files, "--out", out)
    assert result.exit_code == 0, result.output
    found = table(out)
    assert list(found) == ["t", "accel", "gyro", "phi", "p"]
    assert_allclose(found["gyro"], driven.y[:, 0], rtol=0, atol=1e-12)
    assert_allclose(found[["phi", "p"]], driven.x[:-1], rtol=0, atol=1e-12)


def test_an_input_that_the_problem_computed_is_named_with_the_way_to_a_file_that_has_it(
    driven: Simulated, files: tuple[Path, Path], tmp_path: Path
) -> None:
    channels = replace(driven.fitted.channels, derived={"accel": "d/dt of the speed"})
    saved = replace(driven.fitted, channels=channels).save(tmp_path / "derived.casid")
    assert run(saved, files[1], "--out", tmp_path / "a.csv").exit_code == 0
    pd.DataFrame({"t": driven.t, "speed": driven.inputs["accel"]}).to_csv(files[1], index=False)
    result = run(saved, files[1], "--out", tmp_path / "b.csv")
    assert result.exit_code == 2
    assert "computed by the problem file (d/dt of the speed)" in result.output


def test_parameters_and_initial_states_are_set(files: tuple[Path, Path], tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    assert run(*files, "--out", out, "--set", "k=11", "--x0", "phi=0.1").exit_code == 0
    inputs = {"accel": pd.read_csv(files[1])["accel"]}
    wanted = extended_pendulum().simulate(inputs, {"phi": 0.1}, known={"k": 11.0})
    assert_allclose(table(out)["gyro"], wanted["gyro"], rtol=0, atol=1e-12)


def test_a_problem_runs_with_its_example_and_its_starts(tmp_path: Path) -> None:
    """Against a Runge-Kutta simulation of the indirect model (7.24) with the starts in it."""
    result = run(PENDULUM, "--out", tmp_path / "out.csv")
    assert result.exit_code == 0, result.output
    found = table(tmp_path / "out.csv")
    k, d, I_x, M, z_g, z_s = 8.0, 0.1, 0.15, 22.04, -0.018, -0.218
    S = M * z_g
    I_2 = I_x + M * z_g**2 - z_s * S
    h, x, a = 0.01 / 4, np.zeros(2), found["accel"].to_numpy()

    def rates(x: np.ndarray, a: float) -> np.ndarray:
        return np.array([x[1], (-k * x[0] - d * x[1] - S * a) / I_2])

    for i in range(200):
        assert found["gyro"][i] == pytest.approx(x[1], abs=1e-6)
        for j in range(4):
            u = [a[i] + (j + c) / 4 * (a[i + 1] - a[i]) for c in (0.0, 0.5, 1.0)]
            k1 = rates(x, u[0])
            k2 = rates(x + h / 2 * k1, u[1])
            k3 = rates(x + h / 2 * k2, u[1])
            k4 = rates(x + h * k3, u[2])
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def test_a_model_without_inputs_runs_for_a_time(tmp_path: Path) -> None:
    saved = extended_roll_decay().save(tmp_path / "decay.casid")
    assert run(saved, "--out", tmp_path / "a.csv").exit_code == 0
    wanted = simulated(extended_roll_decay())
    assert_allclose(table(tmp_path / "a.csv")["phi"], wanted.y[:, 0], rtol=0, atol=1e-12)
    assert run(saved, "--out", tmp_path / "b.csv", "--duration", "3").exit_code == 0
    assert len(table(tmp_path / "b.csv")) == 150


def test_the_written_file_reads_back(files: tuple[Path, Path], tmp_path: Path) -> None:
    run(*files, "--out", tmp_path / "out.csv")
    record = casid.read_record(tmp_path / "out.csv")
    assert (record.units["gyro"], record.units["phi"], record.N) == ("rad/s", "rad", 400)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--x0", "zz=1"], "--x0 zz: pendulum has no such state; it has phi, p\n"),
        (["--set", "K=1"], "no parameter 'K'; did you mean 'k'"),
        (["--duration", "3"], "--duration is for a model without inputs"),
        (["--map", "accel=a_x"], "no column 'a_x'"),
    ],
)
def test_what_cannot_be_is_refused(
    files: tuple[Path, Path], tmp_path: Path, arguments: list[str], message: str
) -> None:
    result = run(*files, "--out", tmp_path / "out.csv", *arguments)
    assert result.exit_code == 2
    assert message in result.output or message in result.output.replace("\n", " ")


def test_inputs_are_needed_where_the_model_has_some(
    files: tuple[Path, Path], tmp_path: Path
) -> None:
    result = run(files[0], "--out", tmp_path / "out.csv")
    assert result.exit_code == 2
    assert "pendulum is driven by accel; name a file" in result.output


def test_a_file_that_exists_is_kept_without_force(files: tuple[Path, Path], tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    out.write_text("mine")
    assert run(*files, "--out", out).exit_code == 2
    assert out.read_text() == "mine"
    assert run(*files, "--out", tmp_path / "out.txt").exit_code == 2


def test_the_problem_is_read_from_its_own_file(tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    result = run(ROLL_DECAY, "--out", out, "--duration", "2", "--x0", "phi=0.2")
    assert result.exit_code == 0, result.output
    found = table(out)
    assert list(found) == ["t", "phi", "p"]
    # The linear decay with the starts B_1 = 0.02 / s and C_1 = 6.1 / s^2, from rest at 0.2 rad.
    w = np.sqrt(6.1 - 0.01**2)
    t = found["t"].to_numpy()
    wanted = 0.2 * np.exp(-0.01 * t) * (np.cos(w * t) + 0.01 / w * np.sin(w * t))
    assert_allclose(found["phi"], wanted, rtol=0, atol=2e-7)


def test_how_the_files_are_written_stays_with_the_model(tmp_path: Path) -> None:
    """Hours of local time, over the beginning of summer time, from the fit to the exported file."""
    t = pd.date_range("2025-03-29 12:00", periods=48, freq="h", tz="Europe/Berlin")
    rng = np.random.default_rng(2)
    u = np.repeat(rng.normal(size=12), 4)
    y = np.zeros(48)
    for i in range(47):
        y[i + 1] = np.exp(-1 / 3) * y[i] + (1 - np.exp(-1 / 3)) * u[i]
    y = y + 1e-3 * rng.normal(size=48)
    frame = pd.DataFrame({"Zeit": t.strftime("%d.%m.%Y %H:%M"), "u [V]": u, "y [V]": y})
    frame.to_csv(tmp_path / "run.csv", index=False)
    (tmp_path / "lag.py").write_text(
        "import casid\n"
        "m = casid.Model('lag')\n"
        "x, u = m.state('x', 'V'), m.input('u', 'V', hold='zoh')\n"
        "T = m.parameter('T', 'h', start=2, lower=0.1, upper=100)\n"
        "m.derivative(x, (u - x) / T)\n"
        "m.output('y', x, 'V')\n"
        "problem = casid.Problem('lag', m, channels={'u': 'u [V]', 'y': 'y [V]'},\n"
        "    form=casid.FileFormat(time_zone='Europe/Berlin'), starts=1)\n"
    )
    problem = casid.load_problem(tmp_path / "lag.py")
    estimate = casid.identify(problem, [problem.read(tmp_path / "run.csv")])
    saved = estimate.save(tmp_path / "lag.casid")
    result = run(saved, tmp_path / "run.csv", "--out", tmp_path / "out.csv")
    assert result.exit_code == 0, result.output
    assert len(table(tmp_path / "out.csv")) == 48
    written = casid.load(saved).model.to_problem_file(tmp_path / "again.py")
    assert casid.load_problem(written).form == problem.form


def test_a_jump_acts_in_windows_of_the_fitted_file_and_elsewhere_only_on_request(tmp_path: Path):
    """A tank that drains twice as fast from 10 s on; levels of the exact solution, no noise."""
    t = 0.1 * np.arange(300)
    level = np.where(t < 10.0, np.exp(-0.05 * t), np.exp(-0.5 - 0.1 * (t - 10.0)))
    frame = pd.DataFrame({"t": t, "pump": 0.0 * t, "level": level})
    run_file, other = tmp_path / "run.csv", tmp_path / "other.csv"
    frame.to_csv(run_file, index=False)
    frame[200:].to_csv(other, index=False)
    m = casid.Model("tank")
    pump, h = m.input("pump", "m/s", hold="zoh"), m.state("h", "m", start=1.0)
    rate, more = (m.parameter(n, "1/s", start=0.03, lower=0.0) for n in ("rate", "more"))
    s = m.generated_input("s", "1", casid.StepAt(10.0, is_held=True), hold="zoh")
    m.derivative(h, pump - (rate + more * s) * h)
    m.output("level", h, "m")
    problem = casid.Problem("tank", m, starts=1)
    fitted = casid.identify(problem, problem.read(f"{run_file}@0:19.9")).model
    saved, out = fitted.save(tmp_path / "tank.casid"), tmp_path / "out.csv"

    def drained(*arguments: str | Path) -> tuple[float, str]:
        """By how much of itself the level falls in a second, and what the command says."""
        result = run(saved, *arguments, "--out", out, "--force", "--x0", "h=0.2")
        assert result.exit_code == 0, result.output
        found = table(out)["level"]
        return float(np.log(found[0] / found[10])), result.output

    rate_there, said = drained(f"{run_file}@20:29.9")
    assert rate_there == pytest.approx(0.1, rel=1e-3)
    assert "note" not in said
    rate_there, said = drained(other)
    assert rate_there == pytest.approx(0.05, rel=1e-3)
    note = "note: s: belongs to the clock of run@0:19.9, and does not act in other, which is not"
    assert note in said
    assert "--on-clock makes it act" in said
    rate_there, said = drained(other, "--on-clock")
    assert rate_there == pytest.approx(0.1, rel=1e-3)
    assert "note" not in said
