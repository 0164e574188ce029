"""Rank and reduced row echelon form of a symbolic matrix, at almost every value of its symbols.

What is zero is decided in numbers and never by simplification: at random points modulo random
primes where the entries are rational, with many digits at random points where they are not. Algebra
only writes down what the numbers have shown to be there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.algebra import prime_field
from casid.algebra.elimination import row_echelon
from casid.algebra.factoring import factored
from casid.algebra.interpolation import interpolate
from casid.arrays import Array
from casid.errors import ModelError

Expr = Any  # a sympy expression
Values = Mapping[Any, Any]

POINTS = 3
"""Random points; a rational entry of degree D is zero at all of them by chance below (D/2^30)^3."""

DIGITS = 120
"""Decimal digits where an entry is not rational; a pivot below 1e-60 of the largest is zero."""

LONGEST = 120
"""Operations of an expression above which nobody reads it, and factoring takes its time."""

ATTEMPTS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Where a symbolic (m, n) matrix of rank r has what, at almost every point.

    Attributes
    ----------
    rows, pivots : (r,) the first rows that are independent; pivot columns.
    support : (r, n) bool, True where the reduced row echelon form is not zero.
    idle : symbols that this form does not depend on (empty where entries are not rational).
    """

    rows: tuple[int, ...]
    pivots: tuple[int, ...]
    support: Array
    idle: frozenset[Any]

    @property
    def rank(self) -> int:
        """Rank at almost every point."""
        return len(self.pivots)


def profile(matrix: Any, *, seed: int = 0, find_idle: bool = False) -> Profile:
    """Rank, pivots and zero pattern of a sympy matrix at almost every value of its symbols.

    Parameters
    ----------
    matrix : (m, n) sympy matrix.
    find_idle : also look for the symbols that the reduced form does not depend on.

    Raises
    ------
    ModelError
        If the entries have no value at any of the random points tried.
    """
    entries = _Entries(matrix)
    rng = np.random.default_rng(seed)
    found: list[Profile] = []
    for _ in range(POINTS):
        arithmetic = _Prime(entries, rng) if entries.is_rational else _Digits(entries, rng)
        values, numbers = _at_some_point(entries, arithmetic)
        reduced, pivots = arithmetic.echelon(numbers)
        rows = arithmetic.echelon(numbers.T)[1]
        idle: set[Any] = set()
        if find_idle and entries.is_rational:
            idle = {s for s in entries.symbols if _is_idle(s, arithmetic, values, reduced)}
        support = arithmetic.is_nonzero(reduced)
        found.append(Profile(tuple(rows), tuple(pivots), support, frozenset(idle)))
    best = min(found, key=lambda p: (-p.rank, p.pivots, p.rows))
    alike = [p for p in found if (p.pivots, p.rows) == (best.pivots, best.rows)]
    support = np.logical_or.reduce([p.support for p in alike])
    idle_in_all = frozenset.intersection(*[p.idle for p in alike])
    return Profile(best.rows, best.pivots, support, idle_in_all)


def reduced_row_echelon(matrix: Any, *, seed: int = 0) -> tuple[Any, tuple[int, ...]]:
    """Reduced row echelon form of a sympy matrix, (r, n) without zero rows, and its r pivots.

    Rational entries are found again from their values in prime fields, which never writes down
    what would cancel; others come from elimination. All are factored.
    """
    import sympy

    there = profile(matrix, seed=seed, find_idle=True)
    r, n = there.support.shape
    reduced = sympy.zeros(r, n)
    for i, j in enumerate(there.pivots):
        reduced[i, j] = 1
    wanted = [
        (i, j) for j in range(n) if j not in there.pivots for i in range(r) if there.support[i, j]
    ]
    if wanted:
        independent = matrix.extract(list(there.rows), list(range(n)))
        found = _interpolated(independent, there, wanted, seed)
        if any(e is None for e in found):
            solved = _eliminated(independent, there.pivots)
            found = [tidy(solved[i, j]) for i, j in wanted]
        for (i, j), entry in zip(wanted, found, strict=True):
            reduced[i, j] = entry
    return reduced, there.pivots


def _interpolated(
    independent: Any, there: Profile, wanted: Sequence[tuple[int, int]], seed: int
) -> list[Expr | None]:
    """Entries of the reduced form found again from their values; None where that fails."""
    entries = _Entries(independent)
    if not entries.is_rational:
        return [None] * len(wanted)
    rng = np.random.default_rng(seed)
    idle = {s: int(rng.integers(1, prime_field.LOWEST_PRIME)) for s in there.idle}
    moving = {s.name: s for s in entries.symbols if s not in idle}
    rows, columns = zip(*wanted, strict=True)

    def values_at(values: Mapping[str, int], p: int) -> Array:
        """Entries of the reduced matrix modulo p; refused where the pivots are other ones."""
        point = idle | {s: values[n] for n, s in moving.items()}
        form, pivots = prime_field.echelon(entries.modulo(point, p), p)
        if tuple(pivots) != there.pivots:
            raise ZeroDivisionError("a pivot is zero here")
        return np.asarray(form[list(rows), list(columns)])

    return [f and f.to_sympy() for f in interpolate(values_at, list(moving), seed=seed)]


def _eliminated(independent: Any, pivots: Sequence[int]) -> Any:
    """The reduced form of independent rows, by elimination over the field of their entries."""
    import sympy
    from sympy.polys.matrices import DomainMatrix

    r, n = independent.shape
    others = [j for j in range(n) if j not in pivots]
    ordered = independent.extract(list(range(r)), [*pivots, *others])
    form = DomainMatrix.from_Matrix(ordered).to_field().rref()[0].to_Matrix()
    out = sympy.zeros(r, n)
    for k, j in enumerate([*pivots, *others]):
        out[:, j] = form[:, k]
    return out


def tidy(expression: Expr) -> Expr:
    """The expression over one denominator, both factored; left as it is where that is too long."""

    return expression if expression.count_ops() > LONGEST else factored(expression)


class _Entries:
    """The entries of a sympy matrix, column by row, as something to be evaluated."""

    def __init__(self, matrix: Any) -> None:
        self.matrix = matrix
        self.symbols = sorted(matrix.free_symbols, key=str)
        self.is_rational = all(_is_rational(e) for e in matrix)
        self._compiled: Callable[..., Any] | None = None

    def modulo(self, values: Values, p: int) -> Array:
        """(m, n) int64 values modulo p."""
        known: dict[Any, int] = {s: int(v) for s, v in values.items()}
        flat = [_modulo(e, known, p) for e in self.matrix]
        return np.array(flat, dtype=np.int64).reshape(self.matrix.shape)

    def digits(self, values: Values) -> Array:
        """(m, n) values with as many digits as mpmath now works with."""
        import sympy

        if self._compiled is None:
            self._compiled = sympy.lambdify(
                self.symbols, list(self.matrix), modules="mpmath", dummify=True
            )
        flat = self._compiled(*[values[s] for s in self.symbols])
        out = np.empty(len(flat), dtype=object)
        out[:] = flat
        return out.reshape(self.matrix.shape)


class _Prime:
    """Arithmetic modulo one random prime."""

    def __init__(self, entries: _Entries, rng: np.random.Generator) -> None:
        self.entries, self.rng, self.p = entries, rng, prime_field.random_prime(rng)

    def draw(self) -> int:
        return int(self.rng.integers(1, self.p))

    def evaluate(self, values: Values) -> Array:
        return self.entries.modulo(values, self.p)

    def echelon(self, a: Array) -> tuple[Array, list[int]]:
        return prime_field.echelon(a, self.p)

    def is_nonzero(self, a: Array) -> Array:
        return np.asarray(a != 0)

    def is_equal(self, a: Array, b: Array) -> bool:
        return np.array_equal(a, b)


class _Digits:
    """Arithmetic with `DIGITS` digits."""

    def __init__(self, entries: _Entries, rng: np.random.Generator) -> None:
        self.entries, self.rng = entries, rng

    def draw(self) -> Any:
        with _mpmath().workdps(DIGITS):
            return _mpmath().mpf(int(self.rng.integers(1, 2**62))) / 2**62

    def evaluate(self, values: Values) -> Array:
        with _mpmath().workdps(DIGITS):
            return self.entries.digits(values)

    def echelon(self, a: Array) -> tuple[Array, list[int]]:
        with _mpmath().workdps(DIGITS):
            return _echelon_in_digits(a, _mpmath().mpf(10) ** (-DIGITS // 2))

    def is_nonzero(self, a: Array) -> Array:
        flat = [abs(v) > 10.0 ** (-DIGITS // 3) for v in a.ravel()]
        return np.array(flat, dtype=bool).reshape(a.shape)

    def is_equal(self, a: Array, b: Array) -> bool:
        return a.shape == b.shape and not self.is_nonzero(a - b).any()


_Arithmetic = _Prime | _Digits


def _mpmath() -> Any:
    import mpmath

    return mpmath


def _at_some_point(entries: _Entries, arithmetic: _Arithmetic) -> tuple[dict[Any, Any], Array]:
    """A random point where every entry has a value, and the values there."""
    for _ in range(ATTEMPTS):
        values = {s: arithmetic.draw() for s in entries.symbols}
        try:
            return values, arithmetic.evaluate(values)
        except ZeroDivisionError:  # another point may do
            continue
    raise ModelError(
        f"a denominator was zero at each of {ATTEMPTS} random points; "
        "look for a division by an expression that is zero everywhere"
    )


def _is_idle(symbol: Any, arithmetic: _Arithmetic, values: Values, reduced: Array) -> bool:
    """True if the reduced form stays as it is when this symbol alone gets another value."""
    try:
        numbers = arithmetic.evaluate({**values, symbol: arithmetic.draw()})
    except ZeroDivisionError:
        return False
    return arithmetic.is_equal(arithmetic.echelon(numbers)[0], reduced)


def _is_rational(expression: Expr) -> bool:
    if expression.is_Symbol or expression.is_Rational:
        return bool(expression.is_Symbol or expression.q != 0)
    if expression.is_Pow:
        return bool(expression.exp.is_Integer) and _is_rational(expression.base)
    return bool(expression.is_Add or expression.is_Mul) and all(map(_is_rational, expression.args))


def _modulo(expression: Expr, known: dict[Any, int], p: int) -> int:
    """A rational sympy expression modulo p; `known` remembers what has been evaluated."""
    if expression in known:
        return known[expression]
    if expression.is_Rational:
        value = prime_field.to_field(int(expression.p), p)
        if expression.q != 1:
            value = value * _inverse(int(expression.q) % p, p) % p
    elif expression.is_Pow:
        base, exponent = _modulo(expression.base, known, p), int(expression.exp)
        value = pow(_inverse(base, p) if exponent < 0 else base, abs(exponent), p)
    elif expression.is_Add:
        value = sum(_modulo(a, known, p) for a in expression.args) % p
    else:
        value = 1
        for a in expression.args:
            value = value * _modulo(a, known, p) % p
    known[expression] = value
    return value


def _inverse(value: int, p: int) -> int:
    if value == 0:
        raise ZeroDivisionError("zero has no inverse")
    return pow(value, -1, p)


def _echelon_in_digits(matrix: Array, tolerance: Any) -> tuple[Array, list[int]]:
    """Reduced row echelon form with partial pivoting, rows scaled to a largest entry of one."""
    a = matrix.copy()
    for i in range(a.shape[0]):
        largest = max((abs(v) for v in a[i]), default=0)
        if largest > 0:
            a[i] = a[i] / largest
    found = row_echelon(a.tolist(), is_zero=lambda v: abs(v) <= tolerance, size=abs)
    rows = np.empty((found.rank, a.shape[1]), dtype=object)
    for i in range(found.rank):
        rows[i] = found.rows[i]
    return rows, found.pivots
