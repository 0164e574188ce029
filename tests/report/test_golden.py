"""Texts, pages and JSON of results stay as they are until they are changed on purpose.

After a change on purpose: `python -m tests.report.write_golden`, and read `git diff`.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.report.golden_results import FOLDER, golden_texts

GOLDEN = dict(golden_texts())


@pytest.mark.parametrize("name", GOLDEN)
def test_a_result_is_displayed_as_its_golden_file_has_it(name: str) -> None:
    make: Callable[[], str] = GOLDEN[name]
    assert make().splitlines() == (FOLDER / name).read_text(encoding="utf-8").splitlines()


def test_every_golden_file_is_compared() -> None:
    assert {path.name for path in FOLDER.iterdir()} == set(GOLDEN)
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 400_000
