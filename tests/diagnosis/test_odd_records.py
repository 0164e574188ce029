"""Records that go wrong before any effect is missing: what the diagnosis says of them is true."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.diagnosis.facts import Facts

TS, N = 0.02, 1000
M, K, D = 1.2, 40.0, 1.5


def problem() -> casid.Problem:
    m = casid.Model("mass")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold="zoh", known=True)
    mass = m.parameter("M", "kg", start=1.0, lower=0.1, upper=20)
    k = m.parameter("k", "N/m", start=30.0, lower=0.0)
    d = m.parameter("d", "N s/m", start=1.0, lower=0.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[F, -k * x, -d * v])
    m.output("x", x, "m")
    return casid.Problem("mass", m, starts=1)


@pytest.fixture(scope="module")
def signals() -> tuple[np.ndarray, np.ndarray]:
    """Force held between samples, and the position exactly, by the matrix exponential."""
    rng = np.random.default_rng(1)
    force = np.repeat(5 * rng.normal(size=N // 25), 25)
    A = np.array([[0.0, 1.0, 0.0], [-K / M, -D / M, 1 / M], [0.0, 0.0, 0.0]])
    step, state, x = expm(TS * A), np.zeros(2), np.empty(N)
    for i in range(N):
        x[i] = state[0]
        state = (step @ np.array([*state, force[i]]))[:2]
    return force, x + 1e-3 * rng.normal(size=N)


def diagnosed(force: np.ndarray, x: np.ndarray) -> casid.Diagnosis:
    return casid.diagnose(
        problem(), casid.Record({"F": force, "x": x}, {"F": "N", "x": "m"}, Ts=TS)
    )


def test_of_an_output_that_stands_still_no_noise_and_no_error_is_claimed(signals):
    """The model was not fitted: the errors would be those of the start values."""
    force, _ = signals
    d = diagnosed(force, np.full(N, 0.3))
    assert d.verdict == "undecided"
    assert "x is constant" in d.sentence
    assert not d.noise
    assert not Facts.of(d).changes
    assert "noise floor" not in str(d)


@pytest.mark.slow
def test_an_output_in_another_unit_is_advised_to_be_checked(signals):
    force, x = signals
    d = diagnosed(force, 1000 * x)
    assert d.verdict == "undecided"
    assert "signs, units and the mapping" in d.advice
    assert any("next to nothing of x" in note for note in d.notes)


@pytest.mark.slow
def test_a_wrong_sign_is_among_what_explains_and_not_among_what_is_undetectable(signals):
    force, x = signals
    d = diagnosed(force, -x)
    first = d.causes[0]
    assert (first.kind, first.where) == ("sensor_scale", "x")
    assert d.remaining is not None
    assert d.remaining.explained[0].kind == "sensor_scale"
    assert d.remaining.explained[0].share > 0.9
    assert ("sensor_scale", "x") not in {(u.kind, u.where) for u in d.undetectable}


@pytest.mark.slow
def test_an_offset_that_no_experiment_separates_is_not_said_to_be_separable(signals):
    """A constant force and a bias of the position are the same to a linear spring."""
    force, x = signals
    d = diagnosed(force, x + 0.1)
    assert "this record does not separate" in d.sentence
    assert d.advice.startswith("No experiment considered separates")
    assert "would separate" not in str(d)
    assert not any(line.startswith("  next ") for line in str(d).splitlines())
