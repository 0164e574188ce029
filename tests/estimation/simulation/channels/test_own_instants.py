"""Samples between the instants of the clock on which a record is simulated.

The truth is one compartment, V dc/dt = rate - CL c, by its exact solution between the rows.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import casid
from casid.estimation.simulation.channels.own_instants import Instants, at_own_instants
from casid.estimation.simulation.channels.sensor_dynamics import Before
from casid.estimation.simulation.records.input_gaps import with_gaps_treated
from casid.estimation.simulation.simulation_error import SimulationError

V, CL = 10.0, 8.0  # L, L/h


def problem() -> casid.Problem:
    m = casid.Model("one compartment")
    c = m.state("c", "mg/L")
    rate = m.input("rate", "mg/h", hold="zoh", known=True)
    volume = m.parameter("V", "L", start=V, lower=1, upper=100)
    clearance = m.parameter("CL", "L/h", start=CL, lower=0.01, upper=50)
    m.balance(c, "plasma", inertia=volume, terms=[rate, -clearance * c])
    m.output("c", c, "mg/L")
    return casid.Problem("plasma", m, channels={"rate": "rate [mg/h]", "c": "c [mg/L]"})


def written(path: Path, steps: list[tuple[float, float]], taken: np.ndarray) -> Path:
    """A file of events: a row for each step (time [h], rate [mg/h]) and for each sample."""
    rows, c, rate, last = [], 0.0, 0.0, 0.0
    events = sorted([(t, r) for t, r in steps] + [(t, None) for t in taken.tolist()])
    for t, new in events:
        c = rate / CL + (c - rate / CL) * np.exp(-CL / V * (t - last))
        rate, last = rate if new is None else new, t
        rows.append(f"{t:.4f},{rate:g},{'' if new is not None else f'{c:.7f}'}")
    path.write_text("\n".join(["time [h],rate [mg/h],c [mg/L]", *rows]) + "\n")
    return path


def errors_at_the_truth(path: Path) -> tuple[np.ndarray, SimulationError]:
    """Measured minus simulated [mg/L] of the samples, at the true parameters."""
    plasma = problem()
    parts = with_gaps_treated(plasma.model, [plasma.read(path)])
    criterion = SimulationError(plasma.model, parts[:1])
    at = criterion.simulated(criterion.start, 0)
    assert len(parts) == 1
    return 1e3 * at.residual[criterion.data[0].used[:, 0], 0], criterion


def test_samples_count_at_their_own_instants(tmp_path: Path) -> None:
    """Errors are of the order Ts^2 CL / (8 V), and no longer Ts/2 times the slope.

    That times the slope is what a straight line costs, times rate / V what it costs that a step
    within an interval acts as its mean over it; no sample lies in such an interval.
    """
    rng = np.random.default_rng(3)
    steps = [(6.0 * k + d, r) for k in range(8) for d, r in ((0.0, 100.0 + 10 * k), (1.0, 0.0))]
    taken = np.sort(np.concatenate([6.0 * k + rng.uniform(0.1, 5.9, 6) for k in range(8)]))
    taken = taken[np.append(True, np.diff(taken) > 0.1)]
    error, criterion = errors_at_the_truth(written(tmp_path / "doses.csv", steps, taken))
    d = criterion.data[0]
    Ts = d.Ts / 3600
    late = np.abs(d.instants.late[d.used]) * Ts
    assert late.max() > 0.3 * Ts  # h: up to half an interval off
    steepest, rate = (CL / V) * 10.0, 170.0
    assert np.abs(error).max() < Ts**2 / 8 * (CL / V) * (steepest + 2 * rate / V)
    assert np.abs(error).max() < 0.05 * late.max() * steepest


def test_the_tangent_is_that_of_the_moved_output(tmp_path: Path) -> None:
    taken = np.array([0.31, 0.62, 1.03, 1.57, 2.71, 3.14, 4.4, 5.05, 7.77, 8.08])
    path = written(tmp_path / "dose.csv", [(0.0, 90.0), (1.0, 0.0), (5.5, 70.0)], taken)
    criterion = errors_at_the_truth(path)[1]
    x, h = criterion.start, 1e-5 * criterion.start[0]
    up, down = (criterion.simulate(x + s * np.eye(len(x))[0], 0)[0] for s in (h, -h))
    used = criterion.data[0].used
    slope = ((up - down) / (2 * h))[used]
    assert criterion.simulated(x, 0).jacobian[used][:, 0] == pytest.approx(slope, rel=1e-6)


def test_a_line_does_not_cross_a_step_or_the_beginning_of_a_part() -> None:
    """Outputs 0, 1, 2, .. that step to ten times as much in sample 3, simulated anew from 6."""
    y = np.array([0.0, 1.0, 2.0, 30.0, 40.0, 50.0, -6.0, -7.0])[:, None]
    before = Before(np.array([1.0, 2.0, 3.0, 40.0, 50.0, 60.0, -7.0, -8.0]))
    late = np.array([0.0, 0.5, 0.25, -0.25, 0.0, 0.5, -0.5, 0.0])[:, None]
    cuts = np.array([0, 6, 8])
    at = Instants(late, np.full(8, np.nan))
    stepping = y.copy()
    at_own_instants(stepping, None, at, {0: before}, cuts)
    assert stepping[:, 0].tolist() == [0.0, 1.5, 2.25, 2.75, 40.0, 55.0, -5.5, -7.0]
    smooth = y.copy()
    at_own_instants(smooth, None, at, {}, cuts)
    assert smooth[1, 0] == 1.5
    assert smooth[5:7, 0].tolist() == [55.0, -5.5]


def test_lines_do_not_cross_a_bend() -> None:
    """Slope 0 until 3.4, and 10 behind it; a sample at the bend itself is one before it."""
    t = np.arange(8.0)
    y = 10 * np.maximum(t - 3.4, 0.0)[:, None]
    bend = np.full(8, np.nan)
    bend[3] = 0.4
    for place, row in ((3.3, 3), (3.4, 3), (3.6, 4), (2.7, 3), (4.8, 5)):
        late = np.zeros((8, 1))
        late[row] = place - row
        moved = y.copy()
        at_own_instants(moved, None, Instants(late, bend), {}, np.array([0, 8]))
        assert moved[row, 0] == pytest.approx(10 * max(place - 3.4, 0.0), abs=1e-12)


def test_two_rows_at_one_place_leave_a_dose_as_it_was(tmp_path: Path) -> None:
    """Samples half a minute before and after a step: the mean of both would act for an hour."""
    steps = [(6.0 * k + d, r) for k in range(12) for d, r in ((0.013, 100.0), (1.017, 0.0))]
    steps = [(-0.5, 0.0), *steps]
    taken = np.array([6.0 * k + d for k in range(12) for d in (0.5, 2.0, 3.1, 4.3)])
    close = np.array([0.013 + 0.007, 6.013 - 0.006, 13.017 - 0.008])
    path = written(tmp_path / "close.csv", steps, np.sort(np.append(taken, close)))
    error, criterion = errors_at_the_truth(path)
    places = criterion.data[0].u[:, 0] * 3.6e9
    assert np.any((places > 1) & (places < 99))  # intervals in which the dose began or ended
    total = np.sum(places) * criterion.data[0].Ts / 3600
    assert total == pytest.approx(100.0 * 1.004 * 12, rel=1e-9)
    assert np.abs(error).max() < 0.02


def test_a_bolus_within_one_interval_is_all_there(tmp_path: Path) -> None:
    steps = [(6.0 * k + d, r) for k in range(8) for d, r in ((0.01, 6000.0), (0.02, 0.0))]
    taken = np.array([6.0 * k + d for k in range(8) for d in np.arange(0.4, 6.0, 0.35)])
    error, criterion = errors_at_the_truth(written(tmp_path / "bolus.csv", steps, taken))
    d = criterion.data[0]
    assert np.sum(d.u[:, 0]) * 3.6e9 * d.Ts / 3600 == pytest.approx(60.0 * 8, rel=1e-9)
    assert np.abs(error).max() < 0.05


def series_errors(path: Path, seed: int, *, steps_last: bool) -> tuple[np.ndarray, np.ndarray]:
    """Errors [V] of a resistance of 2 ohm in series with a store, u = q / C + R i, and du/dR - i.

    The current runs in from the row's own stamp; with `steps_last` it steps at the last row.
    """
    rng, R, C = np.random.default_rng(seed), 2.0, 40.0
    t = np.cumsum(rng.uniform(0.8, 1.2, 300))
    i = np.repeat(rng.choice([-1.0, 0.0, 1.0, 2.0], 30), 10)
    if steps_last:
        i[-1] = i[-2] + 3.0
    q = np.append(0.0, np.cumsum(i[:-1] * np.diff(t)))
    rows = [f"{a:.6f},{b:g},{c:.9f}" for a, b, c in zip(t, i, q / C + R * i, strict=True)]
    path.write_text("\n".join(["t [s],i [A],u [V]", *rows]) + "\n")
    m = casid.Model("store behind a resistance")
    charge, current = m.state("q", "coulomb"), m.input("i", "A", hold="zoh", known=True)
    m.balance(charge, "charge", inertia=1, terms=[current], unit="A")
    series = m.parameter("R", "ohm", start=R, lower=0.1, upper=100)
    m.output("u", charge / m.constant("C", C, "farad") + series * current, "V")
    cell = casid.Problem("cell", m)
    criterion = SimulationError(m, with_gaps_treated(m, [cell.read(path)]))
    start = np.where(criterion.start == R, R, 0.0)
    used = criterion.data[0].used[:, 0]
    assert criterion.data[0].instants is not None
    at = criterion.simulated(start, 0)
    of_R = at.jacobian[used, 0, int(np.flatnonzero(criterion.start == R)[0])]
    return at.residual[used, 0], np.abs(of_R) - np.abs(i)


def test_an_output_that_steps_with_the_input_has_all_of_its_step_at_once(tmp_path: Path) -> None:
    """A row has the current from its stamp on.

    What is simulated is the mean current of the clock's interval, and R times what that lacks
    would be an error a hundred times as large.
    """
    error, of_R = series_errors(tmp_path / "cell.csv", 5, steps_last=False)
    assert np.abs(error).max() < 0.02
    assert np.abs(of_R).max() < 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_a_step_at_the_last_row_counts_there_as_at_any_other(tmp_path: Path, seed: int) -> None:
    """Whether that row stands before its place on the clock or behind it, where no interval is."""
    error, of_R = series_errors(tmp_path / "cell.csv", seed, steps_last=True)
    assert np.abs(error).max() < 0.02
    assert np.abs(of_R).max() < 1e-9
