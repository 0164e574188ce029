"""The autopilot of the simulated ship, and forces that depend on her heading."""

from __future__ import annotations

import math

import numpy as np
import pytest

from casid.errors import DataError
from problems.ship_4dof import HeadingAutopilot, Load, Ship, Start, by_heading, linearised, simulate
from problems.ship_simulator.waves import Jonswap, Wind, sample_sea


def test_a_course_is_held_against_a_yaw_torque_with_the_error_of_theory():
    """At rest on a course r = p = 0, so delta_s = K_p e: the PD's error is delta_s/K_p.

    delta_s solves the three balances of the linear model, 0 = F x + F_delta delta + T tau, in phi,
    v and delta. What is not linear is of relative size v = 1e-3, as is the loss of speed.
    """
    N, torque, course = 3000, 0.005, 0.3
    autopilot = HeadingAutopilot(K_p=0.8, K_d=0.6)
    forces = np.tile([0.0, 0.0, 0.0, torque], (N, 1))
    motion = simulate(np.zeros(N), forces=forces, autopilot=autopilot, course=course, substeps=2)
    linear, rows = linearised(), [2, 3, 4]
    matrix = np.column_stack([linear.F[rows, 0], linear.F[rows, 2], linear.F_delta[rows]])
    _, _, steady = np.linalg.solve(matrix, -torque * linear.T[rows, 2])
    error = motion["psi"][-1] - course
    assert error == pytest.approx(steady / 0.8, rel=1e-2)
    assert motion["delta"][-1] == pytest.approx(0.8 * error, rel=1e-6)
    assert abs(motion["r"][-1]) < 1e-6
    assert error > 0.0  # the torque is to starboard


def test_the_shorter_way_round_is_taken_and_limits_hold():
    """From 350 to 10 deg by starboard, though the number 10 is the smaller."""
    start, goal = math.radians(350.0), math.radians(10.0)
    limited = HeadingAutopilot(K_p=5.0, K_d=1.0, limit=math.radians(8.0))
    motion = simulate(
        np.zeros(2000), start=Start(psi=start), autopilot=limited, course=goal, substeps=2
    )
    assert motion["psi"][-1] == pytest.approx(goal + 2 * math.pi, abs=1e-2)
    assert np.abs(motion["delta"]).max() == pytest.approx(math.radians(8.0), rel=1e-9)
    rate = np.abs(np.diff(motion["delta"])).max() / motion.Ts
    assert rate <= Ship().rudder.rate * (1 + 1e-9)


def test_a_steered_motion_goes_on_from_its_end():
    """The autopilot keeps nothing: what it asks for depends on the sample alone."""
    command = np.zeros(200)
    course = np.where(np.arange(200) < 80, 0.0, 0.2)
    own = {"autopilot": HeadingAutopilot(), "substeps": 2}
    whole = simulate(command, course=course, **own)
    first = simulate(command[:111], course=course[:111], **own)
    then = simulate(command[110:], course=course[110:], start=first.end, **own)
    np.testing.assert_array_equal(whole.states[110:], then.states)


def test_what_steers_away_is_refused():
    with pytest.raises(DataError, match=r"K_p = -1.0.*Give K_p > 0"):
        HeadingAutopilot(K_p=-1.0)
    with pytest.raises(DataError, match="no autopilot to hold it. Give autopilot="):
        simulate(np.zeros(10), course=0.1)
    with pytest.raises(DataError, match=r"\(10, 4, 2\).*by_heading"):
        simulate(np.zeros(10), forces=np.zeros((10, 4, 2)))
    with pytest.raises(DataError, match="m = nan kg.*Give finite numbers"):
        Load(math.nan)


def test_forces_by_heading_are_those_of_each_heading():
    """Waves depend on the heading by its cosine, sine and those of twice it: exactly."""
    t = 0.02 * np.arange(50)
    sea = sample_sea(Jonswap(0.02, 4.0), (2.0, 12.0), seed=1, n=20, U=1.0, beta=1.1)
    forces = by_heading(lambda turn: sea.forces(t, turn=turn), course=0.4)
    start = Start(psi=0.9)
    motion = simulate(np.zeros(50), forces=forces, start=start, substeps=1)
    np.testing.assert_allclose(motion.forces[0], sea.forces(t, turn=0.5)[0], atol=1e-12)
    for k in (10, 49):
        turn = float(motion["psi"][k]) - 0.4
        np.testing.assert_allclose(motion.forces[k], sea.forces(t, turn=turn)[k], atol=1e-12)
    on_course = by_heading(lambda turn: sea.forces(t))  # the same from every side
    plain = simulate(np.zeros(50), forces=sea.forces(t), substeps=1)
    again = simulate(np.zeros(50), forces=on_course, substeps=1)
    np.testing.assert_allclose(again.states, plain.states, atol=1e-12)


def test_a_ship_that_turns_has_the_wind_from_another_side():
    wind = Wind(5.0, beta=math.pi / 2)
    ahead = wind.forces(2, 0.1, U=1.0, seed=1)
    turned = wind.forces(2, 0.1, U=1.0, seed=1, turn=math.pi / 2)
    assert ahead[0, 1] > 0.0
    assert turned[0, 1] == pytest.approx(0.0, abs=1e-12)
    assert turned[0, 0] > ahead[0, 0]
