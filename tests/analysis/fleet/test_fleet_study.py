"""The simulator of the fleet against closed forms, its plan, and the study in short."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from analysis.fleet.study import STUDY
from analysis.fleet.voyages import (
    CAUSED,
    DISTURBED,
    LAMBDA,
    NOISE,
    TS,
    Drawn,
    N,
    outputs,
    plan,
    sizes_of,
    write,
)

VALUES = {"C": 0.36, "B": 0.06, "K_delta": -0.02, "K_r": -0.25, "phi": 0.02, "p": 0.0}


def test_a_free_decay_is_that_of_the_matrix_exponential() -> None:
    """Runge-Kutta steps of a sixteenth of a second: error (w h)^4 / 120 a step and cycle, 1e-8."""
    nothing = np.zeros((N, 1))
    phi, p = outputs([VALUES], nothing, nothing, nothing)
    A = np.array([[0.0, 1.0], [-0.36, -0.06]])
    exact = np.array([expm(A * TS * k) @ [0.02, 0.0] for k in range(0, N, 50)])
    assert np.abs(phi[::50, 0] - exact[:, 0]).max() < 1e-8
    assert np.abs(p[::50, 0] - exact[:, 1]).max() < 1e-8


def test_a_load_moves_the_rest_and_a_delay_moves_the_gyro() -> None:
    nothing = np.zeros((N, 2))
    columns = [{**VALUES, "load": 0.0036, "B": 0.2}, {**VALUES, "late": 2 * TS}]
    phi, p = outputs(columns, nothing, nothing, nothing)
    assert phi[-1, 0] == pytest.approx(0.0036 / 0.36, rel=1e-6)
    _, own = outputs([VALUES], nothing[:, :1], nothing[:, :1], nothing[:, :1])
    assert np.abs(p[10:, 1] - own[8:-2, 0]).max() < 1e-6  # splines of samples half a second apart


def test_the_plan_has_the_shares_that_it_says() -> None:
    voyages = plan(400, 10, seed=3)
    caused = [v for v in voyages if v.cause]
    assert len(caused) == CAUSED * 400
    assert sum(v.sea > 0 for v in voyages) == DISTURBED * 400
    assert all(LAMBDA[0] <= v.strength <= LAMBDA[1] for v in caused)
    runs = Counter(v.run for v in caused)
    assert max(runs.values()) >= 3
    assert min(runs.values()) == 1


def test_the_size_of_a_cause_has_its_lambda(tmp_path: Path) -> None:
    """A bias of the gyro that no parameter imitates: lambda is N (b / sd)^2, or a little less."""
    (voyage, *_) = [v for v in plan(400, 10, seed=3) if v.cause == "gyro"]
    size = sizes_of([voyage], 3)[voyage.run]
    whole = N * (size / NOISE["gyro"]) ** 2
    assert voyage.strength <= whole <= 1.2 * voyage.strength
    assert Drawn.of(voyage, 3).delta.shape == (N,)
    written = write([voyage], tmp_path, 3)
    assert written[0].size == size
    assert (tmp_path / voyage.name).exists()


@pytest.mark.slow
def test_the_short_study_meets_its_targets(tmp_path: Path) -> None:
    assert STUDY.main(["--quick", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "fleet" / "report.html").exists()
