"""One call says of any model what can be told of it, and agrees with 26 models of known answers."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy

import casid
from casid import Assumptions
from casid.errors import CasidError, DataError, ModelError
from casid.report.texts.assessment import verdict_words
from problems import pendulum, ship
from tests.support.excited_models import TS, decay, integrator
from tests.support.shared import ROOT, shared

FOLDER = "identifiability"
MODELS = (
    "akt_fujita bilirubin c2m_w_b cgv1990 crauste crn dof2_F2 goodwin hdnl hiv_eta_unknown "
    "hiv_wodarz jakstat kd1999 leukaemia llw mapk6 me_catenary5 me_cyclic5 nfkb_full pharm qy "
    "related_massdamper seaijrc si_issue419 si_issue503 siwr1"
).split()

SPRING = """\
name = "spring"
states = ["x", "v"]
params = ["m", "d", "k"]
inputs = ["F"]

[equations]
x = "v"
v = "(F - d*v - k*x)/m"

[outputs]
y = "x"
"""


def told(assessment: casid.Assessment) -> set[str]:
    return {p for p, v in assessment.parameters.items() if v == "identifiable"}


def lost(assessment: casid.Assessment) -> set[str]:
    return {p for p, v in assessment.parameters.items() if v == "not_identifiable"}


def structural(subject: Any, experiments: Any = None, **options: Any) -> casid.Assessment:
    return casid.assess_identifiability(
        subject, experiments, **{"symbolic": False, "practical": False, **options}
    )


# -- whatever names a model ------------------------------------------------------------------------


def spring() -> casid.Model:
    m = casid.Model("spring")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N")
    mass, d = m.parameter("m", "kg", start=1.0), m.parameter("d", "N s/m", start=1.0)
    k = m.parameter("k", "N/m", start=1.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[F, -d * v, -k * x])
    m.output("y", x, "m")
    return m


def subjects(folder: Path) -> dict[str, Any]:
    import tomllib

    (folder / "spring.toml").write_text(SPRING)
    fields = tomllib.loads(SPRING)
    (folder / "spring.json").write_text(json.dumps(fields))
    system = casid.parse_system(fields)
    return {
        "a path": folder / "spring.toml",
        "a path as text": str(folder / "spring.json"),
        "an equation file": casid.read_equations(folder / "spring.json"),
        "a system": system,
        "a sequence of systems": [system],
        "a model": spring(),
        "a problem": casid.Problem("spring", spring()),
    }


def test_equations_a_system_a_model_and_a_problem_have_one_answer(tmp_path):
    """The equations decide, not who hands them over; a force on a spring tells m, d and k."""
    for what, subject in subjects(tmp_path).items():
        a = structural(subject)
        assert (a.rank, a.unknowns) == (5, 5), what
        assert a.name == "spring", what
        assert a.is_identifiable, what
        assert a.answer.error_bound == 0.0, what
        assert dict(a.states) == {"x": "observable", "v": "observable"}, what


def test_a_problem_file_is_the_problem_it_holds():
    path = structural(ROOT / "problems" / "pendulum.py")
    held = structural(pendulum.problem)
    assert path.to_json() | {"seconds": 0} == held.to_json() | {"seconds": 0}
    assert told(path) == {"k", "d", "I_x"}


def test_a_problem_without_records_is_asked_about_in_its_load_cases():
    """With no record at all, three load cases decide the ship as its three records do."""
    import dataclasses

    bare = dataclasses.replace(
        ship.nine_parameters(), example=None, simulate=None, load_cases=dict(ship.LOAD_CASES)
    )
    cases = {k: v for k, v in ship.LOAD_CASES.items() if k != "second calibration"}
    a = structural(dataclasses.replace(bare, load_cases=cases))
    assert a.experiments == ("nominal", "calibration", "loaded")
    assert (a.rank, a.unknowns) == (14, 15)
    mended = structural(bare)  # a second calibration weight at another height
    assert mended.is_identifiable


@pytest.mark.parametrize("stranger", [3, None, [], ["x"], {"states": ["x"]}])
def test_what_is_no_model_is_refused(stranger):
    with pytest.raises(ModelError, match="give a problem, a model, the path"):
        structural(stranger)


def test_a_file_that_is_absent_is_refused_with_the_nearest_one(tmp_path):
    subjects(tmp_path)
    with pytest.raises(DataError, match=r"no such equation file.*spring\.toml"):
        structural(tmp_path / "sprong.toml")
    with pytest.raises(CasidError, match="sprong"):
        structural(tmp_path / "sprong.py")


@pytest.mark.parametrize(
    ("assuming", "words"),
    [
        (Assumptions(known=["mm"]), "known parameter 'mm'"),
        (Assumptions(known_initial=["y"]), "known initial value 'y'"),
        (Assumptions(at={"kk": 0.0}), "'kk'.*did you mean 'k'"),
        (Assumptions(shared_inputs=["F"]), "shared input 'F'"),
    ],
)
def test_an_assumption_about_a_stranger_is_refused(assuming, words, tmp_path):
    with pytest.raises(ModelError, match=words):
        structural(subjects(tmp_path)["a system"], assuming=assuming)


# -- 26 models with known answers ------------------------------------------------------------------


@cache
def assessed(name: str) -> casid.Assessment:
    return structural(shared(f"{FOLDER}/{name}.json"))


def expected(name: str) -> dict[str, Any]:
    return json.loads(shared(f"{FOLDER}/{name}.json").read_text())["expected"]


COMPARED = {
    *("rank", "unknowns", "locally_identifiable", "non_identifiable", "observable_states"),
    *("unobservable_states", "parameter_deficiency", "confounded_groups", "example_fixing_set"),
    *("number_of_minimal_fixing_sets", "if_unknown_input_is_polynomial_of_degree"),
    *("replicates_needed", "parameter_deficiency_by_number_of_replicates"),  # their own test
    *("own_force_per_data_set", "same_force_in_both", "with_known_generic_ic"),  # their own tests
}
COMMENTS = {"computed_by", "cross_check", "published", "assumption"}


def test_the_models_are_those_of_the_folder_and_every_answer_is_compared():
    assert sorted(p.stem for p in shared(FOLDER).glob("*.json")) == sorted(MODELS)
    for name in MODELS:
        assert set(expected(name)) <= COMPARED | COMMENTS, name


@pytest.mark.parametrize("name", MODELS)
def test_rank_verdicts_groups_and_fixing_sets_are_the_known_ones(name):
    """Sources: the files' own, SIAN, StructuralIdentifiability.jl, STRIKE-GOLDD."""
    e, a = expected(name), assessed(name)
    for field in ("rank", "unknowns"):
        if e.get(field) is not None:
            assert getattr(a, field) == e[field]
    if "locally_identifiable" in e:
        assert told(a) == set(e["locally_identifiable"])
    if "non_identifiable" in e:
        assert lost(a) == set(e["non_identifiable"])
    seen = {x for x, v in a.states.items() if v == "observable"}
    if "observable_states" in e:
        assert seen == set(e["observable_states"])
    if "unobservable_states" in e:
        assert set(a.states) - seen == set(e["unobservable_states"])
    if "parameter_deficiency" in e:
        assert a.answer.deficiency == e["parameter_deficiency"]
    if "confounded_groups" in e:
        assert {frozenset(g) for g in a.confounded_groups} == {
            frozenset(g) for g in e["confounded_groups"]
        }
    assert a.fixing is not None
    if e.get("number_of_minimal_fixing_sets") is not None:
        assert a.fixing.count == len(a.fixing.sets) == e["number_of_minimal_fixing_sets"]
        assert frozenset(e["example_fixing_set"]) in {frozenset(s) for s in a.fixing.sets}
    elif not lost(a):
        assert a.fixing.sets == ((),)  # nothing has to be known
        assert a.remedy() == ""
    assert a.answer.error_bound <= 1e-12
    assert (a.answer.error_bound == 0.0) == (a.rank == a.unknowns)


@pytest.mark.parametrize("name", ["c2m_w_b", "dof2_F2", "hiv_eta_unknown"])
def test_the_class_of_the_unknown_input_changes_the_verdict(name):
    """Ranks and unknowns of a polynomial count its coefficients."""
    classes = expected(name)["if_unknown_input_is_polynomial_of_degree"]
    a = assessed(name)
    assert {f"polynomial_{k}" for k in classes} <= set(a.by_class)
    for degree, e in classes.items():
        answer = a.by_class[f"polynomial_{degree}"]
        assert (answer.rank, answer.unknowns) == (e["rank"], e["unknowns"])
        assert set(answer.not_identifiable) == set(e["non_identifiable"])
        unseen = {x for x, v in answer.states.items() if v == "not_observable"}
        assert unseen == set(e["unobservable_states"])
        assert set(answer.states) == set(a.states)  # those of the input are not listed
    arbitrary = a.by_class["arbitrary"]
    assert dict(arbitrary.parameters) == dict(a.parameters)
    assert (arbitrary.rank, arbitrary.unknowns) == (a.rank, a.unknowns)
    assert a.eliminated
    assert a.eliminated[0] in str(a).replace("\n", " ").replace("                ", "")


@pytest.mark.parametrize("name", ["me_catenary5", "me_cyclic5"])
def test_repeated_experiments_tell_what_one_cannot(name):
    """A catenary takes five, a cycle three (Ovchinnikov, Pillay, Pogudin, Scanlon 2022)."""
    e, a = expected(name), assessed(name)
    assert a.replicas is not None
    assert a.replicas.needed == e["replicates_needed"]
    for count, deficiency in enumerate(e["parameter_deficiency_by_number_of_replicates"], 1):
        assert a.replicas.deficiency(count) == deficiency
    n = e["replicates_needed"]
    path = shared(f"{FOLDER}/{name}.json")
    assert structural(path, assuming=Assumptions(replicas=n)).is_identifiable
    fewer = structural(path, assuming=Assumptions(replicas=n - 1))
    assert fewer.answer.deficiency == a.replicas.deficiency(n - 1) > 0


def test_two_data_sets_share_a_force_only_where_that_is_said():
    """m v' = w - d v: two unknown forces absorb everything, one force moves two masses apart."""
    path = shared(f"{FOLDER}/related_massdamper.json")
    own = structural(path)
    assert lost(own) == {"m", "d"}
    assert (own.rank, own.unknowns) == (2, 4)
    assert "each experiment has its own unknown inputs" in str(own)
    assert own.to_json()["unknown_inputs"]["shared"] == []

    both = structural(path, assuming=Assumptions(shared_inputs=["w"]))
    assert told(both) == {"m", "d"}
    assert (both.rank, both.unknowns) == (4, 4)
    assert "all experiments share w" in str(both)
    assert both.to_json()["unknown_inputs"]["shared"] == ["w"]


def test_known_initial_states_count_no_more_and_may_tell_parameters():
    """Issue 503 of StructuralIdentifiability.jl: one known state tells nothing, all four do."""
    path = shared(f"{FOLDER}/si_issue503.json")
    one = structural(path, assuming=Assumptions(known_initial=["x1"]))
    assert (one.rank, one.unknowns, len(lost(one))) == (8, 10, 7)
    every = structural(path, assuming=Assumptions(known_initial=["x1", "x2", "x3", "x4"]))
    assert (every.rank, every.unknowns) == (7, 7)
    assert every.is_identifiable


def test_a_special_initial_value_tells_less_than_a_known_one():
    """x' = a x tells a from any start but 0, where it stays."""
    fields = {"states": ["x"], "params": ["a"], "equations": {"x": "a*x"}, "outputs": {"y": "x"}}
    system = casid.parse_system(fields)
    some = structural(system, assuming=Assumptions(known_initial=["x"]))
    assert told(some) == {"a"}
    rest = structural(system, assuming=Assumptions(known_initial={"x": 0.0}))
    assert lost(rest) == {"a"}
    assert "special values of x" in str(rest)


def test_a_special_initial_value_is_followed_past_a_stall():
    """S' = 1 + a S^2 from S(0) = 0: a first shows in the third derivative, after a stall."""
    fields = {
        "states": ["S"],
        "params": ["a"],
        "equations": {"S": "1 + a*S**2"},
        "outputs": {"y": "S"},
        "known_initial": {"S": 0},
    }
    assert told(structural(casid.parse_system(fields))) == {"a"}


def test_a_special_value_of_a_parameter_is_asked_about_at_that_point():
    """y = c x, x' = -a x + u: both are told at almost every point, and no a where c is 0."""
    fields = {
        "states": ["x"],
        "params": ["a", "c"],
        "known_inputs": ["u"],
        "equations": {"x": "-a*x + u"},
        "outputs": {"y": "c*x"},
    }
    system = casid.parse_system(fields)
    assert told(structural(system)) == {"a", "c"}
    there = structural(system, assuming=Assumptions(at={"c": 0.0}))
    assert "a" in lost(there)


# -- families --------------------------------------------------------------------------------------


def invariants(assessment: casid.Assessment) -> list[Any]:
    return [i for f in assessment.families for i in f.invariants]


N, delta, rho, p2, p4 = sympy.symbols("N delta rho p2 p4")


def is_function_of(goal: Any, found: list[Any]) -> bool:
    """True if the gradient of `goal` is a combination of those of `found`, at a random point."""
    names = sorted({s for i in (*found, goal) for s in i.free_symbols}, key=str)
    point = {s: sympy.Rational(k, 7) for k, s in enumerate(names, 3)}
    rows = [[sympy.diff(i, s).subs(point) for s in names] for i in (*found, goal)]
    return sympy.Matrix(rows).rank() == sympy.Matrix(rows[:-1]).rank() == len(found)


@pytest.mark.parametrize(
    ("name", "wanted"),
    [("hiv_eta_unknown", (delta - rho) / (N * delta)), ("llw", p2 * p4)],
)
def test_what_is_told_of_a_confounded_pair_is_the_known_combination(name, wanted):
    a = casid.assess_identifiability(shared(f"{FOLDER}/{name}.json"))
    (family,) = a.families
    assert family.is_closed
    (found,) = invariants(a)
    alone = [sympy.Symbol(n) for n in told(a)]
    assert is_function_of(wanted, [found, *alone])
    assert not is_function_of(wanted, alone)
    assert f"invariants: {found}" in str(a)
    assert a.to_json()["families"][0]["invariants"] == [str(found)]


TOGETHER = {
    "akt_fujita": {"reaction_1_k2 + reaction_9_k1 - reaction_1_k1"},
    "hiv_wodarz": {"beta*k*lm", "c*lm**2", "q/lm"},
    "kd1999": {"UA/DH", "cp*ro/DH", "cph*roh/DH"},
}


@pytest.mark.parametrize("name", TOGETHER)
def test_what_is_told_of_a_group_that_moves_along_several_curves_stays_along_all(name):
    """k lm of hiv_wodarz stays where lm moves, and changes where beta does: it is not told."""
    a = casid.assess_identifiability(shared(f"{FOLDER}/{name}.json"))
    (told_of,) = [
        t for t in a.identifiable_combinations if sum(f.free in t.group for f in a.families) > 1
    ]
    assert told_of.is_complete
    names = {n: sympy.Symbol(n) for n in a.parameters}
    wanted = {sympy.sympify(text, locals=names) for text in TOGETHER[name]}
    assert set(told_of.combinations) == wanted
    for f in a.families:
        for c in wanted:
            slopes = [sympy.diff(c, names[n]) * v for n, v in f.direction.entries.items()]
            assert sympy.simplify(sum(slopes)) == 0
    text = " ".join(str(a).split())
    assert f"identifiable combinations of {', '.join(told_of.group)}: " in text
    assert "on this curve alone, unchanged: " in text
    content = a.to_json()["told_instead"]
    assert {tuple(t["group"]) for t in content} == {t.group for t in a.identifiable_combinations}


def test_a_combination_holds_along_the_curves_of_other_groups_as_well():
    """With w = (x1' + a x1)/b, x2' = -c x2 + (d + a e/b) x1 + e/b x1': a e + b d scales with b."""
    fields = {
        "states": ["x1", "x2"],
        "params": ["a", "b", "c", "d", "e"],
        "unknown_inputs": ["w"],
        "equations": {"x1": "-a*x1 + b*w", "x2": "-c*x2 + d*x1 + e*w"},
        "outputs": {"y1": "x1", "y2": "x2"},
    }
    found = casid.assess_identifiability(casid.parse_system(fields))
    assert found.confounded_groups == (("a", "d"), ("b", "e"))
    a, b, d, e = sympy.symbols("a b d e")
    of_group = {t.group: t for t in found.identifiable_combinations}
    (first,), (second,) = (of_group[g].combinations for g in found.confounded_groups)
    assert sympy.simplify(first - (d + a * e / b)) == 0
    assert second == e / b
    assert all(t.is_complete for t in of_group.values())
    text = " ".join(str(found).split())
    assert "on this curve alone, unchanged: a*e + b*d" in text
    assert f"identifiable combinations of a, d: {first}" in text
    assert "invariants: e/b" in text


def test_a_combination_that_another_group_moves_beyond_a_factor_is_not_shown():
    """w enters with b + f, and their ratio to the other gain cannot be a power of b and f."""
    fields = {
        "states": ["x1", "x2"],
        "params": ["a", "b", "c", "d", "e", "f"],
        "unknown_inputs": ["w"],
        "equations": {"x1": "-a*x1 + (b + f)*w", "x2": "-c*x2 + d*x1 + e*w"},
        "outputs": {"y1": "x1", "y2": "x2"},
    }
    found = casid.assess_identifiability(casid.parse_system(fields))
    for told in found.identifiable_combinations:
        for combination in told.combinations:
            for f in found.families:
                rates = f.direction.entries.items()
                slopes = [sympy.diff(combination, sympy.Symbol(n)) * v for n, v in rates]
                assert sympy.simplify(sum(slopes)) == 0
    complete = {t.group: t.is_complete for t in found.identifiable_combinations}
    assert complete == {("a", "d"): False, ("b", "e", "f"): True}


@pytest.mark.parametrize(
    ("equations", "wanted"),
    [
        ({"h": "(q - a*sqrt(2*g*h))/A"}, {"a**2*g"}),
        ({"h": "k*q - a1*sqrt(h)", "h2": "a2*sqrt(h) - a3*sqrt(h2)"}, {"a1*a2", "k/a1**2"}),
    ],
    ids=["one tank", "two tanks in series"],
)
def test_what_is_identifiable_of_tanks_that_empty_by_a_square_root_has_a_closed_form(
    equations, wanted
):
    """A square root exists at every second point of a prime field only."""
    last = list(equations)[-1]
    names = set().union(*(sympy.sympify(e).free_symbols for e in equations.values()))
    fields = {
        "states": list(equations),
        "params": sorted(str(n) for n in names if str(n) not in {"q", *equations}),
        "known_inputs": ["q"],
        "equations": equations,
        "outputs": {"y": last},
    }
    found = casid.assess_identifiability(casid.parse_system(fields))
    (told,) = found.identifiable_combinations
    assert {str(c) for c in told.combinations} == wanted
    assert told.is_complete


def test_curves_that_are_no_scalings_and_no_shifts_have_joint_invariants_of_their_own():
    """x' = u - p x/(q + r): one curve scales q + r, the other leaves it; p/(q + r) stays."""
    fields = {
        "states": ["x"],
        "params": ["p", "q", "r"],
        "known_inputs": ["u"],
        "equations": {"x": "u - p/(q + r)*x"},
        "outputs": {"y": "x"},
    }
    a = casid.assess_identifiability(casid.parse_system(fields))
    (told_of,) = a.identifiable_combinations
    assert set(told_of.group) == {"p", "q", "r"}
    p, q, r = sympy.symbols("p q r")
    (combination,) = told_of.combinations
    assert is_function_of(p / (q + r), [combination])
    assert told_of.is_complete


def test_a_pendulum_tells_the_sum_of_its_inertias():
    a = casid.assess_identifiability(pendulum.linear_model().with_unknown(I_xm=0.01))
    assert a.confounded_groups == (("I_x", "I_xm"),)
    assert [str(i) for i in invariants(a)] == ["I_x + I_xm"]
    assert a.remedy() == "give any one of I_x, I_xm a known value"


@pytest.mark.slow
def test_the_nine_parameters_of_the_ship_move_and_the_height_of_the_load_does_not():
    """One curve; zbar_m is told always, m where the load is as high as the calibration weight."""
    a = casid.assess_identifiability(ship.nine_parameters(), practical=False)
    assert (a.rank, a.unknowns) == (14, 15)
    assert told(a) == {"zbar_m"}
    (family,) = a.families
    assert family.is_closed
    assert family.unchanged == ("zbar_m",)
    (where,) = family.unchanged_where["m"]
    names = {s.name: s for s in where.free_symbols}
    assert set(names) == {"zbar_m", "zbar_m_calibration"}
    assert where.subs(names["zbar_m"], names["zbar_m_calibration"]) == 0
    assert {frozenset(s) for s in a.fixing.sets} == {frozenset({p}) for p in lost(a)}
    # along the curve, the values of Table 8.2 in particular
    values = {**ship.TABLE_8_2, "m_calibration": 0.2, "zbar_m_calibration": -0.172}
    moved = family.at(values, 1.1 * values[family.free])
    assert moved["zbar_m"] == values["zbar_m"]
    assert moved["m"] != pytest.approx(values["m"], rel=1e-3)
    level = family.at({**values, "zbar_m": -0.172}, 1.1 * values[family.free])
    assert level["m"] == pytest.approx(values["m"], rel=1e-9)


# -- out of time -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["nfkb_full", "akt_fujita", "hiv_eta_unknown", "hdnl"])
@pytest.mark.parametrize("limit", [1e-9, 1e-3, 5e-3, 2e-2])
def test_what_is_proven_in_time_is_true_and_the_rest_is_unknown(name, limit):
    """Whatever the clock allows, no verdict contradicts the full answer."""
    e = expected(name)
    a = structural(shared(f"{FOLDER}/{name}.json"), time_limit=limit)
    assert told(a) <= set(e["locally_identifiable"])
    assert lost(a) <= set(e["non_identifiable"])
    seen = {x for x, v in a.states.items() if v == "observable"}
    assert seen <= set(e["observable_states"])
    if not a.answer.is_partial:
        assert told(a) == set(e["locally_identifiable"])
        return
    assert not lost(a)  # never said of what was not decided
    assert a.fixing is None
    content = json.loads(json.dumps(a.to_json(), allow_nan=False))
    assert content["partial"] is True
    assert content["error_bound"] is None
    assert set(content["parameters"].values()) <= {"identifiable", "unknown"}
    assert "Partial" in str(a)


def test_no_time_at_all_decides_nothing():
    a = structural(shared(f"{FOLDER}/nfkb_full.json"), time_limit=1e-9)
    assert a.answer.is_partial
    assert "Time ran out" in a.sentence


# -- what moves, and what the records give ---------------------------------------------------------


def test_a_pendulum_whose_cart_rests_loses_a_rank_though_its_accelerometer_moves():
    """Section 7.3.1: with a_y = 0 the input a_s is a function of the states."""
    a = structural(pendulum.problem)
    assert (a.rank, a.unknowns) == (5, 5)
    (resting,) = [v for k, v in a.by_excitation.items() if k.startswith("a_y zero")]
    assert (resting.rank, resting.unknowns) == (4, 5)
    assert set(resting.not_identifiable) == {"k", "d", "I_x"}
    assert "a_y zero" in str(a)
    table = a.to_json()["verdict_by_excitation"]
    assert next(v for k, v in table.items() if k.startswith("a_y"))["rank"] == 4


def run(**level: float) -> casid.Record:
    """White u and w, or one of them at a level; a structural answer does not look at y."""
    rng = np.random.default_rng(8)
    channels = {name: rng.standard_normal(200) for name in ("u", "w", "y")}
    channels |= {name: np.full(200, value) for name, value in level.items()}
    return casid.Record(channels, {"u": "m/s", "w": "m/s", "y": "m"}, Ts=TS, name="run")


def test_an_input_at_rest_in_the_record_tells_nothing_of_its_parameter():
    """x' = a u + b w with w = 0: the record says so, and b cannot be told."""
    assert structural(integrator(), run()).is_identifiable
    a = structural(integrator(), run(w=0.0))
    assert (told(a), lost(a)) == ({"a"}, {"b"})
    assert "run: input w is 0 in all samples" in " ".join(str(a).split())
    assert a.remedy().startswith("give b a known value")


def test_a_constant_input_of_known_value_still_tells_its_parameter():
    a = structural(integrator(), run(w=0.7))
    assert told(a) == {"a", "b"}
    assert "w is the same in all samples" in " ".join(str(a).split())


def test_a_planned_record_needs_no_outputs():
    """Before anybody measures: known inputs decide, and the answer says what is to be measured."""
    channels = {name: run()[name] for name in ("u", "w")}
    planned = casid.Record(channels, {"u": "m/s", "w": "m/s"}, Ts=TS, name="plan")
    a = casid.assess_identifiability(integrator(), planned)
    assert told(a) == {"a", "b"}
    assert "plan: y is not recorded, and assumed measured" in " ".join(str(a).split())
    assert a.practical is not None  # errors relative to each other: the noise is unknown
    assert verdict_words(a, "a") == "identifiable"
    rest = casid.Record({**channels, "w": np.zeros(200)}, planned.units, Ts=TS, name="plan")
    assert lost(structural(integrator(), rest)) == {"b"}
    with pytest.raises(DataError, match="no channel 'w' for integrator"):
        structural(integrator(), planned.without("w"))


def test_no_data_will_tell_and_not_with_these_records_are_two_verdicts():
    """g1 g2 is told as a product alone; p could be told, but hardly from 0.4 s under noise."""
    model, record = decay(T=0.4, gains=2)
    rng = np.random.default_rng(3)
    noisy = record.with_channel("y", 4 * np.exp(-0.5 * record.t), "m")
    noisy = noisy.with_channel("y", noisy["y"] + 2.0 * rng.standard_normal(record.N), "m")
    a = casid.assess_identifiability(model, noisy, symbolic=False)
    assert verdict_words(a, "g1") == verdict_words(a, "g2") == "structurally unidentifiable"
    assert verdict_words(a, "p").startswith("identifiable, but not with these records")
    text = str(a)
    assert "structurally unidentifiable: g1, g2" in text
    assert "identifiable, but not with these records: poorly determined: p" in text


def test_a_long_quiet_record_tells_what_a_short_loud_one_does_not():
    model, record = decay(T=20.0)
    rng = np.random.default_rng(3)
    y = 2 * np.exp(-0.5 * record.t) + 1e-3 * rng.standard_normal(record.N)
    a = casid.assess_identifiability(model, record.with_channel("y", y, "m"), symbolic=False)
    assert verdict_words(a, "p") == verdict_words(a, "g1") == "identifiable"
    assert a.practical is not None
    assert a.practical["p"].verdict == "well determined"
    assert a.to_json()["practical"] is not None


def test_an_assessment_hangs_on_its_seed_in_nothing_but_the_points():
    path = shared(f"{FOLDER}/kd1999.json")
    first, second = structural(path, seed=1), structural(path, seed=2)
    assert dict(first.parameters) == dict(second.parameters)
    assert first.fixing == second.fixing


def test_candidates_are_weighed_by_what_they_cost():
    """LLW tells p2 p4: its states x1 and x2 tell p2 and p4, and the cheaper sensor is enough."""
    path = shared(f"{FOLDER}/llw.json")
    dear, cheap = casid.sensor("first", "x1", 3.0), casid.sensor("second", "x2", 1.0)
    a = structural(path, candidates=[dear, cheap])
    assert a.remedies is not None
    assert str(a.remedies.cheapest[0]) == "sensor second"
    assert "cheapest remedy: sensor second (cost 1)" in str(a)
    assert a.to_json()["mends"]["cheapest"]


def test_a_reference_at_rest_takes_with_it_what_only_it_tells():
    """The accelerometer moves with the noise; the cart does not, and nothing is told (7.3.1)."""
    still = pendulum.simulate(duration=10.0, ref=np.zeros(1000), noise=0.01)
    rest = casid.assess_identifiability(pendulum.problem, [still], symbolic=False)
    assert rest.is_identifiable
    assert rest.unexcited == ("k", "d", "I_x")
    assert "a_y does not act in these records: k, d, I_x" in str(rest)
    moving = casid.assess_identifiability(
        pendulum.problem, [pendulum.simulate(duration=10.0)], symbolic=False
    )
    assert moving.unexcited == ()


def test_a_parameter_that_is_assumed_known_is_known_to_the_expected_errors_too():
    """Knowing the stiffness makes the inertia more certain: their estimates are correlated."""
    options = {"symbolic": False}
    free = casid.assess_identifiability(pendulum.problem, **options).practical
    known = casid.assess_identifiability(
        pendulum.problem, assuming=casid.Assumptions(known=["k"]), **options
    ).practical
    k = pendulum.problem.model.parameters["k"].start
    fixed = casid.assess_identifiability(pendulum.problem.with_known({"k": k}), **options).practical
    assert "k" in [row.name for row in free.parameters]
    assert "k" not in [row.name for row in known.parameters]
    assert known["I_x"].std_error == pytest.approx(fixed["I_x"].std_error, rel=1e-9)
    assert known["I_x"].std_error < 0.6 * free["I_x"].std_error
