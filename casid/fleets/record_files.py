"""The files of a fleet: of this machine, or behind an address that fsspec knows.

An address has a protocol: s3://bucket/voyages/*.parquet, https://..., or chained, as in
zip://*.csv::voyages.zip. Each record is copied to a folder of its own while it is read.
"""

from __future__ import annotations

import contextlib
import glob
import importlib
import re
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from casid.errors import DataError

_NUMBER = re.compile(r"\d+")
_ADDRESS = re.compile(r"^[a-z][a-z0-9+]+(::|://)", re.IGNORECASE)

NAMES = "name files, a folder of them or a pattern in quotes, as in 'voyages/*.parquet'"


@dataclass(frozen=True, slots=True)
class RecordFile:
    """A file, and what a change of it would change.

    Attributes
    ----------
    path : absolute, or an address.
    size, modified : bytes, and ns since 1970-01-01 or another number that a change of the file
        changes; 0 where the file system says neither.
    """

    path: str
    size: int
    modified: int

    @property
    def place(self) -> PurePosixPath:
        """Path of the file, without the protocol of an address and what it is inside."""
        return place_of(self.path)


def place_of(path: str) -> PurePosixPath:
    """The path of a file, without the protocol of an address and the archive that it is in."""
    if not is_address(path):
        return PurePosixPath(Path(path).as_posix())
    first = path.split("::")[0]
    return PurePosixPath("/" + first.split("://", 1)[-1].lstrip("/"))


def is_address(text: str) -> bool:
    """True of what has a protocol, which is no path."""
    return bool(_ADDRESS.match(text)) and "://" in text


def files_of(records: str | Path | Iterable[str | Path]) -> list[RecordFile]:
    """The files that patterns, folders, paths and addresses name, each once, in natural order.

    Raises
    ------
    DataError
        If one of them names no file, or an address cannot be opened.
    """
    given = [records] if isinstance(records, str | Path) else list(records)
    found: dict[str, RecordFile] = {}
    for each in given:
        named = _behind(str(each)) if is_address(str(each)) else _here(Path(each))
        if not named:
            raise DataError(f"{each}: no such record; {NAMES}")
        found |= {f.path: f for f in named}
    if not found:
        raise DataError("no record given; name files, a folder of them or a pattern")
    return sorted(found.values(), key=lambda f: natural(f.path))


def natural(text: str) -> tuple[tuple[int, int, str], ...]:
    """A key that sorts numbers in a text by their size: run2 before run10."""
    parts, end = [], 0
    for number in _NUMBER.finditer(text):
        parts += [(1, 0, text[end : number.start()]), (0, int(number[0]), "")]
        end = number.end()
    return (*parts, (1, 0, text[end:]))


@contextlib.contextmanager
def local(path: str) -> Iterator[Path]:
    """A path of this machine for a record, as long as it is read.

    Raises
    ------
    DataError
        If an address cannot be opened.
    """
    if not is_address(path):
        yield Path(path)
        return
    fs, inside = _opened(path)
    with tempfile.TemporaryDirectory(prefix="casid-") as folder:
        copy = Path(folder) / place_of(path).name
        with _explained(path):
            fs.get_file(inside, str(copy))
        yield copy


def _here(path: Path) -> list[RecordFile]:
    if path.is_dir():
        named = [p for p in path.rglob("*") if p.is_file() and not p.name.startswith(".")]
    elif glob.has_magic(str(path)) and not path.exists():
        named = [Path(p) for p in glob.glob(str(path), recursive=True) if Path(p).is_file()]
    else:
        named = [path] if path.is_file() else []
    out = []
    for p in named:
        status = p.stat()
        out.append(RecordFile(str(p.resolve()), status.st_size, status.st_mtime_ns))
    return out


def _behind(address: str) -> list[RecordFile]:
    """The files of an address: one, those of a folder, or those that a pattern names."""
    fs, inside = _opened(address)
    with _explained(address):
        if glob.has_magic(inside):
            paths = [p for p in fs.glob(inside) if fs.isfile(p)]
        elif fs.isdir(inside):
            paths = [p for p in fs.find(inside) if not PurePosixPath(p).name.startswith(".")]
        else:
            paths = [inside] if fs.exists(inside) else []
        first, *outer = address.split("::")
        protocol = first.split("://")[0]
        out = []
        for path in paths:
            info = fs.info(path)
            whole = "::".join([f"{protocol}://{fs._strip_protocol(path)}", *outer])
            out.append(RecordFile(whole, int(info.get("size") or 0), _modified(info)))
    return out


def _modified(info: dict[str, Any]) -> int:
    """A number that changes with the file: its time, or what its store calls its version."""
    import zlib

    for name in ("mtime", "LastModified", "last_modified", "created", "ETag", "date_time", "CRC"):
        if (value := info.get(name)) is not None:
            if isinstance(value, int | float):
                return int(1e9 * value)
            return zlib.crc32(str(value).encode())
    return 0


def _opened(address: str) -> tuple[Any, str]:
    try:
        fsspec = importlib.import_module("fsspec")
    except ImportError:
        raise DataError(
            f"{address}: addresses need the extra `remote`; install it with: pip install "
            "'casid[remote]'"
        ) from None
    with _explained(address):
        fs, inside = fsspec.core.url_to_fs(address)
    return fs, str(inside)


@contextlib.contextmanager
def _explained(address: str) -> Iterator[None]:
    """Say which address failed, and how; what its file system raises is its own."""
    try:
        yield
    except DataError:
        raise
    except Exception as error:
        what = str(error).strip().splitlines() or [type(error).__name__]
        raise DataError(
            f"{address} cannot be opened ({what[0]}); check the address, and that the package of "
            "its protocol is installed (s3fs for s3://, gcsfs for gs://)"
        ) from error
