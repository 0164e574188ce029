"""One disturbance in several balances, as the diagnosis tells it and draws it anew."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

import casid
from casid.diagnosis.advice.recommendation import disturbance_advice
from casid.diagnosis.calibration.null_records import NullRecords, Recipe, null_noise
from casid.diagnosis.evidence.disturbances import Disturbance, Ratio, disturbances_of, shown_source
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model

TS, C, G, BETWEEN = 300.0, (3e6, 2e6), (80.0, 60.0), 50.0
PEOPLE, RATIO, SD = 150.0, 0.6, 0.02


def rooms() -> casid.Model:
    m = casid.Model("two zones")
    P = [m.input(f"P_{i}", "W", hold="zoh") for i in (1, 2)]
    T = [m.state(f"T_{i}", "K") for i in (1, 2)]
    between = m.constant("G_12", BETWEEN, "W/K")
    for i in (0, 1):
        c = m.parameter(f"C_{i + 1}", "MJ/K", start=2.0, lower=0.1, upper=100)
        g = m.parameter(f"G_{i + 1}", "W/K", start=50, lower=1, upper=1000)
        terms = [P[i], -g * T[i], -between * (T[i] - T[1 - i])]
        m.balance(T[i], f"zone {i + 1}", inertia=c, terms=terms, unit=("W", "kW")[i])
        m.output(f"room_{i + 1}", T[i], "K")
    return m


def record(seed: int, N: int = 700) -> casid.Record:
    """Heating steps in two rooms, and people in both; exactly between thirds of a sample."""
    rng, n = np.random.default_rng(seed), 3 * N
    P = [np.repeat(rng.random(N // p + 1) * 2000, 3 * p)[:n] for p in (12, 9)]
    pole = np.exp(-TS / 3 / 9000)
    people = lfilter([1.0], [1.0, -pole], rng.standard_normal(n + 900) * np.sqrt(1 - pole**2))[900:]
    a = np.zeros((4, 4))
    a[:2, :2] = [
        [-(G[0] + BETWEEN) / C[0], BETWEEN / C[0]],
        [BETWEEN / C[1], -(G[1] + BETWEEN) / C[1]],
    ]
    a[0, 2], a[1, 3] = 1 / C[0], 1 / C[1]
    step = expm(a * TS / 3)
    x, rows = np.zeros(2), []
    for k in range(n):
        rows.append(x)
        heat = [P[0][k] + PEOPLE * people[k], P[1][k] + RATIO * PEOPLE * people[k]]
        x = step[:2, :2] @ x + step[:2, 2:] @ heat
    y = np.array(rows)[::3] + SD * rng.standard_normal((N, 2))
    channels = {"P_1": P[0][::3], "P_2": P[1][::3], "room_1": y[:, 0], "room_2": y[:, 1]}
    units = {"P_1": "W", "P_2": "W", "room_1": "K", "room_2": "K"}
    return casid.Record(channels, units, Ts=TS)


@pytest.fixture(scope="module")
def found() -> Weighted:
    experiments = [casid.Experiment(record(1), {}, "rooms")]
    fit = fit_model(rooms(), experiments, FitSettings(starts=1))
    return Weighing(experiments).with_disturbances().estimated(fit)


def test_it_is_told_with_its_ratio_in_the_units_of_its_balances(found: Weighted) -> None:
    (d,) = disturbances_of(found, 0.01)
    assert (d.where, d.unit, d.place) == ("zone 1", "W", "zone 1 and zone 2")
    assert d.std == pytest.approx(PEOPLE, rel=0.3)
    (also,) = d.also
    assert (also.where, also.unit) == ("zone 2", "kW/W")
    assert also.value == pytest.approx(1e-3 * RATIO, abs=3 * also.std_error)
    assert also.std_error < 2e-4
    assert "one unrecorded random disturbance acts on zone 1 and zone 2 together" in d.sentence
    assert "zone 2 at a ratio of" in d.sentence
    told = json.loads(json.dumps(d.to_json()))
    assert told["where"] == "zone 1"
    assert told["also"][0].keys() == {"where", "value", "std_error", "unit"}
    (source,) = found.full.spectra
    assert shown_source(found.model, found.full, source, 2.0) == (2.0, "W")
    # `identify` has no disturbance in two places, and none is advised.
    advice = disturbance_advice(found.model, d)
    assert "what acts on zone 1 and zone 2 and record it" in advice
    assert "--disturbance" not in advice


def test_a_ratio_without_a_unit_is_told_without_one() -> None:
    d = Disturbance("a", 2.0, "N", 0.5, also=(Ratio("b", -0.5, 0.02, "1"),))
    assert "2 N in a, b at a ratio of -0.5 +- 0.02, flat spectrum" in d.sentence
    assert dataclasses.replace(d, also=()).sentence.startswith("an unrecorded")


def test_null_records_have_it_in_both_places(found: Weighted) -> None:
    """Of many draws the mean square about the simulation, and the coherence, are those found."""
    fit = found.fit
    split = split_records(fit.criterion.experiments, 0.0)
    noise = null_noise(found.full, fit.criterion.outputs, {})
    drawn = NullRecords(found.model, Recipe.of(split, fit.criterion, fit.values, noise))
    clean, rng, moments = fit.criterion.simulated(fit.x, 0).y, np.random.default_rng(5), []
    for _ in range(30):
        (e,), _ = drawn.draw(rng)
        moved = np.column_stack([e.record[name] for name in found.model.outputs]) - clean
        moments.append(moved.T @ moved / len(moved))
    matrix, omega = found.full.matrix(0).real, found.full.responses[0].omega
    expected = np.trapezoid(matrix, omega, axis=0) / np.pi
    error = np.std(moments, axis=0) / np.sqrt(len(moments))
    mean = np.mean(moments, axis=0)
    assert np.all(abs(mean - expected) < 4 * error + 0.15 * abs(expected)), (mean, expected, error)
    assert mean[0, 1] > 0.8 * np.sqrt(mean[0, 0] * mean[1, 1])


@pytest.mark.slow
def test_people_in_both_rooms_are_one_disturbance_and_no_cause() -> None:
    channels = {n: n for n in ("P_1", "P_2", "room_1", "room_2")}
    problem = casid.Problem("rooms", rooms(), channels=channels)
    d = casid.diagnose(problem, casid.Experiment(record(2), {}, "rooms"), starts=1)
    (people,) = d.disturbances
    assert people.place == "zone 1 and zone 2"
    assert 1e3 * people.also[0].value == pytest.approx(RATIO, abs=0.15)
    assert d.verdict == "adequate"
    assert d.noise["zone 1 and zone 2"].startswith("random disturbance")
