"""What mends a deficiency: a sensor, another experiment, a repetition, or something known."""

from __future__ import annotations

import functools
import json
from itertools import combinations

import casadi as ca
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from casid.errors import IdentifiabilityError, ModelError
from casid.identifiability.combinations.fixing_sets import confounded_groups, fixing_sets
from casid.identifiability.equations.equation_file import read_equations
from casid.identifiability.equations.equation_text import parse_system
from casid.identifiability.inputs.elimination import eliminate_unknown_inputs
from casid.identifiability.rank.observability import observability
from casid.identifiability.remedies.cheapest_remedies import (
    cheapest_remedies,
    experiment,
    known_initial_state,
    known_parameter,
    replica,
    replicas_needed,
    sensor,
    sensor_subsets,
)
from tests.support.shared import shared


def published(name):
    return read_equations(shared(f"identifiability/{name}.json")).systems


@functools.cache
def signalling_table():
    """NFkB: 15 states, 29 parameters, and the 63 subsets of its six outputs."""
    (signalling,) = published("nfkb_full")
    return signalling, sensor_subsets(signalling)


def system(name, equations, outputs, parameters, **more):
    return parse_system(
        {
            "states": list(equations),
            "params": parameters,
            "equations": equations,
            "outputs": outputs,
            **more,
        },
        name=name,
    )


def thrust():
    """a = F/m, of which only the acceleration is seen (Linder 2017, section 7.1)."""
    return system("nominal", {"v": "F/m"}, {"a": "F/m"}, ["F", "m"])


def loaded_thrust():
    """The same force moves a known mass as well."""
    equations, outputs = {"v": "F/(m + dm)"}, {"a": "F/(m + dm)"}
    return system("loaded", equations, outputs, ["F", "m"], known_constants=["dm"])


def oscillator():
    """m x'' + d x' + k x = b u: only d/m, k/m and b/m can be told."""
    equations = {"x": "v", "v": "(b*u - d*v - k*x)/m"}
    return system("oscillator", equations, {"y": "x"}, ["m", "d", "k", "b"], known_inputs=["u"])


def chain():
    """Two tanks in a row; the gain of the gauge hides how much there is."""
    equations = {"x1": "-k1*x1 + b*u", "x2": "k1*x1 - k2*x2"}
    outputs = {"y": "c*x2"}
    return system("chain", equations, outputs, ["k1", "k2", "b", "c"], known_inputs=["u"])


# -- the force-mass ambiguity ---------------------------------------------------------------------


def test_force_and_mass_cannot_be_told_from_the_acceleration_and_repetitions_do_not_help():
    told = replicas_needed(thrust())
    assert (told.deficiencies, told.needed, told.enough) == ((1, 1), None, 1)
    assert "add nothing" in str(told)


@pytest.mark.parametrize(
    "candidate",
    [
        known_parameter("F"),
        known_parameter("m"),
        sensor("load cell", "F"),
        sensor("weight", "9.81*m"),
        experiment("loaded", loaded_thrust()),
    ],
    ids=str,
)
def test_force_and_mass_are_told_once_one_is_known_or_the_mass_is_changed_by_a_known_amount(
    candidate,
):
    mends = cheapest_remedies(thrust(), [candidate])
    assert mends.before.missing == ("F", "m")
    assert mends.singles[0].is_remedy
    assert mends.cheapest[0].candidates == (candidate,)
    assert dict(mends.verdict.identifiable).get("F", True)


def test_an_unknown_change_of_the_mass_mends_nothing():
    """Linder (2017), section 7.1: the change must be known, or one of the loads nominal."""
    equations, outputs = {"v": "F/(m + dm)"}, {"a": "F/(m + dm)"}
    unknown = system("unknown load", equations, outputs, ["F", "m", "dm"])
    mends = cheapest_remedies(thrust(), [experiment("unknown load", unknown)])
    assert mends.together.missing == ("F", "m")
    assert not mends.cheapest
    assert "are no remedy" in str(mends)


def test_of_all_that_mends_the_cheapest_is_chosen():
    offers = [
        sensor("load cell", "F", 3.0),
        known_parameter("m", 5.0),
        experiment("loaded", loaded_thrust(), cost=2.0),
        replica(cost=0.5),
    ]
    mends = cheapest_remedies(thrust(), offers)
    assert [str(e) for e in mends.cheapest] == ["experiment loaded"]
    assert [e.cost for e in mends.singles] == [2.0, 3.0, 5.0, 0.5]
    assert "cheapest remedy: experiment loaded (cost 2)" in str(mends)
    assert not mends.is_cut
    content = json.loads(json.dumps(mends.to_json()))
    assert content["cheapest"][0]["candidates"] == [{"kind": "experiment", "label": "loaded"}]


# -- known parameters are a matroid ---------------------------------------------------------------


def test_knowing_any_member_of_a_confounded_group_of_deficiency_one_mends():
    names = ["m", "d", "k", "b"]
    mends = cheapest_remedies(oscillator(), [known_parameter(q) for q in names])
    assert mends.before.deficiency == 1
    assert {e.candidates[0].label for e in mends.cheapest} == set(names)
    assert all(e.is_remedy and set(e.gained) == set(names) for e in mends.singles)


def test_the_cheapest_known_parameters_are_the_cheapest_fixing_set():
    """Bases of a matroid: sparing the dearest first is optimal (Oxley 2011, section 1.8)."""
    (signalling,) = published("akt_fujita")
    costs = {q: 1.0 + (7 * i) % 5 for i, q in enumerate(signalling.parameters)}
    point = observability(signalling).points[0]
    fixing = fixing_sets(point.information, point.parameters, point.prime)
    least = min(sum(costs[q] for q in s) for s in fixing.sets)
    mends = cheapest_remedies(signalling, [known_parameter(q, c) for q, c in costs.items()])
    best = mends.cheapest[0]
    assert best.cost == least
    assert tuple(c.label for c in best.candidates) in fixing.sets


def test_a_known_parameter_makes_its_confounded_group_move_less():
    (signalling,) = published("akt_fujita")
    point = observability(signalling).points[0]
    groups = confounded_groups(point.information, point.parameters, point.prime)
    confounded = {q for g in groups for q in g}
    mends = cheapest_remedies(signalling, [known_parameter(q) for q in signalling.parameters])
    for e in mends.singles:
        (c,) = e.candidates
        assert mends.before.deficiency - e.deficiency == (c.label in confounded)


# -- adding never loses ---------------------------------------------------------------------------

OFFERS = (
    sensor("level 1", "x1", 2.0),
    sensor("sum", "x1 + x2", 1.5),
    known_parameter("b", 1.0),
    known_parameter("c", 3.0),
    known_initial_state("x1", 0.5),
    known_initial_state("x2", 0.5),
    replica(cost=4.0),
)


@settings(max_examples=20, deadline=None)
@given(st.sets(st.integers(0, len(OFFERS) - 1)), st.integers(0, len(OFFERS) - 1))
def test_whatever_is_added_no_parameter_is_lost(chosen, one_more):
    fewer = cheapest_remedies(chain(), [OFFERS[i] for i in sorted(chosen)]).together
    more = cheapest_remedies(chain(), [OFFERS[i] for i in sorted({*chosen, one_more})]).together
    assert set(more.missing) <= set(fewer.missing)
    assert more.deficiency <= fewer.deficiency


@pytest.mark.parametrize("size", [1, 2])
def test_what_one_point_shows_of_candidates_is_what_the_rank_of_the_extended_system_says(size):
    """Columns left out and rows added, against equations written anew."""
    base = chain()
    x, symbols = base.symbols, base.symbols
    changes = {
        OFFERS[0]: lambda s: s.where(outputs=(*s.outputs, "1"), h=ca.vertcat(s.h, x["x1"])),
        OFFERS[1]: lambda s: s.where(
            outputs=(*s.outputs, "2"), h=ca.vertcat(s.h, symbols["x1"] + symbols["x2"])
        ),
        OFFERS[2]: lambda s: s.with_known("b"),
        OFFERS[3]: lambda s: s.with_known("c"),
        OFFERS[4]: lambda s: s.where(known_initial=(*s.known_initial, "x1")),
        OFFERS[5]: lambda s: s.where(known_initial=(*s.known_initial, "x2")),
    }
    for chosen in combinations(changes, size):
        changed = base
        for c in chosen:
            changed = changes[c](changed)
        expected = observability(changed)
        seen = cheapest_remedies(base, chosen).together
        known = {c.label for c in chosen if c.kind == "known parameter"}
        missing = {q for q, yes in expected.identifiable.items() if not yes}
        assert set(seen.missing) == missing - known
        assert seen.deficiency == expected.deficiency


def test_a_known_initial_state_stands_for_the_gain_of_a_gauge():
    """b and c are scaled against x: b/s, c s, x/s. One known x(0) stops it."""
    mends = cheapest_remedies(chain(), OFFERS)
    assert mends.before.missing == ("b", "c")
    assert mends.cheapest[0].cost == 0.5
    assert {str(e) for e in mends.cheapest} == {
        "known initial state x1",
        "known initial state x2",
    }


def test_several_things_are_added_where_one_does_not_do():
    """A gauge of unknown gain in each of two tanks that do not touch: one known value for each."""
    equations = {"x1": "-k1*x1", "x2": "-k2*x2"}
    outputs = {"y1": "c1*x1", "y2": "c2*x2"}
    apart = system("two tanks", equations, outputs, ["k1", "k2", "c1", "c2"])
    offers = [sensor("level 1", "x1", 1.0), sensor("level 2", "x2", 2.0)]
    offers += [known_parameter("c2", 4.0), known_parameter("k1", 0.1)]
    mends = cheapest_remedies(apart, offers)
    assert str(mends.cheapest[0]) == "sensor level 1 and sensor level 2"
    assert mends.cheapest[0].cost == 3.0
    # A goal that asks for less is reached with less.
    one = cheapest_remedies(apart, offers, goal=["c2"])
    assert [str(e) for e in one.cheapest] == ["sensor level 2"]
    assert not cheapest_remedies(apart, offers, goal=["k1"]).cheapest  # nothing to mend


def test_a_mend_larger_than_the_sets_compared_is_found_and_said_to_be_perhaps_too_dear():
    equations = {f"x{i}": f"-k{i}*x{i}" for i in range(4)}
    outputs = {f"y{i}": f"c{i}*x{i}" for i in range(4)}
    names = [f"{n}{i}" for n in "kc" for i in range(4)]
    apart = system("four tanks", equations, outputs, names)
    offers = [known_parameter(f"c{i}", 2.0) for i in range(4)] + [known_parameter("k0", 0.1)]
    mends = cheapest_remedies(apart, offers, max_size=2)
    assert {c.label for c in mends.cheapest[0].candidates} == {"c0", "c1", "c2", "c3"}
    assert mends.is_cut
    assert "raise max_size" in str(mends)


# -- unknown inputs -------------------------------------------------------------------------------


def without_unknown(system):
    return eliminate_unknown_inputs(system).system


def test_a_sensor_of_the_force_mends_what_own_unknown_forces_hide():
    """related_massdamper: with own forces the second data set tells nothing, a force gauge does."""
    systems = published("related_massdamper")
    mends = cheapest_remedies(systems, [sensor("gauge", "w")], prepare=without_unknown)
    assert mends.before.missing == ("m", "d")
    assert mends.cheapest[0].is_remedy
    with pytest.raises(ModelError, match="eliminate it"):
        cheapest_remedies(systems, [sensor("gauge", "w")])


def test_a_sensor_may_be_mounted_in_one_experiment_only():
    first, second = published("related_massdamper")
    names = [first.name, second.name]
    assert len({*names}) == 2
    for name in names:
        gauge = sensor("gauge", "w", experiments=[name])
        mends = cheapest_remedies([first, second], [gauge], prepare=without_unknown)
        assert mends.together.is_remedy  # one force known is enough for m and d


# -- replicas -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["me_cyclic5", "me_catenary5"])
def test_published_numbers_of_replicas(name):
    """Ovchinnikov, Pillay, Pogudin & Scanlon (2022): cyclic 3, catenary 5 experiments for n = 5."""
    (network,) = published(name)
    content = json.loads(shared(f"identifiability/{name}.json").read_text())["expected"]
    told = replicas_needed(network)
    assert told.needed == content["replicates_needed"]
    expected = content["parameter_deficiency_by_number_of_replicates"]
    assert [told.deficiency(i + 1) for i in range(len(expected))] == expected
    assert told.error_bound <= 1e-12
    assert f"{told.needed} make all" in str(told)
    assert json.loads(json.dumps(told.to_json()))["needed"] == told.needed


def test_replicas_are_what_the_joint_rank_of_repeated_experiments_says():
    (network,) = published("me_cyclic5")
    told = replicas_needed(network)
    for count in (1, 2, 3):
        joint = observability([network] * count)
        assert told.deficiency(count) == joint.deficiency
        seen = tuple(q for q, yes in joint.identifiable.items() if yes)
        assert told.identifiable[count - 1] == seen


def test_a_search_for_replicas_that_was_cut_says_so():
    (network,) = published("me_catenary5")
    told = replicas_needed(network, limit=3)
    assert (told.deficiencies, told.is_cut, told.needed, told.enough) == (
        (13, 8, 4),
        True,
        None,
        None,
    )
    assert "raise limit" in str(told)
    with pytest.raises(IdentifiabilityError, match="raise limit"):
        told.deficiency(4)
    with pytest.raises(IdentifiabilityError, match="allow at least one"):
        replicas_needed(network, limit=0)


def test_replicas_among_the_candidates_add_up():
    (network,) = published("me_cyclic5")
    again = experiment("a second time", network), experiment("a third time", network)
    mends = cheapest_remedies(network, again)
    assert [e.deficiency for e in mends.singles] == [2, 2]
    assert mends.cheapest[0].candidates == again


# -- subsets of the outputs -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "outputs",
    [("y1",), ("y6",), ("y4", "y5"), ("y1", "y3", "y6"), ("y1", "y2", "y5"), ("y2", "y3", "y4")],
)
def test_subsets_of_outputs_are_what_the_rank_of_each_says(outputs):
    signalling, table = signalling_table()
    row = table.of(*outputs)
    positions = [signalling.outputs.index(y) for y in outputs]
    alone = observability(signalling.where(outputs=outputs, h=signalling.h[positions]))
    assert (row.rank, row.deficiency) == (alone.rank, alone.deficiency)
    assert row.identifiable == tuple(q for q, yes in alone.identifiable.items() if yes)


def test_an_output_more_never_tells_less():
    _, table = signalling_table()
    assert len(table.subsets) == 63
    assert table.error_bound <= 1e-12
    for a in table.subsets:
        for b in table.subsets:
            if set(a.outputs) < set(b.outputs):
                assert a.rank <= b.rank
                assert a.deficiency >= b.deficiency
                assert set(a.identifiable) <= set(b.identifiable)


def test_minimal_subsets_tell_as_much_as_all_and_lose_with_any_member():
    signalling, table = signalling_table()
    everything = table.of(*signalling.outputs)
    for s in table.minimal:
        assert s.deficiency == everything.deficiency
        assert s.identifiable == everything.identifiable
        for y in s.outputs:
            rest = [o for o in s.outputs if o != y]
            assert table.of(*rest).deficiency > s.deficiency
    assert all(s.cost == 3.0 for s in table.cheapest)


def test_costs_decide_between_outputs_that_tell_the_same():
    equations = {"x": "-k*x"}
    outputs = {"tape": "x", "laser": "2*x", "lamp": "c"}
    tank = system("tank", equations, outputs, ["k", "c"])
    table = sensor_subsets(tank, costs={"laser": 10.0})
    assert {s.outputs for s in table.minimal} == {("tape", "lamp"), ("laser", "lamp")}
    assert [s.outputs for s in table.cheapest] == [("tape", "lamp")]
    assert table.of("lamp").identifiable == ("c",)
    assert table.of("tape").identifiable == ("k",)
    assert "*      2" in str(table)
    assert json.loads(json.dumps(table.to_json()))["cheapest"] == [["tape", "lamp"]]
    assert len(sensor_subsets(tank, ["laser", "lamp"]).subsets) == 3


@pytest.mark.parametrize(
    "special",
    [
        {"known_initial": {"x": 0}},
        {"known_initial": ["x"]},
        {"outputs": {"y1": "x", "y2": "abs(x)"}},
    ],
    ids=["special initial value", "known initial state", "kink"],
)
def test_subsets_at_special_points_are_what_the_rank_of_each_says(special):
    """x' = 1 + a x^2 tells a at order three if x(0) = 0, after two orders that tell nothing."""
    more = {"outputs": {"y1": "x", "y2": "x^2"}, **special}
    grown = system("growth", {"x": "1 + a*x^2"}, parameters=["a"], **more)
    table = sensor_subsets(grown)
    for outputs in (("y1",), ("y2",), ("y1", "y2")):
        positions = [grown.outputs.index(y) for y in outputs]
        alone = observability(grown.where(outputs=outputs, h=grown.h[positions]))
        assert table.of(*outputs).rank == alone.rank
        assert table.of(*outputs).identifiable == ("a",)


# -- bad input ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("candidates", "error", "mend"),
    [
        ([known_parameter("kk1")], IdentifiabilityError, "did you mean 'k1'"),
        ([known_initial_state("x3")], IdentifiabilityError, "known are: x1, x2"),
        ([sensor("level", "x1 + xx")], ModelError, "'xx' is not declared; known are"),
        ([sensor("level", ca.SX.sym("z"))], ModelError, "'z' is not declared"),
        ([sensor("level", "__import__('os')")], ModelError, "has no place in a formula"),
        ([sensor("y", "x1")], ModelError, "rename the sensor"),
        ([sensor("s", "x1", experiments=["chian"])], IdentifiabilityError, "'chain'"),
        ([replica("chian")], IdentifiabilityError, "did you mean 'chain'"),
        ([sensor("s", "x1"), sensor("s", "x2")], IdentifiabilityError, "its own label"),
    ],
)
def test_a_candidate_that_fits_nothing_is_refused_with_the_mend(candidates, error, mend):
    with pytest.raises(error, match=mend):
        cheapest_remedies(chain(), candidates)


@pytest.mark.parametrize("cost", [-1.0, float("nan"), float("inf")])
def test_costs_are_numbers_from_zero(cost):
    with pytest.raises(IdentifiabilityError, match="a number >= 0"):
        known_parameter("k1", cost)
    with pytest.raises(IdentifiabilityError, match="a number >= 0"):
        sensor_subsets(chain(), costs={"y": cost})


def test_questions_that_cannot_be_answered_say_why():
    with pytest.raises(IdentifiabilityError, match="no equations"):
        experiment("empty")
    with pytest.raises(IdentifiabilityError, match="did you mean 'k1'"):
        cheapest_remedies(chain(), OFFERS, goal=["K1"])
    with pytest.raises(IdentifiabilityError, match="did you mean 'y1'"):
        sensor_subsets(published("nfkb_full")[0], ["y11"])
    with pytest.raises(IdentifiabilityError, match="raise limit"):
        sensor_subsets(published("nfkb_full")[0], limit=10)
    table = sensor_subsets(chain())
    with pytest.raises(IdentifiabilityError, match="no output 'z'"):
        table.of("z")
