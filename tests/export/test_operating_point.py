"""Where a fitted model is linearised when nobody says where: at the point its record works at."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import casid
from casid.errors import ModelError

DRAG, MASS, SPEED = 0.4, 1200.0, 25.0


def car() -> casid.Problem:
    """A car against drag, under a force; the angle of its steering swings about zero."""
    m = casid.Model("car")
    v, y = m.state("v", "m/s", start=SPEED), m.state("y", "m")
    F, turn = m.input("F", "N"), m.input("turn", "rad")
    c = m.parameter("c", "kg/m", start=0.3, lower=0.0)
    m.balance(v, "force", inertia=m.constant("M", MASS, "kg"), terms=[F, -c * v**2])
    m.derivative(y, v * turn)
    m.output("speed", v, "km/h")
    m.output("offset", y, "m")
    return casid.Problem("car", m, noise={"speed": 0.1, "offset": 0.01})


def drive(N: int = 400, Ts: float = 0.1) -> casid.Record:
    """It stays between 20 and 30 m/s; Euler steps of 5 ms, which casid has no part in."""
    t = Ts * np.arange(N)
    F = 250.0 + 400.0 * np.sign(np.sin(0.4 * t))
    turn = 0.02 * np.sin(0.7 * t)
    v, y, rows = SPEED, 0.0, []
    for k in range(N):
        rows.append((v, y))
        for _ in range(20):
            v, y = v + Ts / 20 * (F[k] - DRAG * v * v) / MASS, y + Ts / 20 * v * turn[k]
    rng = np.random.default_rng(3)
    speed, offset = np.array(rows).T + rng.standard_normal((2, N)) * [[0.03], [0.01]]
    units = {"F": "N", "turn": "rad", "speed": "m/s", "offset": "m"}
    columns = {"F": F, "turn": turn, "speed": speed, "offset": offset}
    return casid.Record(columns, units, Ts=Ts)


@pytest.fixture(scope="module")
def estimate() -> casid.Estimate:
    return casid.identify(car(), drive(), starts=1)


def test_a_model_is_linearised_where_its_record_works(estimate: casid.Estimate) -> None:
    """What stays away from zero has its mean, what passes through zero is zero."""
    point, c = estimate.model.operating_point, estimate.model.values["c"]
    assert point["v"] == pytest.approx(float(drive()["speed"].mean()), rel=0.01)
    assert point["turn"] == 0.0
    assert point["F"] == 0.0  # brakes and pulls
    system = estimate.model.to_control()
    assert system.A[0, 0] == pytest.approx(-2 * c * point["v"] / MASS, rel=1e-9)
    assert system.B[1, 1] == pytest.approx(point["v"], rel=1e-9)


def test_what_is_named_stands_before_the_record(estimate: casid.Estimate) -> None:
    slow = estimate.model.to_control({"v": 10.0})
    assert slow.B[1, 1] == pytest.approx(10.0, rel=1e-12)
    with pytest.raises(ModelError, match="no state or input 'w'"):
        estimate.model.to_control({"w": 1.0})


def test_the_operating_point_is_kept_with_the_result_and_in_the_file(
    estimate: casid.Estimate, tmp_path: Path
) -> None:
    kept = casid.load(estimate.save(tmp_path / "car.casid")).model
    assert kept.operating_point == estimate.model.operating_point
    assert np.array_equal(kept.to_control().A, estimate.model.to_control().A)
    from casid.export.targets import export

    text = export(kept, "control", tmp_path / "car.py").read_text()
    assert f"linearised at v = {kept.operating_point['v']:g} m/s; matrices in SI" in text


def test_a_model_with_noise_in_it_has_one_too() -> None:
    """Of a prediction-error fit the states are those of a simulation."""
    found = casid.identify(car(), drive(), disturbances=["force"], starts=1)
    point = found.model.operating_point
    assert point["v"] == pytest.approx(float(drive()["speed"].mean()), rel=0.02)
    A = found.model.without_noise().to_control().A
    assert A[0, 0] == pytest.approx(-2 * found.model.values["c"] * point["v"] / MASS, rel=1e-9)
