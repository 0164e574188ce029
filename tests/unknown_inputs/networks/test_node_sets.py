"""Statements of Linder (2017), chapters 3 and 4, by number, exact on random networks."""

from __future__ import annotations

from fractions import Fraction
from itertools import count, islice

import networkx as nx
import numpy as np
import pytest
import sympy

from casid.unknown_inputs.networks.confounders import disturbances_in, excitations_in
from casid.unknown_inputs.networks.elimination import immerse
from casid.unknown_inputs.networks.equations import node_equations
from casid.unknown_inputs.networks.graph import graph_of
from casid.unknown_inputs.networks.indirect_equations import (
    fully_eliminated,
    indirect_equations,
    partially_eliminated,
)
from casid.unknown_inputs.networks.network import dynamic_network
from casid.unknown_inputs.networks.node_recovery import recoverable, recovery_filters
from casid.unknown_inputs.networks.node_sets import node_sets
from casid.unknown_inputs.networks.random_equations import random_equations
from tests.support.network_blocks import blocks, column, signals, usable, usable_seeds
from tests.support.network_samples import point, random_module, random_network

NETWORKS = range(60)
NONE = Fraction(0)


def matrix(e, rows, columns):
    """The block of G as the network has it."""
    return sympy.Matrix(
        len(rows), len(columns), lambda i, k: sympy.Rational(str(e.module(rows[i], columns[k])))
    )


def inverse_block(f, unknown, measured):
    """The columns of a left inverse that belong to `measured`."""
    return sympy.Matrix(
        len(unknown),
        len(measured),
        lambda i, k: number(f.get((unknown[i], measured[k]), NONE)),
    )


def number(x):
    return sympy.Rational(str(x))


def reached_past(network, source, kept):
    """Nodes that `source` reaches on paths whose inner nodes are none of `kept`."""
    graph = graph_of(network)
    graph.remove_edges_from([(a, b) for a, b in graph.edges if a in kept and a != source])
    return {source} | nx.descendants(graph, source)


# -- chapter 3 ---------------------------------------------------------------------------------


def test_3_21_the_filters_of_the_immersed_network_have_the_zeros_of_its_pattern():
    """F = [F_jj 0 F_jA F_jU; 0 F_KK F_KA F_KU] over (j, K, A, U), F_KK diagonal; and (3.23): the
    effective noise of w_j holds F_jj tau_j alone of the kept nodes."""
    from_A = from_U = 0
    for seed in NETWORKS:
        network = random_network(seed)
        sets = node_sets(network, 1)
        e = immerse(random_equations(network, seed), (1, *sets.K))
        outside = {*sets.A, *sets.U}
        for n in e.nodes:
            assert set(e.F[n]) - outside == {n}, (seed, n)
        from_A += bool(set(e.F[1]) & set(sets.A))
        from_U += bool(set(e.F[1]) & set(sets.U))
    assert min(from_A, from_U) > 5


def test_3_21_the_immersed_modules_and_filters_are_those_of_the_schur_complement():
    """G_RR + G_RZ (I - G_ZZ)^-1 G_ZR and [I, G_RZ (I - G_ZZ)^-1], each row over one minus its
    diagonal entry."""
    for seed in NETWORKS:
        network = random_network(seed)
        sets = node_sets(network, 1)
        e = node_equations(network, **point(network, seed))
        R, Z = (1, *sets.K), (*sets.A, *sets.U)
        F = matrix(e, R, Z) * (sympy.eye(len(Z)) - matrix(e, Z, Z)).inv()
        G = matrix(e, R, R) + F * matrix(e, Z, R)
        found = immerse(e, R)
        for i, n in enumerate(R):
            scale = 1 - G[i, i]
            assert number(found.filter(n, n)) == 1 / scale
            for k, m in enumerate(R):
                assert number(found.module(n, m)) == (G[i, k] / scale if i != k else 0)
            for k, z in enumerate(Z):
                assert number(found.filter(n, z)) == F[i, k] / scale, (seed, n, z)


@pytest.mark.parametrize("keeps_A", [False, True])
def test_3_23_and_3_40_a_disturbance_reaches_the_rows_it_has_a_path_to_past_the_kept_nodes(keeps_A):
    """R_j and P_j as sets of paths; with all of S kept (3.38) those of K and A stay in their rows.

    Decided modulo a prime: what cancels for these modules would be seen, and nothing does.
    """
    shared = 0
    for seed in NETWORKS:
        network = random_network(seed)
        excited = dynamic_network(
            network.modules, nodes=network.nodes, measured=network.measured, excitations=(1, 2)
        )
        sets = node_sets(excited, 1)
        kept = (1, *sets.K, *sets.A) if keeps_A else (1, *sets.K)
        e = immerse(random_equations(excited, seed), kept)
        reach = {n: reached_past(excited, n, kept) for n in excited.nodes}
        for n in e.nodes:
            wanted = tuple(k for k in excited.nodes if n in reach[k] and (k == n or k not in kept))
            assert disturbances_in(excited, e, n) == wanted, (seed, n)
            assert excitations_in(excited, e, n) == tuple(k for k in wanted if k in (1, 2))
        if keeps_A:
            assert all(set(e.F[n]) - {n} <= set(sets.U) for n in e.nodes)
        shared += any(sum(u in e.F[n] for n in e.nodes) > 1 for u in sets.U)
    assert shared > 10


def test_3_43_the_unobserved_nodes_are_told_by_all_observed_ones():
    """w_U = (I - G_UU)^-1 (G_Uj w_j + G_UK w_K + G_UA w_A + delta_U + tau_U)."""
    several = 0
    for seed in NETWORKS:
        network = random_network(seed)
        sets = node_sets(network, 1)
        e = node_equations(network, **point(network, seed))
        inverse = (sympy.eye(len(sets.U)) - matrix(e, sets.U, sets.U)).inv()
        G = inverse * matrix(e, sets.U, sets.S)
        for i, u in enumerate(sets.U):
            found = immerse(e, (*sets.S, u))
            for k, s in enumerate(sets.S):
                assert number(found.module(u, s)) == G[i, k], (seed, u, s)
            for k, v in enumerate(sets.U):
                assert number(found.filter(u, v)) == inverse[i, k], (seed, u, v)
            assert set(found.F[u]) <= set(sets.U)
        several += len(sets.U) > 1
    assert several > 10


# -- chapter 4 ---------------------------------------------------------------------------------


def test_4_20_all_unobserved_nodes_are_told_by_the_additional_nodes_and_4_21_is_the_row():
    """w_U = f (-G_Aj w_j - G_AK w_K + (I - G_AA) w_A - delta_A - tau_A), put into w_j."""
    done = 0
    for seed in usable_seeds():
        _, sets, e = usable(seed)
        if len(recoverable(e, sets.U, sets.A)[0]) < len(sets.U):
            continue
        done += 1
        inverse = recovery_filters(e, sets.U, sets.A)
        f = inverse_block(inverse, sets.U, sets.A)
        w, outside = signals(e, np.random.default_rng(seed))
        j = (1,)
        G = {x + y: matrix(e, a, b) for x, a in _named(sets, j) for y, b in _named(sets, j)}
        unit = sympy.eye(len(sets.A))
        told = f * (
            -G["Aj"] * column(w, j)
            - G["AK"] * column(w, sets.K)
            + (unit - G["AA"]) * column(w, sets.A)
            - column(outside, sets.A)
        )
        assert told == column(w, sets.U), seed
        row, scale = fully_eliminated(e, sets), 1 + (G["jU"] * f * G["Aj"])[0]
        modules = {"K": G["jK"] - G["jU"] * f * G["AK"], "A": G["jU"] * f * (unit - G["AA"])}
        for x, nodes in (("K", sets.K), ("A", sets.A)):
            for k, n in enumerate(nodes):
                assert number(row.module(1, n)) == modules[x][0, k] / scale, (seed, n)
        assert not {*sets.K, *sets.U} & set(row.F[1])
    assert done > 20


def _named(sets, j):
    return (("j", j), ("K", sets.K), ("A", sets.A), ("U", sets.U))


def with_direct_sensors(seed):
    """A random network in which every unknown predictor input of node 1 has direct sensors.

    As many new nodes as there are such inputs, each fed by one or two of them alone.
    """
    rng = np.random.default_rng(seed)
    network = random_network(seed)
    sU = node_sets(network, 1).sU
    new = tuple(range(100, 100 + len(sU)))
    modules = dict(network.modules)
    for k, d in enumerate(new):
        for u in {sU[k], sU[int(rng.integers(len(sU)))]}:
            modules[d, u] = random_module(rng)
    measured = (*network.measured, *new)
    found = dynamic_network(modules, nodes=(*network.nodes, *new), measured=measured)
    return found, node_sets(found, 1, known=found.modules, direct=new, indirect=())


def test_4_26_with_direct_observations_alone_the_row_is_the_nodes_own_with_w_sU_put_in():
    """w_j = G_jK w_K + G_jsU f w_D + delta_j + tau_j - G_jsU f (delta_D + tau_D)."""
    unknown = (seed for seed in count() if node_sets(random_network(seed), 1).sU)
    done = 0
    for seed in islice(unknown, 60):
        network, sets = with_direct_sensors(seed)
        e = node_equations(network, **point(network, seed))
        if len(recoverable(e, sets.sU, sets.D)[0]) < len(sets.sU):
            continue  # two sensors may be fed alike
        done += 1
        f = recovery_filters(e, sets.sU, sets.D)
        row = indirect_equations(e, sets)
        gains = {
            d: sum((e.module(1, u) * f.get((u, d), NONE) for u in sets.sU), NONE) for d in sets.D
        }
        assert {k: row.module(1, k) for k in sets.K} == {k: e.module(1, k) for k in sets.K}
        assert {d: row.module(1, d) for d in sets.D} == gains
        assert set(row.G[1]) <= {*sets.K, *sets.D}
        filters = {d: -g for d, g in gains.items() if g} | {1: Fraction(1)}
        assert row.F[1] == filters, seed
    assert done > 40


def test_4_28_without_direct_observations_and_other_unknown_nodes_the_row_is_local():
    """G_IUt = 0: w_j = N0 [(G_jK - J G_IK) w_K - J G_IO w_O + J (I - G_II) w_I + delta_j + tau_j
    - J (delta_I + tau_I)], J = G_jsU f, N0 = (1 + J G_Ij)^-1: no other node's disturbance."""
    done = looped = 0
    for seed in usable_seeds():
        network, sets, _ = usable(seed)
        if sets.D:
            continue
        cut = network.without(
            *[(i, u) for i in sets.I for u in sets.Ut if (i, u) in network.modules]
        )
        now = node_sets(cut, 1, direct=(), indirect=sets.I)
        e = node_equations(cut, **point(cut, seed))
        done += 1
        f = recovery_filters(e, now.sU, now.I)
        inverse = inverse_block(f, now.sU, now.I)
        J = matrix(e, (1,), now.sU) * inverse
        N0 = 1 / (1 + (J * matrix(e, now.I, (1,)))[0])
        row = indirect_equations(e, now)
        wanted = {
            "K": N0 * (matrix(e, (1,), now.K) - J * matrix(e, now.I, now.K)),
            "O": -N0 * J * matrix(e, now.I, now.O),
            "I": N0 * J * (sympy.eye(len(now.I)) - matrix(e, now.I, now.I)),
        }
        for x, nodes in (("K", now.K), ("O", now.O), ("I", now.I)):
            assert [number(row.module(1, n)) for n in nodes] == list(wanted[x]), (seed, x)
        assert number(row.filter(1, 1)) == N0
        assert [number(row.filter(1, n)) for n in now.I] == list(-N0 * J)
        assert set(row.F[1]) <= {1, *now.I}
        looped += N0 != 1
    assert done > 30
    assert looped > 10


def test_4_39_and_4_40_the_remaining_unobserved_nodes_by_nodes_and_disturbances():
    """w_Ut = Q [sum_X Gb_UX w_X + delta_Ut + tau_Ut - V f_D (delta_D + tau_D) - V f_I (delta_I +
    tau_I)] with Q = (I - Gb_UU)^-1, as a statement on signals; and Gb_UX, entry by entry, is what
    the partly eliminated network (4.23) has for these nodes."""
    done = 0
    for seed in usable_seeds()[:120]:
        _, sets, e = usable(seed)
        if not sets.Ut:
            continue
        done += 1
        f = recovery_filters(e, sets.sU, (*sets.D, *sets.I))
        names, _, own, _, _ = blocks(e, f, sets)
        V, Q, Gb = own["V"], own["Q"], own["Ub"]
        fD = inverse_block(f, sets.sU, sets.D)
        w, outside = signals(e, np.random.default_rng(seed))
        total = column(outside, sets.Ut)
        total -= V * fD * column(outside, sets.D) + V * own["fI"] * column(outside, sets.I)
        for x in "jKOID":
            total += Gb[x] * column(w, names[x])
        assert Q * total == column(w, sets.Ut), seed
        partial = partially_eliminated(e, sets)
        for i, u in enumerate(sets.Ut):
            scale = 1 - Gb["U"][i, i]  # its row is normalised
            for x in "jKOIDU":
                for k, n in enumerate(names[x]):
                    if n != u:
                        assert number(partial.module(u, n)) == Gb[x][i, k] / scale, (seed, u, n)
    assert done > 40
