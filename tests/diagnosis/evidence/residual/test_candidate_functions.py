"""Functions on which what is missing may depend are those that many samples show."""

from __future__ import annotations

import numpy as np
import pytest

from casid.diagnosis.evidence.residual.candidate_functions import functions_of
from casid.diagnosis.thresholds import RESIDUAL


def sign_of(values: np.ndarray) -> np.ndarray:
    (group,) = [g for name, g in functions_of(["v"], []) if name == "sign(v)"]
    return group.columns({"v": values})[:, 0]


@pytest.mark.parametrize("most", [1.0, -1.0])
def test_a_sign_that_few_samples_do_not_have_is_constant(most: float):
    """Three neighbouring samples of 840 that are negative say nothing about a dependence."""
    values = np.full(840, most)
    values[540:543] = -most
    assert np.all(sign_of(values) == most)


def test_a_sign_that_changes_in_earnest_is_as_it_is():
    values = np.ones(840)
    values[: int(1.2 * RESIDUAL.rare * 840)] = -1.0
    assert np.array_equal(sign_of(values), values)
    swing = np.sin(np.arange(840) / 7)
    assert np.array_equal(sign_of(swing), np.sign(swing))
