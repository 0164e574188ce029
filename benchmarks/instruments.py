"""One refinement of instrumental variables, in passes over the record.

    python -m benchmarks.instruments [--repeats N]

A pass is one channel of the full record through a filter by scipy.signal.lfilter: through the
study's low-pass of 21 taps, which every channel goes through, and, shown beside it without a
target, through the recursion of second order that the instruments are simulated with. An iteration
simulates the instruments with the last estimate, forms the moments, weighs them, solves the program
and goes back to physical parameters: what a fit takes longer when it refines more often. In one
process on one thread; exit status 1 when the target is missed.
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

    from analysis.pendulum_study.records import PendulumRecords, low_pass
    from casid.estimation.moments.equations.parts import parts_of
    from casid.estimation.moments.instruments.instruments import (
        Instruments,
        Loop,
        reference_signals,
    )
    from casid.estimation.moments.instruments.reference_filter import ReferenceFilter
    from casid.estimation.moments.stages.moment_settings import MomentSettings
    from casid.estimation.moments.stages.stage import Stage
    from problems.pendulum import indirect_model

    experiments = PendulumRecords(0.3).experiments(0)[:1]
    model = indirect_model().with_known(m=0.0, k=10.39).with_unknown(d=0.1, I_x=0.15)
    (part,) = parts_of(model, experiments)
    instruments = Instruments("ref", ReferenceFilter.lag(0.1))
    loop = Loop(model, part.Ts)
    drives = reference_signals(instruments, loop.direct, part.channels, part.Ts, part.record)
    denominator, _ = loop.coefficients({**part.values, "d": 0.1067, "I_x": 0.1385})
    taps = low_pass(1).taps
    one_pass = least(lambda: lfilter(taps, [1.0], drives["a_y"]), repeats)
    recursion = least(lambda: lfilter([1.0], denominator, drives["a_y"]), repeats)
    few, many = 1, 6

    def fit(iterations: int) -> Any:
        """Refinements that never settle: tolerance 0 asks for all of them."""
        settings = MomentSettings(form="linear", iterations=iterations, tolerance=0.0)
        stage = Stage(model, [part], ("I_x", "d"), settings, instruments)
        start = np.array([0.15, 0.1])
        stage.fit([part], [part.values], start)  # build what is built once
        return lambda: stage.fit([part], [part.values], start)

    took = [least(fit(n), repeats) for n in (few, many)]
    iteration = (took[1] - took[0]) / (many - few)
    print(f"{part.channels['ref'].size} samples, one thread, least of {repeats}")
    print(f"  one pass, 21 taps           {one_pass:8.3f} ms")
    print(f"  one pass, the recursion     {recursion:8.3f} ms")
    print(f"  fit, {few} refinement          {took[0]:8.3f} ms")
    print(f"  fit, {many} refinements         {took[1]:8.3f} ms")
    print(f"  one more refinement         {iteration:8.3f} ms{iteration / one_pass:8.2f} passes")
    print(f"                                         {iteration / recursion:8.2f} of the recursion")
    missed = iteration / one_pass > TARGET
    print(f"  target: at most {TARGET} passes: {'MISSED' if missed else 'met'}")
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
