"""A fit leaves a model that knows its values, its records and what was added to it."""

from __future__ import annotations

import numpy as np
import pytest

import casid

TS = 0.02


def oscillator() -> casid.Model:
    m = casid.Model("mass on a spring")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    force = m.input("force", "N", hold="zoh", known=True)
    d = m.parameter("d", "N s/m", start=1.0, lower=0.0)
    k = m.parameter("k", "N/m", start=40.0, lower=0.0)
    mass = m.constant("m", 2.0, "kg")
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[-k * x, -d * v, force])
    m.output("position", x, "m")
    return m


def record(*, seed: int = 3, N: int = 400, k: float = 50.0, name: str = "run") -> casid.Record:
    """Steps of force on 2 kg, 1.5 N s/m and `k`, stepped by Euler's method at 0.1 ms."""
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.normal(0.0, 4.0, N // 25 + 1), 25)[:N]
    x, v, position = 0.05, -0.1, np.empty(N)
    for i in range(N):
        position[i] = x
        for _ in range(200):
            v += TS / 200 * (force[i] - k * x - 1.5 * v) / 2.0
            x += TS / 200 * v
    position += 1e-3 * rng.normal(size=N)
    units = {"force": "N", "position": "m"}
    return casid.Record({"force": force, "position": position}, units, Ts=TS, name=name)


@pytest.fixture(scope="module")
def estimate() -> casid.Estimate:
    problem = casid.Problem("oscillator", oscillator(), {"position": "x_mm:mm"}, starts=1)
    return casid.identify(problem, record())


def test_every_parameter_of_the_fitted_model_has_its_estimated_value(estimate):
    fitted = estimate.model
    assert all(p.is_known for p in fitted.model.parameters.values())
    assert fitted.values == {n: estimate[n] for n in ("d", "k", "m")}
    assert fitted.initial_states == {n: estimate[f"{n}(0)"] for n in ("x", "v")}
    assert fitted.Ts == TS
    assert fitted.covariance_names == ("d", "k", "x(0)", "v(0)")
    assert np.array_equal(fitted.covariance, estimate.covariance)
    assert fitted.channels.columns == {"position": "x_mm:mm"}


def test_a_record_keeps_the_values_that_hold_in_it_alone():
    """Two springs, one mass: each record has its own stiffness, and the model their mean."""
    records = [record(k=50.0, name="soft"), record(k=60.0, name="stiff", seed=4)]
    problem = casid.Problem("oscillator", oscillator(), starts=1)
    fitted = casid.identify(problem, records, settings=casid.FitSettings(starts=1, own=["k"])).model
    soft, stiff = (r.known["k"] for r in fitted.records)
    assert (soft, stiff) == pytest.approx((50.0, 60.0), rel=0.01)
    assert fitted.values["k"] == pytest.approx((soft + stiff) / 2)
