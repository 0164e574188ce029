"""What must be known for the rest to be told is a matroid: bases, their complements, components."""

from __future__ import annotations

import json
from itertools import combinations
from math import comb

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from casid.algebra.prime_field import echelon, matmul, null_space, rank
from casid.errors import IdentifiabilityError
from casid.identifiability.combinations.fixing_sets import (
    confounded_groups,
    count_not_identifiable,
    fixing_sets,
    joined,
)
from casid.identifiability.equations.equation_file import read_equations
from casid.identifiability.rank.observability import observability
from tests.support.shared import shared

P = 1_073_741_827  # the least prime above 2^30


def names_of(matrix):
    return [f"p{j}" for j in range(matrix.shape[1])]


def scalings(*exponents):
    """What the outputs tell where they see only monomials theta^e: the logarithmic Jacobian."""
    return np.array(exponents, dtype=np.int64) % P


@st.composite
def informations(draw):
    """Small matrices whose entries are mostly zero, so that every kind of matroid turns up."""
    rows, columns = draw(st.integers(0, 5)), draw(st.integers(1, 7))
    entries = st.sampled_from([0, 0, 0, 1, 1, 2, P - 1, 12345])
    values = draw(st.lists(entries, min_size=rows * columns, max_size=rows * columns))
    return np.array(values, dtype=np.int64).reshape(rows, columns)


def fixes(information, chosen):
    """Knowing `chosen` leaves no direction: the null space meets theirs in zero only."""
    n = information.shape[1]
    known = np.zeros((len(chosen), n), dtype=np.int64)
    known[range(len(chosen)), list(chosen)] = 1
    return rank(np.vstack([information, known]), P) == n


@given(informations())
def test_fixing_sets_are_all_that_brute_force_finds(information):
    names, n = names_of(information), information.shape[1]
    deficiency = n - rank(information, P)
    expected = [
        tuple(names[j] for j in s)
        for s in combinations(range(n), deficiency)
        if fixes(information, s)
    ]
    found = fixing_sets(information, names, P)
    assert sorted(found.sets) == sorted(expected)
    assert found.size == deficiency
    assert (found.count, found.is_count_exact, found.is_cut) == (len(expected), True, False)


@given(informations())
def test_no_fixing_set_can_do_without_a_member(information):
    names = names_of(information)
    for chosen in fixing_sets(information, names, P).sets:
        positions = [names.index(n) for n in chosen]
        assert fixes(information, positions)
        for left_out in positions:
            assert not fixes(information, [j for j in positions if j != left_out])


@given(informations())
def test_of_two_fixing_sets_a_member_can_be_exchanged(information):
    """The exchange axiom of bases (Oxley 2011, section 1.2)."""
    sets = {frozenset(s) for s in fixing_sets(information, names_of(information), P).sets}
    for a, b in combinations(sets, 2):
        for x in a - b:
            assert any((a - {x}) | {y} in sets for y in b - a)


@given(informations(), st.randoms(use_true_random=False))
def test_what_is_confounded_does_not_depend_on_how_the_rows_are_combined(information, random):
    """Other outputs that say the same: rows multiplied by a regular matrix."""
    names, r = names_of(information), information.shape[0]
    mix = np.array([[random.randrange(P) for _ in range(r)] for _ in range(r)], dtype=np.int64)
    mixed = matmul(mix.reshape(r, r), information, P)
    if rank(mix.reshape(r, r), P) == r:
        assert fixing_sets(mixed, names, P) == fixing_sets(information, names, P)
        assert confounded_groups(mixed, names, P) == confounded_groups(information, names, P)


@given(informations())
def test_groups_are_tied_by_the_circuits_of_the_null_space(information):
    """Two are in one component exactly if a circuit holds both (Oxley 2011, section 4.1)."""
    names, null = names_of(information), null_space(information, P)
    n = len(names)

    def is_circuit(s):
        return rank(null[:, s], P) == len(s) - 1 and all(
            rank(null[:, [j for j in s if j != i]], P) == len(s) - 1 for i in s
        )

    tied = {frozenset((i,)) for i in range(n) if null[:, i].any()}
    for size in range(2, n + 1):
        for s in filter(is_circuit, combinations(range(n), size)):
            merged = frozenset(s).union(*(g for g in tied if g & set(s)))
            tied = {g for g in tied if not g & set(s)} | {merged}
    expected = sorted(tuple(sorted(g)) for g in tied)
    assert [tuple(names.index(x) for x in g) for g in confounded_groups(information, names, P)] == (
        expected
    )


@given(informations(), st.integers(0, 4), st.integers(0, 2))
def test_column_exclusion_is_the_rank_with_the_known_columns_left_out(information, size, n_states):
    n_states = min(n_states, information.shape[1])
    names = [f"p{j}" for j in range(information.shape[1] - n_states)]
    expected = []
    for s in combinations(range(len(names)), size):
        columns = [*range(n_states), *(n_states + j for j in s)]
        if rank(information[:, columns], P) < n_states + size:
            expected.append(tuple(names[j] for j in s))
    found = count_not_identifiable(information, n_states, names, size, P)
    assert (found.failing, found.total) == (tuple(expected), comb(len(names), size))


def test_a_mass_damper_spring_tells_ratios_and_any_one_parameter_mends_it():
    """m x'' + d x' + k x = b u: d/m, k/m and b/m, hence one group and four fixing sets."""
    information = scalings([-1, 1, 0, 0], [-1, 0, 1, 0], [-1, 0, 0, 1])
    names = ["m", "d", "k", "b"]
    found = fixing_sets(information, names, P)
    assert confounded_groups(information, names, P) == (("m", "d", "k", "b"),)
    assert found.sets == (("m",), ("d",), ("k",), ("b",))
    assert "4 minimal fixing sets of 1" in str(found)


def test_groups_multiply():
    """akt_fujita's pattern of groups: 1 alone, 2 of 3, 1 of 5 give 1 x 3 x 5 = 15 fixing sets."""
    information = np.zeros((5, 9), dtype=np.int64)
    information[0, 1:4] = 1, 2, 3
    for i in range(4):
        information[1 + i, [4, 5 + i]] = 1, P - 1
    names = names_of(information)
    found = fixing_sets(information, names, P)
    assert found.groups == (("p0",), ("p1", "p2", "p3"), ("p4", "p5", "p6", "p7", "p8"))
    assert (found.size, found.count, len(set(found.sets))) == (4, 15, 15)
    assert found.group_sizes == (1, 2, 1)
    assert found.sets[0] == ("p0", "p1", "p2", "p4")


def test_names_in_a_set_are_in_the_order_of_declaration_across_groups():
    information = scalings([1, 0, 1, 0], [0, 1, 0, 1])
    assert fixing_sets(information, ["a", "b", "c", "d"], P).sets == (
        ("a", "b"),
        ("a", "d"),
        ("b", "c"),
        ("c", "d"),
    )


def test_where_all_is_identifiable_nothing_needs_to_be_known():
    found = fixing_sets(np.eye(3, dtype=np.int64), ["a", "b", "c"], P)
    assert (found.sets, found.size, found.count) == (((),), 0, 1)
    assert "all parameters are identifiable" in str(found)


def test_a_list_that_is_cut_still_counts_and_says_so():
    """Generic information of rank 3 on 9 parameters: every 6 of 9 fix, in each of two groups."""
    rng = np.random.default_rng(3)
    block = rng.integers(1, P, (3, 9))
    information = np.block([[block, np.zeros_like(block)], [np.zeros_like(block), block]])
    names = names_of(information)
    found = fixing_sets(information, names, P, limit=100)
    assert (found.count, found.is_count_exact, found.is_cut) == (comb(9, 6) ** 2, True, True)
    assert len(found.sets) == 100
    assert "raise limit" in str(found)
    less = fixing_sets(information, names, P, limit=50)
    assert not less.is_count_exact
    assert 51**2 == less.count < found.count
    assert "at least" in str(less)


def test_a_hidden_state_makes_every_subset_fail():
    """The thesis asks for the states, too: rank O[:, x U S] = n + len(S)."""
    full = np.array([[0, 1, 0], [0, 0, 1]], dtype=np.int64)  # state | a, b
    assert count_not_identifiable(full, 1, ["a", "b"], 1, P).count == 2
    assert count_not_identifiable(full[:, 1:], 0, ["a", "b"], 2, P).count == 0


def test_experiments_share_parameters_and_not_states():
    """y = x0 + a tells the sum; a second experiment with x0 seen by itself tells a."""
    one, two = np.array([[1, 1]]), np.array([[1, 0], [0, 1]])
    full, n_states = joined([one, two], [1, 1], P)
    assert full.tolist() == [[1, 0, 1], [0, 1, 0], [0, 0, 1]]
    assert count_not_identifiable(full, n_states, ["a"], 1, P).count == 0
    assert count_not_identifiable(one, 1, ["a"], 1, P).count == 1


def test_the_ship_with_one_record_is_table_8_1_of_the_thesis():
    """Table 8.1 (digest 8.3): 20 of 165, 115 of 330, 296 of 462 sets of 3, 4, 5 parameters fail.

    One record tells five coefficients of (8.10), z_s a known constant and K_ur the parameter:
    (k + S g, d, K_vdot + S, K_ur + S, K_delta) / A_1 with S and A_1 of (8.11). Up to a regular
    factor the rows of their Jacobian are A_1 dN - N dA_1.
    """
    rng = np.random.default_rng(8)
    M, zg, k, A, d, Kr, Kv, Kd, zf, m, zm, g = (int(v) for v in rng.integers(1, P, 12))
    names = ["M", "z_g", "k", "A_x", "d", "K_ur", "K_vdot", "K_delta", "z_f", "m", "z_m"]
    G, Z = zg + zf, zm + zf
    S, A1 = M * G + m * Z, A + M * G**2 + m * Z**2
    dS = np.array([G, M, 0, 0, 0, 0, 0, 0, M + m, Z, m], dtype=object)
    dA1 = np.array(
        [G**2, 2 * M * G, 0, 1, 0, 0, 0, 0, 2 * M * G + 2 * m * Z, Z**2, 2 * m * Z], dtype=object
    )
    e = dict(zip(names, np.eye(11, dtype=int).astype(object), strict=True))
    numerators = [
        (k + S * g, e["k"] + g * dS),
        (d, e["d"]),
        (Kv + S, e["K_vdot"] + dS),
        (Kr + S, e["K_ur"] + dS),
        (Kd, e["K_delta"]),
    ]
    jacobian = np.array(
        [[v % P for v in A1 * dN - N * dA1] for N, dN in numerators], dtype=np.int64
    )
    assert len(echelon(jacobian, P)[1]) == 5
    failing = {s: count_not_identifiable(jacobian, 0, names, s, P).failing for s in (1, 2, 3, 4, 5)}
    assert [len(failing[s]) for s in failing] == [0, 0, 20, 115, 296]
    shape = {"A_x", "M", "z_g", "m", "z_m", "z_f"}
    for s in (3, 4, 5):
        for subset in combinations(names, s):
            a = len(shape & set(subset)) >= 3
            b = {"k", "K_ur", "K_vdot"} <= set(subset) and len(shape & set(subset)) >= 2
            assert (subset in failing[s]) == (a or b)


def test_a_name_that_is_no_parameter_is_refused_with_the_nearest():
    full, names = np.eye(2, dtype=np.int64), ["mass", "damping"]
    with pytest.raises(IdentifiabilityError, match="no parameter 'mas'.*mass"):
        count_not_identifiable(full, 0, names, 1, P, among=["mas"])


def test_more_subsets_than_the_limit_are_refused_with_what_to_do():
    full = np.eye(40, dtype=np.int64)
    with pytest.raises(IdentifiabilityError, match="narrow them with among, or raise limit"):
        count_not_identifiable(full, 0, names_of(full), 20, P)


def test_a_matrix_that_does_not_fit_the_names_is_refused():
    with pytest.raises(IdentifiabilityError, match="one column for each parameter"):
        fixing_sets(np.eye(3, dtype=np.int64), ["a"], P)


@pytest.mark.parametrize(
    "name",
    ["akt_fujita", "cgv1990", "crauste", "goodwin", "hiv_wodarz", "jakstat", "kd1999", "llw"]
    + ["nfkb_full", "qy", "seaijrc", "siwr1"],
)
def test_groups_and_fixing_sets_of_published_models_are_the_known_ones(name):
    path = shared(f"identifiability/{name}.json")
    expected = json.loads(path.read_text(encoding="utf-8"))["expected"]
    point = observability(read_equations(path).systems).points[0]
    names, p = point.parameters, point.prime
    found = fixing_sets(point.information, names, p)
    groups = confounded_groups(point.information, names, p)
    assert [list(g) for g in groups] == expected["confounded_groups"]
    assert found.size == expected["parameter_deficiency"]
    assert found.count == (expected["number_of_minimal_fixing_sets"] or 1)
    assert tuple(expected["example_fixing_set"] or ()) in found.sets
