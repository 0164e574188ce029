"""The page of a fleet: findings ranked with their evidence, causes over time, parameters."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from casid.fleets.findings import Finding
from casid.fleets.fleet import ASSUMPTIONS, Fleet, words_of
from casid.model.quantities import count_text
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
    FINDING_HEAD,
    counts_text,
    effect_cells,
    effect_head,
    finding_cells,
    rates_text,
    undecided_reason,
    unlabelled_text,
)

_FIRST, _FINDINGS = 12, 200  # findings at once, and unfolded; fleet.json has all of them
_REFUSALS, _RECORDS = 100, 3


def fleet_report(fleet: Fleet) -> Document:
    """Findings, causes over time, parameters over assets, rates, and what was refused."""
    figure = figure_parts(fleet_figures(fleet)).get
    settings = {n: str(v) for n, v in fleet.settings.items() if v not in (None, {}, [], ())}
    return Document(
        fleet.problem,
        [
            Section("", [fleet_banner(fleet), *_summary(fleet)], is_open=True),
            Section(
                "Findings",
                [
                    _findings(fleet, fleet.findings[:_FIRST]),
                    figure("causes"),
                    _more(fleet),
                    Section(
                        f"{_many(len(rest), 'further finding', 'further findings')}",
                        [_findings(fleet, rest[: _FINDINGS - _FIRST])],
                        look="fold",
                    )
                    if (rest := fleet.findings[_FIRST:])
                    else None,
                ],
                is_open=True,
            ),
            Section(
                "Parameters",
                [
                    Table(
                        effect_head(fleet),
                        [_signs(effect_cells(e)) for e in fleet.effects],
                        numbers=(2, 3, 4, 5),
                        caption="Parameters over the fleet",
                    ),
                    figure("parameters"),
                    _WORDS if fleet.effects else None,
                ],
                is_open=True,
            ),
            Section("Common causes", [_common(fleet)]),
            Section("Undecided records", [_undecided(fleet)]),
            Section("Refused records", [_refused(fleet)]),
            Section("What the rates assume", [Bullets(ASSUMPTIONS)]),
            provenance((), settings, fleet.versions),
            Section("References", [Bullets(fleet.references())]),
        ],
        kind="Fleet",
    )


def _summary(fleet: Fleet) -> list[str]:
    """What was done, what was decided, and what is not labelled, a paragraph each."""
    parts = [counts_text(fleet), rates_text(fleet), *unlabelled_text(fleet)]
    return [f"{_upper(text)}." for text in parts]


_WORDS = (
    "Mean: of the fleet in the middle of its records in time, with its standard error. Between: "
    "standard deviation from asset to asset. Within: from record to record of one asset, beyond "
    "what the errors of the estimates explain. Drift: of the fleet, per year where times are "
    "dates. Drifting alone: assets with another drift than the fleet's, at 5 % over all assets "
    "(Bonferroni). Variances by restricted maximum likelihood; each asset's trend is shrunk "
    "towards the fleet's."
)


def _signs(cells: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(c.replace("+-", "\u00b1") for c in cells)


def fleet_banner(fleet: Fleet) -> Banner:
    """Causes that last, else those of a last record alone, else those that have gone."""
    lasting = [f for f in fleet.findings if f.is_lasting and f.is_present]
    latest = [f for f in fleet.findings if not f.is_lasting and f.is_present]
    if lasting:
        assets = len({f.asset for f in lasting})
        first = lasting[0]
        sentence = (
            f"{_many(len(lasting), 'cause is', 'causes are')} still there; the strongest is "
            f"{words_of(fleet, first.key)} of {first.asset}, in {len(first.records)} records."
        )
        word = f"{assets} of {count_text(len(fleet.assets), 'asset')}"
        return Banner(word, "with a cause that lasts", sentence, "deficient")
    if latest:
        first = latest[0]
        sentence = (
            f"{_many(len(latest), 'cause appears', 'causes appear')} in a single record, the "
            f"strongest is {words_of(fleet, first.key)} of {first.asset}; further records of the "
            "asset decide whether it lasts."
        )
        return Banner("not confirmed", "found once", sentence, "undecided")
    if fleet.findings:
        it = "it" if len(fleet.findings) == 1 else "them"
        count = _many(len(fleet.findings), "cause was", "causes were")
        sentence = f"{count} there for a time, and the last records do not show {it} any more."
        return Banner("nothing that lasts", "", sentence, "undecided")
    sentence = "No record is deficient at this false discovery rate."
    return Banner("nothing found", "", sentence, "adequate")


def _findings(fleet: Fleet, shown: Sequence[Finding]) -> Table:
    names = dict(zip(fleet.records["number"], fleet.records["record"], strict=True))
    rows = []
    for f in shown:
        asset, *rest = finding_cells(fleet, f)
        # A date is one word.
        words = (re.sub(r"(\d{4})-(\d\d)-(\d\d)", "\\1\u2011\\2\u2011\\3", c) for c in rest)
        rows.append((asset, *words, _size(f), _also(fleet, f), _named(f, names)))
    return Table(
        (*FINDING_HEAD, "size", "it may also be", "example"),
        rows,
        numbers=(3, 4),
        caption="Causes by asset: those still there first, then those of most records",
    )


def _size(f: Finding) -> str:
    if f.size != f.size:
        return "\u2013"
    spread = f" \u00b1 {f.size_spread:.1g}" if f.is_lasting and f.size_spread > 0 else ""
    unit = f" {f.unit}" if f.unit not in ("", "1") else ""
    return number_text(f.size) + spread + unit


def _also(fleet: Fleet, f: Finding) -> str:
    return ", ".join(words_of(fleet, key) for key in f.also) or "\u2013"


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
        "fleet. All records are in causes.parquet beside this page."
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
    caption = "Causes that half of the assets or more have at one time: not specific to one asset"
    return Table(("cause", "assets", "since", "which"), rows, numbers=(1,), caption=caption)


def _undecided(fleet: Fleet) -> Table:
    counts = Counter(undecided_reason(text) for text in fleet.undecided.values())
    return mapping_table({text: str(n) for text, n in counts.most_common()}, ("why", "records"))


def _refused(fleet: Fleet) -> Table:
    refused = fleet.refusals
    if len(refused) <= _REFUSALS:
        return mapping_table(refused, ("record", "why"))
    counts = Counter(text.split(": ", 1)[0] for text in refused.values())
    return mapping_table({text: str(n) for text, n in counts.most_common()}, ("why", "records"))


def _many(n: int, one: str, more: str) -> str:
    return f"{n} {one if n == 1 else more}"


def _upper(text: str) -> str:
    return text[:1].upper() + text[1:]
