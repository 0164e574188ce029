"""Decimal marks and thousands: `1.5`, `1,5`, `1.234,5`, `1,234.5`, `1 234,5`."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

Mark = Literal[".", ","]
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?")
"""A number with a point."""

_EXP = r"(?:[eE][-+]?\d+)?"
_ONE = re.compile(rf"[-+]?\d*([.,])(\d*){_EXP}")
_GROUPED = re.compile(r"[-+]?\d{1,3}(?:([.,' \u00a0\u202f’])\d{3})(?:\1\d{3})*(?:([.,])\d*)?")
_WEAK = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}")
_SPACES = str.maketrans("", "", "' \u00a0\u202f’")


@dataclass(slots=True)
class Evidence:
    """What cells say about the marks; each entry is the first cell that says so.

    Attributes
    ----------
    decimal : mark -> a cell in which it can only be the decimal mark.
    thousands : mark -> a cell in which it can only separate thousands.
    either : mark -> a cell in which it may be one or the other, as 1.234.
    """

    decimal: dict[str, str] = field(default_factory=dict)
    thousands: dict[str, str] = field(default_factory=dict)
    either: dict[str, str] = field(default_factory=dict)

    def add(self, cells: Iterable[str]) -> Evidence:
        """Itself, with these cells."""
        for cell in cells:
            one = _ONE.fullmatch(cell)
            if one:
                where = self.either if _WEAK.fullmatch(cell) else self.decimal
                where.setdefault(one[1], cell)
                continue
            grouped = _GROUPED.fullmatch(cell)
            if grouped:
                separator, mark = grouped[1], grouped[2]
                if separator in ".,":
                    self.thousands.setdefault(separator, cell)
                if mark and mark != separator:
                    self.decimal.setdefault(mark, cell)
        return self


def decimal_mark(found: Evidence, *, default: Mark | None) -> Mark | None:
    """The decimal mark that the cells show, `default` where they leave it open; None for a clash.

    A mark that separates thousands somewhere is no decimal mark anywhere.
    """
    marks = set(found.decimal) | {("," if m == "." else ".") for m in found.thousands}
    if len(marks) > 1:
        return None
    if marks:
        return "," if "," in marks else "."
    return default


def is_number(cell: str) -> bool:
    """Whether a cell is a number, whatever its marks."""
    return bool(NUMBER.fullmatch(cell) or _ONE.fullmatch(cell) or _GROUPED.fullmatch(cell))


def plain_number(cell: str, decimal: str) -> str | None:
    """The number with a point and no thousands; None where the cell is no such number."""
    cell = cell.strip()
    if decimal == ".":
        if NUMBER.fullmatch(cell):
            return cell.replace("d", "e").replace("D", "e")
        thousands = ","
    else:
        thousands = "."
        if thousands not in cell and _ONE.fullmatch(cell):
            return cell.replace(",", ".")
        if NUMBER.fullmatch(cell) and "." not in cell:
            return cell
    grouped = _GROUPED.fullmatch(cell)
    if not grouped or grouped[1] == decimal or grouped[2] == thousands:
        return None
    bare = cell.replace(thousands, "").translate(_SPACES).replace(",", ".")
    return bare if NUMBER.fullmatch(bare) else None
