"""The problem files: they load, simulate the same example twice, and are the models they claim."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid.errors import ModelError
from casid.model.dimensions import check_units
from problems import emps, pendulum, roll_decay
from tests.support.shared import ROOT, shared

NAMES = ("pendulum", "roll_decay", "emps", "ship", "ship_4dof", "sensor_to_sensor")


@pytest.mark.parametrize("name", NAMES)
def test_a_problem_file_loads_by_path_and_its_units_agree(name):
    problem = casid.load_problem(ROOT / "problems" / f"{name}.py")
    assert problem.name == name
    check_units(problem.model)


@pytest.mark.parametrize("name", NAMES)
def test_an_example_is_the_same_every_time_and_has_every_channel(name):
    problem = casid.load_problem(ROOT / "problems" / f"{name}.py")
    first, second = problem.examples(), problem.examples()
    signals = {*problem.model.inputs, *problem.model.outputs, *problem.recorded}
    for a, b in zip(first, second, strict=True):
        assert set(a.record.names) == signals
        for channel in signals:
            np.testing.assert_array_equal(a.record[channel], b.record[channel])


@pytest.mark.parametrize(
    ("name", "file", "N"),
    [
        ("pendulum", "cases/pendulum/case_001.csv", 6437),
        ("roll_decay", "data/kvlcc2_rolldecay_sspa/run_21337.csv", 9166),
        ("emps", "data/emps/estimation.csv", 24841),
    ],
)
def test_measured_records_are_read_without_a_mapping(name, file, N):
    problem = casid.load_problem(ROOT / "problems" / f"{name}.py")
    experiment = problem.read(shared(file))
    assert experiment.record.N == N
    assert set(problem.model.outputs) <= set(experiment.record.names)


# -- the pendulum ------------------------------------------------------------------------------

M, Z_G, I_X, D, K, Z_M, Z_S, G = 22.04, -0.018, 0.1385, 0.1067, 10.39, -0.274, -0.218, 9.81


def derivatives(model, values, x, u):
    """dx/dt of a model at a point."""
    e = model.explicit()
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    p = [values.get(n, model.parameters[n].value) for n in e.parameters]
    return np.array(f(x, u, p)).ravel()


@pytest.mark.parametrize("load", [0.0, 0.2])
def test_eliminating_the_cart_gives_the_indirect_model(load):
    """(7.24)-(7.26): gravity drops out and I_2 = I_1 - z_s S replaces I_1."""
    rng = np.random.default_rng(3)
    model = pendulum.problem.model
    S = M * Z_G + load * Z_M
    I_2 = I_X + M * Z_G * (Z_G - Z_S) + load * Z_M * (Z_M - Z_S)  # (7.25)
    for _ in range(5):
        phi, p, a_s = rng.standard_normal(3)
        k, d = rng.uniform(5, 15), rng.uniform(0.05, 0.2)
        got = derivatives(model, {"k": k, "d": d, "I_x": I_X, "m": load}, [phi, p], [a_s])
        np.testing.assert_allclose(got, [p, (-k * phi - d * p - S * a_s) / I_2], rtol=1e-12)


def test_the_input_that_was_eliminated_is_the_one_that_acted():
    """a_y = z_s phi'' + g phi - a_s from (7.14), with phi'' of the direct model (7.10)."""
    rng = np.random.default_rng(4)
    direct, indirect = pendulum.direct_model(), pendulum.problem.model
    e, i = direct.explicit(), indirect.explicit()
    outputs = ca.Function("h", [e.x, e.u, e.p], [e.h])
    solved = ca.Function("w", [i.x, i.u, i.p], [i.eliminated["a_y"]])
    values = {"k": K, "d": D, "I_x": I_X}
    p_direct = [values.get(n, direct.parameters[n].value) for n in e.parameters]
    p_indirect = [values.get(n, indirect.parameters[n].value) for n in i.parameters]
    for _ in range(5):
        phi, p, a_y = rng.standard_normal(3)
        _, accel = np.array(outputs([phi, p], [a_y], p_direct)).ravel()
        assert float(solved([phi, p], [accel], p_indirect)) == pytest.approx(a_y, rel=1e-12)


@pytest.mark.parametrize(
    ("load", "I_1", "I_2", "w_n"), [(0.0, 0.14564, 0.05916, 6.68), (0.2, 0.16066, 0.06222, 6.09)]
)
def test_table_7_2_has_the_inertias_and_the_frequency_of_the_thesis(load, I_1, I_2, w_n):
    """Derived from Table 7.2 with (7.8) and (7.25); w_n^2 = (k + S g)/I_1 of the direct model."""
    values = {"k": K, "d": 0.0, "I_x": I_X, "m": load}
    direct, indirect = pendulum.direct_model(), pendulum.problem.model
    stiffness_over_I_1 = -derivatives(direct, values, [1.0, 0.0], [0.0])[1]
    assert np.sqrt(stiffness_over_I_1) == pytest.approx(w_n, abs=0.005)
    S = M * Z_G + load * Z_M
    assert (K + S * G) / stiffness_over_I_1 == pytest.approx(I_1, abs=5e-6)
    assert K / -derivatives(indirect, values, [1.0, 0.0], [0.0])[1] == pytest.approx(I_2, abs=5e-6)


def nonlinear_pendulum():
    """The pendulum for large angles: (7.9) with a_s = z_s phi'' + g sin(phi) - a_y cos(phi)."""
    m = casid.Model("pendulum for large angles")
    phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    a_y = m.unknown_input("a_y", "m/s^2")
    k, d = m.parameter("k", "N m/rad"), m.parameter("d", "N m s/rad")
    I_1, S = m.parameter("I_1", "kg m^2"), m.parameter("S", "kg m")
    z_s, g = m.constant("z_s", Z_S, "m"), m.constant("g", G, "m/s^2")
    m.derivative(phi, p)
    terms = [-k * phi, -S * g * ca.sin(phi), -d * p, S * ca.cos(phi) * a_y]
    m.balance(p, "torque", inertia=I_1, terms=terms)
    m.output("gyro", p, "rad/s")
    m.output("accel", z_s * m.der(p) + g * ca.sin(phi) - a_y * ca.cos(phi), "m/s^2")
    return m


def test_a_gain_that_depends_on_the_state_is_eliminated_as_the_numbers_are():
    """Two equations, two unknowns (phi'', a_y): the symbolic solution is the numeric one."""
    rng = np.random.default_rng(6)
    model = nonlinear_pendulum().eliminate("a_y", using="accel")
    e = model.explicit()
    solved = ca.Function("s", [e.x, e.u, e.p], [e.f, e.eliminated["a_y"]])
    S, I_1 = M * Z_G, I_X + M * Z_G**2
    p = [{"k": K, "d": D, "I_1": I_1, "S": S, "z_s": Z_S, "g": G}[n] for n in e.parameters]
    for _ in range(5):
        phi, rate, a_s = rng.uniform(-1.2, 1.2), *rng.standard_normal(2)
        matrix = [[I_1, -S * np.cos(phi)], [Z_S, -np.cos(phi)]]
        right = [-K * phi - S * G * np.sin(phi) - D * rate, a_s - G * np.sin(phi)]
        acceleration, a_y = np.linalg.solve(matrix, right)
        f, w = solved([phi, rate], [a_s], p)
        assert float(f[1]) == pytest.approx(acceleration, rel=1e-10)
        assert float(w) == pytest.approx(a_y, rel=1e-10)


def test_the_linear_indirect_model_is_exact_for_large_angles():
    """S (cos(phi) a_y - g sin(phi)) = S (z_s phi'' - a_s): what is not linear leaves with a_y."""
    rng = np.random.default_rng(8)
    large = nonlinear_pendulum().eliminate("a_y", using="accel")
    linear = pendulum.problem.model
    a = {"k": K, "d": D, "I_1": I_X + M * Z_G**2, "S": M * Z_G}
    b = {"k": K, "d": D, "I_x": I_X}
    for _ in range(5):
        x, a_s = rng.uniform(-1.2, 1.2, 2), rng.standard_normal(1)
        np.testing.assert_allclose(
            derivatives(large, a, x, a_s), derivatives(linear, b, x, a_s), rtol=1e-10
        )


def test_the_simulated_pendulum_obeys_its_model():
    """The file's simulator (direct, nonlinear) against the indirect model it is to be fitted with.

    What is left is the straight line between samples of an acceleration with kinks, of order
    Ts^2: 9e-5 rad/s, a hundredth of the noise that the example carries.
    """
    from casid.estimation.simulation.integration.simulator import Simulator

    record = pendulum.simulate(noise=0.0, duration=20.0)
    model = pendulum.problem.model.with_known(k=K, d=D, I_x=I_X)
    e = model.explicit()
    p = np.array([model.parameters[n].value for n in e.parameters])
    run = Simulator(model, record.Ts).simulate(record["accel"][:, None], p, np.zeros(2))
    assert np.sqrt(np.mean((run.y[:, 0] - record["gyro"]) ** 2)) < 2e-4


# -- elimination refused -----------------------------------------------------------------------


def test_an_output_that_does_not_feel_the_input_cannot_eliminate_it():
    with pytest.raises(ModelError, match=r"do not determine a_y.*an output that responds to it"):
        pendulum.direct_model().eliminate("a_y", using="gyro")


def test_a_mistyped_output_is_answered_with_the_nearest():
    with pytest.raises(ModelError, match=r"did you mean 'accel'"):
        pendulum.direct_model().eliminate("a_y", using="acel")


def squared_wind():
    m = casid.Model("vane")
    v = m.state("v", "m/s")
    w = m.unknown_input("w", "m/s")
    c, M_ = m.parameter("c", "N s/m"), m.parameter("M", "kg")
    b = m.parameter("b", "Pa s^2/m^2")
    m.balance(v, "force", inertia=M_, terms=[c * (w - v)])
    m.output("speed", v, "m/s")
    m.output("pressure", b * w**2, "Pa")
    return m, w, b


def test_where_the_solution_is_not_unique_the_branch_is_asked_for():
    m, w, _ = squared_wind()
    with pytest.raises(ModelError, match=r"not linear in w.*give the branch.*solution="):
        m.eliminate(w, using="pressure")


def test_a_branch_is_taken_where_it_solves_the_output_and_refused_where_not():
    m, w, b = squared_wind()
    y = m.eliminated_symbol("pressure")
    upwind = m.eliminate(w, using="pressure", solution=ca.sqrt(y) / ca.sqrt(b))
    at = derivatives(upwind, {"c": 2.0, "M": 4.0, "b": 3.0}, [1.0], [12.0])
    assert at[0] == pytest.approx(2.0 * (np.sqrt(12.0 / 3.0) - 1.0) / 4.0)
    with pytest.raises(ModelError, match=r"does not satisfy the output pressure.*substituted"):
        m.eliminate(w, using="pressure", solution=ca.sqrt(y))


# -- the other two -----------------------------------------------------------------------------


def test_a_decay_without_the_extras_swings_at_the_frequency_of_its_restoring_moment():
    """Period 2 pi / sqrt(C_1 - B_1^2/4), from the upward zero crossings of a simulated decay."""
    record = roll_decay.simulate(B_1=0.05, B_2=0.0, C_3=0.0, noise=0.0)
    phi = record["phi"]
    k = np.flatnonzero((phi[:-1] < 0) & (phi[1:] >= 0))
    crossings = record.Ts * (k - phi[k] / (phi[k + 1] - phi[k]))
    period = np.mean(np.diff(crossings))
    assert period == pytest.approx(2 * np.pi / np.sqrt(6.06 - 0.05**2 / 4), rel=1e-5)


def test_the_positioning_loop_follows_its_reference_and_dry_friction_makes_it_stick():
    record = emps.simulate(noise=0.0)
    smooth = emps.simulate(noise=0.0, F_c=0.0, F_0=0.0)
    # Sticking at the turns: the cart stands still over whole samples only with dry friction.
    still = [int(np.sum(np.abs(np.diff(r["q"])) < 1e-12)) for r in (record, smooth)]
    assert still[0] > 5
    assert still[1] == 0
