"""MATLAB files of versions 4 to 7.2, by SciPy; those of 7.3 are HDF5 files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from casid.data.reading.file_format import FileFormat
from casid.data.reading.formats.groups import chosen_table
from casid.data.reading.formats.numeric_variables import groups_of
from casid.data.reading.tables import Table
from casid.errors import DataError


def open_file(path: Path, form: FileFormat) -> Table:
    """The table of a .mat file: vectors and matrices, also in structures (`run.t`).

    Raises
    ------
    DataError
        If it holds none or several tables.
    """
    from scipy.io import loadmat

    arrays: dict[str, Any] = {}
    for name, value in loadmat(path, simplify_cells=True).items():
        if not name.startswith("__"):
            _flatten(name, value, arrays)
    groups = groups_of(arrays)
    if not groups:
        raise DataError(
            f"{path.name}: no vectors of numbers among {', '.join(arrays) or 'its variables'}. "
            "Tables, timetables and timeseries are MATLAB's own objects: write them with "
            "writetable(T, 'run.csv') or parquetwrite('run.parquet', T)."
        )
    return chosen_table(path, form, groups, "variable")


def _flatten(name: str, value: Any, arrays: dict[str, Any]) -> None:
    """Take the fields of structures apart."""
    if isinstance(value, dict):
        for field, entry in value.items():
            _flatten(f"{name}.{field}", entry, arrays)
    elif isinstance(value, np.ndarray | list | float | int):
        arrays[name] = np.asarray(value) if not isinstance(value, list) else np.empty(0)
