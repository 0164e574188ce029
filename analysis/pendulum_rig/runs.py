"""Monte Carlo on the rig: do the intervals of stages and joint estimates cover?

The cart's motion is the same in all runs, the disturbance torque, the sensors' noise and the error
of the tilting test are new in each. Intervals of m and z_m are compared with the truth; those of
I_x, d and k against the estimate from the motion alone, which carries the bilinear offset.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from analysis.pendulum_rig.estimators import FREE, TILTED, TRUTH, joint, staged
from analysis.pendulum_rig.records import Draws
from casid.campaigns.campaign import Campaign
from casid.estimation.moments.stages.prior import Prior
from casid.identification.moment_estimators import Reusable


@dataclass(frozen=True)
class RigRun:
    """One run of the campaign: estimates and standard errors of every kind, by name."""

    duration: float = 600.0
    seed: int = 1

    def __reduce__(self) -> tuple[Any, ...]:
        return RigRun, (self.duration, self.seed)  # a worker makes the rest for itself

    @cached_property
    def draws(self) -> Draws:
        """The records, made once a worker."""
        return Draws(self.duration, seed=self.seed)

    @cached_property
    def estimators(self) -> tuple[Reusable, Reusable]:
        """Stages and joint, derived once a worker."""
        return staged(), joint()

    def __call__(self, seed: np.random.SeedSequence) -> Mapping[str, Any]:
        """Stages, joint, and stages with M and z_g from a tilting test of this run."""
        rng = np.random.default_rng(seed)
        experiments = self.draws.experiments(rng)
        error = rng.standard_normal(2) * np.sqrt(np.diag(TILTED.matrix()))
        found = {n: v + e for (n, v), e in zip(TILTED.values.items(), error, strict=True)}
        stages, together = self.estimators
        tilted = replace(stages, prior=Prior(found, TILTED.covariance))
        row: dict[str, Any] = {}
        for kind, estimator in (("staged", stages), ("joint", together), ("tilted", tilted)):
            e = estimator(experiments)
            for n in FREE:
                row[f"{kind} {n}"], row[f"{kind} se {n}"] = e[n], e.std_error(n)
                row[f"{kind} own {n}"] = e.std_error(n, propagated=False)
            row[f"{kind} p"] = e.propagated.p_value
        return row

    @cached_property
    def centre(self) -> dict[str, float]:
        """What intervals are to cover."""
        clean = self.estimators[0](self.draws.experiments())
        return {n: TRUTH[n] if n in ("m", "z_m") else clean[n] for n in FREE}


@dataclass(frozen=True, slots=True)
class Coverage:
    """Intervals of one kind for one parameter over all runs."""

    kind: str
    parameter: str
    runs: int
    spread: float  # standard deviation over the runs, of estimate less centre
    std_error: float  # mean
    covered: float  # share of the 95 % intervals

    @property
    def ratio(self) -> float:
        """Spread over standard error: 1 where the standard error is right."""
        return self.spread / self.std_error

    @property
    def expected(self) -> float:
        """Coverage of Gaussian intervals that are too narrow by `ratio`."""
        return math.erf(1.96 / self.ratio / math.sqrt(2))

    @property
    def is_right(self) -> bool:
        """Within four binomial standard deviations of 95 %."""
        return abs(self.covered - 0.95) <= 4 * math.sqrt(0.95 * 0.05 / self.runs)


KINDS = {
    "stages": ("staged", "staged se"),
    "stages, earlier ones exact": ("staged", "staged own"),
    "joint": ("joint", "joint se"),
    "uncertain M, z_g": ("tilted", "tilted se"),
    "uncertain M, z_g, taken as exact": ("tilted", "staged se"),
}
"""Kind of interval -> columns of estimate and standard error."""


def coverages(campaign: Campaign, centre: Mapping[str, float]) -> list[Coverage]:
    """Every kind of interval for every parameter."""
    out = []
    for kind, (value, error) in KINDS.items():
        for n in FREE:
            x = campaign.column(f"{value} {n}") - centre[n]
            se = campaign.column(f"{error} {n}")
            spread, covered = float(np.sqrt(np.mean(x**2))), float(np.mean(np.abs(x) < 1.96 * se))
            out.append(Coverage(kind, n, len(x), spread, float(np.mean(se)), covered))
    return out


def largest_disagreement(campaign: Campaign, parameter: str) -> float:
    """|stages - joint| over the larger of both standard errors, the largest over all runs."""
    apart = np.abs(campaign.column(f"staged {parameter}") - campaign.column(f"joint {parameter}"))
    se = np.maximum(
        campaign.column(f"staged se {parameter}"), campaign.column(f"joint se {parameter}")
    )
    return float(np.max(apart / se))


@dataclass(frozen=True, slots=True)
class NoiseModels:
    """(7.58) beside (7.60) in stages over the same runs, for one parameter."""

    parameter: str
    spread: float  # rms error with (7.58) over that with (7.60)
    std_error: float  # the same of the mean standard errors
    apart: float  # largest difference in standard errors of (7.60)


def noise_models(run: RigRun, runs: int, *, iterations: int) -> list[NoiseModels]:
    """Estimate `runs` data sets with both noise models."""
    names = ("(7.58)", "(7.60)")
    estimators = [staged(name, iterations=iterations) for name in names]
    values, errors = np.empty((2, runs, 2)), np.empty((2, runs, 2))
    for r in range(runs):
        rng = np.random.default_rng(np.random.SeedSequence(run.seed, spawn_key=(7, r)))
        experiments = run.draws.experiments(rng)
        for i, estimator in enumerate(estimators):
            e = estimator(experiments)
            for j, n in enumerate(("m", "z_m")):
                values[i, r, j], errors[i, r, j] = e[n], e.std_error(n)
    out = []
    for j, n in enumerate(("m", "z_m")):
        rms = np.sqrt(np.mean((values[:, :, j] - TRUTH[n]) ** 2, axis=1))
        mean = errors[:, :, j].mean(axis=1)
        apart = np.max(np.abs(values[0, :, j] - values[1, :, j]) / errors[1, :, j])
        out.append(NoiseModels(n, float(rms[0] / rms[1]), float(mean[0] / mean[1]), float(apart)))
    return out
