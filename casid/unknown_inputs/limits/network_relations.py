"""The relations that a module of a network can be estimated from, each with its own structure.

A relation has the output w_j (less its own delta_j, where that enters as it is), the measured nodes
and the known excitations beside it, and a transfer function from each. They are the predictors of
(6.1)-(6.11) of Linder (2017): every input known, the unmeasured neglected, immersed, or eliminated.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass

from casid.algebra.rational import Rational, rational
from casid.errors import ModelError
from casid.estimation.prediction_error.polynomial.orders import Orders
from casid.unknown_inputs.networks.confounders import Confounder, confounders, confounders_in
from casid.unknown_inputs.networks.estimation.module_equation import module_equation
from casid.unknown_inputs.networks.indirect_equations import indirect_equations
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.node_sets import NodeSets, node_sets
from casid.unknown_inputs.networks.nodes import Edge, Node, edge_label, labels, node_label
from casid.unknown_inputs.networks.prediction.node_predictor import NodePredictor
from casid.unknown_inputs.networks.prediction.observation_choice import INDIRECT, chosen_sets
from casid.unknown_inputs.networks.prediction.predictors import (
    ALL_INPUTS,
    IMMERSED,
    IMMERSED_ALL,
    NEGLECT,
    all_inputs,
    immersed,
    neglecting,
)
from casid.unknown_inputs.networks.prediction.row_predictor import row_predictor
from casid.unknown_inputs.networks.random_equations import random_equations

_PRIMES = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47)
TRUE = "true relation"  # all inputs as their sensors read
KINDS = {ALL_INPUTS: "known", NEGLECT: "neglect", IMMERSED: "immerse", IMMERSED_ALL: "immerse",
         INDIRECT: "eliminate"}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Relation:
    """w_j = sum of modules times channels + error.

    Attributes
    ----------
    name, kind : class of the predictor, kind of the remedy.
    modules : channel -> transfer function; channels are w1 .. and, white ahead of their noise
        models, "delta w6".
    nodes : channel -> node, for those that have a sensor.
    takes_own : delta_j enters as it is, and is taken from the output.
    remark : what becomes of the module, and what confounds.
    """

    name: str
    kind: str
    modules: Mapping[str, Rational]
    nodes: Mapping[str, Node]
    takes_own: bool
    remark: str

    @property
    def lead(self) -> int:
        """Samples of the future that it needs; the output is delayed by as many."""
        return max(0, *(-g.relative_degree for g in self.modules.values()))

    def orders(self, most: int) -> Orders:
        """Orders of B_k/F_k for each channel, at most nb and nf, with C and D of order one."""
        size = {n: _orders(g) for n, g in self.modules.items()}
        return Orders(
            nb={n: min(nb, most) for n, (nb, _) in size.items()},
            nf={n: min(nf, most) for n, (_, nf) in size.items()},
            nk=self.delays,
            nc=1,
            nd=1,
        )

    @property
    def delays(self) -> dict[str, int]:
        """Delay of each channel to the delayed output [samples]."""
        return {n: g.relative_degree + self.lead for n, g in self.modules.items()}

    def common_denominator(self) -> Orders:
        """Orders of A w_j = sum B_k channel_k + A error, which is linear in its coefficients."""
        # In a sum with generic factors nothing cancels but what all denominators share.
        total = rational(0)
        for prime, g in zip(_PRIMES * len(self.modules), self.modules.values(), strict=False):
            total = total + g * prime
        below = Rational(total.denominator)
        nb = {n: _orders(g * below)[0] for n, g in self.modules.items()}
        return Orders(na=_orders(total)[1], nb=nb, nk=self.delays)

    def start(self, orders: Orders) -> dict[str, float]:
        """The true coefficients, where the orders hold them."""
        made: dict[str, float] = {}
        for n, g in self.modules.items():
            nb, nf = (o[n] if isinstance(o, Mapping) else o for o in (orders.nb, orders.nf))
            if _orders(g)[0] > nb or _orders(g)[1] > nf:
                continue
            first = self.delays[n]
            made |= {f"b{first + k}[{n}]": float(b) for k, b in enumerate(g.numerator[:nb])}
            made |= {f"f{k}[{n}]": float(a) for k, a in enumerate(g.denominator[1 : nf + 1], 1)}
        return made


def _orders(g: Rational) -> tuple[int, int]:
    """Coefficients of B and F in powers of q^-1."""
    above, below = (len(p) - _zeros_behind(p) for p in (g.numerator, g.denominator))
    return above, below - 1


def _zeros_behind(p: tuple[object, ...]) -> int:
    kept = [i for i, c in enumerate(p) if c != 0]
    return len(p) - 1 - kept[-1] if kept else 0


def network_relations(
    network: Network, module: Edge, known: Collection[Edge] = ()
) -> tuple[NodeSets, list[Relation], list[tuple[str, str]]]:
    """The relations that hold the module's input, and why the others do not serve.

    Parameters
    ----------
    known : modules whose transfer function is known, for direct measurements.

    Raises
    ------
    ModelError
        If there is no such module, or its output has no sensor.
    """
    j, i = module
    if module not in network.modules:
        raise ModelError(
            f"{network.name} has no module {edge_label(module)}; into {node_label(j)} lead those "
            f"from {labels(network.sources(j))}"
        )
    sets = chosen_sets(network, node_sets(network, j, known=known))
    every = (*sets.K, *sets.A)
    makers: dict[str, Callable[[], NodePredictor]] = {
        ALL_INPUTS: lambda: all_inputs(network, j),
        NEGLECT: lambda: neglecting(network, sets),
        IMMERSED: lambda: immersed(network, sets),
        IMMERSED_ALL: lambda: immersed(network, sets, inputs=every),
        INDIRECT: lambda: row_predictor(network, indirect_equations(network, sets), j, INDIRECT),
    }
    if not sets.sU:  # the true relation is there
        makers = {k: makers[k] for k in (ALL_INPUTS, IMMERSED_ALL)}
        if not sets.A:
            del makers[IMMERSED_ALL]
    found: list[Relation] = []
    refused: list[tuple[str, str]] = []
    for name, make in makers.items():
        try:
            predictor = make()
            if i not in predictor.inputs:
                why = "has no sensor" if i in sets.U else "is no longer in the equation"
                raise ModelError(
                    f"{node_label(i)} {why}, so {edge_label(module)} is not in this relation"
                )
        except ModelError as why:
            refused.append((name, str(why)))
            continue
        if name == IMMERSED_ALL and any(
            r.name == IMMERSED and set(r.nodes.values()) == set(predictor.inputs) for r in found
        ):
            continue  # the other sensors add nothing
        if sets.sU or name != ALL_INPUTS or any(network.sensor_noise.get(k) for k in sets.K):
            found.append(_relation(network, module, sets, predictor, name, KINDS[name]))
        if not sets.sU and name == ALL_INPUTS:
            found.append(_relation(network, module, sets, predictor, TRUE, "measured"))
    return sets, found, refused


def _relation(
    network: Network, module: Edge, sets: NodeSets, p: NodePredictor, name: str, kind: str
) -> Relation:
    j, _ = module
    own = p.excitations.get(j)
    takes_own = own is not None and own.equals(1)
    nodes = {node_label(k): k for k in p.inputs}
    modules = {node_label(k): g for k, g in p.inputs.items()}
    for n, g in p.excitations.items():
        if not (n == j and takes_own):
            modules[f"delta {node_label(n)}"] = g * network.excitations[n].model
    parts = _remarks(network, module, sets, p, kind)
    return Relation(name, kind, modules, nodes, takes_own, "; ".join(parts))


def _remarks(
    network: Network, module: Edge, sets: NodeSets, p: NodePredictor, kind: str
) -> list[str]:
    """What becomes of the module, and what confounds."""
    j, i = module
    parts = []
    if kind == "neglect":
        parts.append(f"what {labels(sets.sU)} sends is in the error")
    elif not p.inputs[i].equals(network.module(j, i)):
        way, inputs = ("indirect", ()) if kind == "eliminate" else ("immersion", tuple(p.inputs))
        becomes = module_equation(network, module, inputs, way).becomes  # type: ignore[arg-type]
        parts.append(f"{edge_label(module)} becomes {becomes or 'another module'}")
    elif kind in ("immerse", "eliminate"):
        parts.append(f"{edge_label(module)} is kept")
    parts += [str(c) for c in _confounders(network, sets, p.inputs, kind)]
    past = [f"delta_{n}" for n in network.excitations if f"delta_{n}" in p.error]
    if past:
        parts.append(f"{', '.join(past)} is in the error and no instrument")
    noisy = [k for k in p.inputs if kind != "known" and network.sensor_noise.get(k, 0.0) > 0]
    if noisy:
        parts.append(f"noisy sensors on {labels(noisy)} (errors in variables)")
    return parts


def _confounders(
    network: Network, sets: NodeSets, inputs: Iterable[Node], kind: str
) -> tuple[Confounder, ...]:
    if kind != "eliminate":
        measured_network = network.with_sensors(network.nodes) if kind == "known" else network
        return confounders(measured_network, sets.target, inputs)
    equations = indirect_equations(random_equations(network, 31), sets)
    return confounders_in(network, equations, sets.target, inputs)
