"""Diagnosis, search for effects and errors in variables decide by the numbers of a table each.

Every number has its meaning, its source, and the test or study that pins it.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib.util
from collections.abc import Iterator
from pathlib import Path

import pytest

from casid.diagnosis import thresholds
from casid.estimation.intervals import thresholds as interval_thresholds
from casid.estimation.noise import thresholds as input_noise_thresholds
from casid.estimation.simulation import thresholds as simulation_thresholds
from casid.experiment_design import thresholds as design_thresholds
from casid.fleets import thresholds as fleet_thresholds
from casid.model.effects import search_ranges
from tests.structure import tree

CASID = Path(__file__).resolve().parents[1] / "casid"
TABLES = {
    "diagnosis": thresholds,
    "model/effects": search_ranges,
    "estimation/simulation": simulation_thresholds,
    "estimation/errors_in_variables": input_noise_thresholds,
    "estimation/intervals": interval_thresholds,
    "experiment_design": design_thresholds,
    "fleets": fleet_thresholds,
}
GROUPS = [
    (name, value)
    for table in TABLES.values()
    for name, value in vars(table).items()
    if dataclasses.is_dataclass(value) and not isinstance(value, type)
]
ENTRIES = [(f"{name}.{f.name}", f.metadata) for name, g in GROUPS for f in dataclasses.fields(g)]
FILES = [
    p
    for room, table in TABLES.items()
    for p in sorted((CASID / room).rglob("*.py"))
    if p.name != Path(table.__file__).name
    # Beside numerical methods with numbers of their own: the files that take theirs from the table.
    and (room != "estimation/simulation" or f"{room}.thresholds".replace("/", ".") in p.read_text())
]
FILES += [
    p
    for room in ("estimation", "estimation/noise", "estimation/disturbances", "identification")
    for p in sorted((CASID / room).glob("*.py"))
    if ".thresholds import" in p.read_text()
]

# Numbers that decide nothing: they are compared with what they are by definition.
PLAIN = {0, 1, -1, 0.5, 2}
REGULAR = 1e-6  # and smaller: keeps divisions and decompositions regular

# file, number -> why it stands in a comparison there.
ALLOWED = {
    ("diagnosis/advice/next_experiment.py", 120): "seconds that are printed as minutes",
    ("diagnosis/calibration/false_alarm_rate.py", 90): "seconds that are printed as minutes",
    ("diagnosis/evidence/recording_faults/spikes.py", 3): "a sample with both its neighbours",
    ("estimation/simulation/record_agreement.py", 4): "records that a sentence names",
}


def numbers_in(node: ast.AST) -> Iterator[float]:
    for part in ast.walk(node):
        if isinstance(part, ast.Constant) and type(part.value) in (int, float):
            yield part.value


def in_room(path: Path) -> str:
    return str(path.relative_to(CASID))


def test_every_threshold_has_a_meaning_a_source_and_a_proof_that_exists():
    for name, entry in ENTRIES:
        assert len(entry["meaning"]) > 10, name
        assert entry["source"], name
        if entry["pinned_by"].startswith("analysis."):
            assert importlib.util.find_spec(entry["pinned_by"]) is not None, name
        else:
            assert (CASID.parent / entry["pinned_by"]).is_file(), name


def test_the_tables_are_frozen():
    for _, group in GROUPS:
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(group, dataclasses.fields(group)[0].name, 0)


def test_every_threshold_is_used():
    used = {
        f"{node.value.id}.{node.attr}"
        for path in FILES
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
    }
    unused = {name for name, _ in ENTRIES} - used
    assert not unused


def upper_case_values(path: Path) -> Iterator[tuple[str, ast.AST]]:
    """The constants that a module assigns: name and value."""
    for node in tree(path).body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
        for target in targets:
            if isinstance(target, ast.Name) and target.id.lstrip("_").isupper():
                yield target.id, getattr(node, "value", None)


def test_no_module_has_a_numeric_constant_of_its_own():
    for path in FILES:
        for name, value in upper_case_values(path):
            # Options of a solver are handed on, not compared; a dictionary is words.
            if not isinstance(value, ast.Call | ast.Dict):
                found = [number for number in numbers_in(value) if abs(number) > REGULAR]
                assert not found, f"{name} of {in_room(path)}: to the table"


def test_no_comparison_decides_by_a_bare_number():
    for path in FILES:
        found = {
            number
            for node in ast.walk(tree(path))
            if isinstance(node, ast.Compare)
            for number in numbers_in(node)
            if number not in PLAIN and abs(number) > REGULAR
        }
        allowed = {number for name, number in ALLOWED if name == in_room(path)}
        assert found <= allowed, in_room(path)


def test_every_exception_is_still_needed():
    for name, number in ALLOWED:
        assert number in set(numbers_in(tree(CASID / name)))
