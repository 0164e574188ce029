"""Whether what was said of a case is right.

Right: the first cause is the hidden kind in the hidden place. Delay and lag of one channel are one
class, as are dead zone and backlash; what the model makes the same (a cosine of the whitened,
projected signatures beyond `oracle.SAME`) counts as the hidden one: the row's `names`.
Wrong: a first cause that is named, the hidden one not in the set with it, and nothing flagged.
Explained: what is named leaves no more of the hidden effect than errors of estimates do, so that no
test of this record could reject it. A cause that no catalogue has is misnamed where its name is
wrong and does not explain it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scipy.stats import chi2

from analysis.diagnosis_power.judgement import UNKNOWN, is_flagged, reported

Row = Mapping[str, Any]

ERRORS = 0.01
"""Chance that errors of the estimates leave more of the hidden effect than counts as none."""


def names_of(row: Row) -> set[tuple[str, str]]:
    """What counts as the hidden effect."""
    return {(kind, where) for kind, where in row["names"]} | {(row["kind"], row["where"])}


def first(row: Row) -> tuple[str, str] | None:
    """The first cause."""
    causes = row.get("causes", ())
    return (causes[0]["kind"], causes[0]["where"]) if causes else None


def is_right(row: Row) -> bool:
    """True if the first cause is the hidden one."""
    return first(row) in names_of(row)


def has_truth(row: Row) -> bool:
    """True if the hidden effect is the first cause or one of its alternatives."""
    return any(pair in names_of(row) for c in row.get("causes", ())[:1] for pair in reported(c))


def is_named(row: Row) -> bool:
    """True if the first cause has a name."""
    pair = first(row)
    return pair is not None and pair[0] != UNKNOWN


def is_wrong(row: Row) -> bool:
    """A wrong name without a flag."""
    return is_named(row) and not has_truth(row) and not is_flagged(row)


def is_explained(row: Row) -> bool:
    """True if what is named leaves as little of the hidden effect as errors of estimates do."""
    return is_named(row) and "left" in row and bool(row["left"] <= chi2.isf(ERRORS, row["free"]))


def is_misnamed(row: Row) -> bool:
    """A wrong name without a flag, of which the record shows that it is wrong."""
    return is_wrong(row) and not is_explained(row)


def oracle_is_right(row: Row, which: str = "oracle_2") -> bool:
    """Kinds that spoil samples have no oracle: it is taken as right."""
    return which not in row or tuple(row[which]) in names_of(row)


def oracle_has_truth(row: Row, which: str = "oracle_2") -> bool:
    """As `oracle_is_right`, of the set that the oracle reports."""
    return which not in row or any(tuple(p) in names_of(row) for p in row[f"{which}_set"])
