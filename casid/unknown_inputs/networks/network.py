"""A dynamic network as a value: nodes, modules between them, and what enters from outside.

w_j = sum_k G_jk(q) w_k + delta_j + tau_j                    (Linder 2017, (2.2)-(2.5))
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from casid.algebra.rational import Rational, rational
from casid.algebra.transfer_matrix import shared_time
from casid.errors import ModelError
from casid.presentation import Presented
from casid.unknown_inputs.networks.nodes import Edge, Node, as_nodes, edge_label
from casid.unknown_inputs.networks.well_posedness import require_well_posed


@dataclass(frozen=True, slots=True)
class Signal:
    """White noise of a variance through a filter: what enters a node from outside.

    Attributes
    ----------
    variance : of the white noise, its intensity in continuous time; >= 0.
    model : the filter H, 1 by default.
    """

    variance: float = 1.0
    model: Rational = field(default_factory=lambda: rational(1))

    def __post_init__(self) -> None:
        if not self.variance >= 0:
            raise ModelError(f"the variance of an external signal is {self.variance}; give >= 0")


@dataclass(frozen=True, slots=True, eq=False)
class Network(Presented):
    """A well-posed network of rational modules; made by `dynamic_network`.

    Attributes
    ----------
    nodes : names, in the order of `G` and of every matrix made from the network.
    modules : (to, from) -> nonzero transfer function; no self loops.
    excitations : node -> delta_j, known to the user.
    disturbances : node -> tau_j, unknown and independent of each other.
    measured : nodes with a sensor, in the order of `nodes`.
    sensor_noise : measured node -> variance of its white sensor noise; absent is none.
    Ts : sample time [s]; None where no module has one, 0 in continuous time.
    name : for pictures and messages.
    """

    nodes: tuple[Node, ...]
    modules: Mapping[Edge, Rational]
    excitations: Mapping[Node, Signal]
    disturbances: Mapping[Node, Signal]
    measured: tuple[Node, ...]
    sensor_noise: Mapping[Node, float]
    Ts: float | None = None
    variable: str = ""
    name: str = "network"

    def module(self, to: Node, source: Node) -> Rational:
        """G_to,source; zero where there is no module."""
        return self.modules.get((to, source), Rational(()))

    def sources(self, node: Node) -> tuple[Node, ...]:
        """N_j: the nodes with a module into `node` (predictor inputs), in the order of nodes."""
        return tuple(k for k in self.nodes if (node, k) in self.modules)

    @property
    def unmeasured(self) -> tuple[Node, ...]:
        """The nodes without a sensor."""
        seen = set(self.measured)
        return tuple(k for k in self.nodes if k not in seen)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the symbols without a value, sorted."""
        return tuple(sorted({n for g in self.modules.values() for n in g.parameters}))

    def substitute(self, values: Mapping[str, Any]) -> Network:
        """The network with parameters replaced by numbers, checked anew.

        Raises
        ------
        ModelError
            If no module has a parameter of that name.
        """
        _refuse_unknown_values(self.modules.values(), values, self.name)
        return dynamic_network(
            {edge: g.substitute(values) for edge, g in self.modules.items()},
            nodes=self.nodes,
            excitations=self.excitations,
            disturbances=self.disturbances,
            measured=self.measured,
            sensor_noise=self.sensor_noise,
            Ts=self.Ts if self.variable == "q" else None,
            name=self.name,
        )

    def without(self, *edges: Edge) -> Network:
        """The network with the modules (to, from) taken out.

        Raises
        ------
        ModelError
            If there is no such module.
        """
        for edge in edges:
            if edge not in self.modules:
                raise ModelError(f"{self.name}: there is no module {edge_label(edge)} to take out")
        kept = {e: g for e, g in self.modules.items() if e not in edges}
        return self._with(modules=kept)

    def with_sensors(self, measured: Iterable[Node]) -> Network:
        """The network with other measured nodes; noise of those that stay is kept."""
        chosen = as_nodes(measured)
        noise = {k: v for k, v in self.sensor_noise.items() if k in chosen}
        return self._with(measured=chosen, sensor_noise=noise)

    def _with(self, **changes: Any) -> Network:
        given: dict[str, Any] = {
            "modules": self.modules,
            "nodes": self.nodes,
            "excitations": self.excitations,
            "disturbances": self.disturbances,
            "measured": self.measured,
            "sensor_noise": self.sensor_noise,
            "Ts": self.Ts if self.variable == "q" else None,
            "name": self.name,
        }
        return dynamic_network(**(given | changes))

    def __repr__(self) -> str:
        step = f", Ts = {self.Ts:g} s" if self.variable == "q" and self.Ts else ""
        return (
            f"<Network {self.name}: {len(self.nodes)} nodes, {len(self.measured)} measured, "
            f"{len(self.modules)} modules{step}>"
        )


def dynamic_network(
    modules: Mapping[Edge, Any],
    *,
    nodes: Iterable[Node] | None = None,
    excitations: Mapping[Node, Any] | Iterable[Node] = (),
    disturbances: Mapping[Node, Any] | Iterable[Node] | None = None,
    measured: Iterable[Node] | None = None,
    sensor_noise: Mapping[Node, float] | None = None,
    Ts: float | None = None,
    values: Mapping[str, Any] | None = None,
    name: str = "network",
) -> Network:
    """Build a network and check it.

    Parameters
    ----------
    modules : (to, from) -> transfer function, anything `rational` takes; a
        bare sympy symbol is a module that nothing is known of. Zero modules are dropped.
    nodes : names in the order wanted; by default those of `modules`, sorted where they can be.
    excitations : nodes with a known delta_j, or node -> variance or `Signal`.
    disturbances : nodes with tau_j, or node -> variance or `Signal`; by default every node has one
        of unit variance, as in (2.2). () is none.
    measured : nodes with a sensor; by default all. Here as everywhere a text stands for the one
        node of that name, not for its characters.
    sensor_noise : measured node -> variance of white sensor noise.
    Ts : sample time [s] of modules that do not carry their own.
    values : numbers for parameters of the modules.

    Raises
    ------
    ModelError
        If there is no node, a module is a self loop or joins an unknown node, variables or sample
        times differ, a module is improper, or the network is ill-posed (the minor is named).

    Example
    -------
    >>> import casid
    >>> import sympy
    >>> q = sympy.Symbol("q")
    >>> modules = {(2, 1): 0.5 / q, (3, 2): 0.8 / q, (3, 1): 0.3 / q}
    >>> network = casid.dynamic_network(modules, excitations=[1], measured=[1, 3], Ts=1.0)
    >>> network
    <Network network: 3 nodes, 2 measured, 3 modules, Ts = 1 s>
    """
    read = _read_modules(modules, Ts, values, name)
    known = _names(nodes, read, name)
    if not known:
        raise ModelError(
            f"{name} has no module and no node; give modules {{(to, from): transfer function}}, or "
            "nodes="
        )
    kept = {edge: g for edge, g in read.items() if not g.is_zero}
    sensors = _subset(known, known if measured is None else measured, "measured", name)
    noise = {k: float(v) for k, v in (sensor_noise or {}).items()}
    _subset(sensors, noise, "sensor_noise", name, "is not measured")
    taus = known if disturbances is None else disturbances
    shared = shared_time(list(kept.values()))
    network = Network(
        nodes=known,
        modules=MappingProxyType(kept),
        excitations=MappingProxyType(_signals(known, excitations, "excitations", name)),
        disturbances=MappingProxyType(_signals(known, taus, "disturbances", name)),
        measured=sensors,
        sensor_noise=MappingProxyType(noise),
        Ts=0.0 if shared[0] == "s" else shared[1] or Ts,
        variable=shared[0],
        name=name,
    )
    require_well_posed(known, kept, name)
    return network


def _read_modules(
    modules: Mapping[Edge, Any], Ts: float | None, values: Mapping[str, Any] | None, name: str
) -> dict[Edge, Rational]:
    """The modules as rational functions, with numbers for the parameters that have values."""
    if not isinstance(modules, Mapping):
        raise ModelError(
            f"{name}: modules is a {type(modules).__name__}; give a mapping of (to, from) to a "
            "transfer function, {('y', 'u'): G}"
        )
    read = {_checked_edge(edge, name): _module(edge, g, Ts, name) for edge, g in modules.items()}
    if values:
        _refuse_unknown_values(read.values(), values, name)
        read = {edge: g.substitute(values) for edge, g in read.items()}
    return read


def _checked_edge(edge: Any, name: str) -> Edge:
    if not isinstance(edge, tuple) or len(edge) != 2:
        raise ModelError(f"{name}: a module is named by (to, from), not by {edge!r}")
    if edge[0] == edge[1]:
        raise ModelError(
            f"{name}: {edge_label(edge)} is a self loop; divide the node's other modules and its "
            f"external signals by 1 - {edge_label(edge)} instead (normalisation)"
        )
    return edge


def _module(edge: Edge, value: Any, Ts: float | None, name: str) -> Rational:
    try:
        g = rational(value, Ts=Ts)
    except ModelError as reason:
        raise ModelError(f"{name}: module {edge_label(edge)}: {reason}") from reason
    if not g.is_proper:
        raise ModelError(
            f"{name}: module {edge_label(edge)} = {g} is improper, so the network is not well "
            "posed; delay or filter it"
        )
    return g


def _refuse_unknown_values(
    modules: Iterable[Rational], values: Mapping[str, Any], name: str
) -> None:
    names = {n for g in modules for n in g.parameters}
    strange = sorted(set(values) - names)
    if strange:
        raise ModelError(
            f"{name}: a value is given for {', '.join(strange)}, which no module has; their "
            f"parameters are {', '.join(sorted(names)) or 'none'}"
        )


def _names(
    nodes: Iterable[Node] | None, modules: Mapping[Edge, Rational], name: str
) -> tuple[Node, ...]:
    if nodes is None:
        found = dict.fromkeys(n for edge in modules for n in edge)
        try:
            return tuple(sorted(found))
        except TypeError:  # names of several kinds have no order
            return tuple(found)
    given = as_nodes(nodes)
    twice = [n for n in given if given.count(n) > 1]
    if twice:
        raise ModelError(f"{name}: the node {twice[0]!r} is named twice; name every node once")
    for n in given:
        if not isinstance(n, Hashable):
            raise ModelError(f"{name}: {n!r} cannot name a node; use a number or a text")
    for edge in modules:
        for n in edge:
            if n not in given:
                raise ModelError(
                    f"{name}: module {edge_label(edge)} joins the unknown node {n!r}; the nodes "
                    f"are {', '.join(map(repr, given))}. Add it to nodes=, or correct the module"
                )
    return given


def _subset(
    known: tuple[Node, ...], chosen: Iterable[Node], what: str, name: str, why: str = "is no node"
) -> tuple[Node, ...]:
    wanted = set(as_nodes(chosen))
    strange = wanted - set(known)
    if strange:
        raise ModelError(
            f"{name}: {what} names {', '.join(sorted(map(repr, strange)))}, which {why}; "
            f"choose among {', '.join(map(repr, known))}"
        )
    return tuple(n for n in known if n in wanted)


def _signals(known: tuple[Node, ...], given: Any, what: str, name: str) -> dict[Node, Signal]:
    chosen = given if isinstance(given, Mapping) else dict.fromkeys(as_nodes(given), 1.0)
    _subset(known, chosen, what, name)
    return {n: _signal(chosen[n]) for n in known if n in chosen}


def _signal(given: Any) -> Signal:
    return given if isinstance(given, Signal) else Signal(float(given))
