"""A disturbance beside which no parameter is known explains no misfit: any model would do."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from casid.diagnosis.verdict import judgement


@pytest.mark.parametrize("known", [True, False])
def test_a_disturbance_explains_a_doubtful_fit_where_a_parameter_is_known_beside_it(
    known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(judgement, "none_is_known", lambda at, std_error: not known)
    start = SimpleNamespace(why_undecided="", why_doubtful="the error is 80 times the noise")
    found: Any = SimpleNamespace(baseline=start, at=SimpleNamespace(fit=None))
    one: Any = [SimpleNamespace(where="heave")]
    why = judgement._why_undecided(found, "", None, one)
    assert why == ("" if known else start.why_doubtful)
    assert judgement._why_undecided(found, "", None, []) == start.why_doubtful


@pytest.mark.parametrize("bounds", [{}, {"K": "K at its upper bound"}])
def test_bounds_that_hold_the_fit_are_the_reason_of_a_large_error(
    bounds: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """At its bounds a fit leaves a large error and no standard errors: that follows from them."""
    monkeypatch.setattr(judgement, "_bounds_beyond_chance", lambda problem, fit, under: bounds)
    monkeypatch.setattr(judgement, "still_inputs", lambda criterion: "")
    start = SimpleNamespace(why_undecided="", why_doubtful="no parameter is known")
    fit = SimpleNamespace(criterion=None)
    at = SimpleNamespace(fit=fit, noise_absorbs_misfit=False)
    found: Any = SimpleNamespace(baseline=start, at=at, best_fit=fit, base_fit=fit)
    why, held = judgement._undecided(SimpleNamespace(), found, None, "", [])
    assert held == bounds
    assert why == ("the fit holds K at its upper bound" if bounds else start.why_doubtful)
    # What the record says of itself comes first.
    start.why_undecided = "nothing excites the system"
    assert judgement._undecided(SimpleNamespace(), found, None, "", []) == (start.why_undecided, {})
