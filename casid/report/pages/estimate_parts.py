"""Parts of a report about estimates: parameters, evidence, provenance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from casid.estimation.estimate import Estimate
from casid.model.quantities import count_text
from casid.report.document import Bullets, Code, Part, Section, Strong, Table, mapping_table
from casid.report.numbers import estimated_texts, in_readable_unit, number_text
from casid.report.verdicts import status_words


def notice(notes: Sequence[str], warnings: Sequence[str]) -> Bullets:
    """Warnings and notes in a frame, each warning once."""
    warned = [(Strong("Warning: "), w) for w in dict.fromkeys(warnings)]
    return Bullets([*warned, *notes], look="notice")


def parameter_table(estimates: Mapping[str, Estimate], shown: Sequence[str] | None = None) -> Table:
    """Estimates side by side by label, with standard errors and intervals; all, or those shown."""
    several = len(estimates) > 1
    names = dict.fromkeys(n for e in estimates.values() for n in e.names)
    if shown is not None:
        names = dict.fromkeys(shown)
    found = {
        label: {p.name: p for p in (*e.parameters, *e.initial_states)}
        for label, e in estimates.items()
    }
    header = ["parameter", "unit"]
    for label in estimates:
        before = f"{label}: " if several else ""
        header += [f"{before}estimate", "std. error", "95 % interval"]
    header += ["start", "note"]
    rows = []
    for name in names:
        here = [found[label].get(name) for label in estimates]
        any_one = in_readable_unit(next(p for p in here if p is not None))
        here = [p if p is None else p.in_unit(any_one.unit) for p in here]
        cells = [name, any_one.unit]
        for p in here:
            cells += ["\u2013"] * 3 if p is None else list(estimated_texts(p))
        notes = [
            (f"{label}: " if several else "") + p.note
            for label, p in zip(estimates, here, strict=True)
            if p is not None and p.note
        ]
        if several and len({p.note for p in here if p is not None}) == 1 and None not in here:
            notes = [any_one.note] if any_one.note else []
        start = "" if any_one.start is None else number_text(any_one.start)
        rows.append([*cells, start, "; ".join(notes) or ("known" if any_one.known else "")])
    others = any(p.ends is not None for e in found.values() for p in e.values())
    kinds = (
        "95 % intervals, normal where no other kind is named" if others else "normal 95 % intervals"
    )
    is_known = all(p.known for e in found.values() for name, p in e.items() if name in names)
    return Table(
        header,
        rows,
        numbers=range(2, 3 + 3 * len(estimates)),
        caption="Known values" if is_known else f"Estimates with standard errors and {kinds}",
    )


def error_bars(estimates: Mapping[str, Estimate]) -> list[str]:
    """What the error bars assume, once where all assume the same."""
    assumed = {label: e.assumes for label, e in estimates.items() if e.assumes}
    if len(set(assumed.values())) == 1:
        return [f"Error bars: {next(iter(assumed.values()))}"]
    return [f"Error bars {label}: {text}" for label, text in assumed.items()]


def evidence_table(estimates: Mapping[str, Estimate]) -> Table:
    """Solver, identifiability and residuals of each estimate."""
    columns = []
    for e in estimates.values():
        i = e.identifiability
        seen = "all unknowns" if i.rank == i.unknowns else i.undetermined or "not all unknowns"
        facts = {
            "method": e.method,
            "status": status_words(e),
            "solver": f"{count_text(e.iterations, 'iteration')}, largest scaled "
            f"gradient {e.scaled_gradient:.0e}",
            "starts": f"{e.starts_agreeing} of {e.starts_tried} agree",
            "identifiable": f"{seen} (rank {i.rank} of {i.unknowns} at the estimate, smallest "
            f"singular value {i.smallest_singular_value:.2g}, scaled)",
            **({"structurally": i.structural} if i.structural else {}),
        }
        residuals = {f"residual of {k}": v for k, v in e.whiteness.items()}
        columns.append(facts | dict(e.evidence) | residuals)
    rows = dict.fromkeys(k for facts in columns for k in facts)
    return Table(
        ("", *estimates),
        [(k, *(facts.get(k, "\u2013") for facts in columns)) for k in rows],
        caption="Solver, identifiability and residuals",
    )


def provenance(
    lines: Sequence[str],
    settings: Mapping[str, str],
    versions: Mapping[str, str],
    *above: Part,
) -> Section:
    """Where the data come from, and what settings and versions worked on them."""
    data = Bullets([Code(line) for line in lines], look="lines", is_numbered=True)
    return Section(
        "Provenance",
        [
            *above,
            Section("Data", [data]),
            Section("Settings", [mapping_table(settings, ("setting", "value"))]),
            Section("Versions", [mapping_table(versions, ("package", "version"))]),
        ],
    )
