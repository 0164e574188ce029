"""Files that are there whole or not at all, whatever kills the process."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO


def write_bytes(path: Path, content: bytes) -> Path:
    """Write `content` beside `path` and move it there in one step; returns the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        file.write(content)
    return path


@contextmanager
def replacing(path: Path, *, is_synced: bool = False) -> Iterator[IO[bytes]]:
    """A file open for writing beside `path`, moved there in one step once it is written.

    Parameters
    ----------
    is_synced : wait for the disk before the file is moved.

    Raises
    ------
    OSError
        If the disk refuses; nothing is left then, and what was at `path` stays.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            yield file
            if is_synced:
                file.flush()
                os.fsync(file.fileno())
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
