"""What happens in time, or rings on its own, imitates laws that depend on the amplitude."""

from __future__ import annotations

from typing import Any

import pytest

from casid.diagnosis.search.alternatives import without_imitations
from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.thresholds import COMPARISON
from casid.model.effects.balance_effects import cubic_damping
from casid.model.effects.effect import Effect
from casid.model.effects.parameter_effects import parameter_jump
from problems import roll_decay

MODEL = roll_decay.decay_model()
LAW = cubic_damping(MODEL, "torque")
JUMP = parameter_jump(MODEL, "B_1", 20.0)


def judged(effect: Effect, gain: float, cost: float) -> Candidate:
    """A candidate with what it gains and costs; nothing else of it is compared here."""
    unused: Any = None
    return Candidate(effect, (), MODEL, unused, gain, cost, 0.0)


@pytest.mark.parametrize(("gain", "is_cause"), [(0.9, False), (1.4, False), (1.6, True)])
def test_a_jump_is_a_cause_if_it_explains_half_as_much_again_as_the_best_law(
    gain: float, is_cause: bool
) -> None:
    assert COMPARISON.imitator == 0.5
    law, jump = judged(LAW, 100.0, 0.0), judged(JUMP, 100.0 * gain, 0.0)
    both = [law, jump]
    assert without_imitations(both, both) == (both if is_cause else [law])


def test_beside_laws_that_explain_nothing_a_jump_has_to_pay_for_itself_alone() -> None:
    law, jump, poor = judged(LAW, 0.1, 5.0), judged(JUMP, 20.0, 15.0), judged(JUMP, 15.0, 15.0)
    assert without_imitations([law, jump], [law, jump]) == [law, jump]
    assert without_imitations([law, poor], [law, poor]) == [law]


def test_a_law_that_is_not_significant_is_no_reason_against_a_jump() -> None:
    law, jump = judged(LAW, 100.0, 0.0), judged(JUMP, 50.0, 0.0)
    assert without_imitations([law, jump], [jump]) == [law, jump]
