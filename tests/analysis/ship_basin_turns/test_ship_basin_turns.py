"""Turns of the nonlinear ship: what makes residuals, how rolls decay, how the ship leans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis.ship_algorithm.records import SIDEWAYS, TS, load
from analysis.ship_algorithm.study import EIGHT, TRUTH
from analysis.ship_basin_turns.decay import identified, kicked
from analysis.ship_basin_turns.records import (
    NONLINEAR,
    SHIPS,
    changes,
    long_sets,
    near_changes,
    s_turn,
    switched_off,
    u_turn,
)
from analysis.ship_basin_turns.residuals import (
    equation_errors,
    missing_torques,
    predicted_errors,
    spikes,
    with_torques,
)
from analysis.ship_basin_turns.short_sets import (
    critical_height,
    lean_at,
    linear_turn,
    simulated_turn,
)
from analysis.ship_basin_turns.speed import at_speed, drop
from analysis.ship_basin_turns.steady_turn import steady_turn
from casid.errors import ModelError
from problems.ship_4dof import linearised

NOMINAL = load("nominal")


@pytest.fixture(scope="module")
def sets():
    return long_sets(duration=60.0, angle=0.3, cases=("nominal",))


# -- rudder and ships ------------------------------------------------------------------------------


def test_short_sets_have_one_turn_or_two():
    for command, times in ((u_turn(0.2), [4.0, 12.0]), (s_turn(0.2), [4.0, 8.0, 12.0])):
        assert len(command) * TS == pytest.approx(20.0)
        np.testing.assert_allclose(TS * changes(command), times)
    near = near_changes(u_turn(0.2), 1.0, before=0.5)
    assert near.sum() * TS == pytest.approx(2 * 1.5)


def test_a_ship_without_its_nonlinear_terms_has_the_same_linear_model():
    """What is switched off has no slope on a straight course, but the resistance."""
    plain = switched_off(SIDEWAYS, *NONLINEAR)
    np.testing.assert_allclose(linearised(ship=plain).A, linearised(ship=SIDEWAYS).A)
    motion = simulated_turn(0.2, "nominal", ship=plain)[0].motion
    assert np.ptp(motion["u"]) < 0.01 < np.ptp(simulated_turn(0.2, "nominal")[0].motion["u"])


def test_what_cannot_be_switched_off_is_refused_with_the_names():
    with pytest.raises(ModelError, match="choose from cross flow in roll"):
        switched_off(SIDEWAYS, "wind")


# -- residuals -------------------------------------------------------------------------------------


def test_the_missing_terms_are_the_residual_at_the_true_parameters(sets):
    """(1): what they leave is the bilinear rule's own error, which a linear ship has too."""
    experiments = [with_torques(s) for s in sets]
    error = equation_errors(EIGHT, experiments, TRUTH)["nominal"]
    parts = predicted_errors(EIGHT, experiments, TRUTH)["nominal"]
    left = error - sum(parts.values())
    linear = long_sets(duration=60.0, angle=0.3, cases=("nominal",), ship=SHIPS["none of them"])
    rule = equation_errors(EIGHT, [s.experiment for s in linear], TRUTH)["nominal"]
    assert np.std(left) < 1.5 * np.std(rule) < 0.5 * np.std(error)
    assert set(parts) == set(missing_torques(sets[0]))


def test_the_speed_makes_the_spikes(sets):
    """The largest error near changes is that of K_r (u - U) r; without speed drop, no spikes."""
    experiments = [with_torques(s) for s in sets]
    parts = predicted_errors(EIGHT, experiments, TRUTH)["nominal"]
    size = {k: spikes(sets, experiments, {"nominal": e}).near for k, e in parts.items()}
    assert max(size, key=lambda k: size[k]) == "speed in K_r r"
    held = long_sets(duration=60.0, angle=0.3, cases=("nominal",), ship=SHIPS["speed held"])
    found = [
        spikes(s, [e.experiment for e in s], equation_errors(EIGHT, [s[0].experiment], TRUTH))
        for s in (sets, held)
    ]
    assert found[1].near < 0.5 * found[0].near
    assert found[0].ratio > 1.5 > found[1].ratio


# -- damping ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("ship", "differs"), [("all terms", True), ("none of them", False)])
def test_roll_decay_in_a_turn_and_after_it_is_that_of_the_simulators_terms(ship, differs):
    """Seven windows of 3 s each; with the nonlinear terms off the two decays are one."""
    record = kicked(SHIPS[ship], turning=30.0)
    turn = identified(record, "in the turn", noise=0.002, seed=1)
    after = identified(record, "after it", noise=0.002, seed=2)
    for found in (turn, after):
        assert abs(found.found - found.expected) < 3.5 * found.std_error
    error = np.hypot(turn.std_error, after.std_error)
    assert (abs(after.found - turn.found) > 5 * error) == differs


def test_a_steady_turn_stays_and_its_linear_motion_begins_with_that_of_a_straight_course():
    """Poles at zero rudder are those of (8.3) and the surge's own, 2 X_uu U/(M - X_udot)."""
    straight = steady_turn(0.0, ship=SIDEWAYS, load=NOMINAL)
    own = [z for z in linearised(ship=SIDEWAYS).poles() if z != 0.0]
    c = SIDEWAYS.coefficients
    surge = 2 * c.X_uu / SIDEWAYS.mass_matrix()[0, 0]
    np.testing.assert_allclose(
        np.sort_complex(straight.poles), np.sort_complex([*own, surge]), atol=1e-6
    )
    # v|v| and its kind: the turn departs from the linear one by the first power of the rudder
    away = [
        steady_turn(d, ship=SIDEWAYS, load=NOMINAL).state["phi"] / linear_turn(d, "nominal").phi - 1
        for d in (1e-3, 2e-3)
    ]
    assert away[1] / away[0] == pytest.approx(2.0, rel=0.05)


# -- lean and speed --------------------------------------------------------------------------------


def test_the_ship_leans_inwards_at_the_entry_and_further_outwards_at_the_exit():
    """A zero in the right half-plane; with the rudder above z_r* it is gone."""
    sailed, _ = simulated_turn(0.05, "nominal")
    for which, side in ((0, 1.0), (1, -1.0)):
        lean = lean_at(sailed, which)
        (t, phi), (t_theory, theory) = lean.first(lean.phi), lean.first(lean.linear)
        assert side * phi > 0.0
        assert t == pytest.approx(t_theory, abs=0.021)
        assert phi == pytest.approx(theory, rel=0.05)
    c = replace(SIDEWAYS.coefficients, z_r=2 * critical_height(SIDEWAYS))
    raised = simulated_turn(0.05, "nominal", ship=replace(SIDEWAYS, coefficients=c))[0]
    lean = lean_at(raised, 0)
    assert lean.first(lean.phi)[1] < 0.0


def test_the_surge_speed_follows_the_rudder_behind_its_own_lag(sets):
    found = drop(sets[0])
    assert found.lowest < 0.9
    assert found.after_lag < -0.8 < found.at_once


def test_at_speed_multiplies_the_yaw_rate(sets):
    e = at_speed(sets[0], sets[0]["u"])
    np.testing.assert_allclose(e.record["r"], sets[0].experiment.record["r"] * sets[0]["u"])
