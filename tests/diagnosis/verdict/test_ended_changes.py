"""A change that what was held out refuses may be over there; one refused otherwise says nothing."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from casid.diagnosis.search.refusals import RANDOM, SUPERFLUOUS, Refusal
from casid.diagnosis.verdict import ended_changes
from casid.diagnosis.verdict.ended_changes import may_be_over
from casid.estimation.simulation.fit import FitSettings


@pytest.mark.parametrize(
    ("why", "is_doubted"),
    [
        (Refusal("it makes the held-out error worse", "held-out"), True),
        (Refusal("its simulation diverges there", "held-out"), True),
        (Refusal("it does not lower the error", "fitted"), False),
        (Refusal("no time was left to fit its held-out error"), False),
        (SUPERFLUOUS, False),
        (RANDOM, False),
    ],
)
def test_a_change_is_fitted_to_its_end_only_where_the_held_out_error_refused_it(
    monkeypatch: pytest.MonkeyPatch, why: Refusal, is_doubted: bool
) -> None:
    """Whatever words the refusal has."""
    monkeypatch.setattr(ended_changes, "_explains_all", lambda *_: True)
    change = SimpleNamespace(effect=SimpleNamespace(sets_in=True), gain=9.0)
    found = SimpleNamespace(
        baseline=SimpleNamespace(why_undecided="", split=SimpleNamespace(is_empty=False)),
        search=SimpleNamespace(
            refused=[(change, why.beside("an offset"))],
            attempts=SimpleNamespace(attempt=lambda _, tried: tried()),
        ),
    )
    assert may_be_over(found, FitSettings()) is is_doubted
