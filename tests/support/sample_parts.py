"""Parts of made-up diagnoses: what is undetectable, what is unknown, what to record next."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from casid.diagnosis.advice.isolability import Isolability, Pair, separation_energy
from casid.diagnosis.advice.next_experiment import Proposal
from casid.diagnosis.advice.undetectable import Undetectable
from casid.diagnosis.calibration.calibration import Calibration
from casid.diagnosis.evidence.disturbances import Disturbance
from casid.diagnosis.evidence.residual.residual_tests import DETERMINISTIC, Band, ResidualTests
from casid.diagnosis.unexplained.description import Occurrence, Unexplained
from casid.diagnosis.unexplained.missing_force import Dependence, MissingForce
from casid.diagnosis.unexplained.smoothed_force import ForceSeries, ForceSpectrum, SmoothedForce
from casid.estimation.estimate import RecordView

KEYS = (
    ("quadratic_damping", "torque"),
    ("coulomb_friction", "torque"),
    ("cubic_stiffness", "torque"),
    ("time_delay", "gyro"),
    ("sensor_lag", "gyro"),
    ("parameter_drift", "k"),
    ("parameter_jump", "d"),
    ("offset", "torque"),
    ("sensor_bias", "gyro"),
    ("unknown", "torque~v^3"),
    ("cross_axis", "gyro~accel"),
    ("scheduled_parameter", "d~speed"),
)


@cache
def isolability(keys: tuple[tuple[str, str], ...] = KEYS) -> Isolability:
    """Angles drawn at random; delay and lag of the gyro are the same thing."""
    rng = np.random.default_rng(5)
    a = rng.standard_normal((len(keys), 6))
    if len(keys) > 4:
        a[1] = a[0] + 0.5 * a[1]
        a[4] = a[3] + 0.01 * a[4]
    a /= np.linalg.norm(a, axis=1)[:, None]
    c = np.clip(a @ a.T, -1.0, 1.0)
    pairs = [
        Pair(keys[j], keys[i], float(c[i, j]), separation_energy(float(c[i, j])))
        for i in range(len(keys))
        for j in range(i)
    ]
    pairs.sort(key=lambda p: -abs(p.cosine))
    groups = ((keys[3], keys[4]),) if len(keys) > 4 else ()
    return Isolability(keys, c, tuple(pairs), groups, undetectable=(("sensor_scale", "gyro"),))


def undetectable(kind: str = "sensor_scale", where: str = "gyro") -> tuple[Undetectable, ...]:
    """One cause that no record shows, one that this record does not."""
    return (
        Undetectable(
            kind,
            where,
            "structural",
            1e-15,
            ("s", "I"),
            ("s/I",),
            "Whatever is recorded, changes of s and I together give the same outputs; "
            "identifiable all the same: s/I.",
            "Give one of s, I a known value, or calibrate gyro apart from these records.",
        ),
        Undetectable(
            "scheduled_parameter",
            where,
            "practical",
            3e-5,
            why="In this record the model's own parameters do 99.99 % of what it does.",
            remedy="Record speed while it moves: it is constant in swing-07.",
        ),
    )


def proposals(first: tuple[str, str] = KEYS[0]) -> tuple[Proposal, ...]:
    """Two experiments that tell the tied causes apart, and the same one again, which does not."""
    pair = (first, KEYS[1])
    inf = float("inf")
    return (
        Proposal(
            "free decay",
            "let it decay from 1 rad, with the cart at rest",
            pair,
            0.42,
            separation_energy(0.42),
            31.0,
            8.4,
            60.0,
        ),
        Proposal(
            "twice the amplitude",
            "move the cart as in swing-07, but twice as far",
            pair,
            0.88,
            separation_energy(0.88),
            240.0,
            1.9,
            120.0,
        ),
        Proposal("the same again", "record the same again", pair, 1.0, inf, inf, 0.0, 120.0),
    )


def disturbances() -> tuple[Disturbance, ...]:
    """A narrow one, a slow one and one with a flat spectrum."""
    return (
        Disturbance("torque", 0.021, "N m", 0.31, peak=1.4, bandwidth=0.2),
        Disturbance("force", 3.2, "N", 0.12, peak=0.1, bandwidth=0.4),
        Disturbance("power", 40.0, "W", 0.05),
    )


def calibration(problem: str = "pendulum") -> Calibration:
    """Twelve false alarms in 120 null records at 5 %: the threshold is corrected."""
    rng = np.random.default_rng(7)
    smallest = rng.uniform(size=120) ** 1.3
    levels = np.where(smallest < 0.05, smallest, np.maximum(smallest, 0.05))
    return Calibration(problem, 0.05, 120, levels, smallest, smallest < 0.05, undecided=1)


def unexplained(
    v: RecordView, place: str = "torque", variable: str = "p", unit: str = "N m"
) -> Unexplained:
    """A missing torque of 0.064 p^3, over time and as a function of p, with its errors."""
    p = v.x[:, 1]
    force = 0.064 * p**3
    rng = np.random.default_rng(11)
    series = ForceSeries(v.name, v.t, force + 0.01 * rng.standard_normal(p.size), 0 * p + 0.012)
    f = np.geomspace(0.05, 20, 60)
    floor = 1e-4 * (1 + f**2)
    density = 3e-3 / (1 + (f / 0.8) ** 4) + floor * 0.2 * rng.standard_normal(f.size)
    spectrum = ForceSpectrum(f, density, floor, 0.3 * floor, None, 0.4)
    at = np.linspace(-1.6, 1.6, 9)
    term = Dependence(
        variables=(variable,),
        share=0.93,
        p_value=2e-14,
        gain=160.0,
        parity="odd",
        power=3.0,
        size=0.064,
        growth="growing about as the cube",
        rivals=(),
        at=at,
        value=0.064 * at**3 + 0.004 * rng.standard_normal(at.size),
        sd=np.full(at.size, 0.008),
    )
    best = MissingForce(
        place=place,
        unit=unit,
        is_balance=True,
        units={variable: "rad/s"},
        misfit=172.0,
        misfit_sd=9.0,
        explained=0.93,
        score=148.0,
        dependences=(term,),
        independent_of=("phi", "accel"),
        over_time=SmoothedForce((series,), spectrum, 2e-3, 0.4, 71.0, 0.81),
    )
    tests = ResidualTests(
        verdict=DETERMINISTIC,
        p_spectrum=3e-5,
        p_dependence=1e-12,
        p_time=0.4,
        adjusted=3e-12,
        bands=(Band("gyro", 0.3, 0.8, 4.1, 1e-9), Band("gyro", 0.8, 2.0, 1.1, 0.3)),
        correlated=None,
        blocks=np.array([[0.0, 60.0, 1.0], [60.0, 120.0, 1.4]]),
        innovation_blocks=np.array([[0.0, 60.0, 1.0], [60.0, 120.0, 1.4]]),
        p_mean=0.7,
        p_power=0.4,
        p_amplitude=0.03,
    )
    return Unexplained(
        where=place,
        places=(best, replace(best, place="gyro", is_balance=False, explained=0.31, score=40.0)),
        tests=tests,
        sentences=(
            f"The remainder is a missing term in the {place} balance that depends on {variable} "
            "(odd, growing about as the cube). This explains 93 % of it.",
            "It does not depend on phi, accel.",
        ),
        occurrences=(Occurrence(v.name, 25.0, 31.0, 3.4),),
        goes_with=((variable, 0.7),),
        signals=({variable: p, "phi": v.x[:, 0]},),
    )
