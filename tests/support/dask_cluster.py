"""A Dask cluster as its documentation starts one: a scheduler and workers, processes each."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.support.shared import ROOT

WAIT = 600.0
"""Seconds for a process to come up on a busy machine."""


class Cluster:
    """A scheduler and two workers of one thread, each killed at the end with what it started."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.file = folder / "scheduler.json"
        self.file.unlink(missing_ok=True)
        self.log = folder / "cluster.log"
        where = ("--scheduler-file", str(self.file), "--no-dashboard")
        self.scheduler = self._start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", *where)
        self.address = self._address()
        one = ("dask_worker", "--nworkers", "1", "--nthreads", "1", *where)
        # Without a nanny, one process is the worker that is killed.
        self.workers = [self._start(*one, "--no-nanny") for _ in range(2)]

    def _start(self, module: str, *options: str) -> subprocess.Popen[bytes]:
        with self.log.open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.{module}", *options],
                env={**os.environ, "PYTHONPATH": str(ROOT)},
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    def _address(self) -> str:
        ends = time.monotonic() + WAIT
        while time.monotonic() < ends:
            with contextlib.suppress(OSError, ValueError, KeyError):
                return str(json.loads(self.file.read_text())["address"])
            time.sleep(0.05)
        raise TimeoutError(self.log.read_text())

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        for process in (*self.workers, self.scheduler):
            killed(process)


def killed(process: subprocess.Popen[bytes]) -> None:
    """Kill -9 a process and all that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
