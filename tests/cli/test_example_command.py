"""`casid example`: a problem's own example as files that the problem reads back the same."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

from casid.data.problem import load_problem
from tests.cli.test_main import casid, refused
from tests.support.shared import ROOT


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", ["pendulum", "roll_decay", "cascaded_tanks"])
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_an_example_reads_back_to_the_last_bit(name: str, suffix: str) -> None:
    problem = load_problem(ROOT / "problems" / f"{name}.py")
    assert casid("example", str(problem.source), "--out", f"run{suffix}").exit_code == 0
    back, record = problem.read(f"run{suffix}").record, problem.examples()[0].record
    assert set(back) == set(record)
    assert back.units == record.units
    assert (back.Ts, back.t0) == pytest.approx((record.Ts, record.t0), rel=1e-12)
    for channel in record:
        np.testing.assert_array_equal(back[channel], record[channel])


def test_names_and_units_stand_above_the_rows() -> None:
    casid("example", str(ROOT / "problems" / "pendulum.py"), "--out", "run.csv")
    names, units = Path("run.csv").read_text().splitlines()[:2]
    found = dict(zip(names.split(","), units.split(","), strict=True))
    assert found["t"] == "s"
    assert found["gyro"] == "rad/s"
    assert found["speed"] == "m/s"


def test_a_unit_that_is_not_si_comes_back_to_a_rounding() -> None:
    Path("swing.py").write_text(
        "import numpy as np\nimport casid\n"
        'm = casid.Model("swing")\n'
        'x = m.state("x", "rad")\n'
        'm.derivative(x, -x / m.parameter("tau", "s"))\n'
        'm.output("x", x, "deg")\n'
        "record = casid.Record({'x': np.exp(-np.arange(50) / 7)}, {'x': 'rad'}, Ts=0.1)\n"
        'problem = casid.Problem("swing", m, channels={"x": "roll:deg"}, example=lambda: record)\n'
    )
    said = casid("example", "swing.py", "--out", "run.csv")
    assert Path("run.csv").read_text().splitlines()[:2] == ["t,roll", "s,deg"]
    back = load_problem("swing.py").read("run.csv").record
    np.testing.assert_allclose(back["x"], np.exp(-np.arange(50) / 7), rtol=3e-16)
    assert said.stdout == "casid diagnose swing.py run.csv\n"


def test_several_records_are_written_with_their_load_cases() -> None:
    ship = str(ROOT / "problems" / "ship.py")
    said = casid("example", ship, "--out", "run.parquet")
    data = "nominal=run-nominal.parquet calibration=run-calibration.parquet run-loaded.parquet"
    assert said.stdout == f"casid diagnose {shlex.quote(ship)} {data}\n"
    assert all(Path(f"run-{n}.parquet").exists() for n in ("nominal", "calibration", "loaded"))


def test_what_cannot_be_written_is_refused() -> None:
    pendulum = str(ROOT / "problems" / "pendulum.py")
    assert "as .csv or .parquet" in refused(casid("example", pendulum, "--out", "run.xlsx"))
    Path("run.csv").write_text("mine")
    message = refused(casid("example", pendulum, "--out", "run.csv"))
    assert "run.csv exists; name another file with --out, or add --force" in message
    assert Path("run.csv").read_text() == "mine"
    assert casid("example", pendulum, "--out", "run.csv", "--force").exit_code == 0
