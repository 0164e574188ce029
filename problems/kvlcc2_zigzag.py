"""Roll of a tanker in zigzag manoeuvres, driven by its own sway and yaw, at full scale.

Linder (2017), Indirect System Identification for Unknown Input Problems, (8.8)-(8.10), divided by
the inertia in roll A_1. With a_y = v' + U r, the lateral acceleration of the hull,

    phi'' = -C_1 phi - B_1 phi' + b_a a_y + b_rdot r' + b_r r + b_v v + b_delta delta + c_0     (1)

C_1 = (k + S g)/A_1, B_1 = d/A_1, b_a = (K_vdot + S)/A_1, b_rdot = K_rdot/A_1,
b_r = (K_ur - K_vdot) U/A_1, b_v = K_|u|v U/A_1, b_delta = K_delta/A_1; c_0 is a mean heel. (8.10)
leaves r' and v out; here they are kept. The roll frequency is omega_0 = sqrt(C_1), and only it has
a published value: 0.347 rad/s for KVLCC2 (model data of HSVA, scaled from 1:45.7).

The files (free-running model tests of MARIN, SIMMAN 2008, scaled to full scale) hold speeds u, v
along axes fixed to the EARTH. So three of the inputs are derived, with a local polynomial for all:

    v    = v_e cos(psi) - u_e sin(psi)            sway speed of the hull, smoothed
    a_y  = dv/dt + U r, U = u_e cos(psi) + v_e sin(psi)
    rdot = dr/dt

and U, smoothed, for who wants to know whether the coefficients depend on it. Units of the columns,
which are this problem's own mapping (--map goes over it):

    phi = phi_deg (deg), p = p_degps (deg/s), r = r_degps (deg/s), delta = delta_deg (deg),
    psi = psi_deg (deg), u_earth = u_mps (m/s), v_earth = v_mps (m/s), t_s (s)

so that a file is used as it is, decimated to a grid that suits a roll period of 18 s:

    casid identify problems/kvlcc2_zigzag.py zz_10.csv --resample 0.54
    casid diagnose problems/kvlcc2_zigzag_alone.py zz_10.csv --resample 0.54

The second file holds the same roll with no input at all (`without_inputs`), which is wrong.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import casid
from casid.data.derived import Derived
from casid.data.local_polynomial import LocalPolynomial

Array = NDArray[np.float64]

OMEGA_0 = 0.3468
"""Published natural frequency in roll [rad/s], full scale: GM 0.1248 m, k_xx 0.372 B at 1:45.7."""

INPUTS = {"a_y": "m/s^2", "rdot": "rad/s^2", "r": "rad/s", "v": "m/s", "delta": "rad"}
"""What drives the roll in (1)."""

SMOOTHER = LocalPolynomial(window=4.0, degree=3)
"""Of every derived channel. At the roll frequency, 0.055 Hz, it loses less than 0.5 %."""

NOISE = {
    "phi": np.deg2rad(4e-4),
    "p": np.deg2rad(2.2e-3),
    "psi": np.deg2rad(2.2e-2),
    "r": np.deg2rad(2.3e-4),
    "delta": np.deg2rad(1e-2),
    "u_earth": 7e-3,
    "v_earth": 4e-3,
}
"""White noise of the recorded channels, SI: what cubics over 1.5 s leave of zz_10 and zz_20, so at
most this much.

Three digits are kept in the files, which alone makes 0.03 degrees of psi and 3 mm/s of a speed.
"""


def roll_model() -> casid.Model:
    """(1), with roll angle and roll rate measured."""
    m = casid.Model("roll in a manoeuvre")
    phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    a_y, rdot, r, v, delta = (m.input(name, unit) for name, unit in INPUTS.items())
    C_1 = m.parameter("C_1", "1/s^2", start=0.12, lower=1e-3, upper=2.0)
    B_1 = m.parameter("B_1", "1/s", start=0.02, lower=0.0, upper=0.5)
    b_a = m.parameter("b_a", "1/m", start=0.0, lower=-0.1, upper=0.1)
    b_rdot = m.parameter("b_rdot", "1", start=0.0, lower=-20.0, upper=20.0)
    b_r = m.parameter("b_r", "1/s", start=0.0, lower=-1.0, upper=1.0)
    b_v = m.parameter("b_v", "1/(m s)", start=0.0, lower=-0.1, upper=0.1)
    b_delta = m.parameter("b_delta", "1/s^2", start=0.0, lower=-0.1, upper=0.1)
    c_0 = m.parameter("c_0", "1/s^2", start=0.0, lower=-0.1, upper=0.1)
    m.derivative(phi, p)
    m.balance(
        p,
        "torque",
        inertia=1,
        terms=[
            -C_1 * phi,
            -B_1 * p,
            b_a * a_y,
            b_rdot * rdot,
            b_r * r,
            b_v * v,
            b_delta * delta,
            c_0,
        ],
        unit="rad/s^2",
    )
    m.output("phi", phi, "rad")
    m.output("p", p, "rad/s")
    return m


def roll_alone() -> casid.Model:
    """(1) without a single input: the wrong model."""
    m = casid.Model("roll alone")
    phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    C_1 = m.parameter("C_1", "1/s^2", start=0.12, lower=1e-3, upper=2.0)
    B_1 = m.parameter("B_1", "1/s", start=0.02, lower=-0.5, upper=0.5)
    c_0 = m.parameter("c_0", "1/s^2", start=0.0, lower=-0.1, upper=0.1)
    m.derivative(phi, p)
    m.balance(p, "torque", inertia=1, terms=[-C_1 * phi, -B_1 * p, c_0], unit="rad/s^2")
    m.output("phi", phi, "rad")
    m.output("p", p, "rad/s")
    return m


# -- channels that no file has ---------------------------------------------------------------------

EARTH = {"u_earth": "m/s", "v_earth": "m/s", "psi": "rad"}


def surge_speed(record: casid.Record) -> Array:
    """(N,) speed along the hull [m/s], from speeds over ground and heading."""
    psi = record["psi"]
    return np.asarray(record["u_earth"] * np.cos(psi) + record["v_earth"] * np.sin(psi))


def smooth_speed(record: casid.Record) -> Array:
    """(N,) smoothed `surge_speed` [m/s]."""
    return SMOOTHER.apply(surge_speed(record), record.Ts)


def _sway(record: casid.Record) -> Array:
    psi = record["psi"]
    return np.asarray(record["v_earth"] * np.cos(psi) - record["u_earth"] * np.sin(psi))


def sway_speed(record: casid.Record) -> Array:
    """(N,) smoothed speed across the hull, to starboard [m/s]."""
    return SMOOTHER.apply(_sway(record), record.Ts)


def lateral_acceleration(record: casid.Record) -> Array:
    """(N,) v' + U r of the hull [m/s^2]."""
    vdot = SMOOTHER.apply(_sway(record), record.Ts, derivative=1)
    return vdot + SMOOTHER.apply(surge_speed(record) * record["r"], record.Ts)


def yaw_acceleration(record: casid.Record) -> Array:
    """(N,) derivative of the yaw rate [rad/s^2]."""
    return SMOOTHER.apply(record["r"], record.Ts, derivative=1)


def _declared(
    unit: str, sources: dict[str, str], values: Callable[..., Array], how: str
) -> Derived:
    filters = f"polynomials of degree {SMOOTHER.degree} over {SMOOTHER.window:g} s"
    return Derived(unit, sources, values, f"{how}, by {filters}", margin=SMOOTHER.window / 2 + 0.1)


_FILE = 0.13526  # s, sample time of the files, for which the bandwidths are given
_BANDS = [f"{SMOOTHER.bandwidth_hz(_FILE, k):.2g} Hz" for k in (0, 1)]

DERIVED = {
    "a_y": _declared(
        "m/s^2",
        {**EARTH, "r": "rad/s"},
        lateral_acceleration,
        f"d/dt (half power at {_BANDS[1]}) of v_e cos psi - u_e sin psi, and smoothed U r",
    ),
    "v": _declared(
        "m/s", EARTH, sway_speed, f"v_e cos psi - u_e sin psi, smoothed (half power {_BANDS[0]})"
    ),
    "rdot": _declared(
        "rad/s^2", {"r": "rad/s"}, yaw_acceleration, f"d/dt of r (half power at {_BANDS[1]})"
    ),
    "U": _declared(
        "m/s", EARTH, smooth_speed, f"u_e cos psi + v_e sin psi, smoothed (half power {_BANDS[0]})"
    ),
}
"""How a_y, v, rdot and U are made of what the files hold."""

CHANNELS = {
    "phi": "phi_deg:deg",
    "p": "p_degps:deg/s",
    "r": "r_degps:deg/s",
    "delta": "delta_deg:deg",
    "psi": "psi_deg:deg",
    "u_earth": "u_mps:m/s",
    "v_earth": "v_mps:m/s",
}
"""Signal -> column of the files, with its unit."""


# -- a manoeuvre of its own ------------------------------------------------------------------------

TRUTH = {
    "C_1": OMEGA_0**2,
    "B_1": 0.015,
    "b_a": -0.012,
    "b_rdot": 0.6,
    "b_r": -0.03,
    "b_v": 1e-4,
    "b_delta": -5e-4,
    "c_0": 0.0,
}
"""Of `simulate`; the heel is as large as in the files."""


def simulate(
    *,
    amplitude: float = 10.0,
    duration: float = 520.0,
    noise: float = 1.0,
    seed: int = 4,
    name: str = "example",
) -> casid.Record:
    """A zigzag as the files have it: earth-fixed speeds, heading, rates, rudder, roll.

    Sway and yaw are linear, with gusts of their own; the speed falls in the turns; roll is (1). The
    rudder goes over at 2.3 deg/s when the heading has passed `amplitude`.

    Parameters
    ----------
    amplitude : deg, of rudder and heading.
    duration : s.
    noise : times `NOISE`.
    seed : of noise and gusts.
    """
    Ts, substeps = _FILE, 4
    N, h, limit = round(duration / Ts), Ts / substeps, np.deg2rad(amplitude)
    b, U_0 = TRUTH, 7.9
    rng = np.random.default_rng(seed)
    w = rng.uniform(0.02, 0.4, (2, 12))
    phase = rng.uniform(0.0, 2 * np.pi, (2, 12))

    def rates(x: Array, t: float, command: float) -> Array:
        psi, r, v, U, delta, _, p = x
        gust = np.sum(np.sin(w * t + phase), axis=1) / np.sqrt(12)
        turn = np.clip((command - delta) / 0.2, -0.04, 0.04)
        rdot = (0.026 * delta - r) / 30.0 - 2e-5 * v + 6e-6 * gust[0]
        vdot = (-140.0 * r - v) / 20.0 - 0.02 * delta + 2e-3 * gust[1]
        Udot = (U_0 - U) / 120.0 - 600.0 * r**2
        pdot = -b["C_1"] * x[5] - b["B_1"] * p + b["b_a"] * (vdot + U * r) + b["b_rdot"] * rdot
        pdot += b["b_r"] * r + b["b_v"] * v + b["b_delta"] * delta + b["c_0"]
        return np.array([r, rdot, vdot, Udot, turn, p, pdot])

    x, rows, side = np.array([0.0, 0.0, 0.0, U_0, 0.0, 0.0, 0.0]), np.empty((N, 7)), 1.0
    for i in range(N):
        rows[i] = x
        if side * x[0] > limit:
            side = -side
        for j in range(substeps):
            t = i * Ts + j * h
            middle = x + h / 2 * rates(x, t, side * limit)
            x = x + h * rates(middle, t + h / 2, side * limit)
    psi, r, v, U, delta, phi, p = rows.T
    channels = {
        "phi": phi,
        "p": p,
        "r": r,
        "delta": delta,
        "psi": psi,
        "u_earth": U * np.cos(psi) - v * np.sin(psi),
        "v_earth": U * np.sin(psi) + v * np.cos(psi),
    }
    units = {n: "rad" for n in ("phi", "delta", "psi")} | {"p": "rad/s", "r": "rad/s"}
    units |= {"u_earth": "m/s", "v_earth": "m/s"}
    return casid.Record(
        {n: y + noise * NOISE[n] * rng.standard_normal(N) for n, y in channels.items()},
        units,
        Ts=Ts,
        name=name,
        provenance=(f"simulated by problems/kvlcc2_zigzag.py, seed {seed}",),
    )


def coarse(experiment: casid.Experiment, factor: int = 4) -> casid.Experiment:
    """The experiment on every `factor`-th sample behind a filter: 0.54 s, 33 a roll period."""
    record = experiment.record.decimate(factor)
    return casid.Experiment(record, experiment.known, experiment.name)


def example() -> list[casid.Experiment]:
    """A 10/10 zigzag of 520 s."""
    return [coarse(problem.experiment(simulate()))]


def draw(seed: int) -> list[casid.Experiment]:
    """The same, its noise from this seed."""
    return [coarse(problem.experiment(simulate(seed=seed, name="drawn")))]


problem = casid.Problem(
    name="kvlcc2_zigzag",
    model=roll_model(),
    channels=CHANNELS,
    recorded={"U": "m/s"},
    derived=DERIVED,
    time="t_s",
    noise={n: sd for n, sd in NOISE.items() if n not in ("phi", "p")},  # those are estimated
    example=example,
    simulate=draw,
    truth=TRUTH,
    starts=1,
    description="Roll of KVLCC2 in zigzags at full scale, driven by lateral acceleration, yaw, "
    "sway and rudder; the heading commands the rudder.",
    references=(
        "J. Linder, Indirect System Identification for Unknown Input Problems, 2017, ch. 8",
        "SIMMAN 2008, free-running tests of KVLCC2 at MARIN; files of M. Alexandersson, "
        "System-identification-of-Vessel-Manoeuvring-Models",
    ),
)


def without_inputs() -> casid.Problem:
    """The wrong model: no input, and all that (1) is driven by recorded beside it."""
    return dataclasses.replace(
        problem,
        name="kvlcc2_zigzag_alone",
        model=roll_alone(),
        recorded=INPUTS,
        derived={n: entry for n, entry in DERIVED.items() if n in INPUTS},
        simulate=None,
        truth={},
        description="Roll of KVLCC2 in zigzags, its inputs left out.",
    )
