"""Networks for tests: random rational ones, and the thesis's eight nodes with letters."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from casid.algebra.rational import Rational
from casid.errors import ModelError
from casid.unknown_inputs.networks.network import Network, dynamic_network
from casid.unknown_inputs.networks.random_equations import random_point


def random_module(rng: np.random.Generator) -> Rational:
    """(d q + b) / (q - a) with small rationals; a third of them without direct term."""
    a, b, d = (Fraction(int(x), 7) for x in rng.integers(-6, 7, 3))
    d *= int(rng.integers(0, 3) > 0)
    return Rational((d, b) if (d or b) else (Fraction(1),), (Fraction(1), -a), "q")


def random_network(seed: int, most: int = 8, density: float = 0.35) -> Network:
    """A well-posed network of 3 to `most` nodes, some without a sensor; any stability."""
    rng = np.random.default_rng(seed)
    while True:
        L = int(rng.integers(3, most + 1))
        modules = {
            (i, k): random_module(rng)
            for i in range(1, L + 1)
            for k in range(1, L + 1)
            if i != k and rng.random() < density
        }
        measured = [n for n in range(1, L + 1) if n == 1 or rng.random() < 0.65]
        try:
            return dynamic_network(modules, nodes=range(1, L + 1), measured=measured)
        except ModelError:  # an ill-posed draw
            continue


def point(network: Network, seed: int) -> dict:
    """Keyword arguments `at` and `values` of a random rational q."""
    at, values = random_point(network, np.random.default_rng(seed))
    return {"at": at, "values": values}
