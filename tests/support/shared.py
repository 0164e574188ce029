"""Where the shared measurements lie; tests that need them are skipped where they are absent."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def shared(path: str = "") -> Path:
    """Return a path inside the shared folder (CASID_SHARED, default ../shared), or skip."""
    folder = Path(os.environ.get("CASID_SHARED", ROOT.parent / "shared"))
    if not (folder / path).exists():
        pytest.skip(f"{path or 'the shared folder'} is absent; set CASID_SHARED to its folder")
    return folder / path
