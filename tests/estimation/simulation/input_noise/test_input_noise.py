"""Noise is drawn on an input where its channel moves, and on none that rests beside moving ones."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.estimation.simulation.input_noise.input_noise import input_noise_sd, with_input_noise

N, SD = 4000, np.array([0.25, 0.5])


def run_and_coast_down() -> SimpleNamespace:
    """Force and wind of two records: under power both move, and coasting the wind alone."""
    rng = np.random.default_rng(3)
    power = rng.standard_normal((N, 2))
    coasting = power * np.array([0.0, 1.0])
    model = SimpleNamespace(inputs={"force": None, "wind": None})
    return SimpleNamespace(model=model, data=[SimpleNamespace(u=u) for u in (power, coasting)])


@pytest.mark.parametrize(("experiment", "own"), [(0, SD), (1, SD * [0.0, 1.0])])
def test_what_rests_in_a_record_has_no_noise_there(experiment: int, own: np.ndarray) -> None:
    criterion = run_and_coast_down()
    np.testing.assert_array_equal(input_noise_sd(criterion.data, experiment, SD), own)


def test_a_draw_is_as_large_as_stated_and_leaves_what_rests_as_it_was() -> None:
    """The standard deviation of N normal samples has a relative error of 1/sqrt(2 N), 1.1 %."""
    criterion = run_and_coast_down()
    u = criterion.data[1].u
    units = {"force": "N", "wind": "m/s"}
    record = casid.Record({"force": u[:, 0], "wind": u[:, 1]}, units, Ts=0.1)
    sd = dict(zip(units, SD.tolist(), strict=True))
    drawn = with_input_noise(record, criterion, 1, sd, np.random.default_rng(5))
    np.testing.assert_array_equal(drawn["force"], record["force"])
    assert np.std(drawn["wind"] - record["wind"]) == pytest.approx(SD[1], rel=4 / np.sqrt(2 * N))
