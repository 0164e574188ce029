"""State-space realisation of transfer functions, and their McMillan degree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from casid.algebra import polynomial as poly
from casid.algebra.minors import pole_polynomial
from casid.algebra.rational import Rational
from casid.arrays import Array
from casid.errors import ModelError

Matrices = tuple[Array, Array, Array, Array]


class TransferFunctions(Protocol):
    """The attributes of a `RationalMatrix` that a realisation needs."""

    @property
    def rows(self) -> tuple[tuple[Rational, ...], ...]:
        """m rows of n transfer functions."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the rows."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the columns."""

    @property
    def time(self) -> tuple[str, float | None]:
        """Variable and sample time."""


@dataclass(frozen=True, slots=True)
class _Single:
    """One transfer function as a matrix."""

    function: Rational
    outputs: tuple[str, ...] = ("y1",)
    inputs: tuple[str, ...] = ("u1",)

    @property
    def rows(self) -> tuple[tuple[Rational, ...], ...]:
        return ((self.function,),)

    @property
    def time(self) -> tuple[str, float | None]:
        return self.function.variable, self.function.Ts


def state_space(function: Rational | TransferFunctions) -> Any:
    """A `control.StateSpace`, minimal where there is one output or one input.

    One output: observer form over the least common denominator of entries that share poles, block
    by block. One input: its transpose. Several of both: the smaller of rows in observer form and
    columns in controller form, which need not be minimal (`mcmillan_degree` has the least order).

    Raises
    ------
    ModelError
        If an entry is improper, or parameters have no value.
    """
    import control

    matrix = _Single(function) if isinstance(function, Rational) else function
    A, B, C, D = matrices(matrix)
    variable, Ts = matrix.time
    dt: Any = {"s": 0, "": None}.get(variable, Ts or True)
    return control.StateSpace(
        A,
        B,
        C,
        D,
        dt,
        inputs=list(matrix.inputs),
        outputs=list(matrix.outputs),
        remove_useless_states=False,
    )


def matrices(matrix: TransferFunctions) -> Matrices:
    """(A, B, C, D) of `state_space` as arrays."""
    _refuse(matrix)
    rows = matrix.rows
    columns = tuple(zip(*rows, strict=True))
    by_row, by_column = _order(rows), _order(columns)
    if by_row <= by_column:
        return _observer_form(rows)
    A, B, C, D = _observer_form(columns)
    return A.T, C.T, B.T, D.T


def mcmillan_degree(function: Rational | TransferFunctions) -> int:
    """The least number of states, exactly; poles at infinity counted for improper functions."""
    rows = ((function,),) if isinstance(function, Rational) else function.rows
    # The degree does not change under q = 1/x + a, and a proper matrix has its poles at finite x
    # once a is no pole.
    if all(g.is_proper for row in rows for g in row):
        return poly.degree(pole_polynomial(rows))
    a = next(
        k
        for k in range(2, 1000)
        if all(poly.evaluate(g.denominator, k) != 0 for row in rows for g in row)
    )
    moved = tuple(tuple(_moved(g, a) for g in row) for row in rows)
    return poly.degree(pole_polynomial(moved))


def _moved(g: Rational, a: int) -> Rational:
    from fractions import Fraction

    above: poly.Polynomial = (Fraction(a), Fraction(1))  # q = (a x + 1) / x
    below: poly.Polynomial = (Fraction(1), Fraction(0))
    top, bottom = (poly.compose_ratio(p, above, below) for p in (g.numerator, g.denominator))
    excess = poly.degree(g.denominator) - poly.degree(g.numerator)
    for _ in range(abs(excess)):
        top, bottom = (
            (poly.multiply(top, below), bottom)
            if excess > 0
            else (top, poly.multiply(bottom, below))
        )
    return Rational(top, bottom, "q")


def _refuse(matrix: TransferFunctions) -> None:
    for y, row in zip(matrix.outputs, matrix.rows, strict=True):
        for u, g in zip(matrix.inputs, row, strict=True):
            if g.parameters:
                raise ModelError(
                    f"{y} / {u} = {g}: a realisation needs a value for {', '.join(g.parameters)}"
                )
            if not g.is_proper:
                raise ModelError(
                    f"{y} / {u} = {g} is improper, so it has no state-space realisation; delay it "
                    f"by {-g.relative_degree} samples, or filter it by as many poles"
                )


def _order(rows: Any) -> int:
    return sum(poly.degree(poly.common_multiple(g.denominator for g in row)) for row in rows)


def _observer_form(rows: Any) -> Matrices:
    m, n = len(rows), len(rows[0])
    blocks = [(i, *_block(row, group, n)) for i, row in enumerate(rows) for group in _groups(row)]
    N = sum(len(a) for _, a, _ in blocks)
    A, B, C = np.zeros((N, N)), np.zeros((N, n)), np.zeros((m, N))
    start = 0
    for i, a, b in blocks:
        stop = start + len(a)
        A[start:stop, start:stop], B[start:stop] = a, b
        C[i, start] = 1.0
        start = stop
    D = np.array([[float(g.direct) for g in row] for row in rows]).reshape(m, n)
    return A, B, C, D


def _groups(row: Any) -> list[list[int]]:
    """Entries with states, those that share a pole together.

    What shares none is realised apart: one companion matrix of many poles would lose digits.
    """
    groups: list[list[int]] = []
    for k, g in enumerate(row):
        if poly.degree(g.denominator) < 1:
            continue
        near = [group for group in groups if any(_share_a_pole(g, row[other]) for other in group)]
        groups = [group for group in groups if group not in near]
        groups.append([*(other for group in near for other in group), k])
    return groups


def _share_a_pole(g: Rational, h: Rational) -> bool:
    return poly.degree(poly.common_divisor(g.denominator, h.denominator)) > 0


def _block(row: Any, group: list[int], n: int) -> tuple[Array, Array]:
    """A and B of one group of a row in observer form."""
    below = poly.common_multiple(row[k].denominator for k in group)
    order = poly.degree(below)
    A, B = np.zeros((order, order)), np.zeros((order, n))
    A[:, 0] = [-float(c) for c in below[1:]]
    A[:-1, 1:] = np.eye(order - 1)
    for k in group:
        fill = poly.divide(below, row[k].denominator)[0]
        rest = poly.add(poly.multiply(row[k].numerator, fill), poly.scale(below, -row[k].direct))
        B[order - len(rest) :, k] = [float(c) for c in rest]
    return A, B
