"""Stabilised inverted pendulum on a cart whose acceleration nobody measures.

Linder (2017), Indirect System Identification for Unknown Input Problems, chapter 7: the direct
model (7.10), an accelerometer and a gyro on the pendulum (7.13)-(7.15), constants of Table 7.2.
The cart's acceleration a_y is eliminated with the accelerometer, which leaves the indirect model

    I_2 phi'' = -k phi - d phi' - S a_s,   S = M z_g + m z_m,   I_2 = I_1 - z_s S          (7.24)

It is exact for the nonlinear pendulum as well: sin(phi) and cos(phi) a_y enter the torque balance
(7.9) and the accelerometer alike, and leave together.
"""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

import casid

Array = NDArray[np.float64]

TABLE_7_2 = {
    "M": 22.04,  # kg
    "z_g": -0.018,  # m
    "I_x": 0.1385,  # kg m^2
    "d": 0.1067,  # N m s/rad
    "k": 10.39,  # N m/rad
    "m": 0.2,  # kg, loaded; 0 nominal
    "z_m": -0.274,  # m
    "z_s": -0.218,  # m
}
"""The true values of the simulation study 7.5.1; heights are negative above the pivot."""

CART_LAG = 0.2
"""Time constant of F_delta(s) = 1/(0.2 s + 1), from the reference to a_y [s]."""


def linear_model() -> casid.Model:
    """The pendulum with the unknown input still in it: (7.10) and (7.13)-(7.15).

    `m`, `z_m` and every other constant of Table 7.2 can be estimated after
    ``model.with_unknown(m=0.1, z_m=-0.3)``; the load is then sought in [0, 5] kg and [-2, 0] m,
    and not from m = 0, where z_m has no effect.
    """
    m = casid.Model("stabilised pendulum on a cart")
    v = _declared(m)
    m.derivative(v.phi, v.p)
    terms = [-(v.k + v.S * v.g) * v.phi, -v.d * v.p, v.S * v.a_y]
    m.balance(v.p, "torque", inertia=v.I_1, terms=terms)
    m.output("gyro", v.p, "rad/s")
    m.output("accel", v.z_s * m.der(v.p) + v.g * v.phi - v.a_y, "m/s^2")
    return m


direct_model = linear_model


def nonlinear_model() -> casid.Model:
    """The pendulum at any angle, the unknown input still in it: (7.9) and (7.13)-(7.15).

    Parameters as in `linear_model`. Eliminating a_y with the accelerometer gives the same indirect
    model as from `linear_model`: what is not linear leaves with a_y.
    """
    m = casid.Model("stabilised pendulum on a cart, any angle")
    v = _declared(m)
    sin, cos = ca.sin(v.phi), ca.cos(v.phi)
    m.derivative(v.phi, v.p)
    terms = [-v.k * v.phi, -v.S * v.g * sin, -v.d * v.p, v.S * cos * v.a_y]
    m.balance(v.p, "torque", inertia=v.I_1, terms=terms)
    m.output("gyro", v.p, "rad/s")
    m.output("accel", v.z_s * m.der(v.p) + v.g * sin - v.a_y * cos, "m/s^2")
    return m


def indirect_model() -> casid.Model:
    """The model after the accelerometer has replaced the cart's acceleration: (7.24)-(7.26)."""
    return linear_model().eliminate("a_y", using="accel")


def _declared(m: casid.Model) -> SimpleNamespace:
    """States, input and parameters of the direct models, with (7.8): S = Mbar zbar_g and I_1."""
    phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    a_y = m.unknown_input("a_y", "m/s^2")
    k = m.parameter("k", "N m/rad", start=8.0, lower=0.0, upper=200.0)
    d = m.parameter("d", "N m s/rad", start=0.1, lower=0.0, upper=20.0)
    # Below 0.0794 kg m^2 the inertia I_2 of the indirect model would be negative.
    I_x = m.parameter("I_x", "kg m^2", start=0.15, lower=0.081, upper=2.0)
    # A load is known to be absent unless a load case says otherwise; it may still appear.
    load = m.parameter("m", "kg", value=0.0, lower=0.0, upper=5.0)
    M, z_g = m.constant("M", TABLE_7_2["M"], "kg"), m.constant("z_g", TABLE_7_2["z_g"], "m")
    z_m, I_xm = m.constant("z_m", TABLE_7_2["z_m"], "m"), m.constant("I_xm", 0.0, "kg m^2")
    z_s, g = m.constant("z_s", TABLE_7_2["z_s"], "m"), m.constant("g", 9.81, "m/s^2")
    # The load stands above the pivot: where a later stage seeks its height, it seeks it there.
    m.parameters["z_m"] = dataclasses.replace(m.parameters["z_m"], lower=-2.0, upper=0.0)
    S = M * z_g + load * z_m
    I_1 = I_x + M * z_g**2 + I_xm + load * z_m**2  # about the pivot (7.8)
    return SimpleNamespace(phi=phi, p=p, a_y=a_y, k=k, d=d, z_s=z_s, g=g, S=S, I_1=I_1)


def telegraph(
    N: int, Ts: float, *, amplitude: float, hold: float = 1.0, rng: np.random.Generator
) -> Array:
    """A random telegraph signal, held over samples: +-amplitude, switching as a Poisson process.

    Parameters
    ----------
    N, Ts : number of samples and sample time [s].
    amplitude : the two levels are +-amplitude, each with probability 1/2 at the start.
    hold : mean time between switches [s]. Several switches may fall into one sample.

    Returns
    -------
    (N,) array; mean 0, variance amplitude^2, autocovariance amplitude^2 exp(-2 |tau| / hold).
    """
    sign = 1.0 if rng.random() < 0.5 else -1.0
    switches = np.concatenate(([0], rng.poisson(Ts / hold, N - 1)))
    return np.asarray(sign * amplitude * (1.0 - 2.0 * (np.cumsum(switches) % 2)))


def simulate(
    *,
    duration: float = 60.0,
    k: float = 10.39,
    d: float = 0.1067,
    I_x: float = 0.1385,
    m: float = 0.0,
    d_2: float = 0.0,
    noise: float = 0.01,
    seed: int = 1,
    ref: Array | None = None,
    name: str = "example",
) -> casid.Record:
    """The nonlinear pendulum (7.9) on a cart that follows a random reference, sampled at 100 Hz.

    The cart's acceleration follows `ref` [m/s^2] through 1/(0.2 s + 1): random steps held for 1 s
    on average, or the (N,) samples given. `d_2` [N m s^2/rad^2] is drag, `noise` the standard
    deviation on both sensors.
    """
    z_s, g = TABLE_7_2["z_s"], 9.81
    rng = np.random.default_rng(seed)
    Ts, substeps = 0.01, 5
    if ref is None:
        N = round(duration / Ts)
        steps = rng.random(N) < Ts / 1.0
        level = rng.uniform(-1.0, 1.0, N)
        ref = level[np.maximum.accumulate(np.where(steps, np.arange(N), 0))]
    N = len(ref)
    phi, p, a_y, p_dot = motion(ref, Ts, substeps, k=k, d=d, I_x=I_x, m=m, d_2=d_2)
    accel = z_s * p_dot + g * np.sin(phi) - a_y * np.cos(phi)
    t = Ts * np.arange(N)
    phase = rng.uniform(0, 2 * np.pi, 4)
    yaw_rate = 0.2 * np.sin(0.31 * t + phase[0]) + 0.1 * np.sin(1.7 * t + phase[1])
    speed = 1.5 + 0.3 * np.sin(0.13 * t + phase[2]) + 0.1 * np.sin(0.71 * t + phase[3])
    return casid.Record(
        {
            "gyro": p + noise * rng.standard_normal(N),
            "accel": accel + noise * rng.standard_normal(N),
            "ref": ref,
            "yaw_rate": yaw_rate,
            "speed": speed,
        },
        {"gyro": "rad/s", "accel": "m/s^2", "ref": "m/s^2", "yaw_rate": "rad/s", "speed": "m/s"},
        Ts=Ts,
        name=name,
        provenance=(f"simulated by problems/pendulum.py, seed {seed}",),
    )


def motion(
    ref: Array, Ts: float, substeps: int, *, k: float, d: float, I_x: float, m: float, d_2: float
) -> Array:
    """(4, N): phi, phi', a_y and phi'' at the samples, from rest, by Runge-Kutta 4."""
    M, z_g, z_m, g = TABLE_7_2["M"], TABLE_7_2["z_g"], TABLE_7_2["z_m"], 9.81
    S, I_1 = M * z_g + m * z_m, I_x + M * z_g**2 + m * z_m**2

    def rates(phi: float, p: float, a: float, r: float) -> tuple[float, float, float]:
        sin, cos = math.sin(phi), math.cos(phi)
        torque = -k * phi - S * g * sin - d * p - d_2 * abs(p) * p + S * cos * a
        return p, torque / I_1, (r - a) / CART_LAG

    h = Ts / substeps
    phi = p = a = 0.0
    path = np.empty((len(ref), 4))
    for i, r in enumerate(ref.tolist()):
        path[i] = phi, p, a, rates(phi, p, a, r)[1]
        for _ in range(substeps):
            f1, p1, a1 = rates(phi, p, a, r)
            f2, p2, a2 = rates(phi + h / 2 * f1, p + h / 2 * p1, a + h / 2 * a1, r)
            f3, p3, a3 = rates(phi + h / 2 * f2, p + h / 2 * p2, a + h / 2 * a2, r)
            f4, p4, a4 = rates(phi + h * f3, p + h * p3, a + h * a3, r)
            phi += h / 6 * (f1 + 2 * f2 + 2 * f3 + f4)
            p += h / 6 * (p1 + 2 * p2 + 2 * p3 + p4)
            a += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return path.T


def experiments(
    *,
    duration: float = 300.0,
    amplitude: float = 0.3,
    seed: int = 1,
    noise: float = 0.01,
    load: float = 0.2,
    load_known: bool = False,
    k: float = 10.39,
    d: float = 0.1067,
    I_x: float = 0.1385,
    d_2: float = 0.0,
) -> list[casid.Experiment]:
    """One nominal and one loaded record of the nonlinear pendulum, references drawn apart.

    Parameters
    ----------
    duration : of each record [s], sampled at 100 Hz.
    amplitude : of the reference, a random telegraph with mean hold 1 s [m/s^2].
    seed : of everything random.
    noise : standard deviation of the white noise on gyro [rad/s] and accel [m/s^2].
    load : the mass on the loaded pendulum, at the height z_m of Table 7.2 [kg].
    load_known : whether the loaded experiment knows it.
    k, d, I_x, d_2 : as in `simulate`.

    Returns
    -------
    two experiments, "nominal" with known m = 0 and "loaded" with m known where it is said to be;
    channels gyro, accel, ref (and two that have no effect, as in the example).
    """
    N = round(duration / 0.01)
    made: list[casid.Experiment] = []
    for case, mass in (("nominal", 0.0), ("loaded", load)):
        first, second = np.random.SeedSequence((seed, len(made))).spawn(2)
        ref = telegraph(N, 0.01, amplitude=amplitude, rng=np.random.default_rng(first))
        record = simulate(
            k=k,
            d=d,
            I_x=I_x,
            m=mass,
            d_2=d_2,
            noise=noise,
            seed=int(second.generate_state(1)[0]),
            ref=ref,
            name=case,
        )
        known = {"m": mass} if case == "nominal" or load_known else {}
        made.append(casid.Experiment(record, known, case))
    return made


def example() -> list[casid.Experiment]:
    """One minute of the nominal pendulum with something that the model above leaves out."""
    return [casid.Experiment(simulate(d_2=0.2), {}, "example")]  # drag: for the diagnosis to find


def draw(seed: int) -> list[casid.Experiment]:
    """Two minutes of the nominal pendulum as the model has it: the noise drawn from `seed`."""
    N = 12_000
    ref = telegraph(N, 0.01, amplitude=0.3, rng=np.random.default_rng(1))
    record = simulate(seed=seed, ref=ref, name="drawn")
    return [casid.Experiment(record, {"m": 0.0}, "drawn")]


problem = casid.Problem(
    name="pendulum",
    model=indirect_model(),
    channels={"gyro": "gyro:rad/s", "accel": "accel:m/s^2"},
    recorded={"ref": "m/s^2", "yaw_rate": "rad/s", "speed": "m/s"},
    time="t",
    load_cases={"nominal": {"m": 0.0}, "loaded": {"m": 0.2}},
    example=example,
    simulate=draw,
    truth={name: TABLE_7_2[name] for name in ("k", "d", "I_x")},
    description="Inverted pendulum on a cart, held by springs; the cart's acceleration is unknown.",
    references=(
        "J. Linder, Indirect System Identification for Unknown Input Problems, 2017, ch. 7",
    ),
)
