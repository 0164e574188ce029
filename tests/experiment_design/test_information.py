"""Scores of information matrices against linear algebra, and the program against the simulation."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid.experiment_design.excitation import excitation_of
from casid.experiment_design.hypotheses import Comparison, nominal_hypothesis
from casid.experiment_design.information import Target, covariance, gradient_of, scores
from casid.experiment_design.limits import limits_of
from casid.experiment_design.prediction import Prediction
from casid.experiment_design.rollout import Rollout
from casid.experiment_design.setup import Setup, nominal_of


@pytest.fixture(scope="module")
def columns() -> np.ndarray:
    """200 samples of two nuisance columns, three of interest, and a misfit; very unlike sizes."""
    rng = np.random.default_rng(3)
    mixed = rng.standard_normal((200, 6)) @ rng.standard_normal((6, 6))
    return mixed * np.array([1.0, 1e3, 1e-2, 5.0, 40.0, 3.0])


def test_the_misfit_is_what_least_squares_leave(columns: np.ndarray) -> None:
    left = np.linalg.lstsq(columns[:, :5], columns[:, 5], rcond=None)[1][0]
    found = scores(columns.T @ columns, Target("misfit", (-1,)))
    assert np.exp(found[0]) == pytest.approx(left, rel=1e-6)


def test_the_criteria_are_those_of_the_covariance(columns: np.ndarray) -> None:
    gram = columns[:, :5].T @ columns[:, :5]
    sizes = (2.0, 0.5, 10.0)
    inner = np.linalg.inv(gram)[2:, 2:]
    relative = inner / np.outer(sizes, sizes)
    interest = (2, 3, 4)
    D = scores(gram, Target("D", interest, sizes))[0]
    assert D == pytest.approx(-np.log(np.linalg.det(inner)) / 3, rel=1e-6)
    A = scores(gram, Target("A", interest, sizes))[0]
    assert A == pytest.approx(-np.log(np.trace(relative) / 3), rel=1e-6)
    E = scores(gram, Target("E", interest, sizes))[0]
    largest = np.linalg.eigvalsh(relative)[-1]
    assert -np.log(largest) - np.log(3) / 8 <= E <= -np.log(largest) + 1e-9
    each = scores(gram, Target("each", interest, sizes))
    assert each == pytest.approx(-np.log(np.diag(relative)), rel=1e-6)
    g = np.array([1.0, -2.0, 0.3])
    function = scores(gram, Target("function", interest, sizes, tuple(g)))[0]
    assert function == pytest.approx(-np.log(g @ inner @ g), rel=1e-6)
    assert covariance(gram)[2:, 2:] == pytest.approx(inner, rel=1e-6)


def test_the_order_of_the_columns_of_interest_does_not_matter(columns: np.ndarray) -> None:
    gram = columns.T @ columns
    first = scores(gram, Target("D", (0, 4), (1.0, 1.0)))
    assert first == pytest.approx(scores(gram, Target("D", (4, 0), (1.0, 1.0))))


def test_a_function_has_its_gradient() -> None:
    assert gradient_of("m * z^2", {"m": 3.0, "z": 2.0}) == {"m": 4.0, "z": 12.0}


def test_the_derivatives_of_the_rollout_are_those_of_differences() -> None:
    """Central differences with a step of 1e-6 are right to about 1e-7."""
    m = casid.Model("pendulum")
    phi, p, u = m.state("phi", "rad"), m.state("p", "rad/s"), m.input("u", "N m")
    d = m.parameter("d", "N m s/rad", start=0.3)
    k = m.parameter("k", "N m/rad", start=4.0)
    m.derivative(phi, p)
    m.balance(
        p,
        "torque",
        inertia=m.constant("J", 1.0, "kg m^2"),
        terms=[-d * p, -k * ca.sin(phi), u],
        unit="N m",
    )
    m.output("phi", phi, "rad")
    problem = casid.Problem("pendulum", m, noise={"phi": 0.01})
    nominal = nominal_of(problem)
    limits = limits_of(nominal.model, {"u": (-2, 2), "p": (-3, 3)}, release={"phi": (-1, 1)})
    excitation = excitation_of("linear", 60, 0.1, intervals=12)
    setup = Setup(nominal, excitation, limits, ("u",), {}, {"u": 0.0}, {}, np.array([0.01]), 6.0)
    h = nominal_hypothesis(nominal, ("u",), "foh")
    rollout = Rollout(Prediction(setup, [h], [Comparison(None, 0)]), 2)
    rng = np.random.default_rng(0)
    w, release = rng.standard_normal((excitation.n, 1)), np.array([0.4])
    weights = rng.standard_normal(len(rollout.outputs(w, release).column))

    def moved(k: int, by: float) -> tuple[np.ndarray, np.ndarray]:
        v = np.append(w[:, 0], release)
        v[k] += by
        return v[:-1, None], v[-1:]

    slope = rollout.slope(w, release)
    curvature = rollout.curvature(w, release, weights)
    for k in (0, 5, excitation.n):
        above, below = moved(k, 1e-6), moved(k, -1e-6)
        difference = rollout.outputs(*above).column - rollout.outputs(*below).column
        assert slope[:, k] == pytest.approx(difference / 2e-6, abs=1e-6 * np.max(np.abs(slope)))
        difference = weights @ (rollout.slope(*above) - rollout.slope(*below))
        atol = 1e-6 * np.max(np.abs(curvature))
        assert curvature[k] == pytest.approx(difference / 2e-6, abs=atol)
