"""What the page of a fleet says first: causes that last, those found once, those that have gone."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from casid.fleets.findings import findings_of
from casid.report.pages.fleet_page import fleet_banner
from tests.fleets.test_findings import BIAS, OFFSET, outcome


def fleet(*shown: set[int], records: int = 8) -> SimpleNamespace:
    """An asset per set of the numbers of records that show an offset."""
    found = findings_of(
        {
            f"ship {k}": [outcome(i, *([OFFSET] if i in numbers else [])) for i in range(records)]
            for k, numbers in enumerate(shown)
        }
    )
    assets = tuple(f"ship {k}" for k in range(len(shown)))
    return SimpleNamespace(findings=found, assets=assets, laws={})


@pytest.mark.parametrize(
    ("shown", "word", "look", "said"),
    [
        ([{4, 5, 6, 7}, set()], "1 of 2 assets", "deficient", "still there"),
        ([{7}], "not confirmed", "undecided", "further records of the asset decide"),
        ([{1, 2, 3}], "nothing that lasts", "undecided", "do not show it any more"),
        ([set()], "nothing found", "adequate", "No record is deficient"),
    ],
)
def test_a_cause_of_the_last_record_is_not_said_to_have_gone(shown, word, look, said) -> None:
    banner = fleet_banner(fleet(*shown))
    assert (banner.word, banner.look) == (word, look)
    assert said in banner.sentence


def test_a_cause_is_called_by_the_words_of_the_fleet() -> None:
    """Of a balance of voltages they are no dry friction."""
    found = fleet({4, 5, 6, 7})
    found.laws = {OFFSET: "a constant voltage"}
    said = "the strongest is constant voltage in the torque balance of ship 0"
    assert said in fleet_banner(found).sentence


def test_two_causes_of_a_single_record_are_found_once() -> None:
    """The first fleet that a user makes: one record."""
    found = findings_of({"ship": [outcome(0, OFFSET, BIAS)]})
    banner = fleet_banner(SimpleNamespace(findings=found, assets=("ship",), laws={}))
    assert banner.sentence.startswith("2 causes appear in a single record")
