"""Networks and their equations as a reader writes them."""

from __future__ import annotations

from casid.algebra.rational import Rational
from casid.report.document import Document, Lines, Part, Table
from casid.unknown_inputs.networks.equations import NodeEquations
from casid.unknown_inputs.networks.estimation.module_estimate import ModuleEstimate
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.node_sets import NodeSets
from casid.unknown_inputs.networks.nodes import edge_label, labels, node_label, path_text
from casid.unknown_inputs.networks.prediction.predictors import INDIRECT, PredictorTable

_LONGEST = 400  # characters beyond which an entry is left out
_LOOPS = 5  # algebraic loops that are listed


def network_document(network: Network) -> Document:
    """One line for each node's equation, then modules, sensors and stability."""
    lines = []
    for n in network.nodes:
        terms = [f"{edge_label((n, k))} {node_label(k)}" for k in network.sources(n)]
        terms += [f"delta_{n}"] * (n in network.excitations)
        terms += [f"tau_{n}"] * (n in network.disturbances)
        lines.append(f"  {node_label(n)} = {' + '.join(terms) or '0'}")
    lines += [f"  {edge_label(edge)} = {g}" for edge, g in network.modules.items()]
    lines.append(f"  measured: {labels(network.measured)}; not: {labels(network.unmeasured)}")
    lines += [f"  {line}" for line in (_loops(network), _stability(network)) if line]
    return Document(repr(network), [Lines(lines)])


def equations_document(equations: NodeEquations) -> Document:
    """One line for each node: modules and filters of external signals, long ones left out."""
    lines = []
    for n in equations.nodes:
        terms = []
        for rows, name in ((equations.G, node_label), (equations.F, lambda k: f"e_{k}")):
            for k in rows[n]:
                entry = str(equations.field.back(rows[n][k]))
                entry = entry if len(entry) <= _LONGEST else "(...)"
                terms.append(name(k) if entry == "1" else f"({entry}) {name(k)}")
        lines.append(f"  {node_label(n)} = {' + '.join(terms) or '0'}")
    lines.append("  e = delta + tau")
    lines += [f"  {reason}" for reason in unrunnable(equations)]
    return Document(repr(equations), [Lines(lines)])


def unrunnable(equations: NodeEquations) -> list[str]:
    """Filters that cannot be run forward in time, and why, one line for each.

    Numbers have no such obstacle; symbolic filters are only checked for being improper.
    """
    if equations.field.name != "symbolic":
        return []
    reasons = []
    for n in equations.nodes:
        for rows, name in ((equations.G, node_label), (equations.F, lambda k: f"e_{k}")):
            for k in rows[n]:
                why = obstacle(equations.field.back(rows[n][k]))
                if why:
                    reasons.append(f"the filter of {name(k)} in {node_label(n)} is {why}")
    return reasons


def obstacle(g: Rational) -> str:
    """Why a filter cannot be run forward in time: IMPROPER, UNSTABLE; empty if it can be."""
    reasons = []
    if not g.is_proper:
        step = "order of derivatives" if g.variable == "s" else "samples it looks ahead"
        reasons.append(f"IMPROPER ({step}: {-g.relative_degree})")
    if not g.parameters and not g.is_stable:
        reasons.append(f"UNSTABLE (pole {next(r for r in g.poles() if not r.is_stable)})")
    return " and ".join(reasons)


def _loops(network: Network) -> str:
    from casid.unknown_inputs.networks.algebraic_loops import algebraic_loops

    if network.parameters:
        return ""
    loops = algebraic_loops(network, most=_LOOPS + 1)
    cycles = "; ".join(path_text((*loop, loop[0])) for loop in loops[:_LOOPS])
    more = " and more" if len(loops) > _LOOPS else ""
    return f"algebraic loops: {cycles}{more}" if loops else "no algebraic loop"


def _stability(network: Network) -> str:
    if network.parameters:
        return f"symbolic in {', '.join(network.parameters)}"
    from casid.unknown_inputs.networks.dynamics import stability_text

    return stability_text(network)


def predictors_document(found: PredictorTable) -> Document:
    """The predictors of a node beside each other, and why others do not exist."""
    rows: list[tuple[str, ...] | str] = []
    for p in found.predictors:
        r = p.row()
        errors = (f"{r[k]:.4g}" for k in ("error variance", "with its own past"))
        rows.append((r["predictor"], r["uses"], *errors, f" {r['remark']}" if r["remark"] else ""))
    rows += [f"{kind:<24}does not exist: {why}" for kind, why in found.refused]
    head = ("predictor", "uses", "plain", "+ own past", "")
    notes = []
    if found.observations is not None:
        remarks = (str(found.observations), found.observations.obstacle())
        notes = [f"  {INDIRECT}: {note}" for note in remarks if note]
    return Document(
        f"Predictors of {node_label(found.target)}: exact variance of the one-step error",
        [Table(head, rows, numbers=(2, 3), widths=(24, 34, 10, 12)), *notes],
    )


def module_document(found: ModuleEstimate) -> Document:
    """A module's estimate: equation, coefficients with their errors, what supports it."""
    rows = [
        ("equation", str(found.equation)),
        ("structure", str(found.consistency)),
        ("transfer", str(found.transfer_text())),
        *((n, f"{found[n]:.5g} +/- {found.std_error(n):.2g}") for n in found.names),
        ("errors assume", found.fit.assumes),
        *found.fit.evidence.items(),
        ("simulated fit", f"{found.simulated_fit():.1f} % from the measured inputs"),
    ]
    seen = found.reference_correlation()
    if seen:
        lags = ", ".join(f"{k}: {v} of 21 lags" for k, v in seen.items())
        rows.append(("residual", f"correlates with {lags} outside 95 %"))
    rows += [("NOTE", n) for n in found.fit.notes]
    return Document(
        f"Module {edge_label(found.module)} by {found.method} from {found.data.name} "
        f"({found.data.N} samples)",
        rows,
        label=max(len(label) for label, _ in rows) + 2,
    )


def node_sets_document(sets: NodeSets) -> Document:
    """Every set with its nodes, then where paths to and from unobservable nodes lead."""
    names = {
        "N": "predictor inputs",
        "S": "observable",
        "U": "unobservable",
        "K": "observable predictor inputs",
        "A": "additional observable",
        "sU": "unobservable predictor inputs",
        "Ut": "remaining unobservable",
        "D": "direct observations",
        "I": "indirect observations",
        "O": "remaining observable",
    }
    parts: list[Part] = [(f"{k:<3} {v}", labels(getattr(sets, k))) for k, v in names.items()]
    for u in sets.U:
        to, since = labels(sets.upstream[u]), labels(sets.downstream[u])
        parts.append(f"  {node_label(u)}: upstream {to}; downstream {since}")
    return Document(f"Node sets of {node_label(sets.target)}", parts, label=35)
