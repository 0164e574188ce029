"""The surge speed drops in turns: how it follows the rudder, and what a constant speed costs.

The speed enters (8.20) by K_r r = (K_ur - K_vdot) U r and by the damping. Where the speed is known,
smoothed from camera positions, the product u r/U takes the place of r as a channel, and K_r is a
constant again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import casid
from analysis.ship_algorithm.records import TS
from analysis.ship_basin_turns.records import Sailed
from casid.arrays import Array
from casid.estimation.prediction_error.coordinated_turn import Track

CAMERA = {"x": 2e-3, "y": 2e-3, "psi": 2e-3}
"""Standard deviations of positions [m] and heading [rad], chosen."""

EVERY = 10
"""Samples of 50 Hz between positions: 5 Hz."""


def surge_time(sailed: Sailed) -> float:
    """Time constant [s] with which the surge speed returns, from its linear equation at 1 m/s."""
    c, m = sailed.motion.ship.coefficients, sailed.motion
    mass = m.ship.mass_matrix(m.load)[0, 0]
    return float(mass / (2 * -c.X_uu * 1.0))


def lagged(delta: Array, seconds: float, Ts: float = TS) -> Array:
    """(N,) |rudder| through a first-order lag, from rest."""
    from scipy.signal import lfilter

    a = np.exp(-Ts / seconds)
    return np.asarray(lfilter([1 - a], [1.0, -a], np.abs(delta)))


@dataclass(frozen=True, slots=True, eq=False)
class Drop:
    """Surge speed and rudder of one record.

    Attributes
    ----------
    lowest : surge speed [m/s].
    at_once, after_lag : correlation of the speed with |rudder|, and with |rudder| behind the
        surge's own lag.
    smoothed : the same as `after_lag`, of the speed from the camera; nan without one.
    error, sd : rms error of the smoothed surge speed and its stated one [m/s].
    """

    lowest: float
    at_once: float
    after_lag: float
    smoothed: float
    error: float
    sd: float


def camera(sailed: Sailed, *, seed: int) -> casid.Record:
    """Positions and heading as cameras give them, every `EVERY`th sample."""
    rng = np.random.default_rng(seed)
    channels = {
        n: sailed[n][::EVERY] + sd * rng.standard_normal(len(sailed[n][::EVERY]))
        for n, sd in CAMERA.items()
    }
    units = {"x": "m", "y": "m", "psi": "rad"}
    return casid.Record(channels, units, Ts=EVERY * TS, name=sailed.experiment.name)


def smoothed(
    sailed: Sailed, *, seed: int, levels: Mapping[str, float] | None = None
) -> tuple[Track, Array]:
    """The track by the smoother, and its surge speed at the record's own samples."""
    seen = camera(sailed, seed=seed)
    track = casid.smooth_track(seen, levels=levels)
    t = TS * np.arange(len(sailed["u"]))
    return track, np.interp(t, EVERY * TS * np.arange(len(track.u)), track.u)


def drop(sailed: Sailed, u: Array | None = None, sd: float = float("nan")) -> Drop:
    """How the surge speed follows the rudder; `u`, `sd`: smoothed, if it was."""
    true, delta = sailed["u"], sailed.cut(sailed.motion["delta"])
    behind = lagged(delta, surge_time(sailed))
    late = slice(round(5 * 7.0 / TS) if len(true) > 5000 else 0, None)  # the lag starts at rest

    def correlation(a: Array, b: Array) -> float:
        return float(np.corrcoef(a[late], b[late])[0, 1])

    return Drop(
        lowest=float(true.min()),
        at_once=correlation(true, np.abs(delta)),
        after_lag=correlation(true, behind),
        smoothed=float("nan") if u is None else correlation(u, behind),
        error=float("nan") if u is None else float(np.sqrt(np.mean((u - true) ** 2))),
        sd=sd,
    )


def at_speed(sailed: Sailed, u: Array) -> casid.Experiment:
    """The record with u r/U in the place of r, U = 1 m/s."""
    e = sailed.experiment
    r = e.record["r"] * u[: len(e.record["r"])]
    return casid.Experiment(e.record.with_channel("r", r, "rad/s"), e.known, e.name)


def at_true_speed(sets: Sequence[Sailed]) -> list[casid.Experiment]:
    """With the true surge speed."""
    return [at_speed(s, s["u"]) for s in sets]


def at_smoothed_speed(sets: Sequence[Sailed], *, seed: int) -> list[casid.Experiment]:
    """With the smoothed one; the noise levels are estimated from the first record alone."""
    made, levels = [], None
    for i, s in enumerate(sets):
        track, u = smoothed(s, seed=seed + i, levels=levels)
        levels = dict(track.levels.values)
        made.append(at_speed(s, u))
    return made
