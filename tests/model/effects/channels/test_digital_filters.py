"""An output whose samples have passed a digital filter shows a share of every step at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import casid
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.channels.channel_effects import sensor_lag
from casid.model.effects.channels.digital_filters import digital_filter, digital_filters_of
from casid.model.effects.effect import Sizes

TS, N, TAU = 1.0, 800, 2.0
DECAY = np.exp(-TS / 12.0)  # of 0.02 ohm and 600 F


def cell(hold: str = "zoh") -> casid.Model:
    """A pair behind a resistance, over which a step of the current shows at once."""
    m = casid.Model("cell")
    current, v = m.input("I", "A", hold=hold, known=True), m.state("v", "V", initial=0.0)
    R_0 = m.parameter("R_0", "ohm", start=0.02, lower=0.001)
    R_1 = m.parameter("R_1", "ohm", start=0.03, lower=0.001)
    C = m.parameter("C", "A s/V", start=500.0, lower=10.0)
    m.balance(v, "pair", inertia=C, terms=[current, -v / R_1], unit="A")
    m.output("V", m.constant("E", 3.5, "V") - R_0 * current - v, "V")
    return m


def record(noise: float) -> casid.Record:
    """800 samples of 1 s; the filter keeps 2/3 of what it showed, and takes 1/3 of the sample."""
    rng = np.random.default_rng(4)
    current = np.repeat(rng.uniform(-2.0, 5.0, N // 20), 20)
    v, shown = np.zeros(N), np.zeros(N)
    for k in range(N - 1):
        v[k + 1] = DECAY * v[k] + (1 - DECAY) * 0.02 * current[k]
    voltage = 3.5 - 0.03 * current - v
    shown[0] = voltage[0]
    for k in range(1, N):
        shown[k] = shown[k - 1] + TS / (TAU + TS) * (voltage[k] - shown[k - 1])
    shown += noise * rng.standard_normal(N)
    return casid.Record({"I": current, "V": shown}, {"I": "A", "V": "V"}, TS)


VALUES = {"R_0": 0.03, "R_1": 0.02, "C": 600.0, "filter_V": TAU}


def test_the_filter_is_that_of_the_samples_and_its_slope_their_change():
    model = digital_filter(cell(), "V", 10.0).extend(cell(), starts={"filter_V": TAU})
    criterion = SimulationError(model, [casid.Experiment(record(0.0), {}, "r")], substeps=20)
    x = np.array([VALUES.get(n, 0.0) for n in criterion.names])
    at = criterion.simulated(x, 0)
    shown = record(0.0)["V"]
    assert np.max(np.abs(at.y[:, 0] - shown)) < 1e-9
    j, h = criterion.names.index("filter_V"), 1e-4
    moved = [criterion.simulate(x + s * h * np.eye(len(x))[j], 0)[0][:, 0] for s in (1, -1)]
    numeric = (moved[0] - moved[1]) / (2 * h)
    counted = criterion.data[0].used[:, 0] > 0  # the first samples are due to the past
    assert np.sum(counted) == N - 51
    wrong = np.abs(at.jacobian[:, 0, j] - numeric)[counted]
    assert np.max(wrong) < 1e-6 * np.max(np.abs(numeric))


def test_a_filter_is_a_candidate_where_a_held_input_moves_the_output_at_once():
    """Joined by straight lines the output has no steps, and a lag does the same."""
    sizes = Sizes({}, {}, (0.0, N * TS), 5.0)
    assert [e.where for e in digital_filters_of(cell(), sizes)] == ["V"]
    assert not [*digital_filters_of(cell("foh"), sizes)]
    assert not [*digital_filters_of(sensor_lag(cell(), "V", 10.0).extend(cell()), sizes)]


def test_a_filtered_voltage_is_named_and_no_further_store():
    """A lag shows nothing of a step at its sample: without the filter a further store is named."""
    found = casid.diagnose(casid.Problem("cell", cell()), record(1e-3), advise=False)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("sensor_lag", "V")
    assert "digital filter" in cause.description
    (size,) = cause.parameters
    assert size.std_error is not None
    assert abs(size.value - TAU) < 4 * size.std_error < 0.15


def test_a_filter_is_written_to_a_problem_file_and_read_again(tmp_path: Path):
    model = digital_filter(cell(), "V", 10.0).extend(cell(), starts={"filter_V": 1.0})
    found = casid.identify(casid.Problem("cell", model), record(1e-3))
    assert found.parameter("filter_V").value == pytest.approx(TAU, rel=0.05)
    assert found.model is not None
    again = casid.load_problem(found.model.to_problem_file(tmp_path / "cell.py"))
    assert [(s.kind, s.channel) for s in again.model.stages] == [("filter", "V")]
