"""The study of bias on the ship: what moves least squares leaves instruments alone."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.ship_bias import figures as ship_bias_figures
from analysis.ship_bias.records import IMPERFECTIONS, Imperfection, Rudder, answers, regressors
from analysis.ship_bias.speed import AtSea, AtSpeed
from analysis.ship_bias.table import (
    BACKGROUND,
    Estimator,
    Row,
    mean_in_instruments,
    rows,
    with_background,
)
from analysis.ship_bias.wrong_signs import flipped, straight_course
from casid.estimation.cross_moments.column_products import column_means
from casid.identification.moment_estimators import least_squares
from casid.identification.signs_from_moments import sign_flips
from casid.linear.sampled.lagged_columns import Column
from problems import ship
from problems.ship import TABLE_8_2
from tests.problems.test_ship import coefficients


def test_a_perfect_record_obeys_the_difference_equation_exactly():
    """Trapezoidal steps are the bilinear image: (8.57) holds with the coefficients of (8.54)."""
    for made in answers(1, seconds=20.0):
        record = made.experiment(Imperfection()).record
        known = {"nominal": {"m": 0.0}, "calibration": {"m": 0.2, "zbar_m": -0.172}}
        alpha1, alpha2, *gains = coefficients(known.get(made.case, {}))[0]
        T = record.Ts
        A = 4 + 2 * alpha1 * T + alpha2 * T**2
        a = np.array([2 * alpha2 * T**2 - 8, 4 - 2 * alpha1 * T + alpha2 * T**2]) / A
        theta = np.concatenate([a, 2 * T * np.array(gains) / A])
        Phi, Y = regressors(record)
        assert np.abs(Y - Phi @ theta).max() < 1e-12


def test_the_mean_of_a_column_is_that_of_its_samples():
    rng = np.random.default_rng(0)
    signals = {"a": rng.standard_normal(50) + 1.0, "b": rng.standard_normal(50)}
    columns = (
        Column("x", (("a", 0, 1.0), ("b", 3, 2.0))),
        Column("y", (("a", 5, -1.0),)),
        Column("z", (("b", 0, 1.0),)),
    )
    expected = [c.samples(signals, 7).mean() for c in columns]
    np.testing.assert_allclose(column_means(columns, signals, 7), expected, rtol=1e-12)


def test_a_gyro_bias_leaves_instruments_without_a_trace():
    """A constant error is not correlated with instruments of mean zero, whatever the rudder's mean.

    b (1 + a1 + a2) = 0.0009 rad/s, more than the rest of the error: were the mean of a combination
    of the instruments left, the estimate would move by far more than its standard error.
    """
    made = answers(2, Rudder(mean=0.1), seconds=120.0)
    estimator = Estimator.make()
    biased = Imperfection(0.01, gyro=BACKGROUND.gyro, accel=BACKGROUND.accel, r=BACKGROUND.r)
    clean, with_bias = (
        estimator.instruments([a.experiment(w) for a in made]) for w in (BACKGROUND, biased)
    )
    assert np.abs(with_bias[0] - clean[0]).max() < 0.02 * clean[1].min()
    np.testing.assert_allclose(with_bias[1], clean[1], rtol=0.02)
    by_squares = estimator.least_squares([a.experiment(biased) for a in made])
    assert by_squares[0] - TABLE_8_2["m"] > 10 * clean[1][0]


def test_a_mean_in_the_instruments_lets_a_gyro_bias_in():
    """Trap T-5: lags of a rudder of mean 0.1 rad as they are, without the mean, differenced."""
    wrong = IMPERFECTIONS["gyro bias 0.01 rad/s"]
    error = mean_in_instruments(wrong, Rudder(mean=0.1), seed=0)
    assert abs(error["as it is"]) > 10.0
    assert abs(error["without its mean"]) < 3.0
    assert abs(error["differenced"]) < 3.0


@pytest.mark.slow
def test_constants_in_the_regressors_inputs_drop_out_of_both_estimators():
    """A bias of the accelerometer and a heel are constant in a_s, of which only mu_1 is used."""
    names = ["none", "accelerometer bias 0.1 m/s^2", "constant heel of 2 deg"]
    found = list(rows(names, Rudder(), 1, seconds=60.0))
    for method, tolerance in ((0, 1e-4), (1, 1e-3)):
        none = found[method]
        for row in found[method + 2 :: 2]:
            np.testing.assert_allclose(row.errors, none.errors, atol=tolerance)


def test_gyro_noise_biases_least_squares_and_not_instruments():
    squares, instruments = rows(["gyro noise 0.002 rad/s"], Rudder(), 4, seconds=60.0)
    assert squares.bias[0] < -10 * squares.monte_carlo[0]
    assert np.all(np.abs(instruments.bias) < 3.5 * instruments.stated.mean(axis=0) / 2)


@pytest.mark.parametrize("channel", ["r", "accel"])
def test_a_channel_with_the_wrong_sign_is_suspected_and_how_to_mend_it_is_said(channel):
    """Equations fit either sign; bounds and what three load cases share fit only one."""
    recorded = [a.experiment(BACKGROUND) for a in answers(0, seconds=60.0)]
    found = sign_flips(ship.problem, flipped(recorded, channel))
    assert [f.channel for f in found if f.is_suspected] == [channel]
    assert f"-record[{channel!r}]" in str(found[0])
    assert "scale of -1" in str(found[0])


def test_right_signs_are_not_suspected():
    recorded = [a.experiment(BACKGROUND) for a in answers(0, seconds=60.0)]
    assert not any(f.is_suspected for f in sign_flips(ship.problem, recorded))


def test_a_straight_course_is_refused_with_a_mend():
    """Instruments need a rudder that moves, and by more than the sensors' noise."""
    assert (
        "use a record in which it is excited"
        in straight_course(seconds=20.0, seed=0)["instruments"]
    )
    trembling = straight_course(seconds=20.0, seed=0, jitter=0.005)["instruments"]
    assert "Use a reference that drives the system" in trembling


def test_least_squares_warns_on_a_straight_course_and_not_where_the_rudder_moves():
    """Differences of white noise are white: nine tenths and more of such regressors are noise."""
    said = straight_course(seconds=20.0, seed=0)["warnings"]
    assert "accel[t] - accel[t-2]" in said
    assert "% noise in" in said
    assert "use casid.instrumental_variables" in said
    assert "K_delta does not move any output" in said
    moving = [a.experiment(BACKGROUND) for a in answers(0, seconds=60.0)]
    assert not least_squares(Estimator.make().model, moving).estimate.warnings


@pytest.mark.slow
def test_a_wrong_sign_is_found_through_all_noises_by_instruments():
    """Noise drops out of the moments: they are chi^2 with the right signs, and far off with others.

    Least squares misses by as much with either sign there.
    """
    wrong = with_background(IMPERFECTIONS["all of these"])
    recorded = [a.experiment(wrong) for a in answers(0, seconds=60.0)]
    found = sign_flips(ship.problem, flipped(recorded, "accel"), reference="delta")
    assert [f.channel for f in found if f.is_suspected] == ["accel"]
    assert not any(f.is_suspected for f in sign_flips(ship.problem, recorded, reference="delta"))


def test_the_figures_say_what_they_show():
    errors = np.array([[0.01, 0.0], [0.02, 0.001], [0.03, 0.002]])
    table = [Row("none", method, errors, errors) for method in ("LS", "IV")]
    sea = [AtSea(Hs, errors, errors, 0.0) for Hs in (0.0, 0.3)]
    speeds = [AtSpeed(n, U, 1.0, 0.1, 1.0, 1.0) for n in ("k", "d", "K_r") for U in (0.6, 1.4)]
    for figure in (
        ship_bias_figures.imperfections(table, 0.0),
        ship_bias_figures.sea(sea),
        ship_bias_figures.speed(speeds),
    ):
        assert "95 %" in figure.layout.meta["caption"]
    drawn = ship_bias_figures.imperfections(table, 0.0).data[0]
    assert drawn.x[0] == pytest.approx(0.02)
    assert drawn.error_x.array[0] == pytest.approx(1.96 * 0.01 / np.sqrt(3))
