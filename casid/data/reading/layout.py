"""Where in a text the names, the units and the rows of its table are."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from casid.data.reading.header_units import looks_like_unit
from casid.data.reading.number_marks import is_number
from casid.data.reading.text_source import COMMENT

SEPARATORS = (";", "\t", "|", ",", " ")
NO_VALUE = frozenset(
    ["", "-", "--", "---", "?", "*", "nan", "na", "n/a", "n.a.", "null", "none", "#n/a", "#na"]
    + ["#nv", "#value!", "#wert!", "#div/0!", "#ref!", "#bezug!", "-nan", "1.#qnan", "-1.#ind"]
    + ["inf", "-inf", "+inf", "infinity", "<na>", "bad", "missing", "no data", "nodata"]
)
"""Cells, in small letters, that stand for no value."""

WEEKDAY = r"(?:(?:mo|tu|we|th|fr|sa|su|di|mi|do|so)[^\W\d]{0,8}\.?,?\s+)"
MONTH = r"(?:jan|feb|m[aä]r|apr|ma[iy]|jun|jul|aug|sep|o[ck]t|nov|de[cz])[^\W\d]{0,6}\.?"
"""What a date in words begins with: Wed Apr  3 21:46:07 2019, Wed, 03 Apr 2019 21:46:07 +0200."""
_DATE = re.compile(
    r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}\.?([ T,].*)?"
    r"|\d{1,2}(?:[-. /]|\. )[^\W\d]{3,9}\.?[-. /]\d{2,4}.*"
    r"|\d{1,3}:\d{2}(:\d{2})?([.,]\d+)?(\s*[ap]\.?m\.?)?|\d{8}T\d{4,6}.*"
    rf"|{WEEKDAY}?{MONTH}\s+\d{{1,2}},?\s.*(?:\d{{4}}|\d:\d{{2}}).*"
    rf"|{WEEKDAY}\d{{1,2}}\.?\s+{MONTH}\s+\d{{4}}.*",
    re.IGNORECASE,
)


@dataclass(slots=True)
class Layout:
    """Where the names, units and rows are.

    Attributes
    ----------
    names : of the columns, as written; empty where there is no line of names.
    units : the cells of a row of units; empty where there is none.
    first : line of the first row, from 0.
    above : lines of text above the names.
    footers : lines below the last row that are no rows.
    width : cells in a row.
    """

    separator: str
    names: list[str] = field(default_factory=list)
    units: list[str] = field(default_factory=list)
    first: int = 0
    above: int = 0
    footers: int = 0
    width: int = 0


def cells_of(line: str, separator: str) -> list[str]:
    """The cells of a line; one with a cell beyond csv's limit, 128 kB, has no quotes."""
    if separator == " ":
        return line.split()
    parts = [f"{part}\n" for part in line.split("\n")]  # more than one where a cell has breaks
    try:
        cells = next(csv.reader(parts, delimiter=separator, skipinitialspace=True))
    except csv.Error:
        cells = line.split(separator)
    return [" ".join(c.split()) if "\n" in c else c.strip() for c in cells]


def is_value(cell: str) -> bool:
    """Whether a cell is a number, a date or a time of day."""
    return is_number(cell) or bool(_DATE.fullmatch(cell))


def is_date(cell: str) -> bool:
    """Whether a cell is a date or a time of day."""
    return bool(_DATE.fullmatch(cell)) and not is_number(cell)


def layout_of(head: Sequence[str], tail: Sequence[str]) -> Layout:
    """Read the layout from the first lines, and the footers from the last ones."""
    given = next((m for m in map(_SEP_LINE.fullmatch, head[:3]) if m), None)
    separator = given[1] if given else _separator(head)
    layout = layout_of_rows(
        [
            None
            if not line.strip() or COMMENT.match(line) or _SEP_LINE.fullmatch(line)
            else cells_of(line, separator)
            for line in head
        ],
        [cells_of(line, separator) for line in tail if line.strip() and not COMMENT.match(line)],
    )
    layout.separator = separator
    if separator == " " and layout.above < len(head) and len(layout.names) > layout.width > 1:
        line = next(x for x in head if cells_of(x, " ") == layout.names)
        apart = re.split(r"\s{2,}", line.strip())
        layout.names = apart if len(apart) == layout.width else layout.names
    commented = _commented_rows(head[: layout.first], layout.width, separator)
    if not layout.names and commented:
        # The last one, unless it has the units of names above it.
        layout.names = next((row for row in commented if not _is_units(row)), commented[0])
    if not layout.units:
        rows = (row for row in commented if row != layout.names and _is_units(row))
        layout.units = next(rows, [])
    return layout


_SEP_LINE = re.compile(r'"?sep=(.)"?', re.IGNORECASE)


def layout_of_rows(
    rows: Sequence[list[str] | None], tail: Sequence[list[str]] | None = None
) -> Layout:
    """The layout of lines that are cells already; None is a line that is not read."""
    lines = [k for k, row in enumerate(rows) if row is not None]
    layout = Layout(",")
    if not lines:
        return layout
    body = _first_row(rows, lines)
    layout.width = _width(rows, lines)
    above = [k for k in lines if k < body] if body is not None else lines[:1]
    layout.first = lines[1] if body is None and len(lines) > 1 else (body or 0)
    if body is None and len(lines) == 1:
        layout.first = lines[0] + 1
    if above:
        layout.names, layout.units, layout.above = _header(rows, above)
    values = _value_columns(rows, lines, layout.width)
    if tail and body is not None and len(lines) > 2:
        layout.footers = _footers(tail, layout.width, values)
        foot = [r for r in tail[len(tail) - layout.footers :] if any(r)]
        if len(foot) == 1 and not layout.units and _is_units(foot[0]):
            layout.units = foot[0]
    return layout


def _header(rows: Sequence[list[str] | None], above: list[int]) -> tuple[list[str], list[str], int]:
    """Names, units, and how many lines of text stand above them."""

    def row(k: int) -> list[str]:
        found = rows[above[k]]
        assert found is not None
        return found

    if len(above) > 1 and _is_units(row(-1)) and len(row(-2)) >= max(2, len(row(-1)) - 1):
        return row(-2), row(-1), len(above) - 2
    if all(is_value(c) for c in row(-1)):
        return [], [], len(above)
    return row(-1), [], len(above) - 1


def _is_units(cells: list[str]) -> bool:
    named = [c for c in cells if c.strip(" -")]
    return bool(named) and sum(map(looks_like_unit, named)) > 0.7 * len(named)


def _width(rows: Sequence[list[str] | None], lines: list[int]) -> int:
    """How many cells most lines have; of many lines the lower half, where the rows are."""
    counts = Counter(len(rows[k] or ()) for k in lines[len(lines) // 2 if len(lines) > 9 else 0 :])
    return counts.most_common(1)[0][0]


def _value_columns(rows: Sequence[list[str] | None], lines: list[int], width: int) -> list[int]:
    """The columns of numbers and times: in the lower half of the lines, half of the cells are."""
    cells: list[list[str]] = [[] for _ in range(width)]
    for k in lines[len(lines) // 2 :]:
        row = rows[k] or []
        if len(row) == width:
            for c, cell in enumerate(row):
                if cell.casefold() not in NO_VALUE:
                    cells[c].append(cell)
    return [
        c for c, entry in enumerate(cells) if entry and 2 * sum(map(is_value, entry)) >= len(entry)
    ]


def _first_row(rows: Sequence[list[str] | None], lines: list[int]) -> int | None:
    """The line of the first row of values; None where no line is one."""
    width = _width(rows, lines)
    values = _value_columns(rows, lines, width)
    sound = {k for k in lines if _is_row(rows[k] or [], width, values)}
    for i, k in enumerate(lines):
        near = lines[i + 1 : i + 4]
        if k in sound and (not near or any(n in sound for n in near)):
            return k
    return min(sound, default=None)


def _is_row(cells: list[str], width: int, values: list[int]) -> bool:
    """Whether every column of values has one here, or none of its own."""
    if len(cells) != width or not values:
        return False
    held = [cells[c] for c in values if cells[c].casefold() not in NO_VALUE]
    return 2 * len(held) >= len(values) and all(map(is_value, held))


def _footers(tail: Sequence[list[str]], width: int, values: list[int]) -> int:
    """Lines at the end of which most cells are no values, or that have none."""
    count = 0
    for cells in reversed(tail):
        if _is_row(cells, width, values):
            return count
        held = [c for i, c in enumerate(cells) if (i in values or len(cells) != width) and c]
        if held and 2 * sum(c.casefold() in NO_VALUE or is_value(c) for c in held) >= len(held):
            return count
        count += 1
    return 0


def _separator(head: Sequence[str]) -> str:
    """The separator that cuts the lines into as many cells each, most of them values."""
    lines = [line for line in head if line.strip() and not COMMENT.match(line)]
    best, score = "", 0.0
    for separator in SEPARATORS:
        rows = [cells_of(line, separator) for line in lines]
        below = rows[len(rows) // 2 :]
        width = Counter(map(len, below)).most_common(1)[0][0] if below else 0
        if width < 2:
            continue
        like = [r for r in below if len(r) == width]
        cells = [c for r in like for c in r if c.casefold() not in NO_VALUE]
        share = sum(map(is_value, cells)) / len(cells) if cells else 0.0
        share *= len(like) / len(below)
        if share > score + 1e-9:
            best, score = separator, share
    if best:
        return best
    first = lines[0] if lines else ""
    counts = {s: first.count(s) for s in (";", "\t", "|", ",")}
    return max(counts, key=lambda s: counts[s]) if any(counts.values()) else ","


def names_above(above: Sequence[str], layout: Layout) -> list[str]:
    """Names in a line of comment that are more than the rows have values; none where no line is."""
    for bare in _comments(above):
        names = cells_of(bare, layout.separator)
        if len(names) > layout.width > 1 and not any(map(is_value, names)):
            return names
    return []


def _commented_rows(above: Sequence[str], width: int, separator: str) -> list[list[str]]:
    """Lines of comment with a cell for each column, the last first: names, or their units.

    `numpy.savetxt` writes names so, and who adds units below them often makes them a comment.
    """
    found = []
    for bare in _comments(above):
        for cut in (separator, ",", "\t", " "):
            cells = cells_of(bare, cut) if bare else []
            if len(cells) == width and not any(map(is_value, cells)):
                found.append(cells)
                break
    return found


def _comments(above: Sequence[str]) -> Iterator[str]:
    """Lines of comment without their marks, the last first."""
    for line in reversed(above):
        if COMMENT.match(line):
            yield line.lstrip().lstrip("#%/").strip()
