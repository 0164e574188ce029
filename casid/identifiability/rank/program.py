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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any, Literal

import casadi as ca

from casid.errors import ModelError
from casid.identifiability.rank.system import System
from casid.linear.symbolic import exact

Kind = Literal["sum", "product", "primitive"]
Terms = dict[int, Fraction]  # node -> coefficient; node -1 is the number 1

ONE = -1
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
    _drop_unused(program)
    return program


class _Reader:
    """Reads instructions; a register is a linear combination of nodes."""

    def __init__(self, name: str, program: Program) -> None:
        self.name, self.program = name, program
        self.immersed: list[str] = []
        self._known: dict[Any, int] = {}  # what a node computes -> the node
        self._sine: dict[int, tuple[int, int]] = {}
        self._scales: dict[Any, list[Fraction]] = {}  # direction -> of its exponentials
        self._units: dict[Any, Fraction] = {}  # direction -> all its scales are multiples of that

    def read(self, function: Any) -> list[Terms]:
        """The linear combination of each output of an SX function of one vector."""
        register: list[Terms] = [{} for _ in range(function.sz_w())]
        results: list[Terms] = [{} for _ in range(function.nnz_out(0))]
        for i in range(function.n_instructions()):
            code = function.instruction_id(i)
            source, target = function.instruction_input(i), function.instruction_output(i)
            if code == ca.OP_INPUT:
                register[target[0]] = {source[1]: Fraction(1)}
            elif code == ca.OP_OUTPUT:
                results[target[1]] = register[source[0]]
            elif code == ca.OP_CONST:
                register[target[0]] = self._number(function.instruction_constant(i))
            else:
                arguments = [register[j] for j in source]
                register[target[0]] = self._operation(code, *arguments)
        return results

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
        special = _SPECIAL.get(code)
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
            constant = _constant(one)
            if constant is not None:
                return {n: c * constant for n, c in other.items() if c * constant}
        if len(a) == 1 and len(b) == 1:  # coefficients stay outside
            ((m, c),), ((n, d),) = a.items(), b.items()
        else:
            (m, c), (n, d) = (self.node(a), Fraction(1)), (self.node(b), Fraction(1))
        pair = (min(m, n), max(m, n))
        return {self._new("product", pair, pair): c * d}

    def _inverse(self, a: Terms) -> Terms:
        constant = _constant(a)
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
        exponent = _constant(b)
        if exponent is None:
            return self.exp(self._product(b, self.log(a)))
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
        return self._adjoined(f"power {exponent}", a, self._power_slope(a, exponent), "free")

    def _power_slope(self, a: Terms, exponent: Fraction) -> Callable[[int], Terms]:
        def slope(s: int) -> Terms:
            ratio = self._product({s: exponent}, self._inverse(a))
            return ratio

        return slope

    def sqrt(self, a: Terms) -> Terms:
        """sqrt(a): g = 1 / (2 s)."""

        def slope(s: int) -> Terms:
            return {n: c / 2 for n, c in self._inverse({s: Fraction(1)}).items()}

        return self._adjoined("sqrt", a, slope, "root")

    def exp(self, a: Terms) -> Terms:
        """exp(a): g = s. exp(k a) is a power of exp(a), so that exp(a) exp(-a) stays one."""
        if _constant(a) == 0:
            return _UNIT
        first = a[min(a)]
        direction = tuple(sorted((n, c / first) for n, c in a.items()))
        self._scales.setdefault(direction, []).append(first)
        unit = self._units.get(direction, first)
        times = first / unit
        if times.denominator != 1 or abs(times) > MAX_RELATED:
            unit, times = first, Fraction(1)
        base = self._adjoined("exp", _scaled(a, unit / first), lambda s: {s: Fraction(1)}, "free")
        return self._power(base, {ONE: times})

    def has_related_exponentials(self) -> bool:
        """True if arguments are multiples of one another: read again, with their common unit."""
        for direction, scales in self._scales.items():
            if len(set(scales)) > 1:
                self._units[direction] = _common_unit(scales)
        return bool(self._units)

    def log(self, a: Terms) -> Terms:
        """log(a): g = 1/a."""
        return self._adjoined("log", a, lambda _: self._inverse(a), "free")

    def sine(self, a: Terms) -> tuple[Terms, Terms]:
        """sin(a) and cos(a), which are each other's slope."""
        if a and a[min(a)] < 0:
            sine_, cosine_ = self.sine(_scaled(a, -1))
            return _scaled(sine_, -1), cosine_
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
        constant = _constant(a)
        if constant is not None:
            return {ONE: Fraction(1 if constant > 0 else -1)} if constant else {}
        first = a[min(n for n in a if n != ONE)]
        if first != 1:
            turned = self.sign({n: c / first for n, c in a.items()})
            return turned if first > 0 else _scaled(turned, -1)
        n = self.node(a)
        key = ("sign", n)
        if key not in self._known:
            self._known[key] = self._append()
            self.program.kinks[self._known[key]] = n
        return {self._known[key]: Fraction(1)}

    def one_over(self, a: Terms) -> Terms:
        """1/a, for the functions of `_SPECIAL`."""
        return self._inverse(a)

    def times(self, a: Terms, b: Terms) -> Terms:
        """a b, for the functions of `_SPECIAL`."""
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


def _common_unit(numbers: Sequence[Fraction]) -> Fraction:
    """The largest number of which all are multiples."""
    denominator = math.lcm(*(x.denominator for x in numbers))
    return Fraction(math.gcd(*(int(x * denominator) for x in numbers)), denominator)


def _constant(a: Terms) -> Fraction | None:
    if not a:
        return Fraction(0)
    return a[ONE] if len(a) == 1 and ONE in a else None


def _added(a: Terms, b: Terms, sign: int = 1) -> Terms:
    total = dict(a)
    for n, c in b.items():
        total[n] = total.get(n, Fraction(0)) + sign * c
        if not total[n]:
            del total[n]
    return total


def _scaled(a: Terms, factor: Fraction | int) -> Terms:
    return {n: c * factor for n, c in a.items()}


def _nearest(value: float, name: str) -> Fraction:
    """The decimal that reads back as this float; thirds and the like as what they are."""
    decimal = exact(value) if value == value else None
    if decimal is None:
        raise ModelError(f"{name}: a number in the equations is {value}; mend it")
    simple = Fraction(value).limit_denominator(1000)
    return simple if float(simple) == value else decimal


def _name(code: int) -> str:
    for name in dir(ca):
        if name.startswith("OP_") and getattr(ca, name) == code:
            return name[3:].lower()
    return f"operation {code}"


_LINEAR: Mapping[int, Callable[..., Terms]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: _added,
    ca.OP_SUB: lambda a, b: _added(a, b, -1),
    ca.OP_NEG: lambda a: _scaled(a, -1),
    ca.OP_TWICE: lambda a: _scaled(a, 2),
}

_UNIT: Terms = {ONE: Fraction(1)}


def _tan(r: _Reader, a: Terms) -> Terms:
    sine, cosine = r.sine(a)
    return r.times(sine, r.one_over(cosine))


def _sinh(r: _Reader, a: Terms) -> Terms:
    e = r.exp(a)
    return _scaled(_added(e, r.one_over(e), -1), Fraction(1, 2))


def _cosh(r: _Reader, a: Terms) -> Terms:
    e = r.exp(a)
    return _scaled(_added(e, r.one_over(e)), Fraction(1, 2))


def _tanh(r: _Reader, a: Terms) -> Terms:
    e = r.exp(a)
    e = r.times(e, e)
    return r.times(_added(e, _UNIT, -1), r.one_over(_added(e, _UNIT)))


def _square(r: _Reader, a: Terms) -> Terms:
    return r.times(a, a)


def _asin(r: _Reader, a: Terms) -> Terms:
    return r.integral("asin", a, r.one_over(r.sqrt(_added(_UNIT, _square(r, a), -1))))


def _acos(r: _Reader, a: Terms) -> Terms:
    slope = r.one_over(r.sqrt(_added(_UNIT, _square(r, a), -1)))
    return r.integral("acos", a, _scaled(slope, -1))


def _atan(r: _Reader, a: Terms) -> Terms:
    return r.integral("atan", a, r.one_over(_added(_UNIT, _square(r, a))))


def _asinh(r: _Reader, a: Terms) -> Terms:
    return r.integral("asinh", a, r.one_over(r.sqrt(_added(_square(r, a), _UNIT))))


def _acosh(r: _Reader, a: Terms) -> Terms:
    return r.integral("acosh", a, r.one_over(r.sqrt(_added(_square(r, a), _UNIT, -1))))


def _atanh(r: _Reader, a: Terms) -> Terms:
    return r.integral("atanh", a, r.one_over(_added(_UNIT, _square(r, a), -1)))


def _atan2(r: _Reader, a: Terms, b: Terms) -> Terms:
    return _atan(r, r.times(a, r.one_over(b)))


def _erf(r: _Reader, a: Terms) -> Terms:
    # 2/sqrt(pi) is a factor that no rank sees.
    return r.integral("erf", a, r.exp(_scaled(_square(r, a), -1)))


_SPECIAL: Mapping[int, Callable[..., Terms]] = {
    ca.OP_SQRT: _Reader.sqrt,
    ca.OP_EXP: _Reader.exp,
    ca.OP_LOG: _Reader.log,
    ca.OP_LOG1P: lambda r, a: r.log(_added(a, _UNIT)),
    ca.OP_EXPM1: lambda r, a: _added(r.exp(a), _UNIT, -1),
    ca.OP_SIN: lambda r, a: r.sine(a)[0],
    ca.OP_COS: lambda r, a: r.sine(a)[1],
    ca.OP_TAN: _tan,
    ca.OP_SINH: _sinh,
    ca.OP_COSH: _cosh,
    ca.OP_TANH: _tanh,
    ca.OP_ASIN: _asin,
    ca.OP_ACOS: _acos,
    ca.OP_ATAN: _atan,
    ca.OP_ATAN2: _atan2,
    ca.OP_ASINH: _asinh,
    ca.OP_ACOSH: _acosh,
    ca.OP_ATANH: _atanh,
    ca.OP_ERF: _erf,
    ca.OP_HYPOT: lambda r, a, b: r.sqrt(_added(_square(r, a), _square(r, b))),
    ca.OP_SIGN: _Reader.sign,
    ca.OP_FABS: lambda r, a: r.times(r.sign(a), a),
}


def _drop_unused(program: Program) -> None:
    """Forget nodes that nothing needs, and number the others without gaps."""
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
