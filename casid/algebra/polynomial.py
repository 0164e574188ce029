"""Polynomials with exact coefficients: tuples in descending powers.

A coefficient is a `fractions.Fraction`, or a sympy expression where parameters have no value. What
divides (remainder, common divisor, stability) is for fractions alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Any, TypeAlias

Coefficient: TypeAlias = Any  # a Fraction, or a sympy expression
Polynomial: TypeAlias = tuple[Coefficient, ...]

ONE: Polynomial = (Fraction(1),)
ZERO: Polynomial = ()


def trimmed(coefficients: Iterable[Coefficient]) -> Polynomial:
    """Without leading zeros; the zero polynomial is empty."""
    p = tuple(coefficients)
    first = next((i for i, c in enumerate(p) if c != 0), len(p))
    return p[first:]


def is_exact(p: Polynomial) -> bool:
    """Whether every coefficient is a fraction."""
    return all(isinstance(c, Fraction) for c in p)


def degree(p: Polynomial) -> int:
    """Degree; -1 for zero."""
    return len(p) - 1


def add(a: Polynomial, b: Polynomial) -> Polynomial:
    """a + b."""
    n = max(len(a), len(b))
    a, b = (Fraction(0),) * (n - len(a)) + a, (Fraction(0),) * (n - len(b)) + b
    return trimmed(x + y for x, y in zip(a, b, strict=True))


def scale(p: Polynomial, factor: Coefficient) -> Polynomial:
    """factor p."""
    return trimmed(factor * c for c in p)


def multiply(a: Polynomial, b: Polynomial) -> Polynomial:
    """a b."""
    if not a or not b:
        return ZERO
    out: list[Coefficient] = [Fraction(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for k, y in enumerate(b):
            out[i + k] += x * y
    return trimmed(out)


def divide(a: Polynomial, b: Polynomial) -> tuple[Polynomial, Polynomial]:
    """Quotient and remainder of a / b, exact coefficients."""
    rest, quotient = list(a), []
    while len(rest) >= len(b):
        factor = rest[0] / b[0]
        quotient.append(factor)
        for i, c in enumerate(b):
            rest[i] -= factor * c
        rest.pop(0)
    return tuple(quotient), trimmed(rest)


def common_divisor(a: Polynomial, b: Polynomial) -> Polynomial:
    """The monic greatest common divisor, exact coefficients; of zero and zero, zero."""
    while b:
        a, b = monic(b), divide(a, b)[1]
    return monic(a)


def common_multiple(polynomials: Iterable[Polynomial]) -> Polynomial:
    """The monic least common multiple of nonzero polynomials, exact coefficients."""
    out = ONE
    for p in polynomials:
        out = monic(multiply(divide(out, common_divisor(out, p))[0], p))
    return out


def monic(p: Polynomial) -> Polynomial:
    """p divided by its leading coefficient."""
    return tuple(c / p[0] for c in p) if p else p


def evaluate(p: Sequence[Coefficient], x: Any) -> Any:
    """p(x) by Horner's rule, for x of any kind with + and *."""
    value: Any = Fraction(0)
    for c in p:
        value = value * x + c
    return value


def compose_ratio(p: Polynomial, above: Polynomial, below: Polynomial) -> Polynomial:
    """below^n p(above / below), with n the degree of p."""
    value, power = ZERO, ONE
    for c in p:
        value = add(multiply(value, above), scale(power, c))
        power = multiply(power, below)
    return value


def is_schur(p: Polynomial) -> bool:
    """Whether every root lies inside the unit circle: Jury's test, exact."""
    p = trimmed(p)
    while len(p) > 1:
        first, last = p[0], p[-1]
        if abs(last) >= abs(first):
            return False
        back = p[::-1]
        p = tuple(first * x - last * y for x, y in zip(p, back, strict=True))[:-1]
    return True


def is_hurwitz(p: Polynomial) -> bool:
    """Whether every root lies in the open left half plane, by s = (z - 1) / (z + 1), exact."""
    n = degree(p)
    one = Fraction(1)
    mapped = compose_ratio(p, (one, -one), (one, one))
    return degree(mapped) == n and is_schur(mapped)  # a root at s = 1 lowers the degree
