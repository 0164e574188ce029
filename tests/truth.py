"""Records whose hidden effect is known, from simulators that share no code with casid.

Three second-order systems are integrated by a fixed-step Runge-Kutta method and sampled with noise:

    cart-pendulum         I_1 phidd = -(k + S g) phi - d phid + S a_y + torque        (7.10)
    roll decay            phidd = -2 zeta w phid - w^2 (phi - heel) + torque
    mass-spring-damper    m xdd = -k x - d xd + F + torque

To each at most two effects are added. The size of an effect follows from its *strength*: the rms
misfit which the best linear refit leaves in the noise-free measured output, in units of that
output's noise. The effects that spoil single samples (`outliers`, `saturation`) need no refit:
their strength is the rms difference between spoilt and true samples, over the whole record.

Equation numbers are those of the thesis; constants are those of its Table 7.2.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

Array = np.ndarray[Any, np.dtype[np.floating[Any]]]

# Table 7.2 (SI units); z points down, so what lies above the centre of rotation is negative.
M, Z_G, I_X, D, K = 22.04, -0.018, 0.1385, 0.1067, 10.39
Z_S, G, M_LOAD, Z_M = -0.218, 9.81, 0.2, -0.274
CART_LAG = 0.2  # a_y = ref / (CART_LAG s + 1) [s]

FINE = 0.002  # integration step of the record itself [s]
COARSE = 0.005  # integration step while the size of an effect is sought [s]
PRE_ROLL = 3.0  # seconds simulated before t = 0: the record starts in motion, a delay has a past
TOLERANCE = 0.01  # relative tolerance of the strength in the search

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
}
SENSOR = {"sensor_bias", "time_delay", "sensor_lag"}
SAMPLES = {"saturation", "outliers"}
PENDULUM_EFFECTS = ("none", *sorted(TORQUE | SENSOR | SAMPLES))
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
}


class UnreachableStrength(ValueError):
    """No admissible size of this effect leaves the requested misfit in this record."""


@dataclass(frozen=True, slots=True, eq=False)
class TruthRecord:
    """One synthetic record with everything that is true about it."""

    columns: Mapping[str, Array]  # name -> (N,) measured channels, SI
    units: Mapping[str, str]  # name -> SI unit
    kind: str  # the effect's name, "none" for none
    where: str  # where it acts: torque, gyro, k, d, m, yaw_rate, d~speed, ...
    strength: float  # measured on the final record, the first effect alone
    truth: Mapping[str, float]  # constants, `size` of the effect and its details, SI
    noise: float  # sd of the measured output's white noise, output units
    clean: Mapping[str, Array]  # name -> (N,) noise-free signals, before the sensor's own effects
    second: tuple[str, str, float] | None = None  # kind, where, measured strength alone
    strength_joint: float = field(default=math.nan)  # misfit of the linear refit, all effects on

    @property
    def Ts(self) -> float:
        """Sample time [s]."""
        return float(self.columns["t"][1] - self.columns["t"][0])


@dataclass(frozen=True, slots=True)
class _Draws:
    """The random details of one effect: drawn for every effect alike, used by some."""

    where: str
    sign: float
    t_jump: float  # [s]
    frequency: float  # [Hz]
    phase: float  # [rad]
    at: np.ndarray[Any, np.dtype[np.signedinteger[Any]]]  # indices of spoilt samples
    spikes: Array  # their relative heights


@dataclass(frozen=True, slots=True)
class _Motion:
    """A noise-free trajectory on the integration grid."""

    t: Array
    x: Array
    v: Array
    a: Array
    u: Array  # input of the linear refit, same grid (empty if there is none)


def cart_pendulum(
    effect: str = "none",
    strength: float = 0.0,
    seed: int = 0,
    duration: float = 60.0,
    Ts: float = 0.01,
    noise: float = 0.01,
    where: str | None = None,
    second: tuple[str, float] | None = None,
    *,
    size: float | None = None,
    load: float = 0.0,
) -> TruthRecord:
    """Cart-pendulum in the direct form (7.10), with an unknown cart acceleration.

    Parameters
    ----------
    effect : one of PENDULUM_EFFECTS
    strength : rms misfit after the linear refit, in units of the gyro noise
    seed : of the one generator; the same seed gives the same constants, excitation and noise for
        every effect
    duration, Ts : seconds; Ts must be a multiple of 0.01 s
    noise : sd of the white noise on gyro [rad/s] and on accel [m/s^2]
    where : k, d or m for `parameter_jump`, k or d for `parameter_drift`; drawn if None
    second : (kind, strength) of a second effect; each size is found with the other absent
    size : the effect's own size, in place of a strength (which is then only measured). SI: Nm s^2,
        Nm, Nm, ... ; relative change for k and d; kg for m; L / max|gyro| for `saturation`
    load : mass at Z_M [kg]; `M_LOAD` is the thesis's

    Returns
    -------
    TruthRecord with columns t, gyro, accel, ref, yaw_rate, speed; clean has phi, phid, phidd,
    accel, a_y.

    Raises
    ------
    UnreachableStrength
        Always for `offset`: it is absorbed exactly by the initial angle of the indirect model.
    """
    _require(effect, second, PENDULUM_EFFECTS)
    rng = np.random.default_rng(seed)
    k, d, I_x = (nominal * rng.uniform(0.8, 1.2) for nominal in (K, D, I_X))
    ref = _Telegraph.draw(rng, rng.uniform(1.2, 2.5), rng.uniform(0.5, 1.0), duration)
    yaw_rate = _Waves.draw(rng, 0.4, 0.02, 0.6, 30)
    speed = _Waves.draw(rng, 0.3, 0.005, 0.06, 12, mean=1.0)
    t = _samples(duration, Ts)
    duration = float(t[-1])
    white = rng.standard_normal((2, t.size))
    draws = [
        _draw(rng, kind, where if i == 0 else None, t)
        for i, kind in enumerate((effect, (second or ("none",))[0]))
    ]

    def motion(sizes: Mapping[str, float], h: float) -> _Motion:
        steps = _Steps(h, duration)
        a_y = ref.lagged(steps, CART_LAG)
        now = _Torque(sizes, dict(zip((effect, (second or ("none",))[0]), draws, strict=True)))
        k_t, d_t, torque, m_t = now.coefficients(k, d, load, steps.times, duration, yaw_rate, speed)
        if np.any(k_t + (M * Z_G + m_t * Z_M) * G <= 0.0) or np.any(d_t < 0.0) or np.any(m_t < 0.0):
            raise _Runaway("the stiffness or the damping became negative: choose a smaller `size`")
        S = M * Z_G + m_t * Z_M
        I_1 = I_x + M * Z_G**2 + m_t * Z_M**2
        x, v, a = _integrate(
            S * a_y + torque, k_t + S * G, d_t, I_1, now.nonlinear(k, width=0.005), h, 0.0, 0.0
        )
        accel = Z_S * a + G * x - np.append(a_y[0], a_y[2, -1])  # (7.14)
        return _Motion(steps.nodes, x, v, a, accel)

    I_2 = I_x + M * Z_G * (Z_G - Z_S) + load * Z_M * (Z_M - Z_S)  # (7.25)
    refit = _Refit(output="v", hold="foh", start=(d / I_2, k / I_2))
    out = _solve(motion, refit, t, noise, effect, strength, second, draws, size)
    truth = {
        "k": k,
        "d": d,
        "I_x": I_x,
        "m": load,
        "z_m": Z_M,
        "M": M,
        "z_g": Z_G,
        "z_s": Z_S,
        "g": G,
    }
    path = out.motion
    at = np.rint((t - path.t[0]) / (path.t[1] - path.t[0])).astype(int)
    clean = {"phi": path.x[at], "phid": path.v[at], "phidd": path.a[at], "accel": path.u[at]}
    clean["a_y"] = Z_S * clean["phidd"] + G * clean["phi"] - clean["accel"]
    columns = {
        "t": t,
        "gyro": out.spoil(out.sensed + noise * white[0]),
        "accel": clean["accel"] + noise * white[1],
        "ref": ref(t),
        "yaw_rate": yaw_rate(t),
        "speed": speed(t),
    }
    units = {
        "t": "s",
        "gyro": "rad/s",
        "accel": "m/s^2",
        "ref": "m/s^2",
        "yaw_rate": "rad/s",
        "speed": "m/s",
    }
    return out.record(columns, units, truth, clean, noise)


def roll_decay(
    effect: str = "none",
    strength: float = 0.0,
    seed: int = 0,
    duration: float = 60.0,
    Ts: float = 0.02,
    noise: float = 0.002,
    second: tuple[str, float] | None = None,
    *,
    size: float | None = None,
) -> TruthRecord:
    """Free roll decay about a constant heel, the angle alone measured.

    phidd + 2 zeta w phid + d2 |phid| phid + w^2 (phi - heel) + k3 (phi - heel)^3 = 0, released
    from rest near 0.3 rad. `size` is d2 [1/rad], k3 [1/(rad^2 s^2)] or the friction [rad/s^2]. The
    effect "both" is quadratic damping and cubic stiffness, each of the given strength when alone.

    Returns
    -------
    TruthRecord with columns t, phi; clean has phi, phid, phidd; truth has zeta, w, heel, phi0.
    """
    if effect == "both":
        effect, second = "quadratic_damping", ("cubic_stiffness", strength)
    _require(effect, second, ROLL_EFFECTS)
    rng = np.random.default_rng(seed)
    w, zeta = rng.uniform(0.8, 2.0), rng.uniform(0.02, 0.06)
    heel, phi0 = rng.uniform(-0.02, 0.02), float(rng.choice([-1.0, 1.0])) * rng.uniform(0.25, 0.4)
    t = _samples(duration, Ts)
    duration = float(t[-1])
    white = rng.standard_normal(t.size)
    draws = [_draw(rng, kind, None, t) for kind in (effect, (second or ("none",))[0])]

    def motion(sizes: Mapping[str, float], h: float) -> _Motion:
        steps = _Steps(h, duration, before=0.0)
        now, ones = _Torque(sizes, {}), np.ones_like(steps.times)
        f = now.nonlinear(w**2, width=0.002)
        x, v, a = _integrate(
            0.0 * ones, w**2 * ones, 2 * zeta * w * ones, ones, f, h, phi0 - heel, 0.0
        )
        return _Motion(steps.nodes, x + heel, v, a, np.empty(0))

    refit = _Refit(output="x", hold="none", start=(2 * zeta * w, w**2))
    out = _solve(motion, refit, t, noise, effect, strength, second, draws, size)
    truth = {"zeta": zeta, "w": w, "heel": heel, "phi0": phi0}
    at = np.rint(t / (out.motion.t[1] - out.motion.t[0])).astype(int)
    clean = {"phi": out.motion.x[at], "phid": out.motion.v[at], "phidd": out.motion.a[at]}
    columns = {"t": t, "phi": out.spoil(out.sensed + noise * white)}
    return out.record(columns, {"t": "s", "phi": "rad"}, truth, clean, noise)


def mass_spring_damper(
    effect: str = "none",
    strength: float = 0.0,
    seed: int = 0,
    duration: float = 60.0,
    Ts: float = 0.01,
    noise: float = 0.001,
    force_noise: float = 0.02,
    second: tuple[str, float] | None = None,
    *,
    size: float | None = None,
    signal: str = "telegraph",
) -> TruthRecord:
    """m xdd + d xd + k x = F, the force held between samples; force and position measured.

    Near m = 2 kg, d = 1.5 N s/m, k = 50 N/m. `signal` is "telegraph" (many levels) or "multisine".

    Returns
    -------
    TruthRecord with columns t, force, position; clean has position, velocity, acceleration, force.
    """
    _require(effect, second, MASS_EFFECTS)
    if signal not in ("telegraph", "multisine"):
        raise ValueError(f"signal={signal!r}: choose 'telegraph' or 'multisine'")
    rng = np.random.default_rng(seed)
    m, d, k = (nominal * rng.uniform(0.8, 1.2) for nominal in (2.0, 1.5, 50.0))
    t = _samples(duration, Ts)
    duration = float(t[-1])
    telegraph = _Telegraph.draw(rng, rng.uniform(3.0, 6.0), rng.uniform(0.5, 1.0), duration)
    waves = _Waves.draw(rng, rng.uniform(3.0, 6.0), 0.05, 2.5, 40)
    force = telegraph if signal == "telegraph" else waves
    white = rng.standard_normal((2, t.size))
    draws = [_draw(rng, kind, None, t) for kind in (effect, (second or ("none",))[0])]

    def held(times: Array) -> Array:
        return force(np.floor(times / Ts + 1e-12) * Ts)

    def motion(sizes: Mapping[str, float], h: float) -> _Motion:
        steps = _Steps(h, duration)
        now, ones = _Torque(sizes, {}), np.ones_like(steps.times)
        F = held(steps.times)
        u = np.append(F[1], held(np.array([duration + 1e-9])))
        f = now.nonlinear(k, width=0.001)
        c = F + sizes.get("offset", 0.0)
        x, v, a = _integrate(c, k * ones, d * ones, m * ones, f, h, 0.0, 0.0)
        return _Motion(steps.nodes, x, v, a, u)

    refit = _Refit(output="x", hold="zoh", start=(d / m, k / m))
    out = _solve(motion, refit, t, noise, effect, strength, second, draws, size)
    truth = {"m": m, "d": d, "k": k}
    path = out.motion
    at = np.rint((t - path.t[0]) / (path.t[1] - path.t[0])).astype(int)
    clean = {
        "position": path.x[at],
        "velocity": path.v[at],
        "acceleration": path.a[at],
        "force": held(t + 1e-9),
    }
    columns = {
        "t": t,
        "force": clean["force"] + force_noise * white[1],
        "position": out.spoil(out.sensed + noise * white[0]),
    }
    return out.record(columns, {"t": "s", "force": "N", "position": "m"}, truth, clean, noise)


def write_csv(truth: TruthRecord, path: str | Path) -> None:
    """Write the measured columns: one header line, nine significant digits, SI units."""
    with Path(path).open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(truth.columns)
        for row in zip(*truth.columns.values(), strict=True):
            rows.writerow([f"{value:.9g}" for value in row])


# --- excitation ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Telegraph:
    """Piecewise constant, normal levels, exponential holds; jumps lie on the 0.01 s grid."""

    jumps: Array
    levels: Array

    @classmethod
    def draw(cls, rng: np.random.Generator, sd: float, hold: float, duration: float) -> _Telegraph:
        n = int(4 * (duration + PRE_ROLL) / hold) + 20
        holds = np.maximum(0.1, np.round(rng.exponential(hold, n), 2))
        levels = rng.standard_normal(n)
        return cls(np.round(np.cumsum(holds) - holds[0] - PRE_ROLL, 2), sd * levels)

    def __call__(self, t: Array) -> Array:
        i = np.searchsorted(self.jumps, np.asarray(t) + 1e-10, side="right") - 1
        out: Array = self.levels[np.maximum(i, 0)]
        return out

    def lagged(self, steps: _Steps, lag: float) -> Array:
        """The exact response of 1 / (lag s + 1) at start, middle and end of each step."""
        level = np.repeat(self(steps.times[1]), 2)  # constant within a step: jumps lie on nodes
        decay = math.exp(-0.5 * steps.h / lag)
        y = lfilter([1.0 - decay], [1.0, -decay], level)
        y = np.concatenate(([0.0], y))
        return np.stack([y[0:-1:2], y[1::2], y[2::2]])


@dataclass(frozen=True, slots=True)
class _Waves:
    """A sum of cosines with random frequencies and phases: band-limited, smooth, no edges."""

    mean: float
    amplitude: Array
    omega: Array
    phase: Array

    @classmethod
    def draw(
        cls, rng: np.random.Generator, sd: float, low: float, high: float, n: int, mean: float = 0.0
    ) -> _Waves:
        omega, phase = 2 * np.pi * rng.uniform(low, high, n), rng.uniform(0.0, 2 * np.pi, n)
        return cls(mean, np.full(n, sd * math.sqrt(2.0 / n)), omega, phase)

    def __call__(self, t: Array) -> Array:
        out = np.full(np.shape(t), self.mean)
        for a, w, p in zip(self.amplitude, self.omega, self.phase, strict=True):
            out += a * np.cos(w * t + p)
        return out


def _samples(duration: float, Ts: float) -> Array:
    ratio = Ts / 0.01
    if abs(ratio - round(ratio)) > 1e-9 or round(ratio) < 1:
        raise ValueError(f"Ts={Ts!r}: choose a multiple of 0.01 s")
    return np.arange(int(round(duration / Ts)) + 1) * Ts


# --- effects ---------------------------------------------------------------------------------


def _require(effect: str, second: tuple[str, float] | None, allowed: tuple[str, ...]) -> None:
    for kind in (effect, *(second or ("none",))[:1]):
        if kind not in allowed:
            raise ValueError(f"effect={kind!r}: choose one of {', '.join(allowed)}")
    if second is not None and second[0] == effect:
        raise ValueError(f"second={second!r}: the same kind twice; choose another")


def _draw(rng: np.random.Generator, kind: str, where: str | None, t: Array) -> _Draws:
    """Draw the details of an effect; the same number of draws whatever the kind."""
    pick = rng.integers(6)
    choice = {"parameter_jump": ("k", "d", "m"), "parameter_drift": ("k", "d")}.get(kind)
    if choice:
        if where is not None and where not in choice:
            raise ValueError(f"where={where!r} of {kind}: choose {', '.join(choice)}")
        where = where or choice[pick % len(choice)]
    else:
        where = {
            "extra_input": "yaw_rate",
            "scheduled_parameter": "d~speed",
            **dict.fromkeys(SENSOR | SAMPLES, "output"),
        }.get(kind, "torque")
    sign = float(rng.choice([-1.0, 1.0]))
    if kind in ONE_SIDED or (kind == "parameter_jump" and where == "m"):
        sign = 1.0
    t_jump = round(float(rng.uniform(0.2, 0.8)) * float(t[-1]), 2)
    frequency, phase = float(rng.uniform(0.4, 3.0)), float(rng.uniform(0.0, 2 * np.pi))
    n = max(1, round(0.01 * t.size))
    # n of N - 4 n places, spread by 4 samples each: no two spikes are neighbours.
    at = np.sort(rng.choice(t.size - 4 * n, n, replace=False)) + 4 * np.arange(n) + 2
    spikes = rng.choice([-1.0, 1.0], n) * rng.uniform(0.7, 1.3, n)
    spikes *= math.sqrt(t.size) / float(np.linalg.norm(spikes))  # rms 1 over the whole record
    return _Draws(where, sign, t_jump, frequency, phase, at, spikes)


@dataclass(frozen=True, slots=True)
class _Torque:
    """What the effects of given sizes do to the right-hand side."""

    sizes: Mapping[str, float]
    draws: Mapping[str, _Draws]

    def coefficients(
        self,
        k: float,
        d: float,
        m: float,
        t: Array,
        duration: float,
        yaw_rate: _Waves,
        speed: _Waves,
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
        return k * factor["k"], d * factor["d"], torque, load

    def nonlinear(self, k: float, width: float) -> Callable[[float, float], float]:
        """The torque that depends on the state; `width` smooths the sign of dry friction."""
        d2 = self.sizes.get("quadratic_damping", 0.0)
        F_c = self.sizes.get("coulomb_friction", 0.0)
        k3 = self.sizes.get("cubic_stiffness", 0.0)
        gap = self.sizes.get("deadzone", 0.0)
        tanh = math.tanh

        def torque(x: float, v: float) -> float:
            out = -d2 * abs(v) * v - k3 * x * x * x
            if F_c:  # stiction: a viscous creep below `width`, in place of a set-valued sign
                out -= F_c * tanh(v / width)
            if gap:
                out += k * min(max(x, -gap), gap)
            return out

        return torque


def _sense(sizes: Mapping[str, float], path: _Motion, output: str, t: Array) -> Array:
    """The measured output at the sample times, without noise and without spoilt samples."""
    y, dy = (path.v, path.a) if output == "v" else (path.x, path.v)
    lag = sizes.get("sensor_lag", 0.0)
    if lag:
        h = float(path.t[1] - path.t[0])
        e = math.exp(-h / lag)
        slope = 1.0 - lag / h * (1.0 - e)  # first-order hold: exact for a piecewise linear signal
        y = lfilter([slope, 1.0 - e - slope], [1.0, -e], y - y[0]) + y[0]
        dy = np.gradient(y, h)
    out: Array = CubicHermiteSpline(path.t, y, dy)(t - sizes.get("time_delay", 0.0))
    return out + sizes.get("sensor_bias", 0.0)


# --- integration -----------------------------------------------------------------------------


class _Runaway(ValueError):
    """The trajectory, or a coefficient on its way, left the admissible range."""


class _Steps:
    """Start, middle and end of each integration step; a jump at a node belongs to the next step."""

    def __init__(self, h: float, duration: float, before: float = PRE_ROLL) -> None:
        n = int(round((duration + before) / h))
        self.h = h
        self.nodes: Array = np.arange(n + 1) * h - before
        start = self.nodes[:-1]
        self.times: Array = np.stack([start + 1e-9, start + 0.5 * h, start + h - 1e-9])


def _integrate(
    c: Array,
    k: Array,
    d: Array,
    inertia: Array,
    torque: Callable[[float, float], float],
    h: float,
    x: float,
    v: float,
    bound: float = 5.0,
) -> tuple[Array, Array, Array]:
    """Classical Runge-Kutta for inertia * a = c - k x - d v + torque(x, v).

    The coefficients are (3, n): at start, middle and end of each step. Returns x, v, a at the n + 1
    nodes. Scalar floats in a plain loop: numpy's overhead on two states would cost ten times more.
    """
    half, sixth = 0.5 * h, h / 6.0
    w = 1.0 / inertia
    rows = zip(*(r.tolist() for r in (*c, *k, *d, *w)), strict=True)
    xs, vs, accs = [x], [v], []
    for c0, c1, c2, k0, k1, k2, d0, d1, d2, w0, w1, w2 in rows:
        a1 = (c0 - k0 * x - d0 * v + torque(x, v)) * w0
        xx, v2 = x + half * v, v + half * a1
        a2 = (c1 - k1 * xx - d1 * v2 + torque(xx, v2)) * w1
        xx, v3 = x + half * v2, v + half * a2
        a3 = (c1 - k1 * xx - d1 * v3 + torque(xx, v3)) * w1
        xx, v4 = x + h * v3, v + h * a3
        a4 = (c2 - k2 * xx - d2 * v4 + torque(xx, v4)) * w2
        x += sixth * (v + 2.0 * (v2 + v3) + v4)
        v += sixth * (a1 + 2.0 * (a2 + a3) + a4)
        if not -bound < x < bound:
            raise _Runaway(f"|x| exceeded {bound:g}: choose a smaller `size`")
        xs.append(x)
        vs.append(v)
        accs.append(a1)
    accs.append((c2 - k2 * x - d2 * v + torque(x, v)) * w2)
    return np.array(xs), np.array(vs), np.array(accs)


# --- strength --------------------------------------------------------------------------------


@dataclass(slots=True)
class _Refit:
    """Best linear model of one output: alpha_1, alpha_2 free, the rest linear and eliminated.

    xdd + alpha_1 xd + alpha_2 x = beta u; the regressor columns, at given alphas, are the response
    to u (or a constant where there is no input) and the two free modes, so the gain and the initial
    state come from linear least squares (variable projection, Golub & Pereyra 1973).
    """

    output: str  # "x" or "v"
    hold: str  # how u runs between grid points: "foh", "zoh", or "none" for no input
    start: tuple[float, float]  # alpha_1, alpha_2 without the effect
    last: tuple[float, float] = (0.0, 0.0)  # log-ratio of the last optimum to `start`

    def misfit(self, path: _Motion, y: Array, t: Array) -> float:
        """Return the rms of y (N,), at times t, minus its best linear fit.

        Two starts, the undisturbed system and the last optimum, and the better end of the two:
        large delays and lags make local minima.
        """
        h = float(path.t[1] - path.t[0])
        first, stride = round((t[0] - path.t[0]) / h), round((t[1] - t[0]) / h)
        u = path.u[first:] if self.hold != "none" else path.u
        scale = float(np.std(y)) or 1.0

        def residual(log_ratio: Array) -> Array:
            alpha_1, alpha_2 = np.array(self.start) * np.exp(np.clip(log_ratio, -4.0, 4.0))
            root = np.sqrt(complex(0.25 * alpha_1**2 - alpha_2))
            if abs(root) < 1e-9:
                root = 1e-9 + 0j
            r = -0.5 * alpha_1 + root
            if abs(r.imag) > 0.0:
                mode = np.exp(r * t)
                modes = [mode.real, mode.imag]
            else:
                modes = [np.exp(r.real * t), np.exp((-0.5 * alpha_1 - root).real * t)]
            if self.hold == "none":
                columns = np.stack([np.ones_like(t), *modes], axis=1)
            else:
                response = _response(alpha_1, alpha_2, self.output, self.hold, h, u)
                columns = np.stack([response[::stride][: t.size], *modes], axis=1)
            columns = columns / np.linalg.norm(columns, axis=0)
            q, _ = np.linalg.qr(columns)
            out: Array = (y - q @ (q.T @ y)) / scale
            return out

        starts = {(0.0, 0.0), self.last}
        fits = [
            least_squares(residual, s, method="lm", xtol=1e-8, ftol=1e-9, max_nfev=60)
            for s in starts
        ]
        best = min(fits, key=lambda fit: float(fit.cost))
        self.last = (float(np.clip(best.x[0], -4, 4)), float(np.clip(best.x[1], -4, 4)))
        return float(np.sqrt(np.mean(best.fun**2))) * scale


def _response(alpha_1: float, alpha_2: float, output: str, hold: str, h: float, u: Array) -> Array:
    """Response of the unit-gain oscillator to u, from rest (any other start is in the modes)."""
    C = np.array([[0.0, 1.0]] if output == "v" else [[1.0, 0.0]])
    A, B = np.array([[0.0, 1.0], [-alpha_2, -alpha_1]]), np.array([[0.0], [1.0]])
    system = (A, B, C, np.zeros((1, 1)))
    A, B, C, D0, _ = cont2discrete(system, h, method=hold)  # type: ignore[call-overload]
    a = [1.0, -float(np.trace(A)), float(np.linalg.det(A))]
    g0, g1, g2 = float(D0[0, 0]), float((C @ B)[0, 0]), float((C @ A @ B)[0, 0])
    out: Array = lfilter([g0, g1 + a[1] * g0, g2 + a[1] * g1 + a[2] * g0], a, u)
    return out


@dataclass(frozen=True, slots=True)
class _Outcome:
    """The final trajectory with all effects on, and what was found on the way."""

    kinds: tuple[str, str]
    sizes: Mapping[str, float]
    draws: list[_Draws]
    strengths: tuple[float, float]
    joint: float
    motion: _Motion
    output: str
    sensed: Array  # (N,) with the sensor's bias, delay, lag; no noise

    def spoil(self, y: Array) -> Array:
        """Add outliers, then clip: the last two things that happen to a sample."""
        return _spoil(y, self.sizes, dict(zip(self.kinds, self.draws, strict=True)), self._level())

    def _level(self) -> float:
        return self.sizes.get("saturation", 1.0) * float(np.max(np.abs(self.sensed)))

    def record(
        self,
        columns: Mapping[str, Array],
        units: Mapping[str, str],
        truth: dict[str, float],
        clean: Mapping[str, Array],
        noise: float,
    ) -> TruthRecord:
        """Put the record together."""
        name = next((n for n in ("gyro", "position", "phi") if n in columns), "output")
        wheres = [name if draw.where == "output" else draw.where for draw in self.draws]
        for prefix, kind, draw in zip(("", "second_"), self.kinds, self.draws, strict=True):
            if kind == "none":
                continue
            truth[prefix + "size"] = self.sizes[kind]
            if kind == "parameter_jump":
                truth[prefix + "t_jump"] = draw.t_jump
            if kind == "periodic_disturbance":
                truth[prefix + "frequency"], truth[prefix + "phase"] = draw.frequency, draw.phase
            if kind == "saturation":
                truth[prefix + "level"] = self._level()
        other = None if self.kinds[1] == "none" else (self.kinds[1], wheres[1], self.strengths[1])
        first = self.kinds[0]
        return TruthRecord(
            columns,
            units,
            first,
            wheres[0],
            self.strengths[0],
            truth,
            noise,
            clean,
            other,
            self.joint,
        )


def _spoil(
    y: Array, sizes: Mapping[str, float], draws: Mapping[str, _Draws], level: float
) -> Array:
    y = y.copy()
    if "outliers" in sizes:
        y[draws["outliers"].at] += sizes["outliers"] * draws["outliers"].spikes
    if "saturation" in sizes:
        y = np.clip(y, -level, level)
    return y


def _solve(
    motion: Callable[[Mapping[str, float], float], _Motion],
    refit: _Refit,
    t: Array,
    noise: float,
    effect: str,
    strength: float,
    second: tuple[str, float] | None,
    draws: list[_Draws],
    size: float | None,
) -> _Outcome:
    """Find each effect's size alone, then run them together on the fine grid."""
    kinds = (effect, second[0] if second else "none")
    wanted = (strength, second[1] if second else 0.0)
    named = dict(zip(kinds, draws, strict=True))
    paths: dict[tuple[float, bool], _Motion] = {}

    def path(sizes: Mapping[str, float], h: float) -> _Motion:
        acting = {kind: s for kind, s in sizes.items() if kind in TORQUE}
        if acting:
            return motion(acting, h)
        if (h, False) not in paths:  # the motion itself is free of effects: once is enough
            paths[h, False] = motion({}, h)
        return paths[h, False]

    def measure(sizes: Mapping[str, float], h: float) -> float:
        now = path(sizes, h)
        y = _sense(sizes, now, refit.output, t)
        if set(sizes) & SAMPLES:
            level = sizes.get("saturation", 1.0) * float(np.max(np.abs(y)))
            return float(np.sqrt(np.mean((_spoil(y, sizes, named, level) - y) ** 2))) / noise
        return refit.misfit(now, y, t) / noise

    sizes: dict[str, float] = {}
    strengths = []
    for i, (kind, target) in enumerate(zip(kinds, wanted, strict=True)):
        if kind != "none":
            if i == 0 and size is not None:
                sizes[kind] = size
            else:
                sizes[kind] = _search(kind, draws[i], target, measure)
        alone = {kind: sizes[kind]} if kind in sizes else {}
        strengths.append(measure(alone, FINE) if kind != "none" or i == 0 else 0.0)
    if len(sizes) == 2 and not set(sizes) & SAMPLES:
        joint = measure(sizes, FINE)
    else:
        joint = math.sqrt(sum(s**2 for s in strengths))  # spoilt samples: independent of the rest
    final = path(sizes, FINE)
    sensed = _sense(sizes, final, refit.output, t)
    return _Outcome(
        kinds, sizes, draws, (strengths[0], strengths[1]), joint, final, refit.output, sensed
    )


def _search(
    kind: str, draw: _Draws, target: float, measure: Callable[[Mapping[str, float], float], float]
) -> float:
    """Find the size that leaves the wanted strength, by secants in log-log inside a bracket."""
    if not target > 0.0:
        raise ValueError(f"strength={target!r} of {kind}: choose a positive one, or effect 'none'")
    start, limit = {
        "quadratic_damping": (0.01, 1e3),
        "coulomb_friction": (0.02, 0.3),
        "cubic_stiffness": (0.5, 1e4),
        "deadzone": (0.01, 1.0),
        "offset": (0.5, 5.0),
        "extra_input": (0.05, 1e2),
        "periodic_disturbance": (0.02, 1e2),
        "parameter_jump": (0.03, 3.0),
        "parameter_drift": (0.03, 3.0),
        "scheduled_parameter": (0.3, 10.0),
        "sensor_bias": (0.01, 1e2),
        "time_delay": (0.01, 0.2),
        "sensor_lag": (0.01, 0.5),
        "outliers": (0.01, 1e6),
        "saturation": (0.1, 0.999),  # of 1 - L / max|y|: less is more
    }[kind]
    signs = (1.0,) if kind in ONE_SIDED or draw.where == "m" else (draw.sign, -draw.sign)
    largest = 0.0
    for sign in signs:  # the drawn sign may be unreachable: a softening spring runs away

        def of(size: float, sign: float = sign) -> float:
            return measure({kind: 1.0 - size if kind == "saturation" else sign * size}, COARSE)

        size, found = _root(of, target, start, limit)
        if size is not None:
            return 1.0 - size if kind == "saturation" else sign * size
        largest = max(largest, found)
    raise UnreachableStrength(
        f"{kind}: strength {target:g} was not reached; the largest found is {largest:.3g}. "
        "Ask for less, take another seed, or give `size` instead."
    )


def _root(
    strength: Callable[[float], float], target: float, start: float, limit: float
) -> tuple[float | None, float]:
    """Return the size with the wanted strength (None if there is none), and the largest found."""
    low, high, size, largest = 0.0, math.inf, start, 0.0
    points: list[tuple[float, float]] = []
    for _ in range(25):
        try:
            found = strength(size)
        except (_Runaway, np.linalg.LinAlgError):
            found = math.inf
        if math.isfinite(found):
            largest = max(largest, found)
            if abs(found / target - 1.0) < TOLERANCE:
                return size, largest
            points.append((math.log(size), math.log(max(found, 1e-12))))
        if found > target:
            high = min(high, size)
        else:
            low = max(low, size)
        if low >= limit * 0.999 or high - low < 2e-3 * high:
            break
        guess = 0.0
        slope = 1.0
        if len(points) > 1 and points[-1][0] != points[-2][0]:
            slope = (points[-1][1] - points[-2][1]) / (points[-1][0] - points[-2][0])
        if points and slope > 0.2:
            step = (math.log(target) - points[-1][1]) / min(slope, 3.0)
            guess = math.exp(points[-1][0] + min(max(step, -3.0), 3.0))
        if not low < guess < high:  # outside the bracket: halve it in ratio, or widen it
            guess = 3.0 * low if high == math.inf else math.sqrt(max(low, high / 30.0) * high)
        size = min(guess, limit)
    return None, largest
