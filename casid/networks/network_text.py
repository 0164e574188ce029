"""Networks and their equations as a reader writes them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from casid.networks.graph import path_text
from casid.networks.network import Network, edge_label, labels, node_label

if TYPE_CHECKING:
    from casid.networks.equations import NodeEquations

_LONGEST = 400  # characters beyond which an entry is left out
_LOOPS = 5  # algebraic loops that are told


def page(network: Network) -> str:
    """One line for each node's equation, then modules, sensors and what is told of stability."""
    lines = [repr(network)]
    for n in network.nodes:
        terms = [f"{edge_label((n, k))} {node_label(k)}" for k in network.sources(n)]
        terms += [f"delta_{n}"] * (n in network.excitations)
        terms += [f"tau_{n}"] * (n in network.disturbances)
        lines.append(f"  {node_label(n)} = {' + '.join(terms) or '0'}")
    lines += [f"  {edge_label(edge)} = {g}" for edge, g in network.modules.items()]
    lines.append(f"  measured: {labels(network.measured)}; not: {labels(network.unmeasured)}")
    lines += [f"  {line}" for line in (_loops(network), _stability(network)) if line]
    return "\n".join(lines)


def equations_text(equations: NodeEquations) -> str:
    """One line for each node: modules and filters of external signals, long ones left out."""
    lines = [repr(equations)]
    for n in equations.nodes:
        terms = []
        for rows, name in ((equations.G, node_label), (equations.F, lambda k: f"e_{k}")):
            for k in rows[n]:
                entry = str(equations.field.back(rows[n][k]))
                entry = entry if len(entry) <= _LONGEST else "(...)"
                terms.append(name(k) if entry == "1" else f"({entry}) {name(k)}")
        lines.append(f"  {node_label(n)} = {' + '.join(terms) or '0'}")
    return "\n".join([*lines, "  e = delta + tau"])


def _loops(network: Network) -> str:
    from casid.networks.well_posed import algebraic_loops

    if network.parameters:
        return ""
    loops = algebraic_loops(network, most=_LOOPS + 1)
    told = "; ".join(path_text((*loop, loop[0])) for loop in loops[:_LOOPS])
    more = " and more" if len(loops) > _LOOPS else ""
    return f"algebraic loops: {told}{more}" if loops else "no algebraic loop"


def _stability(network: Network) -> str:
    if network.parameters:
        return f"symbolic in {', '.join(network.parameters)}"
    from casid.networks.dynamics import stability_text

    return stability_text(network)
