"""CasADi expressions read as algebra are the same functions, exactly where they are rational."""

from __future__ import annotations

from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from casid.algebra.symbolic import evaluate_exactly, exact, to_sympy
from casid.errors import ModelError

x, y = ca.SX.sym("x"), ca.SX.sym("y")
EXPRESSIONS = {
    "polynomial": x**3 - 2 * x * y + 0.5 * y**2 - 7,
    "quotient": (x + y) / (x * y - 3) + 1 / x,
    "roots and powers": ca.sqrt(x) + x**1.5 + y**-2 + ca.power(x, y),
    "transcendent": ca.sin(x) * ca.exp(-y) + ca.log(x) + ca.atan2(x, y) + ca.tanh(y),
    "less usual": ca.log1p(x) + ca.expm1(y) + ca.erf(x) + ca.hypot(x, y) + ca.asinh(y),
    "not smooth": ca.fabs(x - y) + ca.sign(y - x) + ca.fmin(x, y) - ca.fmax(x, 1) + ca.floor(y),
    "branches": ca.if_else(x < y, x, 2 * y) + ca.if_else(ca.logic_or(x >= 1, y == 2), 3, x),
    "logic": ca.if_else(ca.logic_not(ca.logic_and(x <= 1, y != 2)), 3, x),
}


@pytest.mark.parametrize("name", EXPRESSIONS)
@pytest.mark.parametrize("point", [(0.7, 1.9), (2.3, 0.4)])
def test_sympy_and_casadi_give_the_same_values(name, point):
    expression = EXPRESSIONS[name]
    expected = float(ca.Function("f", [x, y], [expression])(*point))
    got = to_sympy(expression, {"x": point[0], "y": point[1]})[0]
    assert float(got) == pytest.approx(expected, rel=1e-14)


def test_a_matrix_keeps_its_shape_and_its_structural_zeros():
    import sympy

    A = ca.SX(2, 3)
    A[1, 0], A[0, 2] = x, 0.25 * y
    got = to_sympy(A, exact_numbers=True)
    X, Y = sympy.symbols("x y")
    assert got == sympy.Matrix([[0, 0, Y / 4], [X, 0, 0]])


def test_an_identity_on_paper_is_one_in_exact_numbers():
    """0.1 + 0.2 = 0.3 and (x + 0.1)^2 = x^2 + 0.2 x + 0.01: false in floats, true as decimals."""
    import sympy

    difference = to_sympy((x + 0.1) ** 2 - (x**2 + 0.2 * x + 0.01), exact_numbers=True)[0]
    assert sympy.expand(difference) == 0
    assert exact(0.1) + exact(0.2) == exact(0.3)
    assert exact(-0.218) == Fraction(-109, 500)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_the_exact_number_reads_back_as_the_float(value):
    assert float(exact(value)) == value


def test_rational_functions_are_evaluated_without_rounding():
    f = ca.Function("f", [ca.vertcat(x, y)], [ca.vertcat((x**2 - y) / (3 * x), 0, ca.inv(y))])
    assert evaluate_exactly(f, [Fraction(1, 3), Fraction(2)]) == [
        [Fraction(-17, 9), Fraction(0), Fraction(1, 2)]
    ]


def test_exact_values_are_the_floats_to_rounding():
    rng = np.random.default_rng(5)
    f = ca.Function("f", [x, y], [EXPRESSIONS["polynomial"], EXPRESSIONS["quotient"]])
    for point in rng.uniform(-3, 3, (20, 2)).round(3).tolist():
        got = evaluate_exactly(f, [exact(point[0])], [exact(point[1])])
        np.testing.assert_allclose(
            [float(got[0][0]), float(got[1][0])], [float(v) for v in f(*point)], rtol=1e-11
        )


def test_matrix_functions_are_expanded_first():
    z = ca.MX.sym("z", 2, 2)
    f = ca.Function("f", [z], [z[0, 0] * z[1, 1] - z[0, 1] * z[1, 0]])
    assert evaluate_exactly(f, [Fraction(v) for v in (1, 2, 3, 5)])[0] == [Fraction(-1)]


# -- refusals ------------------------------------------------------------------------------------


def test_a_pole_is_a_division_by_zero():
    with pytest.raises(ZeroDivisionError):
        evaluate_exactly(ca.Function("f", [x], [1 / (x - 1)]), [Fraction(1)])


def test_what_is_not_rational_is_refused_by_name():
    with pytest.raises(ModelError, match="OP_SIN cannot be done in exact algebra"):
        evaluate_exactly(ca.Function("f", [x], [ca.sin(x)]), [Fraction(1)])
    with pytest.raises(ModelError, match="exponent 1/2 is not rational"):
        evaluate_exactly(ca.Function("f", [x, y], [ca.power(x, y)]), [Fraction(1)], [exact(0.5)])
    with pytest.raises(ModelError, match="OP_FMOD"):
        to_sympy(ca.fmod(x, y))


def test_two_symbols_of_one_name_are_refused():
    with pytest.raises(ModelError, match="give one of them another name"):
        to_sympy(ca.SX.sym("a") + ca.SX.sym("a"))


def test_numbers_that_are_none_are_refused():
    with pytest.raises(ModelError, match="look for a division by zero"):
        exact(float("nan"))


def test_the_number_of_entries_must_fit():
    with pytest.raises(ModelError, match="argument 0 has 1 entries, 2 were given"):
        evaluate_exactly(ca.Function("f", [x], [x]), [Fraction(1), Fraction(2)])
