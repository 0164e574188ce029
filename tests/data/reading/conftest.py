"""Files of text, written where a test may."""

from __future__ import annotations

import pytest


@pytest.fixture
def csv(tmp_path):
    def write(text: str, name: str = "run.csv", encoding: str = "utf-8"):
        path = tmp_path / name
        path.write_bytes(text.encode(encoding))
        return path

    return write
