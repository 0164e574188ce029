"""A rational function is its values: found again exactly from prime fields, or given up openly."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from casid.algebra.interpolation import interpolate
from casid.algebra.prime_field import random_prime
from casid.algebra.rational_degrees import univariate_degrees
from casid.errors import ModelError

P = 1_073_741_827  # the least prime above 2^30


def field_function(*functions):
    """Functions of a name -> value mapping and of division modulo p, as one function."""

    def values(at, p):
        def over(a, b):
            if b % p == 0:
                raise ZeroDivisionError
            return a * pow(b, -1, p)

        return np.array([f(at, over) % p for f in functions], dtype=np.int64)

    return values


@st.composite
def polynomials(draw, least=0):
    """Exponents of (x, y) to nonzero coefficients."""
    exponents = st.tuples(st.integers(0, 3), st.integers(0, 3))
    coefficients = st.integers(-9, 9).filter(bool)
    return draw(st.dictionaries(exponents, coefficients, min_size=least, max_size=4))


def evaluated(polynomial, x, y):
    return sum(c * x**a * y**b for (a, b), c in polynomial.items())


@settings(deadline=None, max_examples=25)
@given(polynomials(), polynomials(least=1))
def test_a_rational_function_is_found_again_from_its_values(top, bottom):
    function = field_function(
        lambda v, over: over(evaluated(top, v["x"], v["y"]), evaluated(bottom, v["x"], v["y"]))
    )
    (found,) = interpolate(function, ["x", "y", "unused"])
    assert "unused" not in found.variables
    x, y = Fraction(17, 5), Fraction(-3, 7)
    if evaluated(bottom, x, y):
        import sympy

        there = {sympy.Symbol("x"): sympy.Rational(17, 5), sympy.Symbol("y"): -sympy.Rational(3, 7)}
        expected = Fraction(evaluated(top, x, y)) / evaluated(bottom, x, y)
        assert found.to_sympy().subs(there) == sympy.Rational(
            expected.numerator, expected.denominator
        )


@given(st.integers(0, 6), st.integers(0, 6), st.randoms(use_true_random=False))
def test_degrees_are_told_as_soon_as_three_values_are_redundant(n, d, random):
    """N/D has n + d + 1 coefficients up to scale; with 3 points more, chance agrees at 1/p^2."""
    top, bottom = ([random.randrange(1, P) for _ in range(k + 1)] for k in (n, d))
    t = random.sample(range(1, P), n + d + 3)
    y = [
        sum(c * pow(x, k, P) for k, c in enumerate(top))
        * pow(sum(c * pow(x, k, P) for k, c in enumerate(bottom)), -1, P)
        % P
        for x in t
    ]
    assert univariate_degrees(t, y, P) == (n, d)


def test_coefficients_too_large_for_one_prime_come_from_several():
    """A fraction a/b is told by p only if both are below sqrt(p / 2), about 30 000."""
    function = field_function(lambda v, over: over(123456789 * v["x"] + 1, 987654321 * v["y"]))
    (found,) = interpolate(function, ["x", "y"])
    assert str(found.to_sympy()) == "(123456789*x + 1)/(987654321*y)"


def test_many_variables_cost_terms_that_are_there_and_not_all_that_could_be():
    """Twelve variables of degree 1: 4096 monomials each, of which two and twelve are there."""
    names = [f"x{i}" for i in range(12)]
    function = field_function(
        lambda v, over: over(
            np.prod([v[n] for n in names], dtype=object) + 1, sum(v[n] for n in names)
        )
    )
    (found,) = interpolate(function, names, max_unknowns=60)
    assert len(found.numerator) == 2
    assert len(found.denominator) == 12


def test_a_component_that_is_too_large_is_given_up_and_the_others_are_not():
    function = field_function(
        lambda v, over: (v["x"] + v["y"]) ** 9,
        lambda v, over: v["x"] ** 50,
        lambda v, over: over(v["x"], v["y"]),
    )
    dense, high, easy = interpolate(function, ["x", "y"], max_unknowns=15)
    assert dense is None
    assert high is None
    assert str(easy.to_sympy()) == "x/y"


def test_what_is_no_function_of_the_variables_is_given_up():
    """A value that depends on something not named looks random."""
    rng = np.random.default_rng(3)
    noise = field_function(lambda v, over: int(rng.integers(P)))
    assert interpolate(noise, ["x"]) == (None,)


def test_points_that_divide_by_zero_are_drawn_again():
    """x / (x - y) where x and y are often equal: half the points are not defined."""
    calls = {"n": 0}

    def function(at, p):
        calls["n"] += 1
        if calls["n"] % 2:
            raise ZeroDivisionError
        return np.array([at["x"] * pow(at["x"] - at["y"], -1, p) % p])

    (found,) = interpolate(function, ["x", "y"])
    assert str(found.to_sympy()) == "x/(x - y)"


def test_a_function_that_is_defined_nowhere_is_refused_with_what_to_do():
    def nowhere(at, p):
        raise ZeroDivisionError

    with pytest.raises(ModelError, match="choose other free parameters"):
        interpolate(nowhere, ["x"])


def test_primes_can_be_chosen_and_give_the_same_function():
    function = field_function(lambda v, over: over(v["x"] ** 2 - 2, 3 * v["x"]))
    rng = np.random.default_rng(11)
    own = [random_prime(rng) for _ in range(3)]
    assert (
        interpolate(function, ["x"], primes=own)[0].numerator
        == interpolate(function, ["x"])[0].numerator
    )
