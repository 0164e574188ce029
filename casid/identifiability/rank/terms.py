"""Linear combinations of the nodes of a program."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

from casid.identifiability.rank.program import ONE, Terms

UNIT: Terms = {ONE: Fraction(1)}
"""The number 1."""


def common_unit(numbers: Sequence[Fraction]) -> Fraction:
    """The largest number of which all are multiples."""
    denominator = math.lcm(*(x.denominator for x in numbers))
    return Fraction(math.gcd(*(int(x * denominator) for x in numbers)), denominator)


def constant_of(a: Terms) -> Fraction | None:
    """The number that a combination is, None where it is none."""
    if not a:
        return Fraction(0)
    return a[ONE] if len(a) == 1 and ONE in a else None


def added(a: Terms, b: Terms, sign: int = 1) -> Terms:
    """a + b, or a - b."""
    total = dict(a)
    for n, c in b.items():
        total[n] = total.get(n, Fraction(0)) + sign * c
        if not total[n]:
            del total[n]
    return total


def scaled(a: Terms, factor: Fraction | int) -> Terms:
    """A multiple."""
    return {n: c * factor for n, c in a.items()}
