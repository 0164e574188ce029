"""Work in a process of its own, which is ended where it takes more than its budget.

A limit that the work checks itself ends neither a simulation that never returns nor an allocation;
the supervising process ends both. It starts the process once and hands it task after task, so that
what the tasks keep (a loaded problem, functions that were built) is built once. Functions are given
by name: their libraries are loaded in that process alone, before the time of a task begins.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import pkgutil
import queue
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import IO, Any

from casid.errors import SolveError
from casid.fleets.thresholds import RECORD_BUDGET
from casid.time_limit import time_factor

_LENGTH = struct.Struct("<Q")
_CHILD = "from casid.fleets.supervision import serve; serve()"


class StoppedError(SolveError):
    """The process of a task was ended, or ended itself."""


class Supervised:
    """A process that does one task after another.

    Parameters
    ----------
    seconds : of wall time for one task, `time_factor()` times as many on a slow machine. It is
        stopped after `RECORD_BUDGET.grace` times as many.
    memory : megabytes that a task may take beside what the libraries have taken; where the system
        has no such limit, none.
    """

    def __init__(self, seconds: float, memory: float) -> None:
        self.seconds, self.memory = seconds, memory
        self._process: subprocess.Popen[bytes] | None = None
        self._answers: queue.Queue[bytes | None] = queue.Queue()

    def __call__(self, function: str, *arguments: Any) -> Any:
        """The value of a function, "module:name", of arguments that can be pickled.

        Raises
        ------
        StoppedError
            If it took more time or memory than it may, its libraries did not load in time, or its
            process crashed.
        Exception
            What the function raises.
        """
        process = self._running()
        wall = RECORD_BUDGET.grace * self.seconds * time_factor()
        task = pickle.dumps((arguments, wall, self.memory))
        loading = RECORD_BUDGET.loading * time_factor()
        answer = self._answer(process, pickle.dumps(function), loading, _NOT_LOADED)
        if answer == _LOADED:
            answer = self._answer(process, task, wall, over_time(self.seconds))
        if answer is None:
            status = process.wait()
            self.end()
            raise StoppedError(self._why(status))
        value, error = pickle.loads(answer)
        if isinstance(error, MemoryError):
            self.end()  # what it holds is in pieces
            raise StoppedError(f"it needed more memory than its budget of {self.memory:g} MB")
        if error is not None:
            raise error
        return value

    def _answer(
        self, process: subprocess.Popen[bytes], content: bytes, timeout: float, late: str
    ) -> bytes | None:
        """What the process answers, None if it has ended; one that takes too long is ended."""
        assert process.stdin is not None
        try:
            _send(process.stdin, content)
            return self._answers.get(timeout=timeout)
        except OSError:
            return None
        except queue.Empty:
            self.end()
            raise StoppedError(late) from None

    def end(self) -> None:
        """End the process, whatever it does."""
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is not None and self._process.poll() is None:
            return self._process
        self.end()
        paths = os.pathsep.join(p for p in sys.path if p)
        process = subprocess.Popen(
            [sys.executable, "-c", _CHILD, str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": paths},
        )
        answers: queue.Queue[bytes | None] = queue.Queue()
        stream = process.stdout
        assert stream is not None

        def read() -> None:
            for answer in _frames(stream):
                answers.put(answer)
            answers.put(None)

        threading.Thread(target=read, name="casid-supervised", daemon=True).start()
        self._process, self._answers = process, answers
        return process

    def _why(self, status: int) -> str:
        import signal

        if -status in (getattr(signal, "SIGXCPU", None), getattr(signal, "SIGKILL", None)):
            return over_time(self.seconds) if -status == signal.SIGXCPU else _KILLED
        return f"its process ended by itself (status {status}): a crash in compiled code"


_LOADED = b"loaded"
_NOT_LOADED = f"its process had not loaded its libraries after {RECORD_BUDGET.loading:g} s"
_KILLED = "its process was killed from outside, as systems do that run out of memory"


def over_time(seconds: float) -> str:
    """Why a task was stopped."""
    return f"it took more than its budget of {seconds:g} s"


def _send(stream: IO[bytes], content: bytes) -> None:
    stream.write(_LENGTH.pack(len(content)))
    stream.write(content)
    stream.flush()


def _frames(stream: IO[bytes]) -> Iterator[bytes]:
    """The messages sent, until the other side ends."""
    with contextlib.suppress(OSError, ValueError):
        while len(head := stream.read(_LENGTH.size)) == _LENGTH.size:
            (length,) = _LENGTH.unpack(head)
            if len(content := stream.read(length)) < length:
                return
            yield content


def end_with_parent(parent: int) -> None:
    """End this process soon after the one that started it, which may have been killed.

    A killed worker does not report its end, and idle workers would hold their memory for minutes.

    Parameters
    ----------
    parent : its process number.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(RECORD_BUDGET.look)
        os._exit(1)

    if os.name == "posix":
        threading.Thread(target=watch, name="casid-parent", daemon=True).start()


def serve() -> None:
    """Do the tasks that come in on standard input until it ends; what they print goes to stderr."""
    import signal

    end_with_parent(int(sys.argv[1]))

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that supervises ends this one
    tasks, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    sys.stdin = open(os.devnull)
    frames = _frames(tasks)
    for name in frames:
        value, error = None, None
        try:
            function = pkgutil.resolve_name(pickle.loads(name))
            _send(answers, _LOADED)
            arguments, seconds, memory = pickle.loads(next(frames))
            with _limited(seconds, memory):
                value = function(*arguments)
        except Exception as raised:
            error = raised
        try:
            answer = pickle.dumps((value, error))
        except Exception:
            answer = pickle.dumps((None, RuntimeError(f"{type(error).__name__}: {error}")))
        try:
            _send(answers, answer)
        except OSError:  # the supervisor has ended
            return


@contextlib.contextmanager
def _limited(seconds: float, megabytes: float) -> Iterator[None]:
    """Limits of the system, where it has them: they hold even where no Python runs any more.

    Of processor time too, so that a task ends of which the supervisor was killed.
    """
    try:
        import resource
    except ImportError:
        yield
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    spent = used.ru_utime + used.ru_stime
    before = {}
    limits = {resource.RLIMIT_CPU: int(spent + 2 * seconds + 10)}
    taken = _data_bytes()
    if taken is not None and hasattr(resource, "RLIMIT_DATA"):
        limits[resource.RLIMIT_DATA] = int(taken + megabytes * 2**20)
    for limit, value in limits.items():
        soft, hard = resource.getrlimit(limit)
        before[limit] = (soft, hard)
        most = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(limit, (most, hard))
    try:
        yield
    finally:
        for limit, pair in before.items():
            resource.setrlimit(limit, pair)


def _data_bytes() -> int | None:
    """Private memory that this process has, as Linux counts it; None elsewhere."""
    with contextlib.suppress(OSError, ValueError, IndexError), open("/proc/self/status") as file:
        for line in file:
            if line.startswith("VmData:"):
                return int(line.split()[1]) * 1024
    return None
