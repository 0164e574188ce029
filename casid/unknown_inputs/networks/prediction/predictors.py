"""The predictors of a node, class by class: (6.1)-(6.11) of Linder (2017)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass

from casid.algebra.rational import Rational, rational
from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.presentation import Presented
from casid.unknown_inputs.networks.elimination import immerse
from casid.unknown_inputs.networks.equations import node_equations
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.node_sets import NodeSets, sets_for
from casid.unknown_inputs.networks.nodes import Edge, Node, as_nodes, node_label
from casid.unknown_inputs.networks.prediction.node_predictor import NodePredictor
from casid.unknown_inputs.networks.prediction.observation_choice import INDIRECT as INDIRECT
from casid.unknown_inputs.networks.prediction.observation_choice import (
    ObservationChoices,
    observation_choices,
)
from casid.unknown_inputs.networks.prediction.row_predictor import predictor_of, row_predictor
from casid.unknown_inputs.networks.simulation import refuse_continuous

ALL_INPUTS, NEGLECT = "all inputs known", "neglect"
IMMERSED, IMMERSED_ALL = "immersed", "immersed, all measured"


def all_inputs(network: Network, target: Node, *, use_excitations: bool = True) -> NodePredictor:
    """(6.1): as if every node with a module into the target were measured; its error is tau_j.

    A reference that no predictor without it can beat; sensor noise is not counted.
    """
    row = {k: network.module(target, k) for k in network.sources(target)}
    quiet = network.with_sensors(network.nodes)
    return predictor_of(
        _without_sensor_noise(quiet),
        target,
        ALL_INPUTS,
        row,
        {target: rational(1)},
        use_excitations=use_excitations,
    )


def neglecting(network: Network, sets: NodeSets) -> NodePredictor:
    """(6.2)-(6.3): modules from measured nodes and delta_j; what other nodes send is the error."""
    target = sets.target
    row = {k: network.module(target, k) for k in sets.K}
    # w_sU by the externals of the whole network: every other node immersed in it.
    error: dict[Node, Rational] = {target: rational(1)}
    for u in sets.sU:
        alone = immerse(node_equations(network), [u])
        for n in alone.externals(u):
            term = network.module(target, u) * alone.filter(u, n)
            error[n] = error[n] + term if n in error else term
    return predictor_of(network, target, NEGLECT, row, error, use_excitations=False)


def immersed(
    network: Network,
    sets: NodeSets,
    *,
    inputs: Iterable[Node] | None = None,
    use_excitations: bool = True,
) -> NodePredictor:
    """(6.5)-(6.6): all nodes but the target and `inputs` immersed (default K, predictor inputs).

    Example 3.4 with K = {1, 3}; Example 3.7 with all measured nodes.
    """
    chosen = sets.K if inputs is None else as_nodes(inputs)
    every = set(chosen) == set(sets.S) - {sets.target}
    found = immerse(node_equations(network), [sets.target, *chosen])
    kind = IMMERSED_ALL if every and inputs is not None else IMMERSED
    return row_predictor(network, found, sets.target, kind, use_excitations=use_excitations)


def indirect(network: Network, sets: NodeSets, *, use_excitations: bool = True) -> NodePredictor:
    """(4.24) and (6.11) corrected: unmeasured inputs eliminated by nodes that they act on.

    Of more observations than unknown inputs those of least error variance:
    `casid.unknown_inputs.networks.prediction.observation_choice`.
    """
    return observation_choices(network, sets, use_excitations=use_excitations).best.predictor


@dataclass(frozen=True, slots=True, eq=False)
class PredictorTable(Presented):
    """The predictors of one node beside each other.

    Attributes
    ----------
    predictors : in the order of the classes.
    refused : class -> why it does not exist here.
    observations : the choices of observations for the indirect class, the one it uses first; None
        where it does not exist.
    """

    target: Node
    predictors: tuple[NodePredictor, ...]
    refused: tuple[tuple[str, str], ...] = ()
    observations: ObservationChoices | None = None

    def __getitem__(self, kind: str) -> NodePredictor:
        for p in self.predictors:
            if p.kind == kind:
                return p
        why = dict(self.refused).get(
            kind, f"there are {', '.join(p.kind for p in self.predictors)}"
        )
        raise ModelError(f"no predictor {kind!r}: {why}")

    def __repr__(self) -> str:
        kinds = "; ".join(p.kind for p in self.predictors)
        return f"<PredictorTable of {node_label(self.target)}: {kinds}>"


@names_wrong_types(ModelError)
def compare_predictors(
    network: Network,
    target: Node,
    *,
    sensors: Iterable[Node] | None = None,
    known: Collection[Edge] = (),
    sets: NodeSets | None = None,
    use_excitations: bool = True,
) -> PredictorTable:
    """All classes of predictors for one node, with the exact variance of each error.

    Parameters
    ----------
    sensors : measured nodes; by default the network's own.
    known : modules whose transfer function is known, for direct measurements.
    sets : the node sets themselves, to name the observations; where they hold more than there are
        unknown inputs, and by default, those of least error variance are taken.
    use_excitations : False: known delta are not used.

    Raises
    ------
    ModelError
        If the network is continuous, unstable, the target is not measured, or sets are given that
        are another target's or another network's.
    """
    refuse_continuous(network, "predicted one step ahead")
    if sensors is not None:
        network = network.with_sensors(sensors)
    sets = sets_for(network, target, sets, known)
    choices: list[ObservationChoices] = []

    def indirect_one() -> NodePredictor:
        choices.append(observation_choices(network, sets, use_excitations=use_excitations))
        return choices[0].best.predictor

    makers: tuple[tuple[str, Callable[[], NodePredictor]], ...] = (
        (ALL_INPUTS, lambda: all_inputs(network, target, use_excitations=use_excitations)),
        (NEGLECT, lambda: neglecting(network, sets)),
        (IMMERSED, lambda: immersed(network, sets, use_excitations=use_excitations)),
        (
            IMMERSED_ALL,
            lambda: immersed(
                network, sets, inputs=(*sets.K, *sets.A), use_excitations=use_excitations
            ),
        ),
        (INDIRECT, indirect_one),
    )
    found, refused = [], []
    for kind, make in makers:
        try:
            found.append(make())
        except ModelError as why:
            refused.append((kind, str(why)))
    observations = choices[0] if choices and sets.sU else None
    return PredictorTable(target, tuple(found), tuple(refused), observations)


# -- inside ----------------------------------------------------------------------------------------


def _without_sensor_noise(network: Network) -> Network:
    from casid.unknown_inputs.networks.network import dynamic_network

    return dynamic_network(
        network.modules,
        nodes=network.nodes,
        excitations=network.excitations,
        disturbances=network.disturbances,
        Ts=network.Ts if network.variable == "q" else None,
        name=network.name,
    )
