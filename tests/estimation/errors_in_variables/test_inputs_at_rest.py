"""A record in which an input rests beside records in which it is noisy: a coast-down."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import casid
from casid.estimation.noise.input_noise_floor import input_noise_floor
from casid.estimation.noise.noise_response import noise_response
from casid.estimation.simulation.fit import FitSettings, fit_model

FORCE, SPEED = 15.0, 0.03
"""Standard deviations of the noise of the force cell [N] and of the speed [m/s]."""


def car() -> casid.Model:
    m = casid.Model("car")
    v, F = m.state("v", "m/s"), m.input("F", "N")
    M = m.parameter("M", "kg", start=1500.0, lower=100.0)
    b = m.parameter("b", "N s/m", start=20.0, lower=0.0)
    m.balance(v, "force", inertia=M, terms=[F, -b * v])
    m.output("v", v, "m/s")
    return m


def run(seed: int, *, is_driven: bool) -> casid.Record:
    """Two minutes at 10 Hz, the exact solution between forces joined by straight lines."""
    rng = np.random.default_rng(seed)
    N, Ts, M, b = 1200, 0.1, 1600.0, 15.0
    smooth = np.hanning(40) / np.hanning(40).sum()
    F = is_driven * np.convolve(np.repeat(rng.uniform(-500, 1500, N // 60), 60), smooth, "same")
    v, e = np.full(N, 20.0), np.exp(-b / M * Ts)
    for k in range(N - 1):  # a ramp of slope s leaves v = F/b - s M/b^2 behind it
        s = (F[k + 1] - F[k]) / Ts
        at, end = F[k] / b - s * M / b**2, F[k + 1] / b - s * M / b**2
        v[k + 1] = end + (v[k] - at) * e
    read = F + is_driven * FORCE * rng.standard_normal(N)
    columns = {"F": read, "v": v + SPEED * rng.standard_normal(N)}
    return casid.Record(columns, {"F": "N", "v": "m/s"}, Ts, name=f"run {seed}")


def runs(seed: int) -> list[casid.Record]:
    """Two runs under power, and a coast-down between them."""
    return [run(3 * seed + k, is_driven=k != 1) for k in range(3)]


@cache
def estimate(seed: int) -> casid.Estimate:
    return casid.identify(casid.Problem("car", car(), starts=1), runs(seed), intervals="quick")


def test_the_noise_of_an_input_is_that_of_the_records_in_which_it_moves() -> None:
    """Where it rests the channel is exact, and the response of the outputs to its noise is zero."""
    fit = fit_model(car(), [casid.Experiment(r) for r in runs(1)], FitSettings(starts=1))
    data = fit.criterion.data
    floor = input_noise_floor(data, ["F"])["F"]
    assert floor == pytest.approx(FORCE, rel=0.1)
    assert input_noise_floor(data[1:2], ["F"])["F"] == 0.0
    gains = [noise_response(fit.criterion, fit.x, e).gain2[:, :, 0] for e in range(3)]
    assert np.all(gains[1] == 0.0)
    assert np.all(gains[0] > 0.0)


def test_errors_count_the_noise_of_a_force_that_rests_in_one_of_the_records() -> None:
    """Noise of the force is a slow residual behind the mass: white errors would be far too small.

    Of 8 x 2 normal errors over their standard errors the mean square is above 2.2 once in 300.
    """
    squares = []
    for found in map(estimate, range(8)):
        assert found.method.endswith("without the bias of input noise")
        for name, true in (("M", 1600.0), ("b", 15.0)):
            squares.append(((found[name] - true) / found.parameter(name).std_error) ** 2)
    assert np.mean(squares) < 2.2


def test_records_agree_whose_residuals_the_noise_of_an_input_makes_slow() -> None:
    """What one record differs by is compared with the errors under the noise that was found."""
    for found in map(estimate, range(8)):
        assert not [text for text in found.warnings if "disagree" in text]
