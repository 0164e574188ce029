"""The ship in four degrees of freedom obeys mechanics, and linearises to what is published."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from casid.errors import DataError, ModelError, SolveError
from problems import ship
from problems.ship_4dof import (
    LOAD_CASES,
    Actuator,
    Coefficients,
    Load,
    PolynomialArm,
    Ship,
    Start,
    TabulatedArm,
    dynamics,
    hydrodynamics,
    linearised,
    random_steps,
    rotation,
    simulate,
    stability,
    stuck_rudder,
    tangent,
    zigzag,
)

NOMINAL, LOADED = LOAD_CASES["nominal"], LOAD_CASES["loaded"]
HEELS = np.radians(np.arange(0.0, 75.0, 5.0))
TABLE = TabulatedArm(tuple(HEELS), tuple(Ship().arm(HEELS)))


def with_(**coefficients: float) -> Ship:
    """The default ship with other coefficients."""
    return Ship(coefficients=replace(Coefficients(), **coefficients))


def every_coefficient(seed: int) -> Coefficients:
    """None is zero, and each differs from its default by about 0.3."""
    rng = np.random.default_rng(seed)
    return Coefficients(
        **{
            f.name: getattr(Coefficients(), f.name) + float(rng.uniform(0.1, 0.5))
            for f in fields(Coefficients)
        }
    )


# -- rigid-body mechanics ------------------------------------------------------------------------


def test_inertial_forces_are_those_of_point_masses():
    """M_RB nu' + C_RB nu is the sum over points of m a and r x m a (Newton, Euler), (A.31)-(A.32).

    Points on the axes have no products of inertia, as (A.31) assumes, and yet first moments.
    """
    points = np.array([[0.3, 0.0, 0.0], [0.0, -0.2, 0.0], [0.0, 0.0, 0.25], [-0.1, 0.0, 0.0]])
    masses = np.array([4.0, 5.0, 6.0, 7.0])
    M, S = masses.sum(), masses @ points
    x_g, y_g, z_g = S / M
    square = masses @ points**2
    body = Ship(
        M=M,
        zbar_g=z_g,
        x_g=x_g,
        y_g=y_g,
        z_f=0.0,
        A_x=square[1] + square[2] - M * (y_g**2 + z_g**2),
        A_z=square[0] + square[1] - M * (x_g**2 + y_g**2),
        coefficients=Coefficients(**{f.name: 0.0 for f in fields(Coefficients)}),
    )
    rng = np.random.default_rng(1)
    for _ in range(5):
        nu, nu_dot = rng.standard_normal((2, 4))
        w, w_dot = np.array([nu[2], 0.0, nu[3]]), np.array([nu_dot[2], 0.0, nu_dot[3]])
        velocity = np.array([nu[0], nu[1], 0.0]) + np.cross(w, points)
        a = np.array([nu_dot[0], nu_dot[1], 0.0]) + np.cross(w_dot, points) + np.cross(w, velocity)
        force = masses[:, None] * a
        torque = np.cross(points, force).sum(axis=0)
        expected = [*force.sum(axis=0)[:2], torque[0], torque[2]]
        got = body.mass_matrix() @ nu_dot + body.coriolis(nu) @ nu
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12)


def test_a_load_is_one_more_point():
    """Its first and second moments add; Abar_x - A_x is the sum of m z^2 (8.11)."""
    own, loaded = Ship(), Load(0.4, -0.182, y_m=0.05)
    z_m = -0.182 - 0.028
    difference = own.mass_matrix(loaded) - own.mass_matrix()
    expected = [
        [0.4, 0.0, 0.0, -0.4 * 0.05],
        [0.0, 0.4, -0.4 * z_m, 0.0],
        [0.0, -0.4 * z_m, 0.4 * (z_m**2 + 0.05**2), 0.0],
        [-0.4 * 0.05, 0.0, 0.0, 0.4 * 0.05**2],
    ]
    np.testing.assert_allclose(difference, expected, atol=1e-14)
    assert own.mass_matrix()[2, 2] == pytest.approx(0.1385 + 22.04 * 0.028**2, rel=1e-14)


def test_the_coriolis_matrix_is_skew():
    heeled = replace(Ship(), x_g=0.02, y_g=0.01)
    C = heeled.coriolis([1.0, 0.3, -0.7, 0.4], Load(0.4, -0.2, 0.05))
    assert np.count_nonzero(C) == 10
    np.testing.assert_array_equal(C, -C.T)


def test_the_rotation_is_orthogonal_and_the_kinematics_are_its_first_rows():
    """(A.8) as repaired; (A.30) at theta = 0, where a yawing ship turns at r cos(phi)."""
    rng = np.random.default_rng(2)
    for phi, theta, psi in rng.uniform(-1.0, 1.0, (5, 3)):
        R = rotation(phi, theta, psi)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(R) == pytest.approx(1.0)
        u, v, p, r = rng.standard_normal(4)
        rates = np.asarray(
            dynamics(Ship(), NOMINAL)([0, 0, phi, psi, u, v, p, r], [0, 0], np.zeros(4), [0, 0])
        ).ravel()
        np.testing.assert_allclose(rates[:2], (rotation(phi, 0, psi) @ [u, v, 0])[:2], atol=1e-15)
        np.testing.assert_allclose(rates[2:4], [p, math.cos(phi) * r], atol=1e-15)


@pytest.mark.parametrize("arm", [Ship().arm, TABLE], ids=["polynomial", "table"])
@pytest.mark.parametrize("load", [NOMINAL, Load(0.4, -0.182, 0.02)], ids=["upright", "off centre"])
def test_without_damping_no_energy_is_made(arm, load):
    """d/dt (nu' M nu/2 + V(phi)) = 0, as C_RB is skew, M symmetric and V' the restoring torque.

    What Runge-Kutta 4 takes from an oscillation's energy is (w h)^6/72 a step; what is not linear
    is allowed half as much again. One substep against two shows that it is the integrator's: over
    a given time it goes with h^5.
    """
    c = replace(Coefficients().without_damping(), K_phiphiphi=-1.0)
    free = Ship(arm=arm, coefficients=c, slowest=-math.inf)  # it may go astern: no term minds
    start = Start(u=1.0, v=0.1, p=0.5, r=-0.2, phi=0.25)
    lost = []
    for substeps in (1, 2):
        motion = simulate(
            np.zeros(500), ship=free, load=load, start=start, Ts=0.04, substeps=substeps
        )
        E = motion.energy()
        rolling = E.max() - free.energy(np.array([[1.0, 0.1, 0.0, -0.2]]), np.zeros(1), load)[0]
        assert np.ptp(motion["phi"]) > 0.3
        lost.append(np.ptp(E))
        w, h = 5.3, 0.04 / substeps
        assert lost[-1] < 1.5 * 500 * substeps * (w * h) ** 6 / 72 * rolling
    assert lost[0] / lost[1] == pytest.approx(2**5, rel=0.1)


def test_added_mass_that_is_not_symmetric_would_make_energy():
    """The control of the statement above: N_vdot != Y_rdot is no mass matrix of a body."""
    c = replace(Coefficients().without_damping(), N_vdot=5.0)
    start = Start(v=0.1, p=0.5, r=-0.2, phi=0.25)
    E = simulate(np.zeros(500), ship=Ship(coefficients=c), start=start).energy()
    assert np.ptp(E) > 1e-3


# -- the equations, written out again ------------------------------------------------------------


def rates_again(c: Coefficients, body: Ship, load: Load, x, delta, w_p, tau):
    """(A.30)-(A.40), term by term, of numbers."""
    _, _, phi, psi, u, v, p, r = x
    M, z_m = body.M + load.m, load.zbar_m + body.z_f
    xg = body.M * body.x_g / M
    yg = (body.M * body.y_g + load.m * load.y_m) / M
    zg = (body.M * (body.zbar_g + body.z_f) + load.m * z_m) / M
    Ax = body.A_x + body.M * (body.y_g**2 + body.z_g**2) + load.m * (load.y_m**2 + z_m**2)
    Az = body.A_z + body.M * (body.x_g**2 + body.y_g**2) + load.m * load.y_m**2
    mass = [
        [M - c.X_udot, 0, 0, -M * yg],
        [0, M - c.Y_vdot, -M * zg - c.Y_pdot, M * xg - c.Y_rdot],
        [0, -M * zg - c.K_vdot, Ax, -c.K_rdot],
        [-M * yg, M * xg - c.N_vdot, -c.N_pdot, Az],
    ]
    inertial = [  # C_RB nu
        -M * r * v + M * zg * r * p - M * xg * r**2,
        M * r * u - M * yg * p**2 - M * yg * r**2,
        -M * zg * r * u + M * yg * p * v,
        M * xg * r * u + M * yg * r * v,
    ]
    f = [
        c.X_uu * abs(u) * u,
        c.Y_uv * abs(u) * v
        + c.Y_ur * u * r
        + c.Y_vv * v * abs(v)
        + c.Y_vr * v * abs(r)
        + c.Y_rv * r * abs(v)
        + c.Y_phiuv * phi * abs(u * v)
        + c.Y_phiur * phi * abs(u * r)
        + c.Y_phiuu * phi * u**2,
        c.K_uv * abs(u) * v
        + c.K_ur * u * r
        + c.K_vv * v * abs(v)
        + c.K_vr * v * abs(r)
        + c.K_rv * r * abs(v)
        + c.K_phiuv * phi * abs(u * v)
        + c.K_phiur * phi * abs(u * r)
        + c.K_phiuu * phi * u**2
        + c.K_up * abs(u) * p
        + c.K_pp * p * abs(p)
        + c.K_p * p
        + c.K_phiphiphi * phi**3,
        c.N_uv * abs(u) * v
        + c.N_ur * abs(u) * r
        + c.N_rr * r * abs(r)
        + c.N_rv * r * abs(v)
        + c.N_phiuv * phi * abs(u * v)
        + c.N_phiur * phi * u * abs(r)
        + c.N_p * p
        + c.N_pp * abs(p) * p
        + c.N_up * abs(u) * p
        + c.N_phiuu * phi * u * abs(u),
    ]
    hull = body.M * body.g * body.arm(phi)
    g = [0, 0, hull + M * body.g * (zg * math.sin(phi) - yg * math.cos(phi)), 0]
    R = [
        c.C3 * w_p - c.C1 * abs(delta),
        c.C2 * delta,
        -c.z_r * c.C2 * delta,
        c.x_r * c.C2 * delta,
    ]
    nu_dot = np.linalg.solve(mass, np.array(f) - inertial - g + R + tau)
    along, across = u, v * math.cos(phi)
    return np.array(
        [
            along * math.cos(psi) - across * math.sin(psi),
            along * math.sin(psi) + across * math.cos(psi),
            p,
            r * math.cos(phi),
            *nu_dot,
        ]
    )


def test_every_term_of_the_equations_is_there():
    c = every_coefficient(3)
    body = Ship(coefficients=c, x_g=0.02, y_g=-0.01)
    load, rng = Load(0.4, -0.182, 0.03), np.random.default_rng(4)
    f = dynamics(body, load)
    for _ in range(20):
        x, tau = rng.standard_normal(8), rng.standard_normal(4)
        x[2] *= 0.3
        delta, w_p = rng.uniform(-0.5, 0.5), rng.uniform(0.0, 100.0)
        got = np.asarray(f(x, [delta, w_p], tau, np.zeros(2))).ravel()
        np.testing.assert_allclose(
            got, rates_again(c, body, load, x, delta, w_p, tau), rtol=1e-11, atol=1e-11
        )


def test_no_coefficient_is_idle():
    """Each of (A.36) changes some force at a general point."""
    at = (0.3, (0.9, 0.2, -0.3, 0.4))
    reference = np.array(hydrodynamics(every_coefficient(5), *at), dtype=np.float64)
    outside = ("X_udot", "Y_vdot", "Y_pdot", "Y_rdot", "K_vdot", "K_rdot", "N_vdot", "N_pdot")
    for f in fields(Coefficients):
        if f.name not in (*outside, "C1", "C2", "C3", "z_r", "x_r"):
            other = replace(every_coefficient(5), **{f.name: 0.0})
            changed = np.array(hydrodynamics(other, *at), dtype=np.float64) != reference
            assert changed.sum() == 1, f.name
            assert "XYKN"[int(np.argmax(changed))] == f.name[0]


def test_a_motion_is_that_of_an_integrator_of_another_kind():
    """Against scipy's DOP853, stopped at every sample and at every end of the rudder's ramps.

    10 substeps of 2 ms: (w h)^4/120 = 1e-10 at the 5.3 rad/s of roll; the kinks of |v| v add more.
    """
    Ts, N = 0.02, 151
    t = Ts * np.arange(N)
    command = zigzag(N * Ts, angle=0.3, every=1.2, Ts=Ts)
    forces = np.stack([0.1 * np.sin(t), 0.5 * np.sin(4 * t), 0.1 * np.cos(5 * t), 0.05 * t], 1)
    motion = simulate(command, load=LOADED, forces=forces, Ts=Ts)
    delta = [0.0]
    for wanted in command[:-1]:
        delta.append(delta[-1] + float(np.clip(wanted - delta[-1], -0.4 * Ts, 0.4 * Ts)))
    np.testing.assert_allclose(motion["delta"], delta, atol=1e-14)
    body, x = motion.ship, np.array([0.0, 0, 0, 0, 1, 0, 0, 0])
    for k in range(N - 1):
        np.testing.assert_allclose(motion.states[k, :8], x, rtol=0, atol=1e-8)
        rates = rates_again(body.coefficients, body, LOADED, x, delta[k], 100.0, forces[k])
        np.testing.assert_allclose(motion.rates[k], rates, rtol=0, atol=1e-6)

        def rhs(s, x, k=k):
            d, tau = ((1 - s / Ts) * a[k] + s / Ts * a[k + 1] for a in (np.array(delta), forces))
            return rates_again(body.coefficients, body, LOADED, x, d, 100.0, tau)

        x = solve_ivp(rhs, (0.0, Ts), x, method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]


def test_runge_kutta_shows_its_order():
    """Halving the step divides the error by 2^4, where no modulus passes a kink."""
    c = replace(Coefficients(), K_pp=0.0, N_pp=0.0)  # p alone changes sign here
    body = Ship(coefficients=c, rudder=Actuator(-0.6, 0.6, 10.0))
    start = Start(v=0.1, r=-0.25, phi=0.2, p=0.1, delta=0.3)

    def end(substeps: int):
        motion = simulate(np.full(11, 0.3), ship=body, start=start, Ts=0.4, substeps=substeps)
        assert np.all(motion["v"] > 0.0)
        assert np.all(motion["r"] < 0.0)
        return motion.states[-1, :8]

    truth = end(128)
    error = [np.abs(end(n) - truth).max() for n in (4, 8, 16)]
    orders = np.log2(np.array(error[:-1]) / error[1:])
    np.testing.assert_allclose(orders, 4.0, atol=0.3)


# -- its linear model ----------------------------------------------------------------------------


def test_the_coefficients_are_those_of_the_roll_subsystem():
    v = ship.TABLE_8_2
    body, found = Ship(), Ship().roll_coefficients(v["U"])
    for name in ("k", "A_x", "d", "K_r", "K_vdot", "K_delta"):
        assert found[name] == pytest.approx(v[name], rel=1e-12), name
    assert (body.M, body.zbar_g, body.z_f, body.g) == (v["M"], v["zbar_g"], v["z_f"], v["g"])
    assert LOADED == Load(v["m"], v["zbar_m"])
    for case, known in ship.LOAD_CASES.items():
        if known:
            assert LOAD_CASES[case] == Load(**known)
    z_s = v["zbar_s"] + v["z_f"]
    for case, A_2 in {"nominal": 0.037876, "calibration": 0.036756, "loaded": 0.036364}.items():
        q = body.roll_coefficients(1.0, LOAD_CASES[case])
        assert q["A_1"] - z_s * (q["K_vdot"] + q["S"]) == pytest.approx(A_2, abs=5e-7)


def test_the_poles_of_table_8_2_have_the_restored_signs():
    """Y_|u|v = -35 and N_|u|r = -1.4; as printed, without their signs, the ship is unstable."""
    expected = [-2.971, -0.697 - 5.241j, -0.697 + 5.241j, -0.334, 0.0]
    poles = np.sort_complex(linearised().poles())
    # Three printed decimals, of which two are rounded and one cut.
    np.testing.assert_allclose(poles, np.sort_complex(np.array(expected)), rtol=0, atol=7e-4)
    printed = linearised(ship=with_(Y_uv=35.0, N_ur=1.4)).poles()
    unstable = np.sort(printed[printed.real > 1e-6].real)
    np.testing.assert_allclose(unstable, [0.25, 3.9], atol=0.05)


@pytest.mark.parametrize("U", [0.5, 1.0, 1.7])
@pytest.mark.parametrize("load", LOAD_CASES.values(), ids=LOAD_CASES.keys())
def test_the_simulator_linearises_to_the_published_matrices(U, load):
    """(8.3)-(8.7) against CasADi's Jacobian, every derivative present."""
    body = replace(Ship(coefficients=every_coefficient(6)), x_g=0.015)
    formula, jacobian = linearised(U, ship=body, load=load), tangent(U, ship=body, load=load)
    for name in ("E", "F", "F_delta", "T"):
        np.testing.assert_allclose(
            getattr(formula, name), getattr(jacobian, name), rtol=1e-11, atol=1e-11
        )


def test_surge_stands_apart_about_a_straight_course():
    f = dynamics(Ship(), LOADED)
    J = f.factory("J", f.name_in(), ["jac:rates:x"])
    A = np.asarray(J([0, 0, 0, 0, 1.0, 0, 0, 0], [0, 0], np.zeros(4), np.zeros(2)))
    assert not A[4, [2, 3, 5, 6, 7]].any()
    assert not A[[2, 3, 5, 6, 7], 4].any()
    assert A[4, 4] == pytest.approx(2 * -1.6 / (22.44 + 1.1))


def test_small_motions_are_those_of_the_linear_model():
    """A rudder of 1e-4 rad: what is not linear is of second order, 1e-4 of the motion."""
    body = replace(Ship(), rudder=Actuator(-1.0, 1.0, 1e3))
    command = np.full(200, 1e-4)
    motion = simulate(command, ship=body, start=Start(delta=1e-4))
    linear = linearised(ship=body)

    def rhs(t, x):
        return linear.A @ x + linear.B * 1e-4

    x = solve_ivp(rhs, (0, motion.t[-1]), np.zeros(5), t_eval=motion.t, rtol=1e-10, atol=1e-14).y
    for i, name in enumerate(("phi", "psi", "v", "p", "r")):
        np.testing.assert_allclose(motion[name], x[i], rtol=0, atol=1e-3 * np.abs(x[i]).max())


def test_the_transfer_function_is_c_over_s_minus_A_times_b():
    linear, s = linearised(), 0.4 + 1.3j
    for i in range(5):
        num, den = linear.transfer(i)
        direct = np.linalg.solve(s * np.eye(5) - linear.A, linear.B)[i]
        assert np.polyval(num, s) / np.polyval(den, s) == pytest.approx(direct, rel=1e-10)


def test_the_accelerometer_has_a_direct_term_from_every_force():
    """From roll torque, relative to p', z_s - [(S + Y_pdot) Abar_z + Y_rdot N_pdot]/[(M_t - Y_vdot)
    Abar_z - Y_rdot N_vdot] (section 8.2); so a_s is correlated with tau at the same instant.
    """
    body = Ship(coefficients=every_coefficient(7))
    c, z_s, linear = body.coefficients, -0.228, linearised(ship=body, load=LOADED)
    _, D_delta, D_tau = linear.accelerometer(z_s, U=1.0, g=body.g)
    mass, S = body.mass_matrix(LOADED), body.moments(LOADED)[3]
    det = mass[1, 1] * mass[3, 3] - c.Y_rdot * c.N_vdot
    onset = np.linalg.inv(mass[1:, 1:])[1, 1]  # p' of a unit torque
    expected = z_s - ((S + c.Y_pdot) * mass[3, 3] + c.Y_rdot * c.N_pdot) / det
    assert D_tau[1] / onset == pytest.approx(expected, rel=1e-12)
    assert np.all(np.abs([D_delta, *D_tau]) > 1e-3)


def test_the_accelerometer_of_the_linear_model_is_that_of_small_motions():
    forces = np.zeros((200, 4))
    forces[:, 2] = 1e-4 * np.sin(0.1 * np.arange(200))
    m = simulate(zigzag(4.0, angle=1e-4, every=1.0), load=LOADED, forces=forces)
    linear, z_s = linearised(load=LOADED), -0.228
    C, D_delta, D_tau = linear.accelerometer(z_s, U=1.0, g=9.82)
    x = np.stack([m[n] for n in ("phi", "psi", "v", "p", "r")])
    got = C @ x + D_delta * m["delta"] + D_tau @ forces[:, 1:].T
    a_s = z_s * m["p_dot"] + 9.82 * np.sin(m["phi"]) - m["v_dot"] - m["u"] * m["r"]
    np.testing.assert_allclose(got, a_s, rtol=0, atol=1e-3 * np.abs(a_s).max())


# -- the initial inward lean ---------------------------------------------------------------------


def lean(body: Ship):
    """Roll angle after a step of 0.02 rad to port, and the sign of the turn: -1 is to port."""
    quick = replace(body, rudder=Actuator(-1.0, 1.0, 1e3))
    motion = simulate(np.full(600, 0.02), ship=quick, start=Start(delta=0.02), substeps=4)
    return motion["phi"], np.sign(motion["r"][-1])


def test_a_low_rudder_heels_the_ship_inwards_first():
    """Rudder to roll has a zero in the right half-plane; the turn itself leans it outwards."""
    zeros = linearised().zeros(0)
    assert np.sum(zeros.real > 0) == 1
    phi, turn = lean(Ship())
    assert turn == -1.0
    assert phi[10] < 0.0 < phi[-1]  # to port, then to starboard


@pytest.mark.parametrize("K_vdot", [0.1, 0.96], ids=["Table 8.2", "chapter 9"])
def test_the_inward_lean_is_gone_when_the_rudder_no_longer_lies_low(K_vdot):
    """The sign of phi'' at the step, Mat^-1 [1, -z_r, x_r]' C2 in roll, changes at

        z_r* = (S + K_vdot) (Abar_z + x_r Y_rdot)/((M - Y_vdot) Abar_z - Y_rdot N_vdot),  K_rdot = 0

    Where S + K_vdot > 0, as with the K_vdot estimated in chapter 9, that is below the CO: a rudder
    at z_r = 0 leans the ship outwards from the start. With Table 8.2, S + K_vdot < 0, it is 8.5 mm
    above: at z_r = 0 a lean remains, a twelfth of what it was, and the zero lies beyond 100 rad/s.
    """
    c = replace(Coefficients(), K_vdot=K_vdot, Y_pdot=K_vdot)
    body = Ship(coefficients=c)
    mass, (_, _, _, S) = body.mass_matrix(), body.moments()
    det = mass[1, 1] * mass[3, 3] - c.Y_rdot * c.N_vdot
    critical = (S + K_vdot) * (mass[3, 3] + c.x_r * c.Y_rdot) / det

    def at(z_r: float):
        other = Ship(coefficients=replace(c, z_r=z_r))
        linear = linearised(ship=other)
        return linear.B[3], linear.zeros(0), other

    assert at(critical)[0] == pytest.approx(0.0, abs=1e-12)
    for z_r, inward in ((critical + 0.002, True), (critical - 0.002, False)):
        onset, zeros, _ = at(z_r)
        assert (onset < 0.0) == inward
        assert np.any(zeros.real > 0.0) == inward
    onset, zeros, other = at(0.0)
    if K_vdot > 0.617:
        assert np.all(zeros.real < 0.0)
        phi, turn = lean(other)
        assert turn == -1.0
        assert phi[:50].min() == 0.0
    else:
        assert critical == pytest.approx(-0.0085, abs=1e-4)
        assert onset / at(Coefficients().z_r)[0] < 1 / 12
        assert zeros.real.max() > 100.0


# -- restoring arm and stability -----------------------------------------------------------------


@pytest.mark.parametrize("arm", [Ship().arm, TABLE], ids=["polynomial", "table"])
def test_the_arm_is_odd_and_its_integral_an_integral(arm):
    for phi in (0.03, 0.4, -0.4, 1.1):
        assert arm(-phi) == pytest.approx(-arm(phi), rel=1e-14)
        assert arm.integral(np.array(phi)) == pytest.approx(
            quad(arm, 0, phi, points=np.sign(phi) * HEELS, limit=100)[0], rel=1e-9
        )
    assert (arm(1e-6) / 1e-6) == pytest.approx(arm.slope, rel=1e-6)


def test_a_table_gives_the_arm_it_was_made_from():
    """At its heels exactly; between, 5 h^4/384 of the fourth derivative, which is 120 c_5 phi."""
    np.testing.assert_allclose(TABLE(HEELS), Ship().arm(HEELS), atol=1e-15)
    phi = np.linspace(0.0, math.radians(50.0), 301)
    fourth = 120 * 0.9 * 10.38 / (22.04 * 9.82) * phi.max()
    bound = math.radians(5.0) ** 4 * 5 / 384 * fourth
    assert np.abs(TABLE(phi) - Ship().arm(phi)).max() < bound
    motions = [
        simulate(zigzag(10, angle=0.3, every=3), ship=Ship(arm=a)) for a in (TABLE, Ship().arm)
    ]
    np.testing.assert_allclose(motions[0]["phi"], motions[1]["phi"], atol=1e-5)


def test_the_righting_arm_rises_and_vanishes():
    body = Ship()
    found = stability(body)
    k, S = 10.38, 22.04 * -0.028
    assert found.GM == pytest.approx((k + S * 9.82) / (22.04 * 9.82), rel=1e-12)
    assert found.rests == (pytest.approx(0.0, abs=1e-12),)
    assert found.vanishing[1] == pytest.approx(-found.vanishing[0], rel=1e-12)
    assert found.vanishing[1] == pytest.approx(math.radians(55.3), abs=1e-3)
    assert body.GZ(np.array(found.vanishing[1])) == pytest.approx(0.0, abs=1e-12)
    inside = np.linspace(0.01, found.vanishing[1] - 0.01, 50)
    assert np.all(body.GZ(inside) > 0.0)


def test_a_load_off_the_centre_line_heels_the_ship_to_where_the_torques_balance():
    load = Load(0.2, -0.2, y_m=0.05)
    (rest,) = stability(Ship(), load).rests
    k, S = 10.38, 22.04 * -0.028 + 0.2 * -0.228
    assert rest == pytest.approx(0.2 * 9.82 * 0.05 / (k + S * 9.82), rel=2e-3)  # small angles
    motion = simulate(np.zeros(2000), load=load, substeps=2)
    assert motion["phi"][-1] == pytest.approx(rest, rel=1e-4)
    with pytest.raises(ModelError, match="off the centre line.*y_m to 0"):
        linearised(load=load)


# -- actuators, current, speed -------------------------------------------------------------------


def test_rudder_and_propeller_keep_their_limits():
    body = Ship()
    command = np.concatenate([np.full(200, 1.0), np.full(300, -1.0)])
    motion = simulate(command, w_p=np.where(np.arange(500) < 250, 100.0, 500.0), substeps=2)
    for name, a in (("delta", body.rudder), ("w_p", body.propeller)):
        assert motion[name].min() >= a.lowest
        assert motion[name].max() <= a.highest
        assert np.abs(np.diff(motion[name])).max() <= a.rate * motion.Ts * (1 + 1e-12)
    assert motion["delta"].max() == pytest.approx(body.rudder.highest)
    assert motion["delta"].min() == pytest.approx(body.rudder.lowest)
    # 1.22 rad at 0.4 rad/s are 3.05 s
    assert np.count_nonzero(np.abs(np.diff(motion["delta"][200:])) > 1e-9) == 153


def test_straight_ahead_thrust_and_resistance_balance():
    motion = simulate(np.zeros(100))
    np.testing.assert_allclose(motion["u"], 1.0, rtol=1e-14)
    np.testing.assert_array_equal(motion["phi"], 0.0)
    x = simulate(np.zeros(500), w_p=60.0, substeps=2)["u"]
    # u' = (0.96 - 1.6 u^2)/23.14, the propeller slowing at 100 rad/s^2 first
    assert x[-1] > math.sqrt(0.96 / 1.6)
    assert np.all(np.diff(x) <= 0.0)


def test_a_steady_current_carries_the_motion_along():
    """Galileo: velocities through the water are the same, places differ by the drift."""
    command = random_steps(10.0, angle=0.3, hold=1.0, seed=1)
    still = simulate(command, substeps=2)
    carried = simulate(command, current=np.tile([0.2, -0.1], (500, 1)), substeps=2)
    np.testing.assert_allclose(carried.states[:, 2:], still.states[:, 2:], atol=1e-14)
    np.testing.assert_allclose(carried["x"] - still["x"], 0.2 * still.t, atol=1e-12)
    np.testing.assert_allclose(carried["y"] - still["y"], -0.1 * still.t, atol=1e-12)


def test_a_motion_goes_on_from_its_end():
    """Two stretches that share a sample are the whole, the rudder's ramp included."""
    command = random_steps(4.0, angle=0.5, hold=0.3, seed=2)
    forces = np.random.default_rng(3).normal(0.0, 0.1, (200, 4))
    speed = np.where(np.arange(200) < 100, 100.0, 130.0)
    whole = simulate(command, w_p=speed, forces=forces, substeps=2)
    first = simulate(command[:111], w_p=speed[:111], forces=forces[:111], substeps=2)
    then = simulate(
        command[110:], w_p=speed[110:], forces=forces[110:], start=first.end, substeps=2
    )
    np.testing.assert_array_equal(whole.states[:111], first.states)
    np.testing.assert_array_equal(whole.states[110:], then.states)


def test_a_long_record_is_no_other_than_its_stretches():
    """Whatever blocks it is computed in: 3000 samples at a time, the last one filled up."""
    command = random_steps(140.0, angle=0.3, hold=1.0, seed=4)
    whole = simulate(command, substeps=1)
    parts = [simulate(command[:2500], substeps=1)]
    for start in (2499, 4998):
        parts.append(simulate(command[start : start + 2500], start=parts[-1].end, substeps=1))
    joined = np.vstack([parts[0].states, *(part.states[1:] for part in parts[1:])])
    np.testing.assert_array_equal(whole.states, joined)
    assert whole.rates.shape == (7000, 8)
    np.testing.assert_array_equal(whole.rates[4998:], parts[-1].rates)


def test_the_ship_slows_in_turns():
    motion = simulate(zigzag(40, angle=math.radians(20), every=10), substeps=4)
    assert 0.7 < motion["u"].min() < 0.95


# -- bad input -----------------------------------------------------------------------------------


def test_a_load_that_capsizes_is_refused_with_the_angle():
    """2 kg are barely borne (section 9.2); more lolls, much more has no righting arm at all."""
    with pytest.raises(SolveError, match=r"GM = -0.7 mm and it lolls to -10.7, 10.7 deg.*lower"):
        simulate(np.zeros(10), load=Load(2.0, -0.2))
    (_, loll) = stability(Ship(), Load(2.0, -0.2)).rests
    assert Ship().GZ(np.array(loll), Load(2.0, -0.2)) == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(SolveError, match="capsizes: no heel") as refusal:
        simulate(np.zeros(10), load=Load(8.0, -0.25))
    limit = 22.04 * (10.38 / (22.04 * 9.82) - 0.028) / 0.278
    assert f"less than {limit:.2f} kg" in str(refusal.value)
    assert stability(Ship(), Load(0.999 * limit, -0.25)).GM > 0.0


def test_a_squall_that_capsizes_is_reported_with_time_and_angle():
    forces = np.zeros((300, 4))
    forces[100:, 2] = 4.0
    with pytest.raises(
        SolveError, match=r"capsizes at t = [23]\.\d\d s, heel 5[5-9].*55\.3.*lower"
    ):
        simulate(np.zeros(300), forces=forces, substeps=2)


def test_a_rudder_that_stays_at_its_limit_is_flagged():
    motion = simulate(np.full(1000, 0.7), substeps=1)
    (warning,) = motion.warnings
    assert "rudder at its limit of 35.0 deg" in warning
    assert "Command less" in warning
    assert any(warning in line for line in motion.record().provenance)
    assert simulate(zigzag(20, angle=0.3, every=5), substeps=1).warnings == ()
    assert stuck_rudder(np.full(100, -0.6), (-0.6, 0.6), 0.02) is not None
    assert stuck_rudder(np.sin(np.arange(100.0)), (-1.0, 1.0), 0.02) is None


def test_a_ship_without_way_is_refused():
    with pytest.raises(SolveError, match=r"0.010 m/s at the start.*Start faster"):
        simulate(np.zeros(10), start=Start(u=0.01))
    with pytest.raises(SolveError, match=r"at t = \d+.*propeller faster"):
        simulate(np.zeros(1500), w_p=0.0, forces=np.tile([-1.0, 0, 0, 0], (1500, 1)), substeps=1)
    for f in (linearised, tangent):
        with pytest.raises(SolveError, match="below 0.1 m/s"):
            f(0.0)


def test_inputs_of_the_wrong_shape_are_refused():
    with pytest.raises(DataError, match=r"forces has shape \(10, 3\). Give \(10, 4\)"):
        simulate(np.zeros(10), forces=np.zeros((10, 3)))
    with pytest.raises(DataError, match=r"w_p has shape \(9,\). Give \(10\)"):
        simulate(np.zeros(10), w_p=np.zeros(9))
    with pytest.raises(DataError, match="delta is not finite in 1 samples, the first k = 3"):
        simulate([0, 0, 0, math.nan, 0])
    with pytest.raises(DataError, match="must begin at"):
        TabulatedArm((0.1, 0.2, 0.3), (0.0, 0.1, 0.2))
    with pytest.raises(DataError, match="at least three"):
        TabulatedArm((0.0, 0.2), (0.0, 0.1))
    with pytest.raises(DataError, match="motion has no 'gyro'"):
        simulate(np.zeros(10))["gyro"]


def test_a_motion_gives_a_record_of_its_states():
    record = simulate(np.zeros(10)).record("straight")
    assert (record.N, record.Ts, record.name) == (10, 0.02, "straight")
    assert record.units["p_dot"] == "rad/s^2"
    assert PolynomialArm((0.04,)).reach == math.pi / 2


def test_a_load_of_negative_mass_is_refused_with_what_to_change():
    with pytest.raises(DataError, match="zero or more.*the ship's own M"):
        Load(-3.0)
    assert Load(0.0).m == 0.0


def test_a_motion_says_in_a_line_what_it_is():
    told = repr(simulate(zigzag(20.0, angle=0.1, every=5.0)))
    assert "1000 samples" in told
    assert len(told) < 120
