"""Whether 95 % intervals of `identify` hold the truth 95 times in a hundred, cell by cell.

    python -m analysis.coverage [--quick] [--draws N] [--only WORD] [--out DIR]

Five systems (the indirect pendulum, a roll decay, a motor, two masses, a room) under white noise on
the outputs, coloured noise on them (second order near the resonance, or first order), noise on the
measured input at three levels, a fifth of the output samples missing, outputs of two rates (the
last one in every fourth sample), and a force of the first order that nobody measures. Every draw
has noise of its own and is fitted as a user would: `casid.identify`, one start, nothing said about
the noise; with a force, its place and kind. The indirect pendulum has no cell with one, since its
accelerometer, which is used as input, feels it. In its place stands the roll of a ship with a
rudder in beam seas (`ship.py`), whose accelerometer is an output, its sway a disturbance.

For every parameter: the share of printed intervals, of whatever kind, that hold the truth with its
95 % binomial interval (Wilson), bias over spread, and mean standard error over spread. A cell meets
its target where the binomial intervals of all its parameters reach into 93 to 97 %, or where at
least 95 % of its draws say themselves that a bias may be left. Where inputs are exact and the
system is linear, the RMS error is compared with the Cramer-Rao bound, too (`bounds.py`).
--quick: 20 draws of the motor. Exit 1 where a target is missed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

import casid
from analysis.common.runner import Run, Study
from analysis.common.targets import Target, holds
from analysis.coverage.bounds import bounds
from analysis.coverage.ship import SEAS, SeaCell
from analysis.coverage.systems import SYSTEMS, System
from casid.arrays import Array
from casid.campaigns.accuracy import Accuracy, accuracy_of
from casid.errors import CasidError
from casid.estimation.simulation.fit import FitSettings

CONDITIONS = (
    *("white", "coloured", "input, small", "input, medium", "input, large"),
    *("gaps", "two rates", "disturbance"),
)
GAPS = 0.2
SLOWER = 4  # samples of the fast clock for one of the slow one
WANTED = (0.93, 0.97)
FLAGGED = 0.95
EFFICIENT = 1.15
FLAGS = ("noise on measured inputs", "follows the residual", "values may be biased")
SETTLING = 2000  # samples of coloured noise before the record


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """One system under one condition, drawn many times."""

    system: System
    condition: str

    @property
    def name(self) -> str:
        """System and condition."""
        return f"{self.system.name}: {self.condition}"

    @property
    def truth(self) -> Mapping[str, float]:
        """Parameter -> true value."""
        return self.system.truth

    def record(self, draw: int) -> casid.Record:
        """The record of one draw."""
        rng = np.random.default_rng((draw, *self.name.encode()))
        motion = self.system.motion()
        columns = {name: values.copy() for name, values in motion.inputs.items()}
        if self.condition.startswith("input"):
            level = ("small", "medium", "large").index(self.condition.split()[-1])
            for name, levels in self.system.levels.items():
                columns[name] += levels[level] * rng.standard_normal(len(columns[name]))
        missing = {}
        pushed = self._pushed(len(next(iter(motion.outputs.values()))), rng)
        for name, values in motion.outputs.items():
            noise = self.system.noise[name] * self._noise(len(values), rng)
            columns[name] = values + noise + pushed.get(name, 0.0)
            if self.condition == "gaps":
                missing[name] = rng.random(len(values)) < GAPS
        if self.condition == "two rates":
            last = list(motion.outputs)[-1]
            missing[last] = np.arange(len(columns[last])) % SLOWER > 0
        model = self.system.model()
        units = {name: model.unit_of(name) for name in columns}
        return casid.Record(columns, units, Ts=motion.Ts, missing=missing, name="drawn")

    def bounds(self) -> dict[str, float]:
        """Parameter -> the least standard deviation that an estimate can have, where it is known.

        With the samples that the first draw misses.
        """
        record = self.record(0)
        missing = np.column_stack([record.is_missing(name) for name in self.system.noise])
        return bounds(self.system, self.condition, missing)

    def _pushed(self, N: int, rng: np.random.Generator) -> dict[str, Array]:
        """What the force does to the outputs (N,), where there is one."""
        push, plant, motion = self.system.push, self.system.plant, self.system.motion()
        if self.condition != "disturbance" or push is None or plant is None:
            return {}
        columns = push.response(plant.matrices(self.truth), N, motion.Ts, rng)
        return dict(zip(motion.outputs, columns.T, strict=True))

    def _noise(self, n: int, rng: np.random.Generator) -> Array:
        """(n,) of unit variance, white or with the system's pole."""
        white = rng.standard_normal(n + SETTLING)
        if self.condition != "coloured":
            return white[SETTLING:]
        pole = complex(self.system.pole)
        poles = [pole, pole.conjugate()] if pole.imag else [pole]
        denominator = np.poly(poles).real
        impulse = lfilter([1.0], denominator, np.eye(1, SETTLING)[0])
        shaped = lfilter([1.0], denominator, white)[SETTLING:]
        return np.asarray(shaped / math.sqrt(float(impulse @ impulse)))

    def estimate(self, draw: int) -> casid.Estimate:
        """The estimate of one draw."""
        system = self.system
        experiment = casid.Experiment(self.record(draw), {}, "drawn")
        problem = casid.Problem(system.name, system.model())
        push = system.push if self.condition == "disturbance" else None
        return casid.identify(
            problem,
            experiment,
            settings=FitSettings(starts=1),
            disturbances=() if push is None else f"{push.place}:first",
        )


@dataclass(frozen=True, slots=True)
class Drawn:
    """What the draws of a cell gave.

    Attributes
    ----------
    flagged : share of draws that warn of a bias.
    failed : draws without an estimate.
    """

    parameters: list[Accuracy]
    flagged: float
    failed: int


def accuracy(cell: Cell | SeaCell, draws: int) -> Drawn:
    """How well a cell's parameters are estimated."""
    names = list(cell.truth)
    found, flags, failed = [], 0, 0
    for draw in range(draws):
        try:
            estimate = cell.estimate(draw)
        except CasidError:
            failed += 1
            continue
        flags += any(flag in w for w in estimate.warnings for flag in FLAGS)
        rows = [estimate.parameter(name) for name in names]
        none = math.nan, math.nan
        found.append([(p.value, p.std_error or math.nan, *(p.interval or none)) for p in rows])
    values = np.array(found).reshape(-1, len(names), 4)
    out = []
    for i, name in enumerate(names):
        value, error, *ends = values[:, i].T
        out.append(accuracy_of(name, "", cell.truth[name], value, error, tuple(ends)))
    return Drawn(out, flags / max(len(found), 1), failed)


def row(a: Accuracy) -> str:
    """One parameter in a line."""
    low, high = a.coverage_interval or (math.nan, math.nan)
    return (
        f"{a.name} {100 * (a.coverage or 0.0):.0f} % [{100 * low:.0f}, {100 * high:.0f}], bias "
        f"{(a.bias or 0.0) / a.spread:+.2f}, error/spread {a.mean_std_error / a.spread:.2f}"
    )


def judged(name: str, drawn: Drawn) -> Target:
    """The coverage of a cell beside its target."""
    met = all(
        p.coverage_interval is not None
        and p.coverage_interval[0] <= WANTED[1]
        and p.coverage_interval[1] >= WANTED[0]
        for p in drawn.parameters
    )
    text = "; ".join(row(p) for p in drawn.parameters)
    said = f"; {100 * drawn.flagged:.0f} % of draws warn" if drawn.flagged else ""
    said += f"; {drawn.failed} failed" if drawn.failed else ""
    wanted = "93 to 97 %, or 95 % of draws warn"
    return holds(name, text + said, wanted, (met or drawn.flagged >= FLAGGED) and not drawn.failed)


def efficient(name: str, drawn: Drawn, least: Mapping[str, float]) -> Target:
    """The RMS errors of a cell over the least that there are.

    It meets the target where the interval of each ratio reaches it: of n draws a standard deviation
    is known to 1/sqrt(2 n).
    """
    rows = [(p.name, math.hypot(p.bias or 0.0, p.spread) / least[p.name]) for p in drawn.parameters]
    reach = 1.96 / math.sqrt(2 * max(drawn.parameters[0].n, 1))
    text = "; ".join(f"{name} {ratio:.2f}" for name, ratio in rows)
    met = all(ratio * (1 - reach) <= EFFICIENT for _, ratio in rows)
    said = f"{text} (+- {100 * reach:.0f} %)"
    wanted = f"RMS error at most {EFFICIENT:g} of the Cramer-Rao bound"
    return holds(f"{name}: efficiency", said, wanted, met)


def cells(only: str) -> Iterator[Cell | SeaCell]:
    """All cells whose name holds a word."""
    for system in SYSTEMS:
        for condition in CONDITIONS:
            if condition.startswith("input") and not system.levels:
                continue
            if condition == "disturbance" and system.push is None:
                continue
            cell = Cell(system, condition)
            if only in cell.name:
                yield cell
    yield from (cell for cell in SEAS if only in cell.name)


def found(run: Run) -> Iterator[Target | str]:
    """The cells, one by one."""
    draws = run.options.draws or (20 if run.quick else 400)
    only = run.options.only or ("motor" if run.quick else "")
    yield f"{draws} draws a cell"
    for cell in cells(only):
        drawn = accuracy(cell, draws)
        yield judged(cell.name, drawn)
        least = cell.bounds() if isinstance(cell, Cell) else {}
        if least:
            yield efficient(cell.name, drawn, least)


STUDY = Study(
    found,
    quick="20 draws of one system",
    options={
        "--draws": {"type": int, "help": "draws of each cell (default 400, quick 20)"},
        "--only": {"metavar": "WORD", "help": "cells whose name holds this word"},
    },
)
