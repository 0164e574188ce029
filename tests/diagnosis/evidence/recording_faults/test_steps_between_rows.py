"""Doses that begin and end between the rows of their record, at instants that it does not have.

The truth is one compartment, V dc/dt = rate - CL c, in forty steps of Euler between two rows.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.recording_faults.steps_between_rows import steps_between_rows
from casid.estimation.simulation.fit import FitSettings, fit_model

V, CL, TS, N = 10.0, 8.0, 0.1, 400  # L, L/h, h
NOISE = 0.02  # mg/L
ALPHA = 0.001

Early = Callable[[np.random.Generator], float]
Slope = Callable[[float, float, float], float]  # of c, rate and time [h]


def compartment(c: float, rate: float, t: float) -> float:
    return (rate - CL * c) / V


def saturable(c: float, rate: float, t: float) -> float:
    return (rate - 14.0 * c / (1 + c / 5.0)) / V


def with_a_jump(c: float, rate: float, t: float) -> float:
    return (rate - CL * c * (1.0 if t < 20.0 else 1.5)) / V


def with_a_tide(c: float, rate: float, t: float) -> float:
    return (rate * (1 + 0.3 * np.sin(t)) - CL * c) / V


def record(early: Early, slope: Slope = compartment, seed: int = 1) -> casid.Record:
    """Ten infusions of an hour, each edge `early` of an interval before its row."""
    rng = np.random.default_rng(seed)
    edges = np.array([s + d for s in np.arange(1.0, 38.0, 4.0) for d in (0.0, 1.0)])
    edges = edges - TS * np.array([early(rng) for _ in edges])
    rates = np.array([x for _ in range(10) for x in (100.0 + 10 * rng.integers(-3, 4), 0.0)])

    def rate(t: float) -> float:
        place = int(np.searchsorted(edges, t + 1e-9, side="right"))
        return float(rates[place - 1]) if place else 0.0

    c, h = np.zeros(N), TS / 40
    for k in range(N - 1):
        x = c[k]
        for j in range(40):
            t = k * TS + j * h
            x += h * slope(x, rate(t + 0.5 * h), t)
        c[k + 1] = x
    read = {"rate": np.array([rate(k * TS) for k in range(N)]) * 1e-6 / 3600}
    read["c"] = (c + NOISE * rng.standard_normal(N)) * 1e-3
    return casid.Record(read, {"rate": "kg/s", "c": "kg/m^3"}, Ts=TS * 3600)


def problem() -> casid.Problem:
    m = casid.Model("one compartment")
    c, rate = m.state("x", "mg/L"), m.input("rate", "mg/h", hold="zoh", known=True)
    volume = m.parameter("V", "L", start=8.0, lower=1.0, upper=100.0)
    clearance = m.parameter("CL", "L/h", start=5.0, lower=0.01, upper=50.0)
    m.balance(c, "plasma", inertia=volume, terms=[rate, -clearance * c])
    m.output("c", c, "mg/L")
    return casid.Problem("plasma", m)


def at_random(rng: np.random.Generator) -> float:
    return float(rng.uniform(0.0, 1.0))


def found_in(read: casid.Record):
    settings = FitSettings(starts=1)
    return steps_between_rows(
        fit_model(problem().model, [casid.Experiment(read)], settings, throw=False), ALPHA
    )


@pytest.mark.parametrize("seed", range(3))
def test_doses_between_the_rows_are_found_with_how_early_each_came(seed: int) -> None:
    """Of 100 mg/h in 10 L an interval gives 1 mg/L: the noise of 0.02 leaves a share to 0.03."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0.0, 1.0, 20)
    shares = iter(truth)
    found = found_in(record(lambda _: next(shares), seed=seed))
    assert found is not None
    assert found.channel == "rate"
    assert found.explained > 0.95
    assert np.abs(found.shares - truth).max() < 0.1


@pytest.mark.parametrize(
    ("early", "slope"),
    [
        (lambda _: 0.0, compartment),  # at the rows
        (lambda _: 0.5, compartment),  # all alike: another hold, or a delay
        (lambda _: 0.0, saturable),
        (lambda _: 0.0, with_a_jump),
        (lambda _: 0.0, with_a_tide),
    ],
)
def test_no_other_misfit_passes_for_doses_between_the_rows(early: Early, slope: Slope) -> None:
    for seed in range(3):
        assert found_in(record(early, slope, seed)) is None


@pytest.mark.slow
def test_a_diagnosis_names_the_doses_between_the_rows_and_how_to_record_them() -> None:
    found = casid.diagnose(problem(), record(at_random), advise=False, max_causes=1)
    (note,) = [text for text in found.notes if "steps of rate came between its rows" in text]
    assert "rows of their own" in note
