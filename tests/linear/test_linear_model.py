"""Linear models: linearised, reduced by structure, turned into transfer functions and back."""

from __future__ import annotations

import pickle

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from casid.errors import ModelError
from casid.linear.linear_model import LinearModel, adjugate_polynomials, linearise
from casid.model.effects.balances.balance_effects import coulomb_friction, offset, quadratic_damping
from casid.model.effects.channels.channel_effects import sensor_bias
from casid.model.effects.channels.delays import time_delay
from casid.model.effects.parameter_effects import parameter_jump
from casid.model.model import Model
from problems.pendulum import direct_model
from tests.support.linear_models import (
    NOMINAL,
    Z_G,
    Z_S,
    G,
    M,
    chain_values,
    indirect,
    spring_chain,
)

# -- matrices ----------------------------------------------------------------------------------


def test_the_indirect_pendulum_is_7_26():
    """A = [0 1; -k/I_2 -d/I_2], B = [0; -S/I_2], y = phi' (Linder 2017, (7.26))."""
    A, B, C, D = linearise(indirect()).matrices(NOMINAL)
    S = M * Z_G
    I_2 = 0.1385 + M * Z_G * (Z_G - Z_S)
    assert pytest.approx(0.05916, abs=5e-6) == I_2
    np.testing.assert_allclose(A, [[0, 1], [-10.39 / I_2, -0.1067 / I_2]], rtol=1e-13)
    np.testing.assert_allclose(B, [[0], [-S / I_2]], rtol=1e-13)
    np.testing.assert_array_equal(C, [[0, 1]])
    np.testing.assert_array_equal(D, [[0]])


def test_the_direct_pendulum_is_7_16():
    """The elimination undone: input a_y, outputs the gyro and the accelerometer (7.16)."""
    model = linearise(indirect().direct())
    assert (model.inputs, model.outputs) == (("a_y",), ("gyro", "accel"))
    A, B, C, D = model.matrices(NOMINAL)
    S, I_1 = M * Z_G, 0.1385 + M * Z_G**2
    It_1 = I_1 / Z_S
    K = 10.39 + S * G
    assert pytest.approx(0.14564, abs=5e-6) == I_1
    np.testing.assert_allclose(A, [[0, 1], [-K / I_1, -0.1067 / I_1]], rtol=1e-13)
    np.testing.assert_allclose(B, [[0], [S / I_1]], rtol=1e-13)
    np.testing.assert_allclose(C, [[0, 1], [-K / It_1 + G, -0.1067 / It_1]], rtol=1e-13)
    np.testing.assert_allclose(D, [[0], [(S - It_1) / It_1]], rtol=1e-13)


def test_a_nonlinear_pendulum_has_the_matrices_of_the_linear_one():
    """sin(phi), cos(phi) a_y, drag: first order at phi = 0 leaves (7.24), and says so."""
    m = direct_model()
    phi, p, a_y = (m.symbol(n) for n in ("phi", "p", "a_y"))
    S = m.symbol("M") * m.symbol("z_g") + m.symbol("m") * m.symbol("z_m")
    torque = m.balances["torque"]
    m._rates, m.balances = {"phi": p}, {}  # the same model with (7.9) for its torque balance
    d_2 = m.parameter("d_2", "N m s^2/rad^2", value=0.2)
    g = m.symbol("g")
    m.balance(
        p,
        "torque",
        inertia=torque.inertia,
        terms=[
            -m.symbol("k") * phi - S * g * ca.sin(phi) - m.symbol("d") * p,
            S * ca.cos(phi) * a_y - d_2 * ca.fabs(p) * p,
        ],
    )
    a_s = m.symbol("z_s") * m.der(p) + g * ca.sin(phi) - a_y * ca.cos(phi)
    m.replace_output("accel", a_s, "m/s^2")
    nonlinear = linearise(m.eliminate("a_y", using="accel"))
    for got, wanted in zip(
        nonlinear.matrices(NOMINAL), linearise(indirect()).matrices(NOMINAL), strict=True
    ):
        np.testing.assert_allclose(got, wanted, atol=1e-12)
    assert any("nonlinear" in n for n in nonlinear.notes)
    assert any("d_2" in n for n in nonlinear.notes)
    assert nonlinear.is_nonlinear
    assert "d_2" in nonlinear.lost


def test_an_equilibrium_may_depend_on_the_parameters():
    """q'' = F - k q - k_3 q^3 + F_0 at rest at q_0: stiffness k + 3 k_3 q_0^2 about it."""
    m = Model("hardening spring")
    q, v = m.state("q", "m"), m.state("v", "m/s")
    F = m.input("F", "N")
    k, k_3, q_0 = (m.parameter(n, u) for n, u in (("k", "N/m"), ("k_3", "N/m^3"), ("q_0", "m")))
    m.derivative(q, v)
    m.balance(v, "force", inertia=1.0, terms=[F, -k * q, -k_3 * q**3])
    m.output("q", q, "m")
    linear = linearise(m, x={"q": q_0}, u={"F": k * q_0 + k_3 * q_0**3})
    A, *_ = linear.matrices({"k": 2.0, "k_3": 5.0, "q_0": 0.3})
    np.testing.assert_allclose(A, [[0, 1], [-(2.0 + 3 * 5.0 * 0.3**2), 0]], rtol=1e-14)
    at_rest = ca.Function("at_rest", [q_0], [linear.equilibrium["q"]])
    assert float(at_rest(0.3)) == 0.3


def test_away_from_an_equilibrium_is_refused():
    with pytest.raises(ModelError, match=r"d.*/dt = .*give the values at rest"):
        linearise(indirect(), x={"phi": 0.1})


def test_a_constant_force_has_no_equilibrium_at_zero():
    """An offset in a balance moves the equilibrium: named with the rate that it drives."""
    with pytest.raises(ModelError, match=r"dp/dt .* drop the constant"):
        linearise(indirect().extend(offset(indirect(), "torque")))


def test_an_unknown_name_in_the_equilibrium_is_refused_with_the_nearest():
    with pytest.raises(ModelError, match="did you mean 'phi'"):
        linearise(indirect(), x={"phj": 0.0})


def test_an_infinite_slope_is_refused():
    """sqrt(q) at q = 0."""
    m = Model("tank")
    q, u, c = m.state("q", "m"), m.input("u", "m/s"), m.parameter("c", "m^0.5/s")
    m.derivative(q, u - c * ca.sqrt(q))
    m.output("q", q, "m")
    with pytest.raises(ModelError, match="not finite .* choose another equilibrium"):
        linearise(m)


@pytest.mark.parametrize(
    "make",
    [
        lambda m: time_delay(m, "gyro", 0.1),
        lambda m: time_delay(m, "accel", 0.1),
        lambda m: parameter_jump(m, "k", 3.0),
    ],
    ids=["output delay", "input delay", "jump"],
)
def test_delays_and_jumps_have_no_linear_model_of_finite_order(make):
    m = indirect()
    with pytest.raises(ModelError, match="without that effect"):
        linearise(m.extend(make(m)))


def test_a_missing_value_is_named():
    with pytest.raises(ModelError, match="no value for k, d; give one"):
        linearise(indirect()).matrices({"I_x": 0.1})


def test_the_ships_poles_are_the_published_ones():
    """(8.3)-(8.7) with Table 8.2 and the signs of erratum E-22; N_|u|v = 0. Coupled inertias."""
    m = Model("sway, roll and yaw")
    phi, psi = m.state("phi", "rad"), m.state("psi", "rad")
    v, p, r = m.state("v", "m/s"), m.state("p", "rad/s"), m.state("r", "rad/s")
    rudder, C_2 = m.input("rudder", "rad"), m.parameter("C_2", "N/rad", value=1.7)
    z_g, g, mass, A_x, z_r, x_r = -0.028, 9.82, 22.04, 0.1385, 0.2, -0.6
    S = mass * z_g
    m.derivative(phi, p)
    m.derivative(psi, r)
    m.balance(
        v,
        "sway",
        inertia=mass + 100.0,
        terms=[(S + 0.1) * m.der(p), -m.der(r), -35.0 * v, -mass * r, C_2 * rudder],
    )
    m.balance(
        p,
        "roll",
        inertia=A_x + mass * z_g**2,
        terms=[
            (S + 0.1) * m.der(v),
            -(10.38 + S * g) * phi,
            -0.2067 * p,
            (-0.4 + S) * r,
            -z_r * C_2 * rudder,
        ],
    )
    m.balance(
        r, "yaw", inertia=3 * A_x, terms=[-m.der(v), -1.4 * r, x_r * C_2 * rudder], unit="N m"
    )
    m.output("gyro", p, "rad/s")
    m.output("heading", psi, "rad")
    model = linearise(m)
    poles = np.sort_complex(np.linalg.eigvals(model.matrices({})[0]))
    wanted = [-2.971, -0.697 - 5.241j, -0.697 + 5.241j, -0.334, 0.0]
    np.testing.assert_allclose(poles, wanted, atol=5e-4)
    assert model.transfer("gyro").order == 4  # the heading is not felt
    assert model.transfer("heading").order == 5
    roots = np.sort_complex(np.roots(model.transfer("gyro").evaluate()[0]))
    np.testing.assert_allclose(roots, wanted[:-1], atol=5e-4)


# -- transfer functions ------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 3])
def test_transfer_functions_are_c_times_resolvent_times_b(n):
    """Faddeev-LeVerrier against the resolvent at points off the spectrum."""
    model = linearise(spring_chain(n))
    values = chain_values(n, seed=n)
    A, B, C, D = model.matrices(values)
    a, b = model.transfer().evaluate(values)
    np.testing.assert_allclose(a, np.poly(A), rtol=1e-11)
    for s in (0.3 + 1j, -2.0 + 0.5j, 5.0):
        wanted = C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D
        got = [[np.polyval(b_ij, s) / np.polyval(a, s) for b_ij in row] for row in b]
        np.testing.assert_allclose(got, wanted, rtol=1e-10)


@given(seed=st.integers(0, 10_000), n=st.integers(1, 6))
def test_the_characteristic_polynomial_is_that_of_the_eigenvalues(seed, n):
    """Also for non-symmetric matrices with complex eigenvalues."""
    A = np.random.default_rng(seed).standard_normal((n, n))
    coefficients, adjugate = adjugate_polynomials(ca.SX(A))
    np.testing.assert_allclose(
        np.array(ca.DM(coefficients)).ravel(), np.poly(A), rtol=1e-8, atol=1e-9
    )
    # adj(s - A) (s - A) = det(s - A)
    s = 1.7
    adj = sum(np.array(ca.DM(m)) * s ** (n - 1 - k) for k, m in enumerate(adjugate))
    np.testing.assert_allclose(
        adj @ (s * np.eye(n) - A), np.polyval(np.poly(A), s) * np.eye(n), atol=1e-7
    )


def test_the_pendulum_keeps_one_numerator_coefficient():
    """G = beta_1 s / (s^2 + alpha_1 s + alpha_2) (7.27): zeros of the numerator are structural."""
    t = linearise(indirect()).transfer()
    assert t.order == 2
    assert [t.numerators[0][0][k].nnz() for k in range(3)] == [0, 1, 0]


def test_states_that_nothing_excites_or_nobody_sees_are_dropped():
    """Heading integrates the rate and is not measured; a disturbance model has no input."""
    m = spring_chain(1)
    w, heading = m.state("w", "1"), m.state("heading", "m s")
    tau = m.parameter("tau", "s", start=1.0)
    m.derivative(w, -w / tau)
    m.derivative(heading, m.symbol("q0") + w)
    part = linearise(m).subsystem()
    assert part.states == ("q0", "v0")
    assert linearise(m).transfer().order == 2


def test_an_output_is_given_the_states_it_sees():
    """A mass that is only pushed from the left is of order 2, the one behind it of order 4."""
    m = Model("one way")
    q, v, r = m.state("q", "m"), m.state("v", "m/s"), m.state("r", "m")
    F, k, c = m.input("F", "N"), m.parameter("k", "1/s^2"), m.parameter("c", "1/s")
    m.derivative(q, v)
    m.derivative(v, F - k * q)
    m.derivative(r, c * (q - r))
    m.output("front", q, "m")
    m.output("behind", r, "m")
    linear = linearise(m)
    assert linear.transfer("front").order == 2
    assert linear.transfer("behind").order == 3
    assert linear.transfer().order == 3


def test_a_free_decay_keeps_its_states():
    """No input reaches the roll: the states that are seen stay."""
    m = Model("decay")
    q, v, k = m.state("q", "rad"), m.state("v", "rad/s"), m.parameter("k", "1/s^2")
    m.derivative(q, v)
    m.derivative(v, -k * q)
    m.output("q", q, "rad")
    assert linearise(m).transfer().order == 2


def test_a_common_factor_s_is_cancelled():
    """Two masses joined by a spring, the stretch measured: the rigid motion is not in it."""
    m = Model("two free masses")
    q, r, v, w = (m.state(n, "m") for n in "qrvw")
    F, k, a = m.input("F", "N"), m.parameter("k", "N/m"), m.parameter("a", "kg")
    m.derivative(q, v)
    m.derivative(r, w)
    m.derivative(v, (F - k * (q - r)) / a)
    m.derivative(w, k * (q - r))
    m.output("stretch", q - r, "m")
    t = linearise(m).transfer()
    assert t.order == 2
    a_, b = t.evaluate({"k": 3.0, "a": 2.0})
    np.testing.assert_allclose(a_, [1, 0, 3.0 * (1 + 1 / 2.0)], atol=1e-14)
    np.testing.assert_allclose(b[0][0], [0, 0, 1 / 2.0])


def test_control_gets_the_same_system():
    values = chain_values(2, seed=5)
    model = linearise(spring_chain(2))
    system = model.to_control(values)
    a, b = model.transfer().evaluate(values)
    assert system.output_labels == ["q", "v"]
    s = 0.4 + 2.0j
    np.testing.assert_allclose(
        np.ravel(system(s)), [np.polyval(b[i][0], s) / np.polyval(a, s) for i in (0, 1)]
    )


def test_transfer_functions_can_be_differentiated_in_the_parameters():
    """d alpha_2 / dk = 1 / I_2."""
    t = linearise(indirect()).transfer()
    slope = ca.Function("d", [t.p], [ca.jacobian(t.denominator, t.p)])
    linear: LinearModel = linearise(indirect())
    got = np.array(slope(linear.vector(NOMINAL)))[2, linear.parameters.index("k")]
    assert got == pytest.approx(1.0 / (0.1385 + M * Z_G * (Z_G - Z_S)))


def test_an_unknown_output_is_refused_with_the_nearest():
    with pytest.raises(ModelError, match="did you mean 'gyro'"):
        linearise(indirect()).transfer("gyr")


# -- undoing eliminations ----------------------------------------------------------------------


def same_model(one: Model, other: Model) -> None:
    a, b = one.explicit(), other.explicit()
    assert (a.states, a.inputs, a.outputs) == (b.states, b.inputs, b.outputs)
    rng = np.random.default_rng(3)
    point = [rng.uniform(0.2, 1.0, n) for n in (len(a.states), len(a.inputs), len(a.parameters))]
    names = dict(zip(a.parameters, point[2], strict=True))
    for part in ("f", "h"):
        f = ca.Function("f", [a.x, a.u, a.p], [getattr(a, part)])
        g = ca.Function("g", [b.x, b.u, b.p], [getattr(b, part)])
        shared = [names[n] for n in b.parameters]
        np.testing.assert_allclose(
            np.array(f(*point)), np.array(g(point[0], point[1], shared)), rtol=1e-12
        )


def test_undoing_an_elimination_gives_the_direct_model_back():
    same_model(indirect().direct(), direct_model())


def test_eliminating_again_gives_the_indirect_model_back():
    same_model(indirect().direct().eliminate("a_y", using="accel"), indirect())


def test_undoing_nothing_changes_nothing():
    same_model(direct_model().direct(), direct_model())


def test_several_eliminations_are_undone_in_turn():
    """Two unknown forces, each felt by its own accelerometer; their order stays as declared."""

    def build() -> Model:
        m = Model("two masses")
        v, w = m.state("v", "m/s"), m.state("w", "m/s")
        f, e = m.unknown_input("f", "N"), m.unknown_input("e", "N")
        u, c = m.input("u", "N"), m.parameter("c", "N s/m")
        m.balance(v, "first", inertia=2.0, terms=[f, u, -c * (v - w)])
        m.balance(w, "second", inertia=3.0, terms=[e, c * (v - w)])
        m.output("a1", m.der(v) + 0.3 * f + 0.1 * e, "m/s^2")
        m.output("v", v + w, "m/s")
        m.output("a2", m.der(w) - 0.2 * e, "m/s^2")
        return m

    eliminated = build().eliminate("f", using="a1").eliminate("e", using="a2")
    assert tuple(eliminated.inputs) == ("u", "a1", "a2")
    same_model(eliminated.direct(), build())


def test_an_elimination_with_a_branch_is_undone_to_the_original_output():
    """y = u^2: the branch u = sqrt(y) is forgotten, the square is back."""

    def build() -> Model:
        m = Model("square")
        q, u, c = m.state("q", "1"), m.unknown_input("u", "1"), m.parameter("c", "1/s")
        m.derivative(q, -c * q + u)
        m.output("q", q, "1")
        m.output("y", u**2, "1")
        return m

    m = build()
    indirect_square = m.eliminate("u", using="y", solution=ca.sqrt(m.eliminated_symbol("y")))
    same_model(indirect_square.direct(), build())


@pytest.mark.parametrize("channel", ["accel", "gyro"])
def test_a_sensor_bias_of_the_indirect_model_is_that_of_the_direct_one(channel):
    """The eliminated channel is corrected as an input, and reads too much as an output."""
    one = indirect().extend(sensor_bias(indirect(), channel)).direct()
    other = direct_model().extend(sensor_bias(direct_model(), channel))
    same_model(one, other)


@pytest.mark.parametrize("make", [quadratic_damping, lambda m, b: coulomb_friction(m, b, 0.1)])
def test_an_effect_in_a_balance_survives_the_undoing(make):
    one = indirect().extend(make(indirect(), "torque")).direct()
    same_model(one, direct_model().extend(make(direct_model(), "torque")))


def test_a_jump_reaches_the_output_that_was_eliminated():
    """z_s stands in the accelerometer alone; the jump must be in the direct model's output."""
    one = indirect().extend(parameter_jump(indirect(), "z_s", 3.0)).direct()
    other = direct_model().extend(parameter_jump(direct_model(), "z_s", 3.0))
    same_model(one, other)


def test_a_delayed_input_becomes_a_delayed_output():
    m = indirect().extend(time_delay(indirect(), "accel", 0.1)).direct()
    assert [(s.kind, s.channel) for s in m.stages] == [("delay", "accel")]
    assert tuple(m.inputs) == ("a_y",)
    same_model(m, direct_model().extend(time_delay(direct_model(), "accel", 0.1)))


def test_a_channel_made_nonlinear_cannot_be_undone():
    m = indirect()
    m.substitute_symbol("accel", m.symbol("accel") ** 3)
    with pytest.raises(ModelError, match=r"accel enters .* call direct\(\) before"):
        m.direct()


# -- travelling to other processes -------------------------------------------------------------


def test_transfer_functions_are_printed_in_letters():
    """(7.26) of Linder (2017): -S s / (I_2 s^2 + d s + k)."""
    transfer = linearise(indirect()).transfer()
    head, line = str(transfer).splitlines()
    assert head == repr(transfer)
    assert line == (
        "  gyro / accel = ((-M*z_g - m*z_m) s) / ((I_x + I_xm + M*z_g^2 - M*z_g*z_s + m*z_m^2 - "
        "m*z_m*z_s) s^2 + d s + k)"
    )
    chain = linearise(spring_chain(1)).transfer()
    assert str(chain).splitlines()[1:] == [
        "  q / F = 1 / D",
        "  v / F = s / D",
        "  D = m0 s^2 + d0 s + k0",
    ]
    assert str(pickle.loads(pickle.dumps(chain))) == str(chain)


def test_transfer_functions_too_large_to_read_say_where_the_numbers_are():
    transfer = linearise(spring_chain(4)).transfer()
    text = str(transfer)
    assert "too many to print; evaluate(values) has numbers" in text
    assert "\n" not in text
    denominator, _ = transfer.evaluate(chain_values(4, 1))
    assert np.isfinite(denominator).all()


def test_one_output_need_not_stand_in_a_list():
    linear = linearise(spring_chain(1))
    assert linear.subsystem("q").outputs == ("q",)
    with pytest.raises(ModelError, match="no output 'qq'; did you mean 'q'"):
        linear.subsystem("qq")


def test_a_pickled_model_is_the_model():
    """Matrices, equilibrium and transfer functions share their parameters' symbols again."""
    model = linearise(indirect())
    other = pickle.loads(pickle.dumps(model))
    for got, wanted in zip(other.matrices(NOMINAL), model.matrices(NOMINAL), strict=True):
        np.testing.assert_array_equal(got, wanted)
    assert (other.A[0, 0].nnz(), other.notes) == (0, model.notes)
    transfer = pickle.loads(pickle.dumps(other.transfer()))
    np.testing.assert_array_equal(
        transfer.evaluate(NOMINAL)[0], model.transfer().evaluate(NOMINAL)[0]
    )
    assert [transfer.numerators[0][0][k].nnz() for k in range(3)] == [0, 1, 0]


# -- what vanishes -----------------------------------------------------------------------------


def test_rounded_constants_do_not_leave_coefficients_behind():
    """0.1 * 3 q - 0.3 q is 5.5e-17 q in floating point: no coefficient, so no regressor."""
    m = spring_chain(1)
    q, v, c = m.symbol("q0"), m.symbol("v0"), m.parameter("c", "1/m")
    m.output("y", c * ((0.1 * 3) * q - 0.3 * q + v), "1")
    numerator = linearise(m).transfer("y").numerators[0][0]
    assert [numerator[k].nnz() for k in range(3)] == [0, 1, 0]
    m.output("z", c * (q * (c * (0.1 * 3)) - q * (0.3 * c) + v), "1")  # seen with c alone
    numerator = linearise(m).transfer("z").numerators[0][0]
    assert [numerator[k].nnz() for k in range(3)] == [0, 1, 0]


def test_small_constants_are_coefficients():
    """1e-13 q beside v is what the model says: it stays, whatever its size."""
    m = spring_chain(1)
    m.output("y", 1e-13 * m.symbol("q0") + m.symbol("v0"), "1")
    numerator = linearise(m).transfer("y").numerators[0][0]
    assert [numerator[k].nnz() for k in range(3)] == [0, 1, 1]


def test_a_root_of_parameters_is_judged_in_floating_point():
    """sqrt(k)^2 - k vanishes, sqrt(k) - k does not."""
    m = spring_chain(1)
    k, q, v = m.symbol("k0"), m.symbol("q0"), m.symbol("v0")
    m.output("none", (ca.sqrt(k) * ca.sqrt(k) - k) * q + v, "1")
    m.output("some", (ca.sqrt(k) - k) * q + v, "1")
    model = linearise(m)
    assert model.C[2, 0].nnz() == 0
    assert model.C[3, 0].nnz() == 1
