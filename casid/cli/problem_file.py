"""The problem file that a command names."""

from __future__ import annotations

from typing import TYPE_CHECKING

from casid.cli.terminal import quiet_stdout
from casid.errors import ModelError

if TYPE_CHECKING:
    from casid.cli.request import Request
    from casid.data.problem import Problem


def load(path: str) -> Problem:
    """The problem of a file; what the file prints goes to standard error.

    Raises
    ------
    ModelError
        If the file cannot be used, or ends the program.
    """
    from casid.data.problem import load_problem

    try:
        with quiet_stdout():
            return load_problem(path)
    except SystemExit as error:
        raise ModelError(
            f"problem file {path} ends the program (exit status {error.code}) instead of defining "
            "`problem`; remove the call to exit"
        ) from error


def known_problem(path: str, request: Request) -> Problem:
    """The problem of a file with the values of --set."""
    problem = load(path)
    return problem.with_known(request.known(problem))
