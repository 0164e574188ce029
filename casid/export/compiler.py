"""The C compiler of this machine."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from casid.errors import DataError


def compiler() -> str | None:
    """The path of a C compiler: that of the variable CC, or cc, gcc or clang; None without one."""
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        found = shutil.which(name) if name else None
        if found is not None:
            return found
    return None


def shared_library(sources: Sequence[Path], library: Path) -> Path:
    """Compile C files into one shared library.

    Raises
    ------
    DataError
        If there is no compiler, or it refuses the files.
    """
    cc = compiler()
    if cc is None:
        raise DataError(
            "an FMU holds a compiled library, and no C compiler is found here; install gcc or "
            "clang, or name one in the variable CC. The other exports need none"
        )
    flags = ["-O2", "-std=c99", "-shared"]
    if sys.platform != "win32":
        flags += ["-fPIC", "-fvisibility=hidden"]
    call = [cc, *flags, "-o", str(library), *map(str, sources), "-lm"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise DataError(f"{cc} does not compile the model: {done.stderr.strip()[:500]}")
    return library
