"""The affine hull of theta = g(theta_p) with a proof, in letters.

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

from casid.errors import ModelError
from casid.linear_constraints import coefficient_names, largest_one
from casid.parameter_draws import check_names, count_of_coefficients
from casid.symbolic import exact, rational_operations, walk

Array = np.ndarray[Any, Any]


@dataclass(frozen=True, slots=True, eq=False)
class SymbolicHull:
    """The affine hull with a proof: B theta = b identically in the free parameters.

    Attributes
    ----------
    B, b : sympy matrices (m, n) and (m, 1), in the known parameters' symbols, row echelon with
        pivots 1. They hold where no denominator of theirs and of g vanishes.
    known : names of the known parameters that stand in them.
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
    free: Sequence[str],
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
        known parameter without a value stays a symbol: ``{}`` gives the constraints in letters.
    limit : largest number of terms in a numerator or denominator on the way.

    Raises
    ------
    ModelError
        If a name is wrong, g is not rational (an exact hold has exponentials), or the polynomials
        outgrow `limit`; `affine_hull` minds neither.
    """
    import sympy
    from sympy.polys.matrices import DomainMatrix

    check_names(parameters, values, free)
    n = count_of_coefficients(g, parameters)
    names = coefficient_names(coefficients, n)
    letters = [p for p in parameters if p in free or p not in values]
    if not letters:
        letters = [parameters[0]]  # a field needs a generator
    symbols = {name: sympy.Symbol(name) for name in letters}
    quotients = sympy.QQ.frac_field(*symbols.values())
    inputs = [
        quotients.from_sympy(symbols[p])
        if p in free or p not in values
        else quotients(_rational_of(p, values))
        for p in parameters
    ]
    theta = walk(g, [inputs], _field_operations(limit), lambda v: quotients(_qq(exact(v))))[0]
    ring = quotients.field.ring
    den = ring.one
    for t in theta:
        den = den.lcm(t.denom)
    columns = [t.numer * den.exquo(t.denom) for t in theta] + [den]
    if max(len(c) for c in columns) > limit:
        raise _too_large(limit)
    # Monomials split into their free part, a row of the matrix, and their known part, its entries.
    is_free = [name in free for name in letters]
    known = [symbols[name] for name in letters if name not in free]
    K = sympy.QQ.frac_field(*known) if known else sympy.QQ
    table: dict[tuple[int, ...], list[Any]] = {}
    for j, polynomial in enumerate(columns):
        for powers, value in polynomial.terms():
            row = tuple(e for e, f in zip(powers, is_free, strict=True) if f)
            rest = tuple(e for e, f in zip(powers, is_free, strict=True) if not f)
            entry = K.field.ring({rest: value}) if known else value
            entries = table.setdefault(row, [K.zero] * (n + 1))
            entries[j] = entries[j] + K(entry)
    matrix = DomainMatrix(list(table.values()), (len(table), n + 1), K)
    basis = matrix.nullspace().rref()[0].to_Matrix()
    B = basis[:, :n].applyfunc(sympy.factor)
    b = (-basis[:, n:]).applyfunc(sympy.factor)
    both = B.row_join(-b)
    letters = [s for s in known if s in both.free_symbols]
    return SymbolicHull(
        B=B,
        b=b,
        coefficients=names,
        free=tuple(free),
        known=tuple(str(s) for s in letters),
        _rows=sympy.lambdify(letters, list(both), modules="numpy", cse=True),
    )


def _qq(fraction: Fraction) -> Any:
    from sympy import QQ

    return QQ(fraction.numerator, fraction.denominator)


def _rational_of(name: str, values: Mapping[str, float]) -> Any:
    return _qq(exact(float(values[name])))


def _too_large(limit: int) -> ModelError:
    return ModelError(
        f"the coefficients have numerators of more than {limit} terms, too many to prove the "
        "constraints; give more known parameters as numbers in `values`, raise `limit`, or be "
        "content with affine_hull"
    )


def _field_operations(limit: int) -> dict[int, Callable[..., Any]]:
    """Operations on quotients of polynomials, guarded against their growth."""

    def guarded(operation: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any) -> Any:
            result = operation(*arguments)
            if len(result.numer) + len(result.denom) > limit:
                raise _too_large(limit)
            return result

        return run

    def power(base: Any, exponent: Any) -> Any:
        if not (exponent.numer.is_ground and exponent.denom.is_ground):
            raise ModelError(
                "a parameter stands in an exponent; such coefficients are not rational"
            )
        number = exponent.numer.LC / exponent.denom.LC if exponent.numer else 0
        if number != int(number):
            raise ModelError(f"a power with the exponent {number} is not rational; use affine_hull")
        return base ** int(number)

    return {code: guarded(op) for code, op in rational_operations(power).items()}
