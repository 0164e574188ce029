"""Work in a process of its own: what takes more than its budget is ended, and the next goes on."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from casid.fleets.supervision import StoppedError, Supervised
from casid.fleets.thresholds import RECORD_BUDGET
from tests.support.dask_cluster import WAIT
from tests.support.shared import ROOT

HERE = "tests.fleets.test_supervision:"


def double(x: int) -> int:
    print("this goes to standard error")
    return 2 * x


def endless() -> None:
    while True:
        pass


def hungry() -> int:
    return len([bytearray(1 << 24) for _ in range(2000)])


def crashing() -> None:
    os.abort()


def failing() -> None:
    raise ValueError("no such thing")


@pytest.fixture
def process(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("CASID_TIME_FACTOR", "1")
    supervised = Supervised(20.0, 300.0)
    yield supervised
    supervised.end()


def test_tasks_are_done_one_after_another_by_one_process(process: Supervised) -> None:
    assert [process(HERE + "double", i) for i in range(3)] == [0, 2, 4]
    assert process("os:getpid") == process("os:getpid") != os.getpid()


def test_what_a_task_raises_is_raised_here(process: Supervised) -> None:
    with pytest.raises(ValueError, match="no such thing"):
        process(HERE + "failing")
    assert process(HERE + "double", 1) == 2


def test_a_function_that_is_not_there_is_told_and_the_next_one_done(process: Supervised) -> None:
    with pytest.raises(AttributeError, match="no_such"):
        process(HERE + "no_such", 1)
    assert process(HERE + "double", 1) == 2


def test_arguments_that_cannot_be_sent_are_told_and_the_next_ones_done(process: Supervised) -> None:
    with pytest.raises(Exception, match="pickle"):
        process(HERE + "double", lambda: 1)
    assert process(HERE + "double", 1) == 2


def test_the_libraries_of_a_task_are_loaded_outside_its_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A module that takes a second to load, and a budget of half a second."""
    (tmp_path / "slow_to_load.py").write_text("import time\ntime.sleep(1)\ndef f(): return 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("CASID_TIME_FACTOR", "1")
    process = Supervised(0.5, 300.0)
    try:
        assert process("slow_to_load:f") == 1
        with pytest.raises(StoppedError, match="budget of 0.5 s"):
            process(HERE + "endless")
    finally:
        process.end()


@pytest.mark.slow
def test_an_endless_task_is_ended_and_the_next_one_done(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CASID_TIME_FACTOR", "1")
    process = Supervised(3.0, 300.0)
    try:
        begun = time.monotonic()
        with pytest.raises(StoppedError, match="more than its budget of 3 s"):
            process(HERE + "endless")
        assert time.monotonic() - begun >= RECORD_BUDGET.grace * 3.0
        assert process(HERE + "double", 4) == 8
    finally:
        process.end()


@pytest.mark.skipif(sys.platform != "linux", reason="no such limit of memory")
def test_a_task_that_takes_too_much_memory_is_ended(process: Supervised) -> None:
    with pytest.raises(StoppedError, match="more memory than its budget of 300 MB"):
        process(HERE + "hungry")
    assert process(HERE + "double", 5) == 10


def test_a_crash_in_compiled_code_is_told_and_survived(process: Supervised) -> None:
    with pytest.raises(StoppedError, match="a crash in compiled code"):
        process(HERE + "crashing")
    assert process(HERE + "double", 6) == 12


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_process_ends_with_the_one_that_supervises_it() -> None:
    """Kill -9 of the parent, which can tell nobody, in the middle of an endless task."""
    program = (
        "import sys, threading, time\n"
        "from casid.fleets.supervision import Supervised\n"
        "s = Supervised(300.0, 300.0)\n"
        f"threading.Thread(target=s, args=({HERE + 'endless'!r},), daemon=True).start()\n"
        "while s._process is None: time.sleep(0.01)\n"
        "print(s._process.pid, flush=True)\n"
        "time.sleep(600)\n"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
    )
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    ends = time.monotonic() + WAIT
    while is_running(child) and time.monotonic() < ends:
        time.sleep(0.1)
    assert not is_running(child)


def is_running(pid: int) -> bool:
    """True unless there is no such process, or it has ended and nobody has asked how."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    stat = Path(f"/proc/{pid}/stat")
    return not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] != "Z"
