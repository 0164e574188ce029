"""Changes that are over before the record is."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.scores.score_tests import Family, Score, ScoreTable
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.search.instants import jump_times
from casid.diagnosis.search.instants import temporary_changes as temporary
from casid.diagnosis.search.instants.jump_times import placed
from casid.diagnosis.search.instants.temporary_changes import placed_changes, temporary_changes
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import SHORTLIST
from casid.errors import SolveError
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.effects.clock_effects import bias_step, gain_step, offset_step
from casid.model.effects.effect import Effect
from casid.model.effects.parameter_effects import parameter_jump

TS, N, NOISE = 0.1, 1000, 5e-3
BEGIN, END = 25.0, 45.0
REST = (
    "sensor_scale hold time_delay actuator_lag sensor_lag missing_mode scheduled_parameter "
    "periodic_disturbance quadratic_damping cubic_damping unknown end_stop saturation outliers "
    "actuator_saturation rectified backlash deadzone cross_axis"
).split()


def leak() -> casid.Problem:
    m = casid.Model("leak")
    h, q = m.state("h", "m"), m.input("q", "m/s", hold="zoh", known=True)
    k = m.parameter("k", "1/s", start=0.5, lower=0.01, upper=10.0)
    m.balance(h, "volume", inertia=1, terms=[q, -k * h], unit="m/s")
    m.output("level", h, "m")
    return casid.Problem("leak", m)


def record(
    *, leaks: float = 0.0, flows: float = 0.0, stays: bool = False, end: float = END
) -> casid.Record:
    """100 s of dh/dt = q + w - k h, sampled exactly, with another k or w from 25 s to `end` [s]."""
    rng = np.random.default_rng(6)
    q = np.repeat(rng.uniform(0.0, 1.0, N // 20), 20)
    level, h = np.empty(N), 1.0
    for i, inflow in enumerate(q):
        level[i] = h
        is_on = i * TS >= BEGIN and (stays or i * TS < end)
        k, w = (0.6 + leaks, flows) if is_on else (0.6, 0.0)
        h = (inflow + w) / k + (h - (inflow + w) / k) * np.exp(-k * TS)
    level += NOISE * rng.standard_normal(N)
    return casid.Record({"q": q, "level": level}, {"q": "m/s", "level": "m"}, Ts=TS, name="run")


def diagnosed(of: casid.Record) -> casid.Diagnosis:
    return casid.diagnose(leak(), of, starts=1, advise=False, without=REST)


def sizes(cause: object) -> dict[str, object]:
    return {p.name: p for p in cause.parameters}  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("effect", "size", "name", "kind"),
    [
        ("leaks", 0.3, "jump_k", "parameter_jump"),
        pytest.param("flows", 0.2, "c_0", "offset", marks=pytest.mark.slow),
    ],
)
def test_what_is_on_for_a_while_is_one_cause_with_both_instants(
    effect: str, size: float, name: str, kind: str
):
    """A step that is held sets in at the first sample of which it is all."""
    (cause,) = diagnosed(record(**{effect: size})).causes  # type: ignore[arg-type]
    found = sizes(cause)
    assert cause.kind == kind
    assert "for a while" in cause.sentence
    assert "for a while" in cause.words
    for what, true in ((name, size), ("time", BEGIN), ("end", END)):
        p = found[what]
        assert 0.0 < p.std_error < 0.1 * abs(true)  # type: ignore[attr-defined]
        assert abs(p.value - true) < 4 * p.std_error  # type: ignore[attr-defined]


@pytest.mark.slow
def test_for_a_while_a_parameter_may_be_many_times_what_it_is():
    """A valve that is opened: eight times the leak."""
    (cause,) = diagnosed(record(leaks=4.0, end=27.0)).causes
    jump = sizes(cause)["jump_k"]
    assert (cause.kind, cause.where) == ("parameter_jump", "k")
    assert abs(jump.value - 4.0) < 4 * jump.std_error  # type: ignore[attr-defined]


def test_what_stays_is_a_jump():
    (cause,) = diagnosed(record(leaks=0.3, stays=True)).causes
    assert cause.kind == "parameter_jump"
    assert "end" not in sizes(cause)
    assert cause.words == "jump of k"


def passing() -> tuple[Refitting, Weighted, Candidate]:
    """A jump that stays, refitted as one that ends 2 s before the record does."""
    experiments, model = [casid.Experiment(record(leaks=0.3, stays=True))], leak().model
    weighing = Weighing(experiments)
    refitting = Refitting(weighing)
    at = weighing.weigh(model, fit_model(model, experiments, FitSettings(starts=1)))
    found = refitting.refit(at, parameter_jump(model, "k", BEGIN, (N - 20) * TS), 0.3)
    assert found is not None
    return refitting, at, found


def test_what_seems_to_end_just_before_the_record_is_compared_with_what_stays():
    """Both explain as much of what was fitted, and one instant less costs less."""
    refitting, at, found = passing()
    best = max(placed(refitting, at, [found], [], lambda _: None), key=lambda c: c.merit)
    assert best.effect.end is None
    assert best.effect.variant == pytest.approx(BEGIN, abs=TS)


def test_a_comparison_with_what_stays_that_fails_is_noted_and_no_instants_are(monkeypatch):
    """The instants were found; only what stays may have been better."""

    def fails(*arguments):
        raise SolveError("it diverges")

    monkeypatch.setattr(jump_times, "_or_staying", fails)
    refitting, at, found = passing()
    (kept,) = placed(refitting, at, [found], [], lambda _: None)
    assert kept.effect.end is not None
    (note,) = refitting.attempts.notes()
    assert note.startswith("the comparison of ")
    assert note.endswith(" with a change that stays was left out: it diverges")


def test_a_record_without_a_change_has_none():
    assert diagnosed(record()).causes == ()


def table_of(effects: list[Effect], signatures: np.ndarray, residual: np.ndarray) -> ScoreTable:
    """Scores of signatures (M, K) of a white residual (M,), as `score_test` has them."""
    z, energy = signatures.T @ residual, np.sum(signatures**2, axis=0)
    size = np.sqrt(energy)
    scores = tuple(
        Score(e, float(z[i] / size[i]), 1e-9, 1e-9, energy[i], z[i] / energy[i], u, 0.5)
        for i, (e, u) in enumerate(zip(effects, (z**2 / energy).tolist(), strict=True))
    )
    cosines = signatures.T @ signatures / np.outer(size, size)
    return ScoreTable(scores, cosines, 0, Family(np.empty(0), len(scores)))


def of_samples(n: int) -> object:
    return SimpleNamespace(model=leak().model, criterion=SimpleNamespace(n_samples=n))


def test_the_scores_of_steps_are_those_of_every_pair_of_them():
    """A change by 2 from the third instant to the sixth; a regression gives the same numbers."""
    rng, n = np.random.default_rng(0), 700
    times = [100.0 * k for k in range(1, 7)]
    steps = np.array([np.arange(n) >= t for t in times], dtype=float).T
    steps -= steps.mean(axis=0)
    residual = 2.0 * (steps[:, 2] - steps[:, 5]) + 0.1 * rng.standard_normal(n)
    effects = [parameter_jump(leak().model, "k", t) for t in times]
    (found,) = temporary_changes(of_samples(n), table_of(effects, steps, residual))  # type: ignore
    assert (found.effect.variant, found.effect.end) == (300.0, 600.0)
    own = steps[:, 2] - steps[:, 5]
    assert found.step == pytest.approx(own @ residual / (own @ own))
    assert found.unrobust == pytest.approx((own @ residual) ** 2 / (own @ own))
    assert found.effect.cost == 5


def test_a_step_that_explains_as_much_alone_has_no_second_instant():
    n, times = 700, [100.0 * k for k in range(1, 7)]
    steps = np.array([np.arange(n) >= t for t in times], dtype=float).T
    steps -= steps.mean(axis=0)
    residual = 2.0 * steps[:, 2] + 0.1 * np.random.default_rng(1).standard_normal(n)
    effects = [parameter_jump(leak().model, "k", t) for t in times]
    assert temporary_changes(of_samples(n), table_of(effects, steps, residual)) == []  # type: ignore


def test_few_changes_for_a_while_are_refitted(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(temporary, "SHORTLIST", replace(SHORTLIST, passing=2))
    n, times = 700, [100.0 * k for k in range(1, 7)]
    steps = np.array([np.arange(n) >= t for t in times], dtype=float).T
    steps -= steps.mean(axis=0)
    residual = 2.0 * (steps[:, 2] - steps[:, 4])
    model = leak().model
    every = [
        *(parameter_jump(model, "k", t) for t in times),
        *(offset_step(model, "volume", t) for t in times),
        *(bias_step(model, "level", t) for t in times),
    ]
    signatures = np.hstack([steps, 0.9 * steps, 0.8 * steps])
    found = temporary_changes(of_samples(n), table_of(every, signatures, residual))  # type: ignore
    assert len(found) == 2


def test_gains_of_channels_crowd_out_no_force():
    """A knock for an instant is a gain of every input that moves then, and a force."""
    n, times = 700, [100.0 * k for k in range(1, 7)]
    steps = np.array([np.arange(n) >= t for t in times], dtype=float).T
    steps -= steps.mean(axis=0)
    residual = 2.0 * (steps[:, 2] - steps[:, 4])
    m = casid.Model("store")
    h, inputs = m.state("h", "m"), [m.input(f"q_{i}", "m/s") for i in range(6)]
    m.balance(h, "volume", inertia=1, terms=inputs, unit="m/s")
    m.output("level", h, "m")
    gains = [gain_step(m, f"q_{i}", t) for i in range(6) for t in times]
    force = [offset_step(m, "volume", t) for t in times]
    signatures = np.hstack([*[steps] * 6, 0.5 * steps])
    at = SimpleNamespace(model=m, criterion=SimpleNamespace(n_samples=n))
    found = temporary_changes(at, table_of([*gains, *force], signatures, residual))  # type: ignore
    kinds = [s.effect.kind for s in found]
    assert kinds.count("sensor_scale") == SHORTLIST.gains
    assert "offset" in kinds


def test_the_end_of_a_change_is_found_far_from_where_it_was_scored():
    """A leak from 25 to 60 s that was taken for one of 2 s, steps of the grid being 3.3 s apart."""
    m, split = leak().model, split_records([casid.Experiment(record(leaks=0.3, end=60.0))], 0.3)
    weighing = Weighing(split.fitted)
    at = weighing.weigh(m, fit_model(m, split.fitted, FitSettings(starts=1)))
    refitting = Refitting(weighing)
    rough = refitting.refit(at, parameter_jump(m, "k", BEGIN, 27.0), 0.1)
    (found,) = placed(refitting, at, [rough], (), lambda _: None)
    assert abs(found.effect.constants["time"] - BEGIN) < 0.05
    assert abs(found.effect.constants["end"] - 60.0) < 0.05
    assert found.fit.values["jump_k"] == pytest.approx(0.3, rel=0.02)


def test_what_lasts_less_than_an_interval_of_the_grid_is_placed_about_the_burst_of_the_misfit():
    """An inflow for 1.2 s, whose tangents are exact; the instants of steps are 5 s apart."""
    m, split = leak().model, split_records([casid.Experiment(record(flows=0.5, end=26.2))], 0.3)
    base = fit_model(m, split.fitted, FitSettings(starts=1))
    weighing = Weighing(split.fitted)
    at = weighing.weigh(m, base)
    table = Search(weighing, {}).table(at, [])
    (inflow,) = (s for s in placed_changes(at, table) if s.effect.kind == "offset")
    assert abs(inflow.effect.constants["time"] - BEGIN) < TS
    assert abs(inflow.effect.constants["end"] - 26.2) < TS
    assert inflow.step == pytest.approx(0.5, rel=0.05)
    (rough,) = (s for s in temporary_changes(at, table) if s.effect.kind == "offset")
    assert rough.step < 0.8 * inflow.step
