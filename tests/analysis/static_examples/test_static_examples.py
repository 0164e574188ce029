"""The study of the static examples, and the benchmark as a problem."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import casid
from analysis.static_examples.figures import UNIT, figure_3_5
from analysis.static_examples.study import STUDY
from casid.unknown_inputs.limits.regression import Regression
from casid.unknown_inputs.limits.regression_limit import regression_limit
from problems.static_input import VALUES, problem, signals, simulate


@pytest.mark.slow
def test_every_number_of_the_study_meets_its_closed_form(tmp_path: Path) -> None:
    assert STUDY.main(["--quick", "--runs", "400", "--out", str(tmp_path)]) == 0
    targets = json.loads((tmp_path / "targets.json").read_text())
    assert len(targets) > 30
    assert {p.name for p in tmp_path.glob("*.html")} == {
        "dynamic.html",
        "figure_3_5.html",
        "figure_3_5_sample.html",
        "remedies.html",
    }
    with (tmp_path / "examples.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {r["example"].split()[0] for r in rows} == {
        "3.1", "3.3", "3.5", "3.6", "3.8", "3.9", "3.10", "4.2",
    }  # fmt: skip


def test_figure_3_5_names_its_axes_and_draws_the_closed_form() -> None:
    drawn, figure = figure_3_5(UNIT, np.linspace(0.05, 2.5, 30), np.linspace(0.05, 5, 20))
    assert drawn.regions.shape == (20, 30)
    assert "l2 + lu" in figure.layout.xaxis.title.text
    assert figure.data[-1].name == "(3.58), closed form"


def test_the_problem_estimates_what_errors_in_variables_estimate() -> None:
    """`casid.identify` takes the measurement for the input: its limit is that of LS on (u_K, y_U).

    N = 1000; 3.5 asymptotic standard errors.
    """
    found = casid.identify(problem, problem.simulate(7)) if problem.simulate else None
    assert found is not None
    theory = regression_limit(
        signals().at(VALUES | {"a1": 1, "a2": 1}),
        Regression("y_O", {"bK": "u_K", "bU": "y_U"}),
        {k: VALUES[k] for k in ("bK", "bU")},
    )
    for name in ("bK", "bU"):
        error = theory.std_error(name, 1000)
        assert abs(found[name] - theory[name]) < 3.5 * error
        assert found.parameter(name).std_error == pytest.approx(error, rel=0.2)
        assert abs(theory.bias(name)) > 5 * error  # and this bias the record does not show


def test_the_problem_simulates_what_its_signals_say() -> None:
    """Second moments of 100 000 samples; standard error of a product of Gaussians sqrt(2/N) rel."""
    record = simulate(3, N=100_000)
    names = ("u_K", "y_O", "y_U", "y_I", "delta1", "delta2")
    from casid.unknown_inputs.limits.second_moments import second_moments

    numeric = signals().at(VALUES | {"a1": 1, "a2": 1})
    wanted = second_moments(numeric, [(n, 0, False) for n in names]).second
    sampled = np.array([record[n] for n in names])
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    found = sampled @ sampled.T / 100_000
    assert np.all(np.abs(found - wanted) < 4.5 * np.sqrt(2 / 100_000) * scale)
    assert np.array_equal(simulate(3)["y_O"], simulate(3)["y_O"])
    assert not np.array_equal(simulate(3)["y_O"], simulate(4)["y_O"])


def test_a_value_that_the_benchmark_has_not_is_named() -> None:
    with pytest.raises(casid.ModelError, match="no value named gamma; it has alpha, beta"):
        simulate(values={"gamma": 1.0})
