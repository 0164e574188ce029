"""The cases of the power study: drawn by part and number, so that each can be made again alone.

A case is a few plain numbers. Its records come from the independent simulators of the tests, which
share no code with casid. How strong an effect is to be follows from the energy that the case is to
show, drawn log-uniformly; what it does show is measured afterwards (`energy`).
The ship's records are simulated by `ship`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import casid
from analysis.diagnosis_power.energy import FITTED, strength_of_outliers
from analysis.diagnosis_power.judgement import TIMING
from casid.model.effects.effect import KINDS

PARTS = ("nulls", "single", "pairs", "unlisted", "roll", "ship")
"""Parts that have cases of their own; the others judge the same cases again."""

GENERATION = 20261
"""Of the seeds: a new one draws new cases."""

SETTINGS = ((60.0, 0.01), (120.0, 0.02), (300.0, 0.02))
"""Length and sample time of the pendulum's records [s]."""

NULL_NOISE = (0.005, 0.02)
"""Noise levels of the null records: sd of gyro [rad/s] and accelerometer [m/s^2]."""

NOISE = (0.005, 0.01, 0.02)
"""Noise levels of all other records."""

ENERGY = (30.0, 10_000.0)
"""Range of the energies drawn."""

JUMPS = (0.12, 0.58)
"""Shares of the record between which a parameter jumps: within what is fitted."""


@dataclass(frozen=True, slots=True)
class Case:
    """One record to be made, by number."""

    part: str
    number: int
    system: str  # pendulum, roll, ship
    kind: str  # "none" for a null record
    where: str | None  # None: the simulator's own, or drawn by it
    seed: int
    duration: float  # s
    Ts: float  # s
    noise: float  # sd of every sensor
    energy: float = 0.0  # what the first effect is to show
    size: float | None = None  # of an effect that shows nothing
    second: tuple[str, float] | None = None  # kind and energy
    without: tuple[str, ...] = ()  # kinds taken out of the catalogue


@dataclass(frozen=True, slots=True, eq=False)
class Hidden:
    """A case's records, measured and free of noise, and what is true about them."""

    case: Case
    record: casid.Record
    clean: casid.Record
    sd: Mapping[str, float]  # channel -> white noise
    where: str
    strength: float  # rms misfit of the first effect alone, in units of the output's noise
    second: tuple[str, str, float] | None  # kind, where, strength
    alone: tuple[casid.Record, ...]  # noise-free, one effect each, where there are two
    start: Mapping[str, float]  # the model's parameters, as they truly are without the effect
    truth: Mapping[str, float]  # the size of the effect and its details, SI


def draw_case(part: str, number: int) -> Case:
    """Case `number` of a part; the same one in every call."""
    rng = np.random.default_rng([GENERATION, PARTS.index(part), number])
    return {
        "nulls": _null,
        "single": _single,
        "pairs": _pair,
        "unlisted": _unlisted,
        "roll": _roll,
        "ship": _ship,
    }[part](number, rng)


def make(case: Case) -> Hidden:
    """Simulate a case. An effect that cannot be so strong is made half as strong, and again."""
    from tests.support.truth import UnreachableStrength

    while True:
        try:
            return {"pendulum": _pendulum, "roll": _roll_decay, "ship": _ship_record}[case.system](
                case
            )
        except UnreachableStrength:
            second = None if case.second is None else (case.second[0], case.second[1] / 4)
            case = replace(case, energy=case.energy / 4, second=second)
            if case.energy < 1e-3:
                raise


# -- drawing --------------------------------------------------------------------------------------

SINGLE: tuple[tuple[str, str | None], ...] = (
    ("quadratic_damping", None),
    ("coulomb_friction", None),
    ("cubic_stiffness", None),
    ("deadzone", None),
    ("extra_input", None),
    ("periodic_disturbance", None),
    ("parameter_jump", "k"),
    ("parameter_jump", "d"),
    ("parameter_jump", "m"),
    ("parameter_drift", "k"),
    ("parameter_drift", "d"),
    ("scheduled_parameter", None),
    ("sensor_bias", None),
    ("time_delay", None),
    ("sensor_lag", None),
    ("saturation", None),
    ("outliers", None),
    ("cross_axis", None),
    ("missing_mode", None),
    ("time_delay", "accel"),
)
"""Kinds and places of single effects, each as often as any other."""

INVISIBLE: tuple[tuple[str, str | None, float], ...] = (
    ("offset", None, 0.3),
    ("sensor_bias", "accel", 0.1),
    ("sensor_scale", "accel", 0.1),
    ("sensor_scale", None, 0.1),
)
"""Effects that this set-up cannot show: kind, place, size [SI]."""

PAIRED = (
    "quadratic_damping",
    "coulomb_friction",
    "cubic_stiffness",
    "extra_input",
    "periodic_disturbance",
    "parameter_jump",
    "scheduled_parameter",
    "sensor_bias",
    "time_delay",
    "deadzone",
    "parameter_drift",
    "cross_axis",
    "saturation",
    "outliers",
)
"""Kinds of two simultaneous effects."""


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(1, 2**31))


def _energy(rng: np.random.Generator, low: float = ENERGY[0], high: float = ENERGY[1]) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _null(number: int, rng: np.random.Generator) -> Case:
    """Numbers run through the cells (length, noise); every second record hides nothing at all."""
    cell = number % (len(SETTINGS) * len(NULL_NOISE))
    duration, Ts = SETTINGS[cell % len(SETTINGS)]
    kind, where, size = ("none", None, None)
    if rng.random() < 0.5:
        kind, where, size = INVISIBLE[int(rng.integers(len(INVISIBLE)))]
        size = float(size * rng.uniform(-1.0, 1.0))
    noise = NULL_NOISE[cell // len(SETTINGS)]
    seed = _seed(rng)
    return Case("nulls", number, "pendulum", kind, where, seed, duration, Ts, noise, size=size)


def _sampled(rng: np.random.Generator) -> tuple[int, float, float, float]:
    """Seed, length, sample time and noise of a pendulum's record."""
    duration, Ts = SETTINGS[int(rng.integers(len(SETTINGS)))]
    noise = float(rng.choice(NOISE))
    return _seed(rng), duration, Ts, noise


def _single(number: int, rng: np.random.Generator) -> Case:
    kind, where = SINGLE[number % len(SINGLE)]
    return Case("single", number, "pendulum", kind, where, *_sampled(rng), _energy(rng))


def _pair(number: int, rng: np.random.Generator) -> Case:
    kind, other = (PAIRED[int(i)] for i in rng.choice(len(PAIRED), 2, replace=False))
    sampled = _sampled(rng)
    energy, second = (_energy(rng, 300.0, ENERGY[1]) for _ in range(2))
    return Case("pairs", number, "pendulum", kind, None, *sampled, energy, second=(other, second))


STRANGE: tuple[str, ...] = (
    "stribeck_friction",
    "bilinear_stiffness",
    "amplitude_damping",
    "parametric_stiffness",
    "hysteresis",
    "knock",
    "clock_drift",
    "jitter",
    "multiplicative_noise",
)
"""Effects that the catalogue has not at all, or is left without."""


ALIKE = (*TIMING, "actuator_lag")
"""Left out together: a timing effect would be named by any of them."""


def _unlisted(number: int, rng: np.random.Generator) -> Case:
    """By turns, an effect that no catalogue has and one whose kind is taken out of it."""
    sampled, energy = _sampled(rng), _energy(rng)
    kind, where = STRANGE[number // 2 % len(STRANGE)], None
    without: tuple[str, ...] = (kind,) if kind in KINDS else ()
    if number % 2:
        kind, where = SINGLE[number // 2 % len(SINGLE)]
        without = ALIKE if kind in TIMING else (kind,)
    return Case("unlisted", number, "pendulum", kind, where, *sampled, energy, without=without)


ROLL = ("none", "quadratic_damping", "cubic_stiffness", "coulomb_friction")


def _roll(number: int, rng: np.random.Generator) -> Case:
    kind = ROLL[number % len(ROLL)]
    return Case("roll", number, "roll", kind, None, _seed(rng), 60.0, 0.02, 0.002, _energy(rng))


SHIP_KINDS = (
    "quadratic_damping",
    "sensor_bias",
    "time_delay",
    "parameter_jump",
    "scheduled_parameter",
)


def _ship(number: int, rng: np.random.Generator) -> Case:
    """Every second record hides nothing."""
    kind = SHIP_KINDS[number // 2 % len(SHIP_KINDS)] if number % 2 else "none"
    duration, noise = float(rng.choice((60.0, 120.0))), float(rng.choice((5e-4, 1e-3, 2e-3)))
    energy = _energy(rng) if number % 2 else 0.0
    return Case("ship", number, "ship", kind, None, _seed(rng), duration, 0.02, noise, energy)


# -- simulating -----------------------------------------------------------------------------------


def _strength(kind: str, energy: float, case: Case) -> float:
    """The rms misfit that has an energy, were the noise white; accelerometer noise takes some.

    What that is, a third of the energy on average, no effect of single samples loses.
    """
    if kind == "outliers":
        return strength_of_outliers(energy, round(case.duration / case.Ts))
    return math.sqrt(1.5 * energy / (FITTED * case.duration / case.Ts))


def _record(columns: Mapping[str, Any], units: Mapping[str, str], name: str) -> casid.Record:
    t = np.asarray(columns["t"], dtype=np.float64)
    names = [n for n in columns if n != "t"]
    return casid.Record(
        {n: np.asarray(columns[n], dtype=np.float64) for n in names},
        {n: units[n] for n in names},
        Ts=float(t[1] - t[0]),
        name=name,
    )


def _hidden_and_sampled(case: Case) -> tuple[str, float, int, float, float, float]:
    """Kind and strength of the hidden effect; seed, duration [s], sample time [s] and noise."""
    strength = _strength(case.kind, case.energy, case)
    return case.kind, strength, case.seed, case.duration, case.Ts, case.noise


def _pendulum(case: Case) -> Hidden:
    from tests.support import truth

    second = None
    if case.second is not None:
        second = (case.second[0], _strength(*case.second, case))
    made = truth.cart_pendulum(
        *_hidden_and_sampled(case),
        case.where,
        second,
        size=case.size,
        jump_within=JUMPS,
        step_grid=case.Ts,
    )
    start = {name: made.truth[name] for name in ("k", "d", "I_x")}
    return _hidden(case, made, ("gyro", "accel"), start)


def _roll_decay(case: Case) -> Hidden:
    from tests.support import truth

    made = truth.roll_decay(*_hidden_and_sampled(case))
    zeta, w = made.truth["zeta"], made.truth["w"]
    start = {"B_1": 2 * zeta * w, "C_1": w**2, "phi_0": made.truth["heel"]}
    return _hidden(case, made, ("phi",), start)


SEARCHES = 3
"""Times that the size of a ship's effect is corrected, at most."""


def _ship_record(case: Case) -> Hidden:
    from analysis.diagnosis_power import ship as of
    from analysis.diagnosis_power.energy import visible_energy

    sd = {"gyro": case.noise, "accel": case.noise, "r": of.R_NOISE}
    name = f"{case.part} {case.number}"
    size = of.PILOT.get(case.kind, 0.0)
    energy = 0.0
    for _ in range(SEARCHES if size else 1):
        made = of.simulate(
            case.kind, size, case.seed, duration=case.duration, Ts=case.Ts, noise=case.noise
        )
        clean = _record(made.quiet, of.UNITS, f"{name}, without noise")
        if not size:
            break
        energy = visible_energy(of.problem(), clean, sd, made.start)
        if 0.8 < energy / case.energy < 1.25:
            break
        size = of.next_size(case.kind, size, energy, case.energy)
    truth = {"size": made.size, "t_jump": made.t_jump}
    return Hidden(
        case,
        _record(made.columns, of.UNITS, name),
        clean,
        sd,
        made.where,
        math.sqrt(energy / (FITTED * clean.N)),
        None,
        (),
        made.start,
        truth,
    )


def _hidden(case: Case, made: Any, sensors: tuple[str, ...], start: Mapping[str, float]) -> Hidden:
    name = f"{case.part} {case.number}"

    def without_noise(signals: Mapping[str, Any], of: str) -> casid.Record:
        return _record({**made.columns, **signals}, made.units, f"{name}, {of}")

    return Hidden(
        case,
        _record(made.columns, made.units, name),
        without_noise(made.quiet, "without noise"),
        dict.fromkeys(sensors, case.noise),
        made.where,
        made.strength,
        made.second,
        tuple(without_noise(signals, "one effect") for signals in made.alone),
        start,
        made.truth,
    )
