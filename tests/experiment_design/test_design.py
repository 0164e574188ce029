"""Designs that separate, detect and determine: what is predicted is what records then show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import casid
from casid import Aim
from casid.experiment_design.designed_experiment import (
    Outcome,
    energy_for_detection,
    probability_of_detection,
    probability_of_right_name,
)
from casid.experiment_design.verification import contradictions


def spring(**noise: float) -> casid.Problem:
    """A first-order lag with a known start: two parameters."""
    m = casid.Model("lag")
    x, u = m.state("x", "m", initial=0.0), m.input("u", "N")
    c, k = m.parameter("c", "N s/m", start=1.0), m.parameter("k", "N/m", start=2.0)
    m.balance(x, "force", inertia=c, terms=[-k * x, u])
    m.output("y", x, "m")
    return casid.Problem("lag", m, noise=noise or {"y": 0.01})


SMALL: dict[str, Any] = {"Ts": 0.1, "intervals": 15, "candidates": 5, "starts": 1}


@pytest.fixture(scope="module")
def separated() -> casid.DesignedExperiment:
    return casid.design_experiment(
        spring(),
        Aim.separate("quadratic_damping", "cubic_damping"),
        {"u": (-2, 2), "y": (-0.8, 0.8)},
        6.0,
        sizes={"cubic_damping": 0.2},
        **SMALL,
    )


def test_a_design_separates_better_than_every_standard_input(
    separated: casid.DesignedExperiment,
) -> None:
    assert separated.gain > 1.5
    assert all(s.information <= 1.0 for s in separated.standards)
    assert {o.truth for o in separated.outcomes} == {
        "quadratic_damping in force",
        "cubic_damping in force",
    }
    for use in separated.limits:
        assert use.lower <= use.lowest <= use.highest <= use.upper


def test_an_input_that_is_held_is_drawn_in_steps_to_the_end_of_the_record(
    separated: casid.DesignedExperiment,
) -> None:
    assert separated.is_held
    drawn = next(t for t in separated.plot().data if t.name == "designed input")
    assert drawn.line.shape == "hv"
    assert drawn.x[-1] == separated.duration
    t, u = separated.record.t, separated.record["u"]
    held = np.searchsorted(drawn.x, t, side="right") - 1
    assert np.array_equal(np.asarray(drawn.y)[held], u)  # every sample, between two steps
    others = [t for t in separated.plot().data if t.name != "designed input"]
    named = {t.name for t in others}
    assert "cubic damping in the force balance" in named
    assert any(" balance, fitted to cubic damping in the force balance" in n for n in named)
    assert {t.line.shape for t in others} <= {None, "linear"}


def test_an_input_that_the_problem_joins_by_lines_is_said_to_be_held(
    separated: casid.DesignedExperiment,
) -> None:
    """A record of it, diagnosed with the wrong course, shows spikes at every step."""
    assert (
        "u is held between its samples in this design, and joined by straight lines between its "
        'samples in the problem: declare hold="zoh" for it before its record is diagnosed.'
    ) in separated.notes
    aim, limits = Aim.estimate("c"), {"u": (-2.0, 2.0)}
    lines = casid.design_experiment(spring(), aim, limits, 3.0, shape="linear", **SMALL)
    assert not any("declare hold" in note for note in lines.notes)


@pytest.mark.slow
def test_of_several_sizes_of_a_cause_the_worst_counts(
    separated: casid.DesignedExperiment,
) -> None:
    """The energy of a faint cause grows with the square of its size, about: the smaller decides."""
    found = casid.design_experiment(
        spring(),
        Aim.separate("quadratic_damping", "cubic_damping"),
        {"u": (-2, 2), "y": (-0.8, 0.8)},
        6.0,
        sizes={"cubic_damping": [0.2, 0.1]},
        **SMALL,
    )
    assert [o.size for o in found.outcomes if o.truth.startswith("cubic")] == [0.2, 0.1]
    large, small = (o.energy for o in found.outcomes if o.truth.startswith("cubic"))
    assert 2.5 < large / small < 4.5
    assert found.power == min(o.power for o in found.outcomes)
    assert found.power < separated.power
    # What is drawn of truth and rival belongs to one size.
    truth, rival = (
        found.records[n]["y"]
        for n in (
            "cubic_damping in force",
            "quadratic_damping in force, fitted to cubic_damping in force",
        )
    )
    assert np.sum((truth - rival) ** 2) / 0.01**2 == pytest.approx(large, rel=1e-3)
    assert any("with d_3 = 0.2 and with d_3 = 0.1" in n for n in found.notes)
    with pytest.raises(casid.DataError, match="none is given"):
        casid.design_experiment(
            spring(), Aim.detect("cubic_damping"), {"u": (-2, 2)}, 6.0, sizes={"cubic_damping": []}
        )


def test_the_energy_predicted_is_what_a_fit_of_the_rival_leaves(
    separated: casid.DesignedExperiment,
) -> None:
    """Least squares of the rival, by a solver and an integration of its own."""
    from scipy.optimize import least_squares

    o = next(o for o in separated.outcomes if o.truth.startswith("cubic"))
    u, h = separated.record["u"], 0.1

    def course(c: float, k: float, k2: float, k3: float) -> np.ndarray:
        x, out = 0.0, []
        for now in u:
            out.append(x)
            for _ in range(10):

                def rate(x: float, now: float = now) -> float:
                    return (now - k * x - k2 * abs(x) * x - k3 * x**3) / c

                k_1 = rate(x)
                k_2 = rate(x + h / 20 * k_1)
                k_3 = rate(x + h / 20 * k_2)
                x += h / 60 * (k_1 + 2 * k_2 + 2 * k_3 + rate(x + h / 10 * k_3))
        return np.array(out)

    truth = course(1.0, 2.0, 0.0, 0.2)
    best = least_squares(lambda v: (truth - course(*v, 0.0)) / 0.01, [1.0, 2.0, 0.0])
    assert o.energy == pytest.approx(2 * best.cost, rel=0.02)
    without = least_squares(
        lambda v: (truth - course(*v, 0.0, 0.0)) / 0.01, [1.0, 2.0], x_scale=[1.0, 1.0]
    )
    assert o.alone == pytest.approx(2 * without.cost, rel=0.02)
    assert o.power >= norm.cdf(np.sqrt(o.energy) / 2)


@pytest.mark.slow
def test_the_power_predicted_is_the_share_of_right_names_in_simulated_records() -> None:
    """Within four binomial standard errors, for causes that noise often hides."""
    runs = 40
    found = casid.design_experiment(
        spring(y=0.09),
        Aim.separate("quadratic_damping", "cubic_damping"),
        {"u": (-2, 2), "y": (-0.8, 0.8)},
        6.0,
        sizes={"quadratic_damping": 1.0, "cubic_damping": 1.0},
        verify=runs,
        verify_by="fits",
        **SMALL,
    )
    for o in found.outcomes:
        assert 0.5 < o.power < 0.999
        assert o.runs == runs
        spread = np.sqrt(o.power * (1 - o.power) / runs)
        assert abs(o.right / runs - o.power) < 4 * spread + 0.5 / runs


@pytest.mark.slow
def test_whole_diagnoses_of_simulated_records_are_counted_with_the_interval_of_their_share() -> (
    None
):
    """A catalogue of other causes stands beside the two: the one that is true is still named."""
    found = casid.design_experiment(
        spring(y=0.003),
        Aim.separate("quadratic_damping", "cubic_damping"),
        {"u": (-2, 2), "y": (-0.8, 0.8)},
        6.0,
        sizes={"quadratic_damping": 1.0, "cubic_damping": 1.0},
        verify=2,
        **SMALL,
    )
    for o in found.outcomes:
        assert o.power > 0.99
        assert o.diagnosed == o.right == o.runs == 2
        assert o.agreement == pytest.approx(1.0, abs=0.05)
    # 2 of 2: the lower end of the interval of Clopper and Pearson is 0.025^(1/2).
    assert f"2 of 2 ({100 * 0.025 ** (1 / 2):.3g} .. 100 %)" in str(found)


def test_a_record_with_too_few_samples_for_a_diagnosis_is_noted_with_the_sample_time() -> None:
    """Ten samples an unknown: c and k take 20, of which 1.5 s at 0.1 s have 15."""
    settings = {**SMALL, "intervals": 5, "starts": 0}
    arguments = spring(), Aim.detect("cubic_damping"), {"u": (-2, 2)}
    size = {"cubic_damping": 1.0}
    found = casid.design_experiment(*arguments, 1.5, sizes=size, **settings)
    assert any("from 20 samples on" in n and "0.075 s or shorter" in n for n in found.notes)
    longer = casid.design_experiment(*arguments, 2.0, sizes=size, **settings)
    assert not any("samples on" in n for n in longer.notes)


def test_a_share_of_right_names_that_contradicts_the_prediction_is_noted() -> None:
    """80 of 100 where 95 % were predicted: p = 2e-8 of the binomial test."""
    as_predicted = Outcome("a", "b", 10.8, 0.95, 0.9, right=94, runs=100)
    missed = replace(as_predicted, diagnosed=80)
    assert contradictions([as_predicted]) == []
    (words,) = contradictions([missed])
    assert "whole diagnoses named it in 80 of 100" in words
    assert "95 % were predicted" in words


def test_a_designed_experiment_is_written_saved_and_read(
    separated: casid.DesignedExperiment, tmp_path: Path
) -> None:
    page = separated.write(tmp_path)
    assert "Designed experiment" in page.read_text(encoding="utf-8")
    played = casid.read_record(tmp_path / "input.csv")
    assert played["u"] == pytest.approx(separated.record["u"])
    again = casid.load(separated.save(tmp_path / "design.casid"))
    assert again.to_json() == separated.to_json()
    assert str(again) == str(separated)
    assert "names the right cause" in str(again)


def test_the_cheapest_identifying_input_is_as_small_as_its_errors_allow() -> None:
    found = casid.design_experiment(
        spring(), Aim.identifiable(relative_error=0.02), {"u": (-2, 2)}, 6.0, **SMALL
    )
    relative = [p.std_error / p.value for p in found.parameters]
    assert max(relative) == pytest.approx(0.02, rel=0.05)
    assert max(relative) <= 0.02
    assert np.max(np.abs(found.record["u"])) < 2.0


def test_a_parameter_that_stays_uncertain_ends_the_search_with_what_it_takes() -> None:
    with pytest.raises(casid.SolveError, match="record .* times as long, widen the limits"):
        casid.design_experiment(
            spring(y=0.5), Aim.identifiable(relative_error=0.01), {"u": (-1, 1)}, 3.0, **SMALL
        )


def test_the_design_for_the_worst_scenario_is_no_better_for_the_nominal_one() -> None:
    arguments = (spring(), Aim.estimate("k"), {"u": (-2, 2)}, 4.0)
    alone = casid.design_experiment(*arguments, **SMALL)
    robust = casid.design_experiment(*arguments, scenarios=[{"c": 6.0}], **SMALL)
    errors = [found.parameters[-1].std_error for found in (alone, robust)]
    assert errors[0] <= errors[1] * 1.01


def test_a_record_that_is_too_short_is_given_the_time_that_is_enough() -> None:
    """Energies grow with the record: so much longer, that Phi(sqrt(energy) / 2) = 95 %."""
    found = casid.design_experiment(
        spring(y=0.1),
        Aim.separate("quadratic_damping", "cubic_damping"),
        {"u": (-2, 2)},
        6.0,
        sizes={"quadratic_damping": 0.5, "cubic_damping": 0.5},
        **SMALL,
    )
    assert not found.is_enough
    least = min(o.energy for o in found.outcomes)
    enough = 6.0 * (2 * 1.6449) ** 2 / least
    assert f"95 % needs at most {enough:.4g} s" in found.sentence
    assert energy_for_detection(0.9, 0.05) == pytest.approx(10.507, abs=0.01)


def test_the_displacements_that_a_decay_is_released_from_are_compared_each_once() -> None:
    m = casid.Model("decay")
    x = m.state("x", "m")
    rate = m.parameter("a", "1/s", start=0.5, lower=0.0)
    m.derivative(x, -rate * x)
    m.output("y", x, "m")
    found = casid.design_experiment(
        casid.Problem("decay", m, noise={"y": 0.01}),
        Aim.estimate("a"),
        None,
        6.0,
        release={"x": (-2, 3)},
        **{**SMALL, "candidates": 30},
    )
    assert len({s.description for s in found.standards}) == len(found.standards) > 3
    assert "begins at" in str(found)


def _named(energy: float, angle: float) -> float:
    """Share of right names, two causes at an angle [deg] in the plane that they alone span."""
    theta = np.radians(angle)
    truth = np.array([np.cos(theta), np.sin(theta)])
    shown = np.sqrt(energy) / np.sin(theta) * truth
    data = shown + np.random.default_rng(0).standard_normal((100_000, 2))
    left_by_rival = data[:, 1] ** 2  # the rival acts along the first axis
    left_by_truth = np.sum(data**2, axis=1) - (data @ truth) ** 2
    return float(np.mean(left_by_rival > left_by_truth))


def test_probabilities_are_those_of_their_tests() -> None:
    """Without a misfit: a coin for two names, the false-alarm rate for a detection."""
    assert probability_of_right_name(0.0) == 0.5
    assert probability_of_right_name(4 * 1.6449**2) == pytest.approx(0.95, abs=1e-4)
    assert probability_of_right_name(9.0, 9.0) == pytest.approx(_named(9.0, 90.0), abs=4e-3)
    assert probability_of_right_name(9.0, 36.0) == pytest.approx(_named(9.0, 30.0), abs=4e-3)
    assert probability_of_detection(0.0, 0.05) == pytest.approx(0.05)
    # (1.96 + 1.2816)^2 for a power of 90 %, the other side of the test left out.
    assert probability_of_detection(10.507, 0.05) == pytest.approx(0.9, abs=1e-3)


def test_a_design_for_a_dead_voltage_speaks_of_no_friction() -> None:
    m = casid.Model("coil")
    i, u = m.state("i", "A", initial=0.0), m.input("u", "V")
    L, R = m.parameter("L", "H", start=1.0), m.parameter("R", "ohm", start=2.0)
    m.balance(i, "coil", inertia=L, terms=[-R * i, u], unit="V")
    m.output("y", i, "A")
    found = casid.design_experiment(
        casid.Problem("coil", m, noise={"y": 0.01}),
        Aim.separate("coulomb_friction", "offset"),
        {"u": (-2.0, 2.0)},
        6.0,
        sizes={"coulomb_friction": 0.2},
        **{**SMALL, "candidates": 2, "starts": 0},
    )
    assert [p.name for p in found.parameters] == ["L", "R", "V_c"]
    drawn = {t.name for t in found.plot().data}
    for words in (
        "constant voltage that opposes i in the coil balance",
        "constant voltage in the coil balance",
    ):
        assert words in str(found)
        assert words in drawn
        assert any(note.startswith(f"{words} is taken with V_") for note in found.notes)
    assert "dry friction" not in str(found)
