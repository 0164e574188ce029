"""Minima of the simulation-error criterion, from one or several starts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import DataError, IdentifiabilityError, OutOfTimeError, SolveError
from casid.estimation.local_rank import describe_null, rank_of
from casid.estimation.nlp.nlp import Nlp
from casid.estimation.nlp.solution import Evaluation, Solution, not_converged
from casid.estimation.nlp.solver import Solver, descending, quasi_newton
from casid.estimation.simulation.channels.sensor_dynamics import due_to_earlier_inputs
from casid.estimation.simulation.simulation_error import SimulationError, Whitener
from casid.estimation.simulation.singular_samples import singular_sample
from casid.model.model import Model
from casid.time_limit import require_time, seconds_left


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A minimum of the simulation-error criterion.

    Attributes
    ----------
    starts_tried, starts_agreeing : starts that came to an end, and those that ended here.
    not_done : what no time was left for.
    begun : variable -> where the search began, of whose refinements the criterion's start is one.
    """

    criterion: SimulationError
    solution: Solution
    starts_tried: int = 1
    starts_agreeing: int = 1
    notes: tuple[str, ...] = field(default_factory=tuple)
    not_done: tuple[str, ...] = ()
    begun: Mapping[str, float] = field(default_factory=dict)

    @property
    def x(self) -> Array:
        """(n,) the minimiser."""
        return self.solution.x

    @property
    def values(self) -> dict[str, float]:
        """Every variable by name."""
        return dict(zip(self.criterion.names, self.x.tolist(), strict=True))


def widened(fit: Fit, model: Model) -> SimulationError:
    """The criterion of a fit for a model with more parameters, all of them at their start.

    The lag of an input that is none yet leaves out no samples, which all outputs would lose.
    """
    return _restated(fit, model, fit.criterion.whiten)


def whitened(fit: Fit, whiten: Whitener) -> Fit:
    """A fit as a point of its criterion under other noise, with the matrix of that."""
    criterion = _restated(fit, fit.criterion.model, whiten)
    at = criterion.evaluate(fit.x)
    solution = replace(fit.solution, value=at.value, hessian=at.hessian)
    return replace(fit, criterion=criterion, solution=solution)


def _restated(fit: Fit, model: Model, whiten: Whitener | None) -> SimulationError:
    """The criterion of a fit for another model or noise, which begins where the fit ended."""
    base = fit.criterion
    criterion = SimulationError(
        model,
        base.experiments,
        own=base.own,
        weights=base.weights,
        whiten=whiten,
        substeps=base.substeps,
        start=fit.values,
    )
    for e, d, own in zip(base.experiments, criterion.data, base.data, strict=True):
        late = due_to_earlier_inputs(model, d.u, d.Ts, window=e.window, without=("lag_input",))
        d.used[:] = own.used & ~late
    return criterion


Constraint = Callable[[Mapping[str, Any]], Any]
Retry = Literal["unconverged", "unsuccessful", "none"]


def minimize_simulation_error(
    criterion: SimulationError,
    *,
    solver: Solver | None = None,
    starts: int = 1,
    seed: int = 0,
    constraints: Sequence[Constraint] = (),
    check_rank: bool = True,
    retry: Retry = "unconverged",
) -> Fit:
    """Minimise (1), from the declared start and `starts - 1` random ones; the best is kept.

    Parameters
    ----------
    constraints : each takes a mapping of variable names to CasADi symbols and returns an expression
        that is to be zero (linear or not).
    retry : which solutions are improved once more from where they ended: those that are not
        converged; those where the solver did not succeed near the start either; none.

    Raises
    ------
    IdentifiabilityError
        Before the solver starts, where a direction is not identifiable.
    SolveError
        If no start leads to where the criterion is finite; `OutOfTimeError` for want of time.

    Notes
    -----
    The end of a search may be no minimum: `require_minimum` refuses that.
    """
    require_time(f"the fit of {criterion.model.name}")
    nlp = _stated(criterion, constraints)
    first = _at_start(criterion)
    if check_rank and not constraints and criterion.segments == 1:
        _refuse_unidentifiable(criterion, criterion.start, first.hessian)
    solutions: list[Solution] = []
    failures: list[str] = []
    for k in range(max(starts, 1)):
        if k > 0 and seconds_left() <= 0.0:
            break
        rng = np.random.default_rng((seed, k))
        point = _random_start(criterion, criterion.start, rng) if k else criterion.start
        try:
            solution = _solved(nlp, criterion, solver, point)
        except SolveError as error:
            failures.append(str(error))
            continue
        is_done = solution.is_converged or retry == "none" or seconds_left() <= 0.0
        if retry == "unsuccessful" and k == 0 and solution.status == "Solve_Succeeded":
            is_done |= solution.value > 0.5 * first.value
        solutions.append(solution if is_done else _improved(nlp, criterion, solver, solution))
    if not solutions:
        require_time(f"the fit of {criterion.model.name}")
        raise SolveError(failures[0])
    return _kept(criterion, solutions, len(solutions) + len(failures), max(starts, 1))


def _improved(
    nlp: Nlp, criterion: SimulationError, solver: Solver | None, solution: Solution
) -> Solution:
    """Where a search that begins at the end of an unfinished one ends, or that end."""
    # The natural scales of a far start are wrong at the end: once more from there.
    with suppress(SolveError):
        solution = _solved(nlp, criterion, solver, solution.x)
    other = quasi_newton(solver)
    if solution.is_converged or other is None or seconds_left() <= 0.0:
        return solution
    with suppress(SolveError):
        by_gradients = _solved(nlp, criterion, other, solution.x)
        if by_gradients.is_converged:
            return by_gradients
    return solution


def require_minimum(fit: Fit) -> None:
    """Refuse a fit that did not converge.

    Raises
    ------
    SolveError
        With the remedy; `OutOfTimeError`, with the fit, for want of time.
    """
    if not fit.solution.is_converged:
        refusal = not_converged(fit.criterion.model.name, fit.solution)
        raise OutOfTimeError(str(refusal), found=fit) if fit.not_done else refusal


def _kept(
    criterion: SimulationError, solutions: Sequence[Solution], tried: int, starts: int
) -> Fit:
    """The best of the solutions, and the starts that no time was left for."""
    best = max(solutions, key=lambda s: (s.is_converged, -s.value))
    agreeing = sum(s.value <= best.value * (1 + 1e-6) + 1e-12 for s in solutions)
    if seconds_left() > 0.0:
        return Fit(criterion, best, starts, agreeing)
    cut = not solutions[-1].is_converged
    not_done = (f"the search from {_starts(starts - tried + cut, starts)}",)
    return Fit(criterion, best, tried, agreeing, not_done=not_done if tried - cut < starts else ())


def _starts(left: int, starts: int) -> str:
    return "the start" if starts == 1 else f"{left} of {starts} starts"


def _solved(nlp: Nlp, criterion: SimulationError, solver: Solver | None, point: Array) -> Solution:
    """Where the solver ends from `point` (n,); refuses an end without finite derivatives.

    An end above where it began is none: it is sought once more, without steps that rise.
    """
    begun = criterion.evaluate(point).value  # now: later it would have to be simulated once more
    solution = nlp.solve(solver, point.tolist(), throw=False, natural_scales=True)
    again = None if solution.is_converged or seconds_left() <= 0.0 else descending(solver)
    if again is not None and not solution.value <= begun:
        solution = nlp.solve(again, point.tolist(), throw=False, natural_scales=True)
    if not (np.isfinite(solution.value) and np.all(np.isfinite(solution.hessian))):
        there = zip(solution.names, solution.x.tolist(), strict=True)
        raise SolveError(
            f"{criterion.model.name}: the fit runs to where the simulation is not finite "
            f"({', '.join(f'{name} = {value:.3g}' for name, value in there)}); "
            "bound the parameters, or change the start values"
        )
    return solution


def _stated(criterion: SimulationError, constraints: Sequence[Constraint]) -> Nlp:
    """The criterion and constraints on its variables as a nonlinear program."""
    nlp = Nlp(criterion.model.name)
    symbols = {
        v.name: nlp.variable(v.name, v.start, lower=v.lower, upper=v.upper, scale=v.scale)
        for v in criterion.variables
    }
    nlp.minimize(criterion)
    for i, constraint in enumerate(constraints):
        nlp.equality(constraint(symbols), name=f"constraint {i + 1}")
    return nlp


def _at_start(criterion: SimulationError) -> Evaluation:
    """The criterion at its start; refuses simulations that diverge and records that are short."""
    x0 = criterion.start
    first = criterion.evaluate(x0)
    if not (np.isfinite(first.value) and np.all(np.isfinite(first.hessian))):
        what, remedy = divergence(criterion, x0)
        raise DivergenceError(f"{criterion.model.name}: {what}; {remedy}", what)
    if criterion.n_samples <= len(x0):
        raise DataError(
            f"{criterion.data[0].name}: {criterion.n_samples} samples are too few for {len(x0)} "
            "unknowns (parameters and initial states); widen the window or give known values"
        )
    return first


def _refuse_unidentifiable(criterion: SimulationError, x0: Array, hessian: Array) -> None:
    rank = rank_of(criterion.variables, hessian, x0)
    if rank.is_full:
        return
    _refuse_departures(criterion, x0)
    # A start may be special (a zero, a symmetry): look beside it before refusing.
    beside = _random_start(criterion, x0, np.random.default_rng(99))
    at = criterion.evaluate(beside)
    if np.isfinite(at.value):
        rank = rank_of(criterion.variables, at.hessian, beside)
        if rank.is_full:
            return
    raise IdentifiabilityError(
        f"{criterion.model.name}: rank {rank.rank} of {rank.unknowns} unknowns in "
        f"{', '.join(d.name for d in criterion.data)}; {describe_null(rank)}"
        f"{_constant_inputs(criterion)}"
    )


def departures(criterion: SimulationError, x: Array) -> tuple[int, str]:
    """How many windows' simulations leave the range of what was measured, and where the first."""
    left, first = 0, ""
    for e, d in enumerate(criterion.data):
        error = np.abs(criterion.simulated(x, e).residual)
        out = ~np.isfinite(error) | (error > np.where(d.used, np.abs(d.y), 0.0).max(axis=0))
        cuts = [0, *criterion.starts_anew(e).tolist(), d.N]
        for a, b in zip(cuts, cuts[1:], strict=False):
            if out[a:b].any():
                first = first or f", the first in that of {d.name} at t = {d.t[a]:g} s"
                left += 1
    return left, first


def _refuse_departures(criterion: SimulationError, x: Array) -> None:
    """Refuse windows whose simulations leave what was measured: their rank says nothing."""
    parts = sum(criterion.parts(e) for e in range(len(criterion.data)))
    if parts == len(criterion.data):
        return
    left, first = departures(criterion, x)
    if left:
        what = (
            f"from the start values {left} of {parts} windows leave the range of what was "
            f"measured{first}"
        )
        remedy = (
            "start the parameters nearer to their values; where the model is singular, bound them "
            "and record more of the states that its singular terms depend on"
        )
        raise DivergenceError(f"{criterion.model.name}: {what}; {remedy}", what)


def _constant_inputs(criterion: SimulationError) -> str:
    """Inputs that never move, which may be why; an empty text where all do."""
    constant = [
        f"{name} of {d.name} is constant ({d.u[0, i]:g})"
        for d in criterion.data
        for i, (name, entry) in enumerate(criterion.model.inputs.items())
        if entry.kind == "measured" and np.ptp(d.u[:, i]) == 0.0
    ]
    return f". Input {' and '.join(constant)}: check its cable and its mapping" if constant else ""


def _random_start(criterion: SimulationError, x0: Array, rng: np.random.Generator) -> Array:
    """Beside `x0` (n,); segments and windows begin where they do: that was measured."""
    point = x0.copy()
    is_cut = max(criterion.parts(e) for e in range(len(criterion.data))) > 1
    for i, v in enumerate(criterion.variables):
        if v.source in criterion.model.states:
            if is_cut:
                continue
            point[i] += 0.1 * v.scale * rng.standard_normal()
        elif v.start != 0.0:
            point[i] = v.start * np.exp(0.5 * rng.standard_normal())
        else:
            point[i] = v.scale * 0.3 * rng.standard_normal()
        low, high = v.lower, v.upper
        inset = 1e-6 * v.scale
        point[i] = float(np.clip(point[i], min(low + inset, high), max(high - inset, low)))
    return point


class DivergenceError(SolveError):
    """A simulation that diverges from its start values.

    Attributes
    ----------
    what : where and when it diverges, without the model's name and the remedy.
    """

    def __init__(self, message: str, what: str = "") -> None:
        super().__init__(message)
        self.what = what or message


def divergence(criterion: SimulationError, x: Array) -> tuple[str, str]:
    """What diverges from the start values, and the remedy."""
    for e, d in enumerate(criterion.data):
        with np.errstate(all="ignore"):
            y, _, _ = criterion.simulate(x, e)
        bad = ~np.all(np.isfinite(y), axis=1)
        what, samples = f"the sensitivities of {d.name} are not finite from the start values", None
        if bad.any():
            k = int(np.argmax(bad))
            what = f"the simulation of {d.name} diverges at t = {d.t[k]:g} s (sample {k}) from the "
            what += "start values"
            samples = (max(k - 1, 0), k)
        if names := _singular_at_zero(criterion, x, e):
            verb = "begins" if len(names) == 1 else "begin"
            return (
                f"{what}: {', '.join(names)} {verb} at 0, where the equations have "
                f"no finite {'value' if bad.any() else 'slope'}",
                f'declare a start other than 0, as in m.state("{names[0]}", ..., start=1.0), '
                "or the initial value where it is known, initial=1.0",
            )
        p, x0 = criterion.parameter_vector(x, e)
        if found := singular_sample(criterion.model, d.u, p, d.t, x0, samples):
            return f"{what}: {found[0]}", found[1]
        if bad.any():
            return what, f"change the start, fix a parameter, or {_SHOOTING}"
    what = "the sensitivities are not finite at the start"
    return what, f"change the start values, or {_SHOOTING}"


def _singular_at_zero(criterion: SimulationError, x: Array, experiment: int) -> list[str]:
    """States that begin at zero, each of which alone makes the equations singular there.

    A quotient has no finite value where its divisor is zero, a root no finite slope.
    """
    e = criterion.model.explicit()
    slopes = ca.jacobian(e.f, e.x)
    equations = ca.Function("f", [e.x, e.u, e.p], [ca.densify(e.f), ca.densify(slopes)])
    p, x0 = criterion.parameter_vector(x, experiment)
    u = criterion.data[experiment].u[0]

    def is_finite(states: Array) -> bool:
        return all(np.all(np.isfinite(v.full())) for v in equations(states, u, p))

    if is_finite(x0):
        return []
    eye = np.eye(len(x0))
    return [
        n
        for n, v, one in zip(e.states, x0.tolist(), eye, strict=True)
        if v == 0.0 and is_finite(x0 + one)
    ]


_SHOOTING = "use multiple shooting (segments=...) if the model is unstable"
