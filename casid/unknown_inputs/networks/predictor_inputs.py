"""Search over predictor inputs: which measured nodes suffice to find one module of a network.

A set of inputs keeps G_ji by immersion when it holds i, blocks every other path from i to j, and
every loop through j (Dankers, Van den Hof, Bombois & Heuberger 2016, Proposition 3). The smallest
sets are found by branching on what is violated: a set that leaves a path open needs
a measured node on that path, so every minimal set is met. Sets that may become the smallest come
first, by the number of open paths that share no measured node.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from dataclasses import dataclass

from casid.argument_types import names_wrong_types
from casid.deprecation import renamed
from casid.errors import ModelError
from casid.unknown_inputs.networks.confounders import Confounder, confounders
from casid.unknown_inputs.networks.graph import network_readers
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.nodes import (
    Edge,
    Node,
    edge_label,
    labels,
    node_label,
    path_text,
)
from casid.unknown_inputs.networks.propositions import open_path
from casid.unknown_inputs.networks.separators import disjoint_open_paths


@dataclass(frozen=True, slots=True)
class InputSet:
    """Predictor inputs that suffice, and what makes least squares on them biased.

    Attributes
    ----------
    inputs : the set.
    confounders : disturbances common to the output and an input.
    noisy : inputs whose sensor is noisy: an errors-in-variables problem (3.51).
    """

    inputs: tuple[Node, ...]
    confounders: tuple[Confounder, ...]
    noisy: tuple[Node, ...] = ()

    def __str__(self) -> str:
        text = "; ".join(map(str, self.confounders)) or "no confounder"
        if self.noisy:
            text += f"; noisy sensors on {labels(self.noisy)}"
        return f"{labels(self.inputs)}: {text}"


@dataclass(frozen=True, slots=True)
class RefusedSet:
    """Predictor inputs that do not suffice, and why.

    Attributes
    ----------
    inputs : the set.
    reason : the path, loop or confounder that is left.
    remedies : measured nodes that would block it; empty where no sensor lies on it.
    """

    inputs: tuple[Node, ...]
    reason: str
    remedies: tuple[Node, ...]

    mends = renamed("mends", "remedies")

    def __str__(self) -> str:
        return f"{labels(self.inputs)}: {self.reason}"


@dataclass(frozen=True, slots=True)
class InputSearch:
    """Predictor inputs for one module.

    Attributes
    ----------
    module : (j, i).
    sets : those that suffice, in order of size; none holds another.
    refused : those tried that do not, in order of size.
    is_complete : whether every minimal set is among them.
    """

    module: Edge
    sets: tuple[InputSet, ...]
    refused: tuple[RefusedSet, ...]
    is_complete: bool

    def __repr__(self) -> str:
        return (
            f"<InputSearch for {edge_label(self.module)}: {len(self.sets)} sets suffice, "
            f"{len(self.refused)} refused>"
        )

    def __str__(self) -> str:
        lines = [f"Predictor inputs for {edge_label(self.module)}"]
        lines += [f"  suffice   {found}" for found in self.sets] or ["  no measured set suffices"]
        lines += [f"  refused   {tried}" for tried in self.refused]
        if not self.is_complete:
            lines.append("  the search was cut short; raise most= or tries=")
        return "\n".join(lines)


@names_wrong_types(ModelError)
def predictor_inputs(
    network: Network,
    target: Node,
    source: Node,
    *,
    sensors: Iterable[Node] | None = None,
    without_confounders: bool = False,
    most: int = 20,
    tries: int = 2000,
) -> InputSearch:
    """The smallest sets of measured nodes that suffice as inputs for G_ji.

    Parameters
    ----------
    network : its nodes, modules and sensors.
    target, source : j and i; both have to be measured.
    sensors : nodes to choose from, by default the measured ones.
    without_confounders : whether sets with a confounder are refused, and extended by more inputs.
    most, tries : after how many sets, found or tried, the search stops.

    Raises
    ------
    ModelError
        If there is no such module, or one of its ends has no sensor.
    """
    sensors_used = network.measured if sensors is None else network.with_sensors(sensors).measured
    _refuse(network, target, source, sensors_used)
    blind = _past_all_sensors(network, target, source, sensors_used)
    if blind is not None:
        return InputSearch((target, source), (), (blind,), True)
    place = {n: i for i, n in enumerate(network.nodes)}
    readers = network_readers(network)
    others = frozenset(sensors_used) - {target, source}

    def least(chosen: tuple[int, ...]) -> float:
        """The size that a set which holds `chosen` and suffices has at least."""
        inputs = {network.nodes[i] for i in chosen}
        return len(chosen) + disjoint_open_paths(readers, target, source, inputs, others)

    start = (place[source],)
    heap: list[tuple[float, int, tuple[int, ...]]] = [(least(start), 1, start)]
    seen: set[tuple[int, ...]] = {start}
    found: list[InputSet] = []
    refused: list[RefusedSet] = []
    while heap and len(found) < most and len(found) + len(refused) < tries:
        _, _, chosen = heapq.heappop(heap)
        inputs = tuple(network.nodes[i] for i in chosen)
        if any(set(f.inputs) <= set(inputs) for f in found):
            continue
        verdict = _assessed(network, target, source, inputs, sensors_used, without_confounders)
        if isinstance(verdict, InputSet):
            found.append(verdict)
            continue
        refused.append(verdict)
        for n in verdict.remedies:
            grown = tuple(sorted((*chosen, place[n])))
            if grown not in seen:
                seen.add(grown)
                heapq.heappush(heap, (least(grown), len(grown), grown))
    refused.sort(key=lambda r: len(r.inputs))
    return InputSearch((target, source), tuple(found), tuple(refused), not heap)


def _past_all_sensors(
    network: Network, target: Node, source: Node, sensors_used: tuple[Node, ...]
) -> RefusedSet | None:
    """All sensors as inputs, where even they leave a path or loop open."""
    every = tuple(n for n in sensors_used if n != target)
    verdict = _assessed(network, target, source, every, sensors_used, False)
    return verdict if isinstance(verdict, RefusedSet) else None


def _assessed(
    network: Network,
    target: Node,
    source: Node,
    inputs: tuple[Node, ...],
    sensors_used: tuple[Node, ...],
    without_confounders: bool,
) -> InputSet | RefusedSet:
    path, loop = open_path(network, target, source, inputs)
    for what, trail in (("path", path), ("loop", loop)):
        if trail:
            return _refused(
                inputs, f"the {what} {path_text(trail)} is open", trail[1:-1], sensors_used
            )
    common = confounders(network, target, inputs)
    if common and without_confounders:
        c = common[0]
        trail = (*c.to_output[:-1], *(n for p in c.to_inputs[:1] for n in p[:-1]))
        return _refused(inputs, str(c), trail, sensors_used)
    noisy = tuple(n for n in inputs if network.sensor_noise.get(n, 0.0) > 0)
    return InputSet(inputs, common, noisy)


def _refused(
    inputs: tuple[Node, ...], reason: str, trail: tuple[Node, ...], sensors_used: tuple[Node, ...]
) -> RefusedSet:
    inside = tuple(dict.fromkeys(n for n in trail if n not in inputs))
    remedies = tuple(n for n in inside if n in sensors_used)
    if not remedies:
        reason += (
            f" and no sensor can block it; one on {' or '.join(map(node_label, inside))} would"
            if inside
            else " and nothing lies on it that could block it"
        )
    return RefusedSet(inputs, reason, remedies)


def _refuse(network: Network, target: Node, source: Node, sensors_used: tuple[Node, ...]) -> None:
    if (target, source) not in network.modules:
        raise ModelError(
            f"{network.name} has no module {edge_label((target, source))}; into "
            f"{node_label(target)} lead those from {labels(network.sources(target))}"
        )
    for n in (target, source):
        if n not in sensors_used:
            raise ModelError(
                f"{node_label(n)} has no sensor, so {edge_label((target, source))} cannot be found "
                f"by immersion; measure it, or eliminate it by what it acts on (node_sets)"
            )
