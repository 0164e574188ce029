"""Section 8.6 in short: every start reaches the family; what mends it brings it to the truth."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from analysis.common.targets import Target
from analysis.ship_initial_values import study
from analysis.ship_initial_values.figures import cloud, cost_map
from analysis.ship_initial_values.records import TS, matrices, of_case, record
from analysis.ship_initial_values.runs import (
    BOUNDS,
    SLOPES,
    Ends,
    Program,
    Setting,
    admissible,
    equations,
    family,
    inertia,
    program,
    run,
    starts,
    theta,
    true_values,
    trust_region,
)
from problems.ship import NINE, TABLE_8_2, Roll

TRUTH = np.array([TABLE_8_2[n] for n in NINE])


@pytest.fixture(scope="module")
def nine() -> Program:
    return program(study.THE_NINE)


@pytest.fixture(scope="module")
def ends() -> Ends:
    return run(study.THE_NINE, 12)


# -- records ---------------------------------------------------------------------------------------


def test_the_ship_has_the_poles_of_the_corrected_table():
    """With the signs of Y_|u|v and N_|u|r that Table 8.2 lost, sway and yaw are stable."""
    poles = np.linalg.eigvals(matrices(of_case("nominal"))[0])
    for wanted in (-2.971, -0.334, -0.697 + 5.241j, 0.0):
        assert np.min(np.abs(poles - wanted)) < 1e-3


@pytest.mark.parametrize("case", ["nominal", "loaded"])
def test_the_simulator_obeys_the_roll_equation_of_the_problem(case):
    """Its matrices and the transfer functions of problems/ship.py are written down apart.

    A complex exponential: phi, v' and r of (8.3), driven by the rudder, obey (8.10).
    """
    load = of_case(case)
    A, B = matrices(load)
    for w in (0.5, 3.0, 7.0):
        x = np.linalg.solve(1j * w * np.eye(5) - A, B)
        one = np.array([w]), np.array([1j * w * x[2]]), np.array([x[4]]), np.array([1.0])
        assert Roll(**load).angle(*one)[0] == pytest.approx(x[0], rel=1e-12)


@pytest.mark.parametrize("case", ["nominal", "calibration", "second calibration", "loaded"])
def test_trapezoidal_records_obey_the_difference_equation_with_the_true_coefficients(case):
    """The trapezoidal rule is the bilinear map: (8.57) holds to rounding of the largest signal."""
    signals = record(case, duration=10.0)
    e = equations(case).equation
    columns = np.column_stack([c.samples(signals, 2) for c in e.columns])
    error = e.left.samples(signals, 2) - columns @ theta(true_values(case))
    assert np.abs(error).max() < 1e-13


def test_runge_kutta_agrees_with_the_exact_step_of_a_held_rudder():
    """The matrix exponential is exact where the input is constant between samples.

    Steps of h = 5 ms at 5.3 rad/s err by (w h)^4/120, 4e-9 of the signal.
    """
    from scipy.linalg import expm

    signals = record("nominal", integrator="zoh", duration=4.0)
    A, B = matrices(of_case("nominal"))
    step = expm(np.block([[A, B[:, None]], [np.zeros((1, 6))]]) * TS)
    x = np.zeros(5)
    for t, delta in enumerate(signals["delta"]):
        assert signals["gyro"][t] == pytest.approx(x[3], abs=1e-8)
        x = step[:5, :5] @ x + step[:5, 5] * delta


def test_samples_taken_more_often_are_of_the_same_rudder():
    coarse, fine = (record("nominal", integrator="foh", duration=4.0, finer=k) for k in (1, 2))
    np.testing.assert_allclose(fine["delta"][::2], coarse["delta"], atol=1e-15)
    np.testing.assert_allclose(fine["gyro"][::2], coarse["gyro"], atol=1e-8)


# -- the family ------------------------------------------------------------------------------------


def test_one_calibration_leaves_one_direction_and_the_slopes_of_the_digest(nine):
    """Rank 8 of 9 coefficients' slopes; the null vector has the published slopes."""
    scaled = nine.slopes(TRUTH) * np.abs(TRUTH)
    _, s, vt = np.linalg.svd(scaled)
    assert s[-1] < 1e-14 * s[0]
    assert s[-2] > 1e-5 * s[0]
    null = vt[-1] * np.abs(TRUTH)
    null /= null[NINE.index("z_f")]
    for name, slope in zip(NINE, null, strict=True):
        assert slope == pytest.approx(SLOPES[name], rel=1e-3, abs=1e-6)


def test_the_family_has_one_set_of_coefficients_within_the_bounds(nine):
    low, high = admissible()
    members = family(np.linspace(low, high, 20))
    for x in np.column_stack([members[n] for n in NINE]):
        np.testing.assert_allclose(nine.coefficients(x), nine.true_coefficients, atol=1e-13)
        for value, name in zip(x, NINE, strict=True):
            assert BOUNDS[name][0] <= value <= BOUNDS[name][1]
    assert members["m"].min() == pytest.approx(0.3995, abs=1e-4)
    assert members["m"].max() == pytest.approx(0.4058, abs=1e-4)


def test_the_slopes_of_a_program_are_its_differences(nine):
    """Central differences, error h^2 and rounding/h."""
    for i, name in enumerate(NINE):
        h = 1e-6 * abs(TABLE_8_2[name])
        beside = [TRUTH + sign * h * np.eye(9)[i] for sign in (1, -1)]
        for value, slope in (
            (nine.coefficients, nine.slopes),
            (nine.residual, nine.residual_slopes),
        ):
            found = (value(beside[0]) - value(beside[1])) / (2 * h)
            np.testing.assert_allclose(slope(TRUTH)[:, i], found, rtol=1e-5, atol=1e-7)


# -- the starts ------------------------------------------------------------------------------------


def test_starts_fill_the_bounds_and_are_those_of_every_setting():
    drawn = starts(study.THE_NINE, 500)
    for column, name in zip(drawn.T, NINE, strict=True):
        low, high = BOUNDS[name]
        assert low <= column.min() < low + 0.02 * (high - low)
        assert high - 0.02 * (high - low) < column.max() <= high
    kept = starts(study.Z_F_KNOWN, 500)
    np.testing.assert_array_equal(kept, np.delete(drawn, NINE.index("z_f"), axis=1))


def test_every_start_reaches_the_family(ends):
    """The issue's distance; the formula of the family at the z_f that was found."""
    assert ends.is_optimal.all()
    assert ends.distance.max() < 1e-8
    np.testing.assert_allclose(ends["zbar_m"], -0.182, atol=1e-9)
    members = family(ends["z_f"])
    for n in NINE:
        np.testing.assert_allclose(ends[n], members[n], rtol=1e-6, atol=1e-9)
    assert np.ptp(ends["z_f"]) > 1e-3


def test_a_start_beyond_the_pole_ends_in_a_corner_and_is_mirrored_to_the_family(nine):
    """A_2 < 0 (8.18) there; all nine stand at a bound, a local optimum, whatever the optimiser."""
    corner = np.array([0.0, 0.0, 0.0, -10.0, 10.0, -1.0, 1.0, 1.0, -0.5])
    start = starts(study.THE_NINE, 2000)[1867]
    assert nine.inertias(start).max() < 0
    alone = nine.nlp(100).solve(nine.data, nine.values, start.tolist(), throw=False)
    np.testing.assert_allclose(alone.x, corner, atol=2e-3)  # what the barrier leaves
    solution, _, mirrored = nine.solve(start)
    assert mirrored
    assert solution.is_converged
    assert np.max(np.abs(nine.coefficients(solution.x) - nine.true_coefficients)) < 1e-8


def test_the_sign_of_the_inertia_is_seen_without_physics():
    """K_delta <= 0 by its bounds, and gamma1 = K_delta/A_2 < 0 in the linear fit of each record."""
    for case in ("nominal", "calibration", "second calibration", "loaded"):
        e = equations(case)
        _, b = e.equation.continuous(e.unconstrained())
        assert b["delta"][1] < 0
        true = true_values(case)
        assert inertia(true) == pytest.approx(true["K_delta"] / b["delta"][1], rel=1e-7)


def test_a_fixed_parameter_brings_every_start_to_the_truth():
    for fixed in ("z_f", "K_delta"):
        found = run(Setting(fixed=(fixed,), allowed=120), 6)
        assert found.is_optimal.all()
        assert found.relative_error().max() < 1e-6


def test_a_second_calibration_at_another_height_brings_every_start_to_the_truth():
    found = run(study.SECOND_HEIGHT, 6)
    assert found.is_optimal.all()
    assert found.relative_error().max() < 1e-6


@pytest.mark.slow
def test_runs_are_the_same_in_any_number_of_processes(ends):
    assert len(ends.x) == 12
    few = run(study.THE_NINE, 12, jobs=2)
    np.testing.assert_array_equal(few.x, ends.x)


def test_a_second_optimiser_ends_elsewhere_on_the_family(nine, ends):
    found = trust_region(study.THE_NINE, 4)
    for x in found:
        assert np.max(np.abs(nine.coefficients(x) - nine.true_coefficients)) < 1e-8
    z_f = NINE.index("z_f")
    assert np.max(np.abs(found[:, z_f] - ends.x[:4, z_f])) > 1e-3


# -- what is printed and drawn ---------------------------------------------------------------------


@pytest.mark.slow
def test_numbers_of_the_chapter_and_the_refusal_of_the_nine_are_met(capsys):
    targets = [*study.known_numbers(), *study.ranks(), *study.curvature()]
    assert [t.what for t in targets if not t.is_met] == []
    said = capsys.readouterr().out
    assert "rank 14 of 15" in said
    assert "give one of them a known value" in said


@pytest.mark.slow
def test_the_study_ends_with_its_targets_and_figures(tmp_path: Path, monkeypatch):
    """A handful of starts: every target that does not need thousands; the ranks have a test."""
    monkeypatch.setattr(study, "ranks", lambda: iter(()))
    monkeypatch.setattr(study, "QUICK", study.Extent(4, 2, 2, 2, 2, False))
    out = tmp_path / "new"
    assert study.STUDY.main(["--quick", "--jobs", "1", "--out", str(out)]) == 0
    told = json.loads((out / "targets.json").read_text(encoding="utf-8"))
    assert all(t["is_met"] for t in told)
    for name in ("figure_8_10_cost_map.html", "ends_on_the_family.html", "ends.csv"):
        assert (out / name).stat().st_size > 100


def test_a_missed_target_is_an_exit_of_one(monkeypatch):
    def missed(*_: object) -> list[Target]:
        return [Target("a", "1", "2", False)]

    monkeypatch.setattr(study, "study", missed)
    assert study.STUDY.main([]) == 1


def test_figures_show_the_valley_and_the_curve(nine, ends):
    valley = cost_map(nine, n=41)
    z = np.asarray(valley.data[0].z)
    row, column = np.unravel_index(np.argmin(z), z.shape)
    assert valley.data[0].x[column] == pytest.approx(TABLE_8_2["m"], abs=0.02)
    assert valley.data[0].y[row] == pytest.approx(TABLE_8_2["zbar_m"], abs=0.02)
    clouds: Mapping[str, np.ndarray] = {"nine": ends.nine}
    drawn = cloud(clouds)
    assert len(drawn.data) == 3 * (len(NINE) - 1)
    assert {t.name for t in drawn.data} >= {"the family", "truth"}
