"""Networks and their equations as a reader writes them."""

from __future__ import annotations

from casid.algebra.rational import Rational
from casid.unknown_inputs.networks.equations import NodeEquations
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.nodes import edge_label, labels, node_label, path_text

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
    lines.append("  e = delta + tau")
    return "\n".join(lines + [f"  {told}" for told in unrunnable(equations)])


def unrunnable(equations: NodeEquations) -> list[str]:
    """What is to be told of filters that cannot be run forward in time, one line for each.

    Of numbers nothing can be told; of filters with letters only whether they are improper.
    """
    if equations.field.name != "symbolic":
        return []
    told = []
    for n in equations.nodes:
        for rows, name in ((equations.G, node_label), (equations.F, lambda k: f"e_{k}")):
            for k in rows[n]:
                why = obstacle(equations.field.back(rows[n][k]))
                if why:
                    told.append(f"the filter of {name(k)} in {node_label(n)} is {why}")
    return told


def obstacle(g: Rational) -> str:
    """Why a filter cannot be run forward in time: IMPROPER, UNSTABLE; empty if it can be."""
    said = []
    if not g.is_proper:
        step = "order of derivatives" if g.variable == "s" else "samples it looks ahead"
        said.append(f"IMPROPER ({step}: {-g.relative_degree})")
    if not g.parameters and not g.is_stable:
        said.append(f"UNSTABLE (pole {next(r for r in g.poles() if not r.is_stable)})")
    return " and ".join(said)


def _loops(network: Network) -> str:
    from casid.unknown_inputs.networks.algebraic_loops import algebraic_loops

    if network.parameters:
        return ""
    loops = algebraic_loops(network, most=_LOOPS + 1)
    told = "; ".join(path_text((*loop, loop[0])) for loop in loops[:_LOOPS])
    more = " and more" if len(loops) > _LOOPS else ""
    return f"algebraic loops: {told}{more}" if loops else "no algebraic loop"


def _stability(network: Network) -> str:
    if network.parameters:
        return f"symbolic in {', '.join(network.parameters)}"
    from casid.unknown_inputs.networks.dynamics import stability_text

    return stability_text(network)
