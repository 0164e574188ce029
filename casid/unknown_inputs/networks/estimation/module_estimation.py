"""One call: a module of a network with known structure, estimated from a record.

from problems.network8 import simulate, table_network
network = table_network(measured=(1, 2, 3, 5, 7))
found = estimate_module(network, (2, 1), simulate(1, 4000), orders=Orders(nb=1, nf=1))
print(found)
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from casid.argument_types import names_wrong_types
from casid.data.record import Record
from casid.errors import DataError, IdentifiabilityError, ModelError
from casid.estimation.nlp.solver import Solver
from casid.estimation.prediction_error.polynomial.orders import Layout, Orders
from casid.unknown_inputs.networks.equations import ordered
from casid.unknown_inputs.networks.estimation.consistency import Consistency, consistency
from casid.unknown_inputs.networks.estimation.direct_method import direct
from casid.unknown_inputs.networks.estimation.joint_method import joint
from casid.unknown_inputs.networks.estimation.module_data import ModuleData, module_data
from casid.unknown_inputs.networks.estimation.module_equation import (
    Elimination,
    ModuleEquation,
    module_equation,
)
from casid.unknown_inputs.networks.estimation.module_estimate import ModuleEstimate
from casid.unknown_inputs.networks.estimation.module_fit import ModuleFit, without_noise
from casid.unknown_inputs.networks.estimation.module_instruments import by_instruments
from casid.unknown_inputs.networks.estimation.two_stage_method import two_stage
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.nodes import Edge, Node, edge_label, labels
from casid.unknown_inputs.networks.predictor_inputs import predictor_inputs
from casid.unknown_inputs.networks.simulation import refuse_continuous

Method = Literal["ls", "iv", "two_stage", "joint"]


@names_wrong_types(ModelError)
def estimate_module(
    network: Network,
    module: Edge,
    record: Record,
    *,
    orders: Orders,
    method: Method = "ls",
    inputs: Iterable[Node] | None = None,
    references: Collection[Node] | None = None,
    elimination: Elimination = "immersion",
    lags: int | None = None,
    prefilter_order: int = 10,
    solver: Solver | None = None,
    accept_bias: bool = False,
) -> ModuleEstimate:
    """Estimate G_ji from measured nodes and known excitations.

    Parameters
    ----------
    network : the structure; modules may be mere symbols. With numbers, delays are checked too.
    module : (to, from) = (j, i).
    record : channels w1, w2 .. (or the nodes' own names) and delta_n; means are taken off.
    orders : of the polynomials of the equation's inputs, named "w1" .. and "delta_n" where a
        reference enters the equation. `Orders(nb=1, nf=1)`: every module is b/(q - a).
    method : "ls", the direct prediction-error method (least squares for ARX orders); "iv",
        instrumental variables made of the references; "two_stage", inputs replaced by what the
        references make of them; "joint", quotient of the responses of output and inputs to the
        references.
    inputs : predictor inputs; by default the smallest set that keeps G_ji and suits the method.
    references : nodes whose delta is used, by default every excitation; the others count as
        disturbances.
    elimination : "immersion", or "indirect" where unknown inputs are eliminated by what is
        measured of them.
    lags : of the first stage's impulse responses, by default as many as these need; for
        "iv", lags of the references as instruments in place of signals simulated from them.
    prefilter_order : of the noise model that whitens the equation error for "iv"; 0 for none.
    solver : of the nonlinear minima, a `Solver`.
    accept_bias : estimate although the structure says that the method is not consistent.

    Raises
    ------
    ModelError
        If there is no such module, its ends or inputs have no sensor, no inputs keep it, or the
        method is not consistent here (confounder and path, and what would help).
    IdentifiabilityError
        If the references do not move the inputs (which), or coefficients are not identifiable.
    DataError
        If channels are missing, or the record is too short for the orders.
    SolveError
        If no optimum is reached.
    """
    refuse_continuous(network, "estimated from samples")
    _require_method(method)
    known = with_references(network, references)
    equation = _equation(known, module, method, inputs, elimination, orders)
    layout = Layout.of(orders, equation.names)
    verdict = _accepted_consistency(equation, module, method, layout, accept_bias)
    data = module_data(equation, record)
    _refuse_short(data, layout)
    fit = _fit(method, data, orders, lags, prefilter_order, solver)
    return ModuleEstimate(method, equation, verdict, fit, data)


def _require_method(method: Method) -> None:
    if method not in get_args(Method):
        raise ModelError(f"method = {method!r}; choose one of {', '.join(get_args(Method))}")


def _accepted_consistency(
    equation: ModuleEquation, module: Edge, method: Method, layout: Layout, accept_bias: bool
) -> Consistency:
    """Whether the method is consistent; refused if not, unless bias is accepted knowingly."""
    verdict = consistency(equation, method, layout)
    if not verdict.is_consistent and not (accept_bias and verdict.has_references):
        kind = ModelError if verdict.has_references else IdentifiabilityError
        end = ". accept_bias=True estimates all the same" if verdict.has_references else ""
        raise kind(f"{edge_label(module)} from {equation}: {verdict}{end}")
    return verdict


def with_references(network: Network, references: Collection[Node] | None) -> Network:
    """The network with these excitations known and the others among the disturbances.

    Raises
    ------
    ModelError
        If a reference is no excitation.
    """
    if references is None:
        return network
    strange = [n for n in references if n not in network.excitations]
    if strange:
        raise ModelError(
            f"{labels(strange)} has no excitation in {network.name}, which has those of "
            f"{labels(network.excitations)}; choose references among them, or add the excitation"
        )
    from casid.unknown_inputs.networks.network import Signal, dynamic_network

    aside = [n for n in network.excitations if n not in references]
    noise = {n: s.variance for n, s in network.disturbances.items()}
    taus = dict(network.disturbances)
    for n in aside:
        # Where from does not matter to the structure: one disturbance of the node stands for both.
        taus[n] = Signal(noise.get(n, 0.0) + network.excitations[n].variance)
    return dynamic_network(
        network.modules,
        nodes=network.nodes,
        excitations={n: network.excitations[n] for n in references},
        disturbances=taus,
        measured=network.measured,
        sensor_noise=network.sensor_noise,
        Ts=network.Ts if network.variable == "q" else None,
        name=network.name,
    )


# -- inside ----------------------------------------------------------------------------------------


def _equation(
    network: Network,
    module: Edge,
    method: str,
    inputs: Iterable[Node] | None,
    elimination: Elimination,
    orders: Orders,
) -> ModuleEquation:
    if module not in network.modules:
        raise ModelError(
            f"{network.name} has no module {edge_label(module)}; it has "
            f"{', '.join(edge_label(e) for e in network.modules)}"
        )
    if inputs is not None or elimination == "indirect":
        return module_equation(network, module, inputs or (), elimination)
    j, i = module
    search = predictor_inputs(network, j, i)
    if not search.sets:
        why = "; ".join(str(r) for r in search.refused if not r.remedies)
        raise ModelError(
            f"no measured inputs keep {edge_label(module)}: {why}. Add that sensor, give inputs= "
            "to estimate what it becomes, or elimination='indirect'"
        )
    bare = [s.inputs for s in search.sets]
    if method == "ls":
        more = predictor_inputs(network, j, i, without_confounders=True)
        bare = [*(s.inputs for s in more.sets), *bare]
    # With every measured predictor input beside them, fewer references enter the equation itself.
    beside = tuple(k for k in network.sources(j) if k in network.measured)
    candidates = dict.fromkeys([*bare, *(ordered(network.nodes, {*s, *beside}) for s in bare)])
    made = [module_equation(network, module, chosen) for chosen in candidates]
    made.sort(key=lambda e: len(e.excitations))
    for equation in made:
        try:
            layout = Layout.of(orders, equation.names)
        except ModelError:  # the orders are of other inputs
            continue
        if consistency(equation, method, layout).is_consistent:
            return equation
    return made[0]


def _refuse_short(data: ModuleData, layout: Layout) -> None:
    if data.N <= 3 * (layout.n + layout.longest_lag):
        raise DataError(
            f"{data.name}: {data.N} samples for {layout.n} coefficients that reach back "
            f"{layout.longest_lag} samples; lower the orders, or give a longer record"
        )


def _fit(
    method: str,
    data: ModuleData,
    orders: Orders,
    lags: int | None,
    prefilter_order: int,
    solver: Solver | None,
) -> ModuleFit:
    if method == "ls":
        return direct(data, orders, solver)
    if method == "two_stage":
        return two_stage(data, orders, lags, solver)
    if method == "joint":
        return joint(data, orders, lags, solver)
    # From consistent values where there are any: the program has many local optima.
    plain = without_noise(orders)
    starts: list[Callable[[], NDArray[np.float64]]] = [
        lambda: two_stage(data, plain, None, solver).theta,
        lambda: joint(data, plain, None, solver).theta,
        lambda: direct(data, plain, solver).theta,
    ]
    return by_instruments(
        data, orders, lags, starts, prefilter_order=prefilter_order, solver=solver
    )
