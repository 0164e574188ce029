"""Files of results: text and JSON, each whole or not at all, and the folder they are in."""

from __future__ import annotations

import contextlib
import json
import math
import os
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from casid.errors import DataError
from casid.whole_files import write_bytes


def write_text(path: Path, text: str) -> Path:
    """Write `text` beside `path` and move it there in one step; returns the path."""
    return write_bytes(path, text.encode())


@contextlib.contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """A folder inside `folder` whose files replace those of `folder` together, or not at all.

    Results of one run stand side by side, never those of two, as on a disk that is full.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".writing-") as name:
        yield Path(name)
        for path in sorted(Path(name).iterdir()):
            os.replace(path, folder / path.name)


def plain(value: Any) -> Any:
    """NumPy numbers as Python's, NaN and Inf as null: JSON knows neither; parts by their own."""
    if hasattr(value, "to_json"):
        return value.to_json()
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def plain_fields(
    result: Any, *more: str, leave_out: Sequence[str] = (), **keys: str
) -> dict[str, Any]:
    """The fields of a dataclass as JSON holds them.

    Parameters
    ----------
    more : other attributes, behind the fields.
    leave_out : fields.
    keys : attribute -> its key, where that is another.
    """
    own = [field.name for field in fields(result) if field.name not in leave_out]
    return {keys.get(name, name): plain(getattr(result, name)) for name in (*own, *more)}


def write_json(path: Path, content: dict[str, Any]) -> Path:
    """Write `content` as JSON, whole or not at all; returns the path."""
    return write_text(path, json.dumps(plain(content), indent=1, allow_nan=False) + "\n")


def refuse_existing(path: Path, *, force: bool = False) -> None:
    """Refuse a file that exists, unless it is to be written over.

    Raises
    ------
    DataError
        If it exists and `force` is not set.
    """
    if path.exists() and not force:
        raise DataError(f"{path} exists; name another file, or add force=True (--force)")


def output_folder(out: Path | None, default: str, *, force: bool = False) -> Path:
    """The folder to write to: `out`, or a new `reports/<default>-<n>`.

    An existing empty folder is accepted, a full one only with `force`.

    Raises
    ------
    DataError
        If `out` is a file, or holds files and `force` is not set.
    """
    if out is None:
        root = Path("reports")
        n = 1
        while True:
            folder = root / f"{default}-{n}"
            try:
                folder.mkdir(parents=True)
                return folder
            except FileExistsError:
                n += 1
            except OSError as error:
                raise DataError(
                    f"cannot make {folder}: {error.strerror}; name a folder with --out"
                ) from error
    if out.exists() and not out.is_dir():
        raise DataError(f"{out} is a file, not a folder; name a folder with --out")
    if out.is_dir() and any(out.iterdir()) and not force:
        raise DataError(f"{out} is not empty; name another folder with --out, or add --force")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(
            f"cannot make {out}: {error.strerror}; name another folder with --out"
        ) from error
    return out
