"""A public attribute that was renamed keeps its old name for one release, with a warning."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from casid.deprecation import renamed

CASID = Path(__file__).resolve().parents[1] / "casid"


def test_an_old_name_gives_the_new_attribute_and_warns():
    class Result:
        remedy = "fix a parameter"
        mend = renamed("mend", "remedy")

    with pytest.warns(DeprecationWarning, match="Result.mend is called remedy now"):
        assert Result().mend == "fix a parameter"


@pytest.mark.slow
def test_every_old_name_leads_to_an_attribute_of_its_class():
    found = []
    for path in sorted(CASID.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                names = {n.target.id for n in node.body if isinstance(n, ast.AnnAssign)}
                names |= {n.name for n in node.body if isinstance(n, ast.FunctionDef)}
                for n in node.body:
                    if isinstance(n, ast.Assign) and isinstance(n.value, ast.Call):
                        if getattr(n.value.func, "id", "") == "renamed":
                            old, new = (a.value for a in n.value.args)
                            assert n.targets[0].id == old, f"{path}: {node.name}.{old}"
                            assert new in names, f"{path}: {node.name}.{old} -> {new}"
                            found.append(f"{node.name}.{old}")
    assert {"Assessment.mends", "Solution.mend", "Invariants.told"} <= set(found)
