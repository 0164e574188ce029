"""What is said of a residual follows from the counts, and what was saved in words comes back."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from casid.estimation.whiteness import Whiteness, measured_whiteness

WHITE = np.random.default_rng(3).standard_normal(400)
COLOURED = lfilter([1.0], [1.0, -0.9], WHITE)


@pytest.mark.parametrize("coloured", ["incomplete", "allowed for", ""])
def test_a_coloured_residual_means_what_the_method_says_it_does(coloured) -> None:
    """An autoregression with its pole at 0.9 has 0.9^k at lag k, above 0.1 in 20 lags."""
    found = measured_whiteness(COLOURED, "whiteness", coloured)
    assert found.is_coloured
    assert found.meaning == coloured


@pytest.mark.parametrize(("samples", "meaning"), [(16, "too few"), (400, "")])
def test_a_residual_that_is_not_coloured_tells_nothing_by_few_samples(samples, meaning) -> None:
    found = measured_whiteness(WHITE[:samples], "whiteness", "incomplete")
    assert (found.is_coloured, found.meaning) == (False, meaning)
    assert found.lags == min(20, samples - 2)


@pytest.mark.parametrize(
    "test",
    [
        Whiteness(20, 20),
        Whiteness(17, 20, "whiteness of innovations", "incomplete"),
        Whiteness(5, 20, "filtered equation error", "allowed for"),
        Whiteness(0, 14, meaning="too few"),
    ],
)
def test_a_test_that_was_saved_in_words_comes_back(test: Whiteness) -> None:
    assert Whiteness.of_sentence(str(test)) == test
