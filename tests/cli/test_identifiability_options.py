"""`casid identifiability`: its JSON is the contract's, its options mean what they say."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from casid.cli.main import main
from tests.cli.test_main import process
from tests.support.shared import shared

HEAD = """\
name = "plant"
states = ["x"]
params = ["a"]
known_inputs = ["u"]
"""

MIXING = """\
name = "mixing"
states = ["x1", "x2", "x3"]
params = ["p1", "p2", "p3", "p4"]
known_inputs = ["u"]

[equations]
x1 = "-p1*x1 + p2*u"
x2 = "-p3*x2 + p4*u"
x3 = "-(p1 + p3)*x3 + (p4*x1 + p2*x2)*u"

[outputs]
y = "x3"
"""

TWO_MASSES = """\
name = "two masses"
states = ["v"]
params = ["m", "d"]
unknown_inputs = ["w"]

[[data_sets]]
name = "bare"
equations = { v = "(w - d*v)/m" }
outputs = { speed = "v", acceleration = "(w - d*v)/m" }

[[data_sets]]
name = "loaded"
known_constants = ["dm"]
equations = { v = "(w - d*v)/(m + dm)" }
outputs = { speed = "v", acceleration = "(w - d*v)/(m + dm)" }
"""

MASS = '''\
import numpy as np
import casid

m = casid.Model("mass on a spring")
x, v = m.state("x", "m", initial=0.0), m.state("v", "m/s", initial=0.0)
F = m.input("force", "N", hold="zoh")
M = m.parameter("m", "kg", start=1.5, lower=0.1, upper=20)
d = m.parameter("d", "N s/m", start=1.0, lower=0.0, upper=50)
k = m.parameter("k", "N/m", start=40.0, lower=1.0, upper=500)
c = m.parameter("c", "1", value=1.0)
m.derivative(x, v)
m.balance(v, "force", inertia=M, terms=[-k * x, -d * v, c * F])
m.output("position", x, "m")


def example():
    """Semi-implicit Euler steps of the same mass under a random force."""
    rng = np.random.default_rng(1)
    force, position = rng.standard_normal(300), np.zeros(300)
    x = v = 0.0
    for i in range(299):
        v += 0.02 * (force[i] - 40 * x - v) / 1.5
        x += 0.02 * v
        position[i + 1] = x
    position += 1e-4 * rng.standard_normal(300)
    channels = {"force": force, "position": position}
    record = casid.Record(channels, {"force": "N", "position": "m"}, Ts=0.02, name="run")
    return [casid.Experiment(record)]


problem = casid.Problem("mass", m, starts=1, example=example)
'''


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with equations of each kind and a problem with records of its own."""
    monkeypatch.chdir(tmp_path)
    Path("mixing.toml").write_text(MIXING)
    Path("two.toml").write_text(TWO_MASSES)
    Path("mass.py").write_text(MASS)
    return tmp_path


def ask(*arguments: str) -> Result:
    result = CliRunner().invoke(main, ["identifiability", *arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception  # a traceback: a fault of casid
    return result


def answer(*arguments: str) -> dict[str, Any]:
    """The JSON on standard output, with nothing beside it anywhere."""
    result = ask(*arguments, "--json", "--quiet")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(result.stdout, parse_constant=refuse)


def told(content: dict[str, Any]) -> set[str]:
    return {p for p, v in content["parameters"].items() if v == "identifiable"}


def refused(result: Result, *words: str) -> str:
    """The one message of a refusal, which names `words`; no traceback, no folder."""
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.count("error: ") == 1
    message = result.stderr[result.stderr.index("error: ") :]
    assert "Traceback" not in message
    for word in words:
        assert word in message
    assert not Path("reports").exists()
    return message


# -- what it prints --------------------------------------------------------------------------------


def assert_contract(content: dict[str, Any]) -> None:
    """The fields that users' programs read, with their types."""
    assert content["schema"] == "casid.identifiability/1"
    for field in ("rank", "unknowns"):
        assert type(content[field]) is int
    assert content["error_bound"] is None or 0.0 <= content["error_bound"] <= 1e-12
    assert type(content["partial"]) is bool
    verdicts = {"identifiable", "not_identifiable", "unknown"}
    assert set(content["parameters"].values()) <= verdicts
    assert set(content["states"].values()) <= {"observable", "not_observable", "unknown"}
    for field in ("confounded_groups", "minimal_fixing_sets"):
        assert all(isinstance(n, str) for group in content[field] for n in group)
    inputs = content["unknown_inputs"]
    assert inputs["class"] in {"none", "arbitrary"}
    for row in inputs["verdict_by_class"].values():
        assert set(row["parameters"].values()) <= verdicts
        assert row["rank"] is None or row["rank"] <= row["unknowns"]
    assert math.isfinite(content["seconds"])
    assert content["seconds"] > 0


@pytest.mark.parametrize("arguments", ["mixing.toml", "two.toml", "mass.py"])
def test_the_json_has_the_fields_of_the_contract(arguments, here):
    assert_contract(answer(arguments))
    assert_contract(answer(arguments, "--structural"))


def test_the_json_says_of_a_product_that_its_factors_are_not_told(here):
    content = answer("mixing.toml")
    assert (content["rank"], content["unknowns"]) == (6, 7)
    assert content["parameters"] == {
        "p1": "identifiable",
        "p2": "not_identifiable",
        "p3": "identifiable",
        "p4": "not_identifiable",
    }
    assert content["states"] == {
        "x1": "not_observable",
        "x2": "not_observable",
        "x3": "observable",
    }
    assert content["confounded_groups"] == [["p2", "p4"]]
    assert content["minimal_fixing_sets"] == [["p2"], ["p4"]]
    assert content["unknown_inputs"]["class"] == "none"
    assert content["partial"] is False


def test_unknown_inputs_have_a_row_for_every_class(here):
    inputs = answer("two.toml")["unknown_inputs"]
    assert inputs["class"] == "arbitrary"
    assert inputs["names"] == ["w"]
    assert {"arbitrary", "polynomial_0", "polynomial_1"} <= set(inputs["verdict_by_class"])
    polynomial = inputs["verdict_by_class"]["polynomial_1"]
    assert (polynomial["rank"], polynomial["unknowns"]) == (8, 8)  # two coefficients a data set


def test_standard_output_of_the_process_is_json_and_nothing_else(here):
    done = process("identifiability", "mixing.toml", "--json", cwd=here)
    assert done.returncode == 0, done.stderr
    assert_contract(json.loads(done.stdout))
    assert "wrote" in done.stderr


def test_both_files_are_written_and_hold_what_is_printed(here):
    content = answer("mixing.toml")
    folder = Path("reports/mixing-1")
    assert sorted(p.name for p in folder.iterdir()) == ["identifiability.json", "report.html"]
    assert json.loads((folder / "identifiability.json").read_text()) == content
    assert "<html" in (folder / "report.html").read_text()
    answer("mixing.toml")
    assert Path("reports/mixing-2").is_dir()


def test_without_json_the_answer_is_text(here):
    result = ask("mixing.toml", "--out", "found")
    assert result.exit_code == 0
    assert result.stdout.startswith("Identifiability of mixing: rank 6 of 7\n")
    assert "structurally unidentifiable: p2, p4" in result.stdout
    assert "p2*p4" in result.stdout
    assert "wrote found" in result.stderr


def test_a_full_folder_is_used_again_only_by_force(here):
    Path("found").mkdir()
    assert ask("mixing.toml", "--out", "found").exit_code == 0  # an empty one is accepted
    refused(ask("mixing.toml", "--out", "found"), "found is not empty", "--force")
    assert ask("mixing.toml", "--out", "found", "--force").exit_code == 0


def test_json_equations_and_toml_equations_are_one_thing(here):
    Path("mixing.json").write_text(json.dumps(tomllib.loads(MIXING)))
    timed = {"seconds": 0}
    assert answer("mixing.json") | timed == answer("mixing.toml") | timed


# -- options ---------------------------------------------------------------------------------------


def test_replicas_tell_more_of_a_compartment_model(here):
    path = str(shared("identifiability/me_cyclic5.json"))
    counts = [answer(path, "--structural", "--replicas", str(n)) for n in (1, 2, 3)]
    assert [c["deficiency"] for c in counts] == [7, 2, 0]
    assert [len(c["experiments"]) for c in counts] == [1, 2, 3]


def test_a_shared_input_is_assumed_only_where_it_is_said(here):
    own = answer("two.toml", "--structural")
    assert told(own) == set()
    assert any("its own unknown inputs" in note for note in own["notes"])
    both = answer("two.toml", "--structural", "--shared-input", "w")
    assert told(both) == {"m", "d"}
    assert both["unknown_inputs"]["shared"] == ["w"]
    assert any("share w" in note for note in both["notes"])


def test_known_initial_states_are_no_unknowns_and_one_may_have_a_special_value(here):
    free = answer("mixing.toml", "--structural")
    known = answer("mixing.toml", "--structural", "--known-initial", "x1,x2=0")
    assert known["unknowns"] == free["unknowns"] - 2
    assert any("special values of x2" in note for note in known["notes"])
    assert told(known) == {"p1", "p2", "p3", "p4"}  # x1(0) known: p2 and p4 have a scale
    rest = answer("mixing.toml", "--structural", "--known-initial", "x1=0,x2=0")
    assert told(rest) == {"p1", "p3"}  # from rest they may still be traded


def test_known_parameters_are_no_unknowns_and_mend_their_group(here):
    content = answer("mixing.toml", "--structural", "--known", "p2,p1")
    assert content["parameters"] == {"p3": "identifiable", "p4": "identifiable"}
    assert content["unknowns"] == 5


def test_set_gives_a_parameter_of_the_equations_its_value(here):
    content = answer("mixing.toml", "--structural", "--set", "p2=2.5")
    assert told(content) == {"p1", "p3", "p4"}
    nothing = answer("mixing.toml", "--structural", "--set", "p2=0")
    assert "p4" not in told(nothing)  # it stands in the product p4 x1 alone


def test_at_asks_about_one_point_and_not_about_almost_every_value(here):
    Path("gain.toml").write_text(
        'name = "gain"\nstates = ["x"]\nparams = ["a", "c"]\ninputs = ["u"]\n'
        'equations = { x = "u - a*x" }\noutputs = { y = "c*x" }\n'
    )
    assert told(answer("gain.toml", "--structural")) == {"a", "c"}
    there = answer("gain.toml", "--structural", "--at", "c=0")
    assert "a" not in told(there)
    assert any("special values of c" in note for note in there["notes"])


def test_generic_looks_at_some_known_value_and_not_at_the_models_own(here):
    """Where c = 1 happens to switch the force off, m, d and k have no scale; some other c does."""
    Path("off.py").write_text(MASS.replace("c * F", "(c - 1) * F").replace(", initial=0.0", ""))
    assert told(answer("off.py", "--structural")) == set()
    assert told(answer("off.py", "--structural", "--generic")) == {"m", "d", "k"}


def test_set_makes_a_parameter_of_a_problem_known(here):
    content = answer("mass.py", "--structural", "--set", "m=2")
    assert content["parameters"] == {"d": "identifiable", "k": "identifiable"}
    known = answer("mass.py", "--structural", "--known", "m")
    assert known["parameters"] == content["parameters"]


def test_sensors_are_weighed_by_their_cost(here):
    sensors = ("--sensor", "first=x1@3", "--sensor", "second = x2 @ 1.5", "--sensor", "same=x3@0")
    mends = answer("mixing.toml", "--structural", *sensors)["mends"]
    (cheapest,) = mends["cheapest"]
    assert cheapest["cost"] == 1.5
    assert "second" in json.dumps(cheapest)
    text = ask("mixing.toml", "--structural", *sensors).stdout
    assert "cheapest remedy: sensor second (cost 1.5)" in text


def test_structural_leaves_out_closed_forms_and_expected_errors(here):
    full, short = answer("mass.py"), answer("mass.py", "--structural")
    assert full["practical"] is not None
    assert short["practical"] is None
    assert short["excitation"] == []
    assert full["parameters"] == short["parameters"]
    assert answer("mixing.toml")["families"]
    assert answer("mixing.toml", "--structural")["families"] == []


def test_a_time_limit_returns_the_proven_part_and_says_that_it_is_partial(here):
    path = str(shared("identifiability/nfkb_full.json"))
    content = answer(path, "--time-limit", "1e-9")
    assert_contract(content)
    assert content["partial"] is True
    assert content["error_bound"] is None
    assert set(content["parameters"].values()) <= {"identifiable", "unknown"}
    assert "unknown" in content["parameters"].values()
    result = ask(path, "--time-limit", "1e-9", "--out", "partial")
    assert result.exit_code == 0
    assert "Time ran out" in result.stdout
    assert ">partial<" in Path("partial/report.html").read_text()


def test_profiles_are_computed_from_the_records(here):
    content = answer("mass.py", "--profile", "k", "--set", "m=1.5")
    (profile,) = content["profiles"]["profiles"]
    assert profile["name"] == "k"
    assert profile["lower"] < profile["best"] < profile["upper"]


def test_records_named_after_a_problem_say_what_moved(here):
    """A free decay tells the ratios of m, d and k: there is no force to scale them by."""
    t = 0.02 * np.arange(200)
    rows = "\n".join(f"{x:.2f},0,{math.exp(-x) * math.cos(4 * x):.6f}" for x in t)
    Path("still.csv").write_text("t,force,position\n" + rows + "\n")
    Path("free.py").write_text(MASS.replace(", initial=0.0", ""))
    content = answer("free.py", "still.csv", "--structural")
    assert content["confounded_groups"] == [["m", "d", "k"]]
    assert any("force is 0 in all samples" in note for note in content["notes"])


# -- refusals --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["run.csv"], ["DATA", "mixing.toml holds equations alone", "problem file (.py)"]),
        (["--lowpass", "3"], ["--lowpass", "leave it out"]),
        (["--detrend"], ["--detrend", "leave it out"]),
        (["--decimate", "2"], ["--decimate", "leave it out"]),
        (["--map", "y=roll"], ["--map", "leave --map out"]),
        (["--window", "0:3"], ["--window", "leave --window out"]),
        (["--profile", "p1"], ["profile", "p1", "records", "leave it out"]),
    ],
)
def test_equations_are_asked_without_records(options, words, here):
    refused(ask("mixing.toml", *options), *words)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--known", "p9"], ["p9", "p1, p2, p3, p4"]),
        (["--known-initial", "x7"], ["x7", "x1, x2, x3"]),
        (["--known-initial", "x1=a"], ["--known-initial x1=a", "name=value"]),
        (["--known-initial", "x1=inf"], ["--known-initial x1=inf", "finite number"]),
        (["--at", "p1"], ["--at p1", "name=value"]),
        (["--at", "q=1"], ["'q'", "p1, p2, p3, p4"]),
        (["--set", "q=1"], ["--set q=1", "p1, p2, p3, p4"]),
        (["--set", "p1=one"], ["--set p1=one", "name=value"]),
        (["--shared-input", "u"], ["shared input 'u'", "none is declared"]),
        (["--replicas", "0"], ["--replicas", "x>=1"]),
        (["--time-limit", "0"], ["--time-limit", "x>0"]),
        (["--sensor", "x1"], ["--sensor x1", "name=formula"]),
        (["--sensor", "a=q"], ["sensor a", "'q' is not declared", "x1"]),
        (["--sensor", "a=x1@dear"], ["--sensor a=x1@dear", "finite number"]),
        (["--sensor", "a=x1@-1"], ["sensor a", "-1", ">= 0"]),
        (["--sensor", "a=__import__('os').system('touch pwned')"], ["sensor a", "formula"]),
        (["--nonsense"], ["--nonsense", "--help"]),
    ],
)
def test_an_option_that_cannot_be_used_is_refused_with_its_mend(options, words, here):
    refused(ask("mixing.toml", *options), *words)
    assert not Path("pwned").exists()


BAD_EQUATIONS = {
    "an unknown symbol": (
        'equations = { x = "a*x + b*u" }\noutputs = { y = "x" }',
        ["equations.x", "'b' is not declared", "add it to params"],
    ),
    "an output of an undeclared input": (
        'equations = { x = "a*x" }\noutputs = { y = "x + w" }',
        ["outputs.y", "'w' is not declared", "unknown_inputs"],
    ),
    "a function that is unknown": (
        'equations = { x = "a*gamma(x)" }\noutputs = { y = "x" }',
        ["equations.x", "unknown function 'gamma'", "known are"],
    ),
    "a function without differential equations": (
        'equations = { x = "max(a*x, u)" }\noutputs = { y = "x" }',
        ["max", "neither rational nor", "each branch"],
    ),
    "division by zero": (
        'equations = { x = "a*x/(u - u)" }\noutputs = { y = "x" }',
        ["equations.x", "division by zero", "correct the denominator"],
    ),
    "division by a zero that no simplification shows": (
        'equations = { x = "a*x/((x + u)**2 - x**2 - 2*x*u - u**2)" }\noutputs = { y = "x" }',
        ["a denominator vanishes", "Look for a division"],
    ),
    "an algebraic loop": (
        'equations = { x = "a*p" }\noutputs = { y = "x" }\n'
        'definitions = { p = "q + 1", q = "p*x" }',
        ["algebraic loop p -> q -> p", "solve it for one of them"],
    ),
    "an output in a formula": (
        'equations = { x = "a*x" }\noutputs = { y = "2*y + x" }',
        ["outputs.y", "'y' is an output", "definitions"],
    ),
    "no outputs": (
        'equations = { x = "a*x" }',
        ["outputs: there is none", "add what the sensors give"],
    ),
    "no equation": ('outputs = { y = "x" }', ["state 'x' has none", "add its time derivative"]),
    "a huge exponent": (
        'equations = { x = "a*x**1e9" }\noutputs = { y = "x" }',
        ["equations.x", "exponent", "+-100"],
    ),
    "code": (
        "equations = { x = \"__import__('os').system('touch pwned')\" }\noutputs = { y = \"x\" }",
        ["equations.x", "character", "use ASCII letters"],
    ),
    "nesting": (
        f'equations = {{ x = "{"(" * 5000}x{")" * 5000}" }}\noutputs = {{ y = "x" }}',
        ["equations.x", "nested", "substitute it"],
    ),
    "half a file": ('equations = { x = "a*x"', ["not TOML", "line", "correct that line"]),
}


@pytest.mark.parametrize("what", BAD_EQUATIONS)
def test_equations_that_cannot_be_used_are_refused_by_place_and_mend(what, here):
    text, words = BAD_EQUATIONS[what]
    Path("plant.toml").write_text(HEAD + text + "\n")
    refused(ask("plant.toml"), "plant", *words)
    assert not Path("pwned").exists()


def test_a_file_that_is_absent_is_refused_with_the_nearest_one(here):
    refused(ask("mixin.toml"), "mixin.toml: no such equation file", "did you mean 'mixing.toml'")
    refused(ask("mas.py"), "mas.py")
    refused(ask(), "Missing argument", "PROBLEM|EQUATIONS")


def test_broken_json_is_refused_with_its_line(here):
    Path("broken.json").write_text('{"states": ["x"],\n "params": [a]}')
    refused(ask("broken.json"), "broken.json, line 2", "correct that line")


def test_profiles_of_what_is_not_unknown_are_refused(here):
    refused(ask("mass.py", "--profile", "q"), "'q'", "unknown are m, d, k")
    refused(ask("mass.py", "--profile", "k", "--structural"), "--profile", "--structural", "drop")


def test_out_that_is_a_file_is_refused(here):
    refused(ask("mixing.toml", "--out", "mass.py"), "mass.py is a file, not a folder", "--out")
