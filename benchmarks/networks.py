"""Elimination of unknown nodes from sparse networks on many frequencies, and how its time grows.

    python -m benchmarks.networks [--quick] [--out DIR]

Random networks of three modules a node, a quarter of the nodes measured; 512 frequencies; one
process, one thread. Timed are the immersion of every node without a sensor, and the indirect model
of a target with five unknown predictor inputs: those eliminated by five measured nodes, all other
unknown ones immersed. Both keep the filters of every external signal. Target: 200 nodes in under
5 s for the two together.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from analysis.common.targets import at_most, report
from casid.algebra.rational import Rational
from casid.unknown_inputs.networks.elimination import immerse
from casid.unknown_inputs.networks.equations import NodeEquations, node_equations
from casid.unknown_inputs.networks.indirect_equations import indirect_equations
from casid.unknown_inputs.networks.network import Network, dynamic_network
from casid.unknown_inputs.networks.node_sets import node_sets

FREQUENCIES = 512
SIZES = (25, 50, 100, 200, 400)
LIMIT = 5.0  # s, for 200 nodes
UNKNOWN = 5


@dataclass(frozen=True, slots=True)
class Run:
    """Times of one size [s], and the largest error found at a frequency."""

    nodes: int
    modules: int
    build: float
    immersed: float
    indirect: float
    error: float


def sparse_network(L: int, seed: int = 1) -> Network:
    """L nodes with three modules each from anywhere, gains so small that every loop is stable.

    Nodes 1 to 5 act on node 0 and on one measured node each, and have no sensor.
    """
    rng = np.random.default_rng(seed)
    q = Rational.shift()
    eyes = [0, *range(UNKNOWN + 1, UNKNOWN + 1 + L // 4)]
    edges = {(0, u) for u in range(1, UNKNOWN + 1)}
    edges |= {(eyes[u], u) for u in range(1, UNKNOWN + 1)}
    edges |= {(n, int(k)) for n in range(1, L) for k in rng.choice(L, 3, replace=False) if k != n}
    modules = {}
    for edge in sorted(edges):
        pole = Fraction(int(rng.integers(10, 90)), 100)
        gain = Fraction(int(rng.integers(5, 25)), 100) * (1 - pole)
        modules[edge] = gain / (q - pole)
    return dynamic_network(modules, nodes=range(L), measured=eyes)


def run(L: int) -> Run:
    """Build, immerse and eliminate once; check both against a dense solve at three frequencies."""
    started = time.perf_counter()
    network = sparse_network(L)
    build = time.perf_counter() - started
    omega = np.linspace(0.005, np.pi, FREQUENCIES)
    sets = node_sets(network, 0)

    started = time.perf_counter()
    equations = node_equations(network, omega=omega)
    immersed = immerse(equations, network.measured)
    between = time.perf_counter()
    indirect = indirect_equations(equations, sets)
    ended = time.perf_counter()
    errors = [_error(network, e, omega) for e in (immersed, indirect)]
    return Run(L, len(network.modules), build, between - started, ended - between, max(errors))


def _error(network: Network, equations: NodeEquations, omega: np.ndarray) -> float:
    """Largest |w - G w - F e| / |w| for w = (I - G)^-1 e with random e, at three frequencies."""
    rng = np.random.default_rng(2)
    L = len(network.nodes)
    worst = 0.0
    for f in (0, FREQUENCIES // 2, FREQUENCIES - 1):
        G = np.zeros((L, L), complex)
        for (i, k), g in network.modules.items():
            G[i, k] = g.frequency_response(omega[f])
        e = rng.standard_normal(L)
        w = np.linalg.solve(np.eye(L) - G, e)
        for n in equations.nodes:
            row = sum(g[f] * w[k] for k, g in equations.G[n].items())
            row += sum(g[f] * e[k] for k, g in equations.F[n].items())
            worst = max(worst, abs(row - w[n]) / np.abs(w).max())
    return float(worst)


def exponent(runs: Sequence[Run]) -> float:
    """Slope of log time against log nodes."""
    sizes = np.log([r.nodes for r in runs])
    times = np.log([r.immersed + r.indirect for r in runs])
    return float(np.polyfit(sizes, times, 1)[0])


def figure(runs: Sequence[Run], file: Path) -> None:
    """Time against the number of nodes, both axes logarithmic."""
    import plotly.graph_objects as go

    plot = go.Figure()
    sizes = [r.nodes for r in runs]
    for name in ("immersed", "indirect"):
        plot.add_scatter(x=sizes, y=[getattr(r, name) for r in runs], name=name)
    plot.update_xaxes(type="log", title="nodes")
    plot.update_yaxes(type="log", title="time [s]")
    plot.update_layout(title=f"Elimination on {FREQUENCIES} frequencies, three modules a node")
    plot.write_html(file, include_plotlyjs="cdn")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all sizes and print the table; 1 if the target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="up to 200 nodes")
    parser.add_argument("--out", type=Path, help="folder for the targets and the plot of growth")
    options = parser.parse_args(arguments)
    sizes = SIZES[:-1] if options.quick else SIZES
    print("nodes modules  build [s]  immersed [s]  indirect [s]  largest error")
    runs = []
    for L in sizes:
        r = run(L)
        runs.append(r)
        print(
            f"{r.nodes:5d} {r.modules:7d} {r.build:10.2f} {r.immersed:13.3f} {r.indirect:13.3f} "
            f"{r.error:14.1e}"
        )
    print(f"time grows as nodes^{exponent(runs):.2f}")
    two_hundred = next(r for r in runs if r.nodes == 200)
    total = two_hundred.immersed + two_hundred.indirect
    targets = [
        at_most("200 nodes, 512 frequencies, immersed and eliminated", total, LIMIT, "s"),
        at_most("largest error against a dense solve", max(r.error for r in runs), 1e-9, ""),
    ]
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        figure(runs, options.out / "networks.html")
    return report(targets, options.out / "targets.json" if options.out else None)


if __name__ == "__main__":
    sys.exit(main())
