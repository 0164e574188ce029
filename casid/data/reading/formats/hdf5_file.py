"""HDF5 files, MATLAB's of version 7.3 among them, by h5py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from casid.data.reading.file_format import FileFormat
from casid.data.reading.formats.groups import chosen_table
from casid.data.reading.formats.numeric_variables import groups_of
from casid.data.reading.tables import Table


def open_file(path: Path, form: FileFormat) -> Table:
    """The table of a file: data sets of one length in one group, or a compound data set.

    The attribute `unit` or `units` of a data set is its unit.

    Raises
    ------
    DataError
        If it holds none or several tables.
    """
    import h5py

    arrays: dict[str, Any] = {}
    units: dict[str, str] = {}

    def visit(name: str, item: Any) -> None:
        """Collect a data set, field by field where it has fields, and its unit."""
        if not isinstance(item, h5py.Dataset) or name.startswith("#"):
            return  # MATLAB keeps what is no array under #refs#
        values = item[()]
        if getattr(values, "dtype", None) is not None and values.dtype.names:
            for part in values.dtype.names:
                arrays[f"{name}/{part}"] = values[part]
            return
        arrays[name] = values if not _is_matlab(item) else np.transpose(values)
        unit = item.attrs.get("unit", item.attrs.get("units"))
        if unit is not None:
            units[name] = unit.decode() if isinstance(unit, bytes) else str(unit)

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return chosen_table(path, form, groups_of(arrays, units), "group")


def _is_matlab(item: Any) -> bool:
    """MATLAB writes its matrices by columns: HDF5 shows them transposed."""
    return "MATLAB_class" in item.attrs
