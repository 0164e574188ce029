"""The shape of the code stays within its ceilings; `python -m tests.structure` lists entries."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests import structure

CASID = Path(__file__).resolve().parents[1] / "casid"

# What was reached on 2026-11-22. A change that needs more is a change that wants another structure.
CEILINGS = {
    # Of the diagnosis: its table of thresholds.
    f"files over {structure.LONG_FILE} lines": 1,
    f"functions over {structure.LONG} lines": 12,
    f"functions over {structure.TOO_LONG} lines": 0,
    f"functions with more than {structure.MANY_PARAMETERS} parameters": 0,
    f"dataclasses with more than {structure.MANY_FIELDS} fields": 1,  # `Problem`, a public door
    "cycles between packages": 0,
    "cycles between modules": 0,
}


@pytest.mark.parametrize("name", CEILINGS)
def test_the_code_stays_within_its_ceilings(name: str) -> None:
    entries = structure.MEASURES[name]()
    assert len(entries) <= CEILINGS[name], "\n".join(entries)


def test_the_imports_of_packages_have_floors() -> None:
    assert 0 < structure.floors(structure.between_packages()) <= 13


def test_an_equation_of_another_module_is_in_one_that_there_is() -> None:
    """`(1) in` a module that was renamed leads nowhere."""
    modules = {path.stem for path in CASID.rglob("*.py")}
    for path in CASID.rglob("*.py"):
        for name in re.findall(
            r"\(\d+\)\s+(?:in|of)\s+`([\w.]+)`", path.read_text(encoding="utf-8")
        ):
            assert name.rpartition(".")[2] in modules, f"{path.name}: {name}"


FOLDERS = sorted(path.parent for path in CASID.rglob("__init__.py"))


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda p: str(p.relative_to(CASID)))
def test_files_and_folders_of_a_folder_import_one_way(folder: Path) -> None:
    """A folder counts as one: what it holds is used by its neighbours, or uses them, not both."""
    assert structure.cycles(structure.within(folder)) == []


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda p: str(p.relative_to(CASID)))
def test_a_folder_lists_its_folders_in_the_order_of_their_imports(folder: Path) -> None:
    """Where its docstring lists them, as "- `name`: what it is"."""
    listed = re.findall(r"^- `(\w+)`: ", (folder / "__init__.py").read_text("utf-8"), re.M)
    folders = {path.parent.name for path in folder.glob("*/__init__.py")}
    assert not listed or set(listed) == folders
    graph = structure.within(folder)
    for k, name in enumerate(listed):
        assert graph[name] & set(listed) <= set(listed[:k]), name
