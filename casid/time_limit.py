"""How long the work at hand may take: a limit that every stage below can read.

A limit belongs to the call, not to an argument of every function in between: a fit deep inside a
diagnosis ends when the diagnosis has to.

On a slow or shared machine CASID_TIME_FACTOR=5 in the environment makes every limit five times as
long: what is found then does not depend on the machine.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import TypeVar

from casid.errors import DataError, OutOfTimeError

T = TypeVar("T")
_ENDS: ContextVar[float] = ContextVar("casid_time_limit", default=math.inf)


def time_factor() -> float:
    """How many seconds one second of a limit lasts: CASID_TIME_FACTOR, or 1.

    Raises
    ------
    DataError
        If it is no positive number.
    """
    text = os.environ.get("CASID_TIME_FACTOR") or "1"
    try:
        factor = float(text)
    except ValueError:
        factor = math.nan
    if not 0.0 < factor < math.inf:
        raise DataError(f"CASID_TIME_FACTOR={text}: give a positive number, for example 5")
    return factor


def wall_clock() -> float:
    """Seconds of wall time by which limits are judged."""
    return time.monotonic() / time_factor()


def processor_clock() -> float:
    """Seconds of processor time by which limits are judged: a busy machine finds the same."""
    return time.process_time() / time_factor()


@contextmanager
def until(ends: float) -> Iterator[None]:
    """Work inside ends at `ends` of `wall_clock`, or earlier where a limit around it does."""
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
    return max(_ENDS.get() - wall_clock(), 0.0)


def require_time(what: str) -> None:
    """Refuse to begin work after the limit.

    Raises
    ------
    OutOfTimeError
        If no time is left.
    """
    if seconds_left() <= 0.0:
        raise OutOfTimeError(f"{what}: the time limit is over; raise it (--budget SECONDS)")


@dataclass(frozen=True, slots=True)
class Undone:
    """What no time was left for.

    Attributes
    ----------
    not_done : each once, in order.
    """

    not_done: dict[str, None] = field(default_factory=dict)

    def attempt(self, what: str, function: Callable[[], T]) -> T | None:
        """The function's value; None, with a note of `what`, where the time limit is over."""
        try:
            require_time(what)
            return function()
        except OutOfTimeError:
            self.not_done[what] = None
        return None

    def add(self, *what: str) -> None:
        """Note more that was not done."""
        self.not_done.update(dict.fromkeys(what))


def out_of_time_text(not_done: Iterable[str]) -> str:
    """A sentence on what no time was left for."""
    return (
        f"the budget of time ended; not done: {', '.join(not_done)}. What was found until then is "
        "reported; raise it (--budget SECONDS) for the rest"
    )
