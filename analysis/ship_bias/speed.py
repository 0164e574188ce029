"""The roll coefficients against speed, and m against the sea state."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

import casid
from analysis.ship_algorithm.records import BEFORE, TS, load, respond
from analysis.ship_bias.records import SHIP, Imperfection, Rudder, answers
from analysis.ship_bias.table import TRUE, Estimator, by_instruments, model_at_truth
from casid.arrays import Array
from problems.ship_simulator.waves import Jonswap, sample_sea

SENSORS = Imperfection(gyro=0.0005, accel=0.005, r=0.0005)
SCALE = 24.0
FASTER = replace(SHIP, coefficients=replace(SHIP.coefficients, K_phiuu=0.5))
"""The ship with a stiffness that falls with the speed squared; 0.5 kg is chosen."""


@dataclass(frozen=True, slots=True)
class AtSpeed:
    """Estimates of one coefficient at a speed: name, U [m/s], estimate, standard error, truth."""

    name: str
    U: float
    estimate: float
    std_error: float
    true: float
    at_one: float  # true value at 1 m/s

    @property
    def z(self) -> float:
        """Error in standard errors."""
        return (self.estimate - self.true) / self.std_error

    def __str__(self) -> str:
        off = 100 * (self.at_one / self.true - 1)
        return (
            f"U = {self.U:.1f} m/s  {self.name:<4}{self.estimate:>10.4f} +- {self.std_error:<8.4f}"
            f"true {self.true:>9.4f}  constant U = 1 m/s would be off by {off:+.1f} %"
        )


def against_speed(U: float, *, seconds: float, seed: int) -> list[AtSpeed]:
    """k, d and K_r at a constant speed [m/s], by instruments, and what they are."""
    model = model_at_truth().with_known(U=U)
    made = answers(seed, Rudder(), seconds=seconds, ship=FASTER, U=U)
    found = by_instruments(model, [a.experiment(SENSORS) for a in made])
    true, at_one = FASTER.roll_coefficients(U), FASTER.roll_coefficients(1.0)
    return [
        AtSpeed(n, U, found[n], found.std_error(n), true[n], at_one[n]) for n in ("k", "d", "K_r")
    ]


@dataclass(frozen=True, slots=True, eq=False)
class AtSea:
    """Errors of m and zbar_m over draws of the sea (draws, 2), at a full-scale wave height [m]."""

    Hs: float
    by_squares: Array
    by_instruments: Array
    roll_torque: float  # rms [N m]

    def rows(self) -> list[dict[str, str | float]]:
        """A row for each method and draw."""
        methods = {"LS": self.by_squares, "IV": self.by_instruments}
        return [
            {"Hs": self.Hs, "method": method, "error of m": float(m), "error of zbar_m": float(z)}
            for method, errors in methods.items()
            for m, z in errors
        ]

    def __str__(self) -> str:
        text = f"Hs = {self.Hs:.2f} m ({self.roll_torque:.4f} N m rms)"
        for method, errors in (("LS", self.by_squares), ("IV", self.by_instruments)):
            kept = errors[np.isfinite(errors).all(axis=1)]
            text += f"   {method}: "
            if len(kept) < 2:
                text += f"no estimate in {len(errors)} draws"
                continue
            b, s = kept.mean(axis=0), kept.std(axis=0, ddof=1)
            text += f"m {b[0]:+.4f} std {s[0]:.4f}, zbar_m {b[1]:+.4f} std {s[1]:.4f}"
            text += f" ({len(errors) - len(kept)} refused)" if len(kept) < len(errors) else ""
        return text


def at_sea(Hs: float, draws: int, *, seconds: float, period: float = 8.0) -> AtSea:
    """m and zbar_m in beam seas of a full-scale significant height [m] and peak period [s]."""
    estimator, squares, instruments, torque = Estimator.make(), [], [], 0.0
    for seed in range(draws):
        records, torque = records_at_sea(Hs, seed, seconds=seconds, period=period)
        squares.append(estimator.least_squares(records) - TRUE)
        instruments.append(estimator.instruments(records)[0] - TRUE)
    return AtSea(Hs, np.array(squares), np.array(instruments), torque)


def records_at_sea(
    Hs: float, seed: int, *, seconds: float, period: float = 8.0
) -> tuple[list[casid.Experiment], float]:
    """A record of each load case in beam seas as for `at_sea`, and the rms roll torque [N m]."""
    w0, torque = 2 * math.pi / period * math.sqrt(SCALE), 0.0
    records = []
    for i, made in enumerate(answers(seed, Rudder(), seconds=seconds)):
        moved = made.rudder
        if Hs > 0.0:
            waves, band, draw = Jonswap(Hs / SCALE, w0), (0.5 * w0, 4.0 * w0), 1000 * seed + i
            sea = sample_sea(waves, band, seed=draw, U=1.0, beta=math.pi / 2)
            N = len(made.delta) + BEFORE
            forces = sea.forces(TS * np.arange(N, dtype=np.float64))
            inputs = np.column_stack([np.zeros(N), forces[:, 1:]])
            moved = moved + respond(SHIP, load(made.case), inputs)[BEFORE:]
            torque = float(forces[:, 2].std())
        records.append(replace(made, rudder=moved).experiment(SENSORS))
    return records, torque
