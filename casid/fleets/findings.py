"""The same cause in several records of an asset as one finding: what, since when, until when.

A cause that is there shows in a record with probability a, one that is not there with b. Each
record of the asset, in order of time, that shows it counts log(a / b), each that could show it and
does not log((1 - a) / (1 - b)), and one without an outcome 0. The findings are the stretches of
maximal sum (Ruzzo and Tompa, ISMB 1999, 234-241: all of them in linear time), which are the most
likely stretches in which the cause was there. The 95 % interval of an onset holds all starts from
which the sum to the stretch's end is less than the largest by at most chi^2(1) / 2 = 1.92.

Causes that a record does not separate are one finding, named after the one that is possible in most
records of the asset.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from casid.fleets.thresholds import GROUPING

Key = tuple[str, str]
"""Kind and place of a cause."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """One record of an asset.

    Attributes
    ----------
    number : of the record in the fleet.
    when : its time.
    has_answer : it was diagnosed, with an answer.
    causes : its discoveries, each with what it may be as well: key -> rivals.
    sizes : key -> size of the cause and its standard error, NaN where there is none.
    e_value : of the record.
    units : key -> unit of its size.
    """

    number: int
    when: float
    has_answer: bool
    causes: Mapping[Key, frozenset[Key]]
    sizes: Mapping[Key, tuple[float, float]]
    e_value: float
    units: Mapping[Key, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Finding:
    """One cause of one asset.

    Attributes
    ----------
    kind, where : its name.
    records : numbers of the records that show it, in order of time.
    since, until : times of its first and last record.
    onset : between these two times it began, at 95 %; the first is -inf where it may have been
        there before the first record.
    is_present : the asset's last records do not exclude that it is still there.
    e_value : mean of the e-values of the stretch's records, valid under any dependence.
    size, size_spread, unit : median of the sizes, and their median absolute deviation times 1.48.
    assets : with the same cause at the same time, this one among them.
    is_common : they are so many that it is no matter of this asset.
    also : what it may be as well in most of its records.
    """

    asset: str
    kind: str
    where: str
    records: tuple[int, ...]
    since: float
    until: float
    onset: tuple[float, float]
    is_present: bool
    e_value: float
    size: float = math.nan
    size_spread: float = math.nan
    assets: int = 1
    is_common: bool = False
    also: tuple[Key, ...] = ()
    unit: str = ""

    @property
    def is_lasting(self) -> bool:
        """True if more than one record shows it."""
        return len(self.records) > 1

    @property
    def key(self) -> Key:
        """Kind and place."""
        return self.kind, self.where


def findings_of(outcomes: Mapping[str, Sequence[Outcome]]) -> tuple[Finding, ...]:
    """The findings of every asset, common ones marked: those still there first, then the longest.

    Parameters
    ----------
    outcomes : asset -> its records in order of time.
    """
    found = [f for asset, records in outcomes.items() for f in _of_asset(asset, records)]
    found = _with_common(found, outcomes)
    return tuple(
        sorted(
            found,
            key=lambda f: (
                not (f.is_lasting and f.is_present),
                -len(f.records),
                -f.e_value,
                f.asset,
                f.since,
                f.key,
            ),
        )
    )


def _of_asset(asset: str, records: Sequence[Outcome]) -> list[Finding]:
    left = {i: dict(r.causes) for i, r in enumerate(records) if r.causes}
    out = []
    while any(left.values()):
        key = _commonest(left)
        shown: dict[int, Key] = {}
        for i, causes in left.items():
            named = next((k for k, rivals in causes.items() if key == k or key in rivals), None)
            if named is not None:
                shown[i] = named
        for stretch in _stretches(records, set(shown)):
            out.append(_finding(asset, key, records, shown, stretch))
        for i, named in shown.items():
            del left[i][named]
    return out


def _commonest(left: Mapping[int, Mapping[Key, frozenset[Key]]]) -> Key:
    """What most records may have; of equals what is named more often, then the first by name."""
    may: dict[Key, int] = {}
    named: dict[Key, int] = {}
    for causes in left.values():
        for key in {k for own, rivals in causes.items() for k in (own, *rivals)}:
            may[key] = may.get(key, 0) + 1
        for key in causes:
            named[key] = named.get(key, 0) + 1
    return min(named, key=lambda k: (-may[k], -named[k], k))


@dataclass(frozen=True, slots=True)
class _Stretch:
    """Records `first` to `last` of an asset, and the earliest and latest start not excluded."""

    first: int
    last: int
    earliest: int
    latest: int
    is_present: bool


def scores(records: Sequence[Outcome], shown: set[int]) -> list[float]:
    """(n,) log-likelihood ratios of the records, of which `shown` (places) show a cause."""
    a, b = GROUPING.shown, GROUPING.by_chance
    yes, no = math.log(a / b), math.log((1 - a) / (1 - b))
    return [yes if i in shown else no * r.has_answer for i, r in enumerate(records)]


def _stretches(records: Sequence[Outcome], shown: set[int]) -> list[_Stretch]:
    score = scores(records, shown)
    out = []
    for first, last in maximal_stretches(score):
        # The sum from each start to the end of the stretch, as far as it is one stretch.
        before = max((j for j in shown if j < first), default=-1)
        to_end = np.cumsum(score[before + 1 : last + 1][::-1])[::-1]
        near = np.flatnonzero(to_end >= to_end[first - before - 1] - GROUPING.drop) + before + 1
        rest = sum(score[last + 1 :])
        out.append(_Stretch(first, last, int(near[0]), int(near[-1]), rest > -GROUPING.drop))
    return out


def maximal_stretches(score: Sequence[float]) -> list[tuple[int, int]]:
    """First and last place of all stretches of maximal sum (Ruzzo and Tompa 1999), in order."""
    kept: list[_Kept] = []
    total = 0.0
    for i, s in enumerate(score):
        before, total = total, total + s
        if s <= 0:
            continue
        new = _Kept(i, i, before, total)
        while True:
            below = [k for k in range(len(kept)) if kept[k].before < new.before]
            if not below or kept[below[-1]].at_end >= new.at_end:
                kept.append(new)
                break
            old = kept[below[-1]]
            new = _Kept(old.first, new.last, old.before, new.at_end)
            del kept[below[-1] :]
    return [(k.first, k.last) for k in kept]


class _Kept(NamedTuple):
    """A stretch, with the sums of all scores before it and to its end."""

    first: int
    last: int
    before: float
    at_end: float


def _finding(
    asset: str, key: Key, records: Sequence[Outcome], shown: Mapping[int, Key], at: _Stretch
) -> Finding:
    inside = [i for i in range(at.first, at.last + 1) if i in shown]
    sizes = np.array([records[i].sizes.get(key, (math.nan, math.nan))[0] for i in inside])
    sizes = sizes[np.isfinite(sizes)]
    size = float(np.median(sizes)) if sizes.size else math.nan
    spread = 1.48 * float(np.median(np.abs(sizes - size))) if sizes.size else math.nan
    answered = [r for r in records[at.first : at.last + 1] if r.has_answer]
    rivals: dict[Key, int] = {}
    for i in inside:
        for other in {shown[i], *records[i].causes[shown[i]]} - {key}:
            rivals[other] = rivals.get(other, 0) + 1
    return Finding(
        asset=asset,
        kind=key[0],
        where=key[1],
        records=tuple(records[i].number for i in inside),
        since=records[at.first].when,
        until=records[at.last].when,
        onset=(
            records[at.earliest - 1].when if at.earliest > 0 else -math.inf,
            records[at.latest].when,
        ),
        is_present=at.is_present,
        e_value=float(np.mean([r.e_value for r in answered])),
        size=size,
        size_spread=spread,
        unit=next((r.units[key] for r in records[at.first :] if key in r.units), ""),
        also=tuple(sorted(k for k, n in rivals.items() if 2 * n > len(inside))),
    )


def _with_common(
    found: Sequence[Finding], outcomes: Mapping[str, Sequence[Outcome]]
) -> list[Finding]:
    """The findings with the number of assets that have the same at the same time.

    A cause is common where that is at least `GROUPING.common` of the assets that were recorded
    while it lasted, and `GROUPING.fewest` of them.
    """
    out = []
    for f in found:
        same = {
            g.asset for g in found if g.key == f.key and g.since <= f.until and g.until >= f.since
        }
        there = [
            asset
            for asset, records in outcomes.items()
            if records and records[0].when <= f.until and records[-1].when >= f.since
        ]
        share = len(same) / max(len(there), 1)
        is_common = share >= GROUPING.common and len(same) >= GROUPING.fewest
        out.append(replace(f, assets=len(same), is_common=is_common))
    return out
