"""A command is held or switched; a reading of a sensor is neither, however coarse."""

from __future__ import annotations

import numpy as np
import pytest

from casid.data.held_signals import is_held, is_switched

RNG = np.random.default_rng(4)
BLOCKS = np.repeat(RNG.normal(size=30), 20)
SWITCH = np.repeat(RNG.integers(0, 2, 40), 3).astype(float)
SMOOTH = np.sin(0.05 * np.arange(600))


@pytest.mark.parametrize(
    ("values", "held", "switched"),
    [
        pytest.param(BLOCKS, True, False, id="a command in blocks"),
        pytest.param(SWITCH, True, True, id="a switch"),
        pytest.param(SWITCH[::3], False, True, id="a switch with a sample for each interval"),
        pytest.param(SMOOTH, False, False, id="a smooth signal"),
        pytest.param(np.round(SMOOTH, 1), False, False, id="a smooth signal of twenty levels"),
        pytest.param(BLOCKS + 0.01 * RNG.normal(size=600), False, False, id="noise on blocks"),
        pytest.param(np.ones(100), False, False, id="a constant"),
    ],
)
def test_what_moves_in_steps_is_held_or_switched(values, held, switched):
    assert (is_held(values), is_switched(values)) == (held, switched)
