"""The affine hull of theta = g(theta_p) with a proof, symbolically.

theta_i = num_i / den with polynomials in the free parameters, so B theta = b for all of them is
sum_i B_i num_i = b den, coefficient by coefficient: B and b are the null space of the matrix of
coefficients, over the field of rational functions of the known parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np

from casid.algebra.symbolic import exact, rational_operations, walk
from casid.arrays import Array
from casid.errors import ModelError
from casid.linear.hulls.linear_constraints import coefficient_names, largest_one
from casid.linear.hulls.parameter_draws import check_names, count_of_coefficients

_DEGREE = 30  # of numerators and denominators that may be expanded


@dataclass(frozen=True, slots=True, eq=False)
class SymbolicHull:
    """The affine hull with a proof: B theta = b identically in the free parameters.

    Attributes
    ----------
    B, b : sympy matrices (m, n) and (m, 1), in the known parameters' symbols, row echelon with
        pivots 1. They hold where no denominator of theirs and of g vanishes.
    known : names of the known parameters that occur in them.
    """

    B: Any
    b: Any
    coefficients: tuple[str, ...]
    free: tuple[str, ...]
    known: tuple[str, ...]
    _rows: Callable[..., Any] = field(repr=False)

    @property
    def rank(self) -> int:
        """The number of independent linear constraints."""
        return int(self.B.rows)

    @property
    def dimension(self) -> int:
        """Dimension of the hull: coefficients minus linear constraints."""
        return len(self.coefficients) - self.rank

    def numeric(self, values: Mapping[str, float]) -> tuple[Array, Array]:
        """B (m, n) and b (m,) at the known values, the largest entry of each row 1.

        Raises
        ------
        ModelError
            If a known parameter has no value, or a denominator vanishes at the values.
        """
        lacking = [name for name in self.known if name not in values]
        if lacking:
            raise ModelError(
                f"the constraints need the known value of {', '.join(lacking)}; add it to `values`"
            )
        n = len(self.coefficients)
        with np.errstate(all="ignore"):
            rows = self._rows(*[np.float64(values[name]) for name in self.known])
        full = np.array(rows, dtype=float).reshape(-1, n + 1)
        if not np.all(np.isfinite(full)):
            raise ModelError(
                "a constraint divides by a parameter combination that is zero at the known values; "
                "call affine_hull at these values instead"
            )
        full = largest_one(full, n)
        return full[:, :n], 0.0 - full[:, n]

    def __str__(self) -> str:
        lines = [
            f"Coefficients {', '.join(self.coefficients)} with {', '.join(self.free) or 'nothing'} "
            f"free: linear constraints {self.rank}, hull of dimension {self.dimension}, proved"
        ]
        for i in range(self.rank):
            terms = [
                name if entry == 1 else f"({entry}) {name}"
                for entry, name in zip(self.B.row(i), self.coefficients, strict=True)
                if entry != 0
            ]
            lines.append(f"  {' + '.join(terms)} = {self.b[i]}")
        return "\n".join(lines)


def symbolic_hull(
    g: ca.Function,
    parameters: Sequence[str],
    values: Mapping[str, float],
    free: Sequence[str] | str,
    *,
    coefficients: Sequence[str] = (),
    limit: int = 5000,
) -> SymbolicHull:
    """Prove the linear constraints: theta_i = num_i / den with polynomials in the free parameters.

    B theta = b for all free parameters is sum_i B_i num_i = b den, coefficient by coefficient: B
    and b are the null space of the matrix of coefficients, over the field of rational functions of
    the known parameters.

    Parameters
    ----------
    g, parameters, free, coefficients : as `affine_hull`.
    values : known parameters that are numbers, as the shortest decimal that gives the float; a
        known parameter without a value stays a symbol: ``{}`` gives the constraints symbolically.
    limit : largest number of terms in a numerator or denominator on the way.

    Raises
    ------
    ModelError
        If a name is wrong, g is not rational, or its polynomials are too large: more terms than
        `limit`, or a degree beyond 30 (an exact hold's matrix exponential, even as the quotient of
        polynomials that approximates it). `affine_hull` has neither limit.
    """
    import sympy
    from sympy.polys.matrices import DomainMatrix

    free = (free,) if isinstance(free, str) else tuple(free)
    check_names(parameters, values, free)
    n = count_of_coefficients(g, parameters)
    names = coefficient_names(coefficients, n)
    # A field needs a generator, even where all parameters are numbers.
    names_of_symbols = [p for p in parameters if p in free or p not in values] or [parameters[0]]
    columns = _polynomials(g, parameters, values, names_of_symbols, free, limit)
    known = [sympy.Symbol(name) for name in names_of_symbols if name not in free]
    K = sympy.QQ.frac_field(*known) if known else sympy.QQ
    table = _by_free_monomial(columns, [name in free for name in names_of_symbols], K)
    matrix = DomainMatrix(table, (len(table), n + 1), K)
    basis = matrix.nullspace().rref()[0].to_Matrix()
    B = basis[:, :n].applyfunc(sympy.factor)
    b = (-basis[:, n:]).applyfunc(sympy.factor)
    both = B.row_join(-b)
    occurring = [s for s in known if s in both.free_symbols]
    return SymbolicHull(
        B=B,
        b=b,
        coefficients=names,
        free=tuple(free),
        known=tuple(str(s) for s in occurring),
        _rows=sympy.lambdify(occurring, list(both), modules="numpy", cse=True),
    )


def _polynomials(
    g: ca.Function,
    parameters: Sequence[str],
    values: Mapping[str, float],
    symbolic: Sequence[str],
    free: Sequence[str],
    limit: int,
) -> list[Any]:
    """num_1 .. num_n and den of theta_i = num_i / den, polynomials in the `symbolic` parameters."""
    import sympy

    numbers = {p: exact(float(values[p])) for p in parameters if p not in symbolic}
    if free:
        _check_degree(g, parameters, numbers)
    quotients = sympy.QQ.frac_field(*map(sympy.Symbol, symbolic))
    inputs = [
        quotients(_qq(numbers[p])) if p in numbers else quotients.from_sympy(sympy.Symbol(p))
        for p in parameters
    ]
    theta = _walk(g, inputs, quotients, lambda q: _check_terms(q, limit))
    den = quotients.field.ring.one
    for t in theta:
        den = den.lcm(t.denom)
    columns = [t.numer * den.exquo(t.denom) for t in theta] + [den]
    for column in columns:
        _check_terms(quotients(column), limit)
    return columns


def _by_free_monomial(columns: list[Any], is_free: list[bool], K: Any) -> list[list[Any]]:
    """A row for each monomial in the free parameters; its entries hold the known ones, in K."""
    table: dict[tuple[int, ...], list[Any]] = {}
    for j, polynomial in enumerate(columns):
        for powers, value in polynomial.terms():
            row = tuple(e for e, f in zip(powers, is_free, strict=True) if f)
            rest = tuple(e for e, f in zip(powers, is_free, strict=True) if not f)
            entry = value if all(is_free) else K.field.ring({rest: value})
            entries = table.setdefault(row, [K.zero] * len(columns))
            entries[j] = entries[j] + K(entry)
    return list(table.values())


def _qq(fraction: Fraction) -> Any:
    from sympy import QQ

    return QQ(fraction.numerator, fraction.denominator)


def _walk(
    g: ca.Function, inputs: list[Any], quotients: Any, check: Callable[[Any], None]
) -> list[Any]:
    """g on quotients of polynomials, each result on the way checked."""

    def guarded(operation: Callable[..., Any]) -> Callable[..., Any]:
        """The operation, with its result checked."""

        def run(*arguments: Any) -> Any:
            result = operation(*arguments)
            check(result)
            return result

        return run

    def power(base: Any, exponent: Any) -> Any:
        """A whole power of a quotient of polynomials; refused where the exponent is another."""
        if not (exponent.numer.is_ground and exponent.denom.is_ground):
            raise ModelError(
                "a parameter occurs in an exponent; such coefficients are not rational, so use "
                "affine_hull"
            )
        number = exponent.numer.LC / exponent.denom.LC if exponent.numer else 0
        if number != int(number):
            raise ModelError(f"a power with the exponent {number} is not rational; use affine_hull")
        return base ** int(number)

    operations = {code: guarded(op) for code, op in rational_operations(power).items()}
    return walk(g, [inputs], operations, lambda v: quotients(_qq(exact(v))))[0]


def _check_terms(quotient: Any, limit: int) -> None:
    if len(quotient.numer) + len(quotient.denom) > limit:
        raise ModelError(
            f"the coefficients have numerators of more than {limit} terms, too many to prove the "
            "constraints; give more known parameters as numbers in `values`, raise `limit`, or use "
            "affine_hull"
        )


def _check_degree(
    g: ca.Function, parameters: Sequence[str], numbers: Mapping[str, Fraction]
) -> None:
    """Refuse high degrees early: along a line a + b t of the parameters there is one symbol."""
    import sympy

    t = sympy.Symbol("t")
    quotients = sympy.QQ.frac_field(t)
    inputs = [
        quotients(_qq(numbers[p]))
        if p in numbers
        else quotients.from_sympy(3 + i + (7 + 2 * i) * t)
        for i, p in enumerate(parameters)
    ]

    def check(quotient: Any) -> None:
        """Refuse a quotient of a degree too high for the proof."""
        if max(quotient.numer.degree(), quotient.denom.degree()) > _DEGREE:
            raise ModelError(
                f"the coefficients are polynomials of a degree beyond {_DEGREE}, too large to "
                "prove the constraints (exact holds are of this kind); use "
                "affine_hull, or discretise with the bilinear transform"
            )

    _walk(g, inputs, quotients, check)
