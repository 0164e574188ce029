"""A held input that steps in lost rows did so where the outputs behind them show.

The truth is a coil of 40 ms, sampled at 50 ms, by its exact recursion; where the command steps rows
are lost, of command and current alike.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import casid
from casid.data.record import Record
from casid.diagnosis.evidence.recording_faults.steps_in_gaps import with_steps_in_gaps
from casid.estimation.holdout import split_records, whole_simulation
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.records.input_gaps import with_gaps_treated

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


@pytest.mark.parametrize("lost", [pytest.param((2,), marks=pytest.mark.slow), PLACES])
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


def cell() -> casid.Problem:
    """A resistance in series with a leaking store: the voltage steps with the current."""
    m = casid.Model("store behind a resistance")
    charge, current = m.state("q", "coulomb"), m.input("i", "A", hold="zoh")
    capacity, leak = m.constant("C", 40.0, "farad"), m.constant("R_1", 0.5, "ohm")
    m.balance(charge, "charge", inertia=1, terms=[current, -charge / (capacity * leak)], unit="A")
    series = m.parameter("R", "ohm", start=1.5, lower=0.1, upper=100)
    m.output("u", charge / capacity + series * current, "V")
    return casid.Problem("cell", m)


def read_at_uneven_instants(path: Path) -> np.ndarray:
    """A file of a cell of 2 ohm, and 40 F beside 0.5 ohm, of which 15 % of the rows are lost.

    The current steps at its own stamps, 0.8 to 1.2 s apart, lost ones too, and both readings have
    noise. Returns which rows are left.
    """
    rng = np.random.default_rng(6)
    t = np.cumsum(rng.uniform(0.8, 1.2, 400))
    i = np.repeat(rng.choice([-1.0, 0.0, 1.0, 2.0], 100), 4)
    q, held = np.zeros(400), np.exp(-np.diff(t) / 20.0)
    for k in range(399):
        q[k + 1] = held[k] * q[k] + (1 - held[k]) * 20.0 * i[k]
    u = q / 40.0 + 2.0 * i + 0.002 * rng.standard_normal(400)
    measured = i + 1e-4 * rng.standard_normal(400)
    left = rng.random(400) > 0.15
    rows = [f"{a:.6f},{b:.6f},{c:.6f}" for a, b, c in zip(t, measured, u, strict=True)]
    kept = [row for row, is_left in zip(rows, left, strict=True) if is_left]
    path.write_text("\n".join(["t [s],i [A],u [V]", *kept]) + "\n")
    return left


def test_beside_gaps_of_an_uneven_clock_a_row_keeps_its_own_level(tmp_path: Path) -> None:
    """The row before or behind a gap has a step of its own, and there the mean of two levels.

    Taken for a level, such a mean of steps up to 3 A, at 2 ohm, was an error of volts. What may be
    left is the charge of 3 A for a whole lost interval, in 40 F, of a step that is misplaced by it.
    """
    left = read_at_uneven_instants(tmp_path / "cell.csv")
    assert np.sum(~left) > 40
    read = cell().read(tmp_path / "cell.csv")
    split = split_records(with_gaps_treated(cell().model, [read]), 0.3)
    fit = fit_model(cell().model, split.fitted, FitSettings(starts=1), throw=False)
    filled, moved = with_steps_in_gaps(fit, split)
    assert moved > 10
    fit = fit_model(cell().model, filled.fitted, FitSettings(starts=1), throw=False)
    d, y, _ = whole_simulation(fit, filled, 0)
    error = (d.y - y)[d.used]
    assert fit.values["R"] == pytest.approx(2.0, rel=1e-3)
    assert np.abs(error).max() < 3.0 * 1.2 / 40.0
    assert np.sqrt(np.mean(error**2)) < 0.02
