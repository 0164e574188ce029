"""Random networks with their unknown inputs observed, and the matrices of the thesis by name."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from itertools import count, islice

import sympy

from casid.unknown_inputs.networks.elimination import immerse
from casid.unknown_inputs.networks.equations import node_equations
from casid.unknown_inputs.networks.node_recovery import recoverable
from casid.unknown_inputs.networks.node_sets import node_sets
from tests.support.network_samples import point, random_network


@cache
def usable(seed):
    """A random network, the sets of node 1 with as many observations as unknown inputs, and its
    equations at a random rational q; None where there is nothing to eliminate with."""
    network = random_network(seed)
    known = network.modules if seed % 2 else ()
    sets = node_sets(network, 1, known=known)
    e = node_equations(network, **point(network, seed))
    recovered, by = recoverable(e, sets.sU, (*sets.D, *sets.I))
    if not sets.sU or recovered != sets.sU:
        return None
    D, I = ([n for n in by if n in part] for part in (sets.D, sets.I))  # noqa: E741
    return network, node_sets(network, 1, known=known, direct=D, indirect=I), e


@cache
def usable_seeds():
    """The first 200; drawn by the first test that asks, for they take seconds."""
    return tuple(islice((seed for seed in count(1000) if usable(seed)), 200))


def signals(e, rng):
    """Random externals and the node signals that they cause, w = (I - G)^-1 e."""
    draws = rng.integers(-99, 99, len(e.nodes))
    externals = {n: Fraction(int(x), 11) for n, x in zip(e.nodes, draws, strict=True)}
    rows = {}
    for n in e.nodes:
        alone = immerse(e, [n]).F[n]
        rows[n] = sum((f * externals[k] for k, f in alone.items()), Fraction(0))
    return rows, externals


def blocks(e, f, sets):
    """The matrices of section 4.1-4.2 by name, and those that (4.33)-(4.43) make of them."""
    names = {
        "j": (1,),
        "K": sets.K,
        "O": sets.O,
        "I": sets.I,
        "D": sets.D,
        "s": sets.sU,
        "U": sets.Ut,
    }

    def block(rows, columns, entry):
        m, n = len(names[rows]), len(names[columns])
        return sympy.Matrix(
            m, n, lambda i, k: sympy.Rational(str(entry(names[rows][i], names[columns][k])))
        )

    def G(name):
        return block(name[0], name[1], e.module)

    def zero_or(u, m):
        return f.get((u, m), Fraction(0))

    fI, fD = block("s", "I", zero_or), block("s", "D", zero_or)
    J = G("js") * fI
    V = G("Us")
    N0 = (sympy.eye(1) + J * G("Ij")).inv()
    unit = sympy.eye(len(sets.I))
    Gb = {x: N0 * (G("jK") - J * G("IK")) if x == "K" else -N0 * J * G(f"I{x}") for x in "KOU"}
    Gb["I"] = N0 * J * (unit - G("II"))
    Gb["D"] = N0 * G("js") * (fD - fI * G("ID"))
    U = {x: G(f"U{x}") - V * fI * G(f"I{x}") for x in "jKOU"}
    U["I"] = G("UI") + V * fI * (unit - G("II"))
    U["D"] = G("UD") + V * (fD - fI * G("ID"))
    Q = (sympy.eye(len(sets.Ut)) - U["U"]).inv()
    N = (sympy.eye(1) - Gb["U"] * Q * U["j"]).inv()
    Gt = {x: N * (Gb[x] + Gb["U"] * Q * U[x]) for x in "KOID"}
    Ft = {
        "j": N * N0,
        "I": N * (-N0 * J - Gb["U"] * Q * V * fI),
        "D": N * (-N0 * G("js") * fD - Gb["U"] * Q * V * fD),
        "U": N * Gb["U"] * Q,
    }
    return names, G, {"J": J, "V": V, "Q": Q, "fI": fI, "Ub": U}, Gt, Ft


def column(values, nodes):
    return sympy.Matrix(len(nodes), 1, lambda i, _: sympy.Rational(str(values[nodes[i]])))
