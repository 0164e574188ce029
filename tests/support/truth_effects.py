"""Effects that the simulators of `truth` can hide: forces, parameters that vary, sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import lfilter

from tests.support.truth_motion import Inner, Motion, State, Waves

Array = np.ndarray[Any, np.dtype[np.floating[Any]]]

TORQUE = {
    "quadratic_damping",
    "coulomb_friction",
    "cubic_stiffness",
    "deadzone",
    "offset",
    "extra_input",
    "periodic_disturbance",
    "parameter_jump",
    "parameter_drift",
    "scheduled_parameter",
    "missing_mode",
}
SENSOR = {"sensor_bias", "time_delay", "sensor_lag", "sensor_scale", "cross_axis"}
SAMPLES = {"saturation", "outliers"}
# Effects that the catalogue of a diagnosis does not have.
STRANGE_TORQUE = {
    "stribeck_friction",  # friction that falls with speed
    "bilinear_stiffness",  # another stiffness on one side
    "amplitude_damping",  # damping that grows with the angle squared
    "parametric_stiffness",  # stiffness that swings at a frequency of its own
    "hysteresis",  # Bouc-Wen
    "knock",  # one half sine of 0.2 s
}
STRANGE_SENSOR = {"clock_drift"}  # a delay that grows
SCATTER = {"jitter", "multiplicative_noise"}  # every sample spoilt at random, in its own measure
STRANGE = STRANGE_TORQUE | STRANGE_SENSOR | SCATTER
MOVING = TORQUE | STRANGE_TORQUE  # effects that change the motion itself
PENDULUM_EFFECTS = ("none", *sorted(MOVING | SENSOR | STRANGE_SENSOR | SAMPLES | SCATTER))
MASS_EFFECTS = (
    "none",
    "quadratic_damping",
    "coulomb_friction",
    "cubic_stiffness",
    "offset",
    "sensor_bias",
    "time_delay",
)
ROLL_EFFECTS = ("none", "quadratic_damping", "cubic_stiffness", "coulomb_friction", "both")

# Effects whose sign is physics, not chance: they dissipate, they come late, or they are a width.
ONE_SIDED = {
    "quadratic_damping",
    "coulomb_friction",
    "deadzone",
    "time_delay",
    "sensor_lag",
    "saturation",
    "outliers",
    "missing_mode",
    "stribeck_friction",
    "amplitude_damping",
    "hysteresis",
    "jitter",
    "multiplicative_noise",
}

STRIBECK_SPEED = 0.2  # [rad/s]
YIELD_ANGLE = 0.05  # of the hysteresis [rad]
MODE_DAMPING = 0.05  # damping ratio of the missing mode
KNOCK = 0.2  # its length [s]


@dataclass(frozen=True, slots=True)
class Draws:
    """The random details of one effect: drawn for every effect alike, used by some."""

    where: str
    sign: float
    t_jump: float  # [s]
    frequency: float  # [Hz]
    phase: float  # [rad]
    at: np.ndarray[Any, np.dtype[np.signedinteger[Any]]]  # indices of spoilt samples
    spikes: Array  # their relative heights
    scatter: Array  # (N,) white noise of its own


def require(effect: str, second: tuple[str, float] | None, allowed: tuple[str, ...]) -> None:
    for kind in (effect, *(second or ("none",))[:1]):
        if kind not in allowed:
            raise ValueError(f"effect={kind!r}: choose one of {', '.join(allowed)}")
    if second is not None and second[0] == effect:
        raise ValueError(f"second={second!r}: the same kind twice; choose another")


def draw(
    rng: np.random.Generator,
    kind: str,
    where: str | None,
    t: Array,
    jump_within: tuple[float, float] = (0.2, 0.8),
) -> Draws:
    """Draw the details of an effect; the same number of draws whatever the kind."""
    scatter = rng.spawn(1)[0].standard_normal(t.size)  # leaves the stream as it is
    pick = rng.integers(6)
    asked = where
    choice = {"parameter_jump": ("k", "d", "m"), "parameter_drift": ("k", "d")}.get(kind)
    if choice:
        if where is not None and where not in choice:
            raise ValueError(f"where={where!r} of {kind}: choose {', '.join(choice)}")
        where = where or choice[pick % len(choice)]
    else:
        where = {
            "extra_input": "yaw_rate",
            "scheduled_parameter": "d~speed",
            **dict.fromkeys(SENSOR | STRANGE_SENSOR | SAMPLES | SCATTER, "output"),
        }.get(kind, "torque")
        where = _at_accel(kind, asked) or where
    sign = float(rng.choice([-1.0, 1.0]))
    if kind in ONE_SIDED or (kind == "parameter_jump" and where == "m"):
        sign = 1.0
    t_jump = round(float(rng.uniform(*jump_within)) * float(t[-1]), 2)
    frequency, phase = float(rng.uniform(0.4, 3.0)), float(rng.uniform(0.0, 2 * np.pi))
    n = max(1, round(0.01 * t.size))
    # n of N - 4 n places, spread by 4 samples each: no two spikes are neighbours.
    at = np.sort(rng.choice(t.size - 4 * n, n, replace=False)) + 4 * np.arange(n) + 2
    spikes = rng.choice([-1.0, 1.0], n) * rng.uniform(0.7, 1.3, n)
    spikes *= math.sqrt(t.size) / float(np.linalg.norm(spikes))  # rms 1 over the whole record
    return Draws(where, sign, t_jump, frequency, phase, at, spikes, scatter)


def _at_accel(kind: str, where: str | None) -> str:
    """The accelerometer, where a sensor's effect is asked for there, or an empty text."""
    allowed = ("sensor_bias", "time_delay", "sensor_lag", "sensor_scale")
    if where != "accel":
        return ""
    if kind not in allowed:
        raise ValueError(f"where={where!r} of {kind}: only {', '.join(allowed)} act there")
    return where


@dataclass(frozen=True, slots=True)
class Torque:
    """What the effects of given sizes do to the right-hand side."""

    sizes: Mapping[str, float]
    draws: Mapping[str, Draws]

    def coefficients(
        self,
        k: float,
        d: float,
        m: float,
        t: Array,
        duration: float,
        yaw_rate: Waves,
        speed: Waves,
    ) -> tuple[Array, Array, Array, Array]:
        """Stiffness, damping, torque and load as functions of time, each of the shape of t."""
        one = np.ones_like(t)
        factor, load, torque = {"k": one.copy(), "d": one.copy()}, m * one, 0.0 * one
        for kind, size in self.sizes.items():
            draw = self.draws[kind]
            if kind == "parameter_jump" and draw.where == "m":
                load = load + size * (t > draw.t_jump)
            elif kind == "parameter_jump":
                factor[draw.where] += size * (t > draw.t_jump)
            elif kind == "parameter_drift":
                factor[draw.where] += size * np.clip(t / duration, 0.0, 1.0)
            elif kind == "scheduled_parameter":
                factor["d"] += size * (speed(t) - speed.mean)
            elif kind == "offset":
                torque = torque + size
            elif kind == "extra_input":
                torque = torque + size * yaw_rate(t)
            elif kind == "periodic_disturbance":
                torque = torque + size * np.sin(2 * np.pi * draw.frequency * t + draw.phase)
            elif kind == "parametric_stiffness":
                factor["k"] += size * np.sin(2 * np.pi * draw.frequency * t + draw.phase)
            elif kind == "knock":
                since = (t - draw.t_jump) / KNOCK
                inside = (since > 0.0) & (since < 1.0)
                torque = torque + size * np.where(inside, np.sin(np.pi * since), 0.0)
        return k * factor["k"], d * factor["d"], torque, load

    def nonlinear(self, k: float, width: float) -> Callable[[float, float], float]:
        """The torque that depends on the state; `width` smooths the sign of dry friction."""
        d2 = self.sizes.get("quadratic_damping", 0.0)
        F_c = self.sizes.get("coulomb_friction", 0.0)
        k3 = self.sizes.get("cubic_stiffness", 0.0)
        gap = self.sizes.get("deadzone", 0.0)
        F_s = self.sizes.get("stribeck_friction", 0.0)
        k_one = self.sizes.get("bilinear_stiffness", 0.0)
        d_x = self.sizes.get("amplitude_damping", 0.0)
        tanh = math.tanh

        def torque(x: float, v: float) -> float:
            out = -d2 * abs(v) * v - k3 * x * x * x
            if F_c:  # stiction: a viscous creep below `width`, in place of a set-valued sign
                out -= F_c * tanh(v / width)
            if gap:
                out += k * min(max(x, -gap), gap)
            if F_s:
                out -= F_s * tanh(v / width) * math.exp(-((v / STRIBECK_SPEED) ** 2))
            if k_one and x > 0.0:
                out -= k_one * x
            return out - d_x * x * x * v

        return torque

    def inner(self) -> tuple[int, Inner] | None:
        """States of an effect's own: their number, and (x, v, a, z) -> (torque, dz/dt).

        The torque does not depend on a, which is what the torque gives. A missing mode is a part of
        inertia J on a spring and damper of its own, q its relative motion: q'' = -2 zeta w q' -
        w^2 q - a, and J (w^2 q + 2 zeta w q') acts back. Hysteresis is Bouc-Wen's with n = 1:
        z' = v / x_y - |v| z / x_y, torque -F z.
        """
        if "missing_mode" in self.sizes:
            J, w = self.sizes["missing_mode"], 2 * math.pi * self.draws["missing_mode"].frequency
            c = 2 * MODE_DAMPING * w

            def mode(x: float, v: float, a: float, z: State) -> tuple[float, State]:
                spring = w * w * z[0] + c * z[1]
                return J * spring, (z[1], -spring - a)

            return 2, mode
        if "hysteresis" in self.sizes:
            F = self.sizes["hysteresis"]

            def bouc_wen(x: float, v: float, a: float, z: State) -> tuple[float, State]:
                return -F * z[0], ((v - abs(v) * z[0]) / YIELD_ANGLE,)

            return 1, bouc_wen
        return None


def sense(
    sizes: Mapping[str, float],
    draws: Mapping[str, Draws],
    path: Motion,
    output: str,
    t: Array,
    beside: Callable[[Array], Array] | None = None,
) -> Array:
    """The measured output at the sample times, without noise and without spoilt samples.

    `beside` is the signal that a sensor mounted askew also feels.
    """
    here = {kind: size for kind, size in sizes.items() if draws[kind].where != "accel"}
    y, dy = (path.v, path.a) if output == "v" else (path.x, path.v)
    lag = here.get("sensor_lag", 0.0)
    if lag:
        h = float(path.t[1] - path.t[0])
        y = _lagged(y, h, lag)
        dy = np.gradient(y, h)
    late = here.get("time_delay", 0.0) + here.get("clock_drift", 0.0) * t / t[-1]
    if "jitter" in here:
        late = late + here["jitter"] * draws["jitter"].scatter
    out: Array = CubicHermiteSpline(path.t, y, dy)(np.clip(t - late, path.t[0], path.t[-1]))
    if "multiplicative_noise" in here:
        noise = here["multiplicative_noise"] * draws["multiplicative_noise"].scatter
        out = out * (1.0 + noise)
    if "cross_axis" in here and beside is not None:
        out = out + here["cross_axis"] * beside(t)
    return (1.0 + here.get("sensor_scale", 0.0)) * out + here.get("sensor_bias", 0.0)


def sense_input(sizes: Mapping[str, float], draws: Mapping[str, Draws], path: Motion) -> Array:
    """The measured input on the integration grid, without noise."""
    here = {kind: size for kind, size in sizes.items() if draws[kind].where == "accel"}
    u, h = path.u, float(path.t[1] - path.t[0])
    if "sensor_lag" in here:
        u = _lagged(u, h, here["sensor_lag"])
    if "time_delay" in here:
        u = np.interp(path.t - here["time_delay"], path.t, u)
    return (1.0 + here.get("sensor_scale", 0.0)) * u + here.get("sensor_bias", 0.0)


def _lagged(y: Array, h: float, lag: float) -> Array:
    e = math.exp(-h / lag)
    slope = 1.0 - lag / h * (1.0 - e)  # first-order hold: exact for a piecewise linear signal
    out: Array = lfilter([slope, 1.0 - e - slope], [1.0, -e], y - y[0]) + y[0]
    return out


def spoil(y: Array, sizes: Mapping[str, float], draws: Mapping[str, Draws], level: float) -> Array:
    y = y.copy()
    if "outliers" in sizes:
        y[draws["outliers"].at] += sizes["outliers"] * draws["outliers"].spikes
    if "saturation" in sizes:
        y = np.clip(y, -level, level)
    return y
