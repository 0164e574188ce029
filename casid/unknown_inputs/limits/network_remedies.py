"""One module of a network, by every relation and every estimator that there is for it.

The user gives the network and the module; which inputs are unknown, which nodes stand for them,
which references there are, and how each relation is structured, follow. Relations differ in what
becomes of the module, so that its frequency response is compared.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from casid.argument_types import names_wrong_types
from casid.errors import IdentifiabilityError, ModelError
from casid.estimation.nlp.solver import Solver
from casid.estimation.prediction_error.polynomial.orders import Layout, Orders
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.comparison import Comparison, RemedyRow
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.module_response import ResponsePoints, with_response
from casid.unknown_inputs.limits.network_relations import Relation, network_relations
from casid.unknown_inputs.limits.network_signals import network_signals
from casid.unknown_inputs.limits.polynomial_regression import (
    instrumental_limit,
    polynomial_regressors,
)
from casid.unknown_inputs.limits.prediction_limit import prediction_error_limit
from casid.unknown_inputs.limits.regression import Regression
from casid.unknown_inputs.limits.regression_limit import regression_limit
from casid.unknown_inputs.limits.remedy_table import attempted_row, with_simpler_noise
from casid.unknown_inputs.limits.two_stage_limit import two_stage_limit
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.nodes import Edge, edge_label, node_label

WAYS = ("PEM", "LS", "IV", "two-stage")
"""Prediction error; least squares and instrumental variables on A w = sum B w; two stages."""


@names_wrong_types(ModelError)
def network_remedies(
    network: Network,
    module: Edge,
    orders: Orders | None = None,
    *,
    frequencies: Sequence[float] | None = None,
    ways: Collection[str] = WAYS,
    known: Collection[Edge] = (),
    most: int = 2,
    lags: int | None = None,
    N: float = 1000,
    accuracy: float | None = None,
    random_starts: int = 1,
    solver: Solver | None = None,
) -> Comparison:
    """Compare what can be done to estimate one module of a network with the sensors it has.

    Rows are relations times estimators. Relations: all inputs known (for reference); the unknown
    ones neglected; everything but the measured predictor inputs, or but all that is measured,
    immersed; the unknown ones eliminated (the indirect model). Estimators:

    - PEM: B/F for every input and C/D, direct;
    - LS, IV: A w_j = sum B_k w_k with the relation's common denominator A, in full order. The
      instruments are the regressors as the excitations make them (noise-free);
    - two-stage: PEM with inputs that are predicted from the excitations.

    Parameters
    ----------
    network : numbers, discrete, stable.
    module : (j, i).
    orders : nb, nf, nc, nd of the PEM, the same for every input; delays are the relation's. By
        default those of each relation, nb and nf at most `most`, and nc = nd = 1.
    frequencies : [rad/s] at which the response is compared; by default 0 and a tenth of half the
        sampling frequency.
    ways : of `WAYS`.
    known : modules whose transfer function is known, for direct measurements.
    lags : of the predictions from the excitations; by default until responses have died out.
    N, accuracy : samples that standard errors are given at; root mean square error wanted.
    random_starts : of the PEM and two-stage minima, beside zero and the true coefficients where the
        orders hold them. Few references and many coefficients leave several minima: raise it. A
        network of eight nodes takes one to two minutes with all ways, seconds without these two.
    solver : of the nonlinear minima, a `Solver`.

    Returns
    -------
    Comparison; its coefficients are the static gain, and the real and imaginary parts, of G_ji.
    A remark describes what becomes of G_ji in each relation, and names the confounders.

    Raises
    ------
    ModelError
        If there is no such module, its output has no sensor, or the network has symbols, is
        continuous or unstable.
    """
    _refuse_strange(ways)
    sets, relations, refused = network_relations(network, module, known)
    system = network_signals(network)
    points = _response_points(module, frequencies, system.Ts or 1.0)
    truth = points.truth(network.module(*module))
    task = _Task(network, module, system, points, truth, lags, random_starts, solver)
    rows = []
    for relation in relations:
        chosen = relation.orders(most) if orders is None else _for_all(orders, relation)
        rows += [task.row(relation, way, chosen) for way in WAYS if way in ways]
    rows += [RemedyRow(name, "own", None, why) for name, why in refused]
    wanted = {} if accuracy is None else dict.fromkeys(points.names, accuracy)
    unknown = tuple(map(node_label, sets.sU))
    return Comparison(tuple(rows), points.names, unknown, N, wanted)


def _refuse_strange(ways: Collection[str]) -> None:
    strange = [w for w in ways if w not in WAYS]
    if strange:
        raise ModelError(f"ways has {strange[0]!r}; choose among {', '.join(WAYS)}")


def _response_points(
    module: Edge, frequencies: Sequence[float] | None, Ts: float
) -> ResponsePoints:
    """The frequencies given [rad/s], or 0 and a tenth of half the sampling frequency."""
    omega = (0.0, 0.1 * math.pi / Ts) if frequencies is None else tuple(map(float, frequencies))
    return ResponsePoints(edge_label(module), omega, Ts)


def _for_all(orders: Orders, relation: Relation) -> Orders:
    """One order for every input of the relation, with its own delays."""
    if isinstance(orders.nb, Mapping) or isinstance(orders.nf, Mapping):
        raise ModelError(
            "nb or nf for each input: the relations have different inputs; give one number each, "
            "or leave orders out"
        )
    return replace(orders, nk=relation.delays)


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """The arguments that all rows of the table share."""

    network: Network
    module: Edge
    system: LinearSignals
    points: ResponsePoints
    truth: Mapping[str, float]
    lags: int | None
    random_starts: int
    solver: Solver | None

    def row(self, relation: Relation, way: str, orders: Orders) -> RemedyRow:
        """One relation by one estimator."""
        system, output = self._output(relation)
        sources = {n: self._signal(relation, n) for n in relation.modules}
        name = f"{relation.name}, {way}"
        own = relation.common_denominator() if way in ("LS", "IV") else orders

        def found(orders: Orders) -> Asymptotics:
            """The limit of the estimator `way` for a model of these orders."""
            if way == "LS":
                terms = polynomial_regressors(Layout.of(orders, list(sources)), output, sources)
                return regression_limit(system, Regression(output, terms), method=name)
            if way == "IV":
                return instrumental_limit(
                    system, output, sources, self._references(), orders,
                    lags=self.lags, method=name,
                )  # fmt: skip
            start = relation.start(orders) or None
            if way == "PEM":
                return prediction_error_limit(
                    system, output, sources, orders, start=start,
                    method=name, random_starts=self.random_starts, solver=self.solver,
                )  # fmt: skip
            return two_stage_limit(
                system, output, sources, self._references(), orders, lags=self.lags, start=start,
                method=name, random_starts=self.random_starts, solver=self.solver,
            )  # fmt: skip

        def estimate(orders: Orders) -> Asymptotics:
            return self._compared(found(orders), relation, orders)

        simple = with_simpler_noise(estimate, own)
        return attempted_row(name, relation.kind, simple, relation.remark)

    def _compared(self, found: Asymptotics, relation: Relation, orders: Orders) -> Asymptotics:
        layout = Layout.of(orders, list(relation.modules))
        source = node_label(self.module[1])
        return with_response(found, layout, source, self.points, self.truth, lead=relation.lead)

    def _references(self) -> list[str]:
        made = [f"delta {node_label(n)}" for n in self.network.excitations]
        if not made:
            raise IdentifiabilityError(
                "no excitation is known, so there is neither instrument nor prediction; excite a "
                "node upstream and name it in excitations="
            )
        return made

    def _signal(self, relation: Relation, channel: str) -> str:
        """The reading of a channel's sensor."""
        node = relation.nodes.get(channel)
        noisy = self.network.sensor_noise.get(node, 0.0) > 0
        is_read = channel in relation.nodes and noisy and relation.kind != "known"
        return f"measured {channel}" if is_read else channel

    def _output(self, relation: Relation) -> tuple[LinearSignals, str]:
        """The output's reading less its own excitation, delayed by the relation's lead."""
        j = self.module[0]
        label = node_label(j)
        own = f"measured {label}" if self.network.sensor_noise.get(j, 0.0) > 0 else label
        if not (relation.takes_own or relation.lead):
            return self.system, own
        late = ([0.0] * relation.lead + [1.0], [1.0])
        named = f"{own} as explained"
        terms: dict[str, object] = {own: late}
        if relation.takes_own:
            system = self.system.with_signals(
                {"own excitation": {f"delta {label}": self.network.excitations[j].model}}
            )
            late_own = ([0.0] * relation.lead + [-1.0], [1.0])
            return system.with_signals({named: {**terms, "own excitation": late_own}}), named
        return self.system.with_signals({named: terms}), named
