"""The equation a module is estimated from: which inputs it has, and what G_ji becomes in it.

Of the measured nodes only the output j and its predictor inputs are kept, and all others are
immersed ((3.21), (3.38) of Linder 2017), or unknown inputs are first eliminated by what is measured
of them ((4.24), indirect). G_ji may survive that or not (Propositions 3.1 and 4.1).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from casid.algebra.factoring import factored
from casid.errors import ModelError
from casid.unknown_inputs.networks.confounders import Confounder, confounders, confounders_in
from casid.unknown_inputs.networks.elimination import immerse
from casid.unknown_inputs.networks.equations import NodeEquations, ordered
from casid.unknown_inputs.networks.indirect_equations import indirect_equations
from casid.unknown_inputs.networks.network import Network, dynamic_network
from casid.unknown_inputs.networks.node_sets import NodeSets, node_sets
from casid.unknown_inputs.networks.nodes import Edge, Node, as_nodes, edge_label, labels, node_label
from casid.unknown_inputs.networks.prediction.observation_choice import chosen_sets
from casid.unknown_inputs.networks.random_equations import random_point

Elimination = Literal["immersion", "indirect"]
FAR = 1e4, 1e5  # q at which the leading powers alone are left, to four digits
SYMBOLIC_MOST = 14  # nodes of a network whose elimination is written out symbolically


@dataclass(frozen=True, eq=False)
class ModuleEquation:
    """w_j = sum_k Gt_jk w_k + sum_n Ft_jn delta_n + error, k in `inputs`, n in `excitations`.

    Attributes
    ----------
    network : with the references alone as excitations.
    module : (j, i).
    excitations : references that enter the equation past the inputs.
    subtracted : delta_j enters with the factor one exactly, so that it is known and subtracted.
    is_kept : whether Gt_ji = G_ji, decided exactly at random rational q.
    equations : of j and its inputs, exact, at the random q.
    delays : channel of `names` -> delay [samples] of Gt_jk or Ft_jn, negative where improper; empty
        where some module is a mere symbol.
    confounders : disturbances in the error and in an input alike.
    sets : of an indirect model, with the observations that are used.
    """

    network: Network
    module: Edge
    elimination: str
    inputs: tuple[Node, ...]
    excitations: tuple[Node, ...]
    subtracted: bool
    is_kept: bool
    equations: NodeEquations
    delays: dict[str, int]
    confounders: tuple[Confounder, ...]
    sets: NodeSets | None = None

    @cached_property
    def becomes(self) -> str:
        """Gt_ji in the symbols of the modules; empty for networks too large to write out."""
        if self.is_kept:
            return edge_label(self.module)
        return _symbolic(self.network, self.module, self.inputs, self.sets)

    @property
    def output(self) -> Node:
        """j."""
        return self.module[0]

    @property
    def references(self) -> tuple[Node, ...]:
        """Excitations in no unknown filter of the equation: through the inputs alone, or known."""
        return tuple(n for n in self.network.excitations if n not in self.excitations)

    @property
    def names(self) -> tuple[str, ...]:
        """Channels of the model's inputs: w of nodes, then delta of excitations."""
        return (*(node_label(k) for k in self.inputs), *(f"delta_{n}" for n in self.excitations))

    def __str__(self) -> str:
        what = edge_label(self.module)
        outcome = "is kept" if self.is_kept else f"becomes {self.becomes or 'another module'}"
        known = f" + delta_{self.output}" if self.subtracted else ""
        return f"{node_label(self.output)} from {', '.join(self.names)}{known}: {what} {outcome}"


def module_equation(
    network: Network,
    module: Edge,
    inputs: Iterable[Node],
    elimination: Elimination = "immersion",
) -> ModuleEquation:
    """The equation of the module's output in terms of chosen measured inputs.

    Parameters
    ----------
    inputs : predictor inputs; with "indirect" they have to be those of an indirect model. By
        default (empty) all of them; of more observations than unknown inputs those of least error
        variance (`casid.unknown_inputs.networks.prediction.observation_choice`).

    Raises
    ------
    ModelError
        If a node is not measured, the module's input is not among the inputs, or the indirect model
        has other inputs or does not exist.
    """
    j, i = module
    if elimination not in ("immersion", "indirect"):
        raise ModelError(f"elimination = {elimination!r}; choose 'immersion' or 'indirect'")
    chosen = tuple(dict.fromkeys(as_nodes(inputs)))
    sets = None
    q, values = random_point(network, np.random.default_rng(57))
    if elimination == "immersion":
        _refuse_inputs(network, module, chosen)
        reduced = immerse(network, (j, *chosen), at=q, values=values)
        common = confounders(network, j, chosen)
    else:
        sets = chosen_sets(network, node_sets(network, j), chosen)
        whole = indirect_equations(network, sets, at=q, values=values)
        row = ordered(network.nodes, whole.G[j])
        if chosen and set(chosen) != set(row):
            raise ModelError(
                f"the indirect model of {node_label(j)} has the inputs {labels(row)}, not "
                f"{labels(chosen)}; leave inputs= out, or choose other sensors"
            )
        chosen = row
        _refuse_inputs(network, module, chosen)
        reduced = immerse(whole, (j, *chosen))
        common = confounders_in(network, reduced, j, chosen)
    entering = tuple(n for n in network.excitations if n in reduced.F[j])
    own = reduced.F[j].get(j)
    subtracted = j in entering and own == 1 and _is_one_again(network, module, chosen, sets)
    return ModuleEquation(
        network=network,
        module=module,
        elimination=elimination,
        inputs=chosen,
        excitations=tuple(n for n in entering if not (subtracted and n == j)),
        subtracted=subtracted,
        is_kept=reduced.G[j].get(i, 0) == network.module(j, i).substitute(values).at(q),
        equations=reduced,
        delays=_delays(network, module, chosen, entering, sets),
        confounders=common,
        sets=sets,
    )


def _refuse_inputs(network: Network, module: Edge, chosen: tuple[Node, ...]) -> None:
    j, i = module
    blind = [n for n in (j, *chosen) if n not in network.measured]
    if blind:
        raise ModelError(
            f"{labels(blind)} has no sensor; choose inputs among {labels(network.measured)}"
        )
    if j in chosen:
        raise ModelError(f"{node_label(j)} cannot be its own predictor input; take it out")
    if i not in chosen:
        raise ModelError(
            f"{edge_label(module)} cannot be estimated without {node_label(i)} among the predictor "
            f"inputs {labels(chosen)}; add it"
        )


def _reduced(
    network: Network, j: Node, chosen: tuple[Node, ...], sets: NodeSets | None, **field: object
) -> NodeEquations:
    if sets is None:
        return immerse(network, (j, *chosen), **field)
    whole = indirect_equations(network, sets, **field)
    return immerse(whole, (j, *chosen))


def _is_one_again(
    network: Network, module: Edge, chosen: tuple[Node, ...], sets: NodeSets | None
) -> bool:
    q, values = random_point(network, np.random.default_rng(58))
    again = _reduced(network, module[0], chosen, sets, at=q, values=values)
    return bool(again.F[module[0]].get(module[0]) == 1)


def _delays(
    network: Network,
    module: Edge,
    chosen: tuple[Node, ...],
    entering: tuple[Node, ...],
    sets: NodeSets | None,
) -> dict[str, int]:
    """Relative degrees of the row, from its slope at two q far out."""
    if network.parameters:
        return {}
    j = module[0]
    far = _reduced(network, j, chosen, sets, at=np.array(FAR, dtype=complex))
    found = {node_label(k): far.G[j].get(k) for k in chosen}
    found |= {f"delta_{n}": far.F[j].get(n) for n in entering}
    return {
        n: -int(np.round(np.log(abs(x[1] / x[0])) / np.log(FAR[1] / FAR[0])))
        for n, x in found.items()
        if x is not None and np.all(x != 0)
    }


def _symbolic(
    network: Network, module: Edge, chosen: tuple[Node, ...], sets: NodeSets | None
) -> str:
    if len(network.nodes) > SYMBOLIC_MOST:
        return ""
    import sympy

    symbolic = dynamic_network(
        {e: sympy.Symbol(edge_label(e)) for e in network.modules},
        nodes=network.nodes,
        measured=network.measured,
        excitations=(),
    )
    j, i = module
    found = _reduced(symbolic, j, chosen, sets).module(j, i)
    return str(factored(found.expression())) if hasattr(found, "expression") else str(found)
