"""Discretisation: against independent implementations, closed forms and the theory of each map."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from casid.errors import ModelError
from casid.linear.linear_model import TransferMatrix, linearise
from casid.linear.sampled.discretisation import METHODS, discretise, pade_exponential, substitution
from casid.model.model import Model
from problems.pendulum import direct_model
from tests.support.linear_models import NOMINAL, chain_values, indirect, spring_chain

SCIPY = {"forward": "euler", "backward": "backward_diff"}


def scipy_coefficients(matrices, Ts, method):
    *discrete, _ = scipy.signal.cont2discrete(matrices, Ts, SCIPY.get(method, method))
    numerators = []
    for j in range(matrices[1].shape[1]):
        b, a = scipy.signal.ss2tf(*discrete, input=j)
        numerators.append(b)
    return a, numerators


def rational(p, denominator, *numerators):
    """One row of transfer functions of the parameters p, by their coefficients."""
    return TransferMatrix(
        name="test",
        denominator=ca.vertcat(*denominator),
        numerators=(tuple(ca.vertcat(*b) for b in numerators),),
        p=p,
        inputs=tuple(f"u{j}" for j in range(len(numerators))),
        outputs=("y",),
        parameters=tuple(s.name() for s in ca.symvar(p)),
    )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("Ts", [1e-4, 0.01, 0.3])
@pytest.mark.parametrize("build", [indirect, direct_model], ids=["indirect", "direct"])
def test_all_methods_agree_with_scipy_on_the_pendulum(build, Ts, method):
    """Both are exact in the algebra: what differs is rounding (condition of the poles, 1e-12)."""
    model = linearise(build())
    a, b = discretise(model, Ts, method).evaluate(NOMINAL)
    wanted_a, wanted_b = scipy_coefficients(model.matrices(NOMINAL), Ts, method)
    np.testing.assert_allclose(a, wanted_a, atol=1e-12)
    for i, row in enumerate(b):
        np.testing.assert_allclose(row[0], wanted_b[0][i], atol=1e-12)


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10_000),
    n=st.integers(1, 3),
    Ts=st.floats(1e-3, 0.5),
    method=st.sampled_from(METHODS),
)
def test_all_methods_agree_with_scipy_on_chains_of_masses(seed, n, Ts, method):
    model = linearise(spring_chain(n))
    matrices = model.matrices(chain_values(n, seed))
    a, b = discretise(model, Ts, method).evaluate(chain_values(n, seed))
    wanted_a, wanted_b = scipy_coefficients(matrices, Ts, method)
    np.testing.assert_allclose(a, wanted_a, atol=1e-10 * np.abs(wanted_a).max())
    for i, row in enumerate(b):
        np.testing.assert_allclose(row[0], wanted_b[0][i], atol=1e-10 * np.abs(wanted_a).max())


def test_the_bilinear_pendulum_is_7_34():
    a1, a2, beta = 1.8037, 175.64, 6.7063
    p = ca.SX.sym("p", 3)
    d = discretise(rational(p, [1, p[0], p[1]], [0, p[2], 0]), 0.01)
    a, b = (np.array(v).ravel() for v in d.function(ca.DM([a1, a2, beta])))
    T = 0.01
    Ibar = 4 + 2 * a1 * T + a2 * T**2
    np.testing.assert_allclose(
        a, [1, (2 * a2 * T**2 - 8) / Ibar, (4 - 2 * a1 * T + a2 * T**2) / Ibar], rtol=1e-14
    )
    np.testing.assert_allclose(b, [2 * beta * T / Ibar, 0, -2 * beta * T / Ibar], rtol=1e-14)
    assert d.numerators[0][0][1].nnz() == 0  # not rounding: no tap at all


@given(seed=st.integers(0, 10_000), Ts=st.floats(1e-3, 10.0))
def test_the_bilinear_transform_keeps_stability(seed, Ts):
    """The left half plane is mapped into the unit circle and nothing else is."""
    rng = np.random.default_rng(seed)
    poles = rng.uniform(-3.0, 3.0, 3)
    assume(np.abs(2.0 / Ts - poles).min() > 1e-3 and np.abs(poles).min() > 1e-3)
    p = ca.SX.sym("p", 3)
    d = discretise(rational(p, [1, p[0], p[1], p[2]], [0, 0, 0, 1]), Ts)
    a = np.array(d.function(np.poly(poles)[1:])[0]).ravel()
    mapped = np.roots(a)
    assert (np.abs(mapped) < 1).sum() == (poles < 0).sum()


def test_forward_euler_is_a_delay_and_backward_euler_is_not():
    """1/s: T q^-1 / (1 - q^-1) and T / (1 - q^-1)."""
    p = ca.SX.sym("p", 1)
    for method, b in (("forward", [0, 0.2]), ("backward", [0.2, 0])):
        d = discretise(rational(p, [1, 0], [0, 1]), 0.2, method)
        got = [np.array(v).ravel() for v in d.function(0.0)]
        np.testing.assert_allclose(got[0], [1, -1])
        np.testing.assert_allclose(got[1], b)


def test_a_held_integrator_chain_is_exact():
    """1/s^3 under zero-order hold: T^3/6 (q^-1 + 4 q^-2 + q^-3) / (1 - q^-1)^3."""
    p = ca.SX.sym("p", 1)
    d = discretise(rational(p, [1, 0, 0, 0], [0, 0, 0, p[0]]), 0.5, "zoh")
    a, b = (np.array(v).ravel() for v in d.function(1.0))
    np.testing.assert_allclose(a, [1, -3, 3, -1], atol=1e-15)
    np.testing.assert_allclose(b, 0.5**3 / 6 * np.array([0, 1, 4, 1]), atol=1e-16)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_a_hold_reproduces_the_continuous_response_to_its_own_input(hold):
    """Samples of a fine simulation under a held (or straight-line) input obey the equation."""
    Ts, fine = 0.1, 200
    model = linearise(indirect())
    A, B, C, D = model.matrices(NOMINAL)
    rng = np.random.default_rng(1)
    u = rng.standard_normal(40)
    t = Ts / fine * np.arange(39 * fine + 1)
    held = u[np.minimum((t / Ts + 1e-9).astype(int), 39)]
    v = held if hold == "zoh" else np.interp(t, Ts * np.arange(40), u)
    # Both inputs are simulated exactly: lsim interpolates by straight lines, a held one is shifted.
    _, y, _ = scipy.signal.lsim((A, B, C, D), v, t, interp=hold == "foh")
    y = y[::fine]
    a, b = discretise(model, Ts, hold).evaluate(NOMINAL)
    left = sum(a[k] * y[2 - k : 40 - k] for k in range(3))
    right = sum(b[0][0][k] * u[2 - k : 40 - k] for k in range(3))
    np.testing.assert_allclose(left, right, atol=1e-11)


@pytest.mark.parametrize("method", METHODS)
def test_coefficients_are_differentiated_exactly(method):
    """The Jacobian in the parameters against central differences (error h^2, h = 1e-5)."""
    d = discretise(linearise(indirect()), 0.05, method)
    flat = ca.vertcat(d.denominator, d.numerators[0][0])
    f = ca.Function("f", [d.p], [ca.densify(flat)])
    jac = ca.Function("j", [d.p], [ca.densify(ca.jacobian(flat, d.p))])
    p = linearise(indirect()).vector(NOMINAL)
    got = np.array(jac(p))
    for i in range(len(p)):
        h = 1e-5 * max(1.0, abs(p[i]))
        step = h * np.eye(len(p))[i]
        slope = (np.array(f(p + step)) - np.array(f(p - step))).ravel() / (2 * h)
        np.testing.assert_allclose(got[:, i], slope, atol=2e-6 * max(1.0, np.abs(slope).max()))


@given(seed=st.integers(0, 10_000), n=st.integers(1, 5), size=st.floats(0.0, 20.0))
def test_the_matrix_exponential_is_scipys(seed, n, size):
    """Squarings enough for the norm; rounding grows with the norm of the result."""
    A = np.random.default_rng(seed).standard_normal((n, n))
    A *= size / np.linalg.norm(A, 1)
    squarings = max(0, int(np.ceil(np.log2(max(size, 1e-9) / 0.95))))
    got = np.array(ca.DM(pade_exponential(ca.SX(A), squarings)))
    wanted = scipy.linalg.expm(A)
    # Each squaring may double the relative error (Higham 2005, section 4).
    tolerance = 2e-15 * n * 2**squarings * np.linalg.norm(wanted, 1)
    np.testing.assert_allclose(got, wanted, atol=max(tolerance, 1e-15))


@pytest.mark.parametrize("method", ["bilinear", "forward", "backward"])
@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_substitution_is_the_polynomial_in_the_mapped_variable(method, n):
    """d(s) at s(x), times the common denominator, for x off the unit circle."""
    from fractions import Fraction

    d = np.random.default_rng(n).standard_normal(n + 1)
    T = 0.25
    K = np.array([[float(v) for v in row] for row in substitution(n, Fraction(1, 4), method)])
    x = 0.3 + 0.8j
    s, common = {
        "bilinear": (2 / T * (1 - x) / (1 + x), (T / 2 * (1 + x)) ** n),
        "forward": ((1 - x) / (T * x), (T * x) ** n),
        "backward": ((1 - x) / T, T**n),
    }[method]
    assert np.polyval((d @ K)[::-1], x) == pytest.approx(np.polyval(d, s) * common)


def test_two_outputs_share_one_denominator():
    model = linearise(direct_model())
    d = discretise(model, 0.01)
    assert d.outputs == ("gyro", "accel")
    a, b = d.evaluate(NOMINAL)
    one, other = (discretise(model.transfer(y), 0.01).evaluate(NOMINAL) for y in d.outputs)
    np.testing.assert_allclose(a, one[0], rtol=1e-14)
    np.testing.assert_allclose(b[1][0], other[1][0][0], rtol=1e-14)


def test_an_improper_feedback_has_a_bilinear_image_with_poles_at_plus_and_minus_one():
    """F_y = (z_s s^2 + g) / s (7.30), trap T-1; forward Euler and the holds refuse it."""
    p = ca.SX.sym("p", 2)
    F_y = rational(p, [1, 0], [p[0], 0, p[1]])
    d = discretise(F_y, 0.01)
    a, b = (np.array(v).ravel() for v in d.function([-0.218, 9.81]))
    np.testing.assert_allclose(np.sort(np.roots(a)), [-1, 1], atol=1e-12)
    c, z_s, g = 2 / 0.01, -0.218, 9.81
    wanted = np.array([z_s * c**2 + g, 2 * g - 2 * z_s * c**2, z_s * c**2 + g]) / c
    np.testing.assert_allclose(b, wanted, rtol=1e-12)  # fn(q) / c of section 7.4
    for method in ("forward", "zoh", "foh"):
        with pytest.raises(ModelError, match="improper .* use bilinear or backward"):
            discretise(F_y, 0.01, method)
    backward = discretise(F_y, 0.01, "backward").function([-0.218, 9.81])
    assert np.isfinite(np.array(backward[1])).all()


def test_a_static_gain_stays_itself():
    m = spring_chain(1)
    c = m.parameter("c", "1/N")
    m.output("y", c * m.symbol("F"), "1")
    static = linearise(m).transfer("y")
    for method in METHODS:
        a, b = discretise(static, 0.1, method).evaluate(chain_values(1, 0) | {"c": 3.0})
        np.testing.assert_allclose(a, [1])
        np.testing.assert_allclose(b[0][0], [3.0])


def test_fast_poles_are_held_as_well():
    """A pole 1000 times as fast as the sampling: the squarings follow the nominal parameters."""
    m = Model("fast and slow")
    x, z = m.state("x", "1"), m.state("z", "1")
    u = m.input("u", "1")
    tau = m.parameter("tau", "s", start=1e-4)
    m.derivative(x, (u - x) / tau)
    m.derivative(z, x - z)
    m.output("z", z, "1")
    for tau_value in (5e-5, 1e-4, 4e-4):
        values = {"tau": tau_value}
        for hold in ("zoh", "foh"):
            a, b = discretise(linearise(m), 0.1, hold).evaluate(values)
            wanted_a, wanted_b = scipy_coefficients(linearise(m).matrices(values), 0.1, hold)
            np.testing.assert_allclose(a, wanted_a, atol=1e-10)
            np.testing.assert_allclose(b[0][0], wanted_b[0][0], atol=1e-10)


def test_an_unknown_method_and_a_bad_sample_time_are_refused_with_the_mend():
    with pytest.raises(ModelError, match="did you mean 'bilinear'"):
        discretise(linearise(indirect()), 0.01, "bilnear")
    for Ts in (0.0, -0.01, float("nan")):
        with pytest.raises(ModelError, match="positive number of seconds"):
            discretise(linearise(indirect()), Ts)
