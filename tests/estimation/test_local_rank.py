"""The local rank is that of the sensitivities, whatever their units."""

from __future__ import annotations

import numpy as np
import pytest

from casid.errors import SolveError
from casid.estimation.local_rank import LocalRank, describe_null, local_rank

NAMES = ("a", "b", "c")
SENSITIVITIES = np.random.default_rng(2).standard_normal((50, 3))


def rank(scale: float, sensitivities: np.ndarray) -> int:
    columns = scale * sensitivities
    return local_rank(columns.T @ columns, np.ones(3), NAMES, np.ones(3)).rank


@pytest.mark.parametrize("scale", [1e-100, 1.0, 1e152])
def test_units_that_nearly_overflow_change_no_rank(scale):
    assert rank(scale, SENSITIVITIES) == 3
    assert rank(scale, SENSITIVITIES[:, [0, 1, 1]]) == 2


def test_sensitivities_that_overflow_are_refused_with_a_remedy():
    with pytest.raises(SolveError, match="sensitivities are not finite.*shorten the window"):
        local_rank(np.full((3, 3), np.inf), np.ones(3), NAMES, np.ones(3))


def test_a_power_product_with_an_exponent_of_no_law_is_not_printed() -> None:
    """0.0141 : 1 is 283/4 within a thousandth, which tells nobody anything."""
    rank = LocalRank(3, 4, 0.0, ({"th": 1.0, "w": 4 / 283},))
    assert "283" not in describe_null(rank)
    assert "instead" not in describe_null(rank)
    assert "a/b^(3/2)" in describe_null(LocalRank(1, 2, 0.0, ({"a": 1.0, "b": 2 / 3},)))
