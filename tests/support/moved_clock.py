"""A clock that a test moves, in place of `casid.time_limit.time`."""

from __future__ import annotations

import time


class MovedClock:
    """The clock of this machine, `ahead` by so many seconds."""

    def __init__(self) -> None:
        self.ahead = 0.0

    def monotonic(self) -> float:
        """The time [s], moved."""
        return time.monotonic() + self.ahead

    def process_time(self) -> float:
        """The processor's time [s]."""
        return time.process_time()
