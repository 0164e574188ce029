"""Where a solver stopped, and whether that is an optimum, whatever the solver says."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casid.arrays import TINY, Array
from casid.deprecation import renamed
from casid.errors import SolveError, UnknownNameError
from casid.model.quantities import count_text
from casid.presentation import Presented

_FLAT = (
    "the criterion hardly falls there, or has a kink: fix a parameter that has next to no effect, "
    "or try other start values (starts=...)"
)
_REMEDIES = {
    "Infeasible_Problem_Detected": "the constraints contradict each other near the start: "
    "drop one, or start from values that satisfy them",
    "Maximum_Iterations_Exceeded": "raise max_iterations, or start nearer to the solution",
    "Invalid_Number_Detected": "the model gives NaN or Inf near the start: tighten the bounds or "
    "change the start values",
    "Restoration_Failed": "the constraints cannot be met from this start: try several starts",
    "Subproblem_Failed": "its quadratic program has no solution here: use Solver('ipopt')",
    "Solve_Succeeded": _FLAT,
    "Search_Direction_Becomes_Too_Small": _FLAT,
    "Maximum_WallTime_Exceeded": "give it more time, or fit a shorter window",
    "Diverging_Iterates": "a parameter runs to infinity: give it bounds, or fix it",
}


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """A criterion, its derivatives and its own constraints at one point."""

    value: float
    gradient: Array  # (n,)
    hessian: Array  # (n, n), Gauss-Newton or exact, symmetric
    constraints: Array = field(default_factory=lambda: np.zeros(0))  # (m,), to be zero
    jacobian: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (m, n)


def stacked(at: Evaluation, constraints: Array, jacobian: Array) -> Evaluation:
    """A criterion at one point, with further constraints (m,) and their Jacobian (m, n)."""
    n = len(at.gradient)
    return Evaluation(
        at.value,
        at.gradient,
        at.hessian,
        np.concatenate([at.constraints, constraints]),
        np.vstack([at.jacobian.reshape(-1, n), jacobian.reshape(-1, n)]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Solution(Presented):
    """Where a solver stopped, why, and whether that is an optimum."""

    names: tuple[str, ...]
    x: Array  # (n,) physical units
    value: float
    status: str
    iterations: int
    scaled_gradient: float  # largest |dL/dx_i| / sqrt(H_ii f): 0 at an optimum, without units
    constraint_violation: float
    at_lower: tuple[str, ...]
    at_upper: tuple[str, ...]
    hessian: Array  # (n, n) of the criterion at x
    constraint_jacobian: Array  # (m, n)
    solver: str
    evaluations: int = 0  # of the objective, 0 where the solver does not count them

    @property
    def is_converged(self) -> bool:
        """True if the scaled gradient vanishes and the constraints hold, whatever the status."""
        return bool(self.scaled_gradient < 1e-5 and self.constraint_violation < 1e-6)

    @property
    def remedy(self) -> str:
        """The remedy where the solver did not converge."""
        return _REMEDIES.get(
            self.status, "try other start values (starts=...), bounds, or fix a parameter"
        )

    mend = renamed("mend", "remedy")

    @property
    def ending(self) -> str:
        """Where the solver stopped short of the minimum, in words."""
        if self.status.startswith("Solve"):  # it holds that it did not
            return f"{self.solver} ended short of the minimum of the criterion"
        return f"{self.solver} stopped with {self.status}"

    @property
    def active(self) -> Mapping[str, str]:
        """Variables that a bound holds -> "lower", "upper" or "lower and upper"."""
        sides = {"lower": self.at_lower, "upper": self.at_upper}
        held = {n: [s for s, names in sides.items() if n in names] for n in self.names}
        return {name: " and ".join(found) for name, found in held.items() if found}

    @property
    def is_free(self) -> Array:
        """(n,) bool, False for variables that a bound holds."""
        held = self.active
        return np.array([name not in held for name in self.names], dtype=bool)

    def __getitem__(self, name: str) -> float:
        if name not in self.names:
            near = difflib.SequenceMatcher(b=str(name))

            def unlike(known: str) -> float:
                near.set_seq1(known)
                return -near.ratio()

            ordered = ", ".join(sorted(self.names, key=unlike))
            raise UnknownNameError(
                f"{name!r} is no variable; give one of these, nearest first: {ordered}"
            )
        return float(self.x[self.names.index(name)])

    def __repr__(self) -> str:
        state = "converged" if self.is_converged else "not converged"
        return (
            f"<Solution of {len(self.names)} variables, {state}: value {self.value:.6g}, "
            f"{self.solver} {self.status}>"
        )

    @property
    def account(self) -> str:
        """Solver, status and iterations."""
        return f"{self.solver}, {self.status} after {count_text(self.iterations, 'iteration')}"


def not_finite(program: str, names: Sequence[str], x: Array) -> SolveError:
    """The refusal of a start without a value."""
    return SolveError(
        f"{program}: the criterion is not finite at the start "
        f"({', '.join(f'{k} = {v:g}' for k, v in zip(names, x, strict=True))}); "
        "change the start values or tighten the bounds"
    )


def not_converged(program: str, solution: Solution) -> SolveError:
    """The refusal of a point that is no optimum: the solver's reason, the measures and a remedy."""
    return SolveError(
        f"{program}: {solution.ending} after {solution.iterations} iterations (scaled gradient "
        f"{solution.scaled_gradient:.1e}, constraint violation "
        f"{solution.constraint_violation:.1e}): {solution.remedy}"
    )


def is_at_bound(gap: Any, gain: Any, scale: Any, bound: Any, value: Any) -> Any:
    """Whether variables are at a bound: of arrays, or of CasADi expressions.

    An interior-point solver stops where the way that is left to the bound gains nothing. With a
    parameter that matters little that is before it is within a millionth of its scale.

    Parameters
    ----------
    gap, gain : way to the bound, and how fast the criterion falls along it.
    bound : its size.
    value : of the criterion.
    """
    fall = gain * gap
    is_next_to = gap <= 1e-6 * scale
    gains_nothing = (0.0 < fall) * (fall <= 1e-9 * abs(value)) * (gap <= 1e-4 * (scale + bound))
    return (is_next_to + gains_nothing) > 0


def judged(
    names: tuple[str, ...],
    x: Array,
    at: Evaluation,
    scale: Array,
    box: tuple[Array, Array, Array, Array],
    ending: tuple[str, int, int],
    solver: str,
) -> Solution:
    """The point where a solver stopped, its optimality measured apart from the solver's verdict.

    `at` holds the criterion with all constraints at `x` (n,); `box` the lower and upper bounds of
    the variables (n,) and limits of the constraints (m,); `ending` the solver's status, iterations
    and evaluations.
    """
    lower, upper, low, high = box
    with np.errstate(invalid="ignore"):  # no slope towards a bound at infinity
        at_lower = is_at_bound(x - lower, at.gradient, scale, abs(lower), at.value)
        at_upper = is_at_bound(upper - x, -at.gradient, scale, abs(upper), at.value)
    to_lower, to_upper = low - at.constraints, high - at.constraints
    violation = float(max(to_lower.max(initial=0.0), -to_upper.min(initial=0.0)))
    if not np.isfinite(at.constraints).all():
        violation = float("inf")
    size = _scaled_gradient(
        at, at.jacobian, to_lower, to_upper, np.maximum(np.abs(x), scale), at_lower, at_upper
    )
    return assembled(names, x, at, (size, violation), (at_lower, at_upper), ending, solver)


def assembled(
    names: tuple[str, ...],
    x: Array,
    at: Evaluation,
    optimality: tuple[float, float],
    held: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    ending: tuple[str, int, int],
    solver: str,
) -> Solution:
    """The `Solution` at `x` from what was measured there.

    `optimality` holds the scaled gradient and the constraint violation, `held` which variables
    their lower and upper bounds hold (n,), `ending` is as in `judged`.
    """
    status, iterations, evaluations = ending
    size, violation = optimality
    at_lower, at_upper = (
        tuple(n for n, is_held in zip(names, side.tolist(), strict=True) if is_held)
        for side in held
    )
    return Solution(
        names=names,
        x=x,
        value=at.value,
        status=status,
        iterations=iterations,
        scaled_gradient=size,
        constraint_violation=violation,
        at_lower=at_lower,
        at_upper=at_upper,
        hessian=at.hessian,
        constraint_jacobian=at.jacobian,
        solver=solver,
        evaluations=evaluations,
    )


def account(stats: Mapping[str, Any]) -> tuple[str, int, int]:
    """Status in words, iterations and evaluations of the objective, as far as a solver reports."""
    status = stats.get("return_status")
    if not isinstance(status, str):  # a number, or nothing: the word that all plug-ins share
        words = {"SOLVER_RET_SUCCESS": "Solved", "SOLVER_RET_LIMITED": "Limit_Reached"}
        unified = str(stats.get("unified_return_status", ""))
        status = "Solved" if stats.get("success") else words.get(unified, "Not_Solved")
    counters = ("n_call_nlp_f", "n_call_nlp_fg", "n_call_nlp_psi")
    return status, int(stats.get("iter_count", 0)), sum(int(stats.get(c, 0)) for c in counters)


def _scaled_gradient(
    at: Evaluation,
    jacobian: Array,
    to_lower: Array,
    to_upper: Array,
    size: Array,
    at_lower: Array,
    at_upper: Array,
) -> float:
    """Largest |dL/dx_i| / sqrt(H_ii f), a number without units that vanishes at an optimum.

    Multipliers of active constraints are found by least squares in the metric of H: the solver's
    own are in its scaling, and not every plug-in returns them. `size` (n,) is what each variable
    weighs, `to_lower` and `to_upper` (m,) the way from the constraints to their limits.
    """
    h, raw = np.diag(at.hessian), at.gradient
    finite = [np.all(np.isfinite(v)) for v in (at.value, raw, h, jacobian)]
    if not all(finite):
        return float("inf")
    level = abs(at.value) + float(np.max(np.abs(raw) * size, initial=0.0))
    # A variable without curvature of its own (a linear objective) is measured by what f gains when
    # the variable changes by its size.
    curved = h * size**2 > 1e-12 * level
    root = np.sqrt(np.where(curved, h, 1.0))
    weight = np.where(curved, 1 / root, size / np.sqrt(level or 1.0))
    # Where f vanishes (data without noise) no direction of the gradient means anything: a Newton
    # step below 1e-9 of the variable is then converged.
    unit = np.where(
        curved, np.maximum(np.sqrt(abs(at.value)), 1e-4 * root * size), np.sqrt(level or 1.0)
    )
    rows = jacobian * weight
    length = np.linalg.norm(rows, axis=1)
    rows = rows / np.where(length > 0, length, 1.0)[:, None]
    tolerance = 1e-6 * np.maximum(np.abs(jacobian) @ size, TINY)
    near_lower, near_upper = np.abs(to_lower) < tolerance, np.abs(to_upper) < tolerance
    equality = to_lower == to_upper
    active = np.flatnonzero(equality | near_lower | near_upper)
    free = ~(at_lower | at_upper)
    gradient = raw * weight
    if not len(active) and np.any((h * size**2 < -1e-12 * level) & free):
        return float("inf")  # a maximum along that variable
    while len(active):  # leave out the inequalities that do not hold the optimum back
        lam = np.linalg.lstsq(rows[active][:, free].T, -gradient[free], rcond=None)[0]
        pulls_off = np.where(near_lower[active], lam > 1e-9, lam < -1e-9) & ~equality[active]
        if not pulls_off.any():
            gradient = gradient + rows[active].T @ lam
            break
        active = active[~pulls_off]
    gradient = np.where(at_lower, np.minimum(gradient, 0.0), gradient)
    gradient = np.where(at_upper, np.maximum(gradient, 0.0), gradient)
    return float(np.max(np.abs(gradient) / unit, initial=0.0))
