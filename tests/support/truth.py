"""Records whose hidden effect is known, from simulators that share no code with casid.

Three second-order systems are integrated by a fixed-step Runge-Kutta method and sampled with noise:

    cart-pendulum         I_1 phidd = -(k + S g) phi - d phid + S a_y + torque        (7.10)
    roll decay            phidd = -2 zeta w phid - w^2 (phi - heel) + torque
    mass-spring-damper    m xdd = -k x - d xd + F + torque

To each at most two effects are added. The size of an effect follows from its *strength*: the rms
misfit which the best linear refit leaves in the noise-free measured output, in units of that
output's noise. The effects that spoil samples (`outliers`, `saturation`, `jitter`,
`multiplicative_noise`) need no refit: their strength is the rms difference between spoilt and true
samples, over the whole record.

Equation numbers are those of the thesis; constants are those of its Table 7.2.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.truth_effects import (
    MASS_EFFECTS,
    PENDULUM_EFFECTS,
    ROLL_EFFECTS,
    Torque,
    draw,
    require,
)
from tests.support.truth_motion import (
    Motion,
    Runaway,
    Steps,
    Telegraph,
    Waves,
    integrate,
    integrate_with,
    sample_times,
)
from tests.support.truth_strength import Outcome, Refit, solve
from tests.support.truth_strength import UnreachableStrength as UnreachableStrength

Array = np.ndarray[Any, np.dtype[np.floating[Any]]]

# Table 7.2 (SI units); z points down, so what lies above the centre of rotation is negative.
M, Z_G, I_X, D, K = 22.04, -0.018, 0.1385, 0.1067, 10.39
Z_S, G, M_LOAD, Z_M = -0.218, 9.81, 0.2, -0.274
CART_LAG = 0.2  # a_y = ref / (CART_LAG s + 1) [s]


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
    quiet: Mapping[str, Array] = field(default_factory=dict)  # measured channels without noise
    alone: tuple[Mapping[str, Array], ...] = ()  # of two effects: as `quiet`, one effect each

    @property
    def Ts(self) -> float:
        """Sample time [s]."""
        return float(self.columns["t"][1] - self.columns["t"][0])


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
    jump_within: tuple[float, float] = (0.2, 0.8),
    step_grid: float = 0.01,
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
    jump_within : shares of the record between which a parameter jumps
    step_grid : the reference steps at its multiples [s], a multiple of 0.01 s: where it is `Ts`, no
        signal has a corner between samples

    Returns
    -------
    TruthRecord with columns t, gyro, accel, ref, yaw_rate, speed; clean has phi, phid, phidd,
    accel, a_y.

    Raises
    ------
    UnreachableStrength
        Always for `offset`: it is absorbed exactly by the initial angle of the indirect model.
    """
    require(effect, second, PENDULUM_EFFECTS)
    rng = np.random.default_rng(seed)
    k, d, I_x = (nominal * rng.uniform(0.8, 1.2) for nominal in (K, D, I_X))
    ref = Telegraph.draw(rng, rng.uniform(1.2, 2.5), rng.uniform(0.5, 1.0), duration, step_grid)
    yaw_rate = Waves.draw(rng, 0.4, 0.02, 0.6, 30)
    speed = Waves.draw(rng, 0.3, 0.005, 0.06, 12, mean=1.0)
    t = sample_times(duration, Ts)
    duration = float(t[-1])
    white = rng.standard_normal((2, t.size))
    draws = [
        draw(rng, kind, where if i == 0 else None, t, jump_within)
        for i, kind in enumerate((effect, (second or ("none",))[0]))
    ]

    def motion(sizes: Mapping[str, float], h: float) -> Motion:
        steps = Steps(h, duration)
        a_y = ref.lagged(steps, CART_LAG)
        now = Torque(sizes, dict(zip((effect, (second or ("none",))[0]), draws, strict=True)))
        k_t, d_t, torque, m_t = now.coefficients(k, d, load, steps.times, duration, yaw_rate, speed)
        if np.any(k_t + (M * Z_G + m_t * Z_M) * G <= 0.0) or np.any(d_t < 0.0) or np.any(m_t < 0.0):
            raise Runaway("the stiffness or the damping became negative: choose a smaller `size`")
        S = M * Z_G + m_t * Z_M
        I_1 = I_x + M * Z_G**2 + m_t * Z_M**2
        law, inner = now.nonlinear(k, width=0.005), now.inner()
        c, k_all = S * a_y + torque, k_t + S * G
        if inner is None:
            x, v, a = integrate(c, k_all, d_t, I_1, law, h, 0.0, 0.0)
        else:
            x, v, a = integrate_with(c, k_all, d_t, I_1, law, inner, h)
        accel = Z_S * a + G * x - np.append(a_y[0], a_y[2, -1])  # (7.14)
        return Motion(steps.nodes, x, v, a, accel)

    I_2 = I_x + M * Z_G * (Z_G - Z_S) + load * Z_M * (Z_M - Z_S)  # (7.25)
    refit = Refit(output="v", hold="foh", start=(d / I_2, k / I_2))
    out = solve(motion, refit, t, noise, effect, strength, second, draws, size, yaw_rate)
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
    quiet = {"gyro": out.spoil(out.sensed), "accel": out.felt[at]}
    columns = {
        "t": t,
        "gyro": out.spoil(out.sensed + noise * white[0]),
        "accel": quiet["accel"] + noise * white[1],
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
    return _record(out, columns, units, truth, clean, noise, quiet)


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
    require(effect, second, ROLL_EFFECTS)
    rng = np.random.default_rng(seed)
    w, zeta = rng.uniform(0.8, 2.0), rng.uniform(0.02, 0.06)
    heel, phi0 = rng.uniform(-0.02, 0.02), float(rng.choice([-1.0, 1.0])) * rng.uniform(0.25, 0.4)
    t = sample_times(duration, Ts)
    duration = float(t[-1])
    white = rng.standard_normal(t.size)
    draws = [draw(rng, kind, None, t) for kind in (effect, (second or ("none",))[0])]

    def motion(sizes: Mapping[str, float], h: float) -> Motion:
        steps = Steps(h, duration, before=0.0)
        now, ones = Torque(sizes, {}), np.ones_like(steps.times)
        f = now.nonlinear(w**2, width=0.002)
        x, v, a = integrate(
            0.0 * ones, w**2 * ones, 2 * zeta * w * ones, ones, f, h, phi0 - heel, 0.0
        )
        return Motion(steps.nodes, x + heel, v, a, np.empty(0))

    refit = Refit(output="x", hold="none", start=(2 * zeta * w, w**2))
    out = solve(motion, refit, t, noise, effect, strength, second, draws, size)
    truth = {"zeta": zeta, "w": w, "heel": heel, "phi0": phi0}
    at = np.rint(t / (out.motion.t[1] - out.motion.t[0])).astype(int)
    clean = {"phi": out.motion.x[at], "phid": out.motion.v[at], "phidd": out.motion.a[at]}
    columns = {"t": t, "phi": out.spoil(out.sensed + noise * white)}
    quiet = {"phi": out.spoil(out.sensed)}
    return _record(out, columns, {"t": "s", "phi": "rad"}, truth, clean, noise, quiet)


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
    require(effect, second, MASS_EFFECTS)
    if signal not in ("telegraph", "multisine"):
        raise ValueError(f"signal={signal!r}: choose 'telegraph' or 'multisine'")
    rng = np.random.default_rng(seed)
    m, d, k = (nominal * rng.uniform(0.8, 1.2) for nominal in (2.0, 1.5, 50.0))
    t = sample_times(duration, Ts)
    duration = float(t[-1])
    telegraph = Telegraph.draw(rng, rng.uniform(3.0, 6.0), rng.uniform(0.5, 1.0), duration)
    waves = Waves.draw(rng, rng.uniform(3.0, 6.0), 0.05, 2.5, 40)
    force = telegraph if signal == "telegraph" else waves
    white = rng.standard_normal((2, t.size))
    draws = [draw(rng, kind, None, t) for kind in (effect, (second or ("none",))[0])]

    def held(times: Array) -> Array:
        return force(np.floor(times / Ts + 1e-12) * Ts)

    def motion(sizes: Mapping[str, float], h: float) -> Motion:
        steps = Steps(h, duration)
        now, ones = Torque(sizes, {}), np.ones_like(steps.times)
        F = held(steps.times)
        u = np.append(F[1], held(np.array([duration + 1e-9])))
        f = now.nonlinear(k, width=0.001)
        c = F + sizes.get("offset", 0.0)
        x, v, a = integrate(c, k * ones, d * ones, m * ones, f, h, 0.0, 0.0)
        return Motion(steps.nodes, x, v, a, u)

    refit = Refit(output="x", hold="zoh", start=(d / m, k / m))
    out = solve(motion, refit, t, noise, effect, strength, second, draws, size)
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
    units = {"t": "s", "force": "N", "position": "m"}
    quiet = {"force": clean["force"], "position": out.spoil(out.sensed)}
    return _record(out, columns, units, truth, clean, noise, quiet)


def _record(
    out: Outcome,
    columns: Mapping[str, Array],
    units: Mapping[str, str],
    truth: dict[str, float],
    clean: Mapping[str, Array],
    noise: float,
    quiet: Mapping[str, Array],
) -> TruthRecord:
    """Put the record together."""
    name = next((n for n in ("gyro", "position", "phi") if n in columns), "output")
    wheres = [name if its.where == "output" else its.where for its in out.draws]
    for prefix, kind, its in zip(("", "second_"), out.kinds, out.draws, strict=True):
        if kind == "none":
            continue
        truth[prefix + "size"] = out.sizes[kind]
        if kind in ("parameter_jump", "knock"):
            truth[prefix + "t_jump"] = its.t_jump
        if kind in ("periodic_disturbance", "parametric_stiffness", "missing_mode"):
            truth[prefix + "frequency"], truth[prefix + "phase"] = its.frequency, its.phase
        if kind == "saturation":
            truth[prefix + "level"] = out.level()
    other = None if out.kinds[1] == "none" else (out.kinds[1], wheres[1], out.strengths[1])
    inputs = [n for n in quiet if n != name]
    alone = [{name: y, **dict.fromkeys(inputs, u)} for y, u in out.alone]
    return TruthRecord(
        columns,
        units,
        out.kinds[0],
        wheres[0],
        out.strengths[0],
        truth,
        noise,
        clean,
        other,
        out.joint,
        quiet,
        tuple(alone),
    )


def write_csv(truth: TruthRecord, path: str | Path) -> None:
    """Write the measured columns: one header line, nine significant digits, SI units."""
    with Path(path).open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(truth.columns)
        for row in zip(*truth.columns.values(), strict=True):
            rows.writerow([f"{value:.9g}" for value in row])
