"""What sets in during a record, or drifts, is named with its instant and its size.

A slide on a spring, pushed by a known force that is held between samples: between them the motion
is solved exactly, by the exponential of its matrix.
"""

from __future__ import annotations

import functools
import importlib
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.diagnosis.settings import DiagnosisSettings
from casid.estimation.holdout import Split, split_records
from casid.export.problem_file import write_problem_file

diagnosing = importlib.import_module("casid.diagnosis.diagnose")  # the package has the function

Array = np.ndarray

M, D, K = 2.0, 3.0, 40.0
TS, N = 0.02, 2500
SIGMA = 2e-4


def slide() -> casid.Problem:
    model = casid.Model("slide")
    F = model.input("force", "N", hold="zoh", known=True)
    x, v = model.state("x", "m"), model.state("v", "m/s")
    m = model.parameter("m", "kg", start=1.0, lower=0.1, upper=20.0)
    d = model.parameter("d", "N s/m", start=1.0, lower=0.0, upper=50.0)
    k = model.parameter("k", "N/m", start=30.0, lower=1.0, upper=500.0)
    model.derivative(x, v)
    model.balance(v, "force", inertia=m, terms=[F, -d * v, -k * x])
    model.output("position", x, "m")
    return casid.Problem("slide", model)


def record(
    load: Array | float = 0.0,
    reading: Array | float = 0.0,
    seed: int = 0,
    *,
    share: Array | float = 1.0,
    shown: Array | float = 1.0,
) -> casid.Record:
    """Held forces, of which a share (N,) acts, with a load beside them (N,).

    The sensor shows a multiple of the position (N,), and what it adds to it (N,).
    """
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.uniform(-8, 8, N // 25), 25)
    A = np.array([[0.0, 1.0, 0.0], [-K / M, -D / M, 1.0 / M], [0.0, 0.0, 0.0]])
    step = expm(A * TS)
    x, y = np.zeros(3), np.empty(N)
    for k, u in enumerate(share * force + np.broadcast_to(load, N)):
        y[k] = x[0]
        x[2] = u
        x = step @ x
    position = shown * y + reading + SIGMA * rng.standard_normal(N)
    return casid.Record({"force": force, "position": position}, {"force": "N", "position": "m"}, TS)


T = TS * np.arange(N)


def only(found: casid.Diagnosis) -> casid.Cause:
    assert len(found.causes) == 1, found.sentence
    return found.causes[0]


def assert_knocked(found: casid.Diagnosis, instant: float) -> None:
    """One cause, a sensor that reads 2 mm more from an instant on."""
    cause = only(found)
    size, time = cause.parameters
    assert (cause.kind, cause.where) == ("sensor_bias", "position")
    assert size.value == pytest.approx(2e-3, abs=4 * size.std_error)
    assert time.value == pytest.approx(instant, abs=2 * TS)


def is_of_the_whole(found: casid.Diagnosis) -> bool:
    """True where a note says that no part of the record was held out."""
    return any("no part is left to confirm them" in note for note in found.notes)


@functools.cache
def of_a_load_that_sets_in() -> casid.Diagnosis:
    return casid.diagnose(slide(), record(load=0.2 * (T >= 21.0)), advise=False)


@pytest.mark.slow
def test_a_load_that_sets_in_is_a_constant_term_from_an_instant_on():
    cause = only(of_a_load_that_sets_in())
    size, time = cause.parameters
    assert (cause.kind, cause.where) == ("offset", "force")
    assert size.value == pytest.approx(0.2, abs=4 * size.std_error)
    assert time.value == pytest.approx(21.0, abs=2 * TS)
    assert "sets in during the record" in cause.sentence


@pytest.mark.slow
def test_a_sensor_that_was_knocked_is_biased_from_an_instant_on():
    found = casid.diagnose(slide(), record(reading=2e-3 * (T >= 17.0)), advise=False)
    assert_knocked(found, 17.0)


def assert_gain(found: casid.Diagnosis, channel: str, change: float, *instants: float) -> None:
    """One cause, a gain that changes at an instant, and back at the second one of two."""
    cause = only(found)
    size, *times = cause.parameters
    assert (cause.kind, cause.where) == ("sensor_scale", channel)
    assert size.value == pytest.approx(change, abs=4 * size.std_error)
    assert size.unit == "1"
    assert [t.value for t in times] == pytest.approx(list(instants), abs=2 * TS)
    assert cause.words.startswith(f"change of the gain of {channel}")
    assert all(quantity in cause.sentence for quantity in ("the gain", channel, "changes"))


FEW = """hold time_delay actuator_lag sensor_lag missing_mode scheduled_parameter unknown end_stop
    periodic_disturbance quadratic_damping cubic_damping saturation outliers actuator_saturation
    backlash deadzone stribeck_friction coulomb_friction asymmetric_friction cubic_stiffness
    quadratic_stiffness rectified""".split()
"""Kinds left out where the others are compared: what acts on the clock, and gains."""


@pytest.mark.slow
def test_an_actuator_that_loses_a_fifth_of_its_effect_has_another_gain_from_then_on():
    """No parameter of the model is that gain: mass, damper and spring would have to jump alike."""
    part = record(share=1 - 0.2 * (T >= 11.0)).between(0.0, 20.0)
    found = casid.diagnose(slide(), part, advise=False, starts=1, without=FEW)
    assert_gain(found, "force", -0.2, 11.0)


@pytest.mark.slow
def test_an_actuator_that_loses_its_effect_for_a_while_gets_it_back():
    """Beside the whole catalogue: what it leaves has the spectrum of a random disturbance."""
    lost = (T >= 12.0) & (T < 20.0)
    found = casid.diagnose(slide(), record(share=1 - 0.2 * lost), advise=False)
    assert_gain(found, "force", -0.2, 12.0, 20.0)


@pytest.mark.slow
def test_a_load_may_be_taken_off_where_the_record_is_held_out():
    """No fitted sample shows its end: what was held out refuses a load that stays."""
    part = record(load=0.2 * ((T >= 8.0) & (T < 16.5))).between(0.0, 20.0)
    found = casid.diagnose(slide(), part, advise=False, starts=1, without=FEW)
    cause = only(found)
    size, *times = cause.parameters
    assert (cause.kind, cause.where) == ("offset", "force")
    assert size.value == pytest.approx(0.2, abs=4 * size.std_error)
    assert [t.value for t in times] == pytest.approx([8.0, 16.5], abs=2 * TS)


@pytest.mark.slow
def test_a_sensor_whose_scale_changes_shows_all_that_it_shows_larger_from_then_on():
    found = casid.diagnose(slide(), record(shown=1 + 0.05 * (T >= 17.0)), advise=False)
    assert_gain(found, "position", 0.05, 17.0)


@pytest.mark.slow
def test_a_sensor_that_drifts_is_biased_ever_more():
    """It grows to its size over the fitted 70 % of the record."""
    found = casid.diagnose(slide(), record(reading=4e-3 * T / T[-1]), advise=False)
    cause = only(found)
    (size,) = cause.parameters
    assert (cause.kind, cause.where) == ("sensor_bias", "position")
    assert size.name == "drift_position"
    assert size.value == pytest.approx(0.7 * 4e-3, abs=4 * size.std_error)
    assert "drifts" in cause.sentence


@pytest.mark.slow
def test_a_constant_load_stays_what_acts_all_the_time():
    cause = only(casid.diagnose(slide(), record(load=0.2), advise=False))
    kinds = {(cause.kind, cause.where)} | {(a.kind, a.where) for a in cause.alternatives}
    assert ("offset", "force") in kinds
    # Friction that would drive the slide one way is none: the slide has no dry friction.
    assert "asymmetric_friction" not in {kind for kind, _ in kinds}
    assert [p.name for p in cause.parameters][1:] == []


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 2))])
def test_nothing_sets_in_where_nothing_does(seed):
    found = casid.diagnose(slide(), record(seed=seed), advise=False)
    assert found.verdict == "adequate"
    assert not is_of_the_whole(found)


@pytest.mark.slow
def test_the_extended_model_begins_the_load_when_the_record_did(tmp_path):
    """The problem file of the extended model finds nothing missing, and the load by its size."""
    found = of_a_load_that_sets_in()
    path = tmp_path / "slide.py"
    write_problem_file(found.model, path)
    extended = casid.load_problem(path)
    estimate = casid.identify(extended, record(load=0.2 * (T >= 21.0), seed=1))
    load = next(p for p in estimate.parameters if p.name == "F_0")
    assert load.value == pytest.approx(0.2, abs=4 * load.std_error)


@pytest.mark.slow
def test_what_sets_in_where_a_record_is_held_out_is_found_in_all_of_it():
    """The first 70 % of it, 35 s, show nothing: the record is diagnosed as a whole."""
    found = casid.diagnose(slide(), record(reading=2e-3 * (T >= 41.0)), advise=False)
    assert is_of_the_whole(found)
    assert_knocked(found, 41.0)


@pytest.mark.slow
def test_what_sets_in_there_is_found_beside_what_was_there_from_the_beginning():
    """A knock of the sensor that is fitted, and a load that is not."""
    knocked, load = 1e-3 * (T >= 10.0), 0.2 * (T >= 41.0)
    found = casid.diagnose(slide(), record(load=load, reading=knocked), advise=False)
    assert {(c.kind, c.where) for c in found.causes} == {
        ("offset", "force"),
        ("sensor_bias", "position"),
    }
    assert is_of_the_whole(found)
    alone = casid.diagnose(slide(), record(reading=knocked), advise=False)
    assert not is_of_the_whole(alone)
    assert only(alone).kind == "sensor_bias"


def test_whole_records_are_searched_at_the_level_of_the_calibration(monkeypatch):
    """Where null records ask for a smaller one, what is repeated has no larger one."""
    levels = []
    judged = SimpleNamespace(causes=(), remainder=None)

    def searched(problem: object, split: Split, settings: DiagnosisSettings) -> SimpleNamespace:
        levels.append(settings.alpha)
        assert split.is_empty
        return SimpleNamespace()

    monkeypatch.setattr(diagnosing, "_searched", searched)
    monkeypatch.setattr(diagnosing, "_judged", lambda *_: judged)
    monkeypatch.setattr(diagnosing, "errs_in_held_out_alone", lambda *_: True)
    split = split_records([casid.Experiment(record(), {}, "r")], 0.3)
    found = SimpleNamespace(search=SimpleNamespace(alpha=0.01))
    kept = diagnosing._judged_or_whole(slide(), found, split, DiagnosisSettings(alpha=0.05))
    assert levels == [0.01]
    assert kept == (found, judged, [])


@pytest.mark.parametrize(
    ("of_part", "of_whole", "p_value", "is_whole"),
    [
        (["sensor_bias"], ["offset"], 0.4, True),  # others, which leave noise
        (["sensor_bias"], ["offset"], 1e-6, False),  # others, which do not
        (["sensor_bias"], ["sensor_bias"], 0.4, False),  # the same ones: the held-out part stays
        (["sensor_bias", "deadzone"], ["offset"], 0.4, True),
        (["sensor_bias"], [], 0.4, False),
        (["sensor_bias"], ["sensor_bias", "offset"], 1e-6, True),  # more of them
    ],
)
def test_causes_of_the_whole_record_count_where_they_explain_it(
    monkeypatch, of_part, of_whole, p_value, is_whole
):
    """Where those of the first part fail in the rest, as all cases here suppose."""

    def verdict(kinds: list[str]) -> SimpleNamespace:
        remainder = SimpleNamespace(p_value=p_value, level=0.01)
        causes = [SimpleNamespace(kind=kind, where="force") for kind in kinds]
        return SimpleNamespace(causes=causes, remainder=remainder)

    found = SimpleNamespace(search=SimpleNamespace(alpha=0.05))
    again = SimpleNamespace()
    first, second = verdict(of_part), verdict(of_whole)
    monkeypatch.setattr(diagnosing, "_searched", lambda *_: again)
    monkeypatch.setattr(diagnosing, "_judged", lambda _, of, __: first if of is found else second)
    monkeypatch.setattr(diagnosing, "errs_in_held_out_alone", lambda *_: True)
    split = split_records([casid.Experiment(record(), {}, "r")], 0.3)
    kept, judged, notes = diagnosing._judged_or_whole(slide(), found, split, DiagnosisSettings())
    assert (kept, judged) == ((again, second) if is_whole else (found, first))
    assert bool(notes) == is_whole
