"""Text becomes a formula or a message, never code."""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from casid.errors import ModelError, nearest
from casid.model.expressions import MAX_DEPTH, MAX_LENGTH, names, parse

POINT = {"x": 0.7, "y": -1.3, "b1": 2.5}
KINDS = pytest.mark.parametrize("kind", [ca.SX, ca.MX], ids=["SX", "MX"])


def value_of(text: str, kind: Any = ca.SX) -> float:
    symbols = {name: kind.sym(name) for name in POINT}
    function = ca.Function("f", list(symbols.values()), [parse(text, symbols)])
    return float(function(*POINT.values()))


@KINDS
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("-x**2", -(0.7**2)),  # the sign binds looser than the power
        ("2**-1", 0.5),
        ("2**3**2", 512.0),  # powers associate to the right
        ("2^3^2", 512.0),
        ("8/4/2", 1.0),  # quotients and differences to the left
        ("1-2-3", -4.0),
        ("-x*-y", 0.7 * -1.3),
        ("b1*(1-exp[-x*(1+y)])", 2.5 * (1 - math.exp(-0.7 * -0.3))),
        ("arctan[x/(x-y)]/pi", math.atan(0.7 / 2.0) / math.pi),
        ("ln(E)", 1.0),
        ("min(x, y) + max(x, y)", 0.7 - 1.3),
        ("(1+2*b1*x)**(-.5)", (1 + 2 * 2.5 * 0.7) ** -0.5),
        ("3.141592653589793238462643383279E0", math.pi),
        ("pow(b1, y)\n + sign(y)*abs(y)", 2.5**-1.3 - 1.3),
    ],
)
def test_formulas_mean_what_mathematics_makes_of_them(kind, text, expected):
    assert value_of(text, kind) == pytest.approx(expected, rel=1e-14)


Printed = tuple[str, Any]  # text, and its value in the floating type given, by numpy

leaves = st.one_of(
    st.sampled_from([(name, lambda t, v=value: t(v)) for name, value in POINT.items()]),
    st.floats(0.01, 100.0).map(lambda v: (repr(v), lambda t: t(v))),
    st.just(("pi", lambda t: t(math.pi))),
)
UNARY = ["sin", "cos", "arctan", "exp", "tanh", "sqrt", "log", "abs", "sinh"]
BINARY = {"+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide}


def _grow(children: st.SearchStrategy[Printed]) -> st.SearchStrategy[Printed]:
    """Unary and binary nodes over `children`."""

    def call(name: str, b: str, child: Printed) -> Printed:
        return f"{name}{b[0]}{child[0]}{b[1]}", lambda t: getattr(np, name)(child[1](t))

    def pair(op: str, b: str, left: Printed, right: Printed) -> Printed:
        text = f"{b[0]}{left[0]} {op} {b[0]}{right[0]}{b[1]}{b[1]}"
        return text, lambda t: BINARY[op](left[1](t), right[1](t))

    def negative(child: Printed) -> Printed:
        return f"-({child[0]})", lambda t: -child[1](t)

    def power(child: Printed, n: int, op: str) -> Printed:
        return f"({child[0]}){op}{n}", lambda t: child[1](t) ** t(n)

    brackets = st.sampled_from(["()", "[]"])
    return st.one_of(
        st.builds(call, st.sampled_from(UNARY), brackets, children),
        st.builds(pair, st.sampled_from(list(BINARY)), brackets, children, children),
        st.builds(negative, children),
        st.builds(power, children, st.integers(-3, 4), st.sampled_from(["**", "^"])),
    )


@settings(deadline=None, max_examples=150, derandomize=True)
@given(st.recursive(leaves, _grow, max_leaves=12))
def test_a_printed_expression_has_the_value_numpy_gives_it(case):
    text, value = case
    with np.errstate(all="ignore"):
        expected, longer = value(np.float64), value(np.longdouble)
    assume(np.isfinite(expected))
    try:
        got = value_of(text)
    except ModelError as error:  # a constant part that is infinite though the whole is not
        refusal = str(error)
    else:
        refusal = ""
    if refusal:
        assert "no finite real value" in refusal or "division by zero" in refusal
        return
    # The last digits that rounding took (by cancellation, say) are not compared: numpy in extended
    # precision tells how many.
    lost = float(abs(longer - expected))
    assert got == pytest.approx(float(expected), rel=1e-12, abs=100 * lost)


BREAK_INS = {
    "an import": ("__import__('os').system('true')", "has no place in a formula"),
    "a dunder name": ("__class__", "is not declared"),
    "an attribute": ("x.__class__.__mro__", "has no place in a formula"),
    "a method": ("x.sym(y)", "has no place in a formula"),
    "a builtin": ("eval(x)", "unknown function 'eval'"),
    "getattr": ("getattr(x, y)", "unknown function 'getattr'"),
    "a lambda": ("lambda: x", "has no place in a formula"),
    "a comprehension": ("[x for x in y]", "needs ']'"),
    "a subscript": ("x[0]", "'x' is no function; write a product as x*["),
    "a string": ("'x'", "has no place in a formula"),
    "an f-string": ('f"{x}"', "has no place in a formula"),
    "an assignment": ("x = y", "has no place in a formula"),
    "a walrus": ("(x := y)", "has no place in a formula"),
    "a statement": ("x; y", "has no place in a formula"),
    "a comment": ("x # y", "has no place in a formula"),
    "a tuple": ("x, y", "expected an operator before ','"),
    "a starred call": ("min(*x)", "expected a number, a name or a bracket"),
    "a keyword call": ("min(x, y=y)", "has no place in a formula"),
    "a huge power": ("9**9**9**9", "exponent 3.8742e+08 lies beyond +-100"),
    "a huge power of a symbol": ("x^1e9", "write it as exp(...*log(...))"),
    "a huge number": ("1e999", "no finite real value"),
    "a full-width letter": ("\uff58", "(U+FF58)"),
    "a Cyrillic look-alike": ("\u0445 + y", "(U+0445)"),
    "a superscript": ("x\u00b2", "(U+00B2)"),
    "Arabic digits": ("\u0661", "(U+0661)"),
    "a non-breaking space": ("x\u00a0+ y", "(U+00A0)"),
    "a right-to-left mark": ("x\u202e + y", "(U+202E)"),
    "a null byte": ("x\x00", "has no place in a formula"),
    "a hexadecimal number": ("0x10", "expected an operator before 'x10'"),
    "digit grouping": ("1_000", "expected an operator before '_000'"),
    "an imaginary number": ("2j", "expected an operator before 'j'"),
    "a complex power": ("(-8)**(1/3)", "no finite real value"),
    "division by zero": ("x/0", "division by zero"),
    "a folded division by zero": ("1/(2-2)", "no finite real value"),
    "the empty text": ("", "but the formula ends"),
    "a bare operator": ("+", "but the formula ends"),
}


@pytest.mark.parametrize("attempt", BREAK_INS)
def test_what_is_no_formula_is_refused_with_its_place(attempt):
    text, words = BREAK_INS[attempt]
    with pytest.raises(ModelError, match=r"character \d+: ") as caught:
        parse(text, {"x": ca.SX.sym("x"), "y": ca.SX.sym("y")}, where="model.toml")
    assert words in str(caught.value)
    assert str(caught.value).startswith("model.toml: ")


@pytest.mark.parametrize("opening", ["(", "[", "-", "sin(", "x^", "x*("])
def test_nesting_is_bounded_long_before_the_stack_is(opening):
    n = MAX_DEPTH + 1
    closing = {"(": ")", "[": "]"}.get(opening[-1], "")
    with pytest.raises(ModelError, match="nested more than .*substitute"):
        parse(opening * n + "x" + closing * n, {"x": ca.SX.sym("x")})
    few = MAX_DEPTH // 2 - 1  # "x*(" nests twice
    shallow = opening * few + "x" + closing * few
    assert parse(shallow, {"x": ca.SX.sym("x")}).shape == (1, 1)


@KINDS
def test_length_is_bounded_and_a_formula_of_full_length_is_read(kind):
    x = kind.sym("x")
    full = "+".join(["x"] * (MAX_LENGTH // 2))
    assert float(ca.Function("f", [x], [parse(full, {"x": x})])(1.0)) == MAX_LENGTH // 2
    with pytest.raises(ModelError, match=f"more than {MAX_LENGTH}; split"):
        parse(full + "+x", {"x": x})


@given(st.text(max_size=40))
@settings(deadline=None, derandomize=True)
@example("x.real")
def test_any_text_gives_an_expression_or_a_model_error(text):
    try:
        read = parse(text, {"x": ca.SX.sym("x")})
    except ModelError:
        return
    assert isinstance(read, ca.SX)


def test_a_misspelt_name_is_answered_with_the_nearest_one():
    symbols = {"omega_n": ca.SX.sym("omega_n"), "zeta": ca.SX.sym("zeta")}
    with pytest.raises(ModelError, match="character 3: 'omega' is not declared; did you mean 'om"):
        parse("2*omega*zeta", symbols)
    with pytest.raises(ModelError, match=r"unknown function 'atn'; did you mean 'atan'\?"):
        parse("atn(zeta)", symbols)
    assert nearest("k", []) == "; none is declared"


def test_a_declared_symbol_shadows_a_constant_and_nothing_else_does():
    energy = ca.SX.sym("E")
    assert ca.is_equal(parse("E", {"E": energy}), energy)
    assert float(parse("E", {})) == math.e
    assert float(parse("2*g", {"g": 9.81})) == 2 * 9.81  # a number is a known value
    with pytest.raises(ModelError, match="'e' is not declared"):  # NIST's "+ e" is an error term
        parse("e", {})


def test_symbols_of_two_kinds_are_refused():
    with pytest.raises(ModelError, match="same kind"):
        parse("x", {"x": ca.SX.sym("x"), "y": ca.MX.sym("y")})


def test_names_are_listed_without_functions_and_constants():
    assert names("b1*exp[-b2*x]/pi + b1 - exp0") == ("b1", "b2", "x", "exp0")
