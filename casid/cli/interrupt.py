"""Ctrl-C during compiled solvers, which swallow it."""

from __future__ import annotations

import _thread
import contextlib
import io
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """End the work inside at Ctrl-C: the interrupt is repeated until a solver lets it through."""
    before: Any = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    requested, over = threading.Event(), threading.Event()

    def repeat() -> None:
        while not over.wait(0.1):
            _thread.interrupt_main()

    again = threading.Thread(target=repeat, daemon=True)

    def interrupt(number: int, frame: Any) -> None:
        """At the first interrupt, go on interrupting until the work ends."""
        if over.is_set():
            return
        if not requested.is_set():
            requested.set()
            sys.stdout = sys.stderr = io.StringIO()  # CasADi prints all that it swallows
            again.start()
        before(number, frame)

    streams = sys.stdout, sys.stderr
    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    except Exception:
        if requested.is_set():  # what Ctrl-C broke has not failed
            raise KeyboardInterrupt from None
        raise
    finally:
        over.set()
        if again.ident is not None:
            again.join()
        signal.signal(signal.SIGINT, before)
        sys.stdout, sys.stderr = streams
    if requested.is_set():
        raise KeyboardInterrupt
