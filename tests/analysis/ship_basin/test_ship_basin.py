"""The basin made again: its records, what biases do not do, and what a lighter weight costs."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from analysis.ship_algorithm.records import NONE
from analysis.ship_algorithm.study import EIGHT
from analysis.ship_basin.figures import iterations
from analysis.ship_basin.records import (
    BASIN,
    CASES,
    LIGHT,
    SECONDS,
    Basin,
    basin,
    experiments_of,
    halves,
    truth_of,
)
from analysis.ship_basin.runs import LEAST_SQUARES, LOAD, Draws, Found, estimated
from analysis.ship_basin.study import LIGHTER, apart, coverage
from casid.campaigns.campaign import campaign
from casid.estimation.moments.equations.parts import parts_of
from casid.estimation.moments.stages.convergence import Convergence
from problems.ship import TABLE_8_2


@pytest.fixture(scope="module")
def found():
    return {case: estimated(experiments_of(basin(1), case)) for case in (1, 3)}


def test_records_have_the_lengths_and_weights_of_the_tables():
    records = basin(1)
    assert [r.duration for r in records] == pytest.approx(SECONDS, abs=0.021)
    for case, (nominal, light, _) in CASES.items():
        experiments = experiments_of(records, case)
        assert [e.name for e in experiments] == ["nominal", "calibration", "loaded"]
        assert experiments[0].known == {"m": 0.0}
        assert experiments[1].known == LIGHT
        assert not experiments[2].known
        assert (nominal, light) != (light, nominal)
    assert truth_of(1) == LIGHT  # both of 0.2 kg
    assert truth_of(2) == truth_of(3) == {"m": 0.4, "zbar_m": -0.268}


def test_records_obey_the_difference_equation_at_the_truth():
    """The trapezoidal rule is the bilinear image of (8.17): the truth is exact."""
    records = basin(1, Basin(disturbance=NONE))
    for e in experiments_of(records, 3):
        model = EIGHT.with_known(**{n: TABLE_8_2[n] for n in EIGHT.parameters if n in TABLE_8_2})
        part = parts_of(model, [e])[0]
        values = {**part.values, **TABLE_8_2, **(dict(e.known) or truth_of(3))}
        theta = np.asarray(part.equation.g([values[q] for q in part.equation.parameters])).ravel()
        inside = {k: v[200:-200] for k, v in part.signals.items()}  # the filter's edges left out
        rest = part.equation.left.samples(inside, 5)
        for value, column in zip(theta, part.equation.columns, strict=True):
            rest = rest - value * column.samples(inside, 5)
        assert np.max(np.abs(rest)) < 1e-11


def test_halves_make_the_whole():
    experiments = experiments_of(basin(1), 1)
    first, second = halves(experiments)
    for e, a, b in zip(experiments, first, second, strict=True):
        assert np.isclose(a.record.N + b.record.N, e.record.N, atol=1)
        assert a.record["delta"][0] == e.record["delta"][0]
        assert b.record["delta"][-1] == e.record["delta"][-1]


def test_instruments_are_within_their_errors_and_least_squares_does_not_fit(found):
    """Two normal numbers exceed 3.2 once in 400 draws; least squares' moments contradict."""
    for case, estimate in found.items():
        assert apart(case, estimate) < 3.2
    plain = estimated(experiments_of(basin(1), 3), LEAST_SQUARES)
    assert plain.propagated.p_value < 1e-6
    assert abs(plain["K_delta"] / TABLE_8_2["K_delta"] - 1) > 0.5


def test_biases_of_the_sensors_do_not_reach_instruments_without_mean(found):
    """Trap T-5: the constant in the equation error meets instruments that have none.

    Iterations stop at moves of 2e-3 in all eight parameters together, a tenth of m's error.
    """
    without = Basin(disturbance=replace(BASIN, gyro_bias=0.0, accel_bias=0.0))
    clean = estimated(experiments_of(basin(1, without), 3, without))
    for n in LOAD:
        assert abs(clean[n] - found[3][n]) < 0.1 * clean.std_error(n)


def test_a_lighter_calibration_weight_tells_less(found):
    """The relative error of the calibration's lever goes as 1/m_c, the load's own stays."""
    errors = []
    for m_c in (LIGHTER[0], LIGHTER[-1]):
        weights = (Basin().weights[0], {**LIGHT, "m": m_c}, *Basin().weights[2:])
        made = replace(Basin(), weights=weights)
        errors.append(estimated(experiments_of(basin(1, made), 3, made)).std_error("m"))
    assert errors[0] < found[3].std_error("m") < errors[1] < 8 * errors[0]


def test_draws_of_a_campaign_are_the_estimates_of_their_seeds():
    draws = Draws(cases=(3,))
    done = campaign(draws, 2, seed=9)
    known = Found(done, draws)
    values = known.column("case 3 IV", "m")
    seed = np.random.SeedSequence(9, spawn_key=(1,)).generate_state(1)[0]
    again = estimated(experiments_of(basin(int(seed)), 3))
    assert values[1] == pytest.approx(again["m"], rel=1e-6)
    line = known.line("case 3 IV")
    assert line["draws"] == 2
    assert line["median error of m, %"] == pytest.approx(100 * (np.mean(values) / 0.4 - 1))


def test_coverage_counts_both_sides_and_has_the_band_of_its_draws():
    """1000 of 2000 intervals would be no 95 %; 1900 are; 40 draws are judged with 3 errors."""
    table = {"case 3 IV m": np.full(2000, 0.4), "case 3 IV se m": np.full(2000, 0.01)}
    table["case 3 IV m"][:60], table["case 3 IV m"][60:100] = 0.3, 0.5
    done = SimpleNamespace(column=table.__getitem__, runs=2000)
    target = coverage(Found(done, Draws()), "case 3 IV", "m")  # type: ignore[arg-type]
    assert target.is_met
    assert target.found == "95.0 +- 0.5 % (60 low, 40 high)"
    assert target.wanted == "93 to 97 % of 2000"
    table["case 3 IV m"][:1000] = 0.3
    assert not coverage(Found(done, Draws()), "case 3 IV", "m").is_met  # type: ignore[arg-type]


def test_the_figure_of_iterations_ends_at_the_estimates(found):
    paths = {c: Convergence.of(e.stages[0]) for c, e in found.items()}
    figure = iterations({1: paths[1], 2: paths[3], 3: paths[3]}, {c: truth_of(c) for c in CASES})
    by_name = {t.name: t for t in figure.data[::4]}
    assert by_name["case 1"].y[-1] == found[1]["m"]
    assert "m [kg]" in figure.layout.yaxis.title.text
