"""TDMS files of LabVIEW, by npTDMS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from casid.data.reading.file_format import FileFormat
from casid.data.reading.formats.groups import Group, chosen_table
from casid.data.reading.tables import Table
from casid.errors import DataError


def open_file(path: Path, form: FileFormat) -> Table:
    """The table of a TDMS file: the channels of a group, the time from their `wf_increment`.

    Raises
    ------
    DataError
        If it holds none or several groups, or the channels of a group have different sample
        times.
    """
    from nptdms import TdmsFile

    groups = {}
    for group in TdmsFile.read(path).groups():
        channels = {str(c.name): c for c in group.channels() if len(c)}
        if channels:
            groups[str(group.name)] = _group(path, str(group.name), channels)
    return chosen_table(path, form, groups, "group")


def _group(path: Path, name: str, channels: dict[str, Any]) -> Group:
    import pandas as pd

    clocks = {
        c: (float(v.properties["wf_increment"]), float(v.properties.get("wf_start_offset", 0.0)))
        for c, v in channels.items()
        if v.properties.get("wf_increment")
    }
    lengths = {len(v) for v in channels.values()}
    if len(set(clocks.values())) > 1 or len(lengths) > 1:
        listed = ", ".join(
            f"{c} ({len(v)} samples" + (f", every {clocks[c][0]:g} s)" if c in clocks else ")")
            for c, v in list(channels.items())[:6]
        )
        raise DataError(
            f"{path.name}: the channels of group {name!r} were not sampled together: {listed}. "
            "Write those of one sample time into a group of their own."
        )
    columns: dict[str, Any] = {}
    if clocks and "t" not in channels:
        step, start = next(iter(clocks.values()))
        columns["t"] = start + step * np.arange(lengths.pop(), dtype=np.float64)
    columns |= {c: v[:] for c, v in channels.items()}
    units = {
        c: str(v.properties.get("unit_string") or v.properties.get("unit") or "")
        for c, v in channels.items()
    }
    if "t" in columns and "t" not in channels:
        units["t"] = "s"
    return Group(pd.DataFrame(columns), {c: u for c, u in units.items() if u})
