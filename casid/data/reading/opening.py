"""Which reader a file belongs to, by its first bytes and its name."""

from __future__ import annotations

import difflib
import importlib
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

from casid.data.reading.file_format import FileFormat
from casid.data.reading.formats.parquet_table import ParquetTable
from casid.data.reading.formats.text_table import TextTable
from casid.data.reading.tables import Table
from casid.errors import CasidError, DataError

_SUFFIXES = (
    ".csv .txt .tsv .dat .asc .lvm .parquet .pq .xlsx .xlsm .mat .h5 .hdf5 .tdms .mf4 .mdf .bag "
    ".npz .gz .zip"
).split()


class _Reader(NamedTuple):
    """The module that reads a kind of file, the extra it belongs to, and what it imports.

    `what` the kind is called, and what helps where a file of it is damaged.
    """

    module: str
    extra: str
    package: str
    what: str
    remedy: str = "Export the measurement as CSV."


_READERS = {
    "excel": _Reader(
        "spreadsheet", "excel", "openpyxl", "Excel workbook", "Save it again as .xlsx or CSV."
    ),
    "matlab": _Reader(
        "matlab_file", "matlab", "scipy", "MATLAB file",
        "Save it again with save('run.mat', '-v7'), or export CSV with writetable.",
    ),
    "hdf5": _Reader(
        "hdf5_file", "matlab", "h5py", "HDF5 file",
        "Write it again, or give the measurement as CSV.",
    ),
    "tdms": _Reader("tdms_file", "daq", "nptdms", "TDMS file"),
    "mdf": _Reader("mdf_file", "daq", "asammdf", "MDF file"),
    "rosbag": _Reader("ros_bag", "daq", "rosbags", "ROS bag", "Export the topic as CSV."),
    "npz": _Reader(
        "numpy_file", "", "numpy", "NumPy archive", "Save plain arrays with numpy.savez."
    ),
}  # fmt: skip
_MAGIC = {
    b"PAR1": "parquet",
    b"\x89HDF": "hdf5",
    b"MATL": "matlab",
    b"TDSm": "tdms",
    b"MDF ": "mdf",
    b"#ROS": "rosbag",
}
_OTHER = {
    b"\xd0\xcf\x11\xe0": ("an old Excel workbook (.xls)", "Save it as .xlsx or CSV."),
    b"%PDF": ("a PDF document", "Give the measurement as CSV."),
    b"\x89PNG": ("a picture", "Give the measurement as CSV."),
    b"\xff\xd8\xff": ("a picture", "Give the measurement as CSV."),
    b"SQLi": ("an SQLite database", "Export the table as CSV; of a ROS 2 bag give its folder."),
    b"{\\rt": ("a document (.rtf)", "Save it as plain text or CSV."),
    b"7z\xbc\xaf": ("a 7-Zip archive", "Unpack it, or pack it as .zip or .gz."),
    b"BZh": ("a bzip2 archive", "Unpack it, or pack it as .zip or .gz."),
    b"\x89MCA": ("an MCAP file", "Give the folder of the ROS 2 bag that holds it."),
}


def open_table(path: str | Path, form: FileFormat | None = None) -> Table:
    """Open a file of any format that can be read.

    Raises
    ------
    DataError
        If there is no such file, it is no table, or the extra that reads it is not installed.
    """
    path, form = Path(path), form or FileFormat()
    _refuse_path(path)
    kind = kind_of(path)
    if kind == "text":
        return TextTable(path, form)
    if kind == "parquet":
        return ParquetTable(path, form)
    reader = _READERS[kind]
    if reader.extra:
        require_package(reader.package, reader.extra, path.name)
    module = importlib.import_module(f"casid.data.reading.formats.{reader.module}")
    try:
        table: Table = module.open_file(path, form)
    except (CasidError, MemoryError, ImportError):
        raise
    except Exception as error:  # the packages raise anything where a file is damaged
        reason = str(error).partition("\n")[0]
        raise DataError(
            f"{path.name}: not a readable {reader.what} ({reason}). {reader.remedy}"
        ) from error
    return table


def require_package(package: str, extra: str, file: str) -> Any:
    """The imported package, or a refusal that names the extra to install."""
    try:
        return importlib.import_module(package)
    except ImportError:
        raise DataError(
            f'{file} needs the package {package}. Install it with: pip install "casid[{extra}]", '
            "or export the measurement as CSV."
        ) from None


def kind_of(path: Path) -> str:
    """The kind of a file: "text" where nothing else is known of it."""
    if path.is_dir():
        return "rosbag"
    with path.open("rb") as file:
        start = file.read(8)
        file.seek(512)
        userblock = file.read(4)
    if start[:4] == b"MATL" and userblock == b"\x89HDF":
        return "hdf5"  # a MATLAB file of version 7.3
    for magic, kind in _MAGIC.items():
        if start.startswith(magic):
            return kind
    if start.startswith(b"PK\x03\x04"):
        return _kind_of_archive(path)
    if path.suffix.lower() in {".parquet", ".pq"}:
        return "parquet"
    if path.suffix.lower() == ".mat" and not start[:4].isalpha():
        return "matlab"  # version 4 has no first bytes of its own
    for magic, (what, remedy) in _OTHER.items():
        if start.startswith(magic):
            raise DataError(f"{path.name}: {what}, not a table. {remedy}")
    return "text"


def _kind_of_archive(path: Path) -> str:
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except zipfile.BadZipFile:
        return "text"  # refused as it is unpacked
    if any(n.startswith("xl/") for n in names):
        return "excel"
    if "content.xml" in names:
        raise DataError(f"{path.name}: an OpenDocument sheet (.ods). Save it as .xlsx or CSV.")
    return "npz" if names and all(n.endswith(".npy") for n in names) else "text"


def _refuse_path(path: Path) -> None:
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return  # a ROS 2 bag
        inside = sorted(p.name for p in path.iterdir() if p.suffix.lower() in _SUFFIXES)
        raise DataError(
            f"{path} is a folder, not a file. "
            + (
                f"Give one of its files: {', '.join(inside[:8])}."
                if inside
                else "Give a CSV or Parquet file."
            )
        )
    if path.is_file():
        return
    if path.exists():
        raise DataError(
            f"{path} is a pipe or a device, which can be read once alone and may never end. Write "
            "the measurement to a file, and give that."
        )
    folder = path.parent
    if not folder.is_dir():
        raise DataError(f"{path}: there is no folder {folder}. Check the path.")
    files = [p.name for p in folder.iterdir() if p.is_file()]
    near = difflib.get_close_matches(path.name, files, n=1, cutoff=0.4)
    data = sorted(f for f in files if f.lower().endswith(tuple(_SUFFIXES)))
    hint = f"Did you mean {near[0]!r}?" if near else ""
    if not near:
        hint = f"The folder holds {', '.join(data[:8])}." if data else "Check the path."
    raise DataError(f"{path}: there is no such file. {hint}")
