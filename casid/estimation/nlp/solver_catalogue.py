"""The solvers that a comparison can run, by name, with the options that make them accurate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from casid.errors import SolveError
from casid.estimation.nlp.solver import Solver


@dataclass(frozen=True, slots=True)
class SolverEntry:
    """A solver by its name in tables, and how it works."""

    name: str
    solver: Solver | None  # None: not a CasADi plug-in
    rule: str  # how it steps, and when it stops
    takes_criterion: bool = False  # whether it accepts a Hessian that is no expression
    polish: bool = False  # Newton steps after it, as `Compiled.solve` takes them by default


_QUIET = {"print_time": False, "error_on_fail": False}
_QP: dict[str, tuple[dict[str, Any], str]] = {
    "qrqp": (
        {"print_iter": False, "print_header": False, "print_info": False},
        "active-set QP by sparse QR",
    ),
    "daqp": ({}, "dual active-set QP"),
    "osqp": (
        {
            "osqp": {
                "verbose": False,
                "eps_abs": 1e-12,
                "eps_rel": 1e-12,
                "max_iter": 20_000,
                "polish": True,
            }
        },
        "first-order QP (ADMM): accurate only where its polishing finds the active set",
    ),
    "highs": (
        {
            "highs": {
                "output_flag": False,
                "primal_feasibility_tolerance": 1e-10,
                "dual_feasibility_tolerance": 1e-10,
                "qp_regularization_value": 0.0,
            }
        },
        "convex QP to 1e-10 absolute: nearly singular or indefinite Hessians on the way stop it",
    ),
    "proxqp": ({"proxqp": {"eps_abs": 1e-12}}, "proximal augmented Lagrangian QP"),
    "qpoases": ({"printLevel": "none"}, "parametric active-set QP"),
}

_RULES = {
    "ipopt": "interior point, exact Hessian; stops at 1e-12 of the steepest curvature",
    "blocksqp": "SQP with BFGS in place of the Hessian; stops at an optimality of 1e-10",
    "fatrop": "interior point made for optimal control; stops at 1e-12",
    "uno": "interior point or SQP by preset, exact Hessian; stops at 1e-10",
    "alpaqa": "augmented Lagrangian with L-BFGS (PANOC): first order, slow where curvatures differ",
    "sleqp": "active set by linear programs, then Newton steps; stops at its own 1e-6",
    "feasiblesqpmethod": "SQP that keeps every iterate feasible: needs a feasible start",
    "bonmin": "Ipopt inside branch and bound",
}
_SQP = {"tol_du": 1e-11, "tol_pr": 1e-11}
_OPTIONS: dict[str, dict[str, Any]] = {
    "ipopt": {"ipopt.tol": 1e-12, "ipopt.acceptable_tol": 1e-9},
    "blocksqp": {
        **_QUIET,
        "print_header": False,
        "print_iteration": False,
        "linsol": "ldl",  # MA27, its default, is not free
        "opttol": 1e-10,
        "nlinfeastol": 1e-10,
    },
    "fatrop": {**_QUIET, "fatrop.print_level": 0, "fatrop.tolerance": 1e-12},
    "uno": {
        **_QUIET,
        "uno.logger": "SILENT",
        "uno.primal_tolerance": 1e-10,
        "uno.dual_tolerance": 1e-10,
    },
    "alpaqa": {**_QUIET, "alpaqa.alm.tolerance": 1e-10},
    "sleqp": dict(_QUIET),
    "bonmin": {**_QUIET, "bonmin.bb_log_level": 0, "bonmin.nlp_log_level": 0, "bonmin.tol": 1e-9},
    "feasiblesqpmethod": {
        **_QUIET,
        "print_header": False,
        "print_iteration": False,
        "print_status": False,
        "qpsol": "qrqp",
        "qpsol_options": {"print_iter": False, "print_header": False, "error_on_fail": False},
    },
}
NULL_SPACE = "null-space QR"
POLISHED = "ipopt + Newton"
TRUST_CONSTR, SLSQP = "scipy/trust-constr", "scipy/SLSQP"
DEFAULT = (
    NULL_SPACE,
    POLISHED,
    "ipopt",
    "sqpmethod/qrqp",
    "sqpmethod/daqp",
    "sqpmethod/osqp",
    "sqpmethod/highs",
    "blocksqp",
    "fatrop",
    "uno",
    "alpaqa",
    "madnlp",
    "knitro",
    "snopt",
    TRUST_CONSTR,
    SLSQP,
)


def entry_of(entry: str | Solver) -> SolverEntry:
    """A solver by its name: a CasADi plug-in, "sqpmethod/<QP plug-in>", one of SciPy's, or a
    `Solver` with options of the caller's own.
    """
    if isinstance(entry, Solver):
        takes = entry.name in ("ipopt", "sqpmethod")
        return SolverEntry(entry.name, entry, _RULES.get(entry.name, "its own options"), takes)
    if not isinstance(entry, str):
        raise SolveError(
            f"a {type(entry).__name__} is no solver; give Solver('ipopt') or a name such as "
            f"{', '.join(repr(name) for name in DEFAULT[2:5])}"
        )
    if entry == NULL_SPACE:
        return SolverEntry(entry, None, "closed form: exact to rounding, for linear constraints")
    if entry == POLISHED:
        rule = "Ipopt as casid calls it, then Newton steps on the optimality conditions"
        return SolverEntry(entry, Solver(), rule, polish=True)
    if entry == TRUST_CONSTR:
        rule = "trust region with exact Hessian; stops when the region or the gradient is tiny"
        return SolverEntry(entry, None, rule, True)
    if entry == SLSQP:
        rule = "SQP with BFGS in place of the Hessian; stops when the criterion no longer falls"
        return SolverEntry(entry, None, rule, True)
    plug_in, _, qp = entry.partition("/")
    if plug_in == "sqpmethod":
        qp = qp or "qrqp"
        options, rule = _QP.get(qp, ({}, "its own options"))
        options = {"error_on_fail": False, **options}
        solver = Solver("sqpmethod", options=_SQP | {"qpsol": qp, "qpsol_options": options})
        return SolverEntry(
            entry,
            solver,
            f"SQP with exact Hessian, stops at 1e-11 of the steepest curvature; {qp}: {rule}",
            True,
        )
    solver = Solver(plug_in, options=_OPTIONS.get(plug_in, _QUIET))
    return SolverEntry(entry, solver, _RULES.get(plug_in, "its own rules"), plug_in == "ipopt")


def is_installed(solver: Solver) -> bool:
    """Whether CasADi loads the plug-in, and the one for its quadratic programs."""
    import casadi as ca

    qp = solver.options.get("qpsol")
    return bool(ca.has_nlpsol(solver.name)) and (qp is None or bool(ca.has_conic(qp)))
