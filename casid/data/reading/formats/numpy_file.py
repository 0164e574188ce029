"""NumPy archives (.npz)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from casid.data.reading.file_format import FileFormat
from casid.data.reading.formats.groups import chosen_table
from casid.data.reading.formats.numeric_variables import groups_of
from casid.data.reading.tables import Table


def open_file(path: Path, form: FileFormat) -> Table:
    """The table of an archive: its vectors of one length.

    Raises
    ------
    DataError
        If it holds none or several tables.
    """
    with np.load(path, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    return chosen_table(path, form, groups_of(arrays), "array")
