"""Hours of a model ship in waves, and its calibration: what the study of load monitoring is fed.

The nonlinear simulator of `problems.ship_4dof`, model scale 1:24, zigzags of 10 deg every 10 s. A
zigzag turns the ship to and fro by 100 deg, so the waves are taken where the ship is: along the
path of the zigzag in calm water, which repeats itself every 20 s with a constant advance. That the
waves themselves move the ship off this path, a few degrees and decimetres, is left out of their
phases. Every ten minutes another 200 waves fade in.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

import casid
from casid.arrays import Array
from casid.estimation.cross_moments.gram import Moments
from casid.estimation.cross_moments.moments import moments
from casid.estimation.cross_moments.windowed_moments import Simulated, WindowedMoments, on_simulated
from casid.estimation.moments.equations.moment_equations import MomentEquations
from casid.estimation.moments.equations.parts import Part
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.stages.prior import Prior
from casid.estimation.moments.stages.propagation import propagate
from casid.estimation.moments.stages.stage import Stage
from casid.estimation.prediction_error.polynomial.estimation import oe
from casid.linear.sampled.difference_equation import difference_equation
from casid.linear.sampled.lagged_columns import Column
from problems import ship
from problems.ship_4dof import LOAD_CASES, Load, random_steps, simulate, zigzag
from problems.ship_simulator import sensors as ship_sensors
from problems.ship_simulator import waves as ship_waves

TS = 0.02  # s
ANGLE, EVERY = math.radians(10.0), 10.0  # of the zigzag
PERIOD = 20.0  # s, two sides; one window of the monitor
HS = 0.3 / 24.0  # m: 0.3 m at full scale
BLOCK = 30  # periods after which other waves come
CHANNELS = ("gyro", "accel", "r", "delta")
CALIBRATED = ("k", "A_x", "d", "K_r", "K_vdot", "K_delta")
ABOARD = LOAD_CASES["calibration"]  # 0.2 kg at the calibration's height
Z_F = (-0.028, 0.003)  # m: height of the axis of roll and its standard error, as declared


@dataclass(frozen=True, slots=True)
class Path:
    """One period of the zigzag in calm water: places and headings, (n + 1,)."""

    x: Array
    y: Array
    psi: Array


@lru_cache(maxsize=1)
def calm_path() -> Path:
    """The limit cycle, after ten minutes."""
    motion = simulate(zigzag(620.0, angle=ANGLE, every=EVERY), substeps=1)
    n = slice(round(600.0 / TS), None)
    x, y, psi = (motion[name][n] for name in ("x", "y", "psi"))
    # The last sample of the record is one short of the period's end: the cycle closes itself.
    before = round(600.0 / TS) - round(PERIOD / TS)
    step = [motion[name][round(600.0 / TS)] - motion[name][before] for name in ("x", "y")]
    return Path(np.append(x - x[0], step[0]), np.append(y - y[0], step[1]), np.append(psi, psi[0]))


def spectrum(Hs: float = HS) -> ship_waves.Jonswap:
    """JONSWAP with the peak of a fully developed sea, w0 = 0.4 sqrt(g/Hs); 11.2 rad/s here."""
    return ship_waves.Jonswap(Hs, 0.4 * math.sqrt(ship_waves.G / Hs))


def wave_forces(
    first: int, periods: int, *, seed: int, Hs: float = HS, beta: float = math.radians(120.0)
) -> Array:
    """(N, 4) forces and torques of waves over some periods of the zigzag [N, N m].

    Parameters
    ----------
    first, periods : the first period and their number; pieces of one sea fit together.
    seed : of the sea.
    beta : direction in which waves travel, from the mean course [rad]; 120 deg: bow quarter.
    """
    path, loads = calm_path(), ship_waves.WaveLoads()
    n = path.x.size - 1
    mean = float(path.psi[:-1].mean())
    angle = beta + mean - path.psi[:-1]  # from the bow, at each sample
    cos, sin, twice = np.cos(angle), np.sin(angle), np.sin(2.0 * angle)
    # One period in which a set of waves fades into the next one, at constant variance.
    fade = np.pi / 2.0 * np.arange(n) / n
    made = []
    last = None
    for block in range(first // BLOCK, (first + periods - 1) // BLOCK + 1):
        if last is None and block:
            last = _waves(block - 1, seed, Hs, beta + mean)
        eta, slope = _waves(block, seed, Hs, beta + mean)
        if last is not None:
            eta[0] = np.sin(fade) * eta[0] + np.cos(fade) * last[0][-1]
            slope[0] = np.sin(fade) * slope[0] + np.cos(fade) * last[1][-1]
        last = eta, slope
        for k in range(BLOCK):
            if first <= BLOCK * block + k < first + periods:
                s_, d_ = slope[k], np.abs(eta[k]) ** 2
                X = -loads.c_X * s_ * cos + loads.D_X * cos * d_
                Y = -loads.c_Y * s_ * sin + loads.D_Y * sin * d_
                N = -loads.c_N * s_ * twice + loads.D_N * twice * d_
                made.append(np.stack([X, Y, -loads.c_K * s_ * sin, N], axis=1))
    return np.concatenate(made)


def _waves(block: int, seed: int, Hs: float, course: float) -> tuple[Array, Array]:
    """Analytic elevation and faded slope along the path, (BLOCK + 1, n), of one set of waves."""
    path, own = calm_path(), spectrum(Hs)
    n = path.x.size - 1
    along = path.x * math.cos(course) + path.y * math.sin(course)
    band = (0.5 * own.w0, 3.0 * own.w0)
    sea = ship_waves.sample_sea(own, band, seed=seed * 100_000 + block, n=200, gaussian=True)
    kappa = sea.w**2 / ship_waves.G
    within = np.exp(1j * (np.outer(TS * np.arange(n), sea.w) - np.outer(along[:-1], kappa)))
    turn = np.outer(np.arange(BLOCK + 1), sea.w * PERIOD - kappa * along[-1])
    start = sea.amplitude * np.exp(1j * (sea.phase + turn))
    weight = kappa * np.exp(-kappa * ship_waves.WaveLoads().depth)
    return start @ within.T, ((start * weight) @ within.T).imag


def voyage(
    legs: Sequence[tuple[Load, float]], *, seed: int, block: float = 1800.0, Hs: float = HS
) -> Iterator[casid.Record]:
    """Records of zigzags with one load after the other, in pieces that continue each other.

    Parameters
    ----------
    legs : load and duration [s], whole periods of the zigzag.
    seed : of waves and of the sensors' noise.
    block : of one piece at most [s].
    """
    start, piece, done = None, 0, 0
    for load, duration in legs:
        left = round(duration / PERIOD)
        while left:
            n = min(left, round(block / PERIOD))
            rudder = zigzag(n * PERIOD, angle=ANGLE, every=EVERY)
            rudder = np.append(rudder, ANGLE)  # one sample more: where the next piece begins
            forces = wave_forces(done, n, seed=seed, Hs=Hs)
            forces = np.vstack([forces, forces[-1:]])
            motion = simulate(rudder, load=load, forces=forces, start=start, substeps=1)
            record = ship_sensors.measure(motion, seed=seed * 1000 + piece, name="voyage")
            start, piece, left, done = motion.end, piece + 1, left - n, done + n
            yield ship_sensors.for_roll(record).between(0.0, n * PERIOD - TS / 2)


# -- what a monitor needs --------------------------------------------------------------------------


def low_pass() -> tuple[Array, Array]:
    """Butterworth of order 3 at 4 rad/s: waves are above, what the rudder does mostly below."""
    from scipy.signal import butter

    b, a = butter(3, 4.0 * TS / np.pi)
    return np.asarray(b), np.asarray(a)


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What was learnt once: parameters with their covariance, and filters for the instruments.

    Attributes
    ----------
    known : the six parameters and z_f.
    simulated : channels made of the rudder alone.
    remarks : how the estimate fits.
    """

    known: Prior
    simulated: dict[str, Simulated]
    remarks: tuple[str, ...] = field(default=())

    def windows(self) -> WindowedMoments:
        """A stream's moments, a window a period."""
        return WindowedMoments(
            CHANNELS,
            equation().left.order + 2,
            round(PERIOD / TS),
            simulated=self.simulated,
            prefilter=low_pass(),
            settle=5 * round(PERIOD / TS),
        )

    def stream(
        self, legs: Sequence[tuple[Load, float]], *, seed: int, Hs: float = HS
    ) -> list[Moments]:
        """The windows of a voyage."""
        stream = self.windows()
        found: list[Moments] = []
        for record in voyage(legs, seed=seed, Hs=Hs):
            found += stream.add({n: record[n] for n in record.names})
        return found


@lru_cache(maxsize=1)
def equation() -> Any:
    """The roll subsystem as a difference equation."""
    return difference_equation(ship.problem.model, "gyro", TS)


def instruments() -> tuple[Column, ...]:
    """The regressors with what the rudder alone makes of their channels."""
    return on_simulated(equation().columns, {n: f"{n}^" for n in CHANNELS if n != "delta"})


def calibrate(minutes: float = 20.0, *, seed: int = 1) -> Calibration:
    """Calibrate with random steps of the rudder, without load and with the calibration weight.

    Steps of up to 20 deg every second or so: the zigzag's own slow turns leave rudder, yaw rate and
    lateral acceleration nearly proportional to each other, and six parameters are not identifiable.

    Parameters
    ----------
    minutes : of either record.
    seed : of rudder, waves and noise.
    """
    from scipy.signal import lfilter

    model = ship.problem.model.with_known(z_f=Z_F[0])
    records = {}
    for i, case in enumerate(("nominal", "calibration")):
        own = 100 * seed + i
        N = round(minutes * 60.0 / PERIOD)
        rudder = random_steps(N * PERIOD, angle=math.radians(20.0), hold=1.0, seed=own)
        motion = simulate(
            rudder, load=LOAD_CASES[case], forces=wave_forces(0, N, seed=own), substeps=1
        )
        records[case] = ship_sensors.for_roll(ship_sensors.measure(motion, seed=own, name=case))
    simulated: dict[str, Simulated] = {}
    first = records["nominal"]
    n = min(first.N, 15_000)
    for name in ("gyro", "accel", "r"):
        black_box = oe(first[name][:n], first["delta"][:n], nf=4, nb=5, nk=0, Ts=TS, throw=False)
        b, a = (np.asarray(next(iter(p.values()))) for p in (black_box.B, black_box.F))
        simulated[f"{name}^"] = Simulated("delta", b, a)
    b, a = low_pass()
    parts, equations = [], []
    for case, record in records.items():
        known = {"m": 0.0, "zbar_m": 0.0, **ship.LOAD_CASES[case]}
        signals = {c: record[c] for c in CHANNELS}
        signals |= {c: lfilter(s.b, s.a, record[s.channel]) for c, s in simulated.items()}
        signals = {c: lfilter(b, a, x)[1500:] for c, x in signals.items()}
        values = model.nominal_values | known
        parts.append(Part(case, equation(), values, frozenset(known), signals, signals, TS))
        equations.append(
            MomentEquations.from_moments(
                equation(), moments(signals, 2), instruments(), name=case, signals=signals
            )
        )
    stage = Stage(model, parts, CALIBRATED, MomentSettings(), name="calibration")

    def solved(z_f: float) -> Any:
        values = [{**p.values, "z_f": z_f} for p in parts]
        return stage.fit_equations(equations, parts, values)

    fit = solved(Z_F[0])
    found = propagate([fit], how="independent")
    # z_f is taken as known with an error: its part in the others, by solving again.
    h = 0.1 * Z_F[1]
    slope = (solved(Z_F[0] + h).theta_p - solved(Z_F[0] - h).theta_p) / (2.0 * h)
    direction = np.append(slope, 1.0)
    covariance = np.outer(direction, direction) * Z_F[1] ** 2
    covariance[:-1, :-1] += found.own
    values = {**dict(zip(CALIBRATED, fit.theta_p.tolist(), strict=True)), "z_f": Z_F[0]}
    remarks = (f"overidentification: chi2 {found.statistic:.1f} with {found.degrees}",)
    return Calibration(Prior(values, covariance), simulated, remarks)
