"""A solver of nonlinear programs as a value: a CasADi plug-in by name, with its options."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import casadi as ca

from casid.errors import SolveError
from casid.time_limit import seconds_left, time_factor

_QUIET: dict[str, dict[str, Any]] = {
    "ipopt": {
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "print_time": False,
        "ipopt.tol": 1e-9,
        "ipopt.acceptable_tol": 1e-7,
        "ipopt.mu_strategy": "adaptive",
        "ipopt.bound_relax_factor": 0.0,
    },
    "sqpmethod": {
        "print_header": False,
        "print_iteration": False,
        "print_status": False,
        "print_time": False,
        "qpsol": "qrqp",
        "convexify_strategy": "eigen-reflect",  # its QP cannot use negative curvature
        "max_iter_ls": 25,  # after the default of 3 halvings it takes the step, however bad
        "tol_du": 1e-9,
        "tol_pr": 1e-9,
        "error_on_fail": False,
    },
}
# Options of sqpmethod's quadratic programs: each plug-in knows its own alone.
_QUIET_QP: dict[str, dict[str, Any]] = {
    "qrqp": {
        "print_iter": False,
        "print_header": False,
        "print_info": False,
        "error_on_fail": False,
    },
    "qpoases": {"printLevel": "none", "error_on_fail": False},
    "osqp": {"osqp": {"verbose": False}, "error_on_fail": False},
    "highs": {"highs": {"output_flag": False}, "error_on_fail": False},
}

# What each plug-in calls the number of iterations; the others keep their own default.
_MAX_ITERATIONS = {
    "ipopt": "ipopt.max_iter",
    "sqpmethod": "max_iter",
    "feasiblesqpmethod": "max_iter",
    "qrsqp": "max_iter",
    "scpgen": "max_iter",
    "blocksqp": "max_iter",
    "fatrop": "fatrop.max_iter",
    "uno": "uno.max_iterations",
}


LEADS_TO_KNOWN = "Leads_To_Known_Minimum"
"""The status of a search that ends for that (`Solver.known`)."""


@dataclass(frozen=True, slots=True)
class Solver:
    """An NLP solver by its CasADi plug-in name, with the plug-in's own options.

    Parameters
    ----------
    name : "ipopt" (default), "sqpmethod", or any installed `casadi.nlpsol` plug-in.
    max_iterations : iterations before the solver gives up.
    options : passed to `casadi.nlpsol` unchanged; they win over casid's defaults, as
        ``{"qpsol": "daqp"}`` does for "sqpmethod".
    enough : Ipopt ends on a sum of squares without constraints where a step promises to lower it by
        less than this share of it, or some steps together did not lower it by more. 0: nowhere.
    below : it ends there, too, where the fall of its last steps, kept up for all that it has left,
        would not bring it below this value: what does not matter need not be exact.
    known : (n,) a minimum that was found before, in physical units: it ends there, too, where two
        steps in a row lead to it, as `LEADS_TO_KNOWN`.
    """

    name: str = "ipopt"
    max_iterations: int = 300
    options: Mapping[str, Any] = field(default_factory=dict)
    enough: float = 0.0
    below: float = math.inf
    known: tuple[float, ...] = ()

    def nlpsol_options(self) -> dict[str, Any]:
        """Options as `casadi.nlpsol` takes them."""
        # NaN on the way is the line search's business; one at the start is refused before.
        merged = dict(_QUIET.get(self.name, {"print_time": False})) | {"show_eval_warnings": False}
        key = _MAX_ITERATIONS.get(self.name)
        if key is not None:
            merged[key] = self.max_iterations
        merged.update(self.options)
        if self.name == "sqpmethod" and "qpsol_options" not in merged:
            merged["qpsol_options"] = dict(
                _QUIET_QP.get(str(merged["qpsol"]), {"error_on_fail": False})
            )
        return merged


NEARBY = Solver(options={"ipopt.mu_strategy": "monotone", "ipopt.mu_init": 1e-7})
"""For fits that start next to their minimum: a large barrier would only lead away from it."""


def descending(solver: Solver | None) -> Solver | None:
    """The solver without steps that raise the objective, None where nothing changes.

    After ten shortened steps Ipopt's watchdog takes a whole one on trial, as progress along curved
    constraints may need. Where a whole step is far too long, a search was seen to end there.
    """
    chosen = solver or Solver()
    if chosen.name != "ipopt" or _WATCHDOG in chosen.options:
        return None
    return replace(chosen, options={**chosen.options, _WATCHDOG: 0})


def quasi_newton(solver: Solver | None) -> Solver | None:
    """The solver with a BFGS approximation of the Hessian, None where one was chosen.

    Where two solutions of a model meet, as two time constants that may be exchanged become equal,
    the matrix of Gauss and Newton is singular at the minimum and its steps do not end there.
    """
    chosen = solver or Solver()
    if chosen.name != "ipopt" or _HESSIAN in chosen.options:
        return None
    return replace(chosen, options={**chosen.options, _HESSIAN: "limited-memory"})


_HESSIAN = "ipopt.hessian_approximation"
_WATCHDOG = "ipopt.watchdog_shortened_iter_trigger"


def limited(options: Mapping[str, Any], solver: Solver) -> dict[str, Any]:
    """Options with the time limit around the call, where the solver knows one: Ipopt does."""
    seconds = seconds_left()
    if solver.name != "ipopt" or not math.isfinite(seconds):
        return dict(options)
    seconds = max(min(seconds * time_factor(), options.get(_SECONDS, math.inf)), 1e-3)
    return {**options, _SECONDS: seconds}


_SECONDS = "ipopt.max_wall_time"


def as_solver(solver: Solver | str | None) -> Solver:
    """The default solver for None, ``Solver(name)`` for a name.

    Raises
    ------
    SolveError
        If it is neither a solver nor a name.
    """
    if solver is None:
        return Solver()
    if isinstance(solver, str):
        return Solver(solver)
    if not isinstance(solver, Solver):
        raise SolveError(
            f"a {type(solver).__name__} is no solver; give Solver('ipopt'), Solver('sqpmethod') or "
            "the name alone"
        )
    return solver


@cache
def _is_installed(name: str) -> bool:
    """Whether CasADi finds the plug-in; checked once, since a missing one makes CasADi print."""
    return bool(ca.has_nlpsol(name))


def set_up(program: str, solver: Solver, problem: Mapping[str, Any], options: Any) -> Any:
    """The CasADi solver of a problem.

    Raises
    ------
    SolveError
        If the plug-in is not installed or refuses its options.
    """
    plug_in, _, qp = solver.name.partition("/")
    if qp and plug_in == "sqpmethod":
        raise SolveError(
            f"{program}: {solver.name!r} is a solver with an option; write "
            f"Solver('sqpmethod', options={{'qpsol': {qp!r}}})"
        )
    if not _is_installed(solver.name):
        raise SolveError(
            f"{program}: solver {solver.name!r} is no CasADi plug-in that loads here; use "
            "Solver('ipopt') or Solver('sqpmethod')"
        )
    try:
        return ca.nlpsol("nlp", solver.name, problem, options)
    except RuntimeError as error:
        raise SolveError(
            f"{program}: solver {solver.name!r} cannot be set up: {_cause(error)}; "
            "check Solver(options=...)"
        ) from error


def _cause(error: Exception) -> str:
    """What CasADi's message says, without its frame and its list of all that might be meant."""
    causes, near = [], []
    for line in str(error).strip().splitlines():
        line = re.sub(r"^\.\.\./casadi/\S+: ", "", line).strip()
        if line.startswith("> "):
            near += re.findall(r'^> "([^"]+)"', line)
        elif line and not line.startswith(
            ("Error calling", "Assertion ", "Did you mean", "Use print_options")
        ):
            causes.append(line)
    nearest = f" (nearest: {', '.join(near[:2])})" if near else ""
    return (" ".join(causes) or str(error).strip()) + nearest


def gave_up(program: str, solver: str, error: Exception) -> SolveError:
    """The refusal of a solver that ended in an exception."""
    return SolveError(
        f"{program}: {solver} stopped: {str(error).strip().splitlines()[-1]}; "
        "change the start values or tighten the bounds"
    )
