"""One refinement of instrumental variables, in passes over the record.

    python -m benchmarks.instruments [--repeats N]

A pass is one channel of the full record through the filter that the instruments are simulated with,
1/denominator of the loop, by scipy.signal.lfilter. An iteration simulates the instruments with the
last estimate, forms the moments, weighs them, solves the program and checks what the instruments
see. In one process on one thread; exit status 1 when the target is missed.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from typing import Any

TARGET = 2.5  # passes


def least(call: Callable[[], Any], repeats: int) -> float:
    """Least time of a call [ms]."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return 1e3 * min(times)


def main() -> int:
    """Print the parts of an iteration beside a pass."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=100)
    repeats = parser.parse_args().repeats
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    import numpy as np
    from scipy.signal import lfilter

    from casid.instruments import Instruments, Loop, reference_signals
    from casid.moment_equations import moment_equations, parts_of
    from casid.reference_filter import ReferenceFilter
    from casid.stage import MomentSettings, Stage
    from problems.pendulum import indirect_model
    from problems.pendulum_study import Study

    experiments = Study(0.3).experiments(0)[:1]
    model = indirect_model().with_known(m=0.0, k=10.39).with_unknown(d=0.1, I_x=0.15)
    (part,) = parts_of(model, experiments)
    settings = Instruments("ref", ReferenceFilter.lag(0.1))
    loop = Loop(model, part.Ts)
    drives = reference_signals(settings, loop.direct, part.channels, part.Ts, part.record)
    values = {**part.values, "d": 0.1067, "I_x": 0.1385}
    denominator, _ = loop.coefficients(values)
    free = ("I_x", "d")
    stage = Stage(model, [part], free, MomentSettings(form="linear"), settings)
    start = np.array([0.1385, 0.1067])

    def simulate() -> Any:
        return loop.instruments(drives, values, settings, ["gyro"])

    simulated = simulate()

    def moments() -> Any:
        return moment_equations(part, simulated)

    equations = moments()

    def solve() -> Any:
        equations.require_correlation()
        root = equations.root_weight("2sls", equations.unconstrained(), None)
        return stage.solve([equations], [root], [values], start)

    def iteration() -> Any:
        nonlocal simulated, equations
        simulated = simulate()
        equations = moments()
        return solve()

    solve()  # build what is built once
    parts = {
        "simulate the instruments": simulate,
        "moments": moments,
        "weigh, solve, check": solve,
        "one iteration": iteration,
    }
    signal = drives["a_y"]
    one_pass = least(lambda: lfilter([1.0], denominator, signal), repeats)
    print(f"{len(signal)} samples, one thread, least of {repeats}")
    print(f"  {'one pass':<28}{one_pass:8.3f} ms")
    took = {name: least(call, repeats) for name, call in parts.items()}
    for name, ms in took.items():
        print(f"  {name:<28}{ms:8.3f} ms{ms / one_pass:8.2f} passes")
    missed = took["one iteration"] / one_pass > TARGET
    print(f"  target: at most {TARGET} passes: {'MISSED' if missed else 'met'}")
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
