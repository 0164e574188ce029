"""NumPy archives (.npz)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from casid.data.reading.file_format import FileFormat
from casid.data.reading.groups import chosen_table
from casid.data.reading.numeric_variables import groups_of
from casid.data.reading.tables import Table
from casid.errors import DataError


def open_file(path: Path, form: FileFormat) -> Table:
    """The table of an archive: its vectors of one length.

    Raises
    ------
    DataError
        If it holds objects, or none or several tables.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (OSError, ValueError) as error:
        raise DataError(
            f"{path.name}: not a readable NumPy archive ({error}). Save plain arrays with "
            "numpy.savez."
        ) from None
    return chosen_table(path, form, groups_of(arrays), "array")
