"""The C compiler of this machine, where it has one."""

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


def shared_library(sources: Sequence[Path], library: Path, *flags: str) -> Path:
    """Compile C files into one shared library; `flags` come after the optimisation's and matter.

    Raises
    ------
    DataError
        If there is no compiler, or it refuses the files.
    """
    cc = compiler()
    if cc is None:
        raise DataError(
            "no C compiler is found here; install gcc or clang, or name one in the variable CC"
        )
    options = ["-O2", "-std=c99", "-shared", *flags]
    if sys.platform != "win32":
        options += ["-fPIC", "-fvisibility=hidden"]
    call = [cc, *options, "-o", str(library), *map(str, sources), "-lm"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise DataError(f"{cc} does not compile the model: {done.stderr.strip()[:500]}")
    return library
