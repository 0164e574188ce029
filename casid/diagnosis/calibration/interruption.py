"""Ends of a calibration before its time: Ctrl-C, and the time limit of the run."""

from __future__ import annotations

import _thread
import contextlib
import math
import signal
import threading
from collections.abc import Iterator
from typing import Any

from casid.time_limit import seconds_left, time_factor


@contextlib.contextmanager
def ended_in_time(stop: threading.Event) -> Iterator[None]:
    """Do at the time limit what Ctrl-C does."""
    seconds = seconds_left()
    if not math.isfinite(seconds):
        yield
        return
    is_main = threading.current_thread() is threading.main_thread()
    timer = threading.Timer(
        seconds * time_factor(), _thread.interrupt_main if is_main else stop.set
    )
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextlib.contextmanager
def interruptible(stop: threading.Event, *, is_serial: bool) -> Iterator[None]:
    """The first Ctrl-C ends the runs, the next one whatever it ended before.

    In one process the current run is finished: compiled solvers swallow an exception.
    """
    before: Any = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return

    def once(number: int, frame: Any) -> None:
        """At the first interrupt, stop after the runs at hand; at the second, at once."""
        if stop.is_set():
            before(number, frame)
            return
        stop.set()
        if not is_serial:
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, once)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
