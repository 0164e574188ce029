"""Where the shared reference data lie: `CASID_SHARED`, default ../shared from the checkout."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def shared(path: str) -> Path:
    """Path of a shared file or folder; the calling test is skipped where it is absent."""
    found = Path(os.environ.get("CASID_SHARED", ROOT / ".." / "shared")) / path
    if not found.exists():
        pytest.skip(f"{found} is absent; set CASID_SHARED to the folder of shared data")
    return found
