"""A held input that steps in lost rows did so where the outputs behind them show.

The truth is a coil of 40 ms, sampled at 50 ms, by its exact recursion; where the command steps rows
are lost, of command and current alike.
"""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.data.record import Record
from casid.diagnosis.evidence.steps_in_gaps import with_steps_in_gaps
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.input_gaps import with_gaps_treated

TS, N = 0.05, 1200
R, L = 1.2, 0.048


def coil() -> casid.Model:
    m = casid.Model("coil")
    i = m.state("i", "A")
    U = m.input("U", "V", hold="zoh", known=True)
    resistance = m.parameter("R", "ohm", start=1.0, lower=0.1)
    inductance = m.parameter("L", "H", start=0.06, lower=1e-3)
    m.derivative(i, (U - resistance * i) / inductance)
    m.output("current", i, "A")
    return m


def recorded(lost: tuple[int, ...], *, seed: int = 1) -> tuple[Record, np.ndarray]:
    """A record whose command steps every 12 samples, and the command.

    Around as many steps as `lost` has entries three rows are lost, so many of them before the step.
    """
    rng = np.random.default_rng(seed)
    U = np.repeat(rng.uniform(-10, 10, N // 12), 12)
    E = np.exp(-R / L * TS)
    i = np.zeros(N)
    for k in range(N - 1):
        i[k + 1] = E * i[k] + (1 - E) * U[k] / R
    i += 0.05 * rng.standard_normal(N)
    gone = np.zeros(N, dtype=bool)
    for n, before in enumerate(lost):
        at = 12 * (5 + 7 * n)
        gone[at - before : at - before + 3] = True
    record = Record(
        {"U": np.where(gone, 0.0, U), "current": np.where(gone, 0.0, i)},
        {"U": "V", "current": "A"},
        Ts=TS,
        name="run",
        missing={"U": gone, "current": gone},
    )
    return record, U


PROBLEM = casid.Problem("coil", coil(), channels={"U": "U", "current": "current"})
PLACES = (0, 1, 2, 3, 2, 1, 0, 2)


def test_the_input_is_filled_as_it_was() -> None:
    """Of a step of 0 lost rows before it the first row lost has the new value already."""
    record, U = recorded(PLACES)
    chosen = with_gaps_treated(coil(), [casid.Experiment(record, {}, "run")])
    split = split_records(chosen, 0.3)
    held = chosen[0].record["U"]
    assert np.abs(held - U).max() > 1.0
    fit = fit_model(coil(), split.fitted, FitSettings(starts=1), throw=False)
    filled, moved = with_steps_in_gaps(fit, split)
    assert moved == sum(before < 3 for before in PLACES)
    np.testing.assert_array_equal(filled.whole[0].record["U"], U)
    np.testing.assert_array_equal(filled.fitted[0].record["U"], U[: filled.fitted[0].record.N])
    assert "U filled by steps in gaps" in filled.whole[0].record.provenance[-1]
    again, moved = with_steps_in_gaps(fit, filled)
    assert (again, moved) == (filled, 0)


@pytest.mark.parametrize("lost", [(2,), PLACES])
def test_a_step_in_lost_rows_makes_no_outlier_behind_them(lost: tuple[int, ...]) -> None:
    """Nor a disturbance, a knock or a jump of a parameter."""
    record, _ = recorded(lost)
    found = casid.diagnose(PROBLEM, record, advise=False)
    assert (found.verdict, found.causes) == ("adequate", ())
    assert found.model is not None
    assert found.model.values["L"] == pytest.approx(L, rel=0.01)


def test_an_outlier_beside_a_gap_is_one_all_the_same() -> None:
    record, _ = recorded(PLACES)
    spoilt = record["current"].copy()
    spoilt[[100, 317, 12 * 12 + 5, 777]] += 4.0
    record = Record(
        {"U": record["U"], "current": spoilt},
        dict(record.units),
        Ts=TS,
        name="run",
        missing=dict(record.missing),
    )
    found = casid.diagnose(PROBLEM, record, advise=False)
    assert [(c.kind, c.where) for c in found.causes] == [("outliers", "current")]
    (share, _) = found.causes[0].parameters
    assert share.value == pytest.approx(4 / N, rel=0.05)


def tank() -> casid.Model:
    m = casid.Model("tank")
    h = m.state("h", "m", start=1.0)
    Q = m.input("Q", "m^3/s", hold="zoh", known=True)
    area = m.parameter("A", "m^2", start=8.0, lower=0.1)
    outlet = m.parameter("c", "m^2/s", start=0.8, lower=0.01)
    m.balance(h, "tank", inertia=area, terms=[Q, -outlet * h])
    m.output("level", h, "m")
    return m


def test_steps_are_placed_again_once_a_stuck_sensor_is_set_aside() -> None:
    """While it bends the fit, a step seems to fall elsewhere in the gap than it does.

    A tank of 10 s, a row each second, by its exact recursion.
    """
    rng = np.random.default_rng(3)
    Q = np.repeat(rng.uniform(0.5, 2.0, N // 40), 40)
    E = np.exp(-0.1)
    h = np.full(N, 1.0)
    for k in range(N - 1):
        h[k + 1] = E * h[k] + (1 - E) * Q[k]
    h += 0.003 * rng.standard_normal(N)
    h[395:495] = h[395]
    gone = np.zeros(N, dtype=bool)
    for at in (120, 240, 600, 720, 800):
        gone[at : at + 3] = True
    record = Record(
        {"Q": np.where(gone, 0.0, Q), "level": np.where(gone, 0.0, h)},
        {"Q": "m^3/s", "level": "m"},
        Ts=1.0,
        name="run",
        missing={"Q": gone, "level": gone},
    )
    found = casid.diagnose(casid.Problem("tank", tank()), record, advise=False)
    assert [(c.kind, c.where) for c in found.causes] == [("outliers", "level")]
    assert found.model is not None
    assert found.model.values["A"] == pytest.approx(10.0, rel=0.005)
