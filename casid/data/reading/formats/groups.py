"""Which table of a file that holds several: sheets, groups, variables of one length."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from casid.data.reading.file_format import FileFormat
from casid.data.reading.tables import FrameTable
from casid.errors import DataError, nearest
from casid.model.quantities import count_text

if TYPE_CHECKING:
    import pandas as pd


class Group(NamedTuple):
    """One table of a file: its columns, and the units that the file names for them."""

    frame: pd.DataFrame
    units: Mapping[str, str]
    remarks: tuple[str, ...] = ()


def chosen_table(
    path: Path, form: FileFormat, groups: Mapping[str, Group], word: str
) -> FrameTable:
    """The table of the group that the format names, or of the only one.

    Parameters
    ----------
    groups : name -> table.
    word : what the file calls a group, as "sheet".

    Raises
    ------
    DataError
        If there is none, the name is of none, or there are several and none is named.
    """
    if not groups:
        raise DataError(
            f"{path.name}: no {word} with columns of numbers. Export the measurement again, or "
            "give another file."
        )
    name = form.table
    if name is not None and name not in groups:
        raise DataError(
            f"{path.name}: no {word} {name!r} to name with --table{nearest(name, groups)}"
        )
    if name is None:
        if len(groups) > 1:
            listed = "; ".join(f"{n} ({_size(g)})" for n, g in list(groups.items())[:8])
            raise DataError(
                f"{path.name}: {len(groups)} {word}s: {listed}. Choose one with --table NAME "
                f"(FileFormat(table={next(iter(groups))!r}))."
            )
        name = next(iter(groups))
    group = groups[name]
    table = FrameTable(path, form, group.frame, group.units)
    table.remarks += [f"{word} {name}"] if name else []
    table.remarks += group.remarks
    return table


def _size(group: Group) -> str:
    names = [str(c) for c in group.frame.columns]
    listed = ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")
    return f"{count_text(len(group.frame), 'row')} of {listed}"
