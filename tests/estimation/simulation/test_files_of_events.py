"""Doses and blood samples: a row for each sample, and one for each change of the infusion.

The truth is one compartment, V dc/dt = rate - CL c, by its exact solution between the rows.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import casid
from casid.estimation.simulation.records.input_gaps import has_row_at_every_step, with_gaps_treated
from casid.identification.identify import identify

V, CL, NOISE = 12.0, 4.0, 0.05
DOSES = ((0.0, 0.0), (0.5, 90.0), (4.0, 20.0), (16.0, 0.0), (24.0, 120.0), (27.0, 30.0),
         (40.0, 0.0), (44.0, 60.0), (56.0, 10.0))  # fmt: skip


def problem(known: bool = True) -> casid.Problem:
    m = casid.Model("one compartment")
    c = m.state("c", "mg/L")
    rate = m.input("rate", "mg/h", hold="zoh", known=known)
    volume = m.parameter("V", "L", start=20, lower=1, upper=100)
    clearance = m.parameter("CL", "L/h", start=3, lower=0.01, upper=50)
    m.balance(c, "plasma", inertia=volume, terms=[rate, -clearance * c])
    m.output("c", c, "mg/L")
    return casid.Problem("plasma", m, channels={"rate": "rate [mg/h]", "c": "c [mg/L]"})


def concentration(at: np.ndarray) -> np.ndarray:
    """[mg/L] at the instants (n,) [h]."""
    ends = [t for t, _ in DOSES[1:]] + [np.inf]
    out, c = np.zeros(len(at)), 0.0
    for (start, rate), end in zip(DOSES, ends, strict=True):
        here = (at >= start) & (at < end)
        level = rate / CL
        out[here] = level + (c - level) * np.exp(-CL / V * (at[here] - start))
        c = level + (c - level) * np.exp(-CL / V * (end - start)) if end < np.inf else c
    return out


def written(path: Path, rows_at_rest: int = 0, meals: bool = False) -> Path:
    """Samples in pairs of a few minutes around a few instants, half a day apart at most.

    With `meals`, rows at rest are those at which a second column steps.
    """
    rng = np.random.default_rng(4)
    about = np.concatenate([[1.0, 3.0, 25.0, 28.0], rng.uniform(4.0, 70.0, 18)])
    taken = np.unique(np.round(np.concatenate([about, about + rng.uniform(0.03, 0.3, 22)]), 2))
    level = concentration(taken) + NOISE * rng.standard_normal(len(taken))
    cells = {t: f"{v:.3f}" for t, v in zip(taken, level, strict=True)}
    resting = {t: "" for t in 0.305 + np.linspace(5, 60, rows_at_rest)}
    cells = {**resting, **{t: "" for t, _ in DOSES}, **cells}
    rates = {t: [r for since, r in DOSES if since <= t][-1] for t in cells}
    rows = [f"{t:g},{rates[t]:g},{cells[t]}" for t in sorted(cells)]
    head = "time [h],rate [mg/h],c [mg/L]"
    if meals:
        eaten = [sum(since <= t for since in resting) % 2 for t in sorted(cells)]
        head, rows = head + ",meal", [f"{r},{e}" for r, e in zip(rows, eaten, strict=True)]
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def test_samples_in_quick_succession_are_read_at_their_own_instants(tmp_path: Path) -> None:
    run = problem().read(written(tmp_path / "doses.csv"))
    late = np.abs(run.record.late["c"])
    assert run.record.N <= 4000
    assert late.max() < 45.0
    assert (~run.record.is_missing("c")).sum() == 44


def test_an_infusion_is_held_between_the_rows_of_its_steps(tmp_path: Path) -> None:
    plasma = problem()
    run = plasma.read(written(tmp_path / "doses.csv"))
    (whole,) = with_gaps_treated(plasma.model, [run])
    assert whole.record.N == run.record.N
    assert not whole.filled
    assert "rate has a row at each of its steps" in whole.record.provenance[-1]
    fit = identify(plasma, run)
    for name, true in (("V", V), ("CL", CL)):
        found = fit.parameter(name)
        assert found.value == pytest.approx(true, abs=3 * found.std_error), name
        assert found.std_error < 0.02 * true
    # Nothing had to be guessed: the record's history says what was done, and no warning does.
    assert not [w for w in fit.warnings if "of its steps" in w]


def test_a_row_of_another_column_of_events_is_no_row_at_rest(tmp_path: Path) -> None:
    """Rows for the steps of a meal: the infusion has a row at each of its own all the same."""
    plasma = problem()
    run = plasma.read(written(tmp_path / "fed.csv", rows_at_rest=8, meals=True))
    assert has_row_at_every_step(plasma.model, run.record, "rate")
    assert len(with_gaps_treated(plasma.model, [run])) == 1


def test_a_logger_that_was_off_is_no_file_of_events(tmp_path: Path) -> None:
    path = written(tmp_path / "logged.csv", rows_at_rest=8)
    run = problem().read(path)
    assert not has_row_at_every_step(problem().model, run.record, "rate")
    measured = problem(known=False)
    events = measured.read(written(tmp_path / "doses.csv"))
    assert not has_row_at_every_step(measured.model, events.record, "rate")


def test_a_sample_that_failed_leaves_a_file_of_events(tmp_path: Path) -> None:
    """An outlier that is set aside leaves a row at which nothing was measured."""
    plasma = problem()
    record = plasma.read(written(tmp_path / "doses.csv")).record
    mask = np.zeros(record.N, dtype=bool)
    mask[np.flatnonzero(~record.is_missing("c"))[[7, 20]]] = True
    record = record.mark_missing("c", mask)
    assert has_row_at_every_step(plasma.model, record, "rate")
    assert len(with_gaps_treated(plasma.model, [casid.Experiment(record)])) == 1
