"""A network at a random point of a large prime field: exact decisions about networks of any size.

Whether something vanishes for every q and all values of the symbols is decided at a random point,
modulo 2^61 - 1, where numbers do not grow as fractions do. What does not vanish is taken to vanish
with a probability below its degree / 2^61 (Schwartz and Zippel).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from casid.algebra.rational import Rational
from casid.unknown_inputs.networks.equations import Field, NodeEquations, equations_over
from casid.unknown_inputs.networks.network import Network

PRIME = 2**61 - 1


@dataclass(frozen=True, slots=True)
class Residue:
    """A number modulo `PRIME`, with + - * / among its own kind."""

    value: int

    def __add__(self, other: Residue) -> Residue:
        return Residue((self.value + other.value) % PRIME)

    def __sub__(self, other: Residue) -> Residue:
        return Residue((self.value - other.value) % PRIME)

    def __mul__(self, other: Residue) -> Residue:
        return Residue(self.value * other.value % PRIME)

    def __truediv__(self, other: Residue) -> Residue:
        return Residue(self.value * pow(other.value, -1, PRIME) % PRIME)

    def __neg__(self) -> Residue:
        return Residue(-self.value % PRIME)


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

    def read(g: Rational) -> Residue:
        g = g.substitute(values)
        return Residue(polynomial(g.numerator)) / Residue(polynomial(g.denominator))

    field = Field("residues", Residue(1), lambda x: x.value == 0, read, lambda x: x)
    return equations_over(network, field)
