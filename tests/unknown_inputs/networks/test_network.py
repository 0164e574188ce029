"""A network is checked when it is made: names, self loops, well-posedness, loops, stability."""

from __future__ import annotations

from fractions import Fraction

import casadi as ca
import control
import numpy as np
import pytest
import sympy

import casid
from casid.algebra.rational import Rational
from casid.errors import ModelError
from casid.report.figures.network_drawing import network_figure, roles
from casid.unknown_inputs.networks.algebraic_loops import algebraic_loops
from casid.unknown_inputs.networks.dynamics import is_stable, network_states, refuse_unstable
from casid.unknown_inputs.networks.elimination import immerse
from casid.unknown_inputs.networks.indirect_equations import indirect_equations
from casid.unknown_inputs.networks.network import Signal, dynamic_network
from casid.unknown_inputs.networks.node_sets import node_sets
from problems import network8
from tests.support.shared import ROOT

q = Rational.shift()


def test_modules_from_every_source_make_the_same_network():
    Q, x, a = sympy.Symbol("q"), ca.SX.sym("q"), ca.SX.sym("a")
    network = dynamic_network(
        {
            ("a", "b"): control.tf([0.5], [1, -0.3], True),
            ("b", "c"): 0.5 * Q**-1 / (1 - 0.3 * Q**-1),
            ("c", "a"): 0.5 / (x - a),
            ("c", "b"): 0.5 / (q - 0.3),
        },
        values={"a": 0.3},
    )
    assert network.nodes == ("a", "b", "c")
    assert all(g.equals(0.5 / (q - 0.3)) for g in network.modules.values())
    assert "engine" in str(dynamic_network({("wheel", "engine"): 1}))


def test_the_eight_node_network_is_stable_with_the_spectral_radius_told():
    """Example 6.1: 13 modules of first order, spectral radius 0.9535."""
    states = network_states(network8.network)
    assert states.A.shape == (13, 13)
    assert round(float(np.max(np.abs(np.linalg.eigvals(states.A)))), 4) == 0.9535
    assert "stable, 13 states, spectral radius 0.9535" in str(network8.network)
    refuse_unstable(network8.network)


def test_the_state_space_of_a_network_is_the_inverse_of_i_minus_g():
    rng = np.random.default_rng(3)
    network = dynamic_network(
        {(1, 2): 0.3 + 0.2 / (q - 0.5), (2, 3): 0.4, (3, 1): 0.5 * q / (q + 0.2), (3, 2): 1 / q}
    )
    s = network_states(network)
    for z in np.exp(1j * rng.uniform(0, np.pi, 4)):
        G = np.zeros((3, 3), complex)
        for (i, k), g in network.modules.items():
            G[i - 1, k - 1] = g.response(z)
        got = s.C @ np.linalg.solve(z * np.eye(len(s.A)) - s.A, s.B) + s.D
        np.testing.assert_allclose(got, np.linalg.inv(np.eye(3) - G), rtol=1e-10, atol=1e-12)


def test_the_simulator_obeys_the_network_it_is_of():
    """w = (I - G)^-1 (delta + tau) on the simulator's own tau, up to a start that has died out."""
    record = network8.simulate(seed=5, N=400, settle=0)
    s = network_states(network8.network)
    e = np.column_stack([record[f"tau_{n}"] for n in range(1, 9)])
    e[:, 5] += record["delta_6"]
    x, w = np.zeros(len(s.A)), np.zeros((400, 8))
    for t in range(400):
        w[t] = s.C @ x + s.D @ e[t]
        x = s.A @ x + s.B @ e[t]
    got = np.column_stack([record[f"w{n}"] for n in range(1, 9)])
    np.testing.assert_allclose(got, w, atol=1e-10 * np.abs(w).max())


def test_the_problem_file_simulates_the_same_record_for_the_same_seed():
    a, b = network8.simulate(seed=2, N=50), network8.simulate(seed=2, N=50)
    for name in a.names:
        np.testing.assert_array_equal(a[name], b[name])
    assert {*a.names} == {f"w{n}" for n in range(1, 9)} | {f"tau_{n}" for n in range(1, 9)} | {
        "delta_6"
    }
    assert network8.symbolic().modules.keys() == network8.network.modules.keys()
    quiet = network8.simulate(seed=2, N=50, disturbance=0.0, excitation=0.0)
    assert not any(quiet[name].any() for name in quiet.names)
    assert isinstance(a, casid.Record)
    assert (ROOT / "problems" / "network8.py").exists()


def test_a_hub_of_many_close_poles_keeps_its_digits():
    """Twenty modules into one node, poles 0.9 to 0.919: a companion matrix would lose them all."""
    poles = [0.9 + 0.001 * k for k in range(20)]
    modules = {(0, k + 1): 0.001 / (q - p) for k, p in enumerate(poles)}
    found = [r.value.real for r in network_states(dynamic_network(modules)).poles()]
    np.testing.assert_allclose(sorted(found), poles, rtol=1e-12)


# -- well-posedness ----------------------------------------------------------------------------


def test_an_ill_posed_network_names_the_minor_and_the_loop():
    modules = {(1, 2): 2, (2, 1): 0.5, (3, 2): 1 / q, (1, 3): 1}
    with pytest.raises(ModelError) as refused:
        dynamic_network(modules)
    text = str(refused.value)
    assert "principal minor of lim (I - G) of the nodes w1, w2 is zero" in text
    assert "G21 = 1/2" in text
    assert "G12 = 2" in text
    assert "put a delay into one of these modules" in text
    mended = dynamic_network(modules | {(2, 1): 0.5 / q})
    assert algebraic_loops(mended) == []


def test_a_minor_that_vanishes_inside_a_well_posed_whole_is_found():
    """I - G of nodes 1 and 2 is singular, that of all three is not: 1 - 1 - 1/2 != 0."""
    modules = {(1, 2): 1, (2, 1): 1, (1, 3): 1, (3, 1): Fraction(1, 2)}
    with pytest.raises(ModelError, match="minor .* of the nodes w1, w2 is zero"):
        dynamic_network(modules)


@pytest.mark.parametrize("seed", range(30))
def test_well_posedness_by_loops_is_that_of_all_principal_minors(seed):
    """Enumeration of all minors of lim (I - G), Assumption 2.1 (a), against the loops' own."""
    from itertools import combinations

    rng = np.random.default_rng(seed)
    L, density = (5, 0.4) if seed % 2 else (7, 0.25)
    D = np.where(rng.random((L, L)) < density, rng.choice([-1, 1, 2, 0.5], (L, L)), 0.0)
    np.fill_diagonal(D, 0.0)
    minors = [
        np.linalg.det((np.eye(L) - D)[np.ix_(s, s)])
        for size in range(1, L + 1)
        for s in combinations(range(L), size)
    ]
    is_posed = min(abs(m) for m in minors) > 1e-9
    modules = {(i, k): D[i, k] for i in range(L) for k in range(L) if D[i, k]}
    if is_posed:
        dynamic_network(modules, nodes=range(L))
    else:
        with pytest.raises(ModelError, match="ill-posed"):
            dynamic_network(modules, nodes=range(L))


def test_two_hundred_nodes_in_one_loop_with_one_delay_are_well_posed_at_once():
    ring = {((k + 1) % 200, k): 1.0 for k in range(200)}
    with pytest.raises(ModelError, match="ill-posed.*put a delay"):
        dynamic_network(ring)
    dynamic_network(ring | {(0, 199): 1 / q})
    with pytest.raises(ModelError, match="of the nodes w100, w101 is zero"):
        dynamic_network(ring | {(0, 199): 0.5, (100, 101): 1.0})


def test_a_dense_network_of_direct_terms_is_refused_for_its_small_loops_at_least():
    dense = {(i, k): 0.01 for i in range(40) for k in range(40) if i != k}
    dynamic_network(dense)
    with pytest.raises(ModelError, match="of the nodes w3, w5 is zero"):
        dynamic_network(dense | {(3, 5): 4.0, (5, 3): 0.25})


def test_algebraic_loops_are_told_in_order_of_the_signal():
    network = dynamic_network(
        {(2, 1): 0.5, (3, 2): 0.5 * q / (q - 0.1), (1, 3): 0.5, (1, 2): 1 / q}
    )
    assert [set(loop) for loop in algebraic_loops(network)] == [{1, 2, 3}]
    (loop,) = algebraic_loops(network)
    assert all((loop[(i + 1) % 3], loop[i]) in network.modules for i in range(3))
    assert "algebraic loops: w" in str(network)
    assert "no algebraic loop" in str(network8.network)


def test_elimination_by_measurement_makes_algebraic_loops_of_its_own():
    """Section 4.3.1: G25 / G45 of (4.31) has a direct term, and so may a way back to w4."""
    modules = dict(network8.network.modules)
    sets = node_sets(network8.network, 2)
    assert algebraic_loops(indirect_equations(network8.network, sets)) == []
    direct_back = dynamic_network(modules | {(4, 2): 0.3}, measured=network8.MEASURED)
    assert algebraic_loops(direct_back) == []
    found = algebraic_loops(indirect_equations(direct_back, node_sets(direct_back, 2)))
    assert [set(loop) for loop in found] == [{2, 4}]
    with pytest.raises(ModelError, match="eliminate without at= and omega="):
        algebraic_loops(indirect_equations(direct_back, sets, at=3))


def test_a_network_in_continuous_time_is_eliminated_and_judged_as_one():
    s = Rational.derivative()
    network = dynamic_network(
        {(1, 2): 1 / (s + 1), (2, 1): 2 / (s + 3), (1, 3): 1 / (s + 2), (3, 2): 4 / (s + 5)},
        measured=[1, 2],
    )
    assert network.variable == "s"
    assert "slowest pole s = " in str(network)
    kept = immerse(network, [1, 2]).module(1, 2)
    assert kept.equals(1 / (s + 1) + 4 / ((s + 2) * (s + 5)))
    omega = np.array([0.3, 2.0])
    complex_ones = immerse(network, [1, 2], omega=omega).module(1, 2)
    np.testing.assert_allclose(complex_ones, kept.response(1j * omega), rtol=1e-12)
    feedback = dynamic_network({(1, 2): 4 / (s + 1), (2, 1): 1 / (s + 3)})
    with pytest.raises(ModelError, match="right half plane.*lower a loop gain"):
        refuse_unstable(feedback)


def test_an_unstable_network_is_told_and_refused_where_moments_are_needed():
    network = dynamic_network({(1, 2): 1 / (q - 0.9), (2, 1): 0.5 / (q - 0.5)})
    assert not is_stable(network)
    assert "UNSTABLE: 1 of 2 poles" in str(network)
    with pytest.raises(ModelError, match="every module is stable. .* lower a loop gain"):
        refuse_unstable(network)


# -- refusals ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("modules", "options", "match"),
    [
        ({(1, 1): 1 / q}, {}, "G11 is a self loop; divide .* by 1 - G11 instead"),
        ({(1, 2): 1 / q}, {"nodes": [1]}, "joins the unknown node 2; the nodes are 1. Add it"),
        ({(1, 2): 1 / q}, {"nodes": [1, 2, 2]}, "node 2 is named twice; name every node once"),
        ({(1, 2): q}, {}, "module G12 = q is improper.* delay or filter it"),
        ({(1, 2): 1 / q}, {"measured": [3]}, "measured names 3, which is no node; choose among"),
        ({(1, 2): 1 / q}, {"excitations": [3]}, "excitations names 3, which is no node"),
        (
            {(1, 2): 1 / q},
            {"measured": [1], "sensor_noise": {2: 1.0}},
            "sensor_noise names 2, which is not measured; choose among 1",
        ),
        ({"12": 1 / q}, {}, "a module is named by \\(to, from\\), not by '12'"),
        ({(1, 2): "1/q"}, {}, "module G12: '1/q' is no transfer function; give a number"),
        (
            {(1, 2): 1 / Rational.shift(0.1), (2, 1): 1 / Rational.shift(0.2)},
            {},
            "sample times differ.*resample one",
        ),
        (
            {(1, 2): 1 / q, (2, 1): 1 / (Rational.derivative() + 1)},
            {},
            "bring both to discrete or both to continuous",
        ),
    ],
)
def test_what_is_no_network_is_refused_with_the_mend(modules, options, match):
    with pytest.raises(ModelError, match=match):
        dynamic_network(modules, **options)


def test_a_negative_variance_and_a_missing_module_are_refused():
    with pytest.raises(ModelError, match="variance of an external signal is -1.0; give >= 0"):
        Signal(-1.0)
    with pytest.raises(ModelError, match="value is given for G18, which no module has; .*G12"):
        network8.symbolic().substitute({"G18": 1})
    with pytest.raises(ModelError, match="there is no module G18 to take out"):
        network8.network.without((1, 8))
    with pytest.raises(ModelError, match="need a value for G12.* network.substitute"):
        network_states(network8.symbolic())


# -- drawing -----------------------------------------------------------------------------------


def test_the_drawing_marks_target_observed_unobserved_and_confounding_nodes():
    found = roles(network8.network, 2)
    assert {n for n, r in found.role.items() if r == "unobserved"} == {5, 6, 8}
    assert {c.node for c in found.confounders} == {6, 7}  # not tau_6 alone, as Example 3.4 says
    figure = network_figure(network8.network, 2)
    drawn = {trace.name: set(trace.text) for trace in figure.data}
    assert drawn == {
        "target": {"w2"},
        "predictor input": {"w1", "w3"},
        "observed": {"w4", "w7"},
        "unobserved": {"w5", "w6", "w8"},
        "confounding disturbance": {"w6", "w7"},
    }
    notes = [a.text for a in figure.layout.annotations if a.text]
    assert set(notes) == {f"G{i}{k}" for i, k in network8.network.modules} | {"delta_6"}
    assert len([a for a in figure.layout.annotations if a.showarrow]) == 13
