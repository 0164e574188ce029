"""The closed-loop view is the direct model again, and says which estimators the loop biases."""

from __future__ import annotations

import pickle
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import scipy.signal
import sympy

from casid.errors import ModelError, SolveError
from casid.linear.loops.closed_loop import closed_loop_view
from casid.linear.loops.discrete_loop import bilinear
from casid.model.model import Model
from problems.pendulum import direct_model

NAMES = "M z_g k I_x d I_xm m z_m z_s g p a_y"
M, z_g, k, I_x, d, I_xm, m, z_m, z_s, g, p, a_y = sympy.symbols(NAMES)
S = M * z_g + m * z_m
I_1 = I_x + M * z_g**2 + I_xm + m * z_m**2
I_2 = I_1 - z_s * S
NOMINAL = {"k": 10.39, "d": 0.1067, "I_x": 0.1385, "m": 0.0}
LOADED = {**NOMINAL, "m": 0.2}


@pytest.fixture(scope="module")
def pendulum():
    return closed_loop_view(direct_model().eliminate("a_y", using="accel"))


def same(got, expected) -> bool:
    return sympy.cancel(got - expected) == 0


def theory(values=NOMINAL, Ts=0.01):
    """(7.29), (7.34) and T-2's fn in numbers."""
    number = {str(s): v for s, v in zip((M, z_g, z_m, z_s, I_xm), TABLE, strict=True)}
    at = {sympy.Symbol(n): v for n, v in {**number, **values}.items()}
    S_, I_2_ = float(S.subs(at)), float(I_2.subs(at))
    alpha1, alpha2, beta1 = values["d"] / I_2_, values["k"] / I_2_, -S_ / I_2_
    bar = 4 + 2 * alpha1 * Ts + alpha2 * Ts**2
    A = np.array([1, (2 * alpha2 * Ts**2 - 8) / bar, (4 - 2 * alpha1 * Ts + alpha2 * Ts**2) / bar])
    c = 2 / Ts
    fn = np.array([TABLE[3] * c**2 + 9.81, 2 * 9.81 - 2 * TABLE[3] * c**2, TABLE[3] * c**2 + 9.81])
    return A, 2 * beta1 * Ts / bar, 2 * Ts / I_2_ / bar, c, fn, beta1


TABLE = (22.04, -0.018, -0.274, -0.218, 0.0)  # M, z_g, z_m, z_s, I_xm of Table 7.2


# -- proposition 7.1 -----------------------------------------------------------------------------


def test_the_indirect_pendulum_is_7_28(pendulum):
    assert same(pendulum.G_O[0], -S * p / (I_2 * p**2 + d * p + k))
    assert same(pendulum.H_O[0], p / (I_2 * p**2 + d * p + k))


def test_the_return_path_is_7_30(pendulum):
    """a_s = (z_s p^2 + g)/p phi' - a_y, from the gyro and d(phi)/dt = p, without a balance."""
    assert same(pendulum.F_y[0], (z_s * p**2 + g) / p)
    assert pendulum.external == sympy.Matrix([-a_y])
    assert pendulum.F_tau == sympy.zeros(1, 1)
    assert pendulum.used == ("output gyro", "dphi/dt")


def test_proposition_7_1_closing_the_loop_gives_the_direct_model(pendulum):
    """Identically in all parameters; the direct model is (7.10) and (7.14), written here by hand.

    The external signal is -a_y: (7.55) as printed has the opposite sign.
    """
    den = I_1 * p**2 + d * p + k + S * g
    rate = S * p / den  # a_y -> phi'
    sensor = z_s * p * rate + g * rate / p - 1  # a_y -> a_s
    assert same(pendulum.closed[0, 0], rate)
    assert same(pendulum.closed[1, 0], sensor)
    assert same(pendulum.closed[0, 1], p / den)  # torque disturbance -> phi'
    assert pendulum.closed == pendulum.response
    assert pendulum.difference() == sympy.zeros(2, 2)


def test_the_nonlinear_pendulum_has_the_same_loop(pendulum):
    """(7.9) and its accelerometer, linearised: sin(phi) is phi, and phi a_y is of second order."""
    direct = direct_model()
    phi, u = direct.symbol("phi"), direct.symbol("a_y")
    S_ = direct.symbol("M") * direct.symbol("z_g") + direct.symbol("m") * direct.symbol("z_m")
    gravity = S_ * direct.symbol("g")
    direct.add_term("torque", gravity * (phi - ca.sin(phi)) + S_ * u * (ca.cos(phi) - 1))
    accel = direct.symbol("z_s") * direct.der("p") + direct.symbol("g") * ca.sin(phi)
    direct.replace_output("accel", accel - u * ca.cos(phi), "m/s^2")
    view = closed_loop_view(direct.eliminate("a_y", using="accel"))
    for got, expected in ((view.G_O, pendulum.G_O), (view.F_y, pendulum.F_y)):
        assert same(got[0], expected[0])
    assert view.external == pendulum.external
    assert view.difference() == sympy.zeros(2, 2)


# -- the direct term -----------------------------------------------------------------------------


def test_the_direct_term_is_beta1_z_s(pendulum):
    """(7.29): beta1 = -S / I_2; 1 - beta1 z_s = I_1 / I_2, by which the loop divides."""
    assert same(pendulum.direct_term[0], -S / I_2 * z_s)
    assert same(1 - pendulum.direct_term[0], I_1 / I_2)
    assert pendulum.has_direct_term
    assert pendulum.direct_term_at(NOMINAL)[0, 0] == pytest.approx(1 - 0.14564 / 0.05916, rel=1e-3)


def test_an_accelerometer_at_the_pivot_has_no_direct_term():
    view = closed_loop_view(
        direct_model().eliminate("a_y", using="accel"), values={"z_s": 0.0, "M": 22.04}
    )
    assert same(view.F_y[0], g / p)
    assert view.direct_term == sympy.zeros(1, 1)
    assert not view.has_direct_term
    assert "M" not in view.parameters


def test_a_sensor_of_derivative_and_input_halves_the_loop():
    """y = w + v'' and v'' = w - c v' give v'' = (y - c v')/2, so G_O F_y = p^2/(2 p^2 + c p)."""
    model = Model("integrators")
    v, a = model.state("v", "m/s"), model.state("a", "m/s^2")
    w, c = model.unknown_input("w", "m/s^3"), model.parameter("c", "1/s")
    model.derivative(v, a)
    model.balance(a, "jerk", inertia=1, terms=[w, -c * a])
    model.output("v", v, "m/s")
    model.output("y", w + model.der(a), "m/s^3")
    view = closed_loop_view(model.eliminate("w", using="y"))
    assert same(view.F_y[0], view.p**2)
    assert view.direct_term[0] == sympy.Rational(1, 2)
    assert view.difference() == sympy.zeros(2, 2)


def test_a_loop_that_nothing_enters_is_refused(pendulum):
    """u_I = y_O / G_O and no external signal: the indirect model holds for all parameters."""
    nothing = sympy.zeros(1, 1)
    back = replace(pendulum.back, F_y=sympy.Matrix([1 / pendulum.G_O[0]]), F_w=nothing)
    view = replace(pendulum, back=back)
    assert view.is_degenerate
    assert "nothing enters the loop from outside" in str(view)
    for refused in (lambda: view.closed, lambda: view.discrete(0.01)):
        with pytest.raises(ModelError, match="accel is determined by gyro alone.*another output"):
            refused()


def test_verdicts_follow_from_direct_term_noise_and_disturbance(pendulum):
    def consistent(view, **kind):
        return [v.is_consistent for v in view.estimators(**kind)]

    loop = closed_loop_view(direct_model().eliminate("a_y", using="accel"), values={"z_s": 0.0})
    # Least squares, prediction error with the true noise model, output error, instruments.
    assert consistent(pendulum) == [False, False, False, True]
    assert consistent(pendulum, input_noise=False) == [False, False, False, True]
    assert consistent(loop, input_noise=False) == [False, True, False, True]
    assert consistent(loop, input_noise=False, disturbed=False) == [True] * 4
    by_direct_term = [v.by_direct_term for v in pendulum.estimators(input_noise=False)]
    assert by_direct_term == [True, True, False, False]
    assert "within the same sample, by the direct term" in pendulum.estimators()[1].why


@pytest.mark.parametrize("direct_term", [True, False])
def test_the_direct_term_biases_prediction_errors_with_the_true_noise_model(direct_term):
    """(7.31)-(7.32), and by how much.

    With tau such that c0 (1 - q^-2) tau = e is white, y_t = phi_t' theta + e_t is its own one-step
    predictor, and least squares the prediction error method with the true noise model. Its bias is
    R^-1 E[phi_t e_t], where only u_t - u_{t-2} feels e_t: by fn(0)/c over the leading coefficient.
    With the sensor where z_s c^2 + g = 0 the sampled loop has no direct term, and no bias is left.
    """
    Ts, N = 0.01, 100_000
    c = 2 / Ts
    values = NOMINAL if direct_term else {**NOMINAL, "z_s": -9.81 / c**2}
    view = closed_loop_view(direct_model().eliminate("a_y", using="accel"))
    loop = view.discrete(Ts, values)
    open_loop = view.at(view.G_O, values)[0]
    num, den = (sympy.Poly(e, view.p).all_coeffs() for e in sympy.fraction(open_loop))
    A = bilinear(np.array(den, dtype=float), Ts)
    b0 = (bilinear(np.array([0.0, *num], dtype=float), Ts) / A[0])[0]
    A = A / A[0]
    c0 = loop.numerators["gyro", "tau_torque"][0] * loop.leading
    rng = np.random.default_rng(11)
    r, e = rng.standard_normal(N), 0.05 * rng.standard_normal(N)
    a = loop.denominator
    difference = np.array([1.0, 0.0, -1.0])
    y = scipy.signal.lfilter(loop.numerators["gyro", "a_y"], a, r)
    y += scipy.signal.lfilter([1 / loop.leading], a, e)
    u_from_r = np.convolve(loop.numerators["accel", "a_y"], difference)
    du = scipy.signal.lfilter(u_from_r, a, r)
    du += scipy.signal.lfilter(loop.numerators["accel", "tau_torque"] / c0, a, e)
    phi = np.column_stack([-y[1:-1], -y[:-2], du[2:]])
    theta = np.array([A[1], A[2], b0])
    np.testing.assert_allclose(y[2:] - phi @ theta, e[2:], atol=1e-9)  # the regression holds
    R = phi.T @ phi / len(phi)
    fed_back = (values.get("z_s", -0.218) * c**2 + 9.81) / c / loop.leading
    expected = np.linalg.solve(R, [0.0, 0.0, fed_back * 0.05**2])
    bias = np.linalg.lstsq(phi, y[2:], rcond=None)[0] - theta
    # phi' e / N scatters about its mean by |phi| |e| / sqrt(N), at most sqrt(3) of that here.
    error = np.sqrt(3 * 0.05**2 * np.diag(np.linalg.inv(R)) / N)
    if direct_term:
        error = error * 2.0
        assert np.max(np.abs(expected) / error) > 10  # a bias worth speaking of
    else:
        np.testing.assert_allclose(expected, 0.0, atol=1e-12)
    assert np.all(np.abs(bias - expected) < 4 * error)


# -- several inputs and outputs, other return paths ----------------------------------------------


def masses() -> Model:
    """Two masses and springs; both forces unknown, an accelerometer at each."""
    model = Model("two masses")
    x1, v1 = model.state("x1", "m"), model.state("v1", "m/s")
    x2, v2 = model.state("x2", "m"), model.state("v2", "m/s")
    f1, f2, u = (
        model.unknown_input("f1", "N"),
        model.unknown_input("f2", "N"),
        model.input("u", "N"),
    )
    m1, m2 = model.parameter("m1", "kg"), model.parameter("m2", "kg")
    c1, c2 = model.parameter("c1", "N/m"), model.parameter("c2", "N/m")
    h = model.parameter("h", "1")
    model.derivative(x1, v1)
    model.derivative(x2, v2)
    model.balance(v1, "first", inertia=m1, terms=[-c1 * x1, c2 * (x2 - x1), f1, u])
    model.balance(v2, "second", inertia=m2, terms=[-c2 * (x2 - x1), f2])
    model.output("v1", v1, "m/s")
    model.output("v2", v2, "m/s")
    model.output("y1", model.der(v1) + h * f1, "m/s^2")
    model.output("y2", model.der(v2) - f1 + 2 * f2, "m/s^2")
    return model


def test_several_inputs_and_outputs_make_matrices():
    view = closed_loop_view(masses().eliminate("f1", using="y1").eliminate("f2", using="y2"))
    assert view.outputs == ("v1", "v2")
    assert view.inputs == ("y1", "y2")
    assert view.others == ("u",)
    h, f1, f2 = sympy.symbols("h f1 f2")
    p_ = view.p
    assert view.F_y == sympy.Matrix([[p_, 0], [0, p_]])
    assert view.external == sympy.Matrix([h * f1, 2 * f2 - f1])
    assert view.G_O.shape == (2, 2)
    assert view.difference() == sympy.zeros(4, 5)
    # From two masses' equations: m1 v1' = f1 + ..., y1 = v1' + h f1 gives v1'(1 + h m1) = y1 + ...
    m1, m2 = sympy.symbols("m1 m2")
    D = view.direct_term
    assert same(D[0, 0], 1 / (1 + h * m1))
    assert same(D[1, 1], 1 / (1 + 2 * m2))
    values = {"m1": 1.3, "m2": 0.7, "c1": 40.0, "c2": 90.0, "h": 0.4}
    expected = 1 / (1 + 0.4 * 1.3), 1 / (1 + 1.4)
    np.testing.assert_allclose(np.diag(view.direct_term_at(values)), expected)


def test_an_output_that_shows_a_state_is_preferred_to_an_integral(pendulum):
    """With the angle measured as well, a_s = z_s p phi' + g phi: nothing is integrated."""
    model = direct_model()
    model.output("angle", model.symbol("phi"), "rad")
    view = closed_loop_view(model.eliminate("a_y", using="accel"))
    assert view.outputs == ("gyro", "angle")
    assert view.F_y == sympy.Matrix([[z_s * p, g]])
    assert view.difference() == sympy.zeros(3, 2)


def test_a_balance_is_used_where_nothing_else_shows_a_state():
    """The sensor also feels a second mass that no output sees: its disturbance comes in, too."""
    model = Model("hidden mass")
    v, w = model.state("v", "m/s"), model.state("w", "m/s")
    F = model.unknown_input("F", "N")
    c, q = model.parameter("c", "N s/m"), model.parameter("q", "kg")
    model.balance(v, "seen", inertia=1, terms=[-v, F])
    model.balance(w, "hidden", inertia=q, terms=[c * (v - w)])
    model.output("v", v, "m/s")
    model.output("y", F + w, "N")
    view = closed_loop_view(model.eliminate("F", using="y"))
    c_, q_, F_, tau = sympy.symbols("c q F tau_hidden")
    assert same(view.F_y[0], c_ / (q_ * p + c_))
    assert same(view.external[0], F_ + tau / (q_ * p + c_))
    assert view.used == ("output v", "balance hidden")
    assert not view.has_direct_term
    assert view.difference() == sympy.zeros(2, 3)


def test_an_eliminated_input_with_other_inputs_beside_it_keeps_them_external():
    """Ship roll, (8.16): a_s = z_s phi'' + g phi - v' - U r, and -v' - U r comes from outside."""
    model = Model("roll")
    phi, rate = model.state("phi", "rad"), model.state("rate", "rad/s")
    vdot, r = model.unknown_input("vdot", "m/s^2"), model.input("r", "rad/s")
    A_1, k_, d_ = (model.parameter(n, u) for n, u in (("A_1", "kg m^2"), ("k", "1"), ("d", "1")))
    S_, K_ur, U = (model.parameter(n, u) for n, u in (("S", "1"), ("K_ur", "1"), ("U", "m/s")))
    zs, g_ = model.parameter("z_s", "m"), model.constant("g", 9.81, "m/s^2")
    model.derivative(phi, rate)
    torque = [-(k_ + S_ * g_) * phi, -d_ * rate, S_ * vdot, (K_ur + S_) * U * r]
    model.balance(rate, "roll", inertia=A_1, terms=torque)
    model.output("gyro", rate, "rad/s")
    model.output("accel", zs * model.der(rate) + g_ * phi - vdot - U * r, "m/s^2")
    view = closed_loop_view(model.eliminate("vdot", using="accel"))
    S_, K_ur, U, A_1, v, yaw = sympy.symbols("S K_ur U A_1 vdot r")
    assert sympy.expand(view.external[0] + v + U * yaw) == 0
    A_2 = A_1 - z_s * S_  # (8.18) with K_vdot = 0
    assert same(view.G_K[0], K_ur * U * p / (A_2 * p**2 + d * p + k))
    assert view.difference() == sympy.zeros(2, 3)


def test_a_parameter_called_p_leaves_the_operator_another_letter():
    model = Model("lag")
    x, w = model.state("x", "m"), model.unknown_input("w", "m")
    model.balance(x, "lag", inertia=model.parameter("p", "s"), terms=[w, -x])
    model.output("x", x, "m")
    model.output("y", w + model.der(x), "m")
    view = closed_loop_view(model.eliminate("w", using="y"))
    assert str(view.p) == "s"
    assert same(view.F_y[0], sympy.Symbol("s"))


# -- in discrete time ----------------------------------------------------------------------------


@pytest.mark.parametrize("values", [NOMINAL, LOADED])
def test_the_discrete_loop_is_7_55_with_the_sign_of_proposition_7_1(pendulum, values):
    A, b0, c0, c, fn, _ = theory(values)
    loop = pendulum.discrete(0.01, values)
    den = A - b0 / c * fn
    np.testing.assert_allclose(loop.leading, 1 - b0 / c * (-0.218 * c**2 + 9.81), rtol=1e-12)
    np.testing.assert_allclose(loop.leading, den[0], rtol=1e-12)
    np.testing.assert_allclose(loop.denominator, den / den[0], rtol=1e-11)
    pattern = np.array([1.0, 0.0, -1.0])
    numerators = {
        ("gyro", "a_y"): -b0 * pattern,
        ("accel", "a_y"): -A,
        ("gyro", "tau_torque"): c0 * pattern,
        ("accel", "tau_torque"): c0 / c * fn,
    }
    for key, b in numerators.items():
        # The coefficients are differences of terms as large as the largest one.
        np.testing.assert_allclose(loop.numerators[key], b / den[0], rtol=1e-9, atol=1e-13)


def test_the_loop_closed_in_algebra_is_the_sampled_direct_model(pendulum):
    """Bilinear sampling commutes with closing the loop: SciPy samples the state space (7.16)."""
    rng = np.random.default_rng(2)
    a_y = scipy.signal.lfilter([0.05], [1, -0.95], rng.standard_normal(3000))
    loop = pendulum.discrete(0.01, LOADED)
    got = loop.simulate({"a_y": a_y})
    at = {
        **{"M": 22.04, "z_g": -0.018, "z_m": -0.274, "z_s": -0.218, "g": 9.81, "I_xm": 0},
        **LOADED,
    }
    number = {sympy.Symbol(n): v for n, v in at.items()}
    I1, S1 = float(I_1.subs(number)), float(S.subs(number))
    A = np.array([[0, 1], [-(LOADED["k"] + S1 * 9.81) / I1, -LOADED["d"] / I1]])
    B = np.array([[0], [S1 / I1]])
    C = np.array([[0, 1], -0.218 * A[1] + [9.81, 0]])
    D = np.array([[0], [-0.218 * S1 / I1 - 1]])
    A, B, C, D, _ = scipy.signal.cont2discrete((A, B, C, D), 0.01, "bilinear")
    x, out = np.zeros((2, 1)), np.empty((2, len(a_y)))
    for t, u in enumerate(a_y):
        out[:, [t]] = C @ x + D * u
        x = A @ x + B * u
    np.testing.assert_allclose(got["gyro"], out[0], atol=1e-10 * np.abs(out[0]).max())
    np.testing.assert_allclose(got["accel"], out[1], atol=1e-10 * np.abs(out[1]).max())
    # Statically, a cart accelerated to the right leans the pendulum, and a_s begins with -a_y.
    assert got["accel"][0] * a_y[0] < 0


def test_the_leading_coefficient_compares_the_inertias_of_both_models(pendulum):
    """1 - G_O F_y at p = 2/Ts: direct denominator over indirect one; I_1 / I_2 as Ts vanishes."""
    S_ = -22.04 * 0.018
    for Ts in (0.01, 0.1):
        direct = 4 * 0.1456410 + 2 * 0.1067 * Ts + (10.39 + S_ * 9.81) * Ts**2
        indirect = 4 * 0.0591560 + 2 * 0.1067 * Ts + 10.39 * Ts**2
        leading = pendulum.discrete(Ts, NOMINAL).leading
        assert leading == pytest.approx(direct / indirect, rel=2e-6)  # the inertias' last digit
    limit = 1 - pendulum.direct_term_at(NOMINAL)[0, 0]
    assert pendulum.discrete(1e-7, NOMINAL).leading == pytest.approx(limit, rel=1e-6)


def test_the_poles_tell_an_unstable_indirect_model_from_an_unstable_plant(pendulum):
    """I_2 < 0 (trap T-3): the plant is stable, the indirect model alone is not."""
    values = {**NOMINAL, "I_x": 0.07}
    indirect, direct = pendulum.poles(values)
    assert np.any(indirect.real > 0)
    assert np.all(direct.real < 0)
    assert pendulum.discrete(0.01, values).is_stable
    own = closed_loop_view(direct_model().with_unknown(I_x=0.081).eliminate("a_y", using="accel"))
    assert "unstable by itself" not in str(own)


def test_bilinear_substitution_of_a_polynomial():
    """p^2 + 3 p + 5 at p = c (1 - z)/(1 + z), times (1 + z)^2."""
    np.testing.assert_allclose(
        bilinear(np.array([1.0, 3.0, 5.0]), 0.5), [16 + 12 + 5, -32 + 10, 16 - 12 + 5]
    )


# -- showing and refusing ------------------------------------------------------------------------


def test_the_page_reads_as_the_thesis_has_it(pendulum):
    text = str(pendulum)
    assert "G_O[gyro, accel] = -(M z_g + m z_m) p / D" in text
    assert "F_y[accel, gyro] = (z_s p^2 + g) / p" in text
    assert "external[accel] = -a_y" in text
    assert "direct term, lim G_O F_y as p grows: not zero" in text
    assert "consistent  instrumental variables" in text
    assert max(len(line) for line in text.splitlines()) <= 110
    assert repr(pendulum).endswith("accel -> gyro, fed back, a direct term>")
    assert "stable, leading coefficient 2.4" in repr(pendulum.discrete(0.01, NOMINAL))


def test_a_model_without_elimination_has_no_loop():
    with pytest.raises(ModelError, match="call model.eliminate"):
        closed_loop_view(direct_model())


def test_a_point_that_is_no_equilibrium_is_refused():
    model = direct_model().eliminate("a_y", using="accel")
    with pytest.raises(ModelError, match="'torque' does not balance.*equilibrium="):
        closed_loop_view(model, equilibrium={"phi": 0.1})
    with pytest.raises(ModelError, match="neither state nor input; did you mean 'phi'"):
        closed_loop_view(model, equilibrium={"phy": 0.1})


def test_wrong_names_are_told_the_nearest(pendulum):
    with pytest.raises(ModelError, match="did you mean 'I_x"):
        pendulum.discrete(0.01, {"I_X": 1.0})
    with pytest.raises(ModelError, match="no parameter 'kk'"):
        closed_loop_view(direct_model().eliminate("a_y", using="accel"), values={"kk": 1.0})
    loop = pendulum.discrete(0.01, NOMINAL)
    with pytest.raises(ModelError, match="does not drive the loop; did you mean 'a_y'"):
        loop.simulate({"ay": np.zeros(5)})
    with pytest.raises(ModelError, match="give one or more of one length"):
        loop.simulate({"a_y": np.zeros(5), "tau_torque": np.zeros(6)})
    for Ts in (0.0, "0.01"):
        with pytest.raises(ModelError, match="give a positive one"):
            pendulum.discrete(Ts)


def test_a_view_that_was_used_can_be_pickled(pendulum):
    used = (
        pendulum.poles(LOADED),
        pendulum.direct_term_at(LOADED),
        pendulum.discrete(0.01).denominator,
    )
    assert "_closed" in vars(pendulum)
    other = pickle.loads(pickle.dumps(pendulum))
    assert other.loop == pendulum.loop
    again = (other.poles(LOADED), other.direct_term_at(LOADED), other.discrete(0.01).denominator)
    np.testing.assert_array_equal(np.concatenate(used[0]), np.concatenate(again[0]))
    np.testing.assert_array_equal(used[1], again[1])
    np.testing.assert_array_equal(used[2], again[2])


def test_a_loop_whose_leading_coefficient_vanishes_is_refused(pendulum):
    """I_1 = 0 up to terms of order Ts: 1/(1 - G_O F_y) would start with infinity."""
    A, b0, _, c, fn, _ = theory(NOMINAL)
    # Leading coefficient times its denominator: 4 I_1 + 2 d Ts + (k + S g) Ts^2 = 0.
    S_, Ts = -0.39672, 0.01
    I_x = -(2 * 0.1067 * Ts + (10.39 + S_ * 9.81) * Ts**2) / 4 - 22.04 * 0.018**2
    with pytest.raises(ModelError, match="not well posed.*inertia of the direct model near zero"):
        pendulum.discrete(Ts, {**NOMINAL, "I_x": I_x})


def test_an_unstable_loop_is_not_simulated(pendulum):
    loop = pendulum.discrete(0.01, {**NOMINAL, "k": 1.0})  # k + S g < 0: it falls over
    assert not loop.is_stable
    with pytest.raises(SolveError, match="closed loop is unstable .a pole at z = 1.*instruments"):
        loop.simulate({"a_y": np.ones(5)})
