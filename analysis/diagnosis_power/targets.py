"""The targets of the power study: every number that has cases, beside what is wanted of it.

    false alarms          of null records, 2.5 to 6.5 % pooled (nominal 5 %), no cell of length and
                          noise above what chance leaves at 0.1 %; of roll and ship at most 10.5 %
    named right           95 % at lambda >= 100, 98 % at lambda >= 300; strictly 92 % at 300
    wrong name            at most 2 % of all single effects
    the reported set      has the hidden cause in 95 % of the named cases, 1.5 causes on average
    a cause too many      at most 5 % of single effects
    flagged               at most 10 % of single effects, all of which the catalogue has
    two effects           both named in 85 %, one at least in 97 %, both lambdas >= 300
    unlisted              named without a flag in at most 5 %
    gain                  median 95 % of an oracle's, nine tenths of it in 95 %; none is worse
    rivals                at least twice the best peer's rate of right names, over all kinds
    ratio to an oracle    right names over those of an oracle on the same records, lambda >= 100:
                          0.97, its lower bound 0.95, on pendulum, roll and ship
    time                  95 % of the 60 s records at 100 Hz within 5 s, scoring within 1 s

What counts as right is in `judgement`. A number stands with its count and its 95 %
interval (Clopper and Pearson 1934); a target is met if the number itself meets it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scipy.stats import binom

from analysis.common.rates import reaches, stays_within
from analysis.common.targets import Target
from analysis.diagnosis_power.peers import ALONE
from analysis.diagnosis_power.tables import NOMINAL, Summary


def targets_of(s: Summary, *, quick: bool = False) -> list[Target]:
    """Every number that has cases beside its target.

    With `quick` a count misses only where it would with less than 1 % chance, were the rate just at
    the target.
    """
    out: list[Target] = []

    def least(what: str, found: Summary | None, wanted: float) -> None:
        if found and found["of"]:
            met = reaches(found["hits"], found["of"], wanted, quick=quick)
            out.append(_target(what, found, f">= {100 * wanted:g} %", met))

    def most(what: str, found: Summary | None, wanted: float) -> None:
        if found and found["of"]:
            met = stays_within(found["hits"], found["of"], wanted, quick=quick)
            out.append(_target(what, found, f"<= {100 * wanted:g} %", met))

    failed, cases = sum(s["failed"].values()), sum(s["cases"].values())
    out.append(Target("cases that fail", f"{failed} of {cases}", "none", failed == 0))
    if "nulls" in s:
        for cell in s["nulls"]["cells"]:
            limit = int(binom.isf(0.001, cell["of"], NOMINAL)) if cell["of"] < 200 else 21
            what = f"false alarms, {cell['duration']:g} s, noise {cell['noise']:g}"
            out.append(_target(what, cell, f"<= {limit}", cell["hits"] <= limit))
        pooled = s["nulls"]["pooled"]
        inside = 0.025 <= pooled["rate"] <= 0.065
        if quick or pooled["of"] < 400:
            inside = stays_within(pooled["hits"], pooled["of"], NOMINAL, quick=True)
        out.append(_target("false alarms, pooled", pooled, "2.5 to 6.5 %", inside))
    if "single" in s:
        one = s["single"]
        least("named right, lambda >= 100", one["right"]["100"], 0.95)
        least("named right, lambda >= 300", one["right"]["300"], 0.98)
        least("strictly right, lambda >= 300", one["strictly"]["300"], 0.92)
        most("wrong name", one["wrong"], 0.02)
        least("the reported set has the truth", one["truth_in_set"], 0.95)
        if one["set_size"] is not None:
            size = one["set_size"]
            out.append(Target("mean size of the set", f"{size:.2f}", "<= 1.5", size <= 1.5))
        most("a cause too many", one["one_too_many"], 0.05)
        most("listed causes flagged", one["flagged"], 0.10)
    if "pairs" in s:
        least("both of two named", s["pairs"]["both"], 0.85)
        least("at least one of two named", s["pairs"]["one"], 0.97)
    if "unlisted" in s:
        most("unlisted cause named, no flag", s["unlisted"]["silent"], 0.05)
    if s.get("gain", {}).get("median") is not None:
        gain = s["gain"]
        median = gain["median"]
        out.append(
            Target("median share of an oracle's gain", f"{median:.3f}", ">= 0.95", median >= 0.95)
        )
        least("nine tenths of an oracle's gain", gain["nine_tenths"], 0.95)
        most("extensions that worsen by 1 %", gain["worse"], 0.0)
    if s.get("rivals"):
        out += _of_rivals(s["rivals"])
    for system in ("roll", "ship"):
        if system in s:
            most(f"{system}: false alarms", s[system]["alarms"], 0.105)
            least(f"{system}: named right, lambda >= 100", s[system]["right"], 0.95)
    for system, found in s.get("oracle", {}).items():
        met = found["R"] >= 0.97 and found["low"] >= 0.95
        met = found["high"] >= 0.97 if quick else met
        text = f"{found['R']:.3f} ({found['low']:.3f} to {found['high']:.3f}) of {found['of']}"
        out.append(Target(f"{system}: right names over an oracle's", text, ">= 0.97, 0.95", met))
    if "within_5_s" in s.get("time", {}):
        t = s["time"]
        least("60 s at 100 Hz within 5 s", t["within_5_s"], 0.95)
        if t["scoring"] is not None:
            out.append(
                Target("scoring", f"{t['scoring']:.2f} s", "<= 1 s (median)", t["scoring"] <= 1.0)
            )
    return out


def _of_rivals(rivals: Mapping[str, Any]) -> list[Target]:
    """casid beside the best peer on its own; the aided ones are no target of their own."""
    compared = [rivals[p]["all"] for p in ALONE if p in rivals and rivals[p]["all"]["peer"]["of"]]
    if not compared:
        return []
    ahead = max(compared, key=lambda r: r["peer"]["rate"])
    met = ahead["casid"]["rate"] >= 2 * ahead["peer"]["rate"]
    found = " against ".join(text_of(ahead[who]) for who in ("casid", "peer"))
    return [Target("right names, casid and the best peer", found, "twice", met)]


def text_of(found: Summary) -> str:
    """A share with its count and interval."""
    share = f"{100 * found['rate']:.1f} %, {100 * found['low']:.1f} to {100 * found['high']:.1f}"
    return f"{found['hits']} of {found['of']} ({share})"


def _target(what: str, found: Summary, wanted: str, met: Any) -> Target:
    return Target(what, text_of(found), wanted, bool(met))
