"""A linear recursion by filters is the loop that it stands for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from casid.linear.filtering.recursion import recursion

TURN = np.array([[0.9, -0.4, 0.1], [0.4, 0.9, 0.0], [0.2, 0.3, 0.5]]) * 0.9
RIG = np.array([[0.0, 1, 0, 0], [-550, -4, 400, 2], [0, 0, 0, 1], [200, 1, -200, -1]])
SCALED = np.diag([1.0, 1e6, 1e-3, 1e4])  # states in units of very different size
MATRICES = {
    "one state": np.array([[0.7]]),
    "a pair and a real mode": TURN,
    "two pairs of a fast sampled rig": SCALED @ linalg.expm(1e-3 * RIG) @ linalg.inv(SCALED),
    "real modes": np.diag([0.9, -0.5, 0.2]) + np.triu(np.ones((3, 3)), 1),
    "defective": np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]]),
}


@pytest.mark.parametrize("kind", MATRICES)
def test_recursion_is_the_plain_loop(kind: str) -> None:
    """Of every state, within the rounding of a thousand steps in its own size."""
    rng, F = np.random.default_rng(3), MATRICES[kind]
    n = len(F)
    size = np.diag(SCALED) if n == 4 else np.ones(n)
    v, x0 = (size[:, None] * rng.standard_normal(s) for s in ((1000, n, 2), (n, 2)))
    x = [x0]
    for t in range(1000):
        x.append(F @ x[-1] + v[t])
    found, loop = recursion(F, v, x0) / size[:, None], np.array(x) / size[:, None]
    np.testing.assert_allclose(found, loop, rtol=1e-9, atol=1e-9 * np.max(np.abs(loop)))


def test_no_states_are_no_rows() -> None:
    assert recursion(np.zeros((0, 0)), np.zeros((5, 0, 2)), np.zeros((0, 2))).shape == (6, 0, 2)
