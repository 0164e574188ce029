"""A matrix of rational transfer functions as a value."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.algebra.control_reader import control_entries
from casid.algebra.minors import inverse, normal_rank, pole_polynomial, zero_polynomial
from casid.algebra.rational import Rational, common_time, rational
from casid.algebra.realisation import state_space
from casid.algebra.roots import Root, roots_of
from casid.arrays import Array
from casid.errors import ModelError


@dataclass(frozen=True, slots=True, eq=False)
class RationalMatrix:
    """Rows of `Rational`, all in one variable with one sample time.

    Attributes
    ----------
    rows : m rows of n transfer functions.
    outputs, inputs : names of rows and columns; "y1", "u1" and so on by default.
    """

    rows: tuple[tuple[Rational, ...], ...]
    outputs: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        m = len(self.rows)
        n = len(self.rows[0]) if m else len(self.inputs)
        ragged = [i for i, row in enumerate(self.rows) if len(row) != n]
        if ragged:
            raise ModelError(
                f"row {ragged[0]} of a transfer matrix has {len(self.rows[ragged[0]])} entries, "
                f"row 0 has {n}; give every row as many"
            )
        for what, names, count in (("outputs", self.outputs, m), ("inputs", self.inputs, n)):
            if names and len(names) != count:
                raise ModelError(f"{len(names)} {what} are named of a {m} x {n} transfer matrix")
        object.__setattr__(self, "outputs", self.outputs or tuple(f"y{i + 1}" for i in range(m)))
        object.__setattr__(self, "inputs", self.inputs or tuple(f"u{i + 1}" for i in range(n)))
        self.time  # noqa: B018 - refuses entries that do not fit each other

    @property
    def shape(self) -> tuple[int, int]:
        """Outputs and inputs."""
        return len(self.outputs), len(self.inputs)

    @property
    def time(self) -> tuple[str, float | None]:
        """Variable ("q", "s", or "" for constants) and sample time that all entries share.

        Raises
        ------
        ModelError
            If two entries differ in them.
        """
        return shared_time([g for row in self.rows for g in row])

    def __getitem__(self, place: tuple[int, int]) -> Rational:
        return self.rows[place[0]][place[1]]

    def select(self, rows: Sequence[int], columns: Sequence[int]) -> RationalMatrix:
        """The submatrix of the rows and columns numbered."""
        return RationalMatrix(
            tuple(tuple(self.rows[i][k] for k in columns) for i in rows),
            tuple(self.outputs[i] for i in rows),
            tuple(self.inputs[k] for k in columns),
        )

    # -- values ------------------------------------------------------------------------------

    def at(self, q: Any) -> list[list[Any]]:
        """The values at one point, exact at an int or a Fraction."""
        return [[g.at(q) for g in row] for row in self.rows]

    def response(self, points: Any) -> Array:
        """(F, m, n) values at (F,) complex points of the plane of q (or s)."""
        return self._stacked(lambda g: g.response(np.ravel(points)), np.size(points))

    def frequency_response(self, omega: Any) -> Array:
        """(F, m, n) values at (F,) frequencies [rad/s]; [rad/sample] where Ts is not stated."""
        Ts = self.time[1] or 1.0
        w = np.ravel(np.asarray(omega, dtype=float))
        return self.response(1j * w if self.time[0] == "s" else np.exp(1j * w * Ts))

    @property
    def direct(self) -> list[list[Any]]:
        """The direct term, entry by entry: lim at infinity.

        Raises
        ------
        ModelError
            If an entry is improper.
        """
        return [[g.direct for g in row] for row in self.rows]

    def substitute(self, values: Mapping[str, Any]) -> RationalMatrix:
        """Parameters replaced by numbers."""
        return self._each(lambda g: g.substitute(values))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the symbols without a value, sorted."""
        return tuple(sorted({n for row in self.rows for g in row for n in g.parameters}))

    # -- properties --------------------------------------------------------------------------

    @property
    def is_proper(self) -> bool:
        """Whether every entry has a limit at infinity."""
        return all(g.is_proper for row in self.rows for g in row)

    @property
    def is_stable(self) -> bool:
        """Whether every entry's poles are stable."""
        return all(g.is_stable for row in self.rows for g in row)

    def rank(self) -> int:
        """Normal rank: the rank at almost every point (exact, over rational functions)."""
        return normal_rank(self.rows)

    def poles(self) -> tuple[Root, ...]:
        """Poles with their multiplicities: roots of the least common denominator of all minors."""
        return roots_of([float(c) for c in pole_polynomial(self.rows)], *self.time)

    def zeros(self) -> tuple[Root, ...]:
        """Transmission zeros: where the matrix loses rank (Smith-McMillan form)."""
        return roots_of([float(c) for c in zero_polynomial(self.rows)], *self.time)

    # -- algebra -----------------------------------------------------------------------------

    def __matmul__(self, other: RationalMatrix) -> RationalMatrix:
        if self.shape[1] != other.shape[0]:
            raise ModelError(
                f"a {self.shape[0]} x {self.shape[1]} transfer matrix cannot multiply one of "
                f"{other.shape[0]} x {other.shape[1]}: the inner dimensions differ"
            )
        zero = Rational(())
        rows = tuple(
            tuple(
                sum((g * h for g, h in zip(row, column, strict=True)), zero)
                for column in zip(*other.rows, strict=True)
            )
            for row in self.rows
        )
        return RationalMatrix(rows, self.outputs, other.inputs)

    def __add__(self, other: RationalMatrix) -> RationalMatrix:
        if self.shape != other.shape:
            raise ModelError(f"transfer matrices of {self.shape} and {other.shape} cannot be added")
        rows = tuple(
            tuple(g + h for g, h in zip(a, b, strict=True))
            for a, b in zip(self.rows, other.rows, strict=True)
        )
        return RationalMatrix(rows, self.outputs, self.inputs)

    def __neg__(self) -> RationalMatrix:
        return self._each(lambda g: -g)

    def __sub__(self, other: RationalMatrix) -> RationalMatrix:
        return self + -other

    def inverse(self) -> RationalMatrix:
        """The inverse of a square matrix; it may be improper or unstable, see its properties.

        Raises
        ------
        ModelError
            If the matrix is not square, or singular at every q.
        """
        return RationalMatrix(inverse(self.rows), self.inputs, self.outputs)

    def equals(self, other: RationalMatrix) -> bool:
        """Whether two matrices are the same, decided exactly."""
        return all(g.is_zero for row in (self - other).rows for g in row)

    def state_space(self) -> Any:
        """A `control.StateSpace` of it, see `casid.algebra.realisation`."""
        return state_space(self)

    def __str__(self) -> str:
        return "\n".join(
            [repr(self)]
            + [
                f"  {y} / {u} = {g}"
                for y, row in zip(self.outputs, self.rows, strict=True)
                for u, g in zip(self.inputs, row, strict=True)
                if not g.is_zero
            ]
        )

    def __repr__(self) -> str:
        variable, Ts = self.time
        where = f", in {variable}" if variable else ", constant"
        step = f", Ts = {Ts:g} s" if variable == "q" and Ts else ""
        return f"<RationalMatrix {self.shape[0]} x {self.shape[1]}{where}{step}>"

    def _each(self, change: Callable[[Rational], Rational]) -> RationalMatrix:
        rows = tuple(tuple(change(g) for g in row) for row in self.rows)
        return RationalMatrix(rows, self.outputs, self.inputs)

    def _stacked(self, values: Callable[[Rational], Array], F: int) -> Array:
        out = np.zeros((F, *self.shape), complex)
        for i, row in enumerate(self.rows):
            for k, g in enumerate(row):
                out[:, i, k] = values(g)
        return out


def transfer_matrix(
    value: Any,
    *,
    Ts: float | None = None,
    values: Mapping[str, Any] | None = None,
    outputs: Sequence[str] = (),
    inputs: Sequence[str] = (),
) -> RationalMatrix:
    """Read a transfer matrix.

    Parameters
    ----------
    value : nested rows of anything `rational` takes; a 2-d array of numbers;
        a sympy Matrix; a CasADi SX matrix in q; a MIMO `control` object; one function.
    Ts, values : sample time [s] and parameter values, as for `rational`.
    outputs, inputs : names of rows and columns.

    Raises
    ------
    ModelError
        If rows differ in length, or sample times or variables differ.
    """
    rows = tuple(tuple(rational(g, Ts=Ts, values=values) for g in row) for row in _rows(value))
    return RationalMatrix(rows, tuple(outputs), tuple(inputs))


def shared_time(functions: Sequence[Rational]) -> tuple[str, float | None]:
    """Variable and sample time that transfer functions share.

    Raises
    ------
    ModelError
        If two differ in them.
    """
    found: tuple[str, float | None] = ("", None)
    last = Rational(())
    for g in functions:
        if g.variable:
            found = common_time(last, g) if last.variable else (g.variable, g.Ts)
            if last.Ts is None or not last.variable:
                last = g
    return found


def _rows(value: Any) -> Any:
    if isinstance(value, RationalMatrix):
        return value.rows
    module = type(value).__module__
    if module.startswith("control"):
        return [[Rational(*entry) for entry in row] for row in control_entries(value)]
    if module.startswith("casadi"):
        from casid.algebra.symbolic import to_sympy

        return to_sympy(value, exact_numbers=True).tolist()
    if hasattr(value, "tolist") and np.ndim(value) != 1:
        return value.tolist() if np.ndim(value) else [[value]]
    if isinstance(value, Sequence | np.ndarray):
        flat = [row for row in value if not isinstance(row, Sequence | np.ndarray)]
        if flat:
            raise ModelError(
                "a transfer matrix is given as rows: [[g11, g12], [g21, g22]], a single row too; "
                f"{flat[0]!r} is in the place of a row"
            )
        return value
    return [[value]]
