"""Scores of information matrices against linear algebra, and the program against the simulation."""

from __future__ import annotations

import numpy as np
import pytest

from casid.experiment_design.information import Target, covariance, gradient_of, scores


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
