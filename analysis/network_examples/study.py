"""Dynamic networks with unknown inputs: the examples of chapters 3, 4 and 6, and their figures.

    python -m analysis.network_examples [--quick] [--out DIR] [--runs N]

Linder (2017), on the eight-node network of Example 3.2:

1. Node sets, confounders, and Propositions 3.1 and 4.1 (Examples 3.2, 3.4, 4.5).
2. The immersed networks (3.24) and (3.41) and the indirect model (4.31), as formulas, compared with
   the printed ones.
3. Recursive elimination, Figure 4.2, on a chain where each observation feels the next unknown node.
4. Example 6.1: exact error variances of the predictors, their fits over realisations, Figures 6.1
   and 6.2, and how small tau_4 has to be for the indirect predictor to win. The printed legend is
   lost; which of (3.41) and (4.31) fits better is not asserted, since with the printed modules they
   are practically tied.
5. The errors-in-variables Kalman filter (6.13)-(6.21).
6. Feedforward (6.22)-(6.24): an inverse estimated directly, against a model that is inverted.

Targets are derived from theory, or are the numbers that were computed for the same network by
other means; exit 1 where one is missed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import sympy

from analysis.common.output import Output
from analysis.common.runner import Run, Study, runs
from analysis.common.targets import Target, at_most, near
from analysis.network_examples.feedforward import compared
from analysis.network_examples.figures import predictions, rings, signals
from casid.algebra.rational import Rational
from casid.report.figures.network_drawing import network_figure
from casid.unknown_inputs.networks.confounders import confounders
from casid.unknown_inputs.networks.dynamics import network_states
from casid.unknown_inputs.networks.elimination import immerse
from casid.unknown_inputs.networks.equations import NodeEquations
from casid.unknown_inputs.networks.indirect_equations import indirect_equations
from casid.unknown_inputs.networks.network import Network, Signal, dynamic_network
from casid.unknown_inputs.networks.node_sets import node_sets, signal_table
from casid.unknown_inputs.networks.prediction.eiv_filter import eiv_filter
from casid.unknown_inputs.networks.prediction.predictors import (
    IMMERSED,
    IMMERSED_ALL,
    INDIRECT,
    NEGLECT,
    PredictorTable,
    compare_predictors,
)
from casid.unknown_inputs.networks.propositions import proposition_3_1, proposition_4_1
from casid.unknown_inputs.networks.recursive_elimination import eliminate_recursively
from problems import network8

SETTLE = 300  # samples of a record that a predictor started from rest is not judged by


def structure(out: Output) -> Iterator[Target]:
    """Who is who, who confounds, and which modules stay themselves."""
    symbolic, sets = network8.symbolic(), node_sets(network8.symbolic(), 2)
    print(sets)
    for row in signal_table(symbolic, sets):
        print(f"  {row}")
    found = confounders(symbolic, 2, [1, 3])
    for c in found:
        print(f"  {c}")
    names = sorted(c.node for c in found)
    yield Target("confounders of w2 and (w1, w3)", str(names), "[6, 7]", names == [6, 7])
    out.figure("network", network_figure(symbolic, 2, title="Example 3.2"))
    open_loop = symbolic.without((5, 2))
    for what, verdict, holds in (
        ("Proposition 3.1 for G21", proposition_3_1(symbolic, 2, 1), False),
        ("the same without G52", proposition_3_1(open_loop, 2, 1), True),
        ("Proposition 4.1 for G23", proposition_4_1(symbolic, sets, 3), True),
        ("Proposition 4.1 for G21", proposition_4_1(symbolic, sets, 1), False),
    ):
        print(f"-- {what}\n{verdict}")
        yield Target(what, str(verdict.holds), str(holds), verdict.holds is holds)


def formulas() -> Iterator[Target]:
    """(3.24), (3.41) and (4.31) against what is printed."""
    symbolic = network8.symbolic()
    sets = node_sets(symbolic, 2)
    G = {f"{a}{b}": sympy.Symbol(f"G{a}{b}") for a, b in network8.TABLE_6_1}
    D = 1 - G["25"] * G["52"]
    through = G["25"] * G["58"]
    rows: tuple[tuple[str, NodeEquations, dict[int, Any], dict[int, Any]], ...] = (
        (
            "(3.24)",
            immerse(symbolic, [1, 2, 3]),
            {1: G["21"] / D, 3: G["23"] / D},
            {
                2: 1 / D,
                5: G["25"] / D,
                6: through * (G["86"] + G["87"] * G["76"]) / D,
                7: through * G["87"] / D,
                8: through / D,
            },
        ),
        (
            "(3.41)",
            immerse(symbolic, network8.MEASURED),
            {1: G["21"] / D, 3: G["23"] / D, 7: through * G["87"] / D},
            {2: 1 / D, 5: G["25"] / D, 6: through * G["86"] / D, 8: through / D},
        ),
        (
            "(4.31)",
            indirect_equations(symbolic, sets),
            {1: G["21"] - G["25"] / G["45"] * G["41"], 3: G["23"], 4: G["25"] / G["45"]},
            {2: 1, 4: -G["25"] / G["45"]},
        ),
    )
    for name, equations, modules, noise in rows:
        print(f"-- {name}\n{equations}")
        same = _same(equations.G[2], modules, equations.module)
        same = same and _same(equations.F[2], noise, equations.filter)
        yield Target(f"w2 of {name}", "as printed" if same else "differs", "as printed", same)


def _same(row: Mapping[Any, Any], wanted: Mapping[int, Any], read: Any) -> bool:
    return set(row) == set(wanted) and all(read(2, k).equals(g) for k, g in wanted.items())


def chain(n: int) -> Network:
    """A target fed by u_1; y_i feels u_i and u_(i+1): each elimination brings in the next."""
    q = Rational.shift(Ts=1.0)
    modules = {("target", "u1"): 0.3 / (q - 0.6)}
    for i in range(1, n + 1):
        modules[f"y{i}", f"u{i}"] = 0.5 / (q - 0.3 - 0.05 * i)
        if i < n:
            modules[f"y{i}", f"u{i + 1}"] = 0.2 / (q - 0.8 + 0.1 * i)
    measured = ["target", *(f"y{i}" for i in range(1, n + 1))]
    return dynamic_network(modules, measured=measured, name="chain")


def recursion(out: Output, *, quick: bool) -> Iterator[Target]:
    """Figure 4.2: the model grows with every ring."""
    found = eliminate_recursively(chain(4 if quick else 6), "target")
    print(found)
    rows = []
    for r in found.steps:
        row = {"ring": r.number, "eliminated": " ".join(map(str, r.eliminated))}
        row |= {"by": " ".join(map(str, r.by)), "inputs": len(r.inputs)}
        row |= {"unobserved": len(r.unobserved), "involved": len(r.involved), "degree": r.degree}
        rows.append(row)
    out.table("rings", rows)
    out.figure("figure_4_2", rings(found))
    involved = [len(r.involved) for r in found.steps]
    degrees = [r.degree or 0 for r in found.steps]
    yield Target(
        "rings: nodes involved; degree of the model",
        f"{involved}; {degrees}",
        "one more with each ring, degree not less, none unobserved at the end",
        involved == list(range(1, len(involved) + 1))
        and degrees == sorted(degrees)
        and not found.steps[-1].unobserved,
    )


def predictors(out: Output, runs: int) -> Iterator[Target]:
    """Example 6.1."""
    network = network8.network
    radius = float(np.max(np.abs(np.linalg.eigvals(network_states(network).A))))
    yield near("spectral radius", radius, 0.9535, 6e-5, "")
    table = compare_predictors(network, 2)
    without = compare_predictors(network, 2, use_excitations=False)
    print(f"-- with delta_6\n{table}\n-- without\n{without}")
    out.table("predictors", [p.row() for p in table.predictors])
    for what, found, wanted in (
        ("(3.24)", without[IMMERSED].variance, 27.597),
        ("(3.41) with delta_6", table[IMMERSED_ALL].variance, 2.304),
        ("(3.41) without", without[IMMERSED_ALL].variance, 2.532),
        ("indirect (4.31)", table[INDIRECT].variance, 2.515),
    ):
        yield near(f"error variance, {what}", found, wanted, 3e-4, "")
    yield from fits(table, without, out, runs)
    yield from break_even(table, without)


def fits(
    table: PredictorTable, without: PredictorTable, out: Output, runs: int
) -> Iterator[Target]:
    """Fits over realisations, 1000 samples each, and the two figures."""
    chosen = {
        "w1 and w3 alone": (table[NEGLECT], 27.2, 4.3),
        "(3.24)": (without[IMMERSED], 41.6, 3.4),
        "(3.41)": (without[IMMERSED_ALL], 81.5, 3.2),
        "(3.41) with delta_6": (table[IMMERSED_ALL], 82.2, 3.5),
        "indirect": (table[INDIRECT], 81.3, 3.5),
    }
    found: dict[str, list[float]] = {name: [] for name in chosen}
    for seed in range(runs):
        record = network8.simulate(seed, 1000 + SETTLE)
        for name, (p, _, _) in chosen.items():
            found[name].append(p.fit(record, skip=SETTLE))
    rows = []
    for name, (_, mean, spread) in chosen.items():
        got, sd = float(np.mean(found[name])), float(np.std(found[name], ddof=1))
        # Both are means of realisations; the other one, like its spread, is of 200.
        error = spread * np.sqrt(1 / runs + 1 / 200)
        rows.append({"predictor": name, "fit": got, "sd": sd, "runs": runs})
        yield Target(
            f"fit over {runs} realisations, {name}",
            f"{got:.1f} +- {sd:.1f} %",
            f"{mean:g} +- {spread:g} %, within 3 std. errors",
            abs(got - mean) <= 3 * error + 0.05,
        )
    out.table("fits", rows)
    record = network8.simulate(1, 1000 + SETTLE)
    out.figure("figure_6_1", signals(record, SETTLE))
    used = {name: p for name, (p, _, _) in chosen.items()}
    out.figure("figure_6_2", predictions(record, SETTLE, used))


def break_even(table: PredictorTable, without: PredictorTable) -> Iterator[Target]:
    """The variance of tau_4 below which the indirect predictor is the better one."""
    share = table[INDIRECT].variance - 1.0  # of tau_4 of unit variance
    for what, other, wanted in (
        ("with delta_6", table[IMMERSED_ALL].variance, 0.861),
        ("without", without[IMMERSED_ALL].variance, 1.012),
    ):
        limit = (other - 1.0) / share
        yield near(f"indirect wins over (3.41) {what}: var(tau_4) below", limit, wanted, 1e-3, "")
        # Compared with the network itself, with tau_4 a little on either side.
        better = []
        for factor in (0.95, 1.05):
            noisy = dynamic_network(
                network8.network.modules,
                nodes=network8.network.nodes,
                excitations=(6,),
                disturbances={n: Signal(factor * limit if n == 4 else 1.0) for n in range(1, 9)},
                measured=network8.MEASURED,
                Ts=1.0,
            )
            now = compare_predictors(noisy, 2, use_excitations=what != "without")
            better.append(now[INDIRECT].variance < now[IMMERSED_ALL].variance)
        yield Target("  5 % below and above", str(better), "[True, False]", better == [True, False])


def filtering(*, quick: bool) -> Iterator[Target]:
    """The errors-in-variables Kalman filter on a record."""
    f = eiv_filter(network8.network, 2)
    N = 5_000 if quick else 100_000
    record = network8.simulate(11, N + SETTLE)
    found = f.run(record)
    eps = found.innovations[SETTLE:]
    spread = 3.5 * np.sqrt(2 / len(eps))
    yield near("EIV filter: variance of the innovations", float(np.mean(eps**2)), f.variance,
               spread, "")  # fmt: skip
    lag = abs(float(np.mean(eps[1:] * eps[:-1]))) / f.variance
    yield at_most("  correlation with the one before", lag, 3.5 / np.sqrt(len(eps)), "")
    for n, stated in f.noise_free_variances().items():
        error = found.noise_free[n] - (record[f"w{n}"] - record[f"tau_{n}"])
        got = float(np.mean(error[SETTLE:] ** 2))
        yield near(f"  error variance of w{n} - tau_{n}", got, stated, 1.5 * spread, "")


def study(run: Run) -> Iterator[Target]:
    """All parts in turn."""
    yield from structure(run.output)
    yield from formulas()
    yield from recursion(run.output, quick=run.quick)
    yield from predictors(run.output, run.runs(200, quick=20))
    yield from filtering(quick=run.quick)
    yield from compared()


STUDY = Study(study, quick="20 realisations", options=runs(200, quick=20))
