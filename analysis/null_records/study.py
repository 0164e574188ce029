"""Records without a hidden effect: how often does the diagnosis raise an alarm?

    python -m analysis.null_records [--quick] [--draws N] [--only WORD]

Sixty pendulum records of 60 s from the independent simulator of the tests, seeds 1000 to 1059, and
nothing hidden in them; then the records of the coverage study, N of each of its systems: coloured
noise, noise on the measured input at three levels, samples missing, outputs of two rates, a random
force that nobody measures. At the nominal family-wise rate of 5 % the number of alarms is binomial;
wanted are no more than six of sixty, as more than that come with a probability of 3 %.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.stats import binom

import casid
from analysis.common.runner import Run, Study
from analysis.common.targets import Target
from analysis.coverage.study import CONDITIONS, Cell
from analysis.coverage.study import cells as coverage_cells
from problems import pendulum

RATE = 0.05
CHANCE = 0.03  # of more alarms than that


@dataclass(frozen=True, slots=True, eq=False)
class Null:
    """A record in which nothing is hidden, and the problem that it is diagnosed by."""

    name: str
    problem: casid.Problem
    record: Callable[[], casid.Record]


def pendulums(count: int, duration: float) -> Iterator[Null]:
    """Records of the pendulum on a cart, one a seed."""
    from tests.support import truth

    def record(seed: int) -> casid.Record:
        hidden = truth.cart_pendulum(seed=seed, duration=duration)
        return casid.Record(
            {n: np.asarray(c, dtype=np.float64) for n, c in hidden.columns.items() if n != "t"},
            {name: unit for name, unit in hidden.units.items() if name != "t"},
            Ts=hidden.Ts,
            name=f"seed {seed}",
        )

    for seed in range(1000, 1000 + count):
        yield Null(f"pendulum, seed {seed}", pendulum.problem, partial(record, seed))


def of_cells(condition: str, draws: int, only: str) -> Iterator[Null]:
    """Records of the coverage study under one condition, of all its systems that have it."""
    for cell in coverage_cells(only):
        if isinstance(cell, Cell) and cell.condition == condition:
            problem = casid.Problem(cell.system.name, cell.system.model(), starts=1)
            for draw in range(draws):
                name = f"{cell.name}, draw {draw}"
                yield Null(name, problem, partial(cell.record, draw))


def judged(what: str, nulls: Iterator[Null]) -> Target:
    """Diagnose them, a line for each alarm; the target is their number."""
    count = alarms = undecided = 0
    for null in nulls:
        d = casid.diagnose(null.problem, null.record(), advise=False)
        count += 1
        undecided += d.verdict == "undecided"
        if d.verdict == "deficient":
            alarms += 1
            named = ", ".join(f"{c.kind}({c.where}) p = {c.p_value:.1g}" for c in d.causes)
            print(f"  alarm in {null.name}: {named}", flush=True)
    most = int(binom.ppf(1 - CHANCE, count, RATE)) if count else 0
    found = f"{alarms} alarms, {undecided} undecided"
    return Target(f"{count} {what}", found, f"at most {most}", alarms <= most)


def alarms(run: Run) -> Iterator[Target]:
    """The pendulums, then each condition of the coverage study."""
    only = run.options.only or ""
    if not only:
        count, duration = (12, 30.0) if run.quick else (60, 60.0)
        yield judged("pendulums", pendulums(count, duration))
    draws = run.options.draws or (0 if run.quick else 20)
    for condition in CONDITIONS if draws else ():
        yield judged(f"nulls: {condition}", of_cells(condition, draws, only))


STUDY = Study(
    alarms,
    quick="12 pendulum records of 30 s",
    options={
        "--draws": {"type": int, "help": "records of each system and condition (default 20)"},
        "--only": {"metavar": "WORD", "help": "cells of the coverage study that hold this word"},
    },
)
