"""How well instants of changes are known, and where the whole records have them."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.attempts import Attempts
from casid.diagnosis.search.candidates import Adopted, Candidate
from casid.diagnosis.search.instant_errors import moved_in_time, with_instant_errors
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.parameter_effects import parameter_jump
from tests.diagnosis.search.test_temporary_changes import BEGIN, END, NOISE, TS, leak, record

HALF = 0.5 * TS  # a held step sets in that much before the first sample of which it is all


def fitted(begin: float, end: float) -> tuple[Adopted, Fit]:
    """The leak that is larger for a while, between two instants."""
    model = leak().model
    effect = parameter_jump(model, "k", begin, end)
    extended, names = effect.extended(model, starts={"jump_k": 0.3})
    data = [casid.Experiment(record(leaks=0.3), {}, "run")]
    weights = np.array([1 / NOISE])
    fit = fit_model(
        extended, data, FitSettings(starts=1), weights=weights, check_rank=False, throw=False
    )
    return Adopted(Candidate(effect, names, extended, fit, 0.0, 0.0, 9.0), 0.0, ()), fit


@pytest.fixture(scope="module")
def best() -> tuple[Adopted, Fit]:
    return fitted(BEGIN - HALF, END - HALF)


def test_an_instant_is_as_uncertain_as_its_profile_says(best: tuple[Adopted, Fit]):
    """Later by a quarter of a sample, all else fitted again: S rises by (t / sd)^2, both ways.

    The mean of both sides is without the slope that the noise of one record gives.
    """
    cause, fit = best
    (known,) = with_instant_errors(Attempts(), [cause], fit)
    later = 0.25 * TS
    for i, error in enumerate(known.instant_errors):
        sides = []
        for side in (later, -later):
            instants = [BEGIN - HALF, END - HALF]
            instants[i] += side
            sides.append(fitted(*instants)[1].solution.value)
        alone = later / np.sqrt(2 * (np.mean(sides) - fit.solution.value))
        # Beside the other instant it is known less well, by what they have in common.
        assert 0.9 * alone <= error <= 1.3 * alone


def test_the_sizes_move_with_the_instants(best: tuple[Adopted, Fit]):
    cause, fit = best
    (known,) = with_instant_errors(Attempts(), [cause], fit)
    other = fitted(BEGIN - HALF + 0.5 * TS, END - HALF)[1]
    assert len(known.shifts) == 2
    added = np.hypot(*(shift["jump_k"] for shift in known.shifts))
    per_second = (other.values["jump_k"] - fit.values["jump_k"]) / (0.5 * TS)
    # One of the two instants gives at least its own part.
    assert added > 0.5 * abs(per_second) * known.instant_errors[0]


def test_instants_move_to_where_the_records_have_them():
    """From two and from three samples away, in one step for all but what is not linear."""
    cause, fit = fitted(BEGIN - HALF + 0.2, END - HALF - 0.3)
    (moved,) = moved_in_time(leak().model, [cause], fit) or ()
    (known,) = with_instant_errors(Attempts(), [cause], fit)
    for now, true, error in zip(
        (moved.effect.variant, moved.effect.end),
        (BEGIN - HALF, END - HALF),
        known.instant_errors,
        strict=True,
    ):
        assert now == pytest.approx(true, abs=4 * error + 0.05)


def test_what_sets_in_at_no_instant_stays_as_it_is(best: tuple[Adopted, Fit]):
    _, fit = best
    assert moved_in_time(leak().model, [], fit) is None
    assert with_instant_errors(Attempts(), [], fit) == ()
