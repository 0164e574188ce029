"""With every cause in the model gains are likelihoods: the likelier of two takes the name."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from casid.diagnosis.search.adoption.promotion import likelier_rival
from casid.diagnosis.search.adoption.reconsideration import cause_as_it_is
from casid.diagnosis.search.candidates import Adopted, Candidate, Rival, is_needed
from casid.diagnosis.search.comparison.alternatives import rivals_of
from casid.diagnosis.thresholds import COMPARISON
from casid.model.effects.balances.balance_effects import (
    coulomb_friction,
    cubic_damping,
    extra_input,
    quadratic_damping,
)
from casid.model.effects.channels.channel_effects import sensor_lag
from tests.diagnosis.search.comparison.test_alternatives import JUMP, MODEL, judged

CUBIC, SQUARE = cubic_damping(MODEL, "torque"), quadratic_damping(MODEL, "torque")
UNNAMED = replace(CUBIC, kind="unknown")
CLEARLY, HARDLY = 100.0 + COMPARISON.strong + 1.0, 100.0 + COMPARISON.strong - 1.0


def adopted(*rivals: Candidate) -> Adopted:
    return Adopted(judged(CUBIC, 100.0, 0.0), 1e-9, tuple(Rival(c, 0.5) for c in rivals))


@pytest.mark.parametrize(
    ("rival", "takes_its_place"),
    [
        (judged(SQUARE, CLEARLY, 0.0), True),
        (judged(SQUARE, HARDLY, 0.0), False),
        (judged(SQUARE, CLEARLY, 50.0), False),  # it costs more
        (judged(UNNAMED, CLEARLY, 0.0), False),
    ],
    ids=["strong evidence", "weak evidence", "more parameters", "no name"],
)
def test_a_named_rival_takes_the_place_of_a_cause_by_strong_evidence(
    rival: Candidate, takes_its_place: bool
) -> None:
    assert likelier_rival([adopted(rival)], 0) is (rival if takes_its_place else None)


def test_a_rival_that_is_another_cause_stays_where_it_is() -> None:
    rival = judged(SQUARE, CLEARLY, 0.0)
    other = Adopted(rival, 1e-9, ())
    assert likelier_rival([adopted(rival), other], 0) is None


def test_a_change_for_a_while_takes_the_place_of_a_change_in_time_alone() -> None:
    """An overflow acts while a level is high, which in one record is once."""
    law = adopted(judged(replace(JUMP, kind="offset", constants={"end": 40.0}), CLEARLY, 0.0))
    assert likelier_rival([law], 0) is None
    jump = replace(law, candidate=judged(JUMP, 100.0, 0.0))
    assert likelier_rival([jump], 0) is law.rivals[0].candidate


def fitted(candidate: Candidate, residual: np.ndarray) -> Candidate:
    """A candidate whose fit leaves this whitened residual (N,)."""
    criterion = SimpleNamespace(
        data=[None], columns=lambda x, e: (residual[:, None], np.zeros((len(residual), 1, 0)))
    )
    fit: Any = SimpleNamespace(criterion=criterion, x=np.zeros(0))
    return replace(candidate, fit=fit)


@pytest.mark.parametrize(("more", "is_rival"), [(0.0, True), (0.5, False)])
def test_what_leaves_clearly_more_is_no_rival_for_the_noise_that_it_makes_of_the_inputs(
    more: float, is_rival: bool
) -> None:
    """Its gain, less what noise of the inputs gives to it, would be the larger one."""
    white = np.random.default_rng(2).standard_normal(1000)
    best = fitted(judged(CUBIC, 100.0, 0.0), white)
    friction = coulomb_friction(MODEL, "torque", 0.01)
    other = fitted(judged(friction, 400.0, 0.0), white * np.sqrt(1 + more))
    at: Any = SimpleNamespace(noise_absorbs_misfit=False, noise=SimpleNamespace(spectra={}))
    assert [r.candidate for r in rivals_of(at, best, [best, other])] == [other] * is_rival


@pytest.mark.parametrize(("refit", "better"), [(None, 0), (10.0, 0), (90.0, 1)])
def test_rivals_are_compared_with_the_best_fit_of_a_cause_that_is_known(
    refit: float | None, better: int
) -> None:
    """Its refit from the declared start may end far from where the whole model has it."""
    own = judged(CUBIC, 50.0, 0.0)
    other = None if refit is None else judged(CUBIC, refit, 0.0)
    search: Any = SimpleNamespace(
        refitting=SimpleNamespace(judged=lambda *_: own, again=lambda *_, **__: other)
    )
    at: Any = SimpleNamespace(model=MODEL, fit=None)
    assert cause_as_it_is(search, own, at, at) is (own, other)[better]


def test_a_cause_that_another_acts_on_is_needed_and_has_no_rival() -> None:
    """A further input that turns out to lag: without the input there is no lag."""
    wind = extra_input(MODEL, "torque", "wind", "m/s")
    found: Any = SimpleNamespace(values={})
    first = replace(judged(wind, 9.0, 0.0), fit=found, names=("b_wind",))
    with_wind = wind.extend(MODEL)
    late = sensor_lag(with_wind, "wind", 1.0)
    second = replace(judged(late, 9.0, 0.0), fit=found, names=("lag_wind",))
    assert is_needed(MODEL, [second])
    assert not is_needed(MODEL, [first])
    assert not is_needed(MODEL, [first, second])
