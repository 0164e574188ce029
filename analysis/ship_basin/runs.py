"""One draw of the basin: four records, the cases of Table 9.4, instruments and least squares.

Programs are built once for each process and kept for all of its draws (`estimated`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import casid
from analysis.ship_algorithm.study import EIGHT
from analysis.ship_algorithm.study import SETTINGS as ALGORITHM
from analysis.ship_basin.records import CASES, Basin, basin, experiments_of, halves, truth_of
from casid.arrays import Array
from casid.campaigns.campaign import Campaign, campaign
from casid.errors import CasidError
from casid.estimation.moments.instruments.black_box_reference import (
    black_box_instruments,
    black_box_references,
)
from casid.estimation.moments.stages.convergence import Convergence
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from casid.estimation.moments.stages.stage_plan import StageSpec
from casid.identification.moment_estimators import Reusable

if TYPE_CHECKING:
    from numpy.random import SeedSequence


LOAD = ("m", "zbar_m")
CHANNELS = ("gyro", "accel", "r")


@dataclass(frozen=True, slots=True)
class How:
    """How a draw is estimated.

    Attributes
    ----------
    lags : n_y, n_as and n_r; None: least squares.
    weighting : Q of (2.42).
    noise_model : orders of the ARMA model of the prefilter; None: 1, as in section 9.5.
    na, nb : of the black boxes from the rudder.
    """

    lags: int | None = 2
    weighting: str = "2sls"
    noise_model: tuple[int, int] | None = None
    na: int = 4
    nb: int = 5


INSTRUMENTS, LEAST_SQUARES = How(), How(lags=None)


_ESTIMATORS: dict[tuple[How, tuple[str, ...]], Reusable] = {}
"""Programs of each kind of estimate, built once a process."""


def estimated(experiments: Sequence[casid.Experiment], how: How = INSTRUMENTS) -> MomentEstimate:
    """Algorithm 8.1 as `iterative_joint` has it, z_f known, its programs used again."""
    key, instruments = (how, tuple(e.name for e in experiments)), None
    if how.lags is not None:
        boxes = black_box_references(experiments, "delta", CHANNELS, na=how.na, nb=how.nb)
        # names of channels alone: nothing of this draw
        instruments = black_box_instruments(EIGHT, boxes, n_y=how.lags, n_u=how.lags, n_delta=2)
        experiments = boxes.experiments
    if key not in _ESTIMATORS:
        settings = replace(ALGORITHM, weighting=how.weighting, noise_model=how.noise_model)  # type: ignore[arg-type]
        _ESTIMATORS[key] = Reusable(EIGHT, [StageSpec(())], instruments, settings=settings)
    return _ESTIMATORS[key](experiments)


def row(
    experiments: Sequence[casid.Experiment], label: str, how: How = INSTRUMENTS
) -> dict[str, Any]:
    """Values, standard errors, first iterations of one estimate, flat: "<label> m", ..."""
    try:
        found = estimated(experiments, how)
    except CasidError as refused:
        return {f"{label} refused": str(refused)[:300]}
    out: dict[str, Any] = {f"{label} {n}": found[n] for n in found.names}
    out |= {f"{label} se {n}": found.std_error(n) for n in found.names}
    out[f"{label} surplus p"] = found.propagated.p_value
    out[f"{label} bounds"] = len([p for p in found.parameters if "bound" in p.note])
    if how.lags is not None:
        path = Convergence.of(found.stages[0])
        out[f"{label} iterations"] = len(path.theta_p)
        for j in range(min(3, len(path.theta_p))):
            out |= {f"{label} it. {j} {n}": path.theta_p[j, path.names.index(n)] for n in LOAD}
    return out


@dataclass(frozen=True, slots=True)
class Draws:
    """What every draw of a campaign does; labels are "case 1 IV", "case 1 IV first half", ...

    Attributes
    ----------
    made : the records.
    hows : label -> how they are estimated.
    cases : of Table 9.4.
    halved : the halves of every record, instead of the whole.
    """

    made: Basin = field(default_factory=Basin)
    hows: tuple[tuple[str, How], ...] = (("IV", INSTRUMENTS),)
    cases: tuple[int, ...] = tuple(CASES)
    halved: bool = False

    def __call__(self, seed: SeedSequence) -> dict[str, Any]:
        """One draw."""
        records = basin(int(seed.generate_state(1)[0]), self.made)
        out: dict[str, Any] = {}
        for case in self.cases:
            whole = experiments_of(records, case, self.made)
            parts = {"": whole}
            if self.halved:
                parts = dict(zip((" first half", " second half"), halves(whole), strict=True))
            for name, how in self.hows:
                for part, experiments in parts.items():
                    out |= row(experiments, f"case {case} {name}{part}", how)
        return out


@dataclass(frozen=True, slots=True)
class Desk:
    """Where campaigns run, and where what they found is kept."""

    jobs: int = 2
    out: Path | None = None

    def do(self, name: str, draws: Draws, runs: int) -> Found:
        """A campaign, continued where its folder has some of it."""
        import joblib

        folder = None if self.out is None else self.out / "runs" / name
        with joblib.parallel_config(n_jobs=self.jobs):
            done = campaign(draws, runs, seed=9, out=folder)
        return Found(done, draws)


@dataclass(frozen=True, slots=True)
class Found:
    """Estimates of many draws beside the truth."""

    done: Campaign
    draws: Draws

    def column(self, label: str, name: str) -> Array:
        """(n,) values of the draws that were not refused."""
        column = np.asarray(self.done.column(f"{label} {name}"), dtype=float)
        return np.asarray(column[np.isfinite(column)])

    def refused(self, label: str) -> float:
        """Share of the draws without an estimate."""
        return 1 - len(self.column(label, "m")) / self.done.runs

    def truth(self, label: str, name: str) -> float:
        """The true value of a parameter in the case that the label names."""
        from problems.ship import TABLE_8_2

        own = truth_of(int(label.split()[1]), self.draws.made)
        return own[name] if name in own else TABLE_8_2[name]

    def errors(self, label: str, name: str) -> Array:
        """(n,) relative errors, per cent of the truth's size."""
        truth = self.truth(label, name)
        return np.asarray(100 * (self.column(label, name) / truth - 1))

    def median(self, label: str, name: str) -> float:
        """Relative error of the median [%]."""
        return float(np.median(self.errors(label, name)))

    def spread(self, label: str, name: str) -> float:
        """Standard deviation of the relative errors, from quantiles [%]."""
        low, high = np.quantile(self.errors(label, name), [0.1587, 0.8413])
        return float(high - low) / 2

    def std_error(self, label: str, name: str) -> float:
        """Median of the standard errors that the estimates report [%]."""
        column = self.column(label, f"se {name}")
        return float(100 * np.median(column) / abs(self.truth(label, name)))

    def covered(self, label: str, name: str) -> tuple[int, int, int]:
        """Draws; those whose interval lies wholly below the truth; and above."""
        z = (self.column(label, name) - self.truth(label, name)) / np.maximum(
            self.column(label, f"se {name}"), 1e-12
        )
        return len(z), int(np.sum(z < -1.96)), int(np.sum(z > 1.96))

    def line(self, label: str) -> dict[str, float | str]:
        """A row of a table: medians, spreads, standard errors and coverage of m and zbar_m."""
        out: dict[str, float | str] = {"what": label}
        for n in LOAD:
            count, low, high = self.covered(label, n)
            out |= {
                f"median error of {n}, %": self.median(label, n),
                f"spread of {n}, %": self.spread(label, n),
                f"std. error of {n}, %": self.std_error(label, n),
                f"95 % of {n} covers, %": 100 * (1 - (low + high) / count),
            }
        return out | {"draws": count, "refused, %": 100 * self.refused(label)}
