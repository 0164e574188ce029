"""What a worker of a campaign does: some runs one after another, each with its seed."""

from __future__ import annotations

import contextlib
import functools
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from casid.campaigns.parquet_parts import FAILED, RUN, Row, row_of
from casid.errors import CasidError, DataError, OutOfTimeError
from casid.time_limit import seconds_left, until, wall_clock

if TYPE_CHECKING:
    from numpy.random import SeedSequence

Function = Callable[["SeedSequence"], Mapping[str, Any]]

UNLOADABLE = (
    "the function cannot be sent to the workers ({}); define it, and what it uses, at the top of a "
    "module that they can import, or run in one process with joblib.parallel_config(n_jobs=1)"
)


def run_seed(seed: int, run: int) -> SeedSequence:
    """The seed of one run: `SeedSequence(seed).spawn(n)[run]`, whatever n.

    `np.random.default_rng(run_seed(seed, run))` repeats the run's random numbers; a simulator that
    takes a number has `int(run_seed(seed, run).generate_state(1)[0])`.
    """
    return np.random.SeedSequence(seed, spawn_key=(run,))


@dataclass(frozen=True, slots=True)
class Done:
    """What a worker sends back."""

    rows: list[Row]
    seconds: float
    fault: str = ""  # results that no table can hold: the campaign ends
    first: int = -1  # the first of its runs, where none has a row


@functools.lru_cache(maxsize=1)
def _unpickled(content: bytes) -> Function:
    """The function in a worker: once for all of its batches, with all that it keeps."""
    return pickle.loads(content)  # type: ignore[no-any-return]


def run_batch(
    function: Function | bytes, seed: int, runs: Sequence[int], stop: bool, left: float
) -> Done:
    """Do runs one after another, within the seconds that are left; executed by a worker."""
    with until(wall_clock() + left):
        return _batch_done(function, seed, runs, stop)


def _batch_done(function: Function | bytes, seed: int, runs: Sequence[int], stop: bool) -> Done:
    rows: list[Row] = []
    start = time.perf_counter()
    if isinstance(function, bytes):
        try:
            function = _unpickled(function)
        except CasidError as error:
            return Done(rows, 0.0, str(error))
        except Exception as error:
            return Done(rows, 0.0, UNLOADABLE.format(f"{type(error).__name__}: {error}"))
    with _interrupts() as check:
        for run in runs:
            if seconds_left() <= 0.0:
                break
            try:
                result = function(run_seed(seed, run))
            except (Exception, SystemExit) as error:
                check()  # what Ctrl-C broke has not failed
                if isinstance(error, OutOfTimeError) and seconds_left() <= 0.0:
                    break
                name = type(error).__name__
                rows.append({RUN: run, FAILED: f"{name}: {error}" if str(error) else name})
                if stop:
                    break
                continue
            check()
            try:
                rows.append(row_of(run, result))
            except DataError as error:
                return Done(rows, time.perf_counter() - start, str(error))
    return Done(rows, time.perf_counter() - start, first=runs[0])


@contextlib.contextmanager
def _interrupts() -> Iterator[Callable[[], None]]:
    """Remember a Ctrl-C that compiled code swallows, as solvers do; what is yielded raises it."""
    interrupted = False

    def remember(number: int, frame: Any) -> None:
        nonlocal interrupted
        interrupted = True
        before(number, frame)

    def check() -> None:
        if interrupted:
            raise KeyboardInterrupt

    before: Any = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield check
        return
    signal.signal(signal.SIGINT, remember)
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, before)
