"""Where a record is: a path, perhaps with a window of time and a load case."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np

from casid.errors import DataError


def parse_source(text: str) -> tuple[Path, tuple[float, float] | None]:
    """Split `run.csv@12:194` into the path and the window [s]; open ends are infinite.

    Raises
    ------
    DataError
        If the window is not two numbers in order, or the path is empty.
    """
    head, at, tail = text.rpartition("@")
    if not at or (":" not in tail and not re.fullmatch(r"[\d.]+", tail)):
        head, tail = text, ""
    if not head.strip():
        raise DataError(
            f"data source {text!r} names no file. Write it as run.csv or run.csv@12:194."
        )
    return Path(head), (parse_window(tail) if tail else None)


def parse_window(text: str) -> tuple[float, float]:
    """Read a window `12:194`, `12:` or `:194` in seconds of the record's own clock.

    Raises
    ------
    DataError
        If it is not two numbers in order.
    """
    start, colon, stop = text.partition(":")
    try:
        if not colon:
            raise ValueError
        window = (
            float(start) if start.strip() else -np.inf,
            float(stop) if stop.strip() else np.inf,
        )
    except ValueError:
        raise DataError(
            f"window {text!r} is not two numbers of seconds. Write it as 12:194, or 12: and :194 "
            "with one end open."
        ) from None
    if not window[0] < window[1]:
        raise DataError(
            f"window {text!r} is empty or backward. Give the earlier time first, as in 12:194."
        )
    return window


def parse_case(text: str) -> tuple[str | None, Path, tuple[float, float] | None]:
    """Split `nominal=a.csv@12:194` into load case, path and window; the case is None without one.

    Raises
    ------
    DataError
        As `parse_source`, or if the case has no name.
    """
    case, equals, rest = text.partition("=")
    if (
        not equals
        or "/" in case
        or "\\" in case
        or (not Path(rest).exists() and Path(text).exists())
    ):
        return (None, *parse_source(text))
    if not case.strip():
        raise DataError(
            f"data source {text!r} has an empty load case. Write it as nominal=run.csv."
        )
    return (case.strip(), *parse_source(rest))


def source_of(path: str | Path) -> tuple[Path, tuple[float, float] | None]:
    """The path, and the window [s] behind it; a file whose own name holds an @ has none."""
    if Path(path).exists():
        return Path(path), None
    return parse_source(str(path))


def sha256(path: str | Path) -> str:
    """Return the sha256 of a file's bytes, in hexadecimal."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
