"""What becomes of a command that acts through play in a problem file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import casid


def valve() -> casid.Model:
    m = casid.Model("valve and tank")
    h, u = m.state("h", "m"), m.input("u", "m", known=True, hold="zoh")
    m.derivative(h, (u - h) / m.parameter("tau", "s", start=2.0, lower=0.1))
    m.output("level", h, "m")
    return m


@pytest.mark.parametrize("begins", [0.0, -1.0])
def test_a_problem_file_says_where_in_its_play_a_command_begins(tmp_path: Path, begins: float):
    played = valve().extend(casid.input_backlash(valve(), "u", 0.3, begins=begins))
    played = played.with_known(gap_u=0.2)
    rng = np.random.default_rng(1)
    u, level = np.repeat(rng.uniform(-1, 1, 40), 10), np.zeros(400)
    for i in range(399):
        level[i + 1] = u[i] + (level[i] - u[i]) * np.exp(-0.1 / 2.0)
    level += 0.01 * rng.standard_normal(400)
    record = casid.Record({"u": u, "level": level}, {"u": "m", "level": "m"}, Ts=0.1)
    fitted = casid.identify(casid.Problem("valve", played), record).model
    fitted.to_problem_file(tmp_path / "valve.py")
    (stage,) = casid.load_problem(tmp_path / "valve.py").model.stages
    assert (stage.kind, stage.channel, stage.begins) == ("play_input", "u", begins)
