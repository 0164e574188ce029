"""Records without a hidden effect: how often does the diagnosis raise an alarm?

    python -m analysis.null_records [--quick]

Sixty pendulum records of 60 s from the independent simulator of the tests, seeds 1000 to 1059, and
nothing hidden in them. Wanted: at most six called deficient. At the nominal family-wise rate of
5 % the number is binomial with mean 3, and more than six come with a probability of 3 %.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import casid
from analysis.common.runner import Run, Study
from analysis.common.targets import Target
from problems import pendulum

LARGEST = {60: 6, 12: 2}  # records -> alarms that chance explains at 5 % a record


def alarms(run: Run) -> Iterator[Target]:
    """Print a line for each alarm; the target is their number."""
    from tests.support import truth

    count, duration = (12, 30.0) if run.quick else (60, 60.0)
    alarms = undecided = 0
    for seed in range(1000, 1000 + count):
        hidden = truth.cart_pendulum(seed=seed, duration=duration)
        record = casid.Record(
            {n: np.asarray(c, dtype=np.float64) for n, c in hidden.columns.items() if n != "t"},
            {name: unit for name, unit in hidden.units.items() if name != "t"},
            Ts=hidden.Ts,
            name=f"seed {seed}",
        )
        d = casid.diagnose(pendulum.problem, record)
        undecided += d.verdict == "undecided"
        if d.verdict == "deficient":
            alarms += 1
            named = ", ".join(f"{c.kind}({c.where}) p = {c.p_value:.1g}" for c in d.causes)
            print(f"  alarm in seed {seed}: {named}", flush=True)
    most = LARGEST[count]
    found = f"{alarms} alarms, {undecided} undecided"
    yield Target(f"{count} null records", found, f"at most {most}", alarms <= most)


STUDY = Study(alarms, quick="12 records of 30 s")
