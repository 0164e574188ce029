"""Versions of the software that a result was computed with."""

from __future__ import annotations

import importlib.metadata
import platform

import numpy as np


def versions() -> dict[str, str]:
    """Versions of what computed a result."""
    try:
        own = importlib.metadata.version("casid")
    except importlib.metadata.PackageNotFoundError:
        own = "not installed"
    return {
        "casid": own,
        "python": platform.python_version(),
        "casadi": importlib.metadata.version("casadi"),
        "numpy": str(np.__version__),
    }
