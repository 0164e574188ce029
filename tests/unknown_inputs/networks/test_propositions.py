"""What may be concluded: node sets, confounders, Propositions 3.1 and 4.1, predictor inputs."""

from __future__ import annotations

from itertools import combinations

import networkx as nx
import numpy as np
import pytest

from casid.algebra.rational import Rational
from casid.errors import ModelError
from casid.unknown_inputs.networks.confounders import (
    confounders,
    confounders_in,
    disturbances_in,
    excitations_in,
)
from casid.unknown_inputs.networks.elimination import immerse
from casid.unknown_inputs.networks.equations import node_equations
from casid.unknown_inputs.networks.graph import downstream, graph_of, path_past, upstream
from casid.unknown_inputs.networks.indirect_equations import indirect_equations
from casid.unknown_inputs.networks.network import dynamic_network
from casid.unknown_inputs.networks.node_sets import node_sets, signal_table
from casid.unknown_inputs.networks.predictor_inputs import predictor_inputs
from casid.unknown_inputs.networks.propositions import open_path, proposition_3_1, proposition_4_1
from problems import network8
from tests.support.network_samples import point, random_network

q = Rational.shift()
NETWORK, SYMBOLIC = network8.network, network8.symbolic()


# -- node sets ---------------------------------------------------------------------------------


def test_example_3_2_has_the_node_sets_of_the_thesis():
    s = node_sets(SYMBOLIC, 2)
    assert s.N == (1, 3, 5)
    assert s.S == (1, 2, 3, 4, 7)
    assert s.U == (5, 6, 8)
    assert s.K == (1, 3)
    assert s.A == (4, 7)
    assert s.sU == (5,)
    assert s.Ut == (6, 8)
    assert s.D == ()
    assert s.I == (4,)
    assert s.O == (7,)
    assert s.upstream[5] == (1, 2, 3, 7)
    assert s.downstream[5] == (1, 2, 4)
    assert s.upstream[6] == ()


def test_table_4_1_maps_the_nodes_to_signals_of_the_transfer_function_model():
    table = {m.signal: m.elements for m in signal_table(SYMBOLIC, node_sets(SYMBOLIC, 2))}
    assert table == {
        "y_O": ("w2",),
        "y_I": ("w4",),
        "y_D": (),
        "u_K": ("w1", "w3"),
        "u_I": ("w5",),
        "u_D": (),
        "u_A": ("w7", "delta_6"),
    }


def test_a_node_with_known_modules_from_unknown_inputs_alone_is_direct():
    """Definition 4.2; a module from any other node makes it an indirect one."""
    modules = {(1, 2): 1 / q, (3, 2): 0.5, (4, 2): 1 / q, (4, 1): 1 / q, (5, 1): 1 / q}
    network = dynamic_network(modules, measured=[1, 3, 4, 5], excitations=[3, 1])
    assert node_sets(network, 1).D == ()  # no module is known
    s = node_sets(network, 1, known=modules)
    assert (s.D, s.I, s.O) == ((3,), (4,), (5,))
    table = {m.signal: m.elements for m in signal_table(network, s)}
    assert table["y_D"] == ("w3", "delta_3")
    assert table["u_D"] == ("w2",)
    assert table["u_K"] == ("delta_1",)


@pytest.mark.parametrize("seed", range(40))
def test_node_sets_partition_the_nodes(seed):
    network = random_network(seed)
    s = node_sets(network, 1, known=network.modules if seed % 2 else ())
    parts = [{1}, s.K, s.D, s.I, s.O, s.sU, s.Ut]
    assert sum(len(p) for p in parts) == len(network.nodes)
    assert set().union(*parts) == set(network.nodes)
    assert set(s.S) | set(s.U) == set(network.nodes)
    graph = graph_of(network)
    for u in s.U:
        assert set(upstream(network, u)) == nx.ancestors(graph, u)
        assert set(downstream(network, u)) == nx.descendants(graph, u)


def test_a_node_named_direct_and_indirect_is_refused_with_the_mend():
    with pytest.raises(ModelError, match="w4 is named both direct and indirect.*name it in one"):
        node_sets(SYMBOLIC, 2, direct=[4], indirect=[4], known=SYMBOLIC.modules)


def test_a_claim_that_the_modules_contradict_is_refused_with_the_module():
    with pytest.raises(ModelError, match="w4 is no direct observation of w5: G41 adds w1"):
        node_sets(SYMBOLIC, 2, direct=[4])
    with pytest.raises(ModelError, match="w7 is no indirect observation.*Those that are: w4"):
        node_sets(SYMBOLIC, 2, indirect=[7])
    network = SYMBOLIC.without((4, 1))
    with pytest.raises(ModelError, match="G45 is not known; name it in known= if it is"):
        node_sets(network, 2, direct=[4])
    assert node_sets(network, 2, direct=[4], known=[(4, 5)]).D == (4,)
    with pytest.raises(ModelError, match="target w5 has no sensor; choose one among w1, w2"):
        node_sets(SYMBOLIC, 5)
    with pytest.raises(ModelError, match="has no node 9; its nodes are w1"):
        node_sets(SYMBOLIC, 9)


# -- confounders -------------------------------------------------------------------------------


def test_example_3_4_has_the_disturbance_sets_of_the_thesis_and_two_confounders():
    """R_1 = {1,6,7}, R_2 = {2,5,6,7,8}, R_3 = {3,6}, P_2 = {6}; tau6 and tau7 confound."""
    e = immerse(SYMBOLIC, [1, 2, 3])
    assert disturbances_in(SYMBOLIC, e, 1) == (1, 6, 7)
    assert disturbances_in(SYMBOLIC, e, 2) == (2, 5, 6, 7, 8)
    assert disturbances_in(SYMBOLIC, e, 3) == (3, 6)
    assert excitations_in(SYMBOLIC, e, 2) == (6,)
    found = {c.node: c for c in confounders(SYMBOLIC, 2, [1, 3])}
    assert {n: c.inputs for n, c in found.items()} == {6: (1, 3), 7: (1,)}
    assert found[7].to_output == (7, 8, 5, 2)
    assert found[7].to_inputs == ((7, 1),)


def test_with_w7_among_the_inputs_tau_6_remains_a_confounder_and_tau_7_does_not():
    """Example 3.7: tau7 is explained by w7."""
    found = confounders(NETWORK, 2, [1, 3, 7])
    assert [c.node for c in found] == [6]
    assert 3 in found[0].inputs


def test_in_the_indirect_model_of_example_4_1_tau_4_alone_confounds():
    e = indirect_equations(SYMBOLIC, node_sets(SYMBOLIC, 2))
    (found,) = confounders_in(SYMBOLIC, e, 2)
    assert (found.node, found.inputs) == (4, (4,))


def test_a_disturbance_that_is_not_there_confounds_nothing():
    quiet = dynamic_network(
        NETWORK.modules, measured=NETWORK.measured, disturbances=[1, 2, 3, 4, 5, 7, 8]
    )
    assert [c.node for c in confounders(quiet, 2, [1, 3])] == [7]


def test_an_output_among_its_inputs_is_refused():
    with pytest.raises(ModelError, match="w2 cannot be its own predictor input; take it out"):
        confounders(NETWORK, 2, [1, 2])


# -- propositions ------------------------------------------------------------------------------


def test_proposition_3_1_fails_for_the_eight_nodes_by_the_loop_2_5_2_unless_g52_is_zero():
    for i in (1, 3):
        verdict = proposition_3_1(SYMBOLIC, 2, i)
        assert [c.letter for c in verdict.violated] == ["c"]
        assert "w2 -> w5 -> w2" in str(verdict.violated[0])
        assert verdict.conclusion is False
        mended = proposition_3_1(SYMBOLIC.without((5, 2)), 2, i)
        assert mended.holds
        assert mended.conclusion is True


def test_proposition_3_1_names_an_open_parallel_path_and_a_missing_input():
    verdict = proposition_3_1(NETWORK, 4, 1)
    assert [c.letter for c in verdict.violated] == ["b"]
    assert verdict.violated[0].violated_by == "w1 -> w2 -> w5 -> w4"
    missing = proposition_3_1(NETWORK, 2, 5)
    assert "(a) w5 is among the inputs w1, w3: FAILS: w5 is not among w1, w3" in str(missing)
    assert missing.conclusion is None
    with pytest.raises(ModelError, match="2 cannot be a predictor input of w2; choose other"):
        proposition_3_1(NETWORK, 2, 1, inputs=[2])


def test_example_4_5_proposition_4_1_holds_for_i_3_and_not_for_i_1():
    s = node_sets(SYMBOLIC, 2)
    three, one = proposition_4_1(SYMBOLIC, s, 3), proposition_4_1(SYMBOLIC, s, 1)
    assert three.holds
    assert three.conclusion is True
    assert [c.letter for c in one.violated] == ["d"]
    assert one.violated[0].violated_by == "G41 is not zero"
    assert one.conclusion is False
    with pytest.raises(ModelError, match="observable predictor inputs of w2: w1, w3; w7 is none"):
        proposition_4_1(SYMBOLIC, s, 7)


def test_proposition_4_1_names_the_unknown_node_that_acts_on_the_observation():
    network = dynamic_network(
        {(1, 2): 1 / q, (1, 3): 1 / q, (4, 3): 1 / q, (4, 5): 1 / q, (4, 1): 1 / q},
        measured=[1, 2, 4],
    )
    verdict = proposition_4_1(network, node_sets(network, 1), 2)
    assert {c.letter: c.violated_by for c in verdict.violated} == {
        "b": "G45 is not zero",
        "c": "G41 is not zero",
    }
    blind = network.with_sensors([1, 2])
    verdict = proposition_4_1(blind, node_sets(blind, 1), 2)
    assert "w3 cannot be recovered from none" in verdict.violated[0].violated_by
    assert verdict.conclusion is None


def test_the_conclusions_hold_whenever_the_conditions_do_on_200_random_networks():
    """Propositions 3.1 and 4.1 are sufficient; exact at random rational q, up to 8 nodes."""
    held = {"3.1": 0, "4.1": 0}
    failed = {"3.1": 0, "4.1": 0}
    for seed in range(200):
        network = random_network(seed, density=0.25)
        known = network.modules if seed % 2 else ()
        for j in network.measured:
            sets = node_sets(network, j, known=known)
            for i in sets.K:
                verdicts = {"3.1": proposition_3_1(network, j, i)}
                if sets.sU:
                    verdicts["4.1"] = proposition_4_1(network, sets, i)
                for name, verdict in verdicts.items():
                    if verdict.holds:
                        assert verdict.conclusion is True, (name, seed, j, i)
                        held[name] += 1
                    failed[name] += verdict.conclusion is False
    assert min(held.values()) > 20
    assert min(failed.values()) > 20  # the check can tell


# -- predictor inputs --------------------------------------------------------------------------


def all_minimal(network, j, i):
    """Every minimal set of measured nodes that blocks parallel paths and loops, by enumeration."""
    others = [n for n in network.measured if n not in (i, j)]
    found = []
    for size in range(len(others) + 1):
        for more in combinations(others, size):
            inputs = {i, *more}
            if not any(f <= inputs for f in found) and open_path(network, j, i, inputs) == ((), ()):
                found.append(inputs)
    return found


@pytest.mark.parametrize("part", range(4))
def test_the_search_finds_every_minimal_set_and_each_keeps_the_module(part):
    """Against enumeration of all subsets; Dankers et al. (2016), Proposition 3, exactly."""
    sizes = set()
    for seed in range(part, 80, 4):
        network = random_network(seed)
        for j, i in network.modules:
            if j not in network.measured or i not in network.measured:
                continue
            search = predictor_inputs(network, j, i, most=1000)
            assert search.is_complete
            found = [set(s.inputs) for s in search.sets]
            assert sorted(map(sorted, found)) == sorted(map(sorted, all_minimal(network, j, i)))
            assert [len(s) for s in found] == sorted(len(s) for s in found)
            e = node_equations(network, **point(network, seed))
            for inputs in found:
                assert immerse(e, inputs | {j}).module(j, i) == e.module(j, i)
            sizes |= {len(s) for s in found}
    assert {1, 2, 3} <= sizes


def test_the_search_on_the_eight_nodes_asks_for_the_sensor_that_would_help():
    search = predictor_inputs(NETWORK, 2, 1)
    assert search.sets == ()
    assert "w2 -> w5 -> w2 is open and no sensor can block it; one on w5 would" in str(search)
    helped = predictor_inputs(network8.table_network((1, 2, 3, 4, 5, 7)), 2, 1)
    assert [s.inputs for s in helped.sets] == [(1, 5)]
    assert [c.node for c in helped.sets[0].confounders] == [6]


def test_noisy_sensors_among_the_inputs_are_told():
    network = dynamic_network(
        {(1, 2): 1 / q, (1, 3): 1 / q, (3, 2): 1 / q}, sensor_noise={2: 0.0, 3: 0.5}
    )
    (found,) = predictor_inputs(network, 1, 2).sets
    assert (found.inputs, found.noisy) == ((2, 3), (3,))
    assert "noisy sensors on w3" in str(found)


def test_sets_free_of_confounders_are_found_and_checked():
    search = predictor_inputs(
        network8.table_network(tuple(range(1, 9))), 2, 1, without_confounders=True
    )
    assert [s.inputs for s in search.sets] == [(1, 3, 5), (1, 5, 6)]
    assert not any(s.confounders for s in search.sets)
    assert any("tau_6 confounds" in r.reason for r in search.refused)


@pytest.mark.parametrize("seed", range(60))
def test_the_smallest_set_free_of_confounders_is_as_small_as_enumeration_has_it(seed):
    network = random_network(seed, most=6)
    for j, i in network.modules:
        if j in network.measured and i in network.measured:
            others = [n for n in network.measured if n not in (i, j)]
            sizes = [
                1 + size
                for size in range(len(others) + 1)
                for more in combinations(others, size)
                if open_path(network, j, i, {i, *more}) == ((), ())
                and not confounders(network, j, [i, *more])
            ]
            search = predictor_inputs(network, j, i, without_confounders=True, most=1)
            assert [len(s.inputs) for s in search.sets] == sizes[:1]


def test_a_module_that_is_not_there_or_has_no_sensor_is_refused():
    with pytest.raises(ModelError, match="has no module G24; into w2 lead those from w1, w3, w5"):
        predictor_inputs(NETWORK, 2, 4)
    with pytest.raises(ModelError, match="w5 has no sensor, so G25 .*measure it, or eliminate it"):
        predictor_inputs(NETWORK, 2, 5)


def test_a_path_past_nodes_is_shortest_and_passes_none_of_them():
    rng = np.random.default_rng(7)
    for seed in range(30):
        network = random_network(seed)
        graph = graph_of(network)
        a, b = (int(n) for n in rng.choice(network.nodes, 2, replace=False))
        blocked = {int(n) for n in rng.choice(network.nodes, 2)} - {a, b}
        rest = graph.subgraph(set(network.nodes) - blocked)
        path = path_past(network, a, b, blocked)
        if nx.has_path(rest, a, b):
            assert len(path) == len(nx.shortest_path(rest, a, b))
            assert all((to, k) in network.modules for k, to in zip(path, path[1:], strict=False))
        else:
            assert path == ()
