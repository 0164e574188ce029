"""An effect of the user's that makes the simulation run away is left out, and a note says so."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from casid import Record, diagnose, load_problem
from tests.cli.test_main import casid as command

SOURCE = """
import casid

m = casid.Model("ringing mass")
x, v = m.state("x", "m", start=0.1), m.state("v", "m/s")
k = m.parameter("k", "N/m", start=50.0)
m.derivative(x, v)
M, d = m.constant("M", 2.0, "kg"), m.constant("d", 0.04, "N s/m")
m.balance(v, "force", inertia=M, terms=[-k * x, -d * v])
m.output("position", x, "m")
fed = casid.balance_effect(
    "fed", "force", lambda s: s.c * s.v, unit="N s/m", sided="positive", description="a push"
)
problem = casid.Problem("ringing mass", m, effects=[fed])
"""


NOT_AT_ISSUE = (
    *("cogging", "missing_mode", "periodic_disturbance", "parameter_drift", "parameter_jump"),
    *("coulomb_friction", "asymmetric_friction", "stribeck_friction", "cubic_damping", "deadzone"),
    *("cubic_stiffness", "quadratic_stiffness", "backlash", "end_stop", "outliers", "hold"),
)
"""Kinds that neither run away here nor are the damping that the model has too much of."""


@pytest.fixture
def problem_file(tmp_path: Path) -> Path:
    path = tmp_path / "ringing.py"
    path.write_text(SOURCE)
    return path


def ringing() -> Record:
    """Less damped than the model, 100 s: it decays at 0.005/s in place of 0.01/s.

    What feeds c = 0.02 N s/m back explains it. A hundredth of the force is c = 0.01 * 5/s * 2 kg =
    0.1 N s/m; it grows at (0.1 - 0.04) / (2 * 2 kg) = 0.015/s, by exp(1) over the 70 s fitted,
    where the model falls by exp(-0.7).
    """
    t = 0.05 * np.arange(2000)
    x = 0.1 * np.exp(-0.005 * t) * np.cos(5.0 * t)
    x += 1e-4 * np.random.default_rng(1).standard_normal(t.size)
    return Record({"position": x}, {"position": "m"}, Ts=0.05)


def left_out(notes: list[str]) -> list[str]:
    return [
        n
        for n in notes
        if n.startswith("fed in force was left out: its simulation diverges already at c = 0.")
        and "turn its sign round, bound it" in n
    ]


@pytest.mark.slow
def test_a_user_effect_that_runs_away_is_left_out_and_noted(problem_file):
    problem = load_problem(str(problem_file))
    d = diagnose(problem, ringing(), starts=1, max_causes=1, without=NOT_AT_ISSUE, advise=False)
    assert d.verdict == "deficient"
    assert len(left_out(list(d.notes))) == 1
    assert all(c.kind != "fed" for c in d.causes)


@pytest.mark.slow
def test_the_command_says_so_and_ends_well(problem_file, tmp_path):
    record = ringing()
    rows = np.column_stack([record.t, record["position"]])
    np.savetxt(
        tmp_path / "run.csv", rows, delimiter=",", header="t,position", comments="", fmt="%.9g"
    )
    without = (option for kind in NOT_AT_ISSUE for option in ("--without", kind))
    quick = ("--starts", "1", "--max-causes", "1", "--quiet", "--json", *without)
    result = command("diagnose", str(problem_file), str(tmp_path / "run.csv"), *quick)
    assert result.exit_code == 0, result.stderr
    assert len(left_out(json.loads(result.stdout)["notes"])) == 1
