"""Records of ARX, ARMAX, OE and BJ systems with known coefficients."""

from __future__ import annotations

import numpy as np
import pytest

from casid.estimation.prediction_error.polynomial.estimation import Orders
from tests.support.recursion import filtered, simulated

A, B, C, D = (1.0, -1.5, 0.7), (0.0, 1.0, 0.5), (1.0, -0.6, 0.2), (1.0, -0.8)


# Structure: the system, its orders, and the coefficients in casid's order.
SYSTEMS = {
    "ARX": (dict(A=A, B={"u": B}), Orders(na=2, nb=2), [-1.5, 0.7, 1.0, 0.5]),
    "ARMAX": (
        dict(A=A, B={"u": B}, C=C),
        Orders(na=2, nb=2, nc=2),
        [-1.5, 0.7, 1.0, 0.5, -0.6, 0.2],
    ),
    "OE": (dict(B={"u": B}, F={"u": A}), Orders(nb=2, nf=2), [1.0, 0.5, -1.5, 0.7]),
    "BJ": (
        dict(B={"u": B}, C=C, D=D, F={"u": A}),
        Orders(nb=2, nc=2, nd=1, nf=2),
        [1.0, 0.5, -0.6, 0.2, -0.8, -1.5, 0.7],
    ),
}


STRUCTURES = pytest.mark.parametrize("structure", list(SYSTEMS))


def coloured(rng: np.random.Generator, n: int) -> np.ndarray:
    """An input with memory: AR(1), 0.5."""
    return filtered((1.0,), (1.0, -0.5), rng.normal(size=n))


def record(structure: str, n: int, seed: int, noise: float = 0.5):
    """Output, input, orders and coefficients of a record of n samples."""
    rng = np.random.default_rng(seed)
    system, orders, theta = SYSTEMS[structure]
    u = coloured(rng, n)
    return simulated(noise * rng.normal(size=n), {"u": u}, **system), u, orders, np.array(theta)
