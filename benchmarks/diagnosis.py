"""How long a diagnosis takes, and how much memory its test of every effect needs.

    python -m benchmarks.diagnosis [--quick] [--real]

A mass on a spring and a damper, with damping by drag that its model lacks: its position with white
noise, the force measured with noise of its own, 100 Hz. Records of 60 s and of 30 minutes, seven
tenths of them fitted. Each case runs in a fresh process on one thread; times are CPU seconds, which
other programs on the machine do not count in, a C compiler's included. Steps are compiled into an
empty folder, and the whole diagnosis is run once more, with what was compiled. `--real` adds EMPS
(25 000 samples at 1 kHz) and Silverbox (40 000 fitted) from the folder that `CASID_SHARED` names.
The memory of the score stage is the peak of what Python and NumPy hold in `score_test` beyond what
they held before, by tracemalloc, over the number of candidates. Exit status 1 when a target is
missed.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
import tracemalloc
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
SHORT, LONG = 60, 1800  # s
TS = 0.01  # s
LEAST = 20  # candidates that a case must have to count
SECONDS = 60.0  # of the long record's diagnosis
SHORT_SECONDS = 2.5  # of the short record's, with what was compiled before
REAL = {  # folder, file, share held out, seconds
    "emps": ("estimation.csv", 0.3, 20.0),
    "silverbox": ("multisine.csv", 0.2, 40.0),
}
MEGABYTES = 8.0  # a candidate of its score stage


def example(duration: float) -> tuple[Any, Any]:
    """The problem and one record of `duration` [s]."""
    import numpy as np

    import casid
    from casid.estimation.simulation.integration.simulator import Simulator
    from casid.model.effects.balances.balance_effects import quadratic_damping

    m = casid.Model("mass on a spring")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    force = m.input("force", "N")
    k = m.parameter("k", "N/m", start=40.0, lower=0.0)
    d = m.parameter("d", "N s/m", start=1.0, lower=0.0)
    M = m.parameter("M", "kg", start=1.5, lower=0.1)
    m.derivative(x, v)
    m.balance(v, "forces", inertia=M, terms=[-k * x, -d * v, force])
    m.output("position", x, "m")
    rng = np.random.default_rng(1)
    N = round(duration / TS)
    levels = np.repeat(rng.normal(0.0, 20.0, N // 50 + 1), 50)[:N]
    acting = np.convolve(levels, np.ones(20) / 20, mode="same")
    model, (drag,) = quadratic_damping(m, "forces").extended(m)
    truth = {"k": 50.0, "d": 1.2, "M": 2.0, drag: 0.8}
    simulator = Simulator(model, TS, substeps=4)
    p = np.array([truth[name] for name in simulator.equations.parameters])
    position = simulator.simulate(acting[:, None], p, np.array([0.3, -0.5])).y[:, 0]
    columns = {
        "force": acting + 0.2 * rng.standard_normal(N),
        "position": position + 0.01 * rng.standard_normal(N),
    }
    record = casid.Record(columns, {"force": "N", "position": "m"}, Ts=TS)
    return casid.Problem("mass on a spring", m), record


def used() -> float:
    """CPU seconds of this process and of those that it has waited for, a compiler's among them."""
    return sum(os.times()[:4])


def whole(case: str) -> dict[str, Any]:
    """The whole diagnosis: CPU seconds, and the peak memory of the process [MB]."""
    import casid

    hold_out = 0.3
    data: Any
    if case in REAL:
        name, hold_out, _ = REAL[case]
        problem = casid.load_problem(str(ROOT / "problems" / f"{case}.py"))
        data = problem.read(shared() / "data" / case / name)
    else:
        problem, data = example(float(case))
    began = used()
    found = casid.diagnose(problem, data, hold_out=hold_out)
    taken = used() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "seconds": taken,
        "megabytes": peak / (1e6 if sys.platform == "darwin" else 1e6 / 1024),
        "found": repr(found),
    }


def shared() -> Path:
    """The folder of measured records."""
    return Path(os.environ.get("CASID_SHARED", ROOT.parent / "shared"))


def scores(case: str) -> dict[str, Any]:
    """The score stage at the fitted model: candidates, CPU seconds, MB a candidate."""
    import casid
    from casid.diagnosis.evidence.records.signal_sizes import sizes_of
    from casid.diagnosis.evidence.scores.score_tests import score_test
    from casid.diagnosis.evidence.whitening.prewhitening import Weighing
    from casid.estimation.holdout import split_records
    from casid.estimation.simulation.fit import FitSettings, fit_model
    from casid.model.effects.catalogue import catalogue

    problem, record = example(float(case))
    split = split_records([casid.Experiment(record, {}, "r")], 0.3)
    fit = fit_model(problem.model, split.fitted, FitSettings(starts=1))
    at = Weighing(split.fitted).weigh(problem.model, fit)
    effects = catalogue(at.model, sizes_of(at, {}), {})
    began = time.process_time()
    score_test(at.fit, effects, input_sd=at.input_sd)
    taken = time.process_time() - began
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    score_test(at.fit, effects, input_sd=at.input_sd)
    _, peak = tracemalloc.get_traced_memory()
    return {
        "seconds": taken,
        "candidates": len(effects),
        "samples": sum(d.N for d in at.criterion.data),
        "megabytes": (peak - before) / 1e6 / len(effects),
    }


def fresh(what: str, case: str, compiled: str) -> dict[str, Any]:
    """One case in a process of its own, with the steps that a folder has."""
    command = [sys.executable, "-m", "benchmarks.diagnosis", "--case", what, case]
    environment = {**os.environ, **dict.fromkeys(THREADS, "1"), "CASID_CACHE": compiled}
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)} failed:\n{done.stderr[-2000:]}")
    return dict(json.loads(done.stdout.splitlines()[-1]))


def judged(label: str, value: float, unit: str, target: float) -> bool:
    """Print a number beside its target; True if the target is met."""
    met = value <= target
    print(f"{label:<44}{value:9.2f} {unit:<3}at most {target:g}   {'met' if met else 'MISSED'}")
    return met


def main() -> int:
    """Run all; 0 if every target is met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="the short record alone")
    parser.add_argument("--real", action="store_true", help="measured records as well")
    parser.add_argument("--case", nargs=2, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.case:
        run = {"whole": whole, "scores": scores}[chosen.case[0]]
        print(json.dumps(run(chosen.case[1])), flush=True)
        return 0
    met = True
    with tempfile.TemporaryDirectory() as compiled:
        for duration in [SHORT] if chosen.quick else [SHORT, LONG]:
            met = simulated(duration, compiled) and met
        for case, (name, _, target) in REAL.items() if chosen.real else ():
            if not (shared() / "data" / case / name).exists():
                print(f"{case}: absent; set CASID_SHARED to the folder of measured records")
                continue
            first, again = (fresh("whole", case, compiled) for _ in range(2))
            print(f"{case}: {first['found']}")
            met = judged("whole diagnosis, compiling", first["seconds"], "s", target) and met
            print(f"{'whole diagnosis once more':<44}{again['seconds']:9.2f} s")
    return 0 if met else 1


def simulated(duration: int, compiled: str) -> bool:
    """One record of the mass on a spring; True if its targets are met."""
    case = str(duration)
    tested = fresh("scores", case, compiled)
    first, again = (fresh("whole", case, compiled) for _ in range(2))
    print(
        f"{duration} s at {1 / TS:g} Hz: {tested['samples']} samples fitted, "
        f"{tested['candidates']} candidates; {first['found']}"
    )
    met = tested["candidates"] >= LEAST
    if duration == LONG:
        met = judged("whole diagnosis, compiling", first["seconds"], "s", SECONDS) and met
        label = "score stage, memory a candidate"
        met = judged(label, tested["megabytes"], "MB", MEGABYTES) and met
        print(f"{'whole diagnosis once more':<44}{again['seconds']:9.2f} s")
    else:
        print(f"{'whole diagnosis, compiling':<44}{first['seconds']:9.2f} s")
        met = judged("whole diagnosis once more", again["seconds"], "s", SHORT_SECONDS) and met
    print(f"{'score stage':<44}{tested['seconds']:9.2f} s")
    print(f"{'peak memory of the process':<44}{first['megabytes']:9.0f} MB")
    return met


if __name__ == "__main__":
    sys.exit(main())
