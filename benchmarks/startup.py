"""How long casid takes to say what it can do, and to diagnose its own example on one core.

    python -m benchmarks.startup

Exit status 1 when a target is missed.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def on_one_core() -> dict[str, str]:
    """Tie this process and its children to one core; the environment to give the children."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    return {**os.environ, **dict.fromkeys(THREADS, "1")}


def seconds(arguments: list[str], environment: dict[str, str]) -> float:
    """Wall time of one `casid` command in a fresh process."""
    start = time.perf_counter()
    command = [sys.executable, "-m", "casid", *arguments]
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    taken = time.perf_counter() - start
    if done.returncode != 0:
        raise SystemExit(f"casid {' '.join(arguments)} failed:\n{done.stderr[-2000:]}")
    return taken


def judged(label: str, taken: float, target: float) -> bool:
    """Print a time beside its target; True if the target is met."""
    met = taken < target
    print(f"{label:<40}{taken:8.2f} s   under {target:g} s   {'met' if met else 'MISSED'}")
    return met


def main() -> int:
    """Run both; 0 if every target is met."""
    environment = on_one_core()
    shown = [seconds(["--help"], environment) for _ in range(5)]
    met = [judged("casid --help (median of 5)", statistics.median(shown), 0.5)]
    with tempfile.TemporaryDirectory() as folder:
        arguments = ["diagnose", "problems/pendulum.py", "--out", str(Path(folder) / "out")]
        met.append(
            judged("casid diagnose problems/pendulum.py", seconds(arguments, environment), 15.0)
        )
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
