"""Reads the expressions of a system into a program, instruction by instruction.

Equal functions are read as equal: exp(2 a) is the square of exp(a), log(a b) the sum of log(a)
and log(b), so that identities between functions stay identities in the program.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any, Literal

import casadi as ca

from casid.algebra.symbolic import exact, operation_name, run_instructions
from casid.errors import ModelError
from casid.identifiability.equations.system import System
from casid.identifiability.rank.immersion import SPECIAL
from casid.identifiability.rank.program import (
    ONE,
    Primitive,
    Program,
    Terms,
    added,
    common_unit,
    constant_of,
    drop_unused,
    scaled,
)

Kind = Literal["sum", "product", "primitive"]

MAX_POWER = 64
MAX_RELATED = 8
"""exp(a), ..., exp(8 a) are read as powers of one exponential; farther ones as unrelated."""

_ZERO_AT_ZERO = ("asin", "atan", "asinh", "atanh", "erf")
_PINNED: Mapping[str, tuple[int, int]] = {
    "exp": (0, 1),
    "log": (1, 0),
    "power": (1, 1),
    **dict.fromkeys(_ZERO_AT_ZERO, (0, 0)),
}
"""Where an immersed function has a rational value at a rational point (sin and cos: see series)."""

_LINEAR: Mapping[int, Callable[..., Terms]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: added,
    ca.OP_SUB: lambda a, b: added(a, b, -1),
    ca.OP_NEG: lambda a: scaled(a, -1),
    ca.OP_TWICE: lambda a: scaled(a, 2),
}


def program_of(system: System) -> Program:
    """Read the system's expressions.

    Raises
    ------
    ModelError
        If an expression holds a function that is neither rational nor satisfies a rational
        differential equation (min, floor, a branch, ...), or a number that is not finite.
    """
    names = system.declared
    symbols = ca.vertcat(*[system.symbols[n] for n in names])
    value = ca.cse(ca.vertcat(system.f, system.h))
    function = ca.Function("system", [symbols], [ca.densify(value)])
    reader = _Reader(system.name, Program(tuple(names)))
    flat = reader.read(function)
    if reader.has_related_exponentials():
        flat = reader.read(function)
    nx = len(system.states)
    program = reader.program
    program.f = [reader.node(t) for t in flat[:nx]]
    program.h = [reader.node(t) for t in flat[nx:]]
    program.immersed = tuple(dict.fromkeys(reader.immersed))
    drop_unused(program)
    return program


class _Reader:
    """Reads instructions; a register is a linear combination of nodes."""

    def __init__(self, name: str, program: Program) -> None:
        self.name, self.program = name, program
        self.immersed: list[str] = []
        self._known: dict[Any, int] = {}  # what a node computes -> the node
        self._sine: dict[int, tuple[int, int]] = {}
        self._scales: dict[int, list[Fraction]] = {}  # node -> c of its exponentials exp(c node)
        self._units: dict[int, Fraction] = {}  # node -> all its scales are multiples of that

    def read(self, function: Any) -> list[Terms]:
        """The linear combination of each output of an SX function of one vector."""
        inputs: list[Terms] = [{i: Fraction(1)} for i in range(function.numel_in(0))]
        return run_instructions(function, [inputs], self._operation, self._number)[0]

    def node(self, terms: Terms) -> int:
        """The node with the value of a linear combination."""
        if len(terms) == 1:
            ((n, c),) = terms.items()
            if n != ONE and c == 1:
                return n
        return self._new("sum", tuple(sorted(terms.items())), dict(terms))

    # -- operations ---------------------------------------------------------------------------

    def _operation(self, code: int, *a: Terms) -> Terms:
        linear = _LINEAR.get(code)
        if linear is not None:
            return linear(*a)
        if code == ca.OP_MUL:
            return self._product(a[0], a[1])
        if code == ca.OP_SQ:
            return self._product(a[0], a[0])
        if code == ca.OP_DIV:
            return self._product(a[0], self._inverse(a[1]))
        if code == ca.OP_INV:
            return self._inverse(a[0])
        if code in (ca.OP_POW, ca.OP_CONSTPOW):
            return self._power(a[0], a[1])
        special = SPECIAL.get(code)
        if special is None:
            raise ModelError(
                f"{self.name}: {_name(code)} is neither rational nor the solution of a rational "
                "differential equation, so identifiability cannot be decided exactly; analyse "
                "each branch as a model of its own, or replace it by a smooth function such as "
                "tanh"
            )
        return special(self, *a)

    def _number(self, value: float) -> Terms:
        number = _nearest(value, self.name)
        return {ONE: number} if number else {}

    def _product(self, a: Terms, b: Terms) -> Terms:
        for one, other in ((a, b), (b, a)):
            constant = constant_of(one)
            if constant is not None:
                return {n: c * constant for n, c in other.items() if c * constant}
        if len(a) == 1 and len(b) == 1:  # coefficients stay outside
            ((m, c),), ((n, d),) = a.items(), b.items()
        else:
            (m, c), (n, d) = (self.node(a), Fraction(1)), (self.node(b), Fraction(1))
        pair = (min(m, n), max(m, n))
        return {self._new("product", pair, pair): c * d}

    def _inverse(self, a: Terms) -> Terms:
        constant = constant_of(a)
        if constant is not None:
            if constant == 0:
                raise ModelError(
                    f"{self.name}: division by zero at every point; a denominator vanishes "
                    "identically (a known value of zero, perhaps)"
                )
            return {ONE: 1 / constant}
        scale = Fraction(1)
        if len(a) == 1:
            ((n, scale),) = a.items()
        else:
            n = self.node(a)

        def slope(s: int) -> Terms:
            square = self._product({s: Fraction(1)}, {s: Fraction(1)})
            return {k: -c for k, c in square.items()}

        return {self._primitive("inverse", n, slope, "inverse"): 1 / scale}

    def _power(self, a: Terms, b: Terms) -> Terms:
        exponent = constant_of(b)
        if exponent is None:
            return self._distributed(
                a,
                lambda c: self.exp(self._product(b, self.log(c))),
                lambda c: self._power(c, b),
                numbers=True,
            )
        if exponent.denominator == 1 and abs(exponent) <= MAX_POWER:
            base = a if exponent >= 0 else self._inverse(a)
            result: Terms = {ONE: Fraction(1)}
            for bit in bin(abs(exponent.numerator))[2:]:
                result = self._product(result, result)
                if bit == "1":
                    result = self._product(result, base)
            return result
        if exponent.denominator == 2 and abs(exponent.numerator) <= MAX_POWER:
            return self._power(self.sqrt(a), {ONE: Fraction(exponent.numerator)})

        def root(c: Terms) -> Terms:
            return self._adjoined(f"power {exponent}", c, self._power_slope(c, exponent), "free")

        return self._distributed(a, root, lambda c: self._power(c, b))

    def _power_slope(self, a: Terms, exponent: Fraction) -> Callable[[int], Terms]:
        return lambda s: self._product({s: exponent}, self._inverse(a))

    def sqrt(self, a: Terms) -> Terms:
        """sqrt(a): g = 1 / (2 s). Of a product it is a product."""

        def slope(s: int) -> Terms:
            return {n: c / 2 for n, c in self._inverse({s: Fraction(1)}).items()}

        def root(b: Terms) -> Terms:
            return self._adjoined("sqrt", b, slope, "root")

        return self._distributed(a, root, self.sqrt)

    def _distributed(
        self,
        a: Terms,
        one: Callable[[Terms], Terms],
        each: Callable[[Terms], Terms],
        *,
        numbers: bool = False,
    ) -> Terms:
        """A power of a product as the product of the powers; numbers stay inside, or do not."""
        factors = self._factors(a)
        if factors is None or (not numbers and any(ONE in f for f, _ in factors)):
            return one(a)
        result: Terms = {ONE: Fraction(1)}
        for factor, power in factors:
            value = each(factor)
            result = self._product(result, value if power == 1 else self._inverse(value))
        return result

    def exp(self, a: Terms) -> Terms:
        """exp(a): g = s. Of a sum it is a product, of k a the k-th power: exp(a) exp(-a) is one."""
        result: Terms = {ONE: Fraction(1)}
        for n, c in a.items():
            result = self._product(result, self._exponential(n, c))
        return result

    def _exponential(self, n: int, c: Fraction) -> Terms:
        """exp(c n), as a power of the exponential of the unit that all such c have."""
        inside = self._argument_of("log", n)
        if inside is not None:
            return self._power(inside, {ONE: c})
        self._scales.setdefault(n, []).append(c)
        unit = self._units.get(n, c)
        times = c / unit
        if times.denominator != 1 or abs(times) > MAX_RELATED:
            unit, times = c, Fraction(1)
        base = self._adjoined("exp", {n: unit}, lambda s: {s: Fraction(1)}, "free")
        return self._power(base, {ONE: times})

    def has_related_exponentials(self) -> bool:
        """True if arguments are multiples of one another: read again, with their common unit."""
        for n, scales in self._scales.items():
            if len(set(scales)) > 1:
                self._units[n] = common_unit(scales)
        return bool(self._units)

    def log(self, a: Terms) -> Terms:
        """log(a): g = 1/a. Of a product it is a sum."""
        if constant_of(a) == 1:
            return {}
        inside = self._argument_of("exp", next(iter(a))) if len(a) == 1 else None
        if inside is not None and a == {next(iter(a)): 1}:
            return inside
        factors = self._factors(a)
        if factors is None:
            return self._adjoined("log", a, lambda _: self._inverse(a), "free")
        total: Terms = {}
        for factor, power in factors:
            total = added(total, scaled(self.log(factor), power))
        return total

    def _argument_of(self, name: str, n: int) -> Terms | None:
        """The argument of a node, if it is that function."""
        q = self.program.primitives.get(n)
        if q is None or self._known.get((name, q.argument)) != n:
            return None
        return {q.argument: Fraction(1)}

    def _factors(self, a: Terms) -> list[tuple[Terms, int]] | None:
        """The factors of a product or inverse and their powers, None where it is neither."""
        if len(a) != 1:
            return None
        ((n, c),) = a.items()
        if n == ONE:
            return None
        if n in self.program.products:
            left, right = self.program.products[n]
            factors = [({left: Fraction(1)}, 1), ({right: Fraction(1)}, 1)]
        elif n in self.program.primitives and self.program.primitives[n].start == "inverse":
            factors = [({self.program.primitives[n].argument: Fraction(1)}, -1)]
        elif c == 1:
            return None
        else:
            factors = [({n: Fraction(1)}, 1)]
        return factors if c == 1 else [({ONE: c}, 1), *factors]

    def sine(self, a: Terms) -> tuple[Terms, Terms]:
        """sin(a) and cos(a), which are each other's slope."""
        if a and a[min(a)] < 0:
            sine_, cosine_ = self.sine(scaled(a, -1))
            return scaled(sine_, -1), cosine_
        n = self.node(a)
        if n not in self._sine:
            self.immersed += ["sin", "cos"]
            sine, cosine = self._append(), self._append()
            minus = self.node({sine: Fraction(-1)})
            self.program.primitives[sine] = Primitive(n, cosine, "circle")
            self.program.primitives[cosine] = Primitive(n, minus, "partner", sine)
            self._sine[n] = (sine, cosine)
        sine, cosine = self._sine[n]
        return {sine: Fraction(1)}, {cosine: Fraction(1)}

    def sign(self, a: Terms) -> Terms:
        """+-1, constant on each side of the kink; c a has its kink where a has."""
        constant = constant_of(a)
        if constant is not None:
            return {ONE: Fraction(1 if constant > 0 else -1)} if constant else {}
        first = a[min(n for n in a if n != ONE)]
        if first != 1:
            turned = self.sign({n: c / first for n, c in a.items()})
            return turned if first > 0 else scaled(turned, -1)
        n = self.node(a)
        key = ("sign", n)
        if key not in self._known:
            self._known[key] = self._append()
            self.program.kinks[self._known[key]] = n
        return {self._known[key]: Fraction(1)}

    def one_over(self, a: Terms) -> Terms:
        """1/a, for the functions of `SPECIAL`."""
        return self._inverse(a)

    def times(self, a: Terms, b: Terms) -> Terms:
        """a b, for the functions of `SPECIAL`."""
        return self._product(a, b)

    def integral(self, name: str, a: Terms, slope: Terms) -> Terms:
        """A function of `a` with the given derivative."""
        return self._adjoined(name, a, lambda _: slope, "free")

    # -- nodes --------------------------------------------------------------------------------

    def _adjoined(
        self,
        name: str,
        a: Terms,
        slope: Callable[[int], Terms],
        start: Literal["inverse", "root", "free"],
    ) -> Terms:
        self.immersed.append(name)
        return {self._primitive(name, self.node(a), slope, start): Fraction(1)}

    def _primitive(
        self,
        name: str,
        argument: int,
        slope: Callable[[int], Terms],
        start: Literal["inverse", "root", "free"],
    ) -> int:
        key = (name, argument)
        if key not in self._known:
            node = self._append()
            self._known[key] = node
            pinned = _PINNED.get(name.split()[0])
            step = self.node(slope(node))
            self.program.primitives[node] = Primitive(argument, step, start, pinned=pinned)
        return self._known[key]

    def _new(self, kind: Kind, key: Any, content: Any) -> int:
        if (kind, key) not in self._known:
            node = self._append()
            self._known[kind, key] = node
            table: dict[int, Any] = self.program.sums if kind == "sum" else self.program.products
            table[node] = content
        return self._known[kind, key]

    def _append(self) -> int:
        self.program.order.append(self.program.n_nodes)
        return self.program.order[-1]


def _nearest(value: float, name: str) -> Fraction:
    """The decimal that reads back as this float; simple fractions such as 1/3 exactly."""
    decimal = exact(value) if value == value else None
    if decimal is None:
        raise ModelError(f"{name}: a number in the equations is {value}; correct it")
    simple = Fraction(value).limit_denominator(1000)
    return simple if float(simple) == value else decimal


def _name(code: int) -> str:
    called = operation_name(code)
    return {"fmin": "fmin (min)", "fmax": "fmax (max)"}.get(called, called)
