"""Equations written as text become systems, or a message that says how to mend them."""

from __future__ import annotations

import ast
import json
import operator
import os
from fractions import Fraction
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from casid.errors import DataError, ModelError
from casid.identifiability.equations.equation_file import MAX_BYTES, read_equations
from casid.identifiability.equations.equation_text import parse_system, parse_systems
from casid.identifiability.equations.system import System
from tests.support.shared import shared

FILES = """akt_fujita bilirubin c2m_w_b cgv1990 crauste crn dof2_F2 goodwin hdnl hiv_eta_unknown
hiv_wodarz jakstat kd1999 leukaemia llw mapk6 me_catenary5 me_cyclic5 nfkb_full pharm qy
related_massdamper seaijrc si_issue419 si_issue503 siwr1""".split()

MASS: dict[str, Any] = {
    "states": ["x", "v"],
    "params": ["m", "d", "k"],
    "known_inputs": ["F"],
    "equations": {"x": "v", "v": "(F - d*v - k*x)/m"},
    "outputs": {"position": "x"},
}


def without(*fields: str) -> dict[str, Any]:
    return {k: v for k, v in MASS.items() if k not in fields}


def values(system: System, **at: float) -> list[float]:
    """f and h, one below the other, at a point."""
    function = ca.Function(
        "s", [system.symbols[n] for n in system.declared], [ca.vertcat(system.f, system.h)]
    )
    return [float(v) for v in function(*[at[n] for n in system.declared]).full().ravel()]


OPERATORS: dict[type, Any] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}


def by_python_grammar(node: Any, point: dict[str, float]) -> float:
    """The value of a formula as Python's own grammar groups it: a second reader."""
    match node:
        case ast.Constant():
            return float(node.value)
        case ast.Name():
            return point[node.id]
        case ast.UnaryOp():
            return float(OPERATORS[type(node.op)](by_python_grammar(node.operand, point)))
        case ast.BinOp():
            sides = by_python_grammar(node.left, point), by_python_grammar(node.right, point)
            return float(OPERATORS[type(node.op)](*sides))
        case _:
            function = {"exp": np.exp, "log": np.log, "sin": np.sin, "cos": np.cos}[node.func.id]
            return float(function(by_python_grammar(node.args[0], point)))


def written(folder: Path, text: str, name: str = "model.json") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


# -- what is read --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FILES)
def test_published_models_are_read_with_all_they_declare(name):
    path = shared(f"identifiability/{name}.json")
    fields = json.loads(path.read_text(encoding="utf-8"))
    read = read_equations(path)
    assert (read.name, read.description, read.path) == (fields["name"], fields["description"], path)
    sets = fields.get("data_sets", [fields])
    assert len(read.systems) == len(sets)
    for system, own in zip(read.systems, sets, strict=True):
        assert system.states == tuple(own["states"])
        assert system.parameters == tuple(fields["params"])
        assert system.inputs == tuple(own["known_inputs"])
        assert system.unknown_inputs == tuple(own["unknown_inputs"])
        assert system.constants == tuple(own.get("known_constants", ()))
        assert system.outputs == tuple(own["outputs"])
        assert system.is_generic


def test_every_file_of_the_folder_is_in_the_table():
    assert sorted(p.stem for p in shared("identifiability").glob("*.json")) == sorted(FILES)


@pytest.mark.parametrize("name", FILES)
def test_formulas_of_the_published_models_have_the_values_that_pythons_grammar_gives(name):
    path = shared(f"identifiability/{name}.json")
    fields = json.loads(path.read_text(encoding="utf-8"))
    rng = np.random.default_rng(4)
    sets = fields.get("data_sets", [fields])
    for system, own in zip(read_equations(path).systems, sets, strict=True):
        point = dict(zip(system.declared, rng.uniform(0.5, 1.5, len(system.declared)), strict=True))
        texts = [*(own["equations"][s] for s in system.states), *own["outputs"].values()]
        expected = [by_python_grammar(ast.parse(t, mode="eval").body, point) for t in texts]
        # Both evaluate in doubles, in other orders: a few roundings of sums of some ten terms.
        np.testing.assert_allclose(values(system, **point), expected, rtol=1e-12, atol=1e-12)


def test_related_data_sets_share_parameters_and_have_their_own_constants():
    first, second = read_equations(shared("identifiability/related_massdamper.json")).systems
    assert (first.name, second.name) == ("data set 1", "data set 2")
    assert first.parameters == second.parameters == ("m", "d")
    assert (first.constants, second.constants) == ((), ("dm",))


def test_a_toml_file_says_the_same_as_a_json_file(tmp_path):
    toml = """
    name = "mass on a spring"
    states = ["x", "v"]
    parameters = ["m", "d", "k"]   # synonyms
    inputs = ["F"]
    known_initial = {x = 0}
    parameters_at = {d = "1/3"}
    comment = "fields that are not known are left alone"
    definitions.spring = "k*x"
    [equations]
    x = "v"
    v = "(F - d*v - spring)/m"
    [outputs]
    position = "x"
    [units]
    x = "m"
    """
    read = read_equations(written(tmp_path, toml, "mass.toml"))
    (system,) = read.systems
    assert read.name == system.name == "mass on a spring"
    point = {"x": 0.3, "v": -0.2, "m": 2.0, "d": 0.7, "k": 5.0, "F": 1.1}
    assert values(system, **point) == pytest.approx(values(parse_system(MASS), **point), rel=1e-15)
    assert system.initial_values == {"x": Fraction(0)}
    assert system.at == {"d": Fraction(1, 3)}
    assert system.units == {"x": "m"}
    assert not system.is_generic


def test_a_file_without_a_name_is_called_by_its_own(tmp_path):
    read = read_equations(written(tmp_path, "\ufeff" + json.dumps(MASS), "spring.json"))
    assert (read.name, read.systems[0].name, read.description) == ("spring", "spring", "")


def test_known_values_are_exact_decimals_and_known_constants_may_be_numbers():
    system = parse_system(
        without("equations")
        | {
            "known_constants": {"g": 9.81, "zero": 0},
            "known_initial": {"x": 0.1, "v": -2},
            "parameters_at": {"m": 0.218},
            "equations": {"x": "v", "v": "g - k*x/m + zero*d*F"},
        }
    )
    assert system.initial_values == {"x": Fraction(1, 10), "v": Fraction(-2)}
    assert system.at == {"m": Fraction(109, 500)}
    assert system.constants == ()
    at = {"x": 0.5, "v": 1.0, "m": 2.0, "k": 3.0, "d": 7.0, "F": 5.0}
    assert values(system, **at)[1] == pytest.approx(9.81 - 0.75, rel=1e-15)


def test_initial_states_of_a_list_are_some_known_numbers():
    system = parse_system(MASS | {"known_initial": ["v"]})
    assert system.known_initial == ("v",)
    assert system.is_generic


@pytest.mark.parametrize("order", [("a", "b", "c"), ("c", "b", "a"), ("b", "c", "a")])
def test_definitions_stand_in_any_order(order):
    texts = {"a": "2*b + c", "b": "c**2", "c": "x + 1"}
    system = parse_system(
        {
            "states": ["x"],
            "definitions": {n: texts[n] for n in order},
            "equations": {"x": "a"},
            "outputs": {"y": "b"},
        }
    )
    assert values(system, x=2.0) == [21.0, 9.0]


@pytest.mark.parametrize(
    ("definitions", "loop"),
    [
        ({"a": "b + 1", "b": "2*a"}, "a -> b -> a"),
        ({"a": "x", "b": "c", "c": "d_", "d_": "a*b"}, "b -> c -> d_ -> b"),
        ({"a": "a"}, "a -> a"),
    ],
)
def test_an_algebraic_loop_is_named(definitions, loop):
    system = {"states": ["x"], "equations": {"x": "a"}, "outputs": {"y": "x"}}
    with pytest.raises(ModelError, match=rf"definitions: algebraic loop {loop}; solve it for one"):
        parse_system(system | {"definitions": definitions})


def test_a_chain_of_many_definitions_is_no_deep_recursion():
    n = 3000
    chain = {f"a{i}": f"a{i - 1} + 1" for i in range(n, 0, -1)} | {"a0": "x"}
    system = parse_system(
        {
            "states": ["x"],
            "definitions": chain,
            "equations": {"x": f"a{n}"},
            "outputs": {"y": "x"},
        }
    )
    assert values(system, x=0.5)[0] == n + 0.5


@pytest.mark.parametrize(
    "name", ["S", "E", "I", "N", "pi", "beta", "gamma", "lambda", "e5", "sign"]
)
def test_a_declared_name_is_what_it_is_declared_to_be(name):
    """E and pi are numbers elsewhere, sympy has S, I, N, beta and gamma, Python lambda."""
    system = parse_system(
        {
            "states": [name],
            "definitions": {"half": f"1e-1*5*{name}"},
            "equations": {name: f"-half + sign(2)*{name}**3"},
            "outputs": {"y": name},
        }
    )
    assert values(system, **{name: 2.0}) == [7.0, 2.0]


def test_a_system_without_states_is_static():
    system = parse_system({"params": ["a", "b"], "inputs": ["u"], "outputs": {"y": "a*b*u"}})
    assert system.states == ()
    assert system.f.shape == (0, 1)
    assert values(system, a=2.0, b=3.0, u=5.0) == [30.0]


def test_numbers_may_stand_where_formulas_do():
    system = parse_system(
        {"states": ["c"], "equations": {"c": 0}, "outputs": {"y": "c", "z": -2.5}}
    )
    assert values(system, c=4.0) == [0.0, 4.0, -2.5]


def test_powers_and_quotients_keep_their_numbers():
    system = parse_system(
        {"states": ["x"], "params": ["K"], "equations": {"x": "K**3/(K^3 + x**-2)"}}
        | {"outputs": {"y": "(1/3 - x)*92", "z": "x**0.5"}}
    )
    expected = [8 / (8 + 1 / 16), (1 / 3 - 4) * 92, 2.0]
    assert values(system, x=4.0, K=2.0) == pytest.approx(expected, rel=1e-15)


def test_data_sets_have_their_own_names_and_override_what_they_share():
    heavy = {"name": "loaded", "equations": {"x": "v", "v": "(F - d*v - k*x)/(m + dm)"}}
    systems = parse_systems(MASS | {"data_sets": [{}, heavy | {"known_constants": ["dm"]}]})
    assert [s.name for s in systems] == ["data set 1", "loaded"]
    assert [s.constants for s in systems] == [(), ("dm",)]
    with pytest.raises(ModelError, match="use parse_systems"):
        parse_system(MASS | {"data_sets": [{}, heavy | {"known_constants": ["dm"]}]})


# -- what is refused, and how it is mended -------------------------------------------------------

SECOND = {"x": "v"}
MALFORMED: dict[str, tuple[Any, str]] = {
    "unknown symbol": (
        MASS | {"equations": SECOND | {"v": "(F - dd*v)/m"}},
        r"equations\.v: 'dd' is not declared; add it to params, .*did you mean 'd'",
    ),
    "nothing near": (MASS | {"outputs": {"y": "qqqq"}}, r"outputs\.y: 'qqqq' is not declared; add"),
    "undeclared input in an output": (
        MASS | {"outputs": {"y": "x + wind"}},
        r"outputs\.y: 'wind' is not declared; add it to .*unknown_inputs",
    ),
    "output in a formula": (
        MASS | {"equations": SECOND | {"v": "-position"}},
        "'position' is an output.*move it to definitions",
    ),
    "time": (
        MASS | {"equations": SECOND | {"v": "-k*t"}},
        r"'t' is not declared; .*make it a state with derivative 1: add \"t\" to states",
    ),
    "signal of time": (MASS | {"equations": SECOND | {"v": "-x(t)"}}, r"write x, not x\(t\)"),
    "Euler's number": (MASS | {"outputs": {"y": "E*x"}}, r"'E' is not declared.*write exp\(1\)"),
    "equation missing": (MASS | {"equations": SECOND}, "state 'v' has none; add its time deriv"),
    "equation without a state": (
        MASS | {"states": ["x"]},
        r"equations\.v: 'v' is no state; add it to states, or .*definitions",
    ),
    "states forgotten": (without("states"), r"equations\.x: 'x' is no state; add it to states"),
    "declared twice": (
        MASS | {"known_constants": ["m"]},
        "'m' is declared twice, in params and in known_constants; remove or rename",
    ),
    "listed twice": (MASS | {"states": ["x", "v", "x"]}, "'x' is declared twice, in states and in"),
    "definition declared": (
        MASS | {"definitions": {"k": "2"}},
        "'k' is declared twice.*definitions",
    ),
    "no identifier": (
        MASS | {"params": ["m", "d", "k 1"]},
        r"params: 'k 1' is not a name; use ASCII",
    ),
    "not ASCII": (MASS | {"params": ["m", "d", "k", "\u03b2"]}, "is not a name; use ASCII letters"),
    "name is a number": (MASS | {"params": ["m", "d", "k", 3]}, "params: 3 is not a name"),
    "newline in a name": (MASS | {"params": ["m", "d", "k", "z\n"]}, r"'z\\n' is not a name"),
    "text for a list": (MASS | {"states": "x, v"}, "states: expected a list of names, such as"),
    "list for a mapping": (
        MASS | {"outputs": ["x"]},
        "outputs: expected a mapping of name to form",
    ),
    "text for a mapping": (MASS | {"equations": "x' = v"}, "equations: expected a mapping"),
    "formula is a list": (MASS | {"outputs": {"y": ["x"]}}, r"outputs\.y: expected text, got list"),
    "formula is true": (MASS | {"outputs": {"y": True}}, r"outputs\.y: expected text, got bool"),
    "formula is nothing": (MASS | {"outputs": {"y": None}}, r"outputs\.y: expected text"),
    "formula is infinite": (MASS | {"outputs": {"y": float("inf")}}, "write a finite number"),
    "formula is too large": (MASS | {"outputs": {"y": 10**400}}, "write a finite number"),
    "formula is empty": (MASS | {"outputs": {"y": ""}}, r"outputs\.y: .*but the formula ends"),
    "no outputs": (without("outputs"), "nothing is measured; add what the sensors give"),
    "empty outputs": (MASS | {"outputs": {}}, "nothing is measured; add what the sensors give"),
    "division by zero": (
        MASS | {"outputs": {"y": "x/0"}},
        r"outputs\.y: .*division by zero; remove",
    ),
    "division by a zero definition": (
        MASS | {"definitions": {"a": "0", "b": "2*a"}, "outputs": {"y": "x/b"}},
        r"outputs\.y: .*division by zero; remove",
    ),
    "division by a zero constant": (
        MASS | {"known_constants": {"a": 0.0}, "outputs": {"y": "x/a"}},
        "division by zero; remove",
    ),
    "division by what cancels": (
        MASS | {"outputs": {"z": "x", "y": "x/(v - v)"}},
        r"outputs\.y: division by zero.*correct the denominator",
    ),
    "definition without value": (
        MASS | {"definitions": {"a": "1/(x - x)"}},
        r"definitions\.a: division by zero.*correct the denominator",
    ),
    "known initial value of no state": (
        MASS | {"known_initial": ["z"]},
        "'z' is no state; known are",
    ),
    "point of no parameter": (
        MASS | {"parameters_at": {"D": 0}},
        "parameters_at: 'D' is no parameter; did you mean 'd'",
    ),
    "value is text": (
        MASS | {"known_initial": {"x": "two"}},
        r"known_initial\.x: .*no finite number",
    ),
    "value is a pole": (MASS | {"known_initial": {"x": "1/0"}}, r"no finite number; write 0\.5"),
    "value is huge": (MASS | {"known_initial": {"x": 10**400}}, "no finite number"),
    "value is true": (MASS | {"known_initial": {"x": True}}, "no finite number"),
    "value is nan": (MASS | {"known_initial": {"x": float("nan")}}, "no finite number"),
    "value in scientific text": (
        MASS | {"known_initial": {"x": "1e999999999"}},
        "no finite number",
    ),
    "misspelt field": (
        without("outputs") | {"ouputs": {"y": "x"}},
        "'ouputs'; did you mean 'outputs'",
    ),
    "singular field": (without("states") | {"state": ["x"]}, "'state'; did you mean 'states'"),
    "short field": (without("params") | {"param": ["m"]}, "'param'; did you mean 'params'"),
    "capital field": (without("states") | {"States": ["x"]}, "'States'; did you mean 'states'"),
    "another tool's field": (
        without("equations") | {"odes": {}},
        "'odes'; did you mean 'equations'",
    ),
    "another word": (MASS | {"constants": ["g"]}, "'constants'; did you mean 'known_constants'"),
    "synonyms": (MASS | {"inputs": ["F"]}, "'inputs' and its synonym are both given; keep one"),
    "name is a list": (MASS | {"name": ["mass"]}, "name: expected text, got list"),
    "unit is a number": (MASS | {"units": {"x": 1}}, "units, x: expected text"),
    "data sets in data sets": (MASS | {"data_sets": [{"data_sets": [{}]}]}, "put all in one list"),
    "no data sets": (MASS | {"data_sets": []}, "data_sets: expected a list of mappings"),
    "data set is a list": (MASS | {"data_sets": [[1]]}, "data set 1: expected a mapping of fields"),
    "data sets of one name": (
        MASS | {"data_sets": [{"name": "a"}, {"name": "a"}]},
        "data set 2, name: 'a' is taken; give each data set its own",
    ),
    "fault in a data set": (
        MASS | {"data_sets": [{}, {"outputs": {"y": "w"}}]},
        r"data set 2, outputs\.y: 'w' is not declared",
    ),
    "not a mapping": ([MASS], r"expected a mapping of fields \(states, params"),
}


@pytest.mark.parametrize("fault", MALFORMED)
def test_contradictions_are_refused_with_their_place_and_mend(fault):
    mapping, message = MALFORMED[fault]
    with pytest.raises(ModelError, match=message) as caught:
        parse_systems(mapping, name="mass", where="mass.json")
    assert str(caught.value).startswith("mass.json")


@pytest.mark.parametrize(
    ("name", "text", "error", "message"),
    [
        (
            "a.json",
            '{"states": ["x"],\n "params" ["m"]}',
            DataError,
            r"line 2, column 11: not JSON",
        ),
        ("a.json", '{"states": ["x",]}', DataError, "line 1.*none at the end"),
        ("a.json", "", DataError, "line 1, column 1: not JSON"),
        ("a.json", "[" * 200_000, DataError, "nested too deep"),
        ("a.json", '{"x": ' + "9" * 10_000 + "}", DataError, "a number of too many digits"),
        ("a.json", '{"outputs": {"y": NaN}}', ModelError, "a.json: NaN is no number"),
        (
            "a.json",
            '{"equations": {"x": "1", "x": "2"}}',
            ModelError,
            "'x' occurs twice.*remove one",
        ),
        ("a.json", "[1, 2]", ModelError, "a.json: expected a mapping of fields"),
        ("a.toml", 'states = ["x"]\nparams = m', DataError, "not TOML .*line 2.*in quotes"),
        ("a.toml", 'a = "1"\na = "2"', DataError, "not TOML .*each key once"),
        ("a.toml", "a = " + "[" * 200_000, DataError, "not TOML|nested too deep"),
        ("a.toml", "states = 2026-01-01", ModelError, "a.toml, states: expected a list"),
        ("a.py", "states = ['x']", DataError, "read from .json or .toml; rename or convert"),
        ("a.json", '{"description": 1}', ModelError, "a.json, description: expected text"),
    ],
)
def test_files_that_are_no_equation_files_are_refused(tmp_path, name, text, error, message):
    with pytest.raises(error, match=message):
        read_equations(written(tmp_path, text, name))


def test_absent_files_name_the_nearest(tmp_path):
    written(tmp_path, "{}", "pendulum.json")
    with pytest.raises(DataError, match=r"no such equation file; did you mean 'pendulum.json'"):
        read_equations(tmp_path / "pendulun.json")


def test_a_file_too_large_is_refused_before_it_is_parsed(tmp_path):
    with pytest.raises(DataError, match="larger than 5 MB.*give a mapping to parse_systems"):
        read_equations(written(tmp_path, " " * (MAX_BYTES + 1)))


def test_a_file_in_another_encoding_names_the_line(tmp_path):
    path = tmp_path / "a.json"
    path.write_bytes(b'{"states": [],\n "name": "\xe9"}')
    with pytest.raises(DataError, match="line 2: not UTF-8; save it"):
        read_equations(path)


# -- attempts to break in ------------------------------------------------------------------------

ATTACKS = {
    "import": "__import__('os').system('touch broken_in')",
    "import without quotes": "__import__(os)",
    "attribute": "x.__class__.__bases__",
    "attribute of a number": "(1).__class__",
    "subscript": "x[0]",
    "lambda": "(lambda: 1)()",
    "f-string": "f'{x}'",
    "walrus": "(y := 1)",
    "statement": "x; import os",
    "comprehension": "[i for i in (1, 2)]",
    "dunder": "__builtins__",
    "eval": "eval(x)",
    "exec": "exec('open(1)')",
    "open": "open(x)",
    "sympy": "Symbol('x')",
    "sympy function": "Function(x)",
    "sympy singleton": "S(x)",
    "sympy lambda": "Lambda(x, x)",
    "sympy integral": "Integral(x)",
    "shell": "`ls`",
    "dollar": "${x}",
    "percent": "x % 2",
    "comparison": "x == 1",
    "comment": "x # y",
    "string": "'x'",
    "full-width letter": "\uff58 + 1",
    "Greek letter": "\u03bb*x",
    "combining accent": "x\u0301",
    "no-break space": "x\u00a0+ 1",
    "right-to-left mark": "x \u202e+ 1",
    "Arabic digit": "x + \u0663",
    "superscript": "x\u00b2",
    "null byte": "x\x00",
    "line separator": "x\u2028+ 1",
    "tower": "9**9**9",
    "tower of a state": "x**9**9",
    "tower in pow": "pow(9, pow(9, 9))",
    "huge number": "1e999",
    "many digits": "x**" + "9" * 400,
    "nesting": "(" * 5000 + "x" + ")" * 5000,
    "signs": "-" * 5000 + "x",
    "powers": "**".join(["x"] * 5000),
    "length": "x" + " + x" * 100_000,
    "implicit product": "2x",
    "underscored number": "1_000*x",
    "complex": "1j*x",
    "hexadecimal": "0x10*x",
}


@pytest.mark.parametrize("field", ["equations", "outputs", "definitions"])
@pytest.mark.parametrize("attack", ATTACKS)
def test_text_never_becomes_code(attack, field, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fields = {"states": ["x"], "equations": {"x": "-x"}, "outputs": {"y": "x"}}
    key = {"equations": "x", "outputs": "y", "definitions": "a"}[field]
    path = written(tmp_path, json.dumps(fields | {field: {key: ATTACKS[attack]}}))
    with pytest.raises(ModelError, match=rf"^model\.json, {field}\.{key}: ") as caught:
        read_equations(path)
    assert len(str(caught.value)) < 600
    assert os.listdir(tmp_path) == ["model.json"]


@pytest.mark.parametrize(
    "name", ["__import__('os')", "x;y", "x.y", "", "x\x00", "\uff58", "1x", "x y"]
)
def test_names_are_never_more_than_names(name):
    for field in ("states", "params", "known_inputs", "unknown_inputs", "known_constants"):
        with pytest.raises(ModelError, match=f"{field}: .* is not a name; use ASCII letters"):
            parse_system({field: [name], "outputs": {"y": "1"}})
    for field in ("definitions", "outputs", "equations", "parameters_at", "known_initial"):
        with pytest.raises(ModelError, match=f"{field}: .* is not a name; use ASCII letters"):
            parse_system({"outputs": {"y": "1"}} | {field: {name: "1"}})


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.just("x"),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4) | st.just("x"), inner)
    ),
    max_leaves=6,
)


@pytest.mark.slow
@given(
    st.dictionaries(
        st.sampled_from(
            "states params known_inputs unknown_inputs known_constants definitions equations "
            "outputs known_initial parameters_at units data_sets name description x".split()
        ),
        json_values,
    )
)
def test_any_mapping_gives_systems_or_a_model_error(mapping):
    said = "mapping: understood"
    try:
        systems = parse_systems(MASS | mapping, where="mapping")
        assert all(isinstance(s, System) for s in systems)
    except ModelError as error:  # and no other
        said = str(error)
    assert said.startswith("mapping")
