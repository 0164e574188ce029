"""The summary of the power study as tables of text: what the manual shows of it.

Shares stand as "hits of cases, per cent (95 % interval)".
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from analysis.common.output import aligned
from analysis.diagnosis_power.peers import PEERS

Summary = Mapping[str, Any]

NONE = "no cases in this release"
BAR = 20
"""Characters of a bar that means all cases."""


def page_of(summary: Summary, what: str) -> str:
    """One table, by its name in `TABLES`; a line that says so where there are no cases."""
    return TABLES[what](summary) or NONE


def share(found: Summary | None) -> str:
    """A share with its count and interval."""
    if not found or not found["of"]:
        return "-"
    rate, low, high = (100 * found[what] for what in ("rate", "low", "high"))
    return f"{found['hits']} of {found['of']}, {rate:.1f} % ({low:.0f} to {high:.0f})"


def _cases(s: Summary) -> str:
    rows = [(part, str(n), str(s["failed"][part])) for part, n in s["cases"].items()]
    return aligned(("part", "cases", "failed"), rows)


def _targets(s: Summary) -> str:
    rows = [
        (t["what"], t["found"], t["wanted"], "met" if t["is_met"] else "MISSED")
        for t in s.get("targets", ())
    ]
    return aligned(("number", "found", "wanted", ""), rows)


def _power(s: Summary) -> str:
    """Bars are the share named right."""
    rows = []
    for b in s.get("single", {}).get("bins", ()):
        bar = "#" * round(BAR * b["right"]["rate"])
        others = (f"{100 * b[what]['rate']:.0f} %" for what in ("doubtful", "wrong", "detected"))
        band = f"{b['from']:.0f} to {b['to']:.0f}"
        rows.append((band, bar.ljust(BAR), share(b["right"]), *others))
    return aligned(("lambda", "", "named right", "doubtful", "wrong", "detected"), rows)


def _kinds(s: Summary) -> str:
    return _by_kind(s.get("single", {}).get("kinds", ()))


def _by_kind(kinds: Iterable[Summary]) -> str:
    rows = [(k["hidden"], *(share(k[w]) for w in ("right", "wrong", "detected"))) for k in kinds]
    return aligned(("hidden", "named right", "wrong name", "detected"), rows)


def _confusion(s: Summary) -> str:
    """What was named first, the most frequent name first."""
    by: dict[str, list[tuple[int, str]]] = {}
    for cell in s.get("single", {}).get("confusion", ()):
        by.setdefault(cell["hidden"], []).append((cell["count"], cell["named"]))
    rows = [
        (hidden, ", ".join(f"{name} {n}" for n, name in sorted(found, reverse=True)))
        for hidden, found in by.items()
    ]
    width = max((len(text) for _, text in rows), default=0)
    return aligned(("hidden", "named first".ljust(width)), [(h, t.ljust(width)) for h, t in rows])


def _nulls(s: Summary) -> str:
    if "nulls" not in s:
        return ""
    rows = [
        (f"{c['duration']:g} s", f"{c['noise']:g}", share(c), _list(c.get("named", {})))
        for c in s["nulls"]["cells"]
    ]
    rows.append(("pooled", "", share(s["nulls"]["pooled"]), _list(s["nulls"]["named"])))
    return aligned(("record", "noise", "false alarms", "named"), rows)


def _list(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{kind} {n}" for kind, n in sorted(counts.items(), key=lambda item: -item[1]))


def _pairs(s: Summary) -> str:
    names = {"both": "both named", "one": "one at least", "too_many": "a third cause named"}
    found = s.get("pairs", {})
    rows = [(names[what], share(found[what])) for what in names if what in found]
    return aligned(("two effects", "cases"), rows)


def _unlisted(s: Summary) -> str:
    found = s.get("unlisted")
    if found is None:
        return ""
    rows = [("all", share(found["silent"]), share(found["flagged"]))]
    rows += [(f"kind that {_group(g)}", share(of), "") for g, of in found["groups"].items()]
    rows += [(f"  {k['kind']}", share(k), "") for k in found["kinds"]]
    return aligned(("hidden", "named, no flag", "flagged"), rows)


def _group(name: str) -> str:
    return {"none has": "no catalogue has", "left out": "is left out"}[name]


def _gain(s: Summary) -> str:
    gain = s.get("gain", {})
    if gain.get("median") is None:
        return ""
    rows = [
        ("median share of the oracle's gain", f"{gain['median']:.3f}"),
        ("nine tenths of it or more", share(gain["nine_tenths"])),
        ("held-out error larger by 1 %", share(gain["worse"])),
    ]
    return aligned(("gain", "cases"), rows)


def _rivals(s: Summary) -> str:
    rivals = s.get("rivals", {})
    rows = []
    for peer in PEERS:
        if peer not in rivals:
            continue
        every, own = rivals[peer]["all"], rivals[peer]["expressible"]
        rows.append((peer, share(every["peer"]), share(own["peer"]), share(own["casid"])))
    if rows:
        every = rivals[PEERS[0]]["all"]["casid"]
        rows.insert(0, ("casid", share(every), "", ""))
    return aligned(("", "all kinds", "kinds with a column", "casid on these"), rows)


def _small(s: Summary) -> str:
    out = []
    for system in ("roll", "ship"):
        if system in s:
            alarms = f"{system}: false alarms {share(s[system]['alarms'])}"
            out.append(f"{alarms}\n\n{_by_kind(s[system].get('kinds', ()))}".rstrip())
    return "\n\n".join(out)


def _time(s: Summary) -> str:
    rows = [
        (
            t["system"],
            f"{t['duration']:g} s at {1 / t['Ts']:.0f} Hz",
            str(t["count"]),
            *(f"{t[what]:.1f} s" for what in ("median", "p95", "largest")),
        )
        for t in s.get("time", {}).get("settings", ())
    ]
    return aligned(("system", "record", "cases", "median", "95 % below", "largest"), rows)


TABLES: dict[str, Callable[[Summary], str]] = {
    "cases": _cases,
    "targets": _targets,
    "power": _power,
    "kinds": _kinds,
    "confusion": _confusion,
    "nulls": _nulls,
    "pairs": _pairs,
    "unlisted": _unlisted,
    "gain": _gain,
    "rivals": _rivals,
    "small": _small,
    "time": _time,
}
