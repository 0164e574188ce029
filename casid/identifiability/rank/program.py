"""A system read as a straight-line program of three operations: sum, product and primitive.

    sum         s = c_0 + c_1 a_1 + ... + c_m a_m        with numbers c
    product     s = a b
    primitive   ds/dt = g da/dt                          s(0) from a(0)

Every function that satisfies a differential equation with rational right-hand side is a primitive:
1/a (g = -s^2), log a (g = 1/a), exp a (g = s), a^r (g = r s / a), sin a (g = cos a), atan a
(g = 1/(1 + a^2)), ... which is the immersion of the model into a rational one. In truncated power
series all three are linear in the newest coefficient, which is what makes the rank fast (`series`).

Source: A. Sedoglavic, J. Symb. Comput. 33 (2002) 735-755, for the straight-line program.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Literal

Terms = dict[int, Fraction]
"""A linear combination: node -> coefficient; node -1 is the number 1."""

ONE = -1


@dataclass(frozen=True, slots=True)
class Primitive:
    """ds/dt = slope da/dt; how s(0) follows from a(0): inverted, rooted, paired, or drawn.

    Attributes
    ----------
    pinned : a(0) and s(0) where both are rational, such as exp(0) = 1: a special initial value may
        be that very point. Elsewhere s(0) is drawn.
    """

    argument: int
    slope: int
    start: Literal["inverse", "root", "circle", "partner", "free"]
    partner: int = -1  # the sine of a cosine
    pinned: tuple[int, int] | None = None


@dataclass(slots=True)
class Program:
    """Nodes 0 .. n_variables-1 are the symbols of the system; the others follow in order.

    Attributes
    ----------
    variables : names of the symbols, in the system's order.
    sums : node -> terms; products : node -> (a, b); primitives : node -> `Primitive`.
    f, h : nodes of the right-hand sides and of the outputs.
    immersed : names of the functions that are not rational and were adjoined.
    kinks : nodes whose sign is a branch (abs, sign): number -> node of the argument.
    """

    variables: tuple[str, ...]
    order: list[int] = field(default_factory=list)
    sums: dict[int, Terms] = field(default_factory=dict)
    products: dict[int, tuple[int, int]] = field(default_factory=dict)
    primitives: dict[int, Primitive] = field(default_factory=dict)
    f: list[int] = field(default_factory=list)
    h: list[int] = field(default_factory=list)
    immersed: tuple[str, ...] = ()
    kinks: dict[int, int] = field(default_factory=dict)  # node of the sign -> node of the argument

    @property
    def n_nodes(self) -> int:
        """Number of nodes, the variables among them."""
        return len(self.variables) + len(self.order)

    def arguments(self, node: int) -> tuple[int, ...]:
        """Nodes whose newest coefficient that of this node needs."""
        if node in self.sums:
            return tuple(n for n in self.sums[node] if n != ONE)
        if node in self.products:
            return self.products[node]
        if node in self.primitives:
            return (self.primitives[node].argument,)
        return ()


def drop_unused(program: Program) -> None:
    """Remove nodes that are not needed, and number the others without gaps."""
    needed: set[int] = set()
    stack = [*program.f, *program.h]
    while stack:
        n = stack.pop()
        if n in needed:
            continue
        needed.add(n)
        stack.extend(program.arguments(n))
        if n in program.primitives:
            stack.append(program.primitives[n].slope)
            if program.primitives[n].partner >= 0:
                stack.append(program.primitives[n].partner)
    first = len(program.variables)
    kept = [n for n in program.order if n in needed]
    new = {n: n for n in range(first)} | {n: first + i for i, n in enumerate(kept)} | {ONE: ONE}
    program.order = [new[n] for n in kept]
    program.sums = {
        new[n]: {new[k]: c for k, c in t.items()} for n, t in program.sums.items() if n in needed
    }
    program.products = {
        new[n]: (new[a], new[b]) for n, (a, b) in program.products.items() if n in needed
    }
    program.primitives = {
        new[n]: replace(
            q,
            argument=new[q.argument],
            slope=new[q.slope],
            partner=new[q.partner] if q.partner >= 0 else -1,
        )
        for n, q in program.primitives.items()
        if n in needed
    }
    program.kinks = {new[n]: new.get(a, -1) for n, a in program.kinks.items() if n in needed}
    program.f = [new[n] for n in program.f]
    program.h = [new[n] for n in program.h]


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
