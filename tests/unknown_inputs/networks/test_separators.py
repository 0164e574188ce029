"""The bound that leads the search for predictor inputs: disjoint open paths (Menger's theorem)."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from casid.algebra.modular_integer import PRIME, ModularInteger
from casid.unknown_inputs.networks.confounders import confounders
from casid.unknown_inputs.networks.elimination import immerse
from casid.unknown_inputs.networks.equations import node_equations
from casid.unknown_inputs.networks.graph import network_readers
from casid.unknown_inputs.networks.propositions import open_path
from casid.unknown_inputs.networks.random_equations import random_equations
from casid.unknown_inputs.networks.separators import disjoint_open_paths
from tests.support.network_samples import point, random_network


@pytest.mark.parametrize("part", range(4))
def test_as_many_nodes_are_missing_as_there_are_disjoint_open_paths(part):
    """The least number of measured nodes that block is the greatest number of disjoint paths."""
    for seed in range(part, 80, 4):
        network = random_network(seed)
        readers = network_readers(network)
        for j, i in network.modules:
            others = [n for n in network.nodes if n not in (i, j) and n in network.measured]
            sizes = [
                size
                for size in range(len(others) + 1)
                for more in combinations(others, size)
                if open_path(network, j, i, {i, *more}) == ((), ())
            ]
            wanted = min(sizes, default=float("inf"))
            assert disjoint_open_paths(readers, j, i, {i}, set(others)) == wanted, (seed, j, i)


def test_residues_compute_as_fractions_do():
    rng = np.random.default_rng(3)
    for _ in range(20):
        a, b, c = (int(x) for x in rng.integers(1, 10**6, 3))
        x, y, z = ModularInteger(a), ModularInteger(b), ModularInteger(c)
        left = (x / y + z) * y - x
        assert left.value == b * c % PRIME
        assert ((-x) + x).value == 0


@pytest.mark.parametrize("seed", range(20))
def test_what_vanishes_at_a_random_residue_vanishes_at_a_random_rational(seed):
    network = random_network(seed)
    keep = network.measured
    exact = immerse(node_equations(network, **point(network, seed)), keep)
    drawn = immerse(random_equations(network, seed), keep)
    assert {n: set(row) for n, row in exact.G.items()} == {n: set(r) for n, r in drawn.G.items()}
    assert {n: set(row) for n, row in exact.F.items()} == {n: set(r) for n, r in drawn.F.items()}


def test_a_disturbance_that_cancels_on_its_way_confounds_nothing():
    """Two paths from 4 to 1 past the kept nodes, with gains that add up to zero."""
    from casid.algebra.rational import Rational
    from casid.unknown_inputs.networks.network import dynamic_network

    q = Rational.shift()
    modules = {(1, 2): 1 / q, (2, 4): 1 / q, (1, 4): 0.5 / q, (1, 3): 1 / q, (3, 4): -0.5}
    network = dynamic_network(modules, measured=[1, 2])
    assert confounders(network, 1, [2]) == ()
    different = dynamic_network(modules | {(3, 4): -0.4}, measured=[1, 2])
    assert [c.node for c in confounders(different, 1, [2])] == [4]
