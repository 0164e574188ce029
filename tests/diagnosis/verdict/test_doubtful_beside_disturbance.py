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
