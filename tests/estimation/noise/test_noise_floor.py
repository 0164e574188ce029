"""The white noise of a channel by its own spectrum, whatever the signal beside it."""

from __future__ import annotations

import numpy as np
import pytest

from casid.estimation.noise.noise_floor import white_floor

N, SD = 4000, 0.05


def stepping(every: int, rng: np.random.Generator) -> np.ndarray:
    """A signal that steps every so many samples on average, each time by many times the noise."""
    steps = rng.random(N) < 1 / every
    return np.cumsum(np.where(steps, rng.choice([-2.0, -1.0, 1.0, 2.0], N), 0.0))


# Of third differences the median has 1.24 times the scatter of independent ones' (their
# correlation), 1.67 / sqrt(N). What is left of the steps is far below the share of all
# differences that have one in them.
@pytest.mark.parametrize(("every", "left"), [(10**9, 0.0), (50, 0.015), (20, 0.03)])
def test_the_floor_of_a_signal_that_steps_is_that_of_its_noise(every: int, left: float) -> None:
    found = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        found.append(white_floor([stepping(every, rng) + SD * rng.standard_normal(N)]))
    error = np.std(found, ddof=1) / SD / np.sqrt(10)
    assert error < 0.012
    assert np.mean(found) / SD == pytest.approx(1.0, abs=3 * error + left)
