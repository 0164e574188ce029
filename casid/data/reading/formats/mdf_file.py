"""MDF files of measurement systems in vehicles (.mf4, .mdf), by asammdf."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from casid.data.reading.file_format import FileFormat
from casid.data.reading.formats.groups import Group, chosen_table
from casid.data.reading.tables import Table


def open_file(path: Path, form: FileFormat) -> Table:
    """The table of an MDF file: a channel group, its time the master channel.

    Raises
    ------
    DataError
        If it holds none or several groups.
    """
    from asammdf import MDF

    with MDF(path) as file:
        groups = {f"group {k}": g for k in range(len(file.groups)) if (g := _group(file, k))}
    return chosen_table(path, form, groups, "channel group")


def _group(file: Any, index: int) -> Group | None:
    import pandas as pd

    columns: dict[str, Any] = {}
    units: dict[str, str] = {}
    for k, channel in enumerate(file.groups[index].channels):
        if k == file.masters_db.get(index):
            continue
        signal = file.get(group=index, index=k)
        if signal.samples.ndim != 1 or signal.samples.dtype.kind not in "fiub":
            continue
        columns.setdefault("t", np.asarray(signal.timestamps))
        columns[str(channel.name)] = signal.samples
        units[str(channel.name)] = str(signal.unit or "")
    units["t"] = "s"
    return Group(pd.DataFrame(columns), units) if len(columns) > 1 else None
