"""The result of a solver comparison: one row a solver."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from casid.arrays import Array, finite_or_none
from casid.errors import UnknownNameError
from casid.presentation import Presented, present


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One solver on one problem."""

    solver: str
    status: str
    objective: float
    violation: float  # largest, of any constraint, in its own units
    distance: float  # largest |x - x_ref| / |x_ref| of a variable
    scaled_gradient: float
    iterations: int  # 0: the solver does not report it
    evaluations: int  # of the objective; 0: the solver does not report it
    seconds: float  # one solve, the solver being built
    x: Array | None  # (n,), physical units
    agrees: bool
    reason: str  # why it does not agree; empty where it does

    def to_json(self) -> dict[str, Any]:
        """Plain values; what is not finite becomes None."""
        numbers = ("objective", "violation", "distance", "scaled_gradient", "seconds")
        return {
            "solver": self.solver,
            "status": self.status,
            **{key: finite_or_none(getattr(self, key)) for key in numbers},
            "iterations": self.iterations,
            "evaluations": self.evaluations,
            "x": None if self.x is None else [finite_or_none(v) for v in self.x],
            "agrees": self.agrees,
            "reason": self.reason,
        }


@dataclass(frozen=True, slots=True, eq=False)
class SolverComparison(Presented):
    """Every solver's answer to one problem beside a reference."""

    problem: str
    names: tuple[str, ...]
    rows: tuple[Row, ...]
    reference: Array | None  # (n,), None where no solver met the constraints
    reference_from: str
    objective: float  # at the reference
    tolerance: float

    def __getitem__(self, solver: str) -> Row:
        for row in self.rows:
            if row.solver == solver:
                return row
        known = ", ".join(row.solver for row in self.rows)
        raise UnknownNameError(f"{solver!r} did not take part; those that did: {known}")

    @property
    def agreeing(self) -> tuple[str, ...]:
        """Solvers within the tolerance of the reference."""
        return tuple(row.solver for row in self.rows if row.agrees)

    @property
    def is_feasible(self) -> bool:
        """Whether any solver met the constraints."""
        return self.reference is not None

    def __repr__(self) -> str:
        ran = sum(row.x is not None for row in self.rows)
        return (
            f"<SolverComparison {self.problem}: {len(self.agreeing)} of {ran} solvers agree within "
            f"{self.tolerance:g}>"
        )

    def cells(self) -> list[tuple[str, ...]]:
        """The table as text, its first row the head."""
        head = ("solver", "objective", "violation", "distance", "iterations", "evaluations", "ms")
        lines: list[tuple[str, ...]] = [(*head, "status")]
        lines += [
            (
                row.solver,
                _number(row.objective, ".10g"),
                _number(row.violation, ".1e"),
                _number(row.distance, ".1e"),
                str(row.iterations or "--"),
                str(row.evaluations or "--"),
                _number(1e3 * row.seconds, ".2f"),
                row.status,
            )
            for row in self.rows
        ]
        return lines

    def to_json(self) -> dict[str, Any]:
        """Plain values; what is not finite becomes None."""
        return {
            "schema": "casid.solver_comparison/1",
            "problem": self.problem,
            "names": list(self.names),
            "reference": None if self.reference is None else [float(v) for v in self.reference],
            "reference_from": self.reference_from,
            "objective": finite_or_none(self.objective),
            "tolerance": self.tolerance,
            "rows": [row.to_json() for row in self.rows],
        }

    def plot(self) -> Any:
        """Plotly figure: distance to the reference against time, a point for each solver."""
        return present(self, "figure")


def _number(value: float, form: str) -> str:
    """A number for the table."""
    return format(value, form) if math.isfinite(value) else "--"
