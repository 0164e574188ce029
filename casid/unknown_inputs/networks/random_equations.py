"""The equations of a network at a random point: exact decisions about networks of any size.

Whether something vanishes for every q and all values of the symbols is decided at a random point,
modulo 2^61 - 1. What does not vanish there does not vanish; what does vanish there does so by
chance with a probability below its degree / 2^61 (Schwartz and Zippel).
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from casid.algebra.modular_integer import PRIME, ModularInteger
from casid.algebra.rational import Rational
from casid.errors import ModelError
from casid.unknown_inputs.networks.equations import Field, NodeEquations, equations_over
from casid.unknown_inputs.networks.network import Network


def random_equations(network: Network, seed: int) -> NodeEquations:
    """The equations of a network at a random q, with random values for its symbols.

    Parameters
    ----------
    seed : of the point; the same seed is the same point.
    """
    rng = np.random.default_rng(seed)
    q = int(rng.integers(1, PRIME))
    values = {n: Fraction(int(rng.integers(1, PRIME))) for n in network.parameters}

    def polynomial(coefficients: tuple[Any, ...]) -> int:
        total = 0
        for c in coefficients:
            total = (total * q + c.numerator * pow(c.denominator, -1, PRIME)) % PRIME
        return total

    def read(g: Rational) -> ModularInteger:
        g = g.substitute(values)
        return ModularInteger(polynomial(g.numerator)) / ModularInteger(polynomial(g.denominator))

    field = Field("modular", ModularInteger(1), lambda x: x.value == 0, read, lambda x: x)
    return equations_over(network, field)


def random_point(
    network: Network, rng: np.random.Generator
) -> tuple[Fraction, dict[str, Fraction]]:
    """A rational q that is no pole of any module, and a rational value for every parameter."""
    while True:
        q = Fraction(int(rng.integers(-(10**6), 10**6)), int(rng.integers(1, 10**3)) * 2 + 1)
        values = {
            n: Fraction(int(rng.integers(1, 10**6)), int(rng.integers(1, 10**3)) * 2 + 1)
            for n in network.parameters
        }
        try:
            for g in network.modules.values():
                g.substitute(values).at(q)
        except ModelError:
            continue
        return q, values
