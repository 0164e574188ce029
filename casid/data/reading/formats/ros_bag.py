"""ROS bags: files of ROS 1, folders of ROS 2, by rosbags."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from casid.data.reading.file_format import FileFormat
from casid.data.reading.formats.groups import Group, chosen_table
from casid.data.reading.tables import Table


def open_file(path: Path, form: FileFormat) -> Table:
    """The table of a topic: the numbers of its messages, the time of their headers.

    The time is the header's stamp, else that of reception; seconds since the first message.

    Raises
    ------
    DataError
        If it holds none or several topics of numbers.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    columns: dict[str, dict[str, list[float]]] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        wanted = [c for c in reader.connections if form.table in (None, c.topic)]
        for connection, stamp, raw in reader.messages(connections=wanted):
            message = reader.deserialize(raw, connection.msgtype)
            row: dict[str, float] = {}
            _flatten("", message, row)
            row["t"] = row.pop("header.stamp", float("nan"))
            if not row["t"] > 0:
                row["t"] = stamp
            table = columns.setdefault(connection.topic, {})
            for name, value in row.items():
                table.setdefault(name, []).append(value)
    groups = {t: g for t, c in columns.items() if (g := _group(c)) is not None}
    return chosen_table(path, form, groups, "topic")


def _group(columns: dict[str, list[float]]) -> Group | None:
    import pandas as pd

    N = len(columns["t"])
    whole = {n: v for n, v in columns.items() if len(v) == N}
    if N < 2 or len(whole) < 2:
        return None
    stamps = np.asarray(whole.pop("t"))
    t = (stamps - stamps[0]) * 1e-9
    return Group(pd.DataFrame({"t": t, **whole}), {"t": "s"})


def _flatten(name: str, value: Any, row: dict[str, float]) -> None:
    """The numbers of a message: `linear.x`, `data_1`; a header's stamp in nanoseconds."""
    if name == "header.stamp":
        row[name] = value.sec * 1_000_000_000 + value.nanosec  # an integer: exact
    elif isinstance(value, bool | int | float | np.number):
        row[name or "data"] = float(value)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.size <= 64:
        for k, entry in enumerate(value.ravel(), start=1):
            row[f"{name}_{k}"] = float(entry)
    elif hasattr(value, "__dataclass_fields__"):
        for field in value.__dataclass_fields__:
            if not field.startswith("__"):
                _flatten(f"{name}.{field}" if name else field, getattr(value, field), row)
