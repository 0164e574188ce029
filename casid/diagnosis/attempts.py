"""Attempts that may fail: a candidate whose numbers break down is left out, and the search goes on.

The one place where a numerical failure, or the end of the time limit, leaves out a part of a
diagnosis. A divergence that another start may avoid is caught where that start is tried.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from casid.errors import CasidError, OutOfTimeError
from casid.estimation.simulation.minimization import DivergenceError
from casid.model.quantities import count_text
from casid.time_limit import out_of_time_text, require_time, until, wall_clock

T = TypeVar("T")

FAILURES = (CasidError, ArithmeticError, RuntimeError, ValueError)
"""What casid, NumPy (`LinAlgError` is a ValueError), SciPy and CasADi raise where numbers fail."""


@dataclass(slots=True)
class Attempts:
    """Computations that failed, and why.

    Attributes
    ----------
    ends : of `wall_clock`, when attempts have to end.
    failed : what was left out -> why.
    not_done : what no time was left for, each once, in order.
    """

    ends: float = math.inf
    failed: dict[str, str] = field(default_factory=dict)
    not_done: dict[str, None] = field(default_factory=dict)

    def attempt(self, what: str, function: Callable[[], T]) -> T | None:
        """The function's value; None, with a note under `what`, where it fails or time is over."""
        try:
            with until(self.ends), np.errstate(all="ignore"):
                require_time(what)
                return function()
        except OutOfTimeError:
            self.not_done[what] = None
        except FAILURES as error:
            self.failed[what] = reason_of(error)
        return None

    @contextmanager
    def within(self, share: float) -> Iterator[None]:
        """Attempts inside have to end after a share of the time that is left."""
        ends, now = self.ends, wall_clock()
        self.ends = now + share * max(ends - now, 0.0)
        try:
            yield
        finally:
            self.ends = ends

    def succeeded(self, what: str) -> None:
        """Forget the failures of something that succeeded from another start."""
        self.failed.pop(what, None)

    def reasons(self) -> str:
        """Why attempts failed, each reason once: the first few, and how many more."""
        reasons = list(dict.fromkeys(self.failed.values()))
        more = len(reasons[3:])
        return "; ".join(
            [*reasons[:3], *([f"and {count_text(more, 'more reason')}"] if more else [])]
        )

    def notes(self) -> list[str]:
        """What was left out and what was not done, in sentences."""
        found = []
        if self.not_done:
            found.append(out_of_time_text(self.not_done))
        found += [f"{what} was left out: {why}" for what, why in self.failed.items()]
        return found


def reason_of(error: Exception) -> str:
    """An error in one line, those of other libraries as what they are to a reader."""
    if isinstance(error, DivergenceError):
        return error.what  # of a candidate: its start is not the user's
    lines = str(error).strip().splitlines() or [type(error).__name__]
    if isinstance(error, CasidError):
        return lines[0]
    return f"its numbers break down ({lines[-1].strip()})"
