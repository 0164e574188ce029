"""The inertial unit reads what a body at its place, turned as it is, would feel."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from casid.errors import DataError
from problems import ship
from problems.ship_4dof import LOAD_CASES, Motion, Ship, rotation, simulate, zigzag
from problems.ship_simulator.sensors import (
    UNITS,
    Channel,
    InertialUnit,
    for_roll,
    measure,
    specific_force,
    true_signals,
)

PERFECT = InertialUnit().without_noise()


@pytest.fixture(scope="module")
def motion() -> Motion:
    """A zigzag of the loaded ship, heeled by a torque besides."""
    command = zigzag(6.0, angle=0.4, every=1.5)
    forces = np.zeros((command.size, 4))
    forces[:, 2] = 0.6 * np.sin(5.0 * 0.02 * np.arange(command.size))
    return simulate(command, load=LOAD_CASES["loaded"], forces=forces)


# -- what it feels -------------------------------------------------------------------------------


class Course:
    """A made-up motion with smooth velocities; no gravity, so that its attitude is its own."""

    def __init__(self, t, g=0.0):
        self.ship, self.Ts, self.warnings = SimpleNamespace(z_f=-0.028, g=g), t[1] - t[0], ()
        self.signals = {"phi": 0.3 * np.sin(t), "delta": 0.0 * t}
        for i, name in enumerate("uvpr"):
            w = 2.0 + i
            self.signals[name] = 0.5 * np.sin(w * t + i) + 0.2
            self.signals[f"{name}_dot"] = 0.5 * w * np.cos(w * t + i)

    def __getitem__(self, name):
        return self.signals[name]


def test_the_specific_force_is_the_acceleration_of_the_units_place():
    """R' = R S(w), x' = R v integrated; the place x + R r_s differentiated twice; turned back.

    Central differences of h = 2 ms: h^2/12 of a fourth derivative of some 200 m/s^4.
    """
    h, unit = 0.002, InertialUnit(zbar_s=-0.3, x_s=0.15, y_s=0.1)
    t = h * np.arange(500)

    def rates(s, z):
        (u, v, p, r), R = (
            (0.5 * np.sin((2.0 + i) * s + i) + 0.2 for i in range(4)),
            z[3:].reshape(3, 3),
        )
        S = np.array([[0.0, -r, 0.0], [r, 0.0, -p], [0.0, p, 0.0]])
        return np.concatenate([R @ [u, v, 0.0], (R @ S).ravel()])

    z = solve_ivp(
        rates, (0, t[-1]), [0, 0, 0, *np.eye(3).ravel()], "DOP853", t, rtol=1e-13, atol=1e-13
    ).y
    R = z[3:].T.reshape(-1, 3, 3)
    place = z[:3].T + R @ [0.15, 0.1, -0.3 - 0.028]
    a = (place[2:] - 2 * place[1:-1] + place[:-2]) / h**2
    turned_back = np.einsum("nji,nj->ni", R[1:-1], a)
    np.testing.assert_allclose(specific_force(Course(t), unit)[1:-1], turned_back, atol=1e-4)


def test_at_rest_it_feels_its_weight():
    """Heeled by phi, minus gravity: (0, -g sin(phi), -g cos(phi)); its own axes up and to port."""
    t = 0.1 * np.arange(20)
    course = Course(t, g=9.82)
    for name in ("u", "v", "p", "r"):
        course.signals[name] = course.signals[f"{name}_dot"] = 0.0 * t
    expected = 9.82 * np.stack([0.0 * t, -np.sin(course["phi"]), -np.cos(course["phi"])], 1)
    np.testing.assert_allclose(specific_force(course, PERFECT), expected, atol=1e-14)
    np.testing.assert_allclose(
        true_signals(course, PERFECT)["accel"], 9.82 * np.sin(course["phi"]), atol=1e-14
    )


def test_the_three_axes_read_as_the_thesis_has_them(motion):
    """y1 = p, y2 = z_s phi'' + g sin(phi) - v' - u r, y3 = -r (A.41)-(A.45)."""
    read = true_signals(motion, PERFECT)
    z_s = -0.2 - 0.028
    a_y = motion["v_dot"] + motion["u"] * motion["r"]
    a_s = z_s * motion["p_dot"] + 9.82 * np.sin(motion["phi"]) - a_y
    np.testing.assert_allclose(read["gyro"], motion["p"], atol=1e-15)
    np.testing.assert_allclose(read["accel"], a_s, atol=1e-12)
    np.testing.assert_allclose(read["yaw_gyro"], -motion["r"], atol=1e-15)
    np.testing.assert_array_equal(read["delta"], motion["delta"])


def test_in_a_steady_turn_to_port_the_signs_are_those_of_the_ship():
    """r < 0, so the third gyro reads positive; the ship is drawn to port, so y2 sees +U |r|."""
    turn = simulate(np.full(1500, 0.1), substeps=2)
    read = true_signals(turn, PERFECT)
    assert turn["r"][-1] < 0.0 < read["yaw_gyro"][-1]
    pull = -turn["u"][-1] * turn["r"][-1]
    assert read["accel"][-1] == pytest.approx(pull + 9.82 * np.sin(turn["phi"][-1]), rel=1e-3)


def test_a_unit_mounted_higher_feels_more_of_the_roll(motion):
    low, high = (true_signals(motion, replace(PERFECT, zbar_s=z))["accel"] for z in (-0.1, -0.4))
    np.testing.assert_allclose(high - low, -0.3 * motion["p_dot"], atol=1e-12)


# -- misalignment --------------------------------------------------------------------------------


def test_a_unit_turned_about_the_bow_reads_weight_and_centripetal_acceleration(motion):
    """By alpha: y2' = cos(alpha) y2 + sin(alpha) f_up, f_up = g cos(phi) + z_s p^2 - p v, x_s = 0.

    The unit lies above the axis of roll: its centripetal acceleration z_s p^2 points down to it.
    """
    alpha, z_s = 0.05, -0.2 - 0.028
    read = true_signals(motion, replace(PERFECT, roll=alpha))
    straight = true_signals(motion, PERFECT)
    centripetal = z_s * motion["p"] ** 2
    up = 9.82 * np.cos(motion["phi"]) + centripetal - motion["p"] * motion["v"]
    expected = math.cos(alpha) * straight["accel"] + math.sin(alpha) * up
    np.testing.assert_allclose(read["accel"], expected, atol=1e-12)
    assert np.ptp(math.sin(alpha) * centripetal) > 1e-5  # it is seen
    np.testing.assert_array_equal(read["gyro"], straight["gyro"])
    np.testing.assert_allclose(read["yaw_gyro"], math.cos(alpha) * straight["yaw_gyro"], atol=1e-15)


def test_a_unit_turned_about_the_mast_takes_surge_and_centripetal_acceleration_for_sway(motion):
    """By alpha: y2' = cos(alpha) y2 - sin(alpha) f_bow, f_bow = u' - v r + z_s p r - x_s r^2."""
    alpha, x_s, z_s = 0.08, 0.2, -0.2 - 0.028
    unit = replace(PERFECT, x_s=x_s)
    read, straight = (true_signals(motion, replace(unit, yaw=a)) for a in (alpha, 0.0))
    p, r = motion["p"], motion["r"]
    bow = motion["u_dot"] - motion["v"] * r + z_s * p * r - x_s * r**2
    expected = math.cos(alpha) * straight["accel"] - math.sin(alpha) * bow
    np.testing.assert_allclose(read["accel"], expected, atol=1e-12)


def test_a_unit_pitched_in_its_mount_takes_yaw_for_roll(motion):
    """By alpha about the axis to port: y1' = cos(alpha) p - sin(alpha) (-r)."""
    alpha = 0.1
    read = true_signals(motion, replace(PERFECT, pitch=alpha))
    expected = math.cos(alpha) * motion["p"] + math.sin(alpha) * motion["r"]
    np.testing.assert_allclose(read["gyro"], expected, atol=1e-15)


def test_the_mount_turns_by_yaw_pitch_and_roll_in_this_order():
    R = InertialUnit(roll=0.3, pitch=-0.2, yaw=1.0).turned()
    np.testing.assert_allclose(R, rotation(0.3, -0.2, 1.0), atol=1e-15)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0)


# -- errors, channel by channel ------------------------------------------------------------------


def test_each_channel_has_errors_of_its_own(motion):
    """Deviation of N = 300 samples: 4 standard errors of 1/(2 N)^(1/2)."""
    unit = replace(
        PERFECT,
        gyro=Channel(noise=0.002),
        accel=Channel(bias=0.01),
        yaw_gyro=Channel(scale=-1.0, bias=0.1),
        rudder=Channel(noise=0.1, bias=0.5),
    )
    true, record = true_signals(motion, unit), measure(motion, unit, seed=1)
    e = {name: record[name] - true[name] for name in UNITS}
    assert e["gyro"].std() == pytest.approx(0.002, rel=4 / math.sqrt(2 * record.N))
    assert abs(e["gyro"].mean()) < 4 * 0.002 / math.sqrt(record.N)
    np.testing.assert_allclose(e["accel"], 0.01, atol=1e-15)
    np.testing.assert_allclose(record["yaw_gyro"], motion["r"] + 0.1, atol=1e-15)
    assert e["delta"].mean() == pytest.approx(0.5, abs=4 * 0.1 / math.sqrt(record.N))
    assert abs(np.corrcoef(e["gyro"], e["delta"])[0, 1]) < 4 / math.sqrt(record.N)
    again = measure(motion, unit, seed=1)
    np.testing.assert_array_equal(record["gyro"], again["gyro"])
    assert not np.array_equal(record["gyro"], measure(motion, unit, seed=2)["gyro"])


def test_a_record_has_units_clock_and_origin(motion):
    record = measure(motion, seed=3, name="zigzag")
    assert dict(record.units) == UNITS
    assert (record.Ts, record.N, record.name) == (0.02, 300, "zigzag")
    assert "seed 3" in record.provenance[0]


def test_sampling_takes_every_so_many_and_a_slow_channel_is_missing_between(motion):
    unit = replace(PERFECT, sampling=2, yaw_gyro=Channel(every=5))
    record, full = measure(motion, unit, seed=1), measure(motion, PERFECT, seed=1)
    assert (record.Ts, record.N) == (0.04, 150)
    np.testing.assert_array_equal(record["accel"], full["accel"][::2])
    there = ~record.is_missing("yaw_gyro")
    np.testing.assert_array_equal(np.flatnonzero(there), np.arange(0, 150, 5))
    assert not record.is_missing("gyro").any()
    rolled = for_roll(record)
    np.testing.assert_array_equal(rolled.is_missing("r"), record.is_missing("yaw_gyro"))


def test_a_rudder_that_was_stuck_is_told_in_the_record():
    record = measure(simulate(np.full(1000, 0.7), substeps=1), seed=1)
    assert any("rudder at its limit" in line for line in record.provenance)


def test_errors_that_are_none_are_refused(motion):
    with pytest.raises(DataError, match=r"noise -0.1.*noise >= 0"):
        Channel(noise=-0.1)
    with pytest.raises(DataError, match="finite numbers"):
        Channel(bias=math.nan)
    with pytest.raises(DataError, match="every 0.*every >= 1"):
        Channel(every=0)
    with pytest.raises(DataError, match="sampling 0. Give a whole number"):
        measure(motion, replace(PERFECT, sampling=0), seed=1)


# -- the roll subsystem sees them ----------------------------------------------------------------


def test_small_motions_obey_the_roll_subsystem():
    """A_2 phi'' = -(k - K_vdot g) phi - d p - (K_vdot + S) a_s + K_r r + K_delta delta (8.17).

    With K_p|p|, K_v|v| and their like small of second order: motions of 1e-3 leave 1e-3 of them.
    """
    quiet = replace(Ship().coefficients, K_up=0.0, K_p=-0.2067)
    body = Ship(coefficients=quiet)
    m = simulate(zigzag(20.0, angle=1e-3, every=3.0), ship=body, load=LOAD_CASES["loaded"])
    record = for_roll(measure(m, PERFECT, seed=1))
    assert set(record.names) == {"gyro", "accel", "r", "delta"}
    q, g = body.roll_coefficients(1.0, LOAD_CASES["loaded"]), ship.TABLE_8_2["g"]
    A_2 = q["A_1"] - (-0.2 - 0.028) * (q["K_vdot"] + q["S"])
    terms = [
        -(q["k"] - q["K_vdot"] * g) * m["phi"],
        -q["d"] * record["gyro"],
        -(q["K_vdot"] + q["S"]) * record["accel"],
        q["K_r"] * record["r"],
        q["K_delta"] * record["delta"],
    ]
    largest = max(np.abs(term).max() for term in terms)
    np.testing.assert_allclose(A_2 * m["p_dot"], sum(terms), rtol=0, atol=1e-3 * largest)
