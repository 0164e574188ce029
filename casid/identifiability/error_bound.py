"""How likely a random point is to show too small a rank.

A minor of the observability matrix is a polynomial P in the random numbers (parameters, initial
states, coefficients of inputs and what transcendental functions start from), with integer
coefficients. A point shows too small a rank only where a minor that is not identically zero
vanishes there: because the prime divides all its coefficients, or because the point is a root of
what is left,

    probability <= (log2 |P|_1 / 30) / (number of primes drawn from) + deg P / p                (1)

(each prime above 2^30 that divides a coefficient costs it 30 bits; Schwartz, J. ACM 27 (1980)
701-717). Degree and one-norm follow from those of the right-hand sides: a Lie derivative raises the
degree by at most deg f - 1, and the norm by deg times |f|_1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from casid.identifiability.prime_field import LOWEST_PRIME, PRIMES_THERE
from casid.identifiability.program import ONE, Program


@dataclass(frozen=True, slots=True)
class Size:
    """Degree of a polynomial and the binary logarithm of its one-norm, denominators cleared."""

    degree: float
    bits: float


def failure_probability(
    program: Program, rank: int, order: int, *, columns: int, lowest_prime: int = LOWEST_PRIME
) -> float:
    """Bound (1) for a minor of `rank` rows of derivatives up to `order`; at most 1.

    Parameters
    ----------
    program : of the system.
    rank : rows of the minor.
    order : highest derivative among them.
    columns : of the observability matrix.
    """
    sizes = _sizes(program)
    growth, own = _growth(program, sizes)
    worst = _largest([sizes[n] for n in program.h])
    degree, bits = max(worst.degree, 1.0), worst.bits
    for _ in range(order):
        bits += math.log2(max(degree, 1.0)) + growth.bits + math.log2(max(len(program.f), 1))
        degree += max(growth.degree - 1.0, 0.0)
    # The tangent of a function's starting value is its slope: entries grow by its size.
    bits += math.log2(degree + 1.0) + own.bits
    degree += own.degree
    degree *= max(rank, 1)
    bits = rank * bits + math.lgamma(max(columns, 1) + 1) / math.log(2.0)
    # 1/b for the starting value of an inverse: its denominators are cleared.
    divisors = [q for q in program.primitives.values() if q.start in ("inverse", "root")]
    cleared = sum(_ordinary(program, q.argument, sizes) for q in divisors)
    bits += degree * sum(sizes[q.argument].bits for q in divisors)
    degree *= 1.0 + cleared
    return min(1.0, bits / 30.0 / PRIMES_THERE + degree / lowest_prime)


def _sizes(program: Program) -> list[Size]:
    """Of every node, as a polynomial in the variables and the primitives."""
    out = [Size(1.0, 0.0)] * program.n_nodes
    for n in program.order:
        if n in program.sums:
            terms = program.sums[n]
            inside = [
                Size(out[k].degree if k != ONE else 0.0, (out[k].bits if k != ONE else 0.0))
                for k in terms
            ]
            numbers = max(
                (
                    math.log2(max(abs(c.numerator), 1)) + math.log2(c.denominator)
                    for c in terms.values()
                ),
                default=0.0,
            )
            largest = _largest(inside)
            out[n] = Size(largest.degree, largest.bits + numbers + math.log2(max(len(terms), 1)))
        elif n in program.products:
            a, b = program.products[n]
            out[n] = Size(out[a].degree + out[b].degree, out[a].bits + out[b].bits)
        elif n in program.kinks:
            out[n] = Size(0.0, 0.0)
    return out


def _growth(program: Program, sizes: list[Size]) -> tuple[Size, Size]:
    """Size of the time derivatives of states and primitives, and of the primitives' tangents."""
    derivative = _largest([sizes[n] for n in program.f])
    own = Size(0.0, 0.0)
    for n in program.order:
        if n not in program.primitives:
            continue
        q = program.primitives[n]
        slope, argument = sizes[q.slope], sizes[q.argument]
        step = Size(
            slope.degree + max(argument.degree - 1.0, 0.0),
            slope.bits + argument.bits + math.log2(max(argument.degree, 1.0)),
        )
        derivative = _largest(
            [derivative, Size(step.degree + derivative.degree, step.bits + derivative.bits)]
        )
        own = Size(own.degree + step.degree, own.bits + step.bits)
    return derivative, own


def _ordinary(program: Program, node: int, sizes: list[Size]) -> float:
    """Degree of a divisor in the variables alone, the primitives in it counted generously."""
    inside = sum(1 for q in program.primitives if q < node)
    return max(sizes[node].degree, 1.0) * (1.0 + inside)


def _largest(sizes: list[Size]) -> Size:
    return Size(
        max((s.degree for s in sizes), default=0.0), max((s.bits for s in sizes), default=0.0)
    )
