"""How files are written, given on the command line, and what is said of what was read."""

from __future__ import annotations

import html
import json
from pathlib import Path

import numpy as np
import pytest

import casid as library
from tests.cli.test_main import casid, refused

PROBLEM = """
import casid

m = casid.Model("lag")
x = m.state("x", "V")
u = m.input("u", "V")
tau = m.parameter("tau", "s", start=2.0, lower=0.1, upper=20.0)
m.derivative(x, (u - x) / tau)
m.output("y", x, "V")
problem = casid.Problem("lag", m)
"""


def lag(times: list[str] | None, header: str = "Datum;u [mV];y [mV];Licht [lx];Bemerkung") -> str:
    """A first-order lag of 3 s sampled every second, and columns that it does not need."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.uniform(-1, 1, 12), 5)
    y, lines = 0.0, [header]
    for k in range(60):
        stamp = [] if times is None else [times[k]]
        cells = [1e3 * u[k], 1e3 * y + 0.5 * rng.standard_normal(), rng.uniform(0, 9)]
        lines.append(";".join([*stamp, *(f"{c:.4f}".replace(".", ",") for c in cells), ""]))
        ahead = u[min(k + 1, 59)]  # by straight lines between the samples
        decay = np.exp(-1 / 3)
        slope = ahead - u[k]
        y = decay * y + (1 - decay) * u[k] + slope * (1 - 3 * (1 - decay))
    return "\n".join(lines) + "\n"


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("lag.py").write_text(PROBLEM)
    clock = [f"06.01.2025 10:00:{k:02d}" for k in range(60)]
    Path("run.csv").write_text(lag(clock), encoding="latin-1")


MAPS = ("--map", "u=u [mV]", "--map", "y=y [mV]")


def test_a_line_a_channel_is_said_on_standard_error_and_stands_in_the_report() -> None:
    done = casid("identify", "lag.py", "run.csv", *MAPS, "--out", "fit")
    assert done.exit_code == 0
    page = html.unescape(Path("fit/report.html").read_text())
    for line in (
        "time stamps are dates read as day, month, year, first 06 January 2025",
        "column u [mV] to u [V]: times 0.001; unit from its name",
        "column 'Licht [lx]' is not used by the model: a diagnosis tests it as a missing input",
        "column 'Bemerkung' is not used: empty",
    ):
        assert line in done.stderr
        assert line in page
    tau = json.loads(Path("fit/estimate.json").read_text())["parameters"]["tau"]
    assert abs(tau["value"] - 3.0) < 3 * tau["std_error"]
    quiet = casid("identify", "lag.py", "run.csv", *MAPS, "--out", "fit", "--force", "--quiet")
    assert quiet.stderr == ""


def test_a_column_is_ignored_on_request() -> None:
    done = casid("identify", "lag.py", "run.csv", *MAPS, "--ignore", "Licht [lx]", "--out", "fit")
    assert "column 'Licht [lx]' is not used: left out as requested (--ignore)" in done.stderr
    text = refused(casid("identify", "lag.py", "run.csv", *MAPS, "--ignore", "Light"))
    assert "no column 'Light' to ignore" in text


def test_a_file_without_time_stamps_takes_its_sample_time_from_the_option() -> None:
    Path("bare.csv").write_text(lag(None, "u [mV];y [mV];Licht;Bemerkung"))
    refused(casid("identify", "lag.py", "bare.csv", *MAPS), "no time column", "--sample-time")
    done = casid("identify", "lag.py", "bare.csv", *MAPS, "--sample-time", "1", "--out", "fit")
    assert done.exit_code == 0
    assert casid("check", "bare.csv", "--sample-time", "1").exit_code == 0


def test_hours_and_minutes_are_named_as_the_unit_of_the_time_column() -> None:
    Path("run.csv").write_text(lag([f"10:{k:02d}" for k in range(60)]).replace("Datum", "Uhrzeit"))
    assert "may be hours and minutes" in casid("check", "run.csv").stdout
    found = casid("check", "run.csv", "--map", "t=Uhrzeit:hh:mm", "--map", "u=u [mV]")
    assert "every Ts = 60 s" in found.stdout
    assert (
        "every Ts = 1 s"
        in casid("check", "run.csv", "--map", "t=Uhrzeit:mm:ss", "--map", "u=u [mV]").stdout
    )


def test_new_keeps_the_format_in_the_problem_file() -> None:
    dates = [f"02/01/2025 10:00:{k:02d}" for k in range(60)]
    Path("run.csv").write_text(lag(dates))
    done = casid("new", "run.csv", "--dates", "mdy", "--out", "made.py")
    assert done.exit_code == 0, done.output
    assert "form=casid.FileFormat(dates='mdy')" in Path("made.py").read_text()
    assert library.load_problem("made.py").form == library.FileFormat(dates="mdy")
