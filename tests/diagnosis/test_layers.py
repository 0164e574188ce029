"""Imports inside the diagnosis follow the path of the data: evidence, search, verdict, advice."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOM = Path(__file__).resolve().parents[2] / "casid" / "diagnosis"

# Who may import whom inside casid.diagnosis; from low to high.
LAYERS = """
thresholds:
attempts:
solvers: thresholds
settings: thresholds solvers
evidence: thresholds attempts solvers settings
unexplained: thresholds evidence
search: thresholds attempts solvers settings evidence
verdict: thresholds attempts settings evidence unexplained search
advice: thresholds settings evidence search verdict
calibration: thresholds evidence verdict
diagnosis: evidence unexplained verdict advice calibration
facts: verdict diagnosis
diagnose: thresholds settings evidence search verdict advice calibration diagnosis
investigation: diagnosis diagnose
named_causes: diagnose
"""

FILES = sorted(p for p in ROOM.rglob("*.py") if p.name != "__init__.py")


def allowed() -> dict[str, set[str]]:
    rows = (line.partition(":") for line in LAYERS.strip().splitlines())
    return {name: {name, *below.split()} for name, _, below in rows}


def floor_of(path: Path) -> str:
    return path.relative_to(ROOM).parts[0].removesuffix(".py")


def imported(path: Path) -> Iterator[str]:
    """Floors that a file imports from, at any place in it, for the type checker included."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("casid.diagnosis."):
            yield str(node.module).split(".")[2]
        elif isinstance(node, ast.Import):
            names = [name.name for name in node.names]
            assert not any(name.startswith("casid.diagnosis") for name in names), path


def test_the_table_goes_from_low_to_high_and_names_every_floor():
    seen: set[str] = set()
    for name, below in allowed().items():
        assert below - {name} <= seen, name
        seen.add(name)
    assert seen == {floor_of(path) for path in FILES}


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOM)))
def test_no_file_imports_from_a_floor_above(path):
    assert set(imported(path)) <= allowed()[floor_of(path)]
