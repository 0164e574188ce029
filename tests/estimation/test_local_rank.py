"""The local rank is that of the sensitivities, whatever their units."""

from __future__ import annotations

import numpy as np
import pytest

from casid.errors import SolveError
from casid.estimation.local_rank import local_rank

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
