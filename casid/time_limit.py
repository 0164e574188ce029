"""How long the work at hand may take: a limit that every stage below can read.

A limit belongs to the call, not to an argument of every function in between: a fit deep inside a
diagnosis ends when the diagnosis has to.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from casid.errors import OutOfTimeError

_ENDS: ContextVar[float] = ContextVar("casid_time_limit", default=math.inf)


@contextmanager
def until(ends: float) -> Iterator[None]:
    """Work inside ends at `ends` of `time.monotonic`, or earlier where a limit around it does."""
    token = _ENDS.set(min(_ENDS.get(), ends))
    try:
        yield
    finally:
        _ENDS.reset(token)


@contextmanager
def no_time_limit() -> Iterator[None]:
    """Work inside is finished, whatever limit is around it: what a result cannot do without."""
    token = _ENDS.set(math.inf)
    try:
        yield
    finally:
        _ENDS.reset(token)


def seconds_left() -> float:
    """Seconds until the limit; infinite where there is none, 0 where it is over."""
    return max(_ENDS.get() - time.monotonic(), 0.0)


def require_time(what: str) -> None:
    """Refuse to begin work after the limit.

    Raises
    ------
    OutOfTimeError
        If no time is left.
    """
    if seconds_left() <= 0.0:
        raise OutOfTimeError(f"{what}: the time limit is over; raise it (--budget SECONDS)")
