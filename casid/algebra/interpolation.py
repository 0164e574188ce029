"""A rational function interpolated from its values in prime fields.

Degrees by variable come from lines, coefficients from linear equations with one variable more at a
time, so that only terms that are there grow; the rational coefficients come from several primes.
Source: R. Zippel, Probabilistic algorithms for sparse polynomials, EUROSAM 1979, 216-226.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np

from casid.algebra.factoring import factored
from casid.algebra.prime_field import null_space, random_prime, to_rational
from casid.algebra.rational_degrees import univariate_degrees
from casid.arrays import Array
from casid.errors import ModelError

Monomial: TypeAlias = tuple[int, ...]
Function: TypeAlias = Callable[[Mapping[str, int], int], Array]
"""(values of the variables modulo p, p) -> (m,) values of m functions modulo p; it raises
ZeroDivisionError where it is not defined."""

LINE_POINTS = (2, 6, 10, 16, 24, 40)
"""Points on a line until the degrees have settled: numerator + denominator up to 37."""

POINTS_TRIED = 100
"""Random points tried in turn: a function of k square roots exists at one in 2^k."""

LONGEST_FACTORED = 200
"""A numerator or denominator of more terms than this is left as a sum."""


@dataclass(frozen=True, slots=True)
class RationalFunction:
    """numerator / denominator, each a mapping of exponents (one for each variable) to fractions."""

    variables: tuple[str, ...]
    numerator: Mapping[Monomial, Fraction]
    denominator: Mapping[Monomial, Fraction]

    def at(self, values: Mapping[str, int], p: int) -> int:
        """Value modulo p; ZeroDivisionError where the denominator is zero."""
        top, bottom = (
            sum(
                c.numerator * pow(c.denominator, -1, p) * _power_product(self.variables, e, values)
                for e, c in part.items()
            )
            for part in (self.numerator, self.denominator)
        )
        if bottom % p == 0:
            raise ZeroDivisionError("the denominator is zero here")
        return top * pow(bottom, -1, p) % p

    def to_sympy(self) -> Any:
        """The function in sympy symbols of the variables' names, factored if it is not too long."""
        return self._expression(self.numerator) / self._expression(self.denominator)

    def _expression(self, part: Mapping[Monomial, Fraction]) -> Any:
        used = [j for j in range(len(self.variables)) if any(e[j] for e in part)]
        return _factored(
            tuple(self.variables[j] for j in used),
            tuple((tuple(e[j] for j in used), c) for e, c in part.items()),
        )


@lru_cache(maxsize=256)  # entries of one null direction share denominators
def _factored(variables: tuple[str, ...], terms: tuple[tuple[Monomial, Fraction], ...]) -> Any:
    import sympy

    symbols = [sympy.Symbol(v) for v in variables]
    total = sympy.Add(
        *(
            sympy.Rational(c.numerator, c.denominator)
            * sympy.Mul(*(s**n for s, n in zip(symbols, e, strict=True)))
            for e, c in terms
        )
    )
    return factored(total) if len(terms) <= LONGEST_FACTORED else total


def _power_product(variables: Sequence[str], exponents: Monomial, values: Mapping[str, int]) -> int:
    product = 1
    for v, n in zip(variables, exponents, strict=True):
        product *= values[v] ** n
    return product


@dataclass(slots=True)
class Samples:
    """Values of m functions at random points modulo one prime, each evaluated once."""

    function: Function
    variables: tuple[str, ...]
    p: int
    rng: np.random.Generator
    anchor: dict[str, int] = field(default_factory=dict)
    evaluations: int = 0
    _kept: dict[Any, tuple[list[list[int]], list[Array]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # On a line through a point where the function is not defined it may be defined nowhere.
        (point,), _ = self._at(self.variables, 1)
        self.anchor = dict(zip(self.variables, point, strict=True))

    def line(self, variable: str, count: int) -> tuple[list[int], Array]:
        """Values (count, m) where one variable runs and all others stay at the anchor."""
        points, values = self._at((variable,), count)
        return [point[0] for point in points], np.array(values)

    def where_vary(self, variables: Sequence[str], count: int) -> tuple[Array, Array]:
        """Points (count, n) of the variables that vary and values (count, m)."""
        points, values = self._at(tuple(variables), count)
        return np.array(points, dtype=np.int64).reshape(count, len(variables)), np.array(values)

    def _draw(self, n: int) -> list[int]:
        return [int(v) for v in self.rng.integers(1, self.p, n)]

    def _at(self, variables: tuple[str, ...], count: int) -> tuple[list[list[int]], list[Array]]:
        points, values = self._kept.setdefault(variables, ([], []))
        failed = 0
        while len(points) < count:
            point = self._draw(len(variables))
            try:
                value = self.function(
                    self.anchor | dict(zip(variables, point, strict=True)), self.p
                )
            except ZeroDivisionError:
                failed += 1
                if failed > POINTS_TRIED:
                    raise ModelError(
                        f"{failed} random points in turn divide by zero: the function is defined "
                        "at almost no point; choose other free parameters"
                    ) from None
                continue
            failed = 0
            self.evaluations += 1
            points.append(point)
            values.append(np.asarray(value, dtype=np.int64))
        return points[:count], values[:count]


def interpolate(
    function: Function,
    variables: Sequence[str],
    *,
    seed: int = 0,
    primes: Sequence[int] | None = None,
    max_unknowns: int = 600,
) -> tuple[RationalFunction | None, ...]:
    """All m components of a function as rational functions, or None where one is too large.

    Parameters
    ----------
    function : see `Function`; all components are evaluated at once.
    variables : names the function may depend on.
    primes : primes to use, at least two; random ones by default.
    max_unknowns : components that need more coefficients than this at a time are given up (None),
        and those whose degree in a variable (numerator and denominator together) exceeds 37.

    Returns
    -------
    m functions of the variables they depend on, coefficients in Q, each found modulo one or more
    primes and verified at fresh points modulo another one.
    """
    rng = np.random.default_rng(seed)
    fields = _Fields(function, tuple(variables), rng, list(primes or ()))
    degrees = _degrees(fields[0])
    return tuple(
        None if d is None else _interpolate_one(fields, i, d, max_unknowns)
        for i, d in enumerate(degrees)
    )


@dataclass(slots=True)
class _Fields:
    """Samples modulo the first, second, ... prime, made when they are needed."""

    function: Function
    variables: tuple[str, ...]
    rng: np.random.Generator
    primes: list[int]
    samples: list[Samples] = field(default_factory=list)

    def __getitem__(self, k: int) -> Samples:
        while len(self.samples) <= k:
            k_new = len(self.samples)
            while len(self.primes) <= k_new:
                candidate = random_prime(self.rng)
                if candidate not in self.primes:
                    self.primes.append(candidate)
            self.samples.append(
                Samples(self.function, self.variables, self.primes[k_new], self.rng)
            )
        return self.samples[k]


def _degrees(samples: Samples) -> list[dict[str, tuple[int, int]] | None]:
    """By component: variable -> degrees of numerator and denominator, those that matter."""
    _, first = samples.where_vary(samples.variables, 2)
    found: list[dict[str, tuple[int, int]] | None] = [{} for _ in range(first.shape[1])]
    varying = {int(i) for i in np.flatnonzero(first[0] != first[1])}
    for variable in samples.variables:
        _, values = samples.line(variable, LINE_POINTS[0])
        open_ = {i for i in varying if found[i] is not None and values[0, i] != values[1, i]}
        for count in LINE_POINTS[1:]:
            if not open_:
                break
            t, values = samples.line(variable, count)
            for i in sorted(open_):
                pair = univariate_degrees(t, [int(v) for v in values[:, i]], samples.p)
                if pair is not None:
                    degrees = found[i]
                    assert degrees is not None
                    degrees[variable] = pair
                    open_.discard(i)
        for i in open_:
            found[i] = None
    return found


def _interpolate_one(
    fields: _Fields, i: int, degrees: Mapping[str, tuple[int, int]], max_unknowns: int
) -> RationalFunction | None:
    variables = tuple(degrees)
    terms = _terms(fields[0], i, degrees, max_unknowns)
    if terms is None:
        return None
    modulus, combined = 1, [0] * sum(map(len, terms))
    for k in range(8):
        solved = _solve(fields[k], i, variables, terms)
        if solved is None:
            continue
        combined, modulus = _chinese(combined, modulus, solved, fields[k].p)
        fractions = [to_rational(c, modulus) for c in combined]
        if any(c is None for c in fractions):
            continue
        known = [c for c in fractions if c is not None]
        n = len(terms[0])
        function = RationalFunction(
            variables,
            dict(zip(terms[0], known[:n], strict=True)),
            dict(zip(terms[1], known[n:], strict=True)),
        )
        if _agrees(function, fields[k + 1], i):
            return function
    return None


Terms: TypeAlias = tuple[list[Monomial], list[Monomial]]


def _terms(
    samples: Samples, i: int, degrees: Mapping[str, tuple[int, int]], max_unknowns: int
) -> Terms | None:
    """Monomials that are there, found with one variable more at a time, the rest at the anchor."""
    terms: Terms = ([()], [()])
    names = tuple(degrees)
    for j, variable in enumerate(names):
        grown: Terms = (
            [(*e, n) for e in terms[0] for n in range(degrees[variable][0] + 1)],
            [(*e, n) for e in terms[1] for n in range(degrees[variable][1] + 1)],
        )
        if len(grown[0]) + len(grown[1]) > max_unknowns:
            return None
        solved = _solve(samples, i, names[: j + 1], grown)
        if solved is None:
            return None
        n = len(grown[0])
        terms = (
            [e for e, c in zip(grown[0], solved[:n], strict=True) if c],
            [e for e, c in zip(grown[1], solved[n:], strict=True) if c],
        )
    return terms


def _solve(samples: Samples, i: int, variables: Sequence[str], terms: Terms) -> list[int] | None:
    """Coefficients of numerator and denominator, the denominator's last nonzero one being 1."""
    p, unknowns = samples.p, sum(map(len, terms))
    points, values = samples.where_vary(variables, unknowns + 2)
    top, bottom = (_monomials(points, part, p) for part in terms)
    null = null_space(np.hstack([top, -bottom * values[:, i, None] % p]), p)
    if null.shape[0] != 1:
        return None
    leading = [int(c) for c in null[0] if c][-1]
    return [int(c) * pow(leading, -1, p) % p for c in null[0]]


def _monomials(points: Array, exponents: Sequence[Monomial], p: int) -> Array:
    """(count, number of monomials) values modulo p."""
    out = np.ones((points.shape[0], len(exponents)), dtype=np.int64)
    for j in range(points.shape[1]):
        e = np.array([m[j] for m in exponents])
        power = np.ones(points.shape[0], dtype=np.int64)
        for n in range(int(e.max(initial=0)) + 1):
            here = e == n
            out[:, here] = out[:, here] * power[:, None] % p
            power = power * points[:, j] % p
    return out


def _chinese(
    combined: Sequence[int], modulus: int, solved: Sequence[int], p: int
) -> tuple[list[int], int]:
    """Numbers modulo modulus * p with the two given remainders."""
    step = modulus * pow(modulus, -1, p) if modulus > 1 else 1
    total = modulus * p
    return [(c + (s - c) * step) % total for c, s in zip(combined, solved, strict=True)], total


def _agrees(function: RationalFunction, samples: Samples, i: int) -> bool:
    points, values = samples.where_vary(samples.variables, 3)
    try:
        return all(
            function.at(
                dict(zip(samples.variables, (int(v) for v in point), strict=True)), samples.p
            )
            == int(value)
            for point, value in zip(points, values[:, i], strict=True)
        )
    except (ZeroDivisionError, ValueError):  # this prime divides a denominator: not proven
        return False
