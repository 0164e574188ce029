"""Rational transfer functions: exact values, what they are read from, and what they tell."""

from __future__ import annotations

from fractions import Fraction

import casadi as ca
import control
import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from casid.algebra.minors import determinant
from casid.algebra.rational import Rational, rational
from casid.algebra.realisation import mcmillan_degree, state_space
from casid.algebra.transfer_matrix import transfer_matrix
from casid.errors import ModelError

q, s = Rational.shift(), Rational.derivative()
fractions = st.fractions(-3, 3, max_denominator=7)


@st.composite
def functions(draw):
    above = draw(st.lists(fractions, min_size=1, max_size=3))
    below = draw(st.lists(fractions, max_size=2))
    return Rational(tuple(above), (Fraction(1), *below), "q")


@settings(deadline=None, max_examples=60)
@given(functions(), functions(), functions(), st.fractions(5, 9, max_denominator=5))
def test_rational_functions_are_a_field_and_evaluation_is_a_homomorphism(a, b, c, point):
    assert ((a + b) * c).equals(a * c + b * c)
    assert (a - a).is_zero
    assert a.is_zero or (a / a).equals(1)
    values = [g.at(point) for g in (a, b)]  # poles lie within |q| <= 1 + 3 < 5
    assert (a + b).at(point) == sum(values)
    assert (a * b).at(point) == values[0] * values[1]


def test_common_factors_cancel_exactly():
    g = (q - 0.1) * (q - 0.3) / ((q - 0.3) * (q - 0.7))
    assert str(g) == "(q - 0.1) / (q - 0.7)"
    assert g.direct == 1
    assert (q / q).variable == ""


def test_one_module_is_the_same_from_every_source():
    Q, a, b = sympy.symbols("q a b")
    x, alpha = ca.SX.sym("q"), ca.SX.sym("alpha")
    wanted = 0.07 / (q - 0.11)
    for source in (
        0.07 * Q**-1 / (1 - 0.11 * Q**-1),
        control.tf([0.07], [1, -0.11], True),
        control.ss([[0.11]], [[1]], [[0.07]], [[0]], True),
        sympy.Rational(7, 100) / (sympy.Symbol("z") - sympy.Rational(11, 100)),
    ):
        assert rational(source).equals(wanted)
    assert rational(b / (Q - a), values={"a": 0.11, "b": 0.07}).equals(wanted)
    assert rational(0.07 / (x - alpha), values={"alpha": 0.11}).equals(wanted)
    assert rational(wanted, Ts=0.5).Ts == 0.5


def test_a_state_space_model_is_read_exactly_and_its_hidden_modes_cancel():
    A, B = [[0.5, 1.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.9]], [[0.0], [1.0], [1.0]]
    g = rational(control.ss(A, B, [[1, 0, 0]], [[0.25]], True))
    assert g.equals(0.25 + 1 / ((q - 0.5) * (q - 0.2)))  # the mode at 0.9 is not seen


def test_symbolic_coefficients_cancel_and_take_values():
    Q, a, b = sympy.symbols("q a b")
    g = rational((Q - a) * (Q - b) / ((Q - a) * (Q + b)))
    assert g.parameters == ("b",)
    assert g.substitute({"b": 0.5}).equals((q - 0.5) / (q + 0.5))
    with pytest.raises(ModelError, match="no value is given for b.*substitute"):
        g.poles()


@pytest.mark.parametrize("seed", range(10))
def test_stability_decided_exactly_agrees_with_the_roots(seed):
    rng = np.random.default_rng(seed)
    p = tuple(Fraction(int(c), 10) for c in rng.integers(-12, 13, 4))
    below = (Fraction(1), *p)
    if np.min(np.abs(np.abs(np.roots([float(c) for c in below])) - 1)) > 1e-6:
        g = Rational((Fraction(1),), below, "q")
        assert g.is_stable == all(r.is_stable for r in g.poles())
    h = Rational((Fraction(1),), below, "s")
    if np.min(np.abs(np.roots([float(c) for c in below]).real)) > 1e-6:
        assert h.is_stable == all(r.is_stable for r in h.poles())


def test_an_integrator_is_not_stable_and_a_double_one_neither():
    assert not (1 / (q - 1)).is_stable
    assert not (1 / (q - 1) ** 2).is_stable
    assert not (1 / s).is_stable
    assert (1 / (s * s + 0.1 * s + 1)).is_stable


def test_a_zero_tells_where_it_is_and_at_what_frequency():
    zero = ((s - 2) / (s * s + s + 1)).zeros()[0]
    assert not zero.is_stable
    assert zero.frequency == pytest.approx(2)
    assert str(zero) == "s = 2 (right half plane, 2 rad/s)"
    Ts = 0.1
    z = Rational.shift(Ts)
    pair = (z * z - 2 * 1.25 * sympy.Rational(3, 5) * z + Fraction(25, 16)).zeros()
    assert [abs(r.value) for r in pair] == pytest.approx([1.25, 1.25])
    angle, decay = np.arccos(0.6), np.log(1.25)  # of q = 1.25 exp(i angle)
    assert pair[0].frequency == pytest.approx(np.hypot(angle, decay) / Ts)
    assert "not inside the unit circle" in str(pair[0])


def test_frequency_response_is_that_of_control():
    g = (q * 0.3 + 0.1) / (q * q - 0.5 * q + 0.2)
    w = np.array([0.1, 0.7, 2.0])
    np.testing.assert_allclose(g.frequency_response(w), g.to_control()(np.exp(1j * w)), rtol=1e-12)
    h = (s + 2) / (s * s + s + 3)
    np.testing.assert_allclose(h.frequency_response(w), h.to_control()(1j * w), rtol=1e-12)


# -- matrices ----------------------------------------------------------------------------------


def test_smith_mcmillan_poles_and_zeros_of_a_textbook_matrix():
    """Skogestad & Postlethwaite (2005), examples 4.8 and 4.14: poles -1, -2, -2 and 1; zero 1."""
    G = transfer_matrix(
        [
            [(s - 1) * (s + 2), Rational(()), (s - 1) ** 2],
            [-(s + 1) * (s + 2), (s - 1) * (s + 1), (s - 1) * (s + 1)],
        ]
    )
    scale = transfer_matrix(
        [[1 / ((s + 1) * (s + 2) * (s - 1)), 0], [0, 1 / ((s + 1) * (s + 2) * (s - 1))]]
    )
    G = scale @ G
    assert sorted(r.value.real for r in G.poles()) == pytest.approx([-2, -2, -1, 1], abs=1e-6)
    assert [r.value for r in G.zeros()] == pytest.approx([1])
    assert mcmillan_degree(G) == 4
    assert G.rank() == 2


@pytest.mark.parametrize("shape", [(1, 3), (3, 1), (2, 2)])
def test_a_realisation_has_the_transfer_matrix_and_rows_and_columns_are_minimal(shape):
    rng = np.random.default_rng(5)

    def module():
        b, a, d = rng.integers(-9, 10, 3)
        return Fraction(int(d), 10) + Fraction(int(b), 10) / (q - Fraction(int(a), 10))

    G = transfer_matrix([[module() for _ in range(shape[1])] for _ in range(shape[0])])
    system = state_space(G)
    w = np.array([0.2, 1.0, 3.0])
    got = np.stack([system(np.exp(1j * x), squeeze=False) for x in w])
    np.testing.assert_allclose(
        got.reshape(3, *shape), G.frequency_response(w), rtol=1e-10, atol=1e-12
    )
    if 1 in shape:
        assert system.nstates == mcmillan_degree(G)


def test_poles_at_infinity_count_in_the_mcmillan_degree():
    assert mcmillan_degree(q * q + 1 / (q - 0.5)) == 3


def test_an_inverse_is_one_and_the_determinant_of_a_product_is_the_product():
    a = transfer_matrix([[1 / (q - 0.5), 1], [0.3, q / (q + 0.2)]])
    b = transfer_matrix([[2, 1 / q], [0.3 / (q - 0.1), 1]])
    assert (a @ a.inverse()).equals(transfer_matrix([[1, 0], [0, 1]]))
    product = determinant(a.rows) * determinant(b.rows)
    assert determinant((a @ b).rows).equals(product)


def test_a_matrix_reads_control_numpy_sympy_and_casadi():
    x = ca.SX.sym("q")
    Q = sympy.Symbol("q")
    wanted = transfer_matrix([[1 / (q - 0.5), 2]])
    for source in (
        control.tf([[[1], [2]]], [[[1, -0.5], [1]]], True),
        sympy.Matrix([[1 / (Q - 0.5), 2]]),
        ca.horzcat(1 / (x - 0.5), 2),
    ):
        assert transfer_matrix(source).equals(wanted)
    assert transfer_matrix(np.eye(2)).equals(transfer_matrix([[1, 0], [0, 1]]))


# -- refusals ----------------------------------------------------------------------------------


def test_sample_times_and_variables_that_differ_are_refused_with_the_mend():
    with pytest.raises(ModelError, match="Ts = 0.1 s, .* Ts = 0.2 s; resample one"):
        1 / Rational.shift(0.1) + 1 / Rational.shift(0.2)
    with pytest.raises(ModelError, match="sample_system"):
        1 / q + 1 / (s + 1)
    with pytest.raises(ModelError, match="sample times differ"):
        transfer_matrix([[1 / Rational.shift(0.1), 1 / Rational.shift(0.2)]])
    with pytest.raises(ModelError, match="has the sample time 0.1 s, not 0.2 s; resample"):
        rational(control.tf([1], [1, 0.5], 0.1), Ts=0.2)


def test_dimensions_that_differ_are_refused_with_the_mend():
    with pytest.raises(ModelError, match="row 1 .* has 1 entries, row 0 has 2; give every row"):
        transfer_matrix([[1, 2], [3]])
    with pytest.raises(ModelError, match="inner dimensions differ"):
        transfer_matrix([[1, 2]]) @ transfer_matrix([[1, 2]])
    with pytest.raises(ModelError, match="2 outputs and 1 inputs .* use .*transfer_matrix"):
        rational(control.tf([[[1]], [[1]]], [[[1, 2]], [[1, 3]]], True))
    with pytest.raises(ModelError, match="given as rows"):
        transfer_matrix([1, 2])


def test_what_is_no_transfer_function_is_refused_with_what_is():
    with pytest.raises(ModelError, match="give a number, a Rational, a sympy expression"):
        rational("1/(q-0.5)")
    with pytest.raises(ModelError, match="not rational in q; approximate"):
        rational(sympy.exp(sympy.Symbol("q")))
    with pytest.raises(ModelError, match="name the one that is the shift .* variable="):
        rational(sympy.Symbol("q") * sympy.Symbol("s"))
    with pytest.raises(ModelError, match="look for a 1/0"):
        rational(float("inf"))
    with pytest.raises(ModelError, match="denominator zero"):
        Rational((Fraction(1),), (Fraction(0),))
    with pytest.raises(ModelError, match="is a pole of .* choose another point"):
        (1 / (q - 2)).at(2)


def test_an_improper_function_has_no_direct_term_and_no_realisation():
    with pytest.raises(ModelError, match="improper .* Delay or filter it"):
        (q * q / (q - 0.5)).direct  # noqa: B018
    with pytest.raises(ModelError, match="delay it by 1 samples, or filter it"):
        state_space(q * q / (q - 0.5))
    with pytest.raises(ModelError, match="singular at every q .* column 1 depends"):
        transfer_matrix([[1 / q, 2 / q], [1, 2]]).inverse()
