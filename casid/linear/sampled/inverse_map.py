"""The inverse map: physical parameters from the coefficients of a difference equation.

`invert` solves g(theta_p) = theta for some parameters, the others known, by Newton's method (least
squares where there are more coefficients than parameters), and differentiates the solution by the
implicit function theorem. `closed_form` lets sympy solve the continuous coefficients for the
parameters, which gives (7.37) and (7.38) of Linder (2017) for the pendulum.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from typing import Any, NoReturn

import casadi as ca
import numpy as np

from casid.algebra.factoring import factored
from casid.algebra.symbolic import exact, to_sympy
from casid.arrays import Array
from casid.errors import IdentifiabilityError, ModelError, SolveError, nearest
from casid.linear.linear_model import TransferMatrix
from casid.linear.sampled.difference_equation import DifferenceEquation
from casid.linear.sampled.discretisation import SUBSTITUTIONS, substitution

_ITERATIONS = 60
_STARTS = 24  # further starts, where the first does not converge
_TOLERANCE = 1e-13  # relative step at which the iteration ends
_ROUNDING = 1e-7  # relative step below which steps that do not shrink are rounding
_RANK = 1e-11  # a relative singular value below this is none
_DIGITS = 1e-3  # of a parameter's size: more than that from rounding of theta leaves it no digits


def invert(
    equation: DifferenceEquation,
    theta: Array,
    model_values: Mapping[str, float],
    free: Sequence[str] | str,
    start: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    *,
    weight: Array | None = None,
) -> tuple[Array, Array]:
    """The free parameters with g(theta_p) = theta, and their derivative in theta.

    Parameters
    ----------
    theta : (ntheta,) coefficients of `equation`.
    model_values : the other parameters' values; a known parameter has its own unless given here.
        Values given for free parameters are where the iteration starts.
    free : names of the parameters sought, or the name of one.
    start : where the iteration starts, before `model_values`, the model's own value or start.
    bounds : name -> (lower, upper), which the iteration does not leave; none by default.
    weight : (k, ntheta), the rows of theta - g that are made small where there are more
        coefficients than parameters; the unit matrix by default.

    Returns
    -------
    (nfree,) values, and (nfree, ntheta) derivative. On a bound the derivative is 0.

    Raises
    ------
    IdentifiabilityError
        If the coefficients do not determine these parameters; the direction is named.
    SolveError
        If no start converges, so that no such parameters may exist.
    ModelError
        If a name is unknown or repeated, or a value is missing.

    Notes
    -----
    The derivative is that of the implicit function: J^-1 with J = dg/dtheta_p for as many
    coefficients as parameters, (J'QJ - sum_i (Q r)_i H_i)^-1 J'Q else (r = theta - g, Q = W'W).
    """
    free = _checked_names(equation, free)
    task = _task(equation, np.asarray(theta, dtype=float).ravel(), free, weight)
    p, x0, task = _start(equation, task, model_values, start or {}, bounds or {})
    rng = np.random.default_rng(2)
    failures: list[_StuckError] = []
    for attempt in range(1 + _STARTS):
        x = _other_start(task, x0, attempt, rng) if attempt else x0
        try:
            x, r, J = _newton(task, p, x)
        except _StuckError as failure:
            failures.append(failure)
            continue
        inside = (x > task.lower) & (x < task.upper)
        typical = np.where(x0 == 0.0, 1.0, np.abs(x0))
        _require_rank(equation, free, x, J, inside, task.theta, typical)
        return x, _derivative(task, p, x, r, J, inside)
    _refuse_unsolved(equation, task, p, x0, failures[0])


def _refuse_unsolved(
    equation: DifferenceEquation, task: _Task, p: Array, x0: Array, failure: _StuckError
) -> NoReturn:
    """Raise that no start converged, or that the coefficients do not determine the parameters."""
    if not isinstance(failure, _RankError):  # the zero of a start value is not the reason
        x0 = np.where(x0 == 0.0, 0.3, x0)
    _require_rank(equation, task.free, x0, task.map(p, x0)[1], np.ones(len(x0), dtype=bool))
    raise SolveError(
        f"{equation.name}: no {', '.join(task.free)} give these coefficients ({failure}, then from "
        f"{_STARTS} other starts); check the known values and the sample time, or start nearer"
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """What is solved: g(x) = theta within bounds, weighted where there are more coefficients."""

    map: _Map
    free: tuple[str, ...]
    theta: Array
    weight: Array | None
    lower: Array
    upper: Array


def _task(
    equation: DifferenceEquation, theta: Array, free: tuple[str, ...], weight: Array | None
) -> _Task:
    """The equations to solve, without bounds; refuses coefficients that cannot be right."""
    map_ = _evaluator(equation, free, threading.get_ident())
    if len(theta) != map_.ntheta:
        raise ModelError(
            f"{equation.name}: {len(theta)} coefficients given for {map_.ntheta}; they are "
            f"{', '.join(equation.coefficients)}"
        )
    if not np.isfinite(theta).all():
        where = equation.coefficients[int(np.argmin(np.isfinite(theta)))]
        raise ModelError(
            f"{equation.name}: the coefficient {where} is {theta[~np.isfinite(theta)][0]}; look "
            "for gaps in the data that it was estimated from"
        )
    if len(free) > map_.ntheta:
        raise IdentifiabilityError(
            f"{equation.name}: {len(free)} parameters ({', '.join(free)}) cannot follow from "
            f"{map_.ntheta} coefficients; declare at least {len(free) - map_.ntheta} known"
        )
    infinite = np.full(len(free), np.inf)
    return _Task(map_, free, theta, weight, -infinite, infinite)


def _start(
    equation: DifferenceEquation,
    task: _Task,
    model_values: Mapping[str, float],
    start: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
) -> tuple[Array, Array, _Task]:
    """All parameters (np,), the start of the free ones (nfree,), and the task with its bounds."""
    given: tuple[tuple[str, Mapping[str, Any]], ...] = (("start", start), ("bound", bounds))
    for what, names in given:
        for name in names:
            if name not in equation.parameters:
                raise ModelError(
                    f"{equation.name}: a {what} is given for {name!r}, which is no parameter"
                    f"{nearest(name, equation.parameters)}"
                )
    free, description = task.free, {q.name: q for q in equation.description}
    begin = {n: description[n].start for n in free}
    begin |= {n: q.value for n in free if (q := description[n]).value is not None}
    begin |= {n: float(model_values[n]) for n in free if n in model_values}
    begin |= {n: float(start[n]) for n in free if n in start}
    p = equation.vector({**begin, **model_values, **{n: begin[n] for n in free}})
    lower = np.array([bounds.get(n, (-np.inf, np.inf))[0] for n in free])
    upper = np.array([bounds.get(n, (-np.inf, np.inf))[1] for n in free])
    crossed = [n for n, a, b in zip(free, lower, upper, strict=True) if a > b]
    if crossed:
        raise ModelError(
            f"{equation.name}: the lower bound of {crossed[0]} lies above its upper bound; "
            "exchange them"
        )
    x0 = np.clip(p[task.map.index], lower, upper)
    return p, x0, replace(task, lower=lower, upper=upper)


def _other_start(task: _Task, x0: Array, attempt: int, rng: np.random.Generator) -> Array:
    """A random start about x0, farther away with every attempt."""
    spread = np.exp(0.25 * attempt**0.5 * rng.standard_normal(len(x0)))
    fresh = 0.3 * rng.standard_normal(len(x0))
    if attempt > 3:  # maps as m, z_m -> m z_m are singular between the signs
        spread *= rng.choice([-1.0, 1.0], len(x0))
    return np.clip(np.where(x0 == 0.0, fresh, x0 * spread), task.lower, task.upper)


def _checked_names(equation: DifferenceEquation, free: Sequence[str] | str) -> tuple[str, ...]:
    """Names of parameters, of a single one where text is given; each once."""
    free = (free,) if isinstance(free, str) else tuple(free)
    for i, name in enumerate(free):
        if name not in equation.parameters:
            raise ModelError(
                f"{equation.name}: no parameter {name!r}{nearest(name, equation.parameters)}"
            )
        if name in free[:i]:
            raise ModelError(f"{equation.name}: parameter {name!r} is named twice; name it once")
    return free


class _StuckError(Exception):
    """An iteration that does not converge from its start."""


class _RankError(_StuckError):
    """One whose Jacobian has no full rank there."""

    def __init__(self) -> None:
        super().__init__("rank deficient at the start")


class _Map:
    """g and its Jacobian in the free parameters, read and written in place: no copies, no DM."""

    def __init__(self, equation: DifferenceEquation, free: tuple[str, ...]) -> None:
        self.index = [equation.parameters.index(n) for n in free]
        p = ca.SX.sym("p", len(equation.parameters))
        theta = equation.g(p)
        x = ca.vertcat(*[p[i] for i in self.index]) if free else ca.SX(0, 1)
        J = ca.densify(ca.jacobian(theta, x))
        self.ntheta = int(theta.numel())
        weights = ca.SX.sym("w", self.ntheta)
        self.curvature = ca.Function(
            "curvature", [p, weights], [ca.densify(ca.hessian(ca.dot(weights, theta), x)[0])]
        )
        self._function = ca.Function("map", [p], [ca.densify(theta), J], {"cse": True})
        self._p = np.zeros(max(1, len(equation.parameters)))
        self._theta = np.zeros(self.ntheta)
        self._J = np.zeros((len(free), self.ntheta))
        buffer: Any
        buffer, self._call = self._function.buffer()
        self._buffer = buffer  # kept alive for the calls
        buffer.set_arg(0, self._p.data)
        buffer.set_res(0, self._theta.data)
        if self._J.size:
            buffer.set_res(1, self._J.data)

    def __call__(self, p: Array, x: Array) -> tuple[Array, Array]:
        """theta (ntheta,), J (ntheta, nfree); views that the next call overwrites."""
        self._p[:] = p
        self._p[self.index] = x
        self._call()
        return self._theta, self._J.T


@lru_cache(maxsize=256)
def _evaluator(equation: DifferenceEquation, free: tuple[str, ...], thread: int) -> _Map:
    # One for each thread: the buffers are written in place.
    return _Map(equation, free)


def _newton(task: _Task, p: Array, x: Array) -> tuple[Array, Array, Array]:
    """Damped Newton (Gauss-Newton) steps: parameters, residual theta - g, Jacobian there."""
    map_, theta, lower, upper = task.map, task.theta, task.lower, task.upper
    value, J = map_(p, x)
    r = theta - value
    is_square = J.shape[0] == J.shape[1]
    W = None if is_square else task.weight
    for _ in range(_ITERATIONS):
        if not (np.isfinite(r).all() and np.isfinite(J).all()):
            raise _StuckError("not finite")
        J = J.copy()
        blocked = np.zeros(len(x), dtype=bool)
        step, solve = _step(J, r, W, blocked, is_square)
        out = ((x <= lower) & (step < 0)) | ((x >= upper) & (step > 0))
        if out.any():
            step, solve = _step(J, r, W, out, False)
        scale = np.maximum(np.abs(x), 1e-12 * np.abs(x).max(initial=1.0))
        # The test in parameter units: the simplified step from the new point must be shorter
        # (Deuflhard 2004, Newton Methods for Nonlinear Problems, section 3.2).
        length = float(np.linalg.norm(step / scale))
        t = 1.0
        while True:
            new = np.clip(x + t * step, lower, upper)
            value, J_new = map_(p, new)
            r_new = theta - value
            ahead = float(np.linalg.norm(solve(r_new) / scale))  # not a number is not shorter
            if ahead <= (1.0 - 0.25 * t) * length or ahead <= _TOLERANCE:
                is_done = ahead <= _TOLERANCE
                break
            if length <= _ROUNDING:  # steps that no longer shrink
                return x, r, J
            t *= 0.5
            if t < 1e-6:
                raise _StuckError("the residual stops decreasing")
        x, r, J = new, r_new, J_new
        if is_done:
            return x, r, J.copy()
    raise _StuckError(f"no convergence in {_ITERATIONS} steps")


def _step(
    J: Array, r: Array, W: Array | None, blocked: Array, is_square: bool
) -> tuple[Array, Any]:
    """The Newton step, and the map from residuals to steps with this Jacobian."""
    if is_square:
        try:
            inverse = np.linalg.inv(J)
        except np.linalg.LinAlgError:
            raise _RankError from None
    else:
        columns = ~blocked
        weighted = J[:, columns] if W is None else W @ J[:, columns]
        size = np.linalg.norm(weighted, axis=0)
        if (size == 0.0).any():
            raise _RankError
        inverse = np.zeros((J.shape[1], J.shape[0]))
        part = np.linalg.pinv(weighted / size) / size[:, None]
        inverse[columns] = part if W is None else part @ W
    return inverse @ r, lambda residual: inverse @ residual


def _derivative(task: _Task, p: Array, x: Array, r: Array, J: Array, inside: Array) -> Array:
    map_, weight = task.map, task.weight
    result = np.zeros((len(x), map_.ntheta))
    if J.shape[0] == J.shape[1] and inside.all():
        return np.asarray(np.linalg.inv(J))
    Q = np.eye(map_.ntheta) if weight is None else weight.T @ weight
    full = p.copy()
    full[map_.index] = x
    H = J.T @ Q @ J - np.array(map_.curvature(full, Q @ r))
    keep = np.flatnonzero(inside)
    size = np.sqrt(np.abs(np.diag(H)[keep]))
    scaled = H[np.ix_(keep, keep)] / np.outer(size, size)
    result[keep] = np.linalg.solve(scaled, (J.T @ Q)[keep] / size[:, None]) / size[:, None]
    return result


def _require_rank(
    equation: DifferenceEquation,
    free: tuple[str, ...],
    x: Array,
    J: Array,
    inside: Array,
    theta: Array | None = None,
    typical: Array | None = None,
) -> None:
    """Refuse where a direction of the parameters does not move the coefficients.

    With `theta` (ntheta,), also where its rounding moves a parameter by its size or more. A
    parameter that is zero to rounding is measured by its `typical` size (nfree,): m = 1e-16 is a
    value of m, and hides z_m.
    """
    scale = np.where(x == 0.0, 1.0, np.abs(x))
    moved = (J * scale)[:, inside]
    if moved.shape[1] == 0 or not np.isfinite(moved).all():
        return
    U, singular, Vt = np.linalg.svd(moved, full_matrices=True)
    rank = int((singular > _RANK * singular.max(initial=0.0)).sum())
    weak = Vt[-1]
    if rank == moved.shape[1]:
        if theta is None or typical is None:
            return
        inverse = (Vt.T / singular) @ U[:, :rank].T
        error = scale[inside] * (np.abs(inverse) @ (np.finfo(float).eps * np.abs(theta)))
        hidden = error > _DIGITS * np.maximum(np.abs(x), typical)[inside]
        if not hidden.any():
            return
        rank -= int(hidden.sum())
        weak = hidden.astype(float)
    names = [n for n, keep in zip(free, inside, strict=True) if keep]
    terms = [f"{w:+.2g} {n}" for n, w in zip(names, weak, strict=True) if abs(w) > 1e-3]
    raise IdentifiabilityError(
        f"{equation.name}: the coefficients {', '.join(equation.coefficients)} do not determine "
        f"{', '.join(names)} (rank {rank} of {len(names)}); the relative change "
        f"({', '.join(terms)}) moves none of them, so declare one of these known, or start away "
        "from a value that hides another"
    )


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """Parameters as sympy expressions of the continuous coefficients and the other parameters.

    Attributes
    ----------
    expressions : parameter -> sympy expression.
    using : the coefficients that were solved: "alpha1", ... of the denominator s^n + alpha1
        s^(n-1) + ..., and "beta1[accel]", ... of the numerators, beta_k with s^(n-k).
    """

    expressions: Mapping[str, Any]
    using: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join(f"{name} = {e}" for name, e in self.expressions.items())


def continuous_names(transfer: TransferMatrix) -> dict[str, Any]:
    """The coefficients of the first row that are no structural zeros, name -> SX."""
    named = {f"alpha{k}": transfer.denominator[k] for k in range(1, transfer.order + 1)}
    for u, b in zip(transfer.inputs, transfer.numerators[0], strict=True):
        named |= {f"beta{k}[{u}]": b[k] for k in range(b.numel())}
    return {n: e for n, e in named.items() if e.nnz()}


def continuous_form(equation: DifferenceEquation) -> dict[str, Any]:
    """The continuous coefficients as sympy expressions of the discrete ones: (7.36), any order.

    Returns
    -------
    "alpha1", ..., "beta1[accel]", ... (see `ClosedForm`) -> expression of the coefficients of the
    equation ("a1", "b0[accel]", ...) and the sample time "T".

    Raises
    ------
    ModelError
        For an exact hold, where they are no rational functions; `equation.continuous` has numbers.
    """
    import sympy

    if equation.method not in SUBSTITUTIONS:
        raise ModelError(
            f"{equation.name}: under {equation.method} the continuous coefficients are logarithms "
            f"of the discrete ones; use equation.continuous(theta), or {', '.join(SUBSTITUTIONS)}"
        )
    # A relation's weight may hold the sample time: then it is kept as the number it is.
    weights = sympy.Matrix(
        equation.relations.shape[0],
        equation.relations.shape[1],
        lambda i, j: sympy.Rational(exact(float(equation.relations[i, j]))),
    )
    theta = sympy.Matrix([1, *(sympy.Symbol(n) for n in equation.coefficients)])
    n = equation.transfer.order
    T = sympy.Symbol("T", positive=True)
    rows = (weights * theta).reshape(1 + len(equation.inputs), n + 1)
    images = rows * sympy.Matrix(substitution(n, T, equation.method)).inv()
    names = {f"alpha{k}": (0, k) for k in range(1, n + 1)}
    for i, u in enumerate(equation.inputs, 1):
        names |= {f"beta{k}[{u}]": (i, k) for k in range(n + 1)}
    kept = continuous_names(equation.transfer)
    return {
        name: factored(sympy.cancel(images[place] / images[0, 0]))
        for name, place in names.items()
        if name in kept
    }


def closed_form(
    equation: DifferenceEquation,
    free: Sequence[str] | str,
    using: Sequence[str] | str | None = None,
) -> ClosedForm:
    """Solve the continuous coefficients for the free parameters, in closed form.

    Parameters
    ----------
    free : names of parameters; all others appear as symbols of their name.
    using : the coefficients to solve, as many as `free`; by default the first that sympy can
        solve, so the simplest of several forms is not promised.

    Raises
    ------
    ModelError
        If a name is unknown or repeated.
    IdentifiabilityError
        If no choice of coefficients gives the parameters in closed form; `invert` may still.
    """
    import sympy

    free = _checked_names(equation, free)
    using = (using,) if isinstance(using, str) else using
    named = continuous_names(equation.transfer)
    for name in using or ():
        if name not in named:
            raise ModelError(f"{equation.name}: no coefficient {name!r}{nearest(name, named)}")
    # Without assumptions: sympy drops solutions that it cannot show to be real.
    plain = {n: sympy.Symbol(n) for n in equation.parameters}
    unknowns = [plain[n] for n in free]
    rows = {}
    for name, expression in named.items():
        value = sympy.together(to_sympy(expression, plain, exact_numbers=True)[0])
        numerator, denominator = sympy.fraction(sympy.cancel(value))
        if numerator.has(*unknowns) or denominator.has(*unknowns):
            rows[name] = sympy.Symbol(name) * denominator - numerator
    choices = [tuple(using)] if using else list(combinations(rows, len(unknowns)))
    for choice in choices:
        equations = [rows[name] for name in choice if name in rows]
        if len(equations) < len(unknowns):
            continue
        solutions = sympy.solve(equations, unknowns, dict=True)
        full = [s for s in solutions if set(s) == set(unknowns)]
        if full:
            found = {str(u): factored(full[0][u]) for u in unknowns}
            return ClosedForm(found, tuple(choice))
    raise IdentifiabilityError(
        f"{equation.name}: {', '.join(free)} do not follow in closed form from "
        f"{', '.join(using or named)}; declare one of them known, or use the numeric `invert`"
    )
