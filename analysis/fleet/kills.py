"""Kill -9 of the main process of a fleet at random moments: is the table the same, bit for bit?"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from casid.fleets.fleet_table import CAUSES, PARAMETERS

ROOT = Path(__file__).resolve().parents[2]
START = 2.0
"""Seconds in which a process has hardly begun: kills come after some part of them or more."""


def survives(files: Sequence[Path], problem: Path, labels: str, out: Path, kills: int) -> bool:
    """True if the table of a run that is killed so often is that of one that is not.

    Each run goes on where the last one was killed, after a time that is drawn up to what all of it
    takes: the first kills come early, the last ones late. The kills leave the workers as they are.
    """
    arguments = ["fleet", str(problem), *map(str, files), "--asset", labels, "--jobs", "2"]
    begun = time.monotonic()
    if _started([*arguments, "--out", str(out / "whole")]).wait() != 0:
        return False
    whole = time.monotonic() - begun
    rng = np.random.default_rng(kills)
    command = [*arguments, "--out", str(out / "killed")]
    for k in range(kills):
        process = _started(command)
        time.sleep(float(rng.uniform(0.0, START + (whole - START) * (k + 1) / kills)))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    if _started(command).wait() != 0:
        return False
    return all(
        (out / "whole" / name).read_bytes() == (out / "killed" / name).read_bytes()
        for name in (CAUSES, PARAMETERS)
    )


def _started(arguments: Sequence[str]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", "from casid.cli.main import main; main()", *arguments, "--quiet"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
    )
