"""Elimination of unknown nodes: the thesis's examples, and identities on random networks."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import sympy

from casid.algebra.rational import Rational
from casid.errors import ModelError
from casid.unknown_inputs.networks.elimination import immerse
from casid.unknown_inputs.networks.equations import node_equations
from casid.unknown_inputs.networks.indirect_equations import (
    eliminate_by_measurement,
    fully_eliminated,
    indirect_equations,
    partially_eliminated,
)
from casid.unknown_inputs.networks.network import dynamic_network
from casid.unknown_inputs.networks.node_recovery import recoverable, recovery_filters
from casid.unknown_inputs.networks.node_sets import node_sets
from casid.unknown_inputs.networks.recursive_elimination import eliminate_recursively
from problems import network8
from tests.support.network_blocks import blocks, column, signals, usable, usable_seeds

q = Rational.shift()
SYMBOLIC = network8.symbolic()
G = {edge: sympy.Symbol(f"G{edge[0]}{edge[1]}") for edge in network8.TABLE_6_1}
G12, G17, G21, G23, G25, G36, G41, G45, G52, G58, G76, G86, G87 = G.values()
D = 1 - G25 * G52


def assert_row(equations, node, modules, filters):
    """The whole row: these modules and filters of delta + tau, and no others."""
    for rows, wanted, read in (
        (equations.G, modules, equations.module),
        (equations.F, filters, equations.filter),
    ):
        assert set(rows[node]) == set(wanted), node
        for k, expression in wanted.items():
            assert read(node, k).equals(expression), (node, k)


# -- the thesis's examples ---------------------------------------------------------------------


def test_example_3_4_the_immersed_network_of_target_and_known_inputs_is_3_24():
    e = immerse(SYMBOLIC, [1, 2, 3])
    assert_row(e, 1, {2: G12}, {1: 1, 7: G17, 6: G17 * G76})
    noise = {2: 1, 5: G25, 8: G25 * G58, 7: G25 * G58 * G87, 6: G25 * G58 * (G86 + G87 * G76)}
    assert_row(e, 2, {1: G21 / D, 3: G23 / D}, {k: f / D for k, f in noise.items()})
    assert_row(e, 3, {}, {3: 1, 6: G36})


def test_example_3_7_the_immersed_network_of_all_observable_nodes_is_3_41():
    e = immerse(SYMBOLIC, network8.MEASURED)
    assert_row(e, 1, {2: G12, 7: G17}, {1: 1})
    noise = {2: 1, 5: G25, 8: G25 * G58, 6: G25 * G58 * G86}
    assert_row(
        e,
        2,
        {1: G21 / D, 3: G23 / D, 7: G25 * G58 * G87 / D},
        {k: f / D for k, f in noise.items()},
    )
    assert_row(e, 3, {}, {3: 1, 6: G36})
    assert_row(
        e,
        4,
        {1: G41, 2: G45 * G52, 7: G45 * G58 * G87},
        {4: 1, 5: G45, 8: G45 * G58, 6: G45 * G58 * G86},
    )
    assert_row(e, 7, {}, {7: 1, 6: G76})


def test_example_4_1_the_indirect_model_is_4_31_and_its_other_rows_are_those_of_3_41():
    sets = node_sets(SYMBOLIC, 2)
    e, immersed = indirect_equations(SYMBOLIC, sets), immerse(SYMBOLIC, network8.MEASURED)
    assert_row(e, 2, {1: G21 - G25 * G41 / G45, 3: G23, 4: G25 / G45}, {2: 1, 4: -G25 / G45})
    for n in (1, 3, 4, 7):
        assert_row(
            e,
            n,
            {k: immersed.module(n, k).expression() for k in immersed.G[n]},
            {k: immersed.filter(n, k).expression() for k in immersed.F[n]},
        )


def test_the_indirect_row_of_table_6_1_is_proper_and_stable():
    """G25 / G45 = (b25 / b45) (1 - a45 q^-1) / (1 - a25 q^-1), section 6.1."""
    found = indirect_equations(network8.network, node_sets(network8.network, 2)).module(2, 4)
    assert found.equals(Fraction(20, 17) * (q - 0.75) / (q - 0.89))
    assert found.is_proper
    assert found.is_stable
    assert found.Ts == 1.0


def test_partial_elimination_leaves_the_other_unknown_nodes_in_place():
    """(4.30): after w5 is gone, w6 and w8 are still there, and w2 does not see them."""
    e = partially_eliminated(SYMBOLIC, node_sets(SYMBOLIC, 2))
    assert e.eliminated == (5,)
    assert set(e.nodes) == {1, 2, 3, 4, 6, 7, 8}
    assert set(e.G[4]) == {1, 2, 8}
    assert not {6, 8} & set(e.G[2])


# -- random networks, exact at a random rational q ---------------------------------------------


def assert_obeyed(e, w, externals, what):
    for n in e.nodes:
        right = sum((g * w[k] for k, g in e.G[n].items()), Fraction(0))
        right += sum((f * externals[k] for k, f in e.F[n].items()), Fraction(0))
        assert right == w[n], (what, n)


@pytest.mark.parametrize("part", [*(pytest.param(p, marks=pytest.mark.slow) for p in (0, 1, 2)), 3])
def test_the_signals_of_a_network_obey_its_equations_after_every_elimination(part):
    """Immersed to any nodes, partially, completely and fully eliminated."""
    full = 0
    for seed in usable_seeds()[part::4]:
        network, sets, e = usable(seed)
        rng = np.random.default_rng(seed)
        w, externals = signals(e, rng)
        assert_obeyed(e, w, externals, "the network itself")
        keep = [n for n in e.nodes if rng.random() < 0.5]
        assert_obeyed(immerse(e, keep), w, externals, "immersed")
        assert_obeyed(partially_eliminated(e, sets), w, externals, "partial")
        assert_obeyed(indirect_equations(e, sets), w, externals, "indirect")
        if len(recoverable(e, sets.U, sets.A)[0]) == len(sets.U):
            found = fully_eliminated(e, sets)
            assert_obeyed(found, w, externals, "full")
            assert set(found.nodes) == set(sets.S)
            # (4.21): tau_U is fully captured by w_A
            assert not set(found.F[1]) & set(sets.U)
            full += 1
    assert full > 5


@pytest.mark.parametrize("part", range(4))
def test_eliminations_in_either_order_agree(part):
    """Unknown inputs first by measurement, then the rest by immersion, or the reverse (4.2).

    So do the rows of all nodes that are no observation themselves.
    """
    for seed in usable_seeds()[part::4]:
        _, sets, e = usable(seed)
        first = indirect_equations(e, sets)
        immersed = immerse(e, [n for n in e.nodes if n not in sets.Ut])
        second = eliminate_by_measurement(immersed, sets.sU, (*sets.D, *sets.I))
        for n in (1, *sets.K, *sets.O):
            assert first.G[n] == second.G[n], (seed, n)
            assert first.F[n] == second.F[n], (seed, n)


@pytest.mark.parametrize("part", range(4))
def test_nodes_may_be_immersed_in_any_order(part):
    for seed in usable_seeds()[part::4]:
        network, _, e = usable(seed)
        rng = np.random.default_rng(seed)
        keep = [1, *(n for n in e.nodes[1:] if rng.random() < 0.4)]
        at_once = immerse(e, keep)
        step = e
        for n in rng.permutation([n for n in e.nodes if n not in keep]):
            step = immerse(step, [k for k in step.nodes if k != n])
        assert at_once.G == step.G, seed
        assert at_once.F == step.F, seed


@pytest.mark.parametrize("part", range(4))
def test_the_indirect_row_is_that_of_4_24_and_4_33_to_4_43(part):
    for seed in usable_seeds()[part::4]:
        _, sets, e = usable(seed)
        f = recovery_filters(e, sets.sU, (*sets.D, *sets.I))
        names, _, _, Gt, Ft = blocks(e, f, sets)
        row = indirect_equations(e, sets)
        for found, read in ((Gt, row.module), (Ft, row.filter)):
            for x, entries in found.items():
                for k, value in zip(names[x], entries, strict=True):
                    assert sympy.Rational(str(read(1, k))) == value, (seed, x, k)


@pytest.mark.parametrize("part", range(4))
def test_6_9_holds_with_the_corrected_factor_and_signs_and_not_as_printed(part):
    """The expanded identity (6.9). Printed are another left factor, and plus for minus before
    F_jI (w_I - delta_I - tau_I) and F_jD (w_D - delta_D - tau_D)."""
    printed_holds = with_direct = with_remaining = 0
    for seed in usable_seeds()[part::4]:
        _, sets, e = usable(seed)
        f = recovery_filters(e, sets.sU, (*sets.D, *sets.I))
        names, G, own, Gt, Ft = blocks(e, f, sets)
        w, externals = signals(e, np.random.default_rng(seed))
        at = {x: column(w, names[x]) for x in names}
        outside = {x: column(externals, names[x]) for x in names}
        J, V, Q, fI = (own[x] for x in ("J", "V", "Q", "fI"))

        def right(L, sign, G=G, J=J, V=V, Q=Q, fI=fI, Gt=Gt, Ft=Ft, at=at, outside=outside):
            total = Gt["K"] * at["K"] + Gt["O"] * at["O"]
            for x in "ID":
                inner = J * G(f"I{x}") + J * G("IU") * Q * (G(f"U{x}") - V * fI * G(f"I{x}"))
                total += -L * inner * at[x] + sign * Ft[x] * (at[x] - outside[x])
            return total + Ft["j"] * outside["j"] + Ft["U"] * outside["U"]

        one = sympy.eye(1)
        L = (one + J * G("Ij") + J * G("IU") * Q * own["Ub"]["j"]).inv()
        assert right(L, -1) == at["j"], seed
        printed = one + J * G("Ij") - J * G("IU") * own["Ub"]["j"]
        printed_holds += printed[0] != 0 and right(printed.inv(), +1) == at["j"]
        with_direct += bool(sets.D)
        with_remaining += not G("IU").is_zero_matrix
    assert printed_holds == 0
    assert with_direct > 0
    assert with_remaining > 10


def test_frequencies_and_symbols_and_exact_numbers_give_the_same_elimination():
    network = network8.network
    sets = node_sets(network, 2)
    omega = np.array([0.05, 0.4, 2.0])
    complex_ones = indirect_equations(network, sets, omega=omega)
    symbolic = indirect_equations(network, sets)
    exact = indirect_equations(network, sets, at=Fraction(7, 3))
    for n in symbolic.nodes:
        for k in symbolic.G[n]:
            g = symbolic.module(n, k)
            np.testing.assert_allclose(
                complex_ones.module(n, k), g.frequency_response(omega), rtol=1e-9
            )
            assert exact.module(n, k) == g.at(Fraction(7, 3))
        for k in symbolic.F[n]:
            assert exact.filter(n, k) == symbolic.filter(n, k).at(Fraction(7, 3))


def test_a_tall_left_inverse_may_be_chosen_and_is_checked():
    """Two observations of one unknown input: any f with f G = 1 gives an equation that holds."""
    network = dynamic_network(
        {(1, 2): 1 / (q - 0.5), (3, 2): 2 / q, (4, 2): 1 / q, (2, 1): 0.3 / q},
        measured=[1, 3, 4],
    )
    sets = node_sets(network, 1)
    assert sets.I == (3, 4)
    half = {(2, 3): q / 4, (2, 4): q / 2}
    found = indirect_equations(network, sets, filters=half)
    assert found.module(1, 3).equals(q / 4 / (q - 0.5))
    assert found.module(1, 4).equals(q / 2 / (q - 0.5))
    first = indirect_equations(network, sets)
    assert set(first.G[1]) == {3}
    with pytest.raises(ModelError, match=r"no left inverse: f G has 2 .* needs 1.*Leave out"):
        indirect_equations(network, sets, filters={(2, 3): q / 2, (2, 4): q})
    with pytest.raises(ModelError, match="name it \\(unknown, measured\\)"):
        indirect_equations(network, sets, filters={(3, 2): q / 2})


# -- recursive elimination ---------------------------------------------------------------------


def chain(rings: int):
    """Unknown u1 acts on the target; u(k+1) acts on the sensor a(k) of u(k), ring after ring."""
    modules = {("j", "u1"): 0.5 / (q - 0.1)}
    for k in range(1, rings + 1):
        modules |= {(f"a{k}", f"u{k}"): 0.4 / (q - 0.3), (f"u{k}", "j"): 0.1 / (q - 0.05 * k)}
        if k < rings:
            modules[f"a{k}", f"u{k + 1}"] = 0.3 / (q - 0.2 - 0.1 * k)
    eyes = ["j", *(f"a{k}" for k in range(1, rings + 1))]
    return dynamic_network(modules, measured=eyes)


def test_rings_are_eliminated_until_no_unobserved_node_is_left_and_the_model_grows():
    """Figure 4.2: each ring brings in one more measured node and one more module."""
    found = eliminate_recursively(chain(4), "j")
    assert [r.eliminated for r in found.steps] == [(), ("u1",), ("u2",), ("u3",), ("u4",)]
    assert [r.by for r in found.steps] == [(), ("a1",), ("a2",), ("a3",), ("a4",)]
    assert found.steps[-1].unobserved == ()
    assert found.immersed == ()
    assert [len(r.involved) for r in found.steps] == [1, 2, 3, 4, 5]
    degrees = [r.degree for r in found.steps]
    assert degrees == sorted(degrees)
    assert set(found.steps[-1].inputs) == {"a1", "a2", "a3", "a4"}
    # tau of unknown nodes is in none of it
    assert not {n for n in found.steps[-1].externals if n.startswith("u")}


def test_recursion_ends_by_immersing_what_no_measurement_is_left_for():
    network = chain(3).with_sensors(["j", "a1", "a2"])
    found = eliminate_recursively(network, "j")
    assert found.immersed == ("u3",)
    assert found.steps[-1].by == ()
    assert "a sensor on a node that they act on would" in str(found)
    assert "u3" in found.steps[-1].externals


def test_recursion_on_the_eight_nodes_ends_after_one_ring_at_4_31():
    found = eliminate_recursively(network8.network, 2)
    assert [r.eliminated for r in found.steps] == [(), (5,)]
    assert found.steps[1].inputs == (1, 3, 4)
    assert found.steps[1].degree == 4  # poles 0.91, 0.53, 0.89 and that of G41
    assert eliminate_recursively(SYMBOLIC, 2).steps[1].degree is None


# -- refusals ----------------------------------------------------------------------------------


def test_a_rank_deficient_measurement_names_the_inputs_that_cannot_be_recovered():
    """Two unknown inputs reach one sensor, or two sensors by proportional modules."""
    modules = {(1, 2): 1 / q, (1, 3): 1 / (q - 0.5), (4, 2): 1 / q, (4, 3): 2 / q}
    network = dynamic_network(modules, measured=[1, 4])
    with pytest.raises(ModelError, match=r"w2, w3 cannot be recovered from w4:.*1 of 2.*Measure"):
        indirect_equations(network, node_sets(network, 1))
    modules |= {(5, 2): 3 / q, (5, 3): 6 / q}
    network = dynamic_network(modules, measured=[1, 4, 5])
    with pytest.raises(ModelError, match=r"w2, w3 cannot be recovered from w4, w5"):
        indirect_equations(network, node_sets(network, 1))
    more = dynamic_network(modules | {(1, 6): 1 / q, (5, 3): 6 / (q - 0.1)}, measured=[1, 4, 5])
    with pytest.raises(ModelError, match=r"w6 cannot be recovered from w4, w5"):  # w2, w3 can
        indirect_equations(more, node_sets(more, 1))
    mended = dynamic_network(modules | {(5, 3): 6 / (q - 0.1)}, measured=[1, 4, 5])
    assert set(indirect_equations(mended, node_sets(mended, 1)).G[1]) == {4, 5}


def test_keeping_a_node_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(ModelError, match="w9 cannot be kept: .* there are w1, w2, w3"):
        immerse(SYMBOLIC, [1, 9])
    with pytest.raises(ModelError, match="w5 has no equation any more; left are w1, w2"):
        immerse(SYMBOLIC, [1, 2]).module(5, 1)


def test_exact_and_complex_fields_need_a_value_for_every_symbol():
    with pytest.raises(ModelError, match="module G12: .*give a value for G12"):
        node_equations(SYMBOLIC, at=2)
    with pytest.raises(ModelError, match=r"module G12: .* substitute"):
        node_equations(SYMBOLIC, omega=[0.1])
    with pytest.raises(ModelError, match="module G12: q = 11/100 is a pole of .* another point"):
        node_equations(network8.network, at=Fraction(11, 100))
