"""The examples in docstrings: each runs alone, as a reader pastes it, and prints what it says."""

from __future__ import annotations

import doctest
import importlib

import pytest

from tests.structure import ROOT, module

WITH_EXAMPLES = [
    path
    for path in sorted((ROOT / "casid").rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("path", WITH_EXAMPLES, ids=module)
def test_the_examples_of_a_module_run_with_nothing_but_their_own_imports(path):
    found = doctest.DocTestFinder().find(importlib.import_module(module(path)), globs={})
    examples = [example for example in found if example.examples]
    assert examples, "the examples are in no docstring of a function or class"
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    for example in examples:
        report: list[str] = []
        runner.run(example, out=report.append)
        assert not report, "".join(report)
