"""What no effect of the catalogue explains is called unknown, and described, not named after kin.

The strange effects are those of `tests/support/truth.py` that the catalogue does not have.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

import casid
from casid.diagnosis.diagnosis import Cause
from casid.diagnosis.thresholds import JUDGING
from casid.diagnosis.verdict.cause import Alternative
from casid.diagnosis.verdict.remainder import Remaining
from casid.diagnosis.verdict.tested_remainder import Remainder
from casid.diagnosis.verdict.unknown_cause import with_the_unknown
from problems import pendulum
from tests.diagnosis.test_diagnose import record_of
from tests.support import samples, truth, truth_effects
from tests.support.sample_parts import unexplained

# -- the rules ------------------------------------------------------------------------------------


@functools.cache
def left() -> Remainder:
    """Something that acts in the torque, found with p = 1e-12."""
    return Remainder(1e-12, 0.01, unexplained(samples.view(N=600)))


def cause(kind: str, where: str = "torque") -> Cause:
    return Cause(kind, where, 1e-6, (), share=0.6, sentence=f"{kind} in {where}")


def after(share: float, *causes: Cause) -> list[Cause]:
    """What becomes of the causes where `share` of the excess misfit remains."""
    return with_the_unknown(causes, left(), Remaining((), share))


def test_where_nothing_is_named_the_unknown_is_the_cause():
    (only,) = after(1.0)
    assert (only.kind, only.where) == ("unknown", left().unexplained.where)
    assert only.p_value == 1e-12
    assert only.parameters == ()
    assert only.description == left().unexplained.sentence
    assert "no effect of the catalogue explains" in only.sentence


def test_one_name_that_leaves_much_is_the_nearest_of_the_catalogue_and_no_cause():
    (only,) = after(JUDGING.doubtful + 0.1, cause("quadratic_damping"))
    assert only.kind == "unknown"
    assert [(a.kind, a.where) for a in only.alternatives] == [("quadratic_damping", "torque")]
    assert "it explains 75 % of the excess misfit" in only.alternatives[0].why
    assert only.share == 0.6  # of the misfit, as far as the nearest takes it away


def test_what_the_record_cannot_reject_against_the_nearest_is_as_near():
    rival = Alternative("cubic_damping", "torque", 0.4, "explains the misfit as well")
    named = replace(cause("quadratic_damping"), alternatives=(rival,))
    (only,) = after(JUDGING.doubtful + 0.1, named)
    assert [a.kind for a in only.alternatives] == ["quadratic_damping", "cubic_damping"]


def test_names_that_leave_little_stand_alone():
    named = [cause("quadratic_damping")]
    assert after(JUDGING.doubtful - 0.01, *named) == named


def test_several_names_keep_their_places_and_the_unknown_comes_last():
    named = [cause("quadratic_damping"), cause("coulomb_friction")]
    found = after(JUDGING.doubtful + 0.1, *named)
    assert found[:-1] == named
    assert found[-1].kind == "unknown"
    assert found[-1].alternatives == ()


@pytest.mark.parametrize("kind", ["outliers", "saturation"])
def test_spoilt_samples_are_no_name_of_what_is_left(kind):
    spoilt = cause(kind, "gyro")
    found = after(0.01, spoilt)
    assert found[0] == spoilt
    assert found[1].kind == "unknown"
    nearest = after(0.5, cause("cubic_stiffness"), spoilt)
    assert [c.kind for c in nearest] == ["unknown", kind]
    assert nearest[0].alternatives[0].kind == "cubic_stiffness"


def test_what_is_left_untold_counts_as_all():
    (only,) = with_the_unknown([cause("quadratic_damping")], left(), None)
    assert only.kind == "unknown"
    assert "explains 0 %" in only.alternatives[0].why


# -- on records -----------------------------------------------------------------------------------


@functools.cache
def hiding(kind: str, seed: int) -> casid.Diagnosis:
    hidden = truth.cart_pendulum(kind, 3.0, seed=seed, duration=40.0, Ts=0.02)
    return casid.diagnose(pendulum.problem, record_of(hidden), max_causes=2, advise=False)


@pytest.mark.slow
def test_hysteresis_is_unknown_by_its_kind_and_described_with_its_size():
    """Bouc and Wen's loop in the restoring torque: yields at 0.05 rad in the simulator."""
    d = hiding("hysteresis", 1)
    assert d.verdict == "deficient"
    found = d.causes[0]
    assert found.kind == "unknown"
    assert found.where == "torque"
    assert "hysteresis along phi" in found.description
    (travel,) = [p for p in found.parameters if p.name == "x_h"]
    assert abs(travel.value - truth_effects.YIELD_ANGLE) < 3 * travel.std_error


@pytest.mark.slow
@pytest.mark.xfail(reason="a change of m for a while is named, and the force in its set")
def test_a_knock_is_told_from_a_force_that_sets_in_by_what_it_leaves():
    """Half a sine of 0.2 s: both start the pendulum ringing, at instants a quarter period apart.

    Its impulse is 2/pi of its height times 0.2 s, in the middle of it.
    """
    hidden = truth.cart_pendulum("knock", 3.0, seed=3, duration=40.0, Ts=0.02)
    d = hiding("knock", 3)
    (cause,) = d.causes
    assert len(cause.parameters) == 2
    impulse, time = cause.parameters
    assert cause.kind == "unknown"
    assert "knock" in cause.sentence
    assert time.value == pytest.approx(hidden.truth["t_jump"] + 0.1, abs=0.1)
    height = hidden.truth["size"]
    assert impulse.value == pytest.approx(height * 0.2 * 2 / np.pi, rel=0.2)


@pytest.mark.slow
def test_a_knock_is_a_force_for_a_while_and_has_its_instants():
    """Half a sine of 0.2 s; a parameter that changes for as long moves the pendulum alike."""
    hidden = truth.cart_pendulum("knock", 3.0, seed=3, duration=40.0, Ts=0.02)
    (cause,) = hiding("knock", 3).causes
    named = {(cause.kind, cause.where), *((a.kind, a.where) for a in cause.alternatives)}
    assert ("offset", "torque") in named
    time, end = ({p.name: p.value for p in cause.parameters}[name] for name in ("time", "end"))
    assert 0.5 * (time + end) == pytest.approx(hidden.truth["t_jump"] + 0.1, abs=0.05)
    # A constant of the same impulse, 2/pi of the height over 0.2 s, lasts 0.13 s at that height.
    assert 0.1 < end - time < 0.25


@pytest.mark.slow
def test_an_effect_of_the_catalogue_leaves_nothing_unknown():
    d = hiding("quadratic_damping", 3)
    assert [c.kind for c in d.causes] == ["quadratic_damping"]
    assert d.unexplained is None
