"""A problem in another process, made again from its file: models have no pickle of their own."""

from __future__ import annotations

import contextlib
import functools
import hashlib
from dataclasses import dataclass

from casid.campaigns.manifest import name_of
from casid.data.problem import Problem, load_problem
from casid.errors import ModelError


@dataclass(frozen=True, slots=True)
class ProblemOrigin:
    """Where a problem comes from.

    Attributes
    ----------
    source : path of its file.
    known : parameters that it knows, with their SI values.
    sha256 : `digest` of what it has to be.
    takes_si : its numbers are in SI.
    """

    source: str
    known: tuple[tuple[str, float | None], ...]
    sha256: str
    takes_si: bool

    @classmethod
    def of(cls, problem: Problem) -> ProblemOrigin:
        """The origin of a problem that was loaded from a file.

        Raises
        ------
        ModelError
            If it was not.
        """
        if problem.source is None:
            raise ModelError(
                f"problem {problem.name} was not loaded from a file, so worker processes "
                "cannot have it; write it to a file and give casid.load_problem(path), or run in "
                "one process with joblib.parallel_config(n_jobs=1)"
            )
        model = problem.model
        known = tuple((n, p.value) for n, p in model.parameters.items() if p.is_known)
        return cls(str(problem.source), known, digest(problem), model.takes_si)

    def problem(self) -> Problem:
        """The problem, read once.

        Raises
        ------
        ModelError
            If the file makes another one: it was changed after it was loaded.
        """
        return _problem_of(self)


@functools.lru_cache(maxsize=8)
def _problem_of(origin: ProblemOrigin) -> Problem:
    problem = load_problem(origin.source)
    problem = problem.in_si() if origin.takes_si else problem
    problem = problem.with_si_values({n: v for n, v in origin.known if v is not None})
    if digest(problem) != origin.sha256:
        raise ModelError(
            f"the problem in {origin.source} is not the one to be studied: it was changed after it "
            "was loaded; make the change in the file, or run in one process with "
            "joblib.parallel_config(n_jobs=1)"
        )
    return problem


def digest(problem: Problem) -> str:
    """SHA-256 of the model, what is known of it, and the file that it comes from."""
    parts = [
        str(problem.model),
        *(repr(p) for p in problem.model.parameters.values()),
        repr(sorted(problem.noise.items())),
        repr(sorted(problem.truth.items())),
        repr(problem.starts),
        name_of(problem.simulate),
    ]
    if problem.source is not None:
        with contextlib.suppress(OSError):
            parts.append(problem.source.read_text(encoding="utf-8"))
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()
