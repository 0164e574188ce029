"""What the cases of the power study add up to: one summary of plain numbers.

The summary is what figures, targets and the page of the manual are made from. Intervals of rates
are Clopper and Pearson's (1934) at 95 %.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from analysis.common.rates import rate, ratio
from analysis.diagnosis_power.judgement import (
    found_of_pair,
    has_truth,
    is_alarm,
    is_doubtful,
    is_flagged,
    is_named,
    is_right,
    is_wrong_name,
    matches,
    set_size,
)
from analysis.diagnosis_power.peers import PEERS, can_express

Row = Mapping[str, Any]
Summary = dict[str, Any]

EDGES = (30.0, 55.0, 100.0, 173.0, 300.0, 1000.0, 3000.0, 30_000.0)
"""Energies between which the power is counted."""

NOMINAL = 0.05
"""The nominal false-alarm rate of a diagnosis."""


def summary_of(rows: Sequence[Row]) -> Summary:
    """All numbers of the study, of the parts that have cases."""
    parts: dict[str, list[Row]] = {}
    for row in rows:
        parts.setdefault(row["part"], []).append(row)
    done = {part: [r for r in of if "error" not in r] for part, of in parts.items()}
    out: Summary = {
        "cases": {part: len(of) for part, of in sorted(parts.items())},
        "failed": {part: len(of) - len(done[part]) for part, of in sorted(parts.items())},
    }
    makers: dict[str, Callable[[list[Row]], Summary]] = {
        "nulls": _nulls,
        "single": _single,
        "pairs": _pairs,
        "unlisted": _unlisted,
        "roll": _small,
        "ship": _small,
    }
    for part, maker in makers.items():
        if done.get(part):
            out[part] = maker(done[part])
    singles = {r["number"]: r for r in done.get("single", ())}
    if done.get("gain") and singles:
        out["gain"] = _gain(done["gain"], singles)
    if done.get("peers") and singles and done.get("nulls"):
        out["rivals"] = _rivals(done["peers"], singles, done["nulls"])
    if done.get("oracle"):
        out["oracle"] = _oracle(done)
    diagnosed = [r for r in rows if "cpu" in r and "verdict" in r]
    if diagnosed:
        out["time"] = _time(diagnosed)
    return out


def _share(rows: Iterable[Row], claim: Callable[[Row], bool]) -> Summary:
    found = [claim(r) for r in rows]
    return rate(sum(found), len(found)) if found else {"hits": 0, "of": 0, "rate": None}


def _oracle(done: Mapping[str, list[Row]]) -> Summary:
    """R by system: right names of the diagnosis over the oracle's, lambda of 100 and more."""
    out: Summary = {}
    for system in ("single", "roll", "ship"):
        said = {r["number"]: r for r in done["oracle"] if r["of"] == system and "oracle_2" in r}
        rows = [
            {**r, "oracle_2": said[r["number"]]["oracle_2"]}
            for r in done.get(system, ())
            if r["number"] in said and r["energy"] >= 100
        ]
        if rows:
            R, low, high, avoidable = ratio(
                [is_right(r) for r in rows], [_oracle_is_right(r) for r in rows]
            )
            found = {"R": R, "low": low, "high": high, "avoidable": avoidable, "of": len(rows)}
            out["pendulum" if system == "single" else system] = found
    return out


def _oracle_is_right(row: Row) -> bool:
    kind, where = row["oracle_2"]
    return matches((kind, where), (row["kind"], row["where"]))


def _nulls(rows: list[Row]) -> Summary:
    cells: dict[tuple[float, float], list[Row]] = {}
    for r in rows:
        cells.setdefault((r["duration"], r["noise"]), []).append(r)
    return {
        "pooled": _share(rows, is_alarm),
        "cells": [
            {"duration": duration, "noise": noise, **_share(of, is_alarm), "named": _named(of)}
            for (duration, noise), of in sorted(cells.items())
        ],
        "named": _named(rows),
    }


def _named(rows: list[Row]) -> dict[str, int]:
    return dict(Counter(c["kind"] for r in rows for c in r["causes"]))


def _single(rows: list[Row]) -> Summary:
    named = [r for r in rows if is_named(r)]
    extra = [r for r in rows if len(r["causes"]) > 1]
    claims: dict[str, Callable[[Row], bool]] = {
        "right": is_right,
        "detected": is_alarm,
        "wrong": is_wrong_name,
        "doubtful": is_doubtful,
        "flagged": is_flagged,
    }
    bins = []
    for low, high in zip(EDGES[:-1], EDGES[1:], strict=True):
        inside = [r for r in rows if low <= r["energy"] < high]
        if inside:
            counted = {name: _share(inside, claim) for name, claim in claims.items()}
            bins.append({"from": low, "to": high, **counted})
    above = {str(e): [r for r in rows if r["energy"] >= e] for e in (30, 100, 300)}
    return {
        "right": {e: _share(of, is_right) for e, of in above.items()},
        "strictly": {
            e: _share(of, lambda r: is_right(r, strictly=True)) for e, of in above.items()
        },
        "detected": {e: _share(of, is_alarm) for e, of in above.items()},
        "wrong": _share(rows, is_wrong_name),
        "doubtful": _share(rows, is_doubtful),
        "kinds": _kinds(rows),
        "flagged": _share(rows, is_flagged),
        "truth_in_set": _share(named, has_truth),
        "set_size": float(np.mean([set_size(r) for r in named])) if named else None,
        "one_too_many": rate(len(extra), len(rows)),
        "bins": bins,
        "confusion": _confusion(rows),
    }


def _kinds(rows: list[Row]) -> list[Summary]:
    """What became of each hidden effect, energies of 100 and more."""
    of: dict[str, list[Row]] = {}
    for r in rows:
        if r["kind"] != "none" and r["energy"] >= 100.0:
            of.setdefault(f"{r['kind']}({r['where']})", []).append(r)
    return [
        {
            "hidden": hidden,
            "right": _share(cases, is_right),
            "wrong": _share(cases, is_wrong_name),
            "detected": _share(cases, is_alarm),
        }
        for hidden, cases in sorted(of.items())
    ]


def _confusion(rows: list[Row]) -> list[Summary]:
    """How often each hidden effect was given each name, energies of 100 and more."""
    counts = Counter(
        (f"{r['kind']}({r['where']})", r["causes"][0]["kind"] if r["causes"] else "nothing")
        for r in rows
        if r["energy"] >= 100.0
    )
    return [{"hidden": h, "named": n, "count": c} for (h, n), c in sorted(counts.items())]


def _pairs(rows: list[Row]) -> Summary:
    strong = [r for r in rows if min(r["energy"], r["second_energy"]) >= 300.0]
    return {
        "both": _share(strong, lambda r: all(found_of_pair(r))),
        "one": _share(strong, lambda r: any(found_of_pair(r))),
        "too_many": _share(strong, lambda r: len(r["causes"]) > 2),
    }


def _unlisted(rows: list[Row]) -> Summary:
    def silent(r: Row) -> bool:
        return is_named(r) and not is_flagged(r)

    groups = {"none has": [r for r in rows if not r["without"]]}
    groups["left out"] = [r for r in rows if r["without"]]
    kinds = sorted({r["kind"] for r in groups["none has"]})
    return {
        "silent": _share(rows, silent),
        "flagged": _share(rows, is_flagged),
        "groups": {name: _share(of, silent) for name, of in groups.items()},
        "kinds": [
            {"kind": k, **_share([r for r in groups["none has"] if r["kind"] == k], silent)}
            for k in kinds
        ],
    }


def _small(rows: list[Row]) -> Summary:
    nulls = [r for r in rows if r["kind"] == "none"]
    strong = [r for r in rows if r["kind"] != "none" and r["energy"] >= 100.0]
    return {
        "alarms": _share(nulls, is_alarm),
        "right": _share(strong, is_right),
        "wrong": _share(strong, is_wrong_name),
        "kinds": _kinds(rows),
    }


def _gain(oracles: list[Row], singles: Mapping[int, Row]) -> Summary:
    """Share of an oracle's gain, at energies of 100 and more; nothing accepted gains nothing."""
    shares, worse = [], []
    for o in oracles:
        r = singles.get(o["number"])
        if r is None or "oracle" not in o:
            continue
        held = r["held_out"]
        before = next(iter(held["baseline_rmse"].values()))
        after = next(iter(held.get("extended_rmse", held["baseline_rmse"]).values()))
        worse.append(after > 1.01 * before)
        if r["energy"] >= 100.0 and o["oracle"] < o["baseline"]:
            shares.append((before - after) / (o["baseline"] - o["oracle"]))
    return {
        "median": float(np.median(shares)) if shares else None,
        "nine_tenths": rate(int(np.sum(np.array(shares) >= 0.9)), len(shares)) if shares else None,
        "worse": rate(sum(worse), len(worse)) if worse else None,
    }


def _rivals(peers: list[Row], singles: Mapping[int, Row], nulls: list[Row]) -> Summary:
    """Right names of each peer at the false-alarm rate of casid, or the nominal one if larger.

    The threshold of a peer is set on the null records that casid's alarms are counted on. `all` is
    over every kind that was hidden, whether or not the peer has a column for it; `expressible` over
    those that it has. Energies of 30 and more.
    """
    alarms = float(np.mean([is_alarm(r) for r in nulls]))
    level = max(alarms, NOMINAL)
    nulls_of = {r["number"] for r in nulls}
    quiet = [r for r in peers if r["of"] == "nulls" and r["number"] in nulls_of]
    judged = [r for r in peers if r["of"] == "single" and r["number"] in singles]
    judged = [r for r in judged if singles[r["number"]]["energy"] >= 30.0]
    out: Summary = {"false_alarms": level, "nulls": len(quiet)}
    if not quiet:
        return out
    for peer in PEERS:
        threshold = float(np.quantile([r["peers"][peer]["statistic"] for r in quiet], 1 - level))

        def is_named_right(r: Row, peer: str = peer, threshold: float = threshold) -> bool:
            found = r["peers"][peer]
            return bool(found["statistic"] > threshold) and matches(
                (found["kind"], found["where"]), (r["kind"], r["where"])
            )

        own = [r for r in judged if can_express(peer, r["kind"])]
        groups = {"all": judged, "expressible": own}
        out[peer] = {
            name: {
                "peer": _share(of, is_named_right),
                "casid": _share([singles[r["number"]] for r in of], is_right),
            }
            for name, of in groups.items()
        }
        out[peer]["threshold"] = threshold
    return out


def _time(rows: list[Row]) -> Summary:
    sizes: dict[tuple[str, float, float], list[float]] = {}
    for r in rows:
        key = (r.get("system", "pendulum"), r["duration"], r["Ts"])
        sizes.setdefault(key, []).append(r["cpu"])
    settings = [
        {
            "system": system,
            "duration": duration,
            "Ts": Ts,
            "count": len(cpu),
            "median": float(np.median(cpu)),
            "p95": float(np.quantile(cpu, 0.95)),
            "largest": max(cpu),
        }
        for (system, duration, Ts), cpu in sorted(sizes.items())
    ]
    pendulum = [r for r in rows if r.get("system", "pendulum") == "pendulum"]
    minute = [r for r in pendulum if r["duration"] == 60.0 and r["Ts"] == 0.01]
    scoring = [r["scoring"] for r in minute if r.get("scoring") is not None]
    seconds = [r["cpu"] for r in minute]
    if not seconds:
        return {"settings": settings}
    return {
        "settings": settings,
        "median": float(np.median(seconds)),
        "largest": float(np.max(seconds)),
        "within_5_s": rate(int(np.sum(np.array(seconds) <= 5.0)), len(seconds)),
        "scoring": float(np.median(scoring)) if scoring else None,
    }
