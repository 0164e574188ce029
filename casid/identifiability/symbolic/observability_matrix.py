"""The extended observability matrix (2), in readable algebra.

    O = d(y, y', ..., y^(K)) / d(x, theta)                                                      (2)

with the Lie derivatives y^(k) of `lie_derivatives`. Parameters are locally identifiable where
their columns of O, with those of the unknown states, are independent.
Source: Linder (2017), section 2.7, (2.64), after Hermann and Krener (1977) and Anguelova (2007).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

from casid.argument_types import names_wrong_types
from casid.errors import ModelError, nearest
from casid.identifiability.equations.system import System
from casid.identifiability.symbolic.lie_derivatives import Budget, output_derivatives
from casid.identifiability.symbolic.reduced_form import (
    ReducedForm,
    derivative_name,
    latex_table,
)
from casid.identifiability.symbolic.symbolic_rank import Profile, profile, reduced_row_echelon, tidy
from casid.presentation import Presented

Expr = Any  # a sympy expression
Matrix = Any  # a sympy matrix


@names_wrong_types(ModelError)
def observability_matrix(
    system: System,
    orders: int | None = None,
    *,
    limit_seconds: float = 30.0,
    seed: int = 0,
) -> ObservabilityMatrix:
    """The extended observability matrix (2) of a system.

    States with known initial value have no column. Where values are special (`initial_values`,
    `at`), they are inserted after differentiation, and `orders` must be given: no number of
    derivatives is known to be enough there.

    Parameters
    ----------
    orders : highest time derivative K of every output. By default as many as add to the rank, at
        most nx + n_theta - 1: where one more adds nothing, none ever will, because the span of the
        rows is then closed under (1). (Inputs must be free: this holds at almost every point.)
    limit_seconds : time after which the system is refused as too large; checked between steps.
    seed : of the random points that the rank is evaluated at.

    Raises
    ------
    ModelError
        If the system is too large, has unknown inputs or functions without a derivative, or is
        has special values without `orders`.

    Example
    -------
    >>> import casid
    >>> decay = {"states": ["x"], "params": ["a"], "equations": {"x": "-a*x"},
    ...          "outputs": {"y": "x"}}
    >>> print(casid.observability_matrix(casid.parse_system(decay)))
    Extended observability matrix of equations: 2 x 2, rank 2
         x   a
    y    1   0
    y'  -a  -x
    """
    import sympy

    _check_system(system, orders)
    budget = Budget(system.name, limit_seconds)
    columns = [*system.states, *system.parameters]
    known = {*system.known_initial, *system.initial_values}
    special = {sympy.Symbol(n): _rational(v) for n, v in _special(system).items()}
    blocks: list[Matrix] = []
    reached = 0
    highest = max(len(columns) - 1, 0) if orders is None else orders
    for order, derivative in enumerate(output_derivatives(system, budget)):
        blocks.append(derivative.jacobian([sympy.Symbol(c) for c in columns]))
        if orders is None:
            rank = profile(sympy.Matrix.vstack(*blocks), seed=seed).rank
            budget.check(f"the rank with derivative {order}")
            if order > 0 and rank == reached:
                blocks.pop()
                break
            reached = rank
            if rank == len(columns):
                break
        if order == highest:
            break
    kept = [j for j, c in enumerate(columns) if c not in known]
    rows = [(y, k) for k in range(len(blocks)) for y in system.outputs]
    raw = sympy.Matrix.vstack(*blocks).extract(list(range(len(rows))), kept)
    entries = []
    for entry in raw:
        budget.check("the entries")
        entries.append(_at_special(tidy(entry), special, system.name))
    return ObservabilityMatrix(
        system=system.name,
        matrix=sympy.ImmutableMatrix(len(rows), len(kept), entries),
        rows=tuple(rows),
        columns=tuple(columns[j] for j in kept),
        states=tuple(s for s in system.states if s not in known),
        seed=seed,
    )


@dataclass(frozen=True, eq=False)
class ObservabilityMatrix(Presented):
    """Extended observability matrix (2), symbolic; its verdicts hold at almost every point.

    Attributes
    ----------
    matrix : (m, n) sympy matrix.
    rows : (m,) pairs (output, order of its time derivative), order by order.
    columns : (n,) names, states with unknown initial value before parameters.
    states : those of the columns that are states.
    """

    system: str
    matrix: Matrix
    rows: tuple[tuple[str, int], ...]
    columns: tuple[str, ...]
    states: tuple[str, ...]
    seed: int = 0

    @property
    def parameters(self) -> tuple[str, ...]:
        """The columns that are parameters."""
        return tuple(c for c in self.columns if c not in self.states)

    @property
    def orders(self) -> int:
        """Highest time derivative of an output."""
        return max((k for _, k in self.rows), default=0)

    def entry(self, output: str, order: int, column: str) -> Expr:
        """The derivative of the order-th time derivative of an output by a state or parameter."""
        if (output, order) not in self.rows:
            raise ModelError(
                f"{self.system}: no row {derivative_name(output, order)!r}; there are "
                f"{', '.join(derivative_name(*r) for r in self.rows)}"
            )
        return self.matrix[self.rows.index((output, order)), self._place(column)]

    def rank(self) -> int:
        """Rank at almost every point, decided in exact numbers (`symbolic_rank`)."""
        return self._profile.rank

    def only(self, *parameters: str) -> ObservabilityMatrix:
        """The columns of the states and of these parameters, the others being known (7.22)."""
        for p in parameters:
            self._place(p)
        return self._columns([*self.states, *parameters])

    def without(self, *columns: str) -> ObservabilityMatrix:
        """The matrix without these columns: their states or parameters are known."""
        for c in columns:
            self._place(c)
        return self._columns([c for c in self.columns if c not in columns])

    def row_reduced(self) -> ReducedForm:
        """Reduced row echelon form, as in (7.20)-(7.23); the first columns become pivots."""
        return self._reduced

    def null_directions(self) -> tuple[Mapping[str, Expr], ...]:
        """Unobservable directions v, O v = 0: name -> component where not zero.

        Without common denominators and factors, in the system's symbols; as many as the rank
        lacks. {"I_x": 1, "I_xm": -1} means that one inertia may grow as the other shrinks.
        """
        import sympy

        reduced = self._reduced
        free = [j for j in range(len(self.columns)) if j not in reduced.pivots]
        directions = []
        for j in free:
            vector = {self.columns[j]: sympy.Integer(1)}
            for i, pivot in enumerate(reduced.pivots):
                if reduced.matrix[i, j] != 0:
                    vector[self.columns[pivot]] = -reduced.matrix[i, j]
            ordered = {c: vector[c] for c in self.columns if c in vector}
            directions.append(_without_common_factor(ordered))
        return tuple(directions)

    def identifiable(self) -> dict[str, bool]:
        """Parameter -> True if locally identifiable at almost every point."""
        return {p: self._is_seen(p) for p in self.parameters}

    def observable(self) -> dict[str, bool]:
        """State -> True if its initial value is locally observable at almost every point."""
        return {s: self._is_seen(s) for s in self.states}

    def to_latex(self) -> str:
        """The matrix as a LaTeX array, labelled."""
        return latex_table(self.matrix, self.row_names, self.columns)

    def __repr__(self) -> str:
        m, n = self.matrix.shape
        return f"<ObservabilityMatrix {self.system}: {m} x {n}, derivatives 0..{self.orders}>"

    @cached_property
    def _profile(self) -> Profile:
        return profile(self.matrix, seed=self.seed)

    @cached_property
    def _reduced(self) -> ReducedForm:
        matrix, pivots = reduced_row_echelon(self.matrix, seed=self.seed)
        return ReducedForm(self.system, matrix.as_immutable(), self.columns, pivots)

    @property
    def row_names(self) -> list[str]:
        """The output or its derivative in each row."""
        return [derivative_name(*row) for row in self.rows]

    def _place(self, column: str) -> int:
        if column not in self.columns:
            near = nearest(column, self.columns)
            raise ModelError(f"{self.system}: the matrix has no column {column!r}{near}")
        return self.columns.index(column)

    def _columns(self, names: list[str]) -> ObservabilityMatrix:
        kept = self.matrix.extract(list(range(len(self.rows))), [self._place(c) for c in names])
        states = tuple(c for c in names if c in self.states)
        return ObservabilityMatrix(self.system, kept, self.rows, tuple(names), states, self.seed)

    def _is_seen(self, column: str) -> bool:
        there, j = self._profile, self._place(column)
        return j in there.pivots and int(there.support[there.pivots.index(j)].sum()) == 1


def _check_system(system: System, orders: int | None) -> None:
    if orders is not None and orders < 0:
        raise ModelError(f"{system.name}: orders = {orders}; give 0 or more, or None")
    if not system.states and not system.parameters:
        raise ModelError(
            f"{system.name} has neither states nor parameters, so nothing can be assessed; "
            "name the unknown parameters in `parameters`"
        )
    if system.unknown_inputs:
        raise ModelError(
            f"{system.name}: {system.unknown_inputs[0]!r} is an unknown input, and this matrix "
            "takes known ones; eliminate it with an output (Model.eliminate), or use "
            "casid.assess_identifiability, which distinguishes the classes of unknown inputs"
        )
    if not system.is_generic and orders is None:
        raise ModelError(
            f"{system.name}: values are special ({', '.join(_special(system))}), where no number "
            "of derivatives is known to be enough; give orders=..., or use "
            "casid.assess_identifiability"
        )


def _special(system: System) -> dict[str, Fraction]:
    return {**system.initial_values, **system.at}


def _at_special(entry: Expr, special: Mapping[Any, Expr], system: str) -> Expr:
    """An entry where special values are put in."""
    import sympy

    if not special:
        return entry
    value = entry.subs(special)
    if value.has(sympy.zoo, sympy.nan, sympy.oo):
        raise ModelError(
            f"{system}: {entry} has no value where "
            + ", ".join(f"{s} = {v}" for s, v in special.items())
            + "; look at another point"
        )
    return tidy(value)


def _rational(value: Fraction) -> Expr:
    import sympy

    return sympy.Rational(value.numerator, value.denominator)


def _without_common_factor(direction: Mapping[str, Expr]) -> dict[str, Expr]:
    """The direction without denominators and common factors, its first component positive."""
    import sympy

    entries = list(direction.values())
    denominator = sympy.lcm_list([sympy.fraction(e)[1] for e in entries])
    cleared = [sympy.cancel(e * denominator) for e in entries]
    common = sympy.gcd_list(cleared)
    if sympy.cancel(cleared[0] / common).could_extract_minus_sign():
        common = -common
    return {n: tidy(sympy.cancel(e / common)) for n, e in zip(direction, cleared, strict=True)}
