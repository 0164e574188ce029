"""Moment equations as nonlinear programs of a handful of variables.

    min 1/2 sum_k || R_k (Y_k - Phi_k theta_k) ||^2,   theta_k = g_k(theta_p)                    (1)

over bounded physical parameters theta_p, with equality constraints of the user's (Linder 2017,
Approach 5.2, (5.25)). ``eliminated``: theta_k replaced by g_k. ``lifted``: theta_k are variables,
theta_k = g_k constraints. ``linear``: theta_k alone, under the linear constraints that the image of
g_k obeys (Approach 5.1, (5.21)-(5.22)). The data enter as parameters of a program built once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.estimation.moments.equations.moment_equations import MomentEquations
from casid.estimation.nlp.nlp import Nlp
from casid.estimation.nlp.solution import Solution
from casid.estimation.nlp.solver import Solver
from casid.linear.sampled.difference_equation import DifferenceEquation
from casid.model.declarations import Parameter

Constraint = Callable[[Mapping[str, Any]], Any]


@dataclass(frozen=True, slots=True, eq=False)
class Condensed:
    """||R (Y - Phi theta)||^2 = ||left - right theta||^2 + rest, right (ntheta, ntheta)."""

    right: Array
    left: Array
    rest: float

    @classmethod
    def of(cls, equations: MomentEquations, root: Array) -> Condensed:
        """By the QR factors of R [Phi Y]: the size no longer depends on the instruments."""
        n = equations.Phi.shape[1]
        stacked = root @ np.column_stack([equations.Phi, equations.Y])
        triangle = np.linalg.qr(stacked, mode="r")
        full = np.zeros((n + 1, n + 1))
        full[: len(triangle)] = triangle[: n + 1]
        return cls(full[:n, :n], full[:n, n], float(full[n, n] ** 2))


def _data(nlp: Nlp, k: int, n: int) -> tuple[Any, Any, Any]:
    return (
        nlp.parameter(f"right{k}", n, n),
        nlp.parameter(f"left{k}", n, 1),
        nlp.parameter(f"rest{k}", 1, 1),
    )


def _given(data: Sequence[Condensed]) -> dict[str, Array]:
    out: dict[str, Array] = {}
    for k, d in enumerate(data):
        out |= {f"right{k}": d.right, f"left{k}": d.left, f"rest{k}": np.array([[d.rest]])}
    return out


class PhysicalNlp:
    """Program (1) over the physical parameters, eliminated or lifted.

    Parameters
    ----------
    equations : of each part.
    free : the parameters that are estimated, with starts and bounds.
    known : of each part, the free names that are known there (its load case).
    constraints : each takes a mapping of parameter names to symbols, returns what is to be zero.
    """

    def __init__(
        self,
        equations: Sequence[DifferenceEquation],
        free: Sequence[Parameter],
        known: Sequence[frozenset[str]],
        *,
        lifted: bool = False,
        constraints: Sequence[Constraint] = (),
        solver: Solver | None = None,
        name: str = "joint",
    ) -> None:
        nlp = Nlp(name)
        self.names = tuple(p.name for p in free)
        self._parameters = equations[0].parameters
        symbols = {
            p.name: nlp.variable(p.name, p.start, lower=p.lower, upper=p.upper) for p in free
        }
        total: Any = 0
        self._lifted = lifted
        self._g = [e.g for e in equations]
        for k, (e, fixed) in enumerate(zip(equations, known, strict=True)):
            n = len(e.coefficients)
            right, left, rest = _data(nlp, k, n)
            values = nlp.parameter(f"known{k}", len(e.parameters), 1)
            p = ca.vertcat(
                *[
                    symbols[q] if q in symbols and q not in fixed else values[i]
                    for i, q in enumerate(e.parameters)
                ]
            )
            theta = e.g(p)
            if lifted:
                own = [nlp.variable(f"{c}#{k}", 0.0, scale=1.0) for c in e.coefficients]
                lifted_theta = ca.vertcat(*own)
                for i, c in enumerate(e.coefficients):
                    nlp.equality(lifted_theta[i] - theta[i], name=f"{c}#{k} = g(parameters)")
                theta = lifted_theta
            total = total + ca.sumsqr(left - right @ theta) + rest
        nlp.minimize(total / 2)
        for i, constraint in enumerate(constraints):
            nlp.equality(constraint(symbols), name=f"constraint {i + 1}")
        self.nlp = nlp
        self._compiled = nlp.compile(solver)

    def parameters(
        self, data: Sequence[Condensed], values: Sequence[Mapping[str, float]]
    ) -> dict[str, Array]:
        """The program's data: condensed moments, and known values of each part."""
        given = _given(data)
        for k, v in enumerate(values):
            given[f"known{k}"] = np.array([v[q] for q in self._parameters])
        return given

    def solve(
        self,
        data: Sequence[Condensed],
        values: Sequence[Mapping[str, float]],
        start: Sequence[float],
        *,
        throw: bool = True,
    ) -> Solution:
        """The optimum from `start` (one value a free parameter)."""
        x0 = list(start)
        if self._lifted:
            for g, v in zip(self._g, values, strict=True):
                at = {**v, **dict(zip(self.names, start, strict=True))}
                x0 += np.asarray(g([at[q] for q in self._parameters])).ravel().tolist()
        return self._compiled.solve(self.parameters(data, values), x0, throw=throw)


class LinearNlp:
    """Program (1) over theta alone, with B theta = b."""

    def __init__(
        self,
        equations: Sequence[DifferenceEquation],
        rows: int,
        *,
        solver: Solver | None = None,
        name: str = "stage",
    ) -> None:
        nlp = Nlp(name)
        total: Any = 0
        blocks = []
        for k, e in enumerate(equations):
            n = len(e.coefficients)
            right, left, rest = _data(nlp, k, n)
            theta = ca.vertcat(*[nlp.variable(f"{c}#{k}", 0.0, scale=1.0) for c in e.coefficients])
            blocks.append(theta)
            total = total + ca.sumsqr(left - right @ theta) + rest
        nlp.minimize(total / 2)
        self.rows = rows
        if rows:
            stacked = ca.vertcat(*blocks)
            B = nlp.parameter("B", rows, stacked.numel())
            b = nlp.parameter("b", rows, 1)
            for i in range(rows):
                nlp.equality(B[i, :] @ stacked - b[i], name=f"row {i + 1} of B theta = b")
        self.nlp = nlp
        self._compiled = nlp.compile(solver)

    def parameters(self, data: Sequence[Condensed], B: Array, b: Array) -> dict[str, Array]:
        """The program's data."""
        given = _given(data)
        if self.rows:
            given |= {"B": B, "b": b}
        return given

    def solve(
        self, data: Sequence[Condensed], B: Array, b: Array, start: Array, *, throw: bool = True
    ) -> Solution:
        """The optimum; `start` (sum ntheta,)."""
        # A quadratic program: Ipopt's step is Newton's, there is nothing left to polish.
        return self._compiled.solve(
            self.parameters(data, B, b), start.tolist(), throw=throw, polish=False
        )
