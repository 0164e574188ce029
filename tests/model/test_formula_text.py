"""Expressions written as text mean what the expressions mean."""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from casid.errors import ModelError
from casid.model.formula_text import MODELICA, PLAIN, PYTHON, formula_text, shared_parts, summands

X, Y, A = (ca.SX.sym(name) for name in ("x", "y", "a"))
LEAVES = (
    st.sampled_from([X, Y, A]) | st.floats(-3.0, 3.0).map(ca.SX) | st.integers(-4, 4).map(ca.SX)
)
BINARY = (
    lambda a, b: a + b,
    lambda a, b: a - b,
    lambda a, b: a * b,
    lambda a, b: a / (b + 5.7),
    lambda a, b: ca.fmax(a, b),
    lambda a, b: ca.if_else(a < b, a, b),
    lambda a, b: ca.fabs(a) ** b,
)
UNARY = (lambda a: -a, lambda a: a**2, lambda a: a**3, ca.sin, ca.tanh, ca.fabs, lambda a: 2 * a)


def combined(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.builds(lambda f, a, b: f(a, b), st.sampled_from(BINARY), inner, inner) | st.builds(
        lambda f, a: f(a), st.sampled_from(UNARY), inner
    )


def value(expression: Any, point: tuple[float, float, float] = (0.7, -1.3, 0.4)) -> float:
    return float(ca.Function("v", [X, Y, A], [ca.SX(expression)])(*point))


@given(st.recursive(LEAVES, combined, max_leaves=12))
@settings(max_examples=150, deadline=None, derandomize=True)
def test_python_text_evaluates_to_the_expression(expression: Any) -> None:
    if not math.isfinite(value(expression)):
        return
    text = formula_text(expression, PYTHON)
    again = eval(text, {"ca": ca, "x": X, "y": Y, "a": A})
    assert value(again) == pytest.approx(value(expression), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("expression", "python", "modelica"),
    [
        (-A * ca.fabs(X) * X, "-a * ca.fabs(x) * x", "-a * abs(x) * x"),
        ((X + Y) ** 2, "(x + y) ** 2", "(x + y) ^ 2"),
        (-(X**3), "-x**3", "-x^3"),
        (X / -Y, "-x / y", "-x / y"),
        (A - (X - Y), "a - (x - y)", "a - (x - y)"),
        (ca.tanh(X / 0.003), "ca.tanh(x / 0.003)", "tanh(x / 0.003)"),
        (ca.if_else(X < Y, A, 2), "ca.if_else(x < y, a, 2)", "(if x < y then a else 2)"),
        (X**-0.5, "x**-0.5", "x ^ (-0.5)"),
        (ca.fmin(X, -2), "ca.fmin(x, -2)", "min(x, -2)"),
    ],
)
def test_formulas_read_as_a_person_writes_them(expression: Any, python: str, modelica: str) -> None:
    assert formula_text(expression, PYTHON) == python
    assert formula_text(expression, MODELICA) == modelica


def test_numbers_keep_all_their_digits() -> None:
    number = 0.1 + 0.2
    assert formula_text(number * X, PLAIN) == "0.30000000000000004 * x"


def test_what_formulas_share_gets_a_name() -> None:
    S = X * Y + A * X
    united, parts = shared_parts([S * 2, ca.sin(S) + A, S])
    assert [formula_text(part.expression) for part in parts] == ["x * y + a * x"]
    names = {part.key: "S" for part in parts}
    assert [formula_text(e, parts=names) for e in united] == ["2 * S", "sin(S) + a", "S"]


def test_a_sum_falls_into_its_terms() -> None:
    terms = summands(X - A * Y - 3)
    assert [formula_text(t) for t in terms] == ["x", "-a * y", "-3"]
    assert value(sum(terms, ca.SX(0))) == pytest.approx(value(X - A * Y - 3), abs=1e-15)


def test_a_function_without_a_word_is_refused() -> None:
    with pytest.raises(ModelError, match="erf cannot be written as Modelica"):
        formula_text(ca.erf(X), MODELICA)
    with pytest.raises(ModelError, match="nan"):
        formula_text(np.nan * X + ca.SX(float("nan")), PYTHON)
