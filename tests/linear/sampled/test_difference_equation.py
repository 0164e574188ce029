"""The regression of a linear model: minimal columns, coefficients of the parameters, and back."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import sympy
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from casid.errors import ModelError
from casid.linear.linear_model import linearise
from casid.linear.sampled.difference_equation import difference_equation
from casid.linear.sampled.discretisation import METHODS, SUBSTITUTIONS, discretise
from casid.linear.sampled.inverse_map import continuous_form, invert
from casid.model.model import Model
from problems.pendulum import direct_model
from tests.support.linear_models import (
    NOMINAL,
    SHIP,
    Z_G,
    Z_M,
    Z_S,
    M,
    chain_values,
    indirect,
    ship,
    spring_chain,
)

LOADED = NOMINAL | {"m": 0.2}


def coefficients_8_60(v, T):
    """g_theta(theta_p), the hand-derived (8.60)-(8.61)."""
    z_g, z_m, z_s = v["z_f"], v.get("zbar_m", 0.0) + v["z_f"], -0.2 + v["z_f"]
    m, g = v.get("m", 0.0), 9.82
    S = 22.04 * z_g + m * z_m
    L = v["A_x"] + 22.04 * z_g * (z_g - z_s) + m * z_m * (z_m - z_s) - v["K_vdot"] * z_s
    kap = v["k"] - v["K_vdot"] * g
    den = 2 * v["d"] * T + kap * T**2 + 4 * L
    return {
        "a1": (2 * kap * T**2 - 8 * L) / den,
        "a2": (-2 * v["d"] * T + kap * T**2 + 4 * L) / den,
        "b0[accel]": -2 * T * (v["K_vdot"] + S) / den,
        "b0[r]": 2 * T * v["K_r"] / den,
        "b0[rudder]": 2 * T * v["K_delta"] / den,
    }


# -- the pendulum ------------------------------------------------------------------------------


def test_the_pendulums_regression_is_7_35():
    """phi_t = [-y_{t-1}, -y_{t-2}, u_t - u_{t-2}], theta = [a1, a2, b0]."""
    e = difference_equation(indirect(), "gyro", 0.01)
    assert e.coefficients == ("a1", "a2", "b0[accel]")
    assert [c.taps for c in e.columns] == [
        (("gyro", 1, -1.0),),
        (("gyro", 2, -1.0),),
        (("accel", 0, 1.0), ("accel", 2, -1.0)),
    ]
    assert [c.name for c in e.columns] == ["-gyro[t-1]", "-gyro[t-2]", "accel[t] - accel[t-2]"]
    assert e.left.taps == (("gyro", 0, 1.0),)
    assert (e.order, e.inputs) == (2, ("accel",))


def test_a_disturbing_torque_is_filtered_as_in_7_33():
    """H_d = c0 (1 - q^-2) / (1 + a1 q^-1 + a2 q^-2), c0 = 2 gamma_1 T / Ibar_2, gamma_1 = 1/I_2."""
    m = direct_model()
    torque = m.unknown_input("torque", "N m")
    m.add_term("torque", torque)
    T = 0.01
    e = difference_equation(m.eliminate("a_y", using="accel"), "gyro", T)
    assert set(e.coefficients) == {"a1", "a2", "b0[accel]", "b0[torque]"}
    theta = dict(zip(e.coefficients, e.theta(LOADED), strict=True))
    I_2 = 0.1385 + M * Z_G * (Z_G - Z_S) + 0.2 * Z_M * (Z_M - Z_S)
    Ibar_2 = 4 + 2 * (0.1067 / I_2) * T + (10.39 / I_2) * T**2
    assert theta["b0[torque]"] == pytest.approx(2 * T / (I_2 * Ibar_2), rel=1e-12)
    taps = {c.taps for c in e.columns}
    assert (("torque", 0, 1.0), ("torque", 2, -1.0)) in taps
    gamma = e.continuous(e.theta(LOADED))[1]["torque"][1]  # (7.36): (8/T) c0 / (1 - a1 + a2)
    assert gamma == pytest.approx(8 / T * theta["b0[torque]"] / (1 - theta["a1"] + theta["a2"]))
    assert gamma == pytest.approx(1 / I_2, rel=1e-10)


@pytest.mark.parametrize("g", [9.81, 1.62])
def test_the_pendulums_coefficients_are_the_published_ones(g):
    """Digest R.1, item 4: Table 7.2 at T = 0.01 s, nominal and loaded; gravity drops out."""
    e = difference_equation(indirect(), "gyro", 0.01)
    np.testing.assert_allclose(
        e.theta(NOMINAL | {"g": g}), [-1.96487, 0.982202, 0.033088], atol=5e-7 * 10
    )
    np.testing.assert_allclose(
        e.theta(LOADED | {"g": g}), [-1.966581, 0.983068, 0.035825], atol=5e-7
    )


def test_the_inertias_are_the_published_ones():
    """Digest R.1, item 4: I_1 .14564 and .16066, I_2 .05916 and .06222."""
    for values, I_1, I_2 in ((NOMINAL, 0.14564, 0.05916), (LOADED, 0.16066, 0.06222)):
        direct, without = linearise(direct_model()), linearise(indirect())
        assert -values["d"] / direct.matrices(values)[0][1, 1] == pytest.approx(I_1, abs=5e-6)
        assert -values["d"] / without.matrices(values)[0][1, 1] == pytest.approx(I_2, abs=5e-6)


@pytest.mark.slow
@given(
    k=st.floats(1.0, 100.0), d=st.floats(0.0, 5.0), I_x=st.floats(0.09, 2.0),
    m=st.floats(0.0, 3.0), z_m=st.floats(-0.5, 0.5), T=st.floats(1e-4, 0.5),
)  # fmt: skip
def test_the_pendulums_coefficients_are_7_39(k, d, I_x, m, z_m, T):
    """a1, a2, b0 directly in the physical parameters."""
    S = M * Z_G + m * z_m
    I_2 = I_x + M * Z_G * (Z_G - Z_S) + m * z_m * (z_m - Z_S)
    Den = 4 * I_2 + 2 * d * T + k * T**2
    assume(abs(Den) > 1e-3)
    e = difference_equation(indirect(), "gyro", T)
    theta = e.theta({"k": k, "d": d, "I_x": I_x, "m": m, "z_m": z_m})
    np.testing.assert_allclose(
        theta,
        [
            (2 * k * T**2 - 8 * I_2) / Den,
            (4 * I_2 - 2 * d * T + k * T**2) / Den,
            -2 * T * S / Den,
        ],
        rtol=1e-9,
        atol=1e-12,
    )


@pytest.mark.parametrize("T", [0.01, 0.1])
def test_coefficients_satisfy_the_linear_constraints(T):
    """(7.41), (7.43), (7.45), (7.47): residuals vanish."""
    e = difference_equation(indirect(), "gyro", T)
    for values in (NOMINAL, LOADED):
        m = values.get("m", 0.0)
        S, k, d = M * Z_G + m * Z_M, values["k"], values["d"]
        beta = e.transfer.evaluate(values)[1][0][0][1]
        theta = e.theta(values)
        for row, right in (
            ([-S / k, -S / k, -2 * T], S / k),
            ([0, 1, -2 * d / S], 1),
            ([beta * T, -beta * T, 8], beta * T),
            ([d / k, d / k + T, 0], T - d / k),
        ):
            assert np.dot(row, theta) == pytest.approx(right, rel=1e-12, abs=1e-14)


def test_the_inverse_of_the_bilinear_map_is_7_36():
    T = 0.01
    e = difference_equation(indirect(), "gyro", T)
    a1, a2, b0 = theta = e.theta(NOMINAL)
    Dn = 1 - a1 + a2
    alpha, beta = e.continuous(theta)
    np.testing.assert_allclose(
        alpha, [1, 4 / T * (1 - a2) / Dn, 4 / T**2 * (1 + a1 + a2) / Dn], rtol=1e-12
    )
    np.testing.assert_array_equal(beta["accel"][[0, 2]], 0.0)
    assert beta["accel"][1] == pytest.approx(8 / T * b0 / Dn, rel=1e-12)


def test_7_36_follows_symbolically():
    """The inverse substitution on symbols a1, a2, b0, T cancels to the printed formulas."""
    form = continuous_form(difference_equation(indirect(), "gyro", 0.01))
    a1, a2, b0 = sympy.symbols("a1 a2 b0[accel]")
    T = sympy.Symbol("T", positive=True)
    Dn = 1 - a1 + a2
    printed = {
        "alpha1": 4 / T * (1 - a2) / Dn,
        "alpha2": 4 / T**2 * (1 + a1 + a2) / Dn,
        "beta1[accel]": 8 / T * b0 / Dn,
    }
    assert form.keys() == printed.keys()
    for name, expression in printed.items():
        assert sympy.simplify(form[name] - expression) == 0


@pytest.mark.parametrize("method", SUBSTITUTIONS)
def test_the_symbolic_inverse_evaluates_to_the_numeric_one(method):
    e = difference_equation(spring_chain(2), "q", 0.1, method=method)
    theta = e.theta(chain_values(2, 1))
    alpha, beta = e.continuous(theta)
    numbers = {sympy.Symbol(n): v for n, v in zip(e.coefficients, theta, strict=True)}
    numbers[sympy.Symbol("T", positive=True)] = 0.1
    for name, expression in continuous_form(e).items():
        k = int(name.removeprefix("alpha").removeprefix("beta").removesuffix("[F]"))
        wanted = alpha[k] if name.startswith("alpha") else beta["F"][k]
        assert float(expression.subs(numbers)) == pytest.approx(wanted, rel=1e-8)


def test_a_hold_has_no_rational_inverse():
    with pytest.raises(ModelError, match="logarithms .* equation.continuous"):
        continuous_form(difference_equation(indirect(), "gyro", 0.01, method="zoh"))


# -- the ship ----------------------------------------------------------------------------------


def test_the_ships_regression_is_8_57():
    """y_t = [-y_{t-1}, -y_{t-2}, mu1, mu2, mu3] theta, all mu differences over two samples."""
    e = difference_equation(ship().eliminate("vdot", using="accel"), "gyro", 0.02)
    assert set(e.coefficients) == {"a1", "a2", "b0[accel]", "b0[r]", "b0[rudder]"}
    for name, column in zip(e.coefficients[2:], e.columns[2:], strict=True):
        u = name.removeprefix("b0[").removesuffix("]")
        assert column.taps == ((u, 0, 1.0), (u, 2, -1.0))


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), T=st.floats(1e-3, 0.2))
def test_the_ships_coefficients_are_8_60(seed, T):
    rng = np.random.default_rng(seed)
    values = {n: v * rng.uniform(0.5, 1.5) for n, v in SHIP.items()}
    values |= {"m": rng.uniform(0, 1), "zbar_m": -rng.uniform(0, 0.5)}
    wanted = coefficients_8_60(values, T)
    assume(max(abs(w) for w in wanted.values()) < 50)
    e = difference_equation(ship().eliminate("vdot", using="accel"), "gyro", T)
    got = dict(zip(e.coefficients, e.theta(values), strict=True))
    for name, value in wanted.items():
        assert got[name] == pytest.approx(value, rel=1e-9, abs=1e-10)


def test_the_ships_continuous_coefficients_are_the_published_ones():
    """Digest R.1, item 6: A_2 and (alpha1, alpha2, beta1, kappa1, gamma1) for Table 8.2."""
    model = linearise(ship().eliminate("vdot", using="accel"))
    loads = ({}, {"m": 0.2, "zbar_m": -0.172}, {"m": 0.4, "zbar_m": -0.182})
    for load, A_2 in zip(loads, (0.037876, 0.036756, 0.036364), strict=True):
        A, *_ = model.matrices(SHIP | load)
        assert -SHIP["d"] / A[1, 1] == pytest.approx(A_2, abs=5e-7)
    a, b = model.transfer("gyro").evaluate(SHIP)
    by_input = dict(zip(model.inputs, b[0], strict=True))
    np.testing.assert_allclose(a[1:], [5.4573, 248.125], rtol=1e-5)
    wanted = {"accel": 13.6530, "r": -13.2010, "rudder": -10.6928}
    for u, value in wanted.items():
        np.testing.assert_allclose(by_input[u], [0, value, 0], rtol=1e-5)


def test_the_unidentifiable_family_of_the_ship_leaves_all_three_coefficient_sets_alone():
    """Erratum E-21: nominal, calibration and loaded coefficients are invariant along it."""
    e = difference_equation(ship().eliminate("vdot", using="accel"), "gyro", 0.02)
    zbar_c, zbar_m, m_l, zbar_s, mass, g = -0.172, -0.182, 0.4, -0.2, 22.04, 9.82
    z_f, z_new = -0.028, -0.05
    lam = (zbar_c + z_new) / (zbar_c + z_f)
    new = {n: lam * SHIP[n] for n in ("d", "K_r", "K_delta")} | {"z_f": z_new}
    K = new["K_vdot"] = lam * (SHIP["K_vdot"] + mass * z_f) - mass * z_new
    new["k"] = lam * (SHIP["k"] - SHIP["K_vdot"] * g) + K * g
    new["A_x"] = (
        lam * (SHIP["A_x"] - mass * z_f * zbar_s - SHIP["K_vdot"] * (zbar_s + z_f))
        + mass * z_new * zbar_s
        + K * (zbar_s + z_new)
    )
    m_new = lam * m_l * (zbar_m + z_f) / (zbar_m + z_new)
    for old_load, new_load in (
        ({}, {}),
        ({"m": 0.2, "zbar_m": zbar_c}, {"m": 0.2, "zbar_m": zbar_c}),
        ({"m": m_l, "zbar_m": zbar_m}, {"m": m_new, "zbar_m": zbar_m}),
    ):
        np.testing.assert_allclose(e.theta(new | new_load), e.theta(SHIP | old_load), atol=1e-12)


# -- structure ---------------------------------------------------------------------------------


def reconstructed(e, values):
    a, b = e.polynomials(e.theta(values))
    return np.concatenate([a, *b.values()])


@pytest.mark.slow
@settings(max_examples=25)
@given(
    seed=st.integers(0, 10_000),
    n=st.integers(1, 3),
    Ts=st.floats(1e-3, 0.5),
    method=st.sampled_from(METHODS),
)
def test_the_reduced_coefficients_give_all_coefficients_back(seed, n, Ts, method):
    """Relations found at random parameters hold at every parameter value."""
    model = linearise(spring_chain(n))
    values = chain_values(n, seed)
    for output in model.outputs:
        e = difference_equation(model, output, Ts, method=method)
        a, b = discretise(model.transfer(output), Ts, method).evaluate(values)
        wanted = np.concatenate([a, b[0][0]])
        np.testing.assert_allclose(
            reconstructed(e, values), wanted, atol=1e-9 * np.abs(wanted).max()
        )


@pytest.mark.parametrize("method", METHODS)
def test_the_equation_holds_for_a_simulated_sequence(method):
    """left - columns theta = 0 along the recursion of the discrete transfer function itself."""
    e = difference_equation(direct_model(), "accel", 0.02, method=method)
    a, b = e.polynomials(e.theta(NOMINAL))
    u = np.random.default_rng(1).standard_normal(200)
    import scipy.signal

    y = scipy.signal.lfilter(b["a_y"], a, u)
    signals = {"accel": y, "a_y": u}
    left = e.left.samples(signals, e.order)
    right = sum(
        t * c.samples(signals, e.order) for t, c in zip(e.theta(NOMINAL), e.columns, strict=True)
    )
    np.testing.assert_allclose(left, right, atol=1e-12)


def test_an_unknown_dc_gain_is_a_coefficient_and_a_known_one_is_a_relation():
    """w^2 / (s^2 + 2 zeta w s + w^2) has gain 1: b0 = (1 + a1 + a2) / 4, two columns are left."""
    m = Model("unit gain")
    q, v = m.state("q", "1"), m.state("v", "1/s")
    u, w, zeta = m.input("u", "1"), m.parameter("w", "1/s"), m.parameter("zeta", "1")
    m.derivative(q, v)
    m.derivative(v, w**2 * (u - q) - 2 * zeta * w * v)
    m.output("q", q, "1")
    e = difference_equation(m, "q", 0.1)
    assert e.coefficients == ("a1", "a2")
    assert e.left.taps == (("q", 0, 1.0), ("u", 0, -0.25), ("u", 1, -0.5), ("u", 2, -0.25))
    assert e.columns[0].taps == (("q", 1, -1.0), ("u", 0, 0.25), ("u", 1, 0.5), ("u", 2, 0.25))
    _, b = e.polynomials(e.theta({"w": 2.0, "zeta": 0.1}))
    assert e.continuous(e.theta({"w": 2.0, "zeta": 0.1}))[1]["u"][2] == pytest.approx(4.0)
    assert b["u"][1] == pytest.approx(2 * b["u"][0])


@pytest.mark.parametrize("method", METHODS)
def test_an_integrator_in_the_model_is_a_known_difference(method):
    """1/s times anything: 1 - q^-1 divides the denominator, one coefficient fewer."""
    m = Model("integrating")
    q, v = m.state("q", "m"), m.state("v", "m/s")
    u, c, b = m.input("u", "1"), m.parameter("c", "1/s"), m.parameter("b", "m/s^2")
    m.derivative(q, v)
    m.derivative(v, b * u - c * v)
    m.output("q", q, "m")
    e = difference_equation(m, "q", 0.1, method=method)
    assert [n for n in e.coefficients if n.startswith("a")] == ["a1"]
    a, _ = e.polynomials(e.theta({"c": 0.7, "b": 2.0}))
    assert a.sum() == pytest.approx(0.0, abs=1e-13)


def test_inputs_that_act_in_one_ratio_share_a_column():
    """F and 2 G enter as a sum whatever the parameters: the regressor is F + 2 G."""
    m = Model("two forces")
    v, F, G = m.state("v", "m/s"), m.input("F", "N"), m.input("G", "N")
    d, mass = m.parameter("d", "N s/m"), m.parameter("mass", "kg")
    m.balance(v, "force", inertia=mass, terms=[F, 2 * G, -d * v])
    m.output("v", v, "m/s")
    for method in METHODS:
        e = difference_equation(m, "v", 0.1, method=method)
        assert [n for n in e.coefficients if "G" in n] == []
        taps = dict(((c, k), w) for c, k, w in e.columns[-1].taps)
        for (channel, lag), weight in taps.items():
            if channel == "F":
                assert taps["G", lag] == pytest.approx(2 * weight)


def test_an_irrational_model_has_the_same_structure():
    """k = k_0 exp(c): relations are found in floating point and made fractions."""
    import casadi as ca

    m = Model("exponential stiffness")
    q, v = m.state("q", "m"), m.state("v", "m/s")
    u, c, d = m.input("u", "N"), m.parameter("c", "1"), m.parameter("d", "N s/m")
    m.derivative(q, v)
    m.balance(v, "force", inertia=ca.sqrt(1 + c**2), terms=[u, -ca.exp(c) * q, -d * v])
    m.output("v", v, "m/s")
    for Ts in (1e-4, 0.1):
        e = difference_equation(m, "v", Ts)
        assert e.coefficients == ("a1", "a2", "b0[u]")
        assert e.columns[2].taps == (("u", 0, 1.0), ("u", 2, -1.0))


@pytest.mark.parametrize("Ts", [1e-5, 1e-3, 0.1])
def test_small_sample_times_do_not_invent_relations(Ts):
    """At (w T)^4 = 1e-16 coefficients look like binomials in floating point: still 4 are free."""
    e = difference_equation(spring_chain(2), "q", Ts)
    assert [n for n in e.coefficients if n.startswith("a")] == ["a1", "a2", "a3", "a4"]


@pytest.mark.parametrize("Ts", [1e-4, 1e-2, 0.5])
@pytest.mark.parametrize(("hold", "count"), [("zoh", 8), ("foh", 9)])
def test_a_hold_has_the_same_structure_at_every_sample_time(hold, count, Ts):
    """Order 4, relative degree 2: b_0 = 0 under zoh, and nothing else."""
    assert len(difference_equation(spring_chain(2), "q", Ts, method=hold).coefficients) == count


def test_a_factor_common_to_all_transfer_functions_is_noted():
    """Two equal lags side by side are one: y = 2/(s + a) u written with two states."""
    m = Model("twice the same")
    x, z = m.state("x", "1"), m.state("z", "1")
    u, a = m.input("u", "1"), m.parameter("a", "1/s")
    m.derivative(x, u - a * x)
    m.derivative(z, u - a * z)
    m.output("y", x + z, "1")
    e = difference_equation(m, "y", 0.1)
    assert any("share a factor of degree 1" in n and "drop 1 state" in n for n in e.notes)
    single = difference_equation(indirect(), "gyro", 0.1)
    assert not any("share" in n for n in single.notes)


def test_holds_keep_the_structure_that_sampling_leaves():
    """zoh of s/(..): b0 = 0 and b2 = -b1; foh: b0 + b1 + b2 = 0."""
    zoh = difference_equation(indirect(), "gyro", 0.01, method="zoh")
    assert zoh.coefficients == ("a1", "a2", "b1[accel]")
    assert zoh.columns[2].taps == (("accel", 1, 1.0), ("accel", 2, -1.0))
    foh = difference_equation(indirect(), "gyro", 0.01, method="foh")
    assert foh.coefficients == ("a1", "a2", "b0[accel]", "b1[accel]")
    a, b = foh.polynomials(foh.theta(NOMINAL))
    assert b["accel"].sum() == pytest.approx(0.0, abs=1e-15)


def test_several_outputs_are_a_matrix_fraction_row_by_row():
    """(5.16)-(5.18): one equation an output, each of the order that this output needs."""
    m = spring_chain(2)
    m.output("pushed", m.symbol("F") * m.symbol("k0"), "N^2/m")
    equations = {y: difference_equation(m, y, 0.05) for y in m.outputs}
    assert list(equations) == ["q", "v", "pushed"]
    assert [e.order for e in equations.values()] == [4, 4, 0]
    values = chain_values(2, 3)
    a, b = discretise(linearise(m).transfer(("q", "v")), 0.05).evaluate(values)
    for i, y in enumerate(("q", "v")):
        np.testing.assert_allclose(
            reconstructed(equations[y], values), np.concatenate([a, b[i][0]]), atol=1e-12
        )


def test_a_free_decay_is_an_autoregression():
    m = Model("decay")
    q, v = m.state("q", "rad"), m.state("v", "rad/s")
    k, d = m.parameter("k", "1/s^2"), m.parameter("d", "1/s")
    m.derivative(q, v)
    m.derivative(v, -k * q - d * v)
    m.output("q", q, "rad")
    e = difference_equation(m, "q", 0.1, method="zoh")
    assert e.coefficients == ("a1", "a2")
    assert e.inputs == ()
    poles = np.exp(0.1 * np.roots([1, 0.3, 4.0]))
    np.testing.assert_allclose(
        e.theta({"k": 4.0, "d": 0.3}), [-poles.sum().real, poles.prod().real], rtol=1e-12
    )


@pytest.mark.parametrize("method", SUBSTITUTIONS)
def test_eliminating_and_substituting_commute(method):
    """Samples of the discretised direct model obey the discretised indirect equation exactly.

    A substitution is algebra on transfer functions, so G_O and F_y are mapped together (7.30).
    """
    import scipy.signal

    direct = linearise(indirect().direct())
    a, rows = discretise(direct, 0.05, method).evaluate(LOADED)
    a_y = np.random.default_rng(2).standard_normal(100)
    signals = {
        y: scipy.signal.lfilter(b[0], a, a_y) for y, b in zip(direct.outputs, rows, strict=True)
    }
    e = difference_equation(indirect(), "gyro", 0.05, method=method)
    right = sum(
        t * c.samples(signals, e.order) for t, c in zip(e.theta(LOADED), e.columns, strict=True)
    )
    # Forward Euler of this pendulum is unstable: the samples grow, and rounding with them.
    size = max(np.abs(v).max() for v in signals.values())
    np.testing.assert_allclose(e.left.samples(signals, e.order), right, atol=1e-12 * size)


# -- back to continuous time -------------------------------------------------------------------


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10_000),
    n=st.integers(1, 2),
    Ts=st.floats(0.01, 0.3),
    method=st.sampled_from(METHODS),
)
def test_continuous_coefficients_come_back(seed, n, Ts, method):
    """Round trip; rounding is multiplied by (1/(w T))^(2n), with w T > 0.003: 1e-16 * 1e10."""
    values = chain_values(n, seed)
    model = linearise(spring_chain(n))
    e = difference_equation(model, "q", Ts, method=method)
    alpha, beta = e.continuous(e.theta(values))
    a, b = model.transfer("q").evaluate(values)
    scale = max(np.abs(np.roots(a)).max(), 1.0) ** np.arange(len(a))
    if method in SUBSTITUTIONS or np.abs(np.imag(np.roots(a))).max() * Ts < 3.0:
        tolerance = 1e-13 / Ts ** (2 * n)
        np.testing.assert_allclose(alpha / scale, a / scale, atol=max(tolerance, 1e-10))
        np.testing.assert_allclose(beta["F"] / scale, b[0][0] / scale, atol=max(tolerance, 1e-10))


def test_a_discrete_system_without_continuous_counterpart_is_refused():
    """A pole on the negative real axis has no real logarithm (zoh)."""
    e = difference_equation(indirect(), "gyro", 0.01, method="zoh")
    with pytest.raises(ModelError, match=r"pole lies at -0\.\d+, .* use method='bilinear'"):
        e.continuous([0.9, 0.2, 1.0])
    bilinear = difference_equation(indirect(), "gyro", 0.01)
    with pytest.raises(ModelError, match="no continuous system of order 2"):
        bilinear.continuous([1.5, 0.5, 1.0])  # a pole at -1: s = infinity


# -- what is said and refused ------------------------------------------------------------------


def test_forward_euler_that_turns_unstable_is_flagged_with_the_sample_time_needed():
    """|1 + s T| > 1 beyond T = -2 Re s / |s|^2; the equation itself is still given."""
    model = indirect()
    assert not any(
        "unstable" in n for n in difference_equation(model, "gyro", 1e-3, method="forward").notes
    )
    e = difference_equation(model, "gyro", 0.2, method="forward")
    note = next(n for n in e.notes if "unstable" in n)
    assert "use bilinear" in note
    assert e.theta(NOMINAL).shape == (3,)


def test_an_output_without_input_and_state_is_refused():
    m = spring_chain(1)
    m.output("constant", m.symbol("k0") * 0.0, "1")
    with pytest.raises(ModelError, match="depends on no input and no state"):
        difference_equation(m, "constant", 0.1)


def test_wrong_coefficients_and_names_are_refused():
    e = difference_equation(indirect(), "gyro", 0.01)
    with pytest.raises(ModelError, match="2 coefficients given for 3; they are a1, a2, b0"):
        e.polynomials([1.0, 2.0])
    with pytest.raises(ModelError, match="did you mean 'I_x'"):
        e.theta(NOMINAL | {"Ix": 1.0})
    with pytest.raises(ModelError, match="did you mean 'gyro'"):
        difference_equation(indirect(), "gyr", 0.01)


def test_a_coefficient_that_is_not_finite_is_refused():
    """I_2 = 0, k = d = 0: the denominator of (7.39) vanishes."""
    e = difference_equation(indirect(), "gyro", 0.01)
    with pytest.raises(ModelError, match="not finite .* an inertia is zero"):
        e.theta({"k": 0.0, "d": 0.0, "I_x": 0.0, "M": 0.0})


def test_the_equation_is_printed_as_it_is_fitted():
    text = str(difference_equation(indirect(), "gyro", 0.01))
    assert "gyro[t] = a1 (-gyro[t-1]) + a2 (-gyro[t-2]) + b0[accel]" in text
    assert "does not depend on g" in text


def test_a_pickled_equation_is_the_equation():
    """Campaigns send it to other processes; what was cached is left behind."""
    e = difference_equation(indirect(), "gyro", 0.01)
    assert e.jacobian is not None
    other = pickle.loads(pickle.dumps(e))
    np.testing.assert_array_equal(other.theta(NOMINAL), e.theta(NOMINAL))
    assert (other.columns, other.left, str(other)) == (e.columns, e.left, str(e))
    np.testing.assert_array_equal(
        invert(other, e.theta(LOADED), NOMINAL, ("m", "z_m"))[0],
        invert(e, e.theta(LOADED), NOMINAL, ("m", "z_m"))[0],
    )
    discrete = discretise(e.transfer, 0.01)
    again = pickle.loads(pickle.dumps(discrete))
    np.testing.assert_array_equal(again.evaluate(NOMINAL)[0], discrete.evaluate(NOMINAL)[0])
