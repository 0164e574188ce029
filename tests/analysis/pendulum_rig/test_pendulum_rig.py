"""The study of the laboratory rig: its shortcuts are exact, its maps invert, its claims hold."""

from __future__ import annotations

import math
import tomllib

import numpy as np
import pytest

from analysis.pendulum_rig import estimators
from analysis.pendulum_rig.estimators import FREE, INSTRUMENTS, MODEL, TRUTH, joint, staged
from analysis.pendulum_rig.records import TS, Draws, torque_response
from analysis.pendulum_rig.robustness import amplitudes, crossing, stiffening
from analysis.pendulum_rig.runs import Coverage
from analysis.pendulum_rig.tables import PUBLISHED, PUBLISHED_FITS, PUBLISHED_VALUES
from casid.estimation.moments.validation import validate
from casid.linear.sampled.difference_equation import difference_equation
from problems import pendulum_rig as rig
from tests.support.shared import ROOT

ERRORS = {"m": 0.0045, "z_m": 0.0032}
"""Standard errors of ten-minute records, of the study's Table 7.5."""


@pytest.fixture(scope="module")
def draws() -> Draws:
    return Draws(240.0, seed=2)


@pytest.fixture(scope="module")
def run(draws):
    return draws.experiments(np.random.default_rng(4))


@pytest.fixture(scope="module")
def stages(run):
    return staged()(run)


# -- records -------------------------------------------------------------------------------------


def test_a_disturbance_adds_what_the_nonlinear_pendulum_adds() -> None:
    """Superposition: the linear response to a periodic torque against the difference of two
    Runge-Kutta runs, in the second period of 40 s. The transient has fallen to exp(-40 d/(2 I_1))
    = 3e-4 by then; angles below 0.1 rad leave the linear pendulum by phi^2/2 = 0.5 % of the
    resonance's frequency, times 40 samples of phase in a time constant: 5 % allowed."""
    n = round(40.0 / rig.STEP)
    half = rig.STEP / 2 * np.arange(2 * n)
    rng = np.random.default_rng(1)
    torque = rig.dragged(half, 0.003, rng)
    a_y = rig.dragged(half, 0.2, rng)
    twice = [np.append(np.tile(x, 2), x[0]) for x in (a_y, torque)]
    plant = rig.Pendulum()
    moved = plant.motion(twice[0], twice[1], rig.STEP)
    alone = plant.motion(twice[0], 0 * twice[1], rig.STEP)
    every = round(TS / rig.STEP)
    added = (moved - alone)[1][n : 2 * n : every]
    expected = torque_response(plant, torque[:: 2 * every], TS)["gyro"]
    assert np.abs(moved[0]).max() < 0.15
    np.testing.assert_allclose(added, expected, atol=0.05 * np.abs(expected).max())


@pytest.mark.slow
def test_drawn_noise_has_the_power_that_the_filter_leaves(draws) -> None:
    """White noise of 0.007 rad/s behind 41 taps: sd 0.007 ||h||. 12 000 samples that remember
    about 8 each: relative error of the sd 1/sqrt(2 x 1500) = 1.8 %, four of them."""
    quiet = Draws(240.0, torque=0.0, seed=2)
    clean = quiet.experiments()
    noisy = quiet.experiments(np.random.default_rng(1))
    taps = np.convolve(draws._filter.taps, draws._filter.taps)
    for a, b in zip(clean, noisy, strict=True):
        sd = np.std(b.record["gyro"] - a.record["gyro"])
        assert sd == pytest.approx(0.007 * np.linalg.norm(taps), rel=0.075)


def test_a_run_is_the_same_for_the_same_seed(draws) -> None:
    first, again = (draws.experiments(np.random.default_rng(9)) for _ in range(2))
    for a, b in zip(first, again, strict=True):
        for name in a.record.names:
            np.testing.assert_array_equal(a.record[name], b.record[name])


# -- maps ----------------------------------------------------------------------------------------


def test_the_maps_of_the_clouds_invert_the_regression() -> None:
    """(7.36)-(7.38) with E-12 at the theta that the model's own g gives."""
    equation = difference_equation(MODEL, "gyro", TS)
    known = {n: p.value or 0.0 for n, p in MODEL.parameters.items()}
    nominal = equation.theta({**known, **TRUTH, "m": 0.0})
    loaded = equation.theta({**known, **TRUTH, "I_xm": rig.TABLES_7_3_AND_7_4["I_xm"]})
    I_x, d, k = estimators.nominal_map(nominal[None], TS)
    m, z_m = estimators.loaded_map(loaded[None], I_x, k, TS)
    found = dict(zip(FREE, (I_x, d, k, m, z_m), strict=True))
    for name, value in found.items():
        assert value[0] == pytest.approx(TRUTH[name], rel=1e-8)


def test_a_cloud_is_as_wide_as_the_standard_error_where_the_map_is_mild(stages) -> None:
    """20 000 draws: 0.5 % of the spread; curvature at 10 % of m adds some per cent."""
    for propagated in (True, False):
        m, z_m = estimators.cloud(stages, propagated=propagated, n=20_000)
        for name, draw in (("m", m), ("z_m", z_m)):
            se = stages.std_error(name, propagated=propagated)
            assert np.std(draw) == pytest.approx(se, rel=0.1)
            assert abs(np.median(draw) - stages[name]) < 0.1 * se


def test_errors_of_products_follow_from_draws(stages) -> None:
    draws = np.random.default_rng(1).multivariate_normal(
        [stages[n] for n in stages.names], stages.covariance, 40_000, method="eigh"
    )
    m, z_m = (draws[:, stages.names.index(n)] for n in ("m", "z_m"))
    errors = estimators.derived_errors(stages)
    assert np.std(m * z_m) == pytest.approx(errors["m z_m"], rel=0.1)
    assert np.std(m * z_m**2) == pytest.approx(errors["m z_m^2"], rel=0.15)


# -- claims --------------------------------------------------------------------------------------


def test_without_noise_the_bilinear_transform_alone_moves_the_estimates(draws) -> None:
    """Its offset at the resonance to a quarter: the band is 0.3 to 3 Hz wide."""
    clean = staged()(draws.experiments())
    for name, offset in estimators.bilinear_offset(TS).items():
        assert clean[name] - TRUTH[name] == pytest.approx(offset, rel=0.25)
    for name in ("m", "z_m"):
        assert clean[name] == pytest.approx(TRUTH[name], rel=0.01)


def test_stages_and_joint_agree_and_the_load_needs_the_first_steps_error(run, stages) -> None:
    together = joint()(run)
    for name in FREE:
        se = max(stages.std_error(name), together.std_error(name))
        assert abs(stages[name] - together[name]) < 3 * se
    assert stages.std_error("m") == pytest.approx(together.std_error("m"), rel=0.1)
    assert stages.std_error("m") > 1.3 * stages.std_error("m", propagated=False)


def test_simulation_with_true_parameters_misses_what_the_bilinear_transform_moves(draws) -> None:
    """Trap T-6 at a resonance of 1.5 % damping: (w T)^2/12 = 0.7 % of frequency is half a width.
    Straight lines between samples do not warp it."""
    base = {n: p.value or 0.0 for n, p in MODEL.parameters.items()}
    clean = draws.experiments()
    warped, straight = (
        validate(MODEL, {**base, **TRUTH}, clean, INSTRUMENTS, method=method)
        for method in ("bilinear", "foh")
    )
    for case in ("nominal", "loaded"):
        assert warped[case, "gyro"].fit < 85
        assert straight[case, "gyro"].fit > 95


@pytest.mark.slow
def test_springs_that_stiffen_raise_k_as_bussgang_has_it() -> None:
    """k (1 + 3 kappa sigma^2), to twice the 13 % by which five minutes' fourth moment is off."""
    (row,) = stiffening([0.25], ERRORS, duration=300.0)
    assert row.predicted_k == pytest.approx(3 * 0.25 * row.angle**2)
    assert row.k == pytest.approx(row.predicted_k, rel=0.26)


def test_with_linear_springs_elimination_leaves_nothing_of_the_nonlinearity() -> None:
    """(7.24) holds at any angle; the direct model (7.10) is a linearisation."""
    small, large = amplitudes([0.125, 2.0], ERRORS, duration=90.0)
    assert large.angle > 0.25
    assert max(abs(large.m), abs(large.z_m)) < 0.2
    assert max(abs(large.direct_m), abs(large.direct_z_m)) > 3
    assert large.fit_gyro < small.fit_gyro - 10


def test_a_crossing_is_found_between_two_points_or_nowhere() -> None:
    assert crossing([1.0, 2.0], [0.5, -2.5]) == pytest.approx(1.25)
    assert crossing([1.0, 2.0], [0.5, 0.9]) == math.inf


def test_coverage_is_judged_by_its_binomial_spread() -> None:
    right = Coverage("stages", "m", 100, 1.0, 1.0, 0.95)
    assert right.is_right
    assert right.expected == pytest.approx(0.95, abs=1e-4)
    narrow = Coverage("stages", "m", 100, 1.6, 1.0, 0.78)
    assert not narrow.is_right
    assert narrow.expected == pytest.approx(0.779, abs=1e-3)


def test_published_numbers_agree_with_the_table_of_published_answers() -> None:
    """And with one another: E-16's entries follow from m and z_m to the printed digits."""
    table = tomllib.loads((ROOT / "tests" / "published.toml").read_text(encoding="utf-8"))
    theirs = table["pendulum_laboratory"]
    for key, name in (("multi_stage", "multi-stage (7.58)"), ("joint", "joint (7.58)")):
        for quantity, error in theirs[key]["error_percent"].items():
            assert PUBLISHED[name][quantity] == error
            assert PUBLISHED_VALUES[name][quantity] == theirs[key]["estimate"][quantity]
    fits = theirs["joint"]["validation_fit_percent"]
    assert list(PUBLISHED_FITS.values()) == list(fits.values())
    for row in PUBLISHED_VALUES.values():
        assert row["m z_m"] == pytest.approx(row["m"] * row["z_m"], abs=0.6e-4)
        assert row["m z_m^2"] == pytest.approx(row["m"] * row["z_m"] ** 2, abs=0.6e-4)
