"""The page of a fleet: findings ranked with their evidence, causes over time, parameters."""

from __future__ import annotations

from collections import Counter

from casid.fleets.findings import Finding
from casid.fleets.fleet import ASSUMPTIONS, Fleet
from casid.report.document import (
    Banner,
    Bullets,
    Code,
    Document,
    Section,
    Table,
    figure_parts,
    mapping_table,
)
from casid.report.figures.fleets import fleet_figures
from casid.report.numbers import number_text
from casid.report.pages.estimate_parts import provenance
from casid.report.texts.fleets import (
    EFFECT_HEAD,
    FINDING_HEAD,
    counts_text,
    effect_cells,
    finding_cells,
    rates_text,
)

_FINDINGS, _REFUSALS, _RECORDS = 200, 100, 3  # shown; all of them are in the tables beside


def fleet_report(fleet: Fleet) -> Document:
    """Findings, causes over time, parameters over assets, rates, and what was refused."""
    figure = figure_parts(fleet_figures(fleet)).get
    settings = {n: str(v) for n, v in fleet.settings.items() if v not in (None, {}, [], ())}
    return Document(
        fleet.problem,
        [
            Section(
                "",
                [_banner(fleet), f"{_upper(counts_text(fleet))}.", f"{rates_text(fleet)}."],
                is_open=True,
            ),
            Section("Findings", [_findings(fleet), figure("causes"), _more(fleet)], is_open=True),
            Section(
                "Parameters",
                [
                    Table(
                        EFFECT_HEAD,
                        [effect_cells(e) for e in fleet.effects],
                        numbers=(2, 3, 4, 5),
                        caption="Parameters over the fleet",
                    ),
                    figure("parameters"),
                    _WORDS if fleet.effects else None,
                ],
                is_open=True,
            ),
            Section("Common causes", [_common(fleet)]),
            Section("Refused records", [_refused(fleet)]),
            Section("What the rates assume", [Bullets(ASSUMPTIONS)]),
            provenance((), settings, fleet.versions),
            Section("References", [Bullets(fleet.references())]),
        ],
        kind="Fleet",
    )


_WORDS = (
    "Mean: of the fleet in the middle of its records in time, with its standard error. Between: "
    "standard deviation from asset to asset. Within: from record to record of one asset, beyond "
    "what the errors of the estimates explain. Drift: of the fleet, per year where times are "
    "dates. Drifting alone: assets with another drift than the fleet's, at 5 % over all assets "
    "(Bonferroni). Variances by restricted maximum likelihood; each asset's trend is shrunk "
    "towards the fleet's."
)


def _banner(fleet: Fleet) -> Banner:
    lasting = [f for f in fleet.findings if f.is_lasting and f.is_present]
    assets = len({f.asset for f in lasting})
    if lasting:
        word, look = f"{assets} of {len(fleet.assets)} assets", "deficient"
        first = lasting[0]
        sentence = (
            f"{len(lasting)} causes last to this day; the strongest is {first.kind} in "
            f"{first.where} of {first.asset}, in {len(first.records)} records."
        )
    elif fleet.findings:
        word, look = "nothing that lasts", "undecided"
        sentence = f"{len(fleet.findings)} causes were there for a time and are not any more."
    else:
        word, look = "nothing found", "adequate"
        sentence = "No record lacks anything at this rate of false discoveries."
    return Banner(word, "with a cause that lasts" if lasting else "", sentence, look)


def _findings(fleet: Fleet) -> Table:
    names = dict(zip(fleet.records["number"], fleet.records["record"], strict=True))
    rows = []
    for f in fleet.findings[:_FINDINGS]:
        asset, *rest = finding_cells(fleet, f)
        rows.append((asset, *rest, _size(f), _also(f), _named(f, names)))
    return Table(
        (*FINDING_HEAD, "size", "it may also be", "records, as in"),
        rows,
        numbers=(3, 4),
        caption="Causes by asset, those of most records first",
    )


def _size(f: Finding) -> str:
    if f.size != f.size:
        return "\u2013"
    return f"{number_text(f.size)} \u00b1 {f.size_spread:.1g}"


def _also(f: Finding) -> str:
    return ", ".join(f"{kind} in {where}" for kind, where in f.also) or "\u2013"


def _named(f: Finding, names: dict[int, str]) -> Code:
    """The first records of a finding: `casid diagnose` makes their single reports."""
    rest = ", ..." if len(f.records) > _RECORDS else ""
    return Code(", ".join(names[i] for i in f.records[:_RECORDS]) + rest)


def _more(fleet: Fleet) -> str | None:
    first = fleet.findings[0] if fleet.findings else None
    if first is None:
        return None
    path = fleet.records.loc[fleet.records["number"] == first.records[0], "path"].iloc[0]
    text = (
        f"The report of a single record: casid diagnose PROBLEM {path} with the options of this "
        "fleet. All records stand in causes.parquet beside this page."
    )
    if len(fleet.findings) > _FINDINGS:
        text += f" The first {_FINDINGS} of {len(fleet.findings)} findings."
    return text


def _common(fleet: Fleet) -> Table:
    rows = []
    for key in dict.fromkeys(f.key for f in fleet.findings if f.is_common):
        found = [f for f in fleet.findings if f.key == key]
        assets = sorted({f.asset for f in found})
        since = fleet.time_text(min(f.since for f in found))
        rows.append((f"{key[0]} in {key[1]}", str(len(assets)), since, ", ".join(assets[:10])))
    caption = "Causes that half of the assets or more have at one time: no matter of one asset"
    return Table(("cause", "assets", "since", "which"), rows, numbers=(1,), caption=caption)


def _refused(fleet: Fleet) -> Table:
    refused = fleet.refusals
    if len(refused) <= _REFUSALS:
        return mapping_table(refused, ("record", "why"))
    counts = Counter(text.split(": ", 1)[0] for text in refused.values())
    return mapping_table({text: str(n) for text, n in counts.most_common()}, ("why", "records"))


def _upper(text: str) -> str:
    return text[:1].upper() + text[1:]
