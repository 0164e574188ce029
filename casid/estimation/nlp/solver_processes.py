"""CasADi's solvers as contenders: each runs one program in a process of its own.

A plug-in that prints, hangs or crashes costs a row of a table and nothing else.
"""

from __future__ import annotations

import os
import pickle
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

from casid.errors import CasidError, SolveError
from casid.estimation.nlp.nlp import Array, Solution, Solver


@dataclass(frozen=True, slots=True)
class Contender:
    """A solver by its name in tables, and what it can be blamed for."""

    name: str
    solver: Solver | None  # None: not a CasADi plug-in
    rule: str  # how it steps, and when it stops
    takes_criterion: bool = False  # whether it accepts a Hessian that is no expression
    polish: bool = False  # Newton steps after it, as `Compiled.solve` takes them by default


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What a contender brought: a solution, or the reason why there is none."""

    name: str
    solution: Solution | None = None
    seconds: float = float("nan")  # of one solve, the solver being built
    reason: str = ""


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
_NOT_APART = "cannot be handed to a process of its own"
_CHILD = "from casid.estimation.nlp.solver_processes import _serve; _serve()"
_IMPORT_SECONDS = 60.0  # that a child may take to begin

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


def contender(entry: str | Solver) -> Contender:
    """A contender by its name: a CasADi plug-in, "sqpmethod/<QP plug-in>", one of SciPy's, or a
    `Solver` with options of the caller's own.
    """
    if isinstance(entry, Solver):
        takes = entry.name in ("ipopt", "sqpmethod")
        return Contender(entry.name, entry, _RULES.get(entry.name, "its own options"), takes)
    if not isinstance(entry, str):
        raise SolveError(
            f"a {type(entry).__name__} is no solver; give Solver('ipopt') or a name such as "
            f"{', '.join(repr(name) for name in DEFAULT[2:5])}"
        )
    if entry == NULL_SPACE:
        return Contender(entry, None, "closed form: exact to rounding, for linear constraints")
    if entry == POLISHED:
        rule = "Ipopt as casid calls it, then Newton steps on the optimality conditions"
        return Contender(entry, Solver(), rule, polish=True)
    if entry == TRUST_CONSTR:
        rule = "trust region with exact Hessian; stops when the region or the gradient is tiny"
        return Contender(entry, None, rule, True)
    if entry == SLSQP:
        rule = "SQP with BFGS in place of the Hessian; stops when the criterion no longer falls"
        return Contender(entry, None, rule, True)
    plug_in, _, qp = entry.partition("/")
    if plug_in == "sqpmethod":
        qp = qp or "qrqp"
        options, rule = _QP.get(qp, ({}, "its own options"))
        options = {"error_on_fail": False, **options}
        solver = Solver("sqpmethod", options=_SQP | {"qpsol": qp, "qpsol_options": options})
        return Contender(
            entry,
            solver,
            f"SQP with exact Hessian, stops at 1e-11 of the steepest curvature; {qp}: {rule}",
            True,
        )
    solver = Solver(plug_in, options=_OPTIONS.get(plug_in, _QUIET))
    return Contender(entry, solver, _RULES.get(plug_in, "its own rules"), plug_in == "ipopt")


def is_installed(solver: Solver) -> bool:
    """Whether CasADi loads the plug-in, and the one for its quadratic programs."""
    import casadi as ca

    qp = solver.options.get("qpsol")
    return bool(ca.has_nlpsol(solver.name)) and (qp is None or bool(ca.has_conic(qp)))


@contextmanager
def muted() -> Iterator[None]:
    """Send what libraries print from C, too, to nowhere."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = os.dup(1), os.dup(2)
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 1)
        os.dup2(sink, 2)
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for fd, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, fd)
            os.close(copy)
        os.close(sink)


def timed(solve: Any, repeats: int = 3) -> tuple[Solution, float]:
    """A solution, and the shortest time of a few runs; one run where it takes long."""
    begin = time.perf_counter()
    first = solve()
    best = time.perf_counter() - begin
    for _ in range(repeats - 1 if best < 0.2 else 0):
        begin = time.perf_counter()
        solve()
        best = min(best, time.perf_counter() - begin)
    return first, best


# CasADi plug-ins, in a process of their own


def run_apart(
    compiled: Any,
    values: Mapping[str, Any],
    start: Array | None,
    contenders: Sequence[Contender],
    timeout: float,
) -> list[Outcome]:
    """Solve with each plug-in in a child process; a child that dies or hangs is replaced.

    Parameters
    ----------
    compiled : what `Nlp.compile` returned.
    timeout : seconds for one contender, from which it counts as hanging.
    """
    todo, outcomes = list(contenders), []
    try:
        state = pickle.dumps((compiled, dict(values), start))
    except Exception as error:  # a Python callback inside the program
        words = f"{_NOT_APART}: {(str(error).strip().splitlines() or [''])[-1]}"
        return [Outcome(c.name, reason=words) for c in todo]
    while todo:
        done = _serve_to(state, todo, timeout)
        outcomes += done
        todo = todo[len(done) :]
    return outcomes


def _serve_to(state: bytes, todo: Sequence[Contender], timeout: float) -> list[Outcome]:
    """Outcomes from one child, up to and including the contender that ended it."""
    path = os.pathsep.join(p or os.getcwd() for p in sys.path)
    child = subprocess.Popen(
        [sys.executable, "-c", _CHILD],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": path},
    )
    answers: queue.Queue[Any] = queue.Queue()

    def listen() -> None:
        assert child.stdout is not None
        try:
            while True:
                answers.put(pickle.load(child.stdout))
        except (EOFError, pickle.UnpicklingError, OSError):
            answers.put(None)

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    done: list[Outcome] = []
    try:
        assert child.stdin is not None
        pickle.dump((state, [(c.name, c.solver, c.polish) for c in todo]), child.stdin)
        child.stdin.close()
        begun = answers.get(timeout=max(timeout, _IMPORT_SECONDS))
        if begun:  # what hinders the program from being read there
            return [Outcome(c.name, reason=f"{_NOT_APART}: {begun}") for c in todo]
        while begun is not None and len(done) < len(todo):
            found = answers.get(timeout=timeout)
            if found is None:
                break
            done.append(found)
        if len(done) < len(todo):
            code = child.wait(timeout=10)
            words = f"its process died (exit status {code})"
            done.append(Outcome(todo[len(done)].name, reason=words))
    except queue.Empty:
        words = f"no answer within {timeout:g} s: stopped"
        done.append(Outcome(todo[len(done)].name, reason=words))
    except BrokenPipeError:
        done.append(Outcome(todo[len(done)].name, reason="its process could not begin"))
    finally:
        child.kill()
        child.wait()
        listener.join(timeout=10)
        if child.stdout is not None:
            child.stdout.close()
    return done


def _serve() -> None:
    """In the child: read a program and names from standard input, answer one by one."""
    pipe = os.fdopen(os.dup(1), "wb")
    sink = os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 1)

    def answer(message: Any) -> None:
        pickle.dump(message, pipe)
        pipe.flush()

    state, entries = pickle.load(sys.stdin.buffer)
    try:
        compiled, values, start = pickle.loads(state)
    except Exception as error:
        answer((str(error).strip().splitlines() or [type(error).__name__])[-1])
        return
    answer("")
    for name, solver, polish in entries:
        answer(run_here(name, solver, partial(_attempt, compiled, values, start, polish)))


def _attempt(
    compiled: Any,
    values: Mapping[str, Any],
    start: Array | None,
    polish: bool,
    solver: Solver,
) -> tuple[Solution, float]:
    """The plug-in's own answer, polished if so wished."""
    program = compiled.with_solver(solver)
    return timed(lambda: program.solve(values, start, throw=False, polish=polish))


def run_here(name: str, solver: Solver, solve: Any) -> Outcome:
    """`solve(solver)` in this process: what it raises becomes the outcome's reason."""
    try:
        if not is_installed(solver):
            return Outcome(name, reason="not installed: CasADi loads no plug-in of that name here")
        solution, seconds = solve(solver)
        return Outcome(name, solution, seconds)
    except CasidError as error:
        return Outcome(name, reason=str(error).partition(": ")[2] or str(error))
    except Exception as error:
        last = (str(error).strip().splitlines() or [""])[-1]
        return Outcome(name, reason=f"{type(error).__name__}: {last}")
