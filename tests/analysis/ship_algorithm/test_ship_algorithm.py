"""Algorithm 8.1 on the ship: what it finds, what it refuses, and what is left along the family."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import casid
from analysis.ship_algorithm.records import (
    FOUR,
    NONE,
    SIDEWAYS,
    THREE,
    coloured,
    linear_experiments,
    load,
    low_passed,
    respond,
    telegraph,
)
from analysis.ship_algorithm.study import (
    ALL,
    BOUNDS,
    EIGHT,
    LOAD,
    SETTINGS,
    TRUTH,
    along,
    apart,
    fit,
)
from casid.errors import IdentifiabilityError
from casid.estimation.moments.equations.parts import parts_of
from casid.identifiability import requirement
from casid.identifiability.combinations.family_estimate import along_family
from casid.identification.iterative_joint_instruments import family_values
from casid.identification.moment_estimators import least_squares
from casid.identification.profile_interval import profile
from problems.ship import TABLE_8_2
from problems.ship_4dof import Ship, linearised

V = TABLE_8_2


@pytest.fixture(scope="module")
def experiments():
    return low_passed(linear_experiments(1, cases=FOUR))


@pytest.fixture(scope="module")
def three(experiments):
    return [e for e in experiments if e.name in THREE]


@pytest.fixture(scope="module")
def found(three):
    return fit(EIGHT, three)


@pytest.fixture(scope="module")
def family(three):
    return casid.assess_identifiability(ALL, three, practical=False).families[0]


# -- the records -----------------------------------------------------------------------------------


@pytest.mark.parametrize("ship", [SIDEWAYS, Ship()])
def test_records_obey_the_difference_equation_exactly(ship):
    """The trapezoidal rule is the bilinear image: (8.57)-(8.60) hold to rounding at the truth."""
    for e in linear_experiments(1, duration=20.0, disturbance=NONE, ship=ship):
        part = parts_of(EIGHT.with_known(**{n: TRUTH[n] for n in BOUNDS if n != "z_f"}), [e])[0]
        values = {**part.values, **V, **e.known}
        equation = part.equation
        theta = np.asarray(equation.g([values[q] for q in equation.parameters])).ravel()
        rest = equation.left.samples(part.signals, 5)
        for value, column in zip(theta, equation.columns, strict=True):
            rest = rest - value * column.samples(part.signals, 5)
        assert np.max(np.abs(rest)) < 1e-12


def test_a_roll_torque_reaches_the_accelerometer_at_once_and_the_yaw_gyro_later():
    """Section 8.2: a direct term from tau to a_s, none to r; both are correlated with tau."""
    push = np.zeros((400, 4))
    push[:, 2] = 1.0
    y = respond(SIDEWAYS, load("nominal"), push)
    largest = np.max(np.abs(y), axis=0)
    assert abs(y[0, 1]) > 0.1 * largest[1]  # a jump
    linear = linearised(V["U"], ship=SIDEWAYS)
    rate = np.linalg.solve(linear.E, linear.T)[4, 1]  # rad/s^2 per N m
    assert y[0, 2] == pytest.approx(0.5 * 0.02 * rate, rel=0.1)  # half a sample of an integral
    assert largest[2] > 5 * abs(y[0, 2])


def test_disturbances_and_rudder_are_what_they_say():
    rng = np.random.default_rng(3)
    e = coloured(0.5, 6.0, 200_000, rng)
    assert np.std(e) == pytest.approx(0.5, rel=0.03)
    assert np.mean(e[1:] * e[:-1]) / np.var(e) == pytest.approx(np.exp(-6.0 * 0.02), rel=0.01)
    delta = telegraph(100_000, angle=0.2, hold=0.7, rng=rng)
    assert set(np.unique(delta)) == {-0.2, 0.2}
    assert 0.02 * len(delta) / np.sum(delta[1:] != delta[:-1]) == pytest.approx(0.7, rel=0.1)


# -- the algorithm ---------------------------------------------------------------------------------


def test_instruments_are_within_their_intervals_and_least_squares_is_not(three, found):
    """Noise on the regressors and the loop bias least squares, and not instruments from the rudder.

    Eight normal numbers exceed 3.5 once in 270 draws.
    """
    assert max(apart(found.estimate, n) for n in found.estimate.names) < 3.5
    assert found.estimate.propagated.p_value > 1e-3
    plain = least_squares(EIGHT, three)
    assert abs(plain["K_delta"] / TRUTH["K_delta"] - 1) > 0.5
    assert plain.propagated.p_value < 1e-6


def test_the_iterations_converge_and_their_table_says_so(found):
    """(8.93): the last step is below the tolerance, and the first is the largest."""
    c = found.convergence
    assert c.is_settled
    assert c.moved[-1] < SETTINGS.tolerance
    assert np.nanmax(c.moved) == c.moved[1]
    np.testing.assert_allclose(c.theta_p[-1], [found[n] for n in c.names])
    text = str(c)
    assert text.splitlines()[0].split()[:2] == ["it.", c.names[0]]
    assert len(text.splitlines()) == 1 + len(c.theta_p)
    assert c.rows()[-1]["error of m, %"] == pytest.approx(100 * abs(found["m"] / V["m"] - 1))
    assert "not settled" not in text


def test_prefilters_and_their_changes_are_kept_by_iteration():
    """Step B (b)-(c): iteration 0 has L = 1, each later one the noise model of the one before."""
    experiments = low_passed(linear_experiments(2, duration=200.0))
    settings = dataclasses.replace(SETTINGS, noise_model=(1, 1), iterations=2, tolerance=1e-9)
    found = fit(EIGHT, experiments, settings)
    c = found.convergence
    assert len(c.noise_models) == len(c.theta_p) == 3
    assert c.noise_models[0] == (None, None, None)
    assert all(m is not None for m in c.noise_models[1])
    sizes = [np.linalg.norm(m.theta) for m in c.noise_models[1]]
    assert c.prefilter_moved[1] == pytest.approx(sum(sizes))
    assert not c.is_settled
    assert "not settled" in str(c)


@pytest.mark.slow
def test_the_nine_are_refused_with_their_family(three, monkeypatch):
    # The closed form is a matter of seconds; on a slow machine it is still what is tested here.
    monkeypatch.setattr(requirement, "FAMILIES_LIMIT", 120.0)
    with pytest.raises(IdentifiabilityError, match="rank 14 of 15") as refusal:
        fit(ALL, three)
    said = str(refusal.value)
    assert "k, A_x, d, K_vdot, K_delta, z_f, K_r and m are not separately identifiable" in said
    assert "(-M*g*zbar_m_calibration + k)/d" in said
    assert "give one of them a known value" in said


def test_a_second_calibration_at_another_height_tells_the_nine(experiments):
    """Rank 17: z_f too has an interval, that of its profile, and it holds the truth."""
    found = fit(ALL, experiments).estimate
    assert "z_f" in found.names
    for name in ("z_f", *LOAD):
        interval = profile(found, name)
        assert interval.lower < TRUTH[name] < interval.upper


def test_a_rudder_that_does_not_move_the_ship_sideways_tells_too_little():
    """With Table 8.2's added mass a_s is all but a function of roll and yaw: K_vdot against K_r."""
    experiments = low_passed(linear_experiments(1, ship=Ship(), duration=300.0, hold=1.5))
    with pytest.raises(IdentifiabilityError, match="not correlated") as refusal:
        fit(EIGHT, experiments)
    assert "K_vdot" in str(refusal.value)
    assert "fewer free parameters" in str(refusal.value)


# -- along the family ------------------------------------------------------------------------------


@pytest.mark.slow
def test_along_the_family_only_zbar_m_stays(found, family):
    """8.3: m moves by m [1/(zbar_c + z_f) - 1/(zbar_m + z_f)] a metre of z_f, zbar_m not at all."""
    moved = along(found.estimate, family)
    assert moved.invariant == ("zbar_m",)
    z_f, zbar_c = V["z_f"], -0.172
    wanted = found["m"] * (1 / (zbar_c + z_f) - 1 / (found["zbar_m"] + z_f))
    assert moved.slopes["m"] == pytest.approx(wanted, rel=1e-9)
    assert moved.slopes["d"] == pytest.approx(found["d"] / (zbar_c + z_f), rel=1e-9)
    assert moved.spread("m") < 1.0 < moved.spread("k")
    for name in found.estimate.names:
        low, high = moved.intervals[name]
        assert low <= found[name] - 1.959 * found.std_error(name)
        assert high >= found[name] + 1.959 * found.std_error(name)
    assert "identifiable whatever the choice" in str(moved)


@pytest.mark.slow
def test_slopes_at_the_truth_are_those_of_the_thesis(family):
    """Section 8.6, per metre of z_f: k -238.0 N m/rad, A_x -0.0618 kg m^2, and so on."""
    names = [n for n in TRUTH if n != "z_f"]
    values = {**V, "zbar_m_calibration": -0.172, "m_calibration": 0.2}
    moved = along_family(family, values, names, np.zeros((8, 8)), BOUNDS)
    wanted = {
        "k": -238.0, "A_x": -0.0618, "d": -1.0335, "K_r": 2.5, "K_vdot": -19.45,
        "K_delta": 2.025, "m": -0.0952, "zbar_m": 0.0,
    }  # fmt: skip
    for name, slope in wanted.items():
        assert moved.slopes[name] == pytest.approx(slope, rel=2e-3, abs=1e-12)


@pytest.mark.slow
def test_an_estimate_with_another_choice_is_the_image_along_the_family(three, found, family):
    """Values and standard errors of a fit with z_f elsewhere, from this one without any data.

    Both rest on instruments simulated with their own estimate, which differ a little.
    """
    moved = along(found.estimate, family)
    elsewhere = 0.5 * (moved.at + moved.lower)
    again = fit(ALL.with_known(z_f=elsewhere), three).estimate
    values = family_values(found.estimate)
    there = along_family(
        family, values | {"z_f": moved.at}, found.estimate.names, found.estimate.covariance,
        {**BOUNDS, "z_f": (elsewhere, moved.at)},
    )  # fmt: skip
    for name in again.names:
        ends = np.array(there.ranges[name])
        nearest = ends[np.argmin(np.abs(ends - again[name]))]
        assert abs(again[name] - nearest) < 0.2 * again.std_error(name)


def test_what_cannot_be_moved_along_is_refused_with_the_mend(found, family):
    values, names = family_values(found.estimate), found.estimate.names
    covariance = found.estimate.covariance
    with pytest.raises(IdentifiabilityError, match="one has to"):
        along_family(family, values, [*names, "z_f"], np.eye(9), BOUNDS)
    with pytest.raises(IdentifiabilityError, match="give them"):
        along_family(family, values, names, covariance, {"k": (0.0, 50.0)})
    short = {k: v for k, v in values.items() if k != "zbar_m_calibration"}
    with pytest.raises(IdentifiabilityError, match="needs a value of zbar_m_calibration"):
        along_family(family, short, names, covariance, BOUNDS)
    with pytest.raises(IdentifiabilityError, match="widen them"):
        along_family(family, values, names, covariance, {**BOUNDS, "d": (1.0, 2.0)})


def test_a_program_that_the_solver_leaves_early_is_finished_by_least_squares(three):
    """Eliminated, Ipopt's squares lose half of the digits here; both forms have one optimum.

    Instruments are simulated with the estimate, so both are compared in units of its errors.
    """
    model = ALL.with_known(z_f=-0.04)
    lifted = fit(model, three)
    eliminated = fit(model, three, dataclasses.replace(SETTINGS, form="eliminated", solver=None))
    for name in lifted.estimate.names:
        assert abs(eliminated[name] - lifted[name]) < 0.01 * lifted.std_error(name)
