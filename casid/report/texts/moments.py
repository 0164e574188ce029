"""Convergence, black-box models, validation and invariants of moment estimates, as documents."""

from __future__ import annotations

from collections.abc import Iterable

from casid.estimation.moments.instruments.black_box_reference import BlackBoxReferences
from casid.estimation.moments.stages.convergence import Convergence
from casid.estimation.moments.validation import Validation
from casid.identifiability.combinations.family_estimate import AlongFamily
from casid.identification.invariants import Invariants
from casid.report.document import Document, Table


def convergence_document(found: Convergence) -> Document:
    """Estimates iteration by iteration, their errors where a truth is known, how far they moved.

    A first iteration has moved nowhere.
    """
    width = max(10, *(len(n) + 2 for n in found.names))
    rows = [
        (
            str(j),
            *(f"{v:.4f}" for v in theta),
            *(f"{found.errors(n)[j]:.3f}" for n in found.truth),
            f"{found.moved[j]:.1e}" if j else "",
            f"{found.prefilter_moved[j]:.1e}" if j else "",
        )
        for j, theta in enumerate(found.theta_p)
    ]
    head = ("it.", *found.names, *(f"{n} %" for n in found.truth), "moved", "prefilter")
    n = len(head) - 3
    widths = (4, *[width] * n, 10, 11)
    table = Table(head, rows, numbers=range(1, n + 3), widths=widths, indent=0)
    unsettled = [] if found.is_settled else ["not settled within the iterations allowed"]
    return Document("", [table, *unsettled])


def black_box_document(found: BlackBoxReferences) -> Document:
    """How well the black boxes fit, record by record and channel by channel."""
    rows = [
        (record, *(f"{own[c].fit:.1f}" for c in found.channels), "")
        for record, own in found.filters.items()
    ]
    n = len(found.channels)
    head = ("record", *found.channels, " fit, %")
    table = Table(head, rows, numbers=range(1, n + 1), widths=(22, *[12] * n))
    notes = [f"  {note}" for note in found.notes]
    return Document(f"Black-box models from {found.reference}", [table, *notes])


def validation_document(found: Validation) -> Document:
    """Fit, period and amplitude of every channel of every record."""
    head = "record,channel,fit %,rms,unit,period s,error %,peaks %,spread %,matched".split(",")
    rows = [
        (
            c.record,
            c.channel,
            f"{c.fit:.1f}",
            f"{c.rmse:.4g}",
            c.unit,
            f"{c.period:.4g}",
            *(f"{100 * x:.2f}" for x in (c.period_error, c.peak_error, c.peak_spread)),
            str(c.peaks),
        )
        for c in found.channels
    ]
    widths = (14, 12, 8, 12, 9, 10, 9, 9, 10, 9)
    return Document("", [Table(head, rows, numbers=range(2, 10), widths=widths, indent=0)])


def family_document(found: AlongFamily) -> Document:
    """How every parameter moves along one family of equally good estimates."""
    rows = []
    for n, value in found.values.items():
        spans = (*found.ranges[n], *found.intervals[n])
        rows.append(
            (
                n,
                f"{value:.5g}",
                f"{found.std_errors[n]:.2g}",
                f"{found.slopes[n]:.4g}",
                *_five_digits(spans),
                "identifiable whatever the choice" if n in found.invariant else "",
            )
        )
    percent = f"{100 * found.level:g} % from"
    head = (
        "",
        "estimate",
        "std. error",
        f"per {found.held}",
        "moves from",
        "to",
        percent,
        "to",
        "",
    )
    widths = (10, 11, 12, 12, 13, 11, 13, 11)
    return Document(
        f"{found.held} = {found.at:.4g} is a choice; {_span(found)}",
        [Table(head, rows, numbers=range(1, 8), widths=widths)],
    )


def invariants_document(found: Invariants) -> Document:
    """What the data determine whatever is held, and how the rest moves with the choice."""
    parts: list[str | Table] = [
        f"  {a.held} = {a.at:.4g} was held, a choice: {_span(a)}" for a in found.along
    ] or ["  every parameter: nothing was held"]
    rows: list[tuple[str, ...] | str] = [
        (
            f"  {p.name}",
            p.unit,
            f"{p.value:.5g}",
            "--" if p.std_error is None else f"{p.std_error:.2g}",
            p.note,
        )
        for p in found.identifiable.values()
    ]
    head: tuple[str, ...] = ("the same for every choice", "unit", "estimate", "std. error", "")
    rows = rows or ["  no single parameter"]
    parts.append(Table(head, rows, numbers=(2, 3), widths=(28, 12, 11, 12)))
    if found.moving:
        moving = [
            (
                f"  {m.name}",
                m.unit,
                *_five_digits(m.interval),
                "held" if m.name == m.held else f"{m.slope:.4g} of {m.held}",
                "less than a std. error" if m.spread < 1.0 else "",
            )
            for m in found.moving.values()
        ]
        percent = f"{100 * found.level:g} % from"
        head = ("moves with the choice", "unit", percent, "to", "per unit held", "")
        parts.append(Table(head, moving, numbers=(2, 3, 4), widths=(28, 12, 11, 12, 15)))
    if found.combinations:
        parts.append("  identifiable in their place (constants of a load case carry its name)")
    parts += [f"    {c.name} = {c.value:.5g} +- {c.std_error:.2g}" for c in found.combinations]
    return Document(f"What the data determine of {found.problem}", parts)


def _span(a: AlongFamily) -> str:
    low, high = a.stopped_by
    return (
        f"from {a.lower:.4g} ({low} at its bound) to {a.upper:.4g} ({high} at its bound) all fit "
        "equally"
    )


def _five_digits(values: Iterable[float]) -> list[str]:
    return [f"{x:.5g}" for x in values]
