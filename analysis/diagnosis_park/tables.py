"""The park's numbers: by system, by lambda, by nearest rival, and beside their targets.

R is the ratio of right names, casid's to the oracle's, of the same records.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import binom

from analysis.common.rates import rate, ratio, reaches, stays_within
from analysis.common.targets import Target
from analysis.diagnosis_park.judgement import (
    first,
    has_truth,
    is_misnamed,
    is_named,
    is_right,
    is_wrong,
    oracle_has_truth,
    oracle_is_right,
)
from analysis.diagnosis_power.judgement import is_alarm, is_flagged

Row = Mapping[str, Any]
NOMINAL = 0.05
BUDGET = 600.0
"""Processor seconds after which a run counts as failed."""

ENERGIES = (100.0, 300.0, 1000.0, 3000.0)
COSINES = (0.0, 0.8, 0.95, 0.99, 0.999)


def ratio_of(
    rows: Sequence[Row],
    ours: Callable[[Row], bool] = is_right,
    theirs: Callable[[Row], bool] = oracle_is_right,
) -> tuple[float, float, float, float]:
    """R with its 95 % interval, and the share of avoidable errors."""
    return ratio([ours(r) for r in rows], [theirs(r) for r in rows])


def share(rows: Sequence[Row], claim: Callable[[Row], bool]) -> tuple[int, int]:
    """Rows of which the claim is true, and all of them."""
    return sum(claim(r) for r in rows), len(rows)


def text_of(hits: int, of: int) -> str:
    """A share with its Clopper-Pearson interval."""
    if not of:
        return "-"
    percent = (f"{100 * rate(hits, of)[key]:.0f}" for key in ("rate", "low", "high"))
    return "{}/{} ({} %, {} to {})".format(hits, of, *percent)


def is_failed(row: Row) -> bool:
    """True if a run ended in an error or beyond the time."""
    return "error" in row or row["cpu"] > BUDGET


def by_system(rows: Sequence[Row]) -> list[dict[str, str]]:
    """A line for each system, and one for all."""
    names = sorted({r["system"] for r in rows})
    return [_line(n, [r for r in rows if r["system"] == n]) for n in names] + [_line("all", rows)]


def _line(name: str, rows: Sequence[Row]) -> dict[str, str]:
    done = [r for r in rows if "error" not in r]
    parts = {
        p: [r for r in done if r["part"] == p] for p in ("single", "null", "large", "unlisted")
    }
    single, seconds = parts["single"], [r["cpu"] for r in rows]
    out = {"system": name}
    for label, claim in (("right", is_right), ("in set", has_truth), ("wrong", is_wrong)):
        out[label] = text_of(*share(single, claim))
    out["large"] = text_of(*share(parts["large"], is_right))
    out["null alarms"] = text_of(*share(parts["null"], is_alarm))
    out["unlisted named"] = text_of(
        *share(parts["unlisted"], lambda r: is_named(r) and not is_flagged(r))
    )
    out["misnamed"] = text_of(*share(parts["unlisted"], is_misnamed))
    out["failed"] = f"{sum(is_failed(r) for r in rows)}/{len(rows)}"
    out["R"] = "{:.2f} ({:.2f} to {:.2f})".format(*ratio_of(single)[:3]) if single else "-"
    out["seconds"] = f"{np.median(seconds):.1f}, {np.max(seconds):.0f}" if seconds else "-"
    return out


def by_range(rows: Sequence[Row], key: str, edges: Sequence[float]) -> list[dict[str, str]]:
    """R and avoidable errors of single effects by lambda or by the largest cosine to a rival."""
    out = []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        among = [r for r in rows if r["part"] == "single" and low <= r.get(key, -1.0) < high]
        among = [r for r in among if "error" not in r]
        if not among:
            continue
        R, least, most, avoidable = ratio_of(among)
        sets = ratio_of(among, has_truth, oracle_has_truth)
        out.append(
            {
                key: f"{low:g} to {high:g}",
                "cases": str(len(among)),
                "casid": text_of(*share(among, is_right)),
                "oracle-2": text_of(*share(among, oracle_is_right)),
                "oracle-1": text_of(*share(among, lambda r: oracle_is_right(r, "oracle_1"))),
                "R": f"{R:.3f} ({least:.3f} to {most:.3f})",
                "avoidable": f"{100 * avoidable:.1f} %",
                "R of sets": f"{sets[0]:.3f} ({sets[1]:.3f} to {sets[2]:.3f})",
            }
        )
    return out


def confusions(rows: Iterable[Row]) -> list[str]:
    """Records that went wrong, a line each."""
    out = []
    for r in rows:
        hidden = "nothing" if r["kind"] == "none" else f"{r['kind']}({r['where']})"
        named = first(r)
        said = r.get("error") or ("nothing" if named is None else "{}({})".format(*named))
        good = not is_alarm(r) if r["part"] == "null" else is_right(r)
        if r["part"] == "unlisted":
            good = not is_misnamed(r)
        if good and not is_failed(r):
            continue
        beside = " (oracle errs too)" if not oracle_is_right(r) else ""
        where = f"--systems {r['system']} --seed {r['seed']} --first {r['number']} --records 1"
        out.append(f"  {hidden} lambda {r['energy']:.0f}: {said}{beside}   [{where}]")
    return out


def targets_of(rows: Sequence[Row], *, quick: bool) -> list[Target]:
    """What the park is to show; with `quick` a rate misses only beyond chance."""
    done = [r for r in rows if "error" not in r]
    single = [r for r in done if r["part"] == "single"]
    out: list[Target] = []

    def least(what: str, among: Sequence[Row], claim: Callable[[Row], bool], wanted: float) -> None:
        hits, of = share(among, claim)
        if of:
            met = reaches(hits, of, wanted, quick=quick)
            out.append(Target(what, text_of(hits, of), f">= {100 * wanted:g} %", met))

    def most(what: str, among: Sequence[Row], claim: Callable[[Row], bool], wanted: float) -> None:
        hits, of = share(among, claim)
        if of:
            met = stays_within(hits, of, wanted, quick=quick)
            out.append(Target(what, text_of(hits, of), f"<= {100 * wanted:g} %", met))

    least("right name", single, is_right, 0.92)
    least("truth in the reported set", single, has_truth, 0.97)
    most("wrong name without a flag", single, is_wrong, 0.03)
    large = [r for r in done if r["part"] == "large"]
    least("right name, lambda > 1e5", large, is_right, 0.97)
    unlisted = [r for r in done if r["part"] == "unlisted"]
    most(
        "unlisted cause named without a flag",
        unlisted,
        lambda r: is_named(r) and not is_flagged(r),
        0.05,
    )
    most("of which the record shows that the name is wrong", unlisted, is_misnamed, 0.05)
    for name in sorted({r["system"] for r in rows}):
        own = [r for r in done if r["system"] == name]
        nulls = [r for r in own if r["part"] == "null"]
        if nulls:
            hits, of = share(nulls, is_alarm)
            limit = int(binom.isf(0.025, of, NOMINAL))
            found = text_of(hits, of)
            out.append(Target(f"{name}: false alarms", found, f"<= {limit}", hits <= limit))
        compared = [r for r in own if r["part"] == "single"]
        if compared:
            R, low, high, _ = ratio_of(compared)
            met = high >= 0.93 if quick else R >= 0.93
            out.append(Target(f"{name}: R", f"{R:.3f} ({low:.3f} to {high:.3f})", ">= 0.93", met))
    if single:
        avoidable = lambda r: oracle_is_right(r) and not is_right(r)  # noqa: E731
        most("avoidable errors", single, avoidable, 0.02)
    failed = sum(is_failed(r) for r in rows)
    wanted = f"none, none above {BUDGET:g} s"
    out.append(Target("runs that fail", f"{failed} of {len(rows)}", wanted, failed == 0))
    return out
