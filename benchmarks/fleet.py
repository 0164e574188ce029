"""How the time of a fleet grows with its records, and what memory a worker needs.

    python -m benchmarks.fleet [--quick] [--jobs N]

Simulated voyages of four ships (`analysis/fleet/voyages.py`: 5 % with a cause, 20 % in seas), more
and more of them, each fleet in a fresh process with its workers. Times are CPU seconds, which other
programs on the machine do not count in, of all processes; memory is the largest resident set of any
of them. Exit status 1 when a target is missed.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
SIZES, QUICK_SIZES = (100, 200, 400), (20, 40)
SHIPS, SEED = 4, 1
EXPONENT = 1.1  # of the growth of time with records, at most
MEGABYTES = 500.0  # of a worker


def case(records: int, jobs: int, folder: Path) -> None:
    """Run one fleet in this process and print what it took as JSON."""
    from analysis.fleet.study import of_fleet
    from analysis.fleet.voyages import plan, write

    voyages = write(plan(records, SHIPS, SEED), folder / "voyages", SEED)
    files = [folder / "voyages" / v.name for v in voyages]
    found, cost = of_fleet(files, folder / "fleet", jobs, screen=True)
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    row = {"processor": cost.processor, "wall": cost.wall, "peak": peak, "searched": found.searched}
    print(json.dumps(row))


def measured(records: int, jobs: int) -> dict[str, float]:
    """The numbers of one fleet in a fresh process."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "benchmarks.fleet", "--case", str(records), folder]
        done = subprocess.run(
            [*command, "--jobs", str(jobs)],
            cwd=ROOT,
            env={**os.environ, **dict.fromkeys(THREADS, "1"), "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            check=True,
        )
    row: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return row


def main() -> int:
    """Run every size, and say which targets are met."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="20 and 40 records")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--case", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.case:
        case(int(options.case[0]), options.jobs, Path(options.case[1]))
        return 0
    sizes = QUICK_SIZES if options.quick else SIZES
    print("records  searched  CPU s  CPU s a record  wall s  MB a process, at most")
    rows = []
    for n in sizes:
        row = measured(n, options.jobs)
        rows.append(row)
        print(
            f"{n:7d}  {row['searched']:8.0f}  {row['processor']:5.0f}  "
            f"{row['processor'] / n:14.2f}  {row['wall']:6.0f}  {row['peak']:6.0f}"
        )
    times = np.log([row["processor"] for row in rows])
    exponent = float(np.polyfit(np.log(sizes), times, 1)[0])
    peak = max(row["peak"] for row in rows)
    met = exponent <= EXPONENT, peak <= MEGABYTES
    print(
        f"{'ok  ' if met[0] else 'MISS'} time grows as records^{exponent:.2f}, at most {EXPONENT}"
    )
    print(f"{'ok  ' if met[1] else 'MISS'} {peak:.0f} MB a process, at most {MEGABYTES:.0f}")
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
