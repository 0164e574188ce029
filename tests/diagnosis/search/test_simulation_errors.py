"""An extension is adopted only if it lowers every error, whatever its likelihood says."""

from __future__ import annotations

import numpy as np
import pytest

from casid.diagnosis.search.simulation_errors import SimulationErrors, why_not_adopted

N = 400
RNG = np.random.default_rng(3)
NOISE = RNG.standard_normal((3, N, 1))
SWING = np.sin(0.1 * np.arange(N))[:, None]


def errors(fitted: float, continued: float, restarted: float) -> SimulationErrors:
    """The same noise in every model, and a swing of the sizes given that a model leaves."""
    sizes = (fitted, continued, restarted)
    return SimulationErrors(*(e + size * SWING for e, size in zip(NOISE, sizes, strict=True)))


BEFORE = errors(1.0, 1.0, 1.0)


def test_an_extension_that_lowers_all_three_errors_is_adopted():
    assert why_not_adopted(BEFORE, errors(0.1, 0.1, 0.1)) == ""


@pytest.mark.parametrize(
    ("after", "why"),
    [
        ((1.1, 0.1, 0.1), "does not lower the error of the fitted part"),
        ((0.1, 1.3, 0.1), "makes the held-out error worse"),
        ((0.1, 0.1, 1.3), "from an initial state of its own"),
    ],
)
@pytest.mark.parametrize("is_alarm", [False, True])
def test_one_error_that_grows_refuses_it_whatever_the_others_gain(after, why, is_alarm):
    assert why in why_not_adopted(BEFORE, errors(*after), is_alarm=is_alarm)


def test_a_gain_that_may_be_chance_is_enough_for_an_effect_that_is_significant_by_itself():
    """A swing of 0.02 beside noise of 1, at right angles to it: it adds 0.08 +- 0.56 to 400."""
    noise = NOISE[0]
    swing = SWING - noise * float(np.sum(noise * SWING) / np.sum(noise**2))
    before = SimulationErrors(*(noise + 0.02 * swing,) * 3)
    after = SimulationErrors(noise, noise, noise)
    assert "may be chance" in why_not_adopted(before, after)
    assert why_not_adopted(before, after, is_alarm=True) == ""


def test_a_cause_on_the_clock_is_not_judged_by_a_simulation_that_starts_anew():
    after = errors(0.1, 0.1, 1.3)
    assert why_not_adopted(BEFORE, after, is_on_the_clock=True) == ""


def test_a_simulation_that_diverges_is_refused():
    wild = SimulationErrors(*(np.full((N, 1), np.inf) for _ in range(3)))
    assert "diverges" in why_not_adopted(BEFORE, wild)


def test_where_nothing_was_held_out_the_fitted_error_decides():
    none = np.zeros((0, 1))
    before, after = (SimulationErrors(NOISE[0] + size * SWING, none, none) for size in (1.0, 0.1))
    assert why_not_adopted(before, after) == ""
    assert "fitted part" in why_not_adopted(after, before)
