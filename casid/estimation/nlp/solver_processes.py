"""CasADi's solvers, each running one program in a process of its own.

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
from typing import IO, Any, Literal

from casid.arrays import Array
from casid.errors import CasidError
from casid.estimation.nlp.solution import Solution
from casid.estimation.nlp.solver import Solver
from casid.estimation.nlp.solver_catalogue import SolverEntry, is_installed
from casid.time_limit import time_factor


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """Solver outcome: a solution, or the reason why there is none, and its kind."""

    name: str
    solution: Solution | None = None
    seconds: float = float("nan")  # of one solve, the solver being built
    reason: str = ""
    kind: Literal["No_Answer", "Not_Installed", "Does_Not_Fit"] = "No_Answer"


_NOT_APART = "cannot be handed to a process of its own"
_CHILD = "from casid.estimation.nlp.solver_processes import _serve; _serve()"
_IMPORT_SECONDS = 60.0  # that a child may take to begin


@contextmanager
def muted() -> Iterator[None]:
    """Discard what libraries print, from C too."""
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
    entries: Sequence[SolverEntry],
    timeout: float,
) -> list[Outcome]:
    """Solve with each plug-in in a child process; a child that dies or hangs is replaced.

    Parameters
    ----------
    compiled : what `Nlp.compile` returned.
    timeout : seconds for one solver, from which it counts as hanging.
    """
    todo, outcomes = list(entries), []
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


def _serve_to(state: bytes, todo: Sequence[SolverEntry], timeout: float) -> list[Outcome]:
    """Outcomes from one child, up to and including the solver that ended it."""
    path = os.pathsep.join(p or os.getcwd() for p in sys.path)
    child = subprocess.Popen(
        [sys.executable, "-c", _CHILD],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": path},
    )
    answers: queue.Queue[Any] = queue.Queue()

    assert child.stdout is not None
    listener = threading.Thread(target=_collect, args=(child.stdout, answers), daemon=True)
    listener.start()
    done: list[Outcome] = []
    try:
        assert child.stdin is not None
        pickle.dump((state, [(c.name, c.solver, c.polish) for c in todo]), child.stdin)
        child.stdin.close()
        begun = answers.get(timeout=max(timeout, _IMPORT_SECONDS * time_factor()))
        if begun:  # why the program cannot be read there
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
        child.stdout.close()
    return done


def _collect(stream: IO[bytes], answers: queue.Queue[Any]) -> None:
    """Put the answers of a child process into a queue, and None when it ends."""
    try:
        while True:
            answers.put(pickle.load(stream))
    except (EOFError, pickle.UnpicklingError, OSError):
        answers.put(None)


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
    """The plug-in's own answer, polished if requested."""
    program = compiled.with_solver(solver)
    return timed(lambda: program.solve(values, start, throw=False, polish=polish))


def run_here(name: str, solver: Solver, solve: Any) -> Outcome:
    """`solve(solver)` in this process: what it raises becomes the outcome's reason."""
    try:
        if not is_installed(solver):
            why = "not installed: CasADi loads no plug-in of that name here"
            return Outcome(name, reason=why, kind="Not_Installed")
        solution, seconds = solve(solver)
        return Outcome(name, solution, seconds)
    except CasidError as error:
        return Outcome(name, reason=str(error).partition(": ")[2] or str(error))
    except Exception as error:
        last = (str(error).strip().splitlines() or [""])[-1]
        return Outcome(name, reason=f"{type(error).__name__}: {last}")
