"""Several outputs count in units of the errors that they leave: the maximum of the likelihood."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.estimation.simulation.fit import FitSettings, fit_model

M, B, TS, N = 2.0, 0.5, 0.05, 800
NOISE = {"position": 1e-4, "speed": 0.05}  # of 1e-5 and 5 % of the motion


def carriage() -> casid.Model:
    m = casid.Model("carriage")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold="zoh", known=True)
    mass = m.parameter("M", "kg", start=1.5, lower=0.1)
    drag = m.parameter("b", "N s/m", start=0.8, lower=0.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[F, -drag * v])
    m.output("position", x, "m")
    m.output("speed", v, "m/s")
    return m


def record(seed: int) -> casid.Record:
    """Sampled exactly: the force is held."""
    rng = np.random.default_rng(seed)
    F = np.repeat(2 * rng.standard_normal(N // 20), 20)
    step = expm(TS * np.array([[0, 1, 0], [0, -B / M, 1 / M], [0, 0, 0]]))
    states, z = np.empty((N, 2)), np.zeros(2)
    for t in range(N):
        states[t] = z
        z = (step @ np.append(z, F[t]))[:2]
    noise = rng.standard_normal((N, 2)) * list(NOISE.values())
    x, v = (states + noise).T
    units = {"F": "N", "position": "m", "speed": "m/s"}
    return casid.Record({"F": F, "position": x, "speed": v}, units, Ts=TS, name=f"run {seed}")


def test_the_noise_of_one_output_does_not_hide_what_another_one_shows() -> None:
    """The estimate and its errors are those under the true noise, which is not known to it.

    Of 800 samples an rms error is uncertain by 2.5 %, a weight that is settled by 5 %: it moves an
    estimate by a part of that, which the errors of 1e-4 and 0.05 leave to the position alone.
    """
    run = record(3)
    estimate = casid.identify(casid.Problem("carriage", carriage(), starts=1), run)
    weights = 1 / np.array(list(NOISE.values()))
    experiment = casid.Experiment(run, {}, "run")
    best = fit_model(carriage(), [experiment], FitSettings(starts=1), weights=weights)
    info = np.linalg.inv(best.solution.hessian)
    for i, name in enumerate(best.criterion.names[:2]):
        row = estimate.parameter(name)
        assert row.std_error == pytest.approx(np.sqrt(info[i, i]), rel=0.3)
        assert row.value == pytest.approx(best.values[name], abs=0.1 * np.sqrt(info[i, i]))
    assert estimate.rmse["run 3"]["position"] == pytest.approx(1e-4, rel=0.1)
    assert not estimate.fit.coloured


@pytest.mark.slow
def test_estimates_scatter_as_their_errors_say() -> None:
    z = []
    for seed in range(30):
        problem = casid.Problem("carriage", carriage(), starts=1)
        found = casid.identify(problem, record(seed), intervals="quick")
        z.append([(found[n] - t) / found.parameter(n).std_error for n, t in (("M", M), ("b", B))])
    # The mean of 30 has a standard deviation of 0.18, the variance of 30 one of 0.26.
    assert np.all(np.abs(np.mean(z, axis=0)) < 3 * 0.18)
    assert np.all(np.abs(np.var(z, axis=0) - 1) < 3 * 0.26)


def test_the_start_that_is_shown_is_that_of_the_search() -> None:
    found = casid.identify(casid.Problem("carriage", carriage(), starts=1), record(1))
    assert (found.parameter("M").start, found.parameter("b").start) == (1.5, 0.8)
