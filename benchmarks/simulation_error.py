"""Simulation-error fit of one oscillator by casid, jax-sysid and lmfit, side by side.

    python -m benchmarks.simulation_error [--quick | --repeats N]

Every contender runs in a fresh process that imports, builds, fits and reports; the time is that of
the whole process. Contenders take turns, so that a busy machine troubles all alike. Exit status 1
when a target is missed.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
EQUAL = 1e-9  # relative agreement of sums of squares


@dataclass(slots=True)
class Contender:
    """One way to solve the task, and what its runs have given."""

    name: str
    command: Sequence[str]  # module and the arguments after the record
    seconds: list[float] = field(default_factory=list)
    megabytes: list[float] = field(default_factory=list)
    sum_of_squares: float = float("nan")
    values: dict[str, float] = field(default_factory=dict)

    def run(self, record: Path) -> None:
        """Run once in a fresh process and keep its result."""
        module, *rest = self.command
        start = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", module, str(record), *rest],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
        self.seconds.append(time.perf_counter() - start)
        if done.returncode != 0:
            raise SystemExit(f"{self.name} failed:\n{done.stderr[-2000:]}")
        result = json.loads(done.stdout.strip().splitlines()[-1])
        self.megabytes.append(result["megabytes"])
        self.sum_of_squares, self.values = result["sum_of_squares"], result["values"]

    @property
    def time(self) -> float:
        """Median wall time [s]."""
        return statistics.median(self.seconds)

    @property
    def memory(self) -> float:
        """Median peak memory [MB]."""
        return statistics.median(self.megabytes)


def contenders() -> dict[str, Contender]:
    """The contenders by name, casid first."""
    rows = [
        Contender("casid", ["benchmarks.peers_casid"]),
        Contender("jax-sysid", ["benchmarks.peers_jax_sysid"]),
        Contender("jax-sysid, no Adam", ["benchmarks.peers_jax_sysid", "--adam-epochs", "0"]),
        Contender("lmfit", ["benchmarks.peers_lmfit"]),
    ]
    return {row.name: row for row in rows}


def judged(label: str, value: float, target: float) -> bool:
    """Print a ratio beside its target; True if the target is met."""
    met = value <= target
    print(f"  {label:<34} {value:7.3f}   at most {target:.3f}   {'met' if met else 'MISSED'}")
    return met


def judged_optimum(ours: Contender, peers: Sequence[Contender]) -> bool:
    """Compare sums of squares: equal to 1e-9, or ours the lower."""
    print(f"\nsum of squares, relative to casid's (equal to {EQUAL:g}, or casid's the lower)")
    all_met = True
    for peer in peers:
        excess = peer.sum_of_squares / ours.sum_of_squares - 1
        met = excess >= -EQUAL
        verdict = "MISSED: casid's is higher"
        if met:
            equal = abs(excess) <= EQUAL
            verdict = "equal" if equal else "met: the peer stops above the optimum"
        all_met = all_met and met
        print(f"  {peer.name:<34} {excess:+.1e}   {verdict}")
    return all_met


def main() -> int:
    """Run the benchmark; 0 if every target is met."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3, help="runs of each contender (3)")
    parser.add_argument("--quick", action="store_true", help="one run of each")
    arguments = parser.parse_args()
    repeats = 1 if arguments.quick else arguments.repeats
    rows = contenders()
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "record.npy"
        maker = [sys.executable, "-m", "benchmarks.oscillator", str(record)]
        subprocess.run(maker, cwd=ROOT, check=True)
        for _ in range(repeats):
            for row in rows.values():
                row.run(record)
    print(f"{repeats} runs each, medians; seconds of the whole process, imports included\n")
    print(f"{'':<20}{'seconds':>9}{'(least':>9}{'most)':>8}{'MB':>7}   sum of squares")
    for row in rows.values():
        print(
            f"{row.name:<20}{row.time:9.2f}{min(row.seconds):9.2f}{max(row.seconds):8.2f}"
            f"{row.memory:7.0f}   {row.sum_of_squares:.12g}"
        )
        print("    " + ", ".join(f"{name} {value:.6g}" for name, value in row.values.items()))
    ours, jax, bare, lmfit = rows.values()
    print("\ncasid over the peer")
    met = [
        judged("time / jax-sysid", ours.time / jax.time, 1 / 3),
        judged("time / lmfit", ours.time / lmfit.time, 1 / 2),
        judged("memory / jax-sysid", ours.memory / jax.memory, 1 / 2),
    ]
    print(f"  {'time / jax-sysid, no Adam':<34} {ours.time / bare.time:7.3f}   no target")
    print(f"  {'memory / lmfit':<34} {ours.memory / lmfit.memory:7.3f}   no target")
    met.append(judged_optimum(ours, [jax, bare, lmfit]))
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
