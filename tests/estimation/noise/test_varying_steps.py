"""Steps of a simulation from noise on: what sensors and actuators do to it."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.estimation.noise.noise_response import noise_response
from casid.estimation.noise.varying_steps import steps_along
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.channels.channel_effects import sensor_lag
from tests.support import cooled_jacket as jacket


@pytest.mark.parametrize("lag", [5.0, 75.0, 400.0])
def test_a_force_passes_a_sensor_that_lags_as_in_the_frequency_response(lag: float):
    """At a flow that stays: a straight line in each sample is all that the steps know of more."""
    effect = sensor_lag(jacket.model(), "T", 1000.0)
    model, names = effect.extended(jacket.model())
    record = jacket.record(0)
    still = {n: np.full_like(v, v.mean()) for n, v in record.channels.items() if n != "T"}
    still = casid.Record({**record.channels, **still}, record.units, Ts=jacket.TS)
    criterion = SimulationError(model, [casid.Experiment(still, {}, "r")])
    x = criterion.start.copy()
    x[criterion.names.index(names[0])] = lag
    expected = noise_response(criterion, x, 0)
    steps = steps_along(criterion, x, 0)
    k, source = 500, steps.sources.index("heat")
    slow = expected.omega < 0.5  # rad/sample
    z = np.exp(1j * expected.omega[slow])[:, None, None]
    entering = steps.b0[k][:, [source]] + z * steps.b1[k][:, [source]]
    found = steps.c[k] @ np.linalg.solve(z * np.eye(2) - steps.a[k], entering)
    found = found[:, 0, 0] + steps.d[k][0, source]
    assert expected.gain is not None
    assert found == pytest.approx(expected.gain[slow, 0, source], rel=0.02)
