"""A channel of two or three levels is held by its nature: nothing is band-limited in it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.diagnosis.search.rounds import smooths_a_switch
from casid.model.effects.channels.channel_effects import hold


@pytest.mark.parametrize(
    ("toward", "levels", "is_left_out"),
    [
        ("bandlimited", 2, True),
        ("bandlimited", 3, True),
        ("bandlimited", 40, False),
        ("foh", 2, False),
    ],
)
def test_an_input_of_few_levels_is_not_sought_to_be_smooth(toward, levels, is_left_out):
    m = casid.Model("body")
    flag, T = m.input("active", "1", hold="zoh", known=True), m.state("T", "K")
    m.derivative(T, m.parameter("a", "K/s", start=1.0) * flag)
    m.output("temperature", T, "K")
    column = np.random.default_rng(1).integers(0, levels, 300) / (levels - 1)
    data = [SimpleNamespace(u=column[:, None])]
    at = SimpleNamespace(model=m, criterion=SimpleNamespace(data=data))
    assert smooths_a_switch(at, hold(m, "active", toward)) is is_left_out
