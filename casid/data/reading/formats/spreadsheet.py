"""Excel workbooks (.xlsx, .xlsm), by openpyxl."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from casid.data.reading.file_format import FileFormat
from casid.data.reading.formats.groups import Group, chosen_table
from casid.data.reading.layout import layout_of_rows
from casid.data.reading.tables import Table
from casid.data.reading.text_source import HEAD
from casid.model.quantities import count_text


def open_file(path: Path, form: FileFormat) -> Table:
    """The table of a workbook; values of formulas as Excel saved them.

    Raises
    ------
    DataError
        If none or several of its sheets hold a table.
    """
    import openpyxl

    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    groups = {}
    for sheet in book.worksheets:
        group = _table_of([list(row) for row in sheet.iter_rows(values_only=True)])
        if group is not None:
            groups[str(sheet.title)] = group
    book.close()
    return chosen_table(path, form, groups, "sheet")


def _table_of(rows: Sequence[Sequence[Any]]) -> Group | None:
    """The table on a sheet; None where it has no rows of values below a line of names."""
    import pandas as pd

    used = [k for row in rows for k, cell in enumerate(row) if cell is not None]
    if not used:
        return None
    left, right = min(used), max(used) + 1
    cells = [list(row[left:right]) for row in rows]
    while cells and all(c is None for c in cells[-1]):
        cells.pop()
    texts = [None if all(c is None for c in row) else [_text(c) for c in row] for row in cells]
    layout = layout_of_rows(texts[:HEAD], [t for t in texts[-60:] if t is not None])
    body = [row for row in cells[layout.first : len(cells) - layout.footers] if any_cell(row)]
    if not layout.names or len(body) < 2:
        return None
    frame = pd.DataFrame(body).set_axis(range(len(layout.names)), axis=1)
    kept = [k for k, n in enumerate(layout.names) if n or frame[k].notna().any()]
    columns = {layout.names[k] or f"column {k + 1}": frame[k].infer_objects() for k in kept}
    if len(columns) < len(kept):
        names = [f"{layout.names[k]}#{k + 1}" for k in kept]
        columns = dict(zip(names, (frame[k].infer_objects() for k in kept), strict=True))
    units = {layout.names[k]: u for k, u in enumerate(layout.units) if k in kept and u.strip(" -")}
    remarks = []
    if layout.above:
        remarks.append(f"{count_text(layout.above, 'row')} above the names of the columns not read")
    if layout.footers:
        remarks.append(f"{count_text(layout.footers, 'row')} below the last one not read")
    return Group(pd.DataFrame(columns), units, tuple(remarks))


def any_cell(row: Sequence[Any]) -> bool:
    """Whether a row has a cell that is not empty."""
    return any(c is not None for c in row)


def _text(cell: Any) -> str:
    if cell is None:
        return ""
    if isinstance(cell, datetime.datetime | datetime.date):
        return cell.isoformat().replace("T", " ")
    if isinstance(cell, datetime.timedelta):
        return str(cell.total_seconds())
    return str(cell).strip()
