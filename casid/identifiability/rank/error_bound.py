"""Probability that the rank at a random point is too small.

A minor of the observability matrix is a polynomial P in the random numbers (parameters, initial
states, coefficients of inputs and what transcendental functions start from). A point shows too
small a rank only where a minor that is not identically zero vanishes there: because the prime
divides all its coefficients, or because the point is a root of the polynomial modulo the prime,

    probability <= (log2 |L P|_1 / 30) / (number of primes drawn from) + deg P / 2^30           (1)

where L P has integer coefficients (each prime above 2^30 that divides a coefficient costs it 30
bits; Schwartz, J. ACM 27 (1980) 701-717). Degree and one-norm follow from those of the right-hand
sides: a Lie derivative raises the degree by at most deg f - 1, and the norm by deg P times |f|_1.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from casid.algebra.prime_field import LOWEST_PRIME, PRIMES_THERE
from casid.identifiability.rank.program import ONE, Program


@dataclass(frozen=True, slots=True)
class Size:
    """Size of a polynomial: degree, log2 of the one-norm, and how often denominators are cleared.

    With L the least common denominator of the numbers in the equations, L**cleared P has integer
    coefficients. Variables are the symbols and the primitives.
    """

    degree: float
    bits: float
    cleared: float = 0.0

    def __mul__(self, other: Size) -> Size:
        return Size(
            self.degree + other.degree, self.bits + other.bits, self.cleared + other.cleared
        )

    def power(self, n: float) -> Size:
        """The size of the n-th power."""
        return Size(n * self.degree, n * self.bits, n * self.cleared)

    def derivative(self, of_variables: Size) -> Size:
        """A sum of partial derivatives, each times something of the size given."""
        count = math.log2(max(self.degree, 1.0))
        own = Size(max(self.degree - 1.0, 0.0), self.bits + count, self.cleared)
        return own * of_variables


def failure_probabilities(
    program: Program, rank: int, order: int, *, columns: int, copies: int = 1
) -> list[float]:
    """Bound (1) for the event that a matrix of derivatives up to 0, 1, ..., `order` lacks rank.

    Parameters
    ----------
    program : of the system.
    rank : that was found; a minor with one row more would have to vanish.
    order : highest derivative.
    columns : of the matrix.
    copies : experiments of this system with rows in the matrix.
    """
    rows = min(rank + 1, columns)
    denominator = math.lcm(*(c.denominator for t in program.sums.values() for c in t.values()))
    # A root exists at every second point: of those, the share of bad ones is twice as large.
    rooted = 2.0 ** (copies * _roots(program))
    out = []
    for size in minor_sizes(program, rows, order, copies=copies):
        bits = size.bits + size.cleared * math.log2(denominator)
        single = bits / 30.0 / PRIMES_THERE + size.degree / LOWEST_PRIME
        out.append(min(1.0, rooted * single))
    return out


def minor_sizes(program: Program, rows: int, order: int, *, copies: int = 1) -> list[Size]:
    """Sizes of a minor as a polynomial in the random numbers, for derivatives up to 0 .. `order`.

    At most one row of each output is of the highest order, one of the next lower, and so on.
    """
    sizes = _sizes(program)
    growth, tangent = _growth(program, sizes)
    lie = [_largest([sizes[n] for n in program.h])]
    for _ in range(order):
        lie.append(lie[-1].derivative(growth))
    entries = [one.derivative(_largest([Size(0.0, 0.0), tangent])) for one in lie]
    quotients = _quotients(program, sizes)
    conjugates = 2.0 ** (copies * _roots(program))
    each = max(1, copies * len(program.h))
    out = []
    for highest in range(order + 1):
        left = min(rows, each * (highest + 1))
        minor = Size(0.0, math.lgamma(left + 1) / math.log(2.0))
        for entry in reversed(entries[: highest + 1]):
            taken = min(left, each)
            minor, left = minor * entry.power(taken), left - taken
        out.append(_replaced(minor, quotients).power(conjugates))
    return out


def _sizes(program: Program) -> list[Size]:
    """Size of every node, as a polynomial in the variables and the primitives."""
    out = [Size(1.0, 0.0)] * program.n_nodes
    for n in program.order:
        if n in program.sums:
            terms = program.sums[n]
            inside = _largest([out[k] if k != ONE else Size(0.0, 0.0) for k in terms])
            norm = math.log2(max(sum(abs(c) for c in terms.values()), 1))
            is_broken = any(c.denominator > 1 for c in terms.values())
            out[n] = Size(inside.degree, inside.bits + norm, inside.cleared + is_broken)
        elif n in program.products:
            a, b = program.products[n]
            out[n] = out[a] * out[b]
        elif n in program.kinks:
            out[n] = Size(0.0, 0.0)
    return out


def _growth(program: Program, sizes: list[Size]) -> tuple[Size, Size]:
    """Size of the time derivatives of states and primitives, and of the primitives' tangents."""
    in_time = _largest([Size(1.0, 0.0), *(sizes[n] for n in program.f)])
    tangent = Size(0.0, 0.0)
    for n in program.order:
        if n in program.primitives:
            q = program.primitives[n]
            slope, argument = sizes[q.slope], sizes[q.argument]
            in_time = _largest([in_time, slope * argument.derivative(in_time)])
            tangent = _largest([tangent, slope * argument.derivative(tangent)])
    return in_time, tangent


def _quotients(program: Program, sizes: list[Size]) -> list[Size]:
    """Sizes of the primitives that are not drawn themselves, as quotients of what is drawn.

    An inverse is a quotient of polynomials; sine and cosine are 2t/(1 + t^2) and
    (1 - t^2)/(1 + t^2). A polynomial of degree D is cleared by the D-th power of each divisor. With
    roots in it, its product with its conjugates is a polynomial.
    """
    quotient: dict[int, Size] = {}
    for n in program.order:
        if n not in program.primitives:
            continue
        q = program.primitives[n]
        if q.start == "circle":
            quotient[n] = Size(2.0, 1.0)
        elif q.start in ("inverse", "root"):
            inside = {_divisor(program, k) for k in _primitives_in(program, q.argument)}
            known = [quotient[k] for k in sorted(inside) if k in quotient]
            quotient[n] = _replaced(sizes[q.argument], known)
    return list(quotient.values())


def _replaced(size: Size, quotients: Iterable[Size]) -> Size:
    """A polynomial whose variables are replaced by quotients, cleared."""
    total = size
    for q in quotients:
        total = total * q.power(size.degree)
    return total


def _divisor(program: Program, node: int) -> int:
    """The primitive that has the same divisor: of a cosine, its sine."""
    partner = program.primitives[node].partner
    return partner if partner >= 0 else node


def _primitives_in(program: Program, node: int) -> set[int]:
    """Primitives that occur in a node's polynomial."""
    found: set[int] = set()
    visited: set[int] = set()
    stack = [node]
    while stack:
        n = stack.pop()
        if n in visited or n == ONE:
            continue
        visited.add(n)
        if n in program.primitives:
            found.add(n)
        elif n in program.sums:
            stack.extend(program.sums[n])
        else:
            stack.extend(program.products.get(n, ()))
    return found


def _roots(program: Program) -> int:
    return sum(1 for q in program.primitives.values() if q.start == "root")


def _largest(sizes: Iterable[Size]) -> Size:
    listed = list(sizes)
    return Size(
        max((s.degree for s in listed), default=0.0),
        max((s.bits for s in listed), default=0.0),
        max((s.cleared for s in listed), default=0.0),
    )
