"""The examples of CONTRIBUTING.md run, and the files that the house's pages name exist."""

from __future__ import annotations

import re
from typing import Any

import pytest

import casid
from tests.support.shared import ROOT

PAGES = ("CONTRIBUTING.md", "docs/architecture.md")


def blocks() -> list[dict[str, Any]]:
    """The namespaces that the Python blocks leave."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    spaces: list[dict[str, Any]] = []
    for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        spaces.append({})
        exec(compile(code, "CONTRIBUTING.md", "exec"), spaces[-1])
    return spaces


def test_the_smallest_problem_is_identified() -> None:
    """c = 1.2e-3 m^2.5/s; 1200 samples of 1 mm noise give it to a few tenths of a per cent."""
    problem, _ = blocks()
    estimate = casid.identify(problem["problem"])
    c = estimate.parameter("c")
    assert c.std_error is not None
    assert abs(c.value - 1.2e-3) < 4 * c.std_error
    assert c.std_error < 0.01 * c.value


def test_the_example_of_an_effect_extends_a_model_and_is_null_by_default() -> None:
    problem, effect = blocks()
    model = casid.load_problem(ROOT / "problems" / "roll_decay.py").model
    extended, (name,) = effect["quartic_damping"](model, "torque").extended(model)
    assert extended.parameters[name].start == 0.0
    assert extended.parameters[name].unit


@pytest.mark.parametrize("page", PAGES)
def test_named_files_exist(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    prefix = r"(?:casid|tests|problems|analysis|docs|\.ci)"
    named = set(re.findall(rf"`({prefix}/[\w./-]+)`", text))
    named -= {"problems/tank.py"}  # written by the reader
    assert named
    assert not [path for path in named if not (ROOT / path).exists()]


def test_every_public_name_has_one_place_in_the_reference() -> None:
    text = "".join(p.read_text("utf-8") for p in (ROOT / "docs/reference").glob("*.md"))
    named = re.findall(r":: casid\.(\w+)$", text, re.MULTILINE)
    assert sorted(named) == sorted(casid.__all__)
