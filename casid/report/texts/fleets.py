"""A fleet in a terminal."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from casid.estimation.estimate import Estimated
from casid.fleets.findings import Finding
from casid.fleets.fleet import Fleet, words_of
from casid.fleets.random_effects import ParameterEffects
from casid.model.quantities import count_text, shortened
from casid.report.document import Document, Table, labelled
from casid.report.numbers import number_text, plus_minus

_SHOWN, _REASONS = 20, 5


def fleet_document(fleet: Fleet) -> Document:
    """What was found since when, how parameters differ and drift, and what was refused."""
    shown = fleet.findings[:_SHOWN]
    rows = [finding_cells(fleet, f) for f in shown]
    more = len(fleet.findings) - len(shown)
    effects = Table(
        effect_head(fleet), [effect_cells(e) for e in fleet.effects], numbers=(2, 3, 4, 5)
    )
    return Document(
        f"Fleet of {fleet.problem}: {size_text(fleet)}",
        [
            ("records", counts_text(fleet)),
            ("errors", rates_text(fleet)),
            Table(FINDING_HEAD, rows, numbers=(3,)),
            *([f"  and {more} more, in fleet.json and report.html"] if more > 0 else []),
            *([effects] if fleet.effects else []),
            *labelled("no asset", unlabelled_text(fleet)),
            *labelled("undecided", _grouped(fleet.undecided)),
            *labelled("refused", _grouped(fleet.refusals)),
            *(
                [
                    (
                        "NOT DONE",
                        f"{count_text(fleet.not_done, 'record')}: the time limit was reached",
                    )
                ]
                if fleet.not_done
                else []
            ),
        ],
        label=10,
        width=110,
    )


FINDING_HEAD = ("asset", "cause", "began", "records", "e-value", "state")


def effect_head(fleet: Fleet) -> tuple[str, ...]:
    """The columns of `effect_cells`."""
    drift = "drift a year" if fleet.is_dated else "drift a record"
    return ("parameter", "unit", "mean", "between", "within", drift, "drifts alone")


_NUMBER = re.compile(r"(?<![\w.])[-+]?\d[\d.]*(e[-+]?\d+)?")


def undecided_reason(text: str) -> str:
    """Why a record is undecided, without its own numbers: what many records have in common."""
    return _NUMBER.sub("..", text.split(": ", 1)[-1])


def size_text(fleet: Fleet) -> str:
    """How many records of how many assets."""
    records, assets = len(fleet.records), len(fleet.assets)
    return f"{count_text(records, 'record')} of {count_text(assets, 'asset')}"


def unlabelled_text(fleet: Fleet) -> list[str]:
    """Records of which neither path nor columns say the asset."""
    names = fleet.unlabelled
    if not names:
        return []
    what = "its path or columns do" if len(names) == 1 else f"{len(names)} records, whose"
    if len(names) == 1:
        return [f"{names[0]}: {what} not say the asset, which is listed as unknown"]
    listed = shortened(names, _REASONS)
    return [f"{what} paths or columns do not say the asset: {listed}, listed as unknown"]


def counts_text(fleet: Fleet) -> str:
    """How many records were done, searched and refused."""
    refused = len(fleet.refusals)
    return (
        f"{fleet.new} diagnosed now, {len(fleet.records) - fleet.new} before; {fleet.searched} had "
        f"the full search; {refused or 'none'} refused"
    )


def rates_text(fleet: Fleet) -> str:
    """Discoveries by each procedure, and the alarms."""
    monthly = fleet.false_alarms_per_month
    alarms = len(fleet.alarms)
    text = (
        f"{count_text(fleet.discoveries, 'deficient record')} at a false discovery rate of "
        f"{fleet.level:g} (Benjamini-Hochberg), {fleet.discoveries_e} under any dependence between "
        f"records (e-BH); {count_text(alarms, 'alarm')} on arrival (LORD++)"
    )
    if math.isfinite(monthly):
        text += f", at most {monthly:.2g} false ones a month"
    return text


def finding_cells(fleet: Fleet, f: Finding) -> tuple[str, ...]:
    """A finding as cells below `FINDING_HEAD`."""
    return (
        f.asset,
        f"{words_of(fleet, f.key)} [{f.kind}]",
        onset_text(fleet, f),
        str(len(f.records)),
        f"{min(f.e_value, 1e300):.1e}",
        state_text(fleet, f),
    )


def onset_text(fleet: Fleet, f: Finding) -> str:
    """Between which times it began."""
    after, by = f.onset
    if not math.isfinite(after):
        return f"by {fleet.time_text(by)}"
    return f"{fleet.time_text(after)} to {fleet.time_text(by)}"


def state_text(fleet: Fleet, f: Finding) -> str:
    """Whether it lasts, and whose matter it is."""
    lasting = "lasting" if f.is_lasting else "once"
    state = f"{lasting}, still there" if f.is_present and f.is_lasting else lasting
    if f.is_lasting and not f.is_present:
        state += f" until {fleet.time_text(f.until)}"
    if f.is_common:
        return f"{state}; common to {f.assets} assets"
    return state


def effect_cells(e: ParameterEffects) -> tuple[str, ...]:
    """A parameter as cells below `effect_head`."""
    alone = [a for a in e.assets if a.p_value < 0.05 / max(len(e.assets), 1)]
    drift = "--"
    if math.isfinite(e.drift):
        drift = _with_error(e.drift, e.drift_error)
    return (
        e.name,
        e.unit,
        _with_error(e.mean, e.mean_error),
        number_text(e.between),
        number_text(e.within),
        drift,
        ", ".join(a.asset for a in alone[:4]) + (", ..." if len(alone) > 4 else ""),
    )


def _with_error(value: float, std_error: float) -> str:
    return plus_minus(Estimated("", value, "", std_error=std_error)).replace("\u00b1", "+-")


def _grouped(why: Mapping[str, str]) -> list[str]:
    """The commonest reasons: how many records have each, and that of the first of them in full."""
    groups: dict[str, list[str]] = {}
    for record, text in why.items():
        groups.setdefault(_NUMBER.sub("..", text.replace(record, "")), []).append(record)
    out = []
    for records in sorted(groups.values(), key=len, reverse=True)[:_REASONS]:
        first, n = records[0], len(records)
        text = why[first].removeprefix("This record does not determine whether the model is ")
        text = text.removeprefix("adequate: ")
        out.append(f"{first}: {text}" if n == 1 else f"{n} records, {first} the first: {text}")
    return out
