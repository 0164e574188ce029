"""Results whose text, page and JSON are kept in tests/report/golden/.

Nothing here is estimated from drawn data by an optimiser: the results are put together from parts,
or follow from algebra, so that the last digit printed is the same everywhere. Of a page, what
changes without a change of the page is cut out: plotly.js, the style sheet, the digests of scripts,
and the numbers inside figures, of which titles, captions and the names of traces are kept.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from casid.algebra.rational import Rational
from casid.campaigns.accuracy import Accuracy
from casid.campaigns.campaign import Campaign
from casid.campaigns.monte_carlo import MonteCarlo
from casid.data.files import plain
from casid.data.fir_filter import FirFilter
from casid.diagnosis.advice.next_experiment import Advice
from casid.estimation.nlp.solution import Solution
from casid.estimation.prediction_error.polynomial.misfit import Misfit
from casid.estimation.prediction_error.polynomial.model import PolynomialModel, Search
from casid.estimation.reconciliation import Reconciliation
from casid.identifiability.assessment import Assessment
from casid.identifiability.equations.equation_text import parse_system
from casid.identifiability.equations.system import System
from casid.identifiability.procedure import assess_identifiability
from casid.identifiability.remedies.sensor_subsets import sensor_subsets
from casid.identifiability.symbolic.observability_matrix import observability_matrix
from casid.linear.linear_model import linearise
from casid.linear.loops.closed_loop import ClosedLoopView, closed_loop_view
from casid.model.model import Model
from casid.unknown_inputs.limits.comparison import Comparison
from casid.unknown_inputs.limits.remedies import compare_remedies
from casid.unknown_inputs.networks.equations import node_equations
from casid.unknown_inputs.networks.network import Network, dynamic_network
from casid.unknown_inputs.networks.node_sets import node_sets
from problems.pendulum import direct_model
from problems.static_input import VALUES, signals
from tests.support import sample_parts, samples
from tests.support.samples import page_of

FOLDER = Path(__file__).parent / "golden"
q = Rational.shift(Ts=1.0)


def comparison() -> Comparison:
    """The thesis's static example with an unknown input, every remedy, in symbols."""
    return compare_remedies(
        signals().at({"beta": 0}),
        "y_O",
        {"bK": "u_K", "bU": "u_U"},
        "u_U",
        {"bK": "bK", "bU": "bU"},
        known=["delta1", "delta2"],
        approximations={"u_U": "u_hat"},
        explain=[["delta2"], ["delta1", "delta2"]],
        measured={"u_U": "y_U"},
        eliminated={"u_U": "u_I"},
        accuracy=0.05,
    )


def comparison_in_numbers() -> Comparison:
    """The same at the thesis's numbers."""
    numbers = {k: v for k, v in VALUES.items() if k != "beta"}
    return comparison().at(numbers | {"a1": 0.5, "a2": 1.2})


def network() -> Network:
    """Four nodes, one without a sensor, with a loop."""
    return dynamic_network(
        {(3, 1): 0.6 / (q - 0.5), (3, 2): 0.4 / (q - 0.6), (4, 2): 0.5 / (q - 0.6),
         (1, 2): 0.3 / q, (2, 4): 0.2 * q / (q - 0.1)},
        excitations=(1, 2),
        disturbances={1: 0.3, 2: 0.5, 3: 0.4, 4: 0.2},
        measured=(1, 3, 4),
        name="small",
    )  # fmt: skip


def monte_carlo() -> MonteCarlo:
    """Two parameters, one biased with intervals that are too short; 2 of 40 runs failed."""
    run = np.arange(40)
    k = 10.2 + 0.5 * np.sin(1.7 * run)
    d = 1 + 0.1 * np.cos(2.3 * run)
    failed = [None] * 38 + ["DataError: the record is too short"] * 2
    table = pd.DataFrame(
        {"run": run, "k": k, "k.std_error": 0.1, "d": d, "d.std_error": 0.1, "failed": failed}
    ).assign(friction_of_the_joint=d)
    return MonteCarlo(
        "pendulum",
        "identify",
        Campaign("pendulum", 3, table),
        (
            Accuracy("k", "N m/rad", 10.0, 38, 10.2, 0.35, 0.1, 38, 12),
            Accuracy("friction_of_the_joint", "N m s^2/rad^2", None, 38, 1.0, 0.07, 0.1, 38, 0),
            Accuracy("d", "1", 1.0, 38, 1.0, 0.07, 0.1, 38, 37),
        ),
        {"starts": 2, "known": {"m": 0.2}, "duration": None},
        {"casid": "0.1.0"},
        ("Wilson, E. B. (1927). J. Am. Stat. Assoc. 22, 209-212.",),
    )


def loop() -> ClosedLoopView:
    """The pendulum without its unknown acceleration, as a closed loop."""
    return closed_loop_view(direct_model().eliminate("a_y", using="accel"))


def transfer() -> Any:
    """Transfer functions of a mass on a spring, with two outputs."""
    m = Model("mass on a spring")
    x, v, F = m.state("x", "m"), m.state("v", "m/s"), m.input("F", "N")
    mass, k, d = (
        m.parameter(n, u, start=1.0) for n, u in (("m", "kg"), ("k", "N/m"), ("d", "kg/s"))
    )
    m.derivative(x, v)
    m.derivative(v, (F - k * x - d * v) / mass)
    m.output("position", x, "m")
    m.output("speed", v, "m/s")
    return linearise(m).transfer()


def assessment() -> Assessment:
    """A mass and an unknown force: confounded, with fixing sets and classes of the input."""
    system = {
        "states": ["v"],
        "params": ["m", "d"],
        "unknown_inputs": ["w"],
        "equations": {"v": "(w - d*v)/m"},
        "outputs": {"speed": "v", "acceleration": "(w - d*v)/m"},
    }
    return assess_identifiability(parse_system(system, name="unknown force"))


def reconciled() -> object:
    """Three readings of a mass, one of them wrong."""
    r = Reconciliation("scales")
    m = r.unknown("m", 1.0, "kg")
    for i, (value, sd) in enumerate(((2.0, 0.1), (2.2, 0.1), (4.0, 0.4))):
        r.equation(f"reading {i}", r.reading(f"m{i}", value, sd, "kg") - m)
    return r.solve()


def _assessment() -> Assessment:
    a = assessment()
    provenance = replace(a.provenance, seconds=0.012, versions={"casid": "0.1.0"})
    return replace(a, provenance=provenance)


def next_experiments() -> Advice:
    """Two experiments that separate two causes, and the same record again, which does not."""
    first, second, same = sample_parts.proposals()
    return Advice(sample_parts.KEYS[:2], same, (first, second), "Let it decay.")


def mass_on_spring() -> System:
    """A mass on a spring with a force, position and speed measured."""
    return parse_system(
        {
            "states": ["x", "v"],
            "params": ["k", "m"],
            "known_inputs": ["F"],
            "equations": {"x": "v", "v": "(F - k*x)/m"},
            "outputs": {"position": "x", "speed": "v"},
        },
        name="mass on a spring",
    )


def solution() -> Solution:
    """Two variables, one at its bound, one constraint; not converged."""
    return Solution(
        ("stiffness", "d"),
        np.array([10.52, 0.0]),
        1.25,
        "Maximum_Iterations_Exceeded",
        200,
        3e-3,
        2e-8,
        ("d",),
        (),
        np.eye(2),
        np.ones((1, 2)),
        "ipopt",
    )


def polynomial_model() -> PolynomialModel:
    """A Box-Jenkins model of two inputs, put together."""
    names = ("a1", "b1[u]", "f1[u]", "b0[w]", "c1", "d1")
    theta = np.array([-0.7, 0.5, -0.8, 1.5, 0.3, -0.9])
    misfit = Misfit(
        0.0101,
        0.005,
        93.25,
        60,
        (np.cos(np.arange(62.0) ** 2),),
        (2,),
        {"u": np.linspace(-1.2, 0.8, 26)},
    )
    return PolynomialModel(
        "Box-Jenkins",
        np.array([1, -0.7]),
        {"u": np.array([0, 0.5]), "w": np.array([1.5])},
        np.array([1, 0.3]),
        np.array([1, -0.9]),
        {"u": np.array([1, -0.8]), "w": np.array([1.0])},
        {"u": 1, "w": 0},
        names,
        theta,
        np.diag([0.01, 0.02, 0.03, 0.04, 0.05, 0.06]) ** 2,
        "white residuals",
        0.1,
        misfit,
        Search("converged", True, 7, 3e-9, "instrumental variables"),
        ("a root of C was reflected",),
    )


TEXTS: dict[str, Callable[[], object]] = {
    "estimate": samples.estimate,
    "estimate_extended": lambda: samples.estimate(extended=True),
    "diagnosis_deficient": lambda: samples.deficient(N=400),
    "diagnosis_adequate": samples.adequate,
    "diagnosis_undecided": samples.undecided,
    "diagnosis_rich": samples.rich,
    "isolability": sample_parts.isolability,
    "calibration": sample_parts.calibration,
    "next_experiments": next_experiments,
    "assessment": _assessment,
    "reconciliation": reconciled,
    "monte_carlo": monte_carlo,
    "comparison": comparison,
    "comparison_in_numbers": comparison_in_numbers,
    "asymptotics": lambda: comparison_in_numbers()["neglect, LS"],
    "network": network,
    "node_sets": lambda: node_sets(network(), 3),
    "solution": solution,
    "polynomial_model": polynomial_model,
    "sensor_subsets": lambda: sensor_subsets(mass_on_spring(), costs={"position": 2.0}),
    "observability_matrix": lambda: observability_matrix(mass_on_spring()),
    "reduced_form": lambda: observability_matrix(mass_on_spring()).row_reduced(),
    "fir_filter": lambda: FirFilter(np.array([0.25, 0.5, 0.25]), 0.1).describe([1.0, 2.5]),
    "node_equations": lambda: node_equations(network()),
    "closed_loop": loop,
    "transfer_functions": transfer,
}
PAGES: dict[str, Callable[[], str]] = {
    "diagnosis_deficient": lambda: page_of(samples.deficient(N=400)),
    "diagnosis_adequate": lambda: page_of(samples.adequate()),
    "diagnosis_rich": lambda: page_of(samples.rich()),
    "estimate": lambda: page_of(samples.adequate().baseline, samples.adequate().records),
    "assessment": lambda: page_of(_assessment()),
    "monte_carlo": lambda: page_of(monte_carlo()),
}
JSON: dict[str, Callable[[], Any]] = {
    "estimate": lambda: samples.estimate().to_json(),
    "diagnosis_adequate": lambda: samples.adequate().to_json(),
    "monte_carlo": lambda: monte_carlo().to_json(),
    "assessment": lambda: _assessment().to_json(),
}


def _figure(match: re.Match[str]) -> str:
    """What a reader reads in a figure: titles, captions, names of traces."""
    figure = json.loads(match[2])
    layout = figure["layout"]
    titles = [
        layout[k]["title"]["text"]
        for k in layout
        if re.match("[xy]axis", k) and "text" in layout[k].get("title", {})
    ]
    names = [f"{t.get('type')} {t.get('name')}" for t in figure["data"]]
    return match[1] + "\n".join([*titles, *names]) + "\n</script>"


def _page(text: str) -> str:
    text = re.sub(
        r'(<script type="application/json" id="[^"]*">)(.*?)</script>', _figure, text, flags=re.S
    )
    text = re.sub(r'(id="library">)[^<]*', r"\1", text)
    text = re.sub(r"<script>.*?</script>", "<script></script>", text, flags=re.S)
    text = re.sub(r"<style>.*?</style>", "<style></style>", text, flags=re.S)
    text = re.sub(r"sha256-[^']*", "sha256-...", text)
    return re.sub(
        r"(?<=[^\n])(<(?:section|tr|h[123]|figure|table|p|li|div|article|dl)\b)", r"\n\1", text
    )


def golden_texts() -> Iterator[tuple[str, Callable[[], str]]]:
    """File name of everything that is kept, and how to make it."""
    for name, result in TEXTS.items():
        yield f"{name}.txt", lambda result=result: f"{result()}\n"  # type: ignore[misc]
    for name, page in PAGES.items():
        yield f"{name}.html", lambda page=page: _page(page())  # type: ignore[misc]
    for name, content in JSON.items():
        yield (
            f"{name}.json",
            lambda content=content: (  # type: ignore[misc]
                json.dumps(plain(content()), indent=1) + "\n"
            ),
        )
