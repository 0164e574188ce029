"""Pendulum records with one cause of a given size, and what the cart does in them.

Integrated by Runge-Kutta 4 in the direct form (7.10), all cases of a batch at once; the sensors are
(7.13) and (7.14) with white noise on both. Nothing of casid takes part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from casid.arrays import Array

CONSTANTS = {"M": 22.04, "z_g": -0.018, "z_s": -0.218, "z_m": -0.274, "g": 9.81}
K, D, I_X = 10.39, 0.1067, 0.1385  # Table 7.2
STEP = 0.005  # of the integration [s]
TS = 0.02  # of the record [s]
NOISE = 0.01  # sd on gyro [rad/s] and accel [m/s^2]
PRE_ROLL = 5.0  # simulated before the record, so that it starts in motion [s]


@dataclass(frozen=True, slots=True)
class Cause:
    """What is wrong with the model, by the names of the diagnosis, and how large it is."""

    kind: str
    where: str
    size: float

    @property
    def key(self) -> tuple[str, str]:
        """Kind and place."""
        return self.kind, self.where


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What the cart and the recorded channels do, on half steps of the integration."""

    t: Array  # (2 n + 1,) from -PRE_ROLL
    a_y: Array
    yaw_rate: Array
    speed: Array

    @property
    def samples(self) -> slice:
        """The half steps that are sampled."""
        start = round(2 * PRE_ROLL / STEP)
        return slice(start, None, round(2 * TS / STEP))


def _grid(duration: float) -> Array:
    n = round((duration + PRE_ROLL) / STEP)
    return -PRE_ROLL + 0.5 * STEP * np.arange(2 * n + 1)


def _waves(t: Array, rng: np.random.Generator, low: float, high: float, n: int, sd: float) -> Array:
    f, phase = rng.uniform(low, high, n), rng.uniform(0, 2 * np.pi, n)
    made = np.cos(2 * np.pi * f[:, None] * t + phase[:, None]).sum(axis=0)
    return np.asarray(sd * np.sqrt(2 / n) * made)


def _recorded(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    return _waves(t, rng, 0.02, 0.6, 30, 0.4), 1.0 + _waves(t, rng, 0.01, 0.1, 12, 0.3)


def telegraph(duration: float, seed: int, *, amplitude: float = 1.5) -> Drive:
    """Random levels held for 0.8 s on average, followed by the cart with a lag of 0.2 s."""
    rng = np.random.default_rng(seed)
    t = _grid(duration)
    switch = rng.random(len(t)) < 0.5 * STEP / 0.8
    switch[0] = True
    level = rng.standard_normal(len(t))[np.maximum.accumulate(switch * np.arange(len(t)))]
    decay = float(np.exp(-0.5 * STEP / 0.2))
    a_y = lfilter([0.0, 1 - decay], [1, -decay], amplitude * level)
    return Drive(t, a_y, *_recorded(t, rng))


def multisine(
    duration: float, seed: int, bands: Sequence[tuple[float, float]], *, rms: float
) -> Drive:
    """Equal power on all lines of 1/duration inside the bands [Hz], phases at random."""
    rng = np.random.default_rng(seed)
    t = _grid(duration)
    f = np.arange(1, round(0.5 / TS * duration)) / duration
    f = f[np.any([(f >= low) & (f <= high) for low, high in bands], axis=0)]
    made = np.zeros(len(t))
    for line, phase in zip(f, rng.uniform(0, 2 * np.pi, len(f)), strict=True):
        made += np.cos(2 * np.pi * line * t + phase)
    return Drive(t, rms * np.sqrt(2 / len(f)) * made, *_recorded(t, rng))


def simulate(
    drive: Drive, causes: Sequence[Cause], *, jump_at: float, width: float, load: float = 0.0
) -> list[dict[str, Array]]:
    """Noise-free channels of one record for each cause.

    Parameters
    ----------
    jump_at : instant of `parameter_jump` [s].
    width : rate below which dry friction is smoothed [rad/s].
    load : mass on the pendulum [kg].

    Returns
    -------
    one mapping a cause: gyro, accel, yaw_rate, speed, (N,) each, and a_y.
    """
    c = CONSTANTS
    size = {key: np.zeros(len(causes)) for key in {x.key for x in causes}}
    for i, cause in enumerate(causes):
        size[cause.key][i] = cause.size
    zero = np.zeros(len(causes))

    def of(kind: str, where: str) -> Array:
        return size.get((kind, where), zero)

    speed = (drive.speed - np.mean(drive.speed[drive.samples]))[:, None]
    yaw_rate = (drive.yaw_rate - np.mean(drive.yaw_rate[drive.samples]))[:, None]
    after = (drive.t >= jump_at - 1e-9)[:, None]

    def moved(name: str, value: float) -> Array:
        """(2 n + 1, cases) of one parameter."""
        change = after * of("parameter_jump", name)
        change = change + speed * of("scheduled_parameter", f"{name}~speed")
        change = change + yaw_rate * of("scheduled_parameter", f"{name}~yaw_rate")
        return np.asarray(value + change)

    d, m = moved("d", D), moved("m", load)
    S = c["M"] * c["z_g"] + m * c["z_m"]
    k = moved("k", K) + S * c["g"]
    inertia = moved("I_x", I_X) + c["M"] * c["z_g"] ** 2 + m * c["z_m"] ** 2
    acting: Array = S * drive.a_y[:, None]
    acting = acting + drive.yaw_rate[:, None] * of("extra_input", "yaw_rate")
    acting = acting + drive.speed[:, None] * of("extra_input", "speed")
    d_2, F_c = of("quadratic_damping", "torque"), of("coulomb_friction", "torque")
    k_3 = of("cubic_stiffness", "torque")

    def rates(i: int, phi: Array, p: Array) -> Array:
        torque = acting[i] - k[i] * phi - d[i] * p - d_2 * np.abs(p) * p - k_3 * phi**3
        if F_c.any():
            torque = torque - F_c * np.tanh(p / width)
        return np.asarray(torque / inertia[i])

    # The step that ends at the jump ends before it.
    jump = int(np.searchsorted(drive.t, jump_at - 1e-9))
    n = (len(drive.t) - 1) // 2
    h = STEP
    phi: Array = zero.copy()
    p: Array = zero.copy()
    path = np.empty((n + 1, 3, len(causes)))
    for i in range(n + 1):
        a1 = rates(2 * i, phi, p)
        path[i] = phi, p, a1
        if i == n:
            break
        a2 = rates(2 * i + 1, phi + h / 2 * p, p + h / 2 * a1)
        a3 = rates(2 * i + 1, phi + h / 2 * (p + h / 2 * a1), p + h / 2 * a2)
        end = 2 * i + 2 if 2 * i + 2 != jump else 2 * i + 1
        a4 = rates(end, phi + h * (p + h / 2 * a2), p + h * a3)
        phi = phi + h * p + h * h / 6 * (a1 + a2 + a3)
        p = p + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    start, stride = round(PRE_ROLL / h), round(TS / h)
    a_y = drive.a_y[drive.samples]
    delay = of("time_delay", "gyro")
    out = []
    fine_t = drive.t[::2]
    t = fine_t[start::stride]
    for j in range(len(causes)):
        rate = path[:, 1, j]
        # Cubic between fine samples: value and slope are known there.
        gyro = _hermite(fine_t, rate, path[:, 2, j], t - delay[j])
        accel = c["z_s"] * path[start::stride, 2, j] + c["g"] * path[start::stride, 0, j] - a_y
        out.append(
            {
                "gyro": gyro + of("sensor_bias", "gyro")[j],
                "accel": accel,
                "yaw_rate": drive.yaw_rate[drive.samples],
                "speed": drive.speed[drive.samples],
                "a_y": a_y,
            }
        )
    return out


def _hermite(t: Array, y: Array, slope: Array, at: Array) -> Array:
    from scipy.interpolate import CubicHermiteSpline

    return np.asarray(CubicHermiteSpline(t, y, slope)(at))


def with_noise(clean: Mapping[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    """The measured channels, white noise on gyro and accel."""
    n = len(clean["gyro"])
    noisy = {name: clean[name] + NOISE * rng.standard_normal(n) for name in ("gyro", "accel")}
    return {**noisy, "yaw_rate": clean["yaw_rate"], "speed": clean["speed"]}
