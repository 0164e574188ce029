"""One imperfection at a time: what least squares and instruments make of m and zbar_m.

Every row holds some white noise (`BACKGROUND`, a tenth of the sensors' own or less), so that no
estimate is fitted to an exact equation. z_f is known, as in `ship.problem`, and the search starts
at the truth: what is found is an estimator's bias and not a poorer optimum.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np

import casid
from analysis.ship_algorithm.records import TS
from analysis.ship_bias.records import IMPERFECTIONS, Imperfection, Rudder, answers, regressors
from casid.arrays import Array
from casid.errors import IdentifiabilityError, SolveError
from casid.estimation.moments.instruments.black_box_reference import (
    black_box_instruments,
    black_box_references,
)
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.stages.stage_plan import StageSpec
from casid.identification.moment_estimators import Reusable, instrumental_variables
from problems import ship
from problems.ship import TABLE_8_2

BACKGROUND = Imperfection(gyro=2e-4, accel=1e-3, r=2e-4)
SOUGHT = ("m", "zbar_m")
TRUE = np.array([TABLE_8_2[n] for n in SOUGHT])
LAGS = 4  # of each simulated signal among the instruments


def model_at_truth() -> casid.Model:
    """The roll subsystem, eight parameters, the search starting at Table 8.3."""
    return ship.problem.model.with_unknown(**{n: TABLE_8_2[n] for n in ship.problem.truth})


def by_instruments(model: casid.Model, experiments: Sequence[casid.Experiment]) -> MomentEstimate:
    """Algorithm 8.1, instruments made of the rudder."""
    black = black_box_references(experiments, "delta", ["gyro", "accel", "r"])
    chosen = black_box_instruments(model, black, n_y=LAGS, n_u=LAGS)
    return instrumental_variables(model, black.experiments, chosen)


def with_background(wrong: Imperfection) -> Imperfection:
    """The imperfection, where it says nothing of a noise that of the background."""
    own = {f.name: getattr(wrong, f.name) or getattr(BACKGROUND, f.name) for f in fields(wrong)}
    return Imperfection(**own)


@dataclass(frozen=True, slots=True, eq=False)
class Estimator:
    """Both estimators for records of one form, their programs built once."""

    squares: Reusable
    model: casid.Model

    @classmethod
    def make(cls, model: casid.Model | None = None) -> Estimator:
        """For `model`, by default that of `model_at_truth`."""
        model = model or model_at_truth()
        return cls(Reusable(model, [StageSpec(())], settings=MomentSettings()), model)

    def least_squares(self, experiments: Sequence[casid.Experiment]) -> Array:
        """(2,) m [kg] and zbar_m [m]; nan where there is no estimate."""
        try:
            found = self.squares(experiments)
        except (IdentifiabilityError, SolveError):
            return np.full(2, np.nan)
        return np.array([found[n] for n in SOUGHT])

    def instruments(self, experiments: Sequence[casid.Experiment]) -> tuple[Array, Array]:
        """m and zbar_m (2,), and their standard errors, by Algorithm 8.1; nan as above."""
        try:
            found = by_instruments(self.model, experiments)
        except (IdentifiabilityError, SolveError):
            return np.full(2, np.nan), np.full(2, np.nan)
        errors = np.array([found.std_error(n) for n in SOUGHT])
        return np.array([found[n] for n in SOUGHT]), errors


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """An estimator's errors over the draws of one imperfection.

    Attributes
    ----------
    errors : (draws, 2) of m [kg] and zbar_m [m]; nan where the estimate was refused.
    stated : (draws, 2) standard errors that the estimator states; empty for least squares.
    """

    imperfection: str
    method: str
    errors: Array
    stated: Array

    @property
    def kept(self) -> Array:
        """(kept draws, 2) errors of the estimates that there are."""
        return np.asarray(self.errors[np.isfinite(self.errors).all(axis=1)])

    @property
    def bias(self) -> Array:
        """(2,) mean error."""
        return np.asarray(self.kept.mean(axis=0))

    @property
    def deviation(self) -> Array:
        """(2,) standard deviation over draws."""
        return np.asarray(self.kept.std(axis=0, ddof=1))

    @property
    def monte_carlo(self) -> Array:
        """(2,) standard error of `bias`."""
        return np.asarray(self.deviation / np.sqrt(len(self.kept)))

    @property
    def refused(self) -> int:
        """Draws without an estimate."""
        return len(self.errors) - len(self.kept)

    def numbers(self) -> dict[str, str | float]:
        """The row as it is written down, nan where there are no two estimates."""
        row: dict[str, str | float] = {"imperfection": self.imperfection, "method": self.method}
        for i, name in enumerate(SOUGHT):
            enough = len(self.kept) > 1
            row[f"bias of {name}"] = float(self.bias[i]) if enough else np.nan
            row[f"its standard error, {name}"] = float(self.monte_carlo[i]) if enough else np.nan
            row[f"std of {name}"] = float(self.deviation[i]) if enough else np.nan
        return row | {"draws": len(self.errors), "refused": self.refused}

    def __str__(self) -> str:
        if len(self.kept) < 2:
            return f"{self.imperfection:<32}{self.method:<4} no estimate in {self.refused} draws"
        (m, z), (sm, sz), (dm, dz) = self.bias, self.monte_carlo, self.deviation
        return (
            f"{self.imperfection:<32}{self.method:<4}{m:>+9.4f} +- {sm:<7.4f}({dm:.4f})"
            f"{z:>+10.4f} +- {sz:<7.4f}({dz:.4f})"
            + (f"   {self.refused} refused" if self.refused else "")
        )


def rows(
    names: Sequence[str], rudder: Rudder, draws: int, *, seconds: float, first_seed: int = 0
) -> Iterator[Row]:
    """Least squares and instruments for every imperfection named, in order."""
    estimator = Estimator.make()
    made = [answers(first_seed + s, rudder, seconds=seconds) for s in range(draws)]
    for name in names:
        wrong = with_background(IMPERFECTIONS[name])
        records = [[a.experiment(wrong) for a in own] for own in made]
        by_squares = np.array([estimator.least_squares(r) - TRUE for r in records])
        yield Row(name, "LS", by_squares, np.zeros((0, 2)))
        found = [estimator.instruments(r) for r in records]
        yield Row(
            name, "IV", np.array([f - TRUE for f, _ in found]), np.array([s for _, s in found])
        )


def mean_in_instruments(wrong: Imperfection, rudder: Rudder, seed: int) -> dict[str, float]:
    """Trap T-5: error of alpha_2, in per cent, by what is done with the mean of the instruments.

    Two-stage least squares of the nominal record's five coefficients on lags of the rudder angle:
    as it is, without its mean, and differenced over two samples.
    """
    (nominal,) = answers(seed, rudder, cases=("nominal",))
    record = nominal.experiment(with_background(wrong)).record
    Phi, Y = regressors(record)
    delta, lags = record["delta"], range(0, 60, 2)
    start = max(lags) + 2
    lagged = {
        "as it is": delta,
        "without its mean": delta - delta[start:].mean(),
        "differenced": np.concatenate([np.zeros(2), delta[2:] - delta[:-2]]),
    }
    out = {}
    for what, signal in lagged.items():
        Z = np.column_stack([signal[start - lag : len(signal) - lag] for lag in lags])
        if what == "without its mean":
            Z -= Z.mean(axis=0)
        here, left = Phi[start - 2 :], Y[start - 2 :]
        U, s, _ = np.linalg.svd(Z, full_matrices=False)
        U = U[:, s > 1e-10 * s[0]]
        a1, a2 = np.linalg.lstsq(U.T @ here, U.T @ left, rcond=None)[0][:2]
        out[what] = 100.0 * (_alpha_2(float(a1), float(a2), TS) / _true_alpha_2() - 1.0)
    return out


def _alpha_2(a1: float, a2: float, Ts: float) -> float:
    """alpha_2 of (8.22) from the coefficients of (8.54)."""
    # a1 + a2 + 1 = 4 alpha_2 Ts^2/A, and 1 - a1 + a2 = 16/A
    return 4.0 / Ts**2 * (1.0 + a1 + a2) / (1.0 - a1 + a2)


def _true_alpha_2() -> float:
    v = TABLE_8_2
    z_g, z_s = v["zbar_g"] + v["z_f"], v["zbar_s"] + v["z_f"]
    A_2 = v["A_x"] + v["M"] * z_g * (z_g - z_s) - v["K_vdot"] * z_s
    return (v["k"] - v["K_vdot"] * v["g"]) / A_2
