"""An effect that was significant but refused has one statement: at its alternative, or a note."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from casid.diagnosis.diagnosis import Alternative, Cause
from casid.diagnosis.search.refusals import Refusal
from casid.diagnosis.verdict.not_accepted import NOT_ACCEPTED, refusal_notes, with_refusal_reasons
from casid.model.effects.names import LATER_THAN_RECORDED

WHY = "it does not lower the error of the fitted part"
BETTER = Alternative("sensor_lag", "y", 0.9, "explains the misfit better (BIC 277.9 better)")
NAMED = Cause("offset", "torque", 1e-9, (), (BETTER,), sentence="a constant term acts")


def refused(kind: str, where: str, why: str = WHY, *, shape: str = "", description: str = ""):
    key = kind, f"{where}: {shape}" if shape else where
    effect = SimpleNamespace(kind=kind, where=where, key=key, description=description)
    return SimpleNamespace(effect=effect), Refusal(why)


def test_an_effect_that_several_rounds_refuse_has_one_note():
    (note,) = refusal_notes([refused("offset", "torque", why) for why in ("one", "two")])
    assert note.endswith(f"{NOT_ACCEPTED}: two")


def test_an_alternative_that_was_refused_says_why_and_no_note_repeats_it():
    rows = [refused("sensor_lag", "y"), refused("sensor_bias", "y")]
    (cause,) = with_refusal_reasons([NAMED], rows)
    (a,) = cause.alternatives
    assert a.why == (
        "explains the misfit better under the noise model (BIC 277.9 better), but was not "
        f"accepted: {WHY}"
    )
    assert refusal_notes(rows, [cause]) == [f"bias of y {NOT_ACCEPTED}: {WHY}"]


def test_what_was_named_after_all_has_no_note_that_it_was_not_accepted():
    assert refusal_notes([refused("offset", "torque")], [NAMED]) == []


def test_an_alternative_that_was_not_refused_keeps_its_words():
    assert with_refusal_reasons([NAMED], [refused("sensor_lag", "x")]) == [NAMED]


def test_the_reason_stands_once_where_the_alternative_has_it():
    near = Alternative("sensor_lag", "y", 1.0, f"similar, but {WHY}", has_reason=True)
    (cause,) = with_refusal_reasons(
        [Cause("unknown", "y", 1e-3, (), (near,))], [refused("sensor_lag", "y")]
    )
    assert cause.alternatives == (near,)


@pytest.mark.parametrize(("description", "count"), [("", 1), ("a step", 2)])
def test_an_alternative_stands_once_and_its_variants_each(description: str, count: int):
    """Two searches may find it, with gains of their own."""
    again = Alternative("sensor_lag", "y", 0.5, "explains the misfit as well", description)
    (cause,) = with_refusal_reasons([Cause("offset", "torque", 1e-9, (), (BETTER, again))], [])
    assert cause.alternatives == (BETTER, again)[:count]


def test_the_late_input_is_known_by_its_description_and_by_its_shape():
    late = refused("time_delay", "v", shape="acts late", description=LATER_THAN_RECORDED)
    rival = Alternative("time_delay", "v", 0.5, "explains the misfit as well", LATER_THAN_RECORDED)
    (cause,) = with_refusal_reasons([Cause("offset", "torque", 1e-9, (), (rival,))], [late])
    assert cause.alternatives[0].why.endswith(f"but was not accepted: {WHY}")
    (note,) = refusal_notes([late])
    assert note.startswith(f"dead time of v (it acts late) {NOT_ACCEPTED}")
