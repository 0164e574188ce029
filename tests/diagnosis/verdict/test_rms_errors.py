"""The RMS errors that a diagnosis reports count what a model can tell."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.verdict.gain import rmse
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import fit_model
from casid.model.effects.channels.channel_effects import sensor_lag

TS, N, TIME, LAG, NOISE = 0.1, 600, 2.0, 0.8, 0.01


def test_what_a_lagging_sensor_owes_to_inputs_before_the_record_is_no_error():
    """x' = (u - x) / T and T_s w' = x - w from rest under u = 1:

    w = 1 - (T exp(-t/T) - T_s exp(-t/T_s)) / (T - T_s). That the sensor was at rest before, no
    sample says: a motion that went on before would have it at -T_s / T.
    """
    m = casid.Model("tank")
    x, u = m.state("x", "m"), m.input("u", "m", hold="zoh", known=True)
    m.derivative(x, (u - x) / m.parameter("T", "s", start=1.5, lower=0.1, upper=10.0))
    m.output("y", x, "m")
    t = TS * np.arange(N)

    def risen(since: float) -> np.ndarray:
        s = np.maximum(t - since, 0.0)
        return 1 - (TIME * np.exp(-s / TIME) - LAG * np.exp(-s / LAG)) / (TIME - LAG)

    held = np.where(t < 29.95, 1.0, 0.0)
    y = risen(0.0) - risen(30.0) + NOISE * np.random.default_rng(1).standard_normal(N)
    record = casid.Record({"u": held, "y": y}, {"u": "m", "y": "m"}, Ts=TS)
    split = split_records([casid.Experiment(record)], 0.0)
    model = m.extend(sensor_lag(m, "y", 2.0))
    fit = fit_model(model, split.fitted, casid.FitSettings(starts=1), throw=False)
    assert fit.values["lag_y"] == pytest.approx(LAG, abs=0.05)
    # 500 samples count: the standard deviation of an RMS is 3 %.
    assert rmse(fit, fit, split, {}, held=False)["y"] == pytest.approx(NOISE, rel=0.13)


def test_an_output_that_is_not_measured_where_it_would_be_held_out_has_no_error_there():
    """Two sensors of one tank, x' = (u - x) / T, the second dead before the held-out part."""
    m = casid.Model("tank")
    x, u = m.state("x", "m"), m.input("u", "m", hold="zoh", known=True)
    m.derivative(x, (u - x) / m.parameter("T", "s", start=1.5, lower=0.1, upper=10.0))
    m.output("y", x, "m")
    m.output("z", x, "m")
    t, rng = TS * np.arange(N), np.random.default_rng(2)
    risen = 1 - np.exp(-t / TIME)
    y, z = (risen + NOISE * rng.standard_normal(N) for _ in range(2))
    columns = {"u": np.ones(N), "y": y, "z": z}
    dead = {"z": np.arange(N) >= int(0.6 * N)}
    record = casid.Record(columns, dict.fromkeys(columns, "m"), Ts=TS, missing=dead)
    split = split_records([casid.Experiment(record)], 0.3)
    fit = fit_model(m, split.fitted, casid.FitSettings(starts=1), throw=False)
    assert set(rmse(fit, fit, split, {}, held=False)) == {"y", "z"}
    # 180 samples are held out: the standard deviation of an RMS is 5 %.
    assert rmse(fit, fit, split, {}, held=True) == pytest.approx({"y": NOISE}, rel=0.2)
