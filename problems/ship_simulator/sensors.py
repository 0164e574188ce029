"""The inertial unit aboard a ship: what its three used axes and the rudder's encoder would record.

Linder (2017), Appendix A.6. The unit's own axes point to the bow, to port and up, so that

    y1 = p + e1,  y2 = a_s + e2,  a_s = z_s phi'' + g sin(phi) - a_y,  y3 = -r + e3   (A.41)-(A.45)

where z_s < 0 is its height over the centre of rotation, a_y = v' + u r, and the third sign flips
because that axis points up. This is a special case of the general one, which is what is computed:
a unit at (x_s, y_s, z_s) of a ship without pitch and heave feels, in the ship's axes,

    f = v' + w x v + w' x r_s + w x (w x r_s) - g (0, sin(phi), cos(phi)),  w = (p, 0, r),

and turned in its mount by Euler angles, R_m' of that in its own axes: then the centripetal
terms, the weight and the other axes' rates leak into each channel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

import casid
from casid.errors import DataError

Array = NDArray[np.float64]


class Motion(Protocol):
    """What is measured: `ship_4dof.Motion`, or any motion with the same names."""

    @property
    def ship(self) -> Any:
        """The ship: z_f [m] and g [m/s^2] are read."""

    @property
    def Ts(self) -> float:
        """Sample time [s]."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What should be known of the motion."""

    def __getitem__(self, name: str) -> Array:
        """(N,) phi, u, v, p, r, delta and u_dot, v_dot, p_dot, r_dot, SI units."""


@dataclass(frozen=True, slots=True)
class Channel:
    """One channel's errors: scale * true + bias + white noise, sampled every so often.

    Attributes
    ----------
    noise : standard deviation, in the channel's SI unit.
    bias : in the same unit.
    scale : 1, or -1 for an axis that is taken the wrong way round.
    every : one sample in so many of the record's is there; the others are marked missing.
    """

    noise: float = 0.0
    bias: float = 0.0
    scale: float = 1.0
    every: int = 1

    def __post_init__(self) -> None:
        numbers = (self.noise, self.bias, self.scale)
        if not all(math.isfinite(a) for a in numbers) or self.noise < 0.0 or self.every < 1:
            raise DataError(
                f"channel: noise {self.noise!r}, bias {self.bias!r}, scale {self.scale!r}, every "
                f"{self.every!r}. Give finite numbers, noise >= 0 and every >= 1."
            )


@dataclass(frozen=True, slots=True)
class InertialUnit:
    """An inertial unit and the rudder's encoder.

    Attributes
    ----------
    zbar_s : height, down from the mark on the hull [m]; z_s = zbar_s + z_f (8.21).
    x_s, y_s : ahead and to starboard of the CO [m].
    roll, pitch, yaw : by which the unit is turned in its mount, about its own axes to the bow, to
        port and up, in the order yaw, pitch, roll [rad].
    gyro, accel, yaw_gyro, rudder : errors of the channels; [rad/s], [m/s^2], [rad/s], [rad]. The
        noise is section 9's order of size.
    sampling : one sample in so many of the motion's is recorded; there is no filter before.
    """

    zbar_s: float = -0.2
    x_s: float = 0.0
    y_s: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    gyro: Channel = Channel(noise=0.002)
    accel: Channel = Channel(noise=0.02)
    yaw_gyro: Channel = Channel(noise=0.002)
    rudder: Channel = Channel()
    sampling: int = 1

    def without_noise(self) -> InertialUnit:
        """The same unit, mount and all, with perfect channels."""
        perfect = Channel()
        return replace(self, gyro=perfect, accel=perfect, yaw_gyro=perfect, rudder=perfect)

    def turned(self) -> Array:
        """(3, 3) R_m, from the turned unit's axes to those it should have."""
        (cr, sr), (cp, sp), (cy, sy) = (
            (math.cos(a), math.sin(a)) for a in (self.roll, self.pitch, self.yaw)
        )
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
        about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
        about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(about_z @ about_y @ about_x)


UNITS = {"gyro": "rad/s", "accel": "m/s^2", "yaw_gyro": "rad/s", "delta": "rad"}


def specific_force(motion: Motion, unit: InertialUnit) -> Array:
    """(N, 3) f at the unit's place, in the ship's axes (bow, starboard, down) [m/s^2]."""
    u, v, p, r, phi = (motion[n] for n in ("u", "v", "p", "r", "phi"))
    zero, g = np.zeros_like(p), motion.ship.g
    place = np.array([unit.x_s, unit.y_s, unit.zbar_s + motion.ship.z_f])
    w = np.stack([p, zero, r], axis=1)
    w_dot = np.stack([motion["p_dot"], zero, motion["r_dot"]], axis=1)
    at_CO = np.stack([motion["u_dot"] - r * v, motion["v_dot"] + r * u, p * v], axis=1)
    centripetal = np.cross(w, np.cross(w, place))
    weight = g * np.stack([zero, np.sin(phi), np.cos(phi)], axis=1)
    return np.asarray(at_CO + np.cross(w_dot, place) + centripetal - weight)


def true_signals(motion: Motion, unit: InertialUnit) -> dict[str, Array]:
    """What perfect channels of a unit, in the mount it has, would read: (N,) gyro, accel, ..."""
    flip, turned = np.array([1.0, -1.0, -1.0]), unit.turned()
    p, r = motion["p"], motion["r"]
    rates = (flip * np.stack([p, np.zeros_like(p), r], axis=1)) @ turned
    force = (flip * specific_force(motion, unit)) @ turned
    return {
        "gyro": rates[:, 0],
        "accel": force[:, 1],
        "yaw_gyro": rates[:, 2],
        "delta": np.asarray(motion["delta"]),
    }


def measure(
    motion: Motion, unit: InertialUnit | None = None, *, seed: int, name: str = "ship"
) -> casid.Record:
    """Record a motion.

    Parameters
    ----------
    motion : a simulated one.
    unit : at zbar_s = -0.2 m, in line, with noise, by default.
    seed : of the noise.
    name : of the record.

    Returns
    -------
    Record with channels gyro [rad/s], accel [m/s^2] (to port), yaw_gyro [rad/s] (about an axis
    that points up: -r) and delta [rad].

    Raises
    ------
    DataError
        If the motion is too short for the sampling.
    """
    unit = unit or InertialUnit()
    if unit.sampling < 1:
        raise DataError(f"inertial unit: sampling {unit.sampling!r}. Give a whole number >= 1.")
    rng = np.random.default_rng(seed)
    own = {
        "gyro": unit.gyro,
        "accel": unit.accel,
        "yaw_gyro": unit.yaw_gyro,
        "delta": unit.rudder,
    }
    channels: dict[str, Array] = {}
    missing: dict[str, NDArray[np.bool_]] = {}
    for channel, signal in true_signals(motion, unit).items():
        e, true = own[channel], signal[:: unit.sampling]
        noise = e.noise * rng.standard_normal(true.size)
        channels[channel] = e.scale * true + e.bias + noise
        if e.every > 1:
            missing[channel] = np.arange(true.size) % e.every != 0
    return casid.Record(
        channels,
        UNITS,
        Ts=unit.sampling * motion.Ts,
        name=name,
        missing=missing,
        provenance=(
            f"measured by problems/ship_simulator/sensors.py, seed {seed}",
            *motion.warnings,
        ),
    )


def for_roll(record: casid.Record) -> casid.Record:
    """The channels that `ship.problem` has: yaw_gyro becomes r = -yaw_gyro, to starboard."""
    flipped = record.with_channel("r", -record["yaw_gyro"], "rad/s")
    mask = record.is_missing("yaw_gyro")
    if mask.any():
        flipped = flipped.mark_missing("r", mask)
    return flipped.without("yaw_gyro")
