"""What noise on a measured input gives to a score is taken off it, also where a law has a kink."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.signal import lsim

import casid
from casid.diagnosis.evidence.scores.score_tests import score_test
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.declarations import Parameter
from casid.model.effects.effect import Effect

TS, N, RATE, NOISE, SMALL = 0.05, 1200, 4.0, 0.1, 0.002  # s, 1, 1/s, m, m
RECORDS = 24


def lag() -> casid.Model:
    m = casid.Model("a lag")
    x, u = m.state("x", "m"), m.input("u", "m", hold="foh")
    m.derivative(x, m.parameter("rate", "1/s", start=3.0, lower=0.1, upper=20.0) * (u - x))
    m.output("y", x, "m")
    return m


def record(seed: int) -> casid.Record:
    """An input that rests for three quarters of the time, and is recorded with noise."""
    rng = np.random.default_rng([7, seed])
    t = TS * np.arange(N)
    u = np.where(t % 12.0 > 9.0, np.sin(2 * np.pi * t / 1.5), 0.0)
    _, y, _ = lsim(([RATE], [1.0, RATE]), u, t)
    channels = {"u": u + NOISE * rng.standard_normal(N), "y": y + 0.01 * rng.standard_normal(N)}
    return casid.Record(channels, {"u": "m", "y": "m"}, Ts=TS)


def law(shape: str) -> Effect:
    """Of the input: its sign, which has a kink where it rests, or its cube."""
    unit = {"sign": "m/s", "cube": "1/(m^2 s)"}[shape]

    def apply(model: casid.Model, names: tuple[str, ...]) -> None:
        u = model.symbol("u")
        of = ca.tanh(u / SMALL) if shape == "sign" else u**3
        model.add_rate("x", -model.symbol(names[0]) * of)

    return Effect("unknown", "x", (Parameter("c", unit, 0.0),), apply, shape=shape)


@pytest.mark.parametrize("shape", ["sign", "cube"])
def test_the_score_of_what_is_not_there_has_no_mean(shape: str) -> None:
    """Of RECORDS scores of unit variance the mean is within three standard deviations of zero.

    A whole draw of noise beside that of the record shows 1/sqrt(2) of what it gives to the sign.
    """
    scores = []
    for seed in range(RECORDS):
        fit = fit_model(lag(), [casid.Experiment(record(seed))], FitSettings(starts=1))
        table = score_test(fit, [law(shape)], input_sd={"u": NOISE}, draws=50, seed=seed)
        scores.append(table.scores[0].z)
    assert abs(np.mean(scores)) < 3 / np.sqrt(RECORDS)
