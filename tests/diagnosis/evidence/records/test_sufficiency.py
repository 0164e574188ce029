"""Input that holds no answer is called undecided with the reason; input that errs is refused."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.records.recorded_channels import (
    channels_held_out_too,
    left_out_by_clock,
    rate_of,
    refuse_shared_columns,
)
from casid.diagnosis.evidence.records.sufficiency import (
    few_step_fit,
    weak_parameters,
    weighted_as_white,
    why_doubtful,
    why_too_few,
    why_uninformative,
)
from casid.diagnosis.settings import require_settings
from casid.errors import DataError
from casid.estimation.holdout import split_records
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from problems import emps, pendulum, roll_decay

PROBLEMS = {
    "pendulum": (pendulum.problem, lambda: pendulum.simulate(duration=15.0)),
    "emps": (emps.problem, lambda: emps.simulate(duration=3.0)),
    "roll_decay": (roll_decay.problem, lambda: roll_decay.simulate(duration=30.0)),
}


def with_channels(record: casid.Record, **values) -> casid.Record:
    for name, samples in values.items():
        record = record.with_channel(name, samples, record.units[name])
    return record


def spoilt(name: str, fault: str) -> tuple[casid.Problem, casid.Record]:
    """The problem and its record with the fault in it."""
    problem, simulate = PROBLEMS[name]
    record, rng = simulate(), np.random.default_rng(5)
    outputs = list(problem.model.outputs)
    inputs = [n for n, u in problem.model.inputs.items() if u.kind == "measured"]
    size = {n: float(np.std(record[n])) for n in (*outputs, *inputs)}
    noise = {n: 0.02 * size[n] * rng.standard_normal(record.N) for n in size}
    if fault == "constant outputs":
        return problem, with_channels(record, **{n: np.full(record.N, 0.3) for n in outputs})
    if fault == "zero outputs":
        return problem, with_channels(record, **{n: np.zeros(record.N) for n in outputs})
    if fault == "outputs of noise":
        return problem, with_channels(record, **{n: noise[n] for n in outputs})
    if fault == "noise alone":
        return problem, with_channels(record, **noise)
    if fault == "50 samples":
        return problem, record.between(record.t0, record.t0 + 49.5 * record.Ts)
    if fault == "constant inputs":
        return problem, with_channels(record, **{n: np.full(record.N, 0.1) for n in inputs})
    assert fault == "excitation held out"
    late = np.arange(record.N) > 0.72 * record.N
    return problem, with_channels(record, **{n: noise[n] + late * record[n] for n in size})


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("constant outputs", "is constant in every sample that is fitted: check the sensor"),
        ("zero outputs", "is zero in every sample that is fitted: check the sensor"),
        ("outputs of noise", "noise alone"),
        ("noise alone", "noise alone"),
        ("50 samples", "samples are too few to judge a model with"),
    ],
)
def test_a_record_without_an_answer_is_undecided_with_the_reason(name, fault, reason):
    d = casid.diagnose(*spoilt(name, fault), starts=1, max_causes=1, advise=False)
    assert d.verdict == "undecided"
    assert d.causes == ()
    assert reason in d.sentence
    assert "does not determine whether the model is adequate" in d.sentence


@pytest.mark.parametrize("name", ["pendulum", "emps"])
def test_excitation_in_the_held_out_part_alone_is_said_to_lie_there(name):
    """What is not fitted cannot be judged, and is no row of outliers."""
    d = casid.diagnose(*spoilt(name, "excitation held out"), starts=1, max_causes=1, advise=False)
    assert d.verdict == "undecided"
    assert "lies in the held-out part" in d.sentence
    assert "--hold-out 0" in d.sentence


@pytest.mark.parametrize(("samples", "would_do"), [(60, True), (45, False)])
def test_where_the_samples_held_out_would_do_the_remedy_is_said(samples, would_do):
    """Seven in ten are fitted, and 50 are the least for five unknowns."""
    problem, simulate = PROBLEMS["pendulum"]
    record = simulate()
    short = record.between(record.t0, record.t0 + (samples - 0.5) * record.Ts)
    d = casid.diagnose(problem, short, starts=1, max_causes=1, advise=False)
    assert "too few to judge a model with 5 unknowns; 50 are the least" in d.sentence
    assert ("fit all 60 of them (--hold-out 0)" in d.sentence) == would_do
    assert d.advice.startswith("Correct what the reason above names") == would_do


@pytest.mark.slow
def test_an_input_that_stands_still_is_named():
    d = casid.diagnose(*spoilt("emps", "constant inputs"), starts=1, max_causes=1, advise=False)
    assert d.verdict == "undecided"
    assert "force never moves: check its cable and mapping" in d.sentence
    with pytest.raises(
        casid.IdentifiabilityError, match=r"accel .* is constant .* check its cable"
    ):
        casid.diagnose(*spoilt("pendulum", "constant inputs"), starts=1)


def test_a_motion_under_three_times_its_noise_is_still_asked():
    """A white output that the input has a part in is no noise alone."""
    record = pendulum.simulate(duration=30.0)
    rng = np.random.default_rng(6)
    loud = record["gyro"] + 3 * np.std(record["gyro"]) * rng.standard_normal(record.N)
    split = split_records([casid.Experiment(with_channels(record, gyro=loud), {}, "loud")], 0.3)
    assert why_uninformative(pendulum.problem.model, split) == ""


def test_outliers_in_a_quiet_record_do_not_pass_for_noise():
    """A few large samples raise the rms of the residual far over the motion, not its median."""
    rng = np.random.default_rng(2)
    record = pendulum.simulate(duration=15.0)
    hit = rng.choice(record.N, 15, replace=False)
    gyro = record["gyro"].copy()
    gyro[hit] += 30 * np.std(gyro) * rng.choice([-1.0, 1.0], 15)
    d = casid.diagnose(
        pendulum.problem, with_channels(record, gyro=gyro), starts=1, max_causes=1, advise=False
    )
    assert d.verdict == "deficient"
    assert ("outliers", "gyro") in {(c.kind, c.where) for c in d.causes}


def test_a_parameter_that_the_record_does_not_know_is_noted():
    """At rest but for a slow drift the inertia does nothing: k phi = S a, and d, I_x are unseen."""
    N = 1500
    slow = 0.5 * np.sin(2 * np.pi * 0.05 * 0.01 * np.arange(N))
    record = pendulum.simulate(ref=slow, noise=0.01)
    d = casid.diagnose(pendulum.problem, record, starts=1, max_causes=1, advise=False)
    assert d.verdict != "deficient"
    if d.verdict == "adequate":
        assert any("does not determine" in n and "own size" in n for n in d.notes)


def test_what_is_present_or_absent_is_no_parameter_that_the_record_does_not_determine():
    """Of a clipping that was found `saturated_u` is 1, and its error that of no estimate."""
    experiments = [casid.Experiment(pendulum.simulate(duration=2.0), {}, "short")]
    at = weighted_as_white(few_step_fit(pendulum.problem.model, experiments))
    none = SimpleNamespace(parameters=())
    (note,) = weak_parameters(at, lambda name: np.inf, none)
    assert "does not determine k and" in note
    (note,) = weak_parameters(at, lambda name: np.inf, none, without={"k"})
    assert "does not determine k " not in note
    assert (
        weak_parameters(at, lambda name: np.inf if name == "k" else 0.0, none, without={"k"}) == ()
    )


# -- settings -------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [0.0, 1.0, -0.1, 1.5, float("nan")])
def test_a_false_alarm_rate_lies_between_none_and_all(rate):
    with pytest.raises(DataError, match=r"between 0 and 1; .*0\.05"):
        require_settings(pendulum.problem, rate, 4, ())
    with pytest.raises(DataError, match="between 0 and 1"):
        casid.diagnose(pendulum.problem, pendulum.simulate(duration=2.0), false_alarm_rate=rate)


def test_a_search_looks_for_one_cause_at_least():
    with pytest.raises(DataError, match=r"max_causes = 0.*give 1 or more"):
        require_settings(pendulum.problem, 0.05, 0, ())


def test_a_kind_that_does_not_exist_is_refused_with_the_nearest():
    with pytest.raises(DataError, match=r"'cubic_stifness'.*did you mean 'cubic_stiffness'\?"):
        require_settings(pendulum.problem, 0.05, 4, ["cubic_stifness"])
    with pytest.raises(DataError, match=r"in a list, without=\['offset'\]"):
        require_settings(pendulum.problem, 0.05, 4, "offset")
    require_settings(pendulum.problem, 0.05, 4, ["offset", "outliers"])


@pytest.mark.parametrize("runs", [-5, 2.5])
def test_a_negative_number_of_null_records_is_refused(runs):
    with pytest.raises(DataError, match="calibrate = .* whole number from 1 on"):
        casid.diagnose(pendulum.problem, pendulum.simulate(duration=2.0), calibrate=runs)


# -- channels -------------------------------------------------------------------------------------

COLUMNS = ["t", "gyro", "accel", "yaw_rate"]


def test_two_channels_of_one_column_are_refused():
    with pytest.raises(DataError, match=r"accel and gyro would both be column 'gyro'.*--map gyro="):
        refuse_shared_columns(pendulum.problem, {"accel": "gyro"}, COLUMNS, "t")


def test_a_channel_is_not_the_clock():
    with pytest.raises(DataError, match=r"gyro and the time stamps .* 't'.*--map gyro=COLUMN"):
        refuse_shared_columns(pendulum.problem, {"gyro": "t:s"}, COLUMNS, "t")


def test_a_column_that_another_channel_took_is_not_recorded_beside_it_too():
    """A copy of the output would explain all that the model of it leaves."""
    left = refuse_shared_columns(pendulum.problem, {"gyro": "yaw_rate"}, COLUMNS, "t")
    assert "yaw_rate" not in left.recorded
    assert "speed" in left.recorded


def test_a_derived_channel_and_what_it_is_derived_from_are_not_both_mapped():
    problem = dataclasses.replace(
        pendulum.problem,
        derived={"gyro": casid.Derived("rad/s", {"raw": "rad/s"}, lambda record: -record["raw"])},
        channels={},
    )
    with pytest.raises(DataError, match="gyro is computed from raw unless it is mapped itself"):
        refuse_shared_columns(problem, {"gyro": "gyro", "raw": "accel"}, COLUMNS, "t")


def test_a_channel_of_a_slower_clock_is_known_by_its_rows():
    empty = np.ones(1000, dtype=bool)
    empty[::20] = False
    assert rate_of(empty) == 20
    assert rate_of(~empty) is None  # one hole in twenty is no clock
    assert rate_of(np.random.default_rng(1).random(1000) < 0.5) is None
    left, notes = left_out_by_clock(pendulum.problem, {}, {"yaw_rate": empty})
    assert "yaw_rate" not in left.recorded
    assert "one row of 20 alone" in notes[0]
    assert "another clock" in notes[0]
    assert "casid.align" in notes[0]
    # One of the model's own counts at its own instants.
    assert left_out_by_clock(pendulum.problem, {}, {"gyro": empty})[1] == ()


def test_a_held_out_record_that_lacks_a_channel_takes_it_from_the_candidates():
    record = pendulum.simulate(duration=4.0)
    aside = casid.Experiment(record.without("yaw_rate"), {}, "aside")
    kept, notes = channels_held_out_too({"yaw_rate": "rad/s", "speed": "m/s"}, [aside])
    assert kept == {"speed": "m/s"}
    assert "yaw_rate was not tested as a cause: aside, held out, lacks it" in notes[0]
    assert "record it there" in notes[0]
    d = casid.diagnose(
        pendulum.problem, record, hold_out=[aside], starts=1, max_causes=1, advise=False
    )
    assert "yaw_rate" not in {r.where for r in d.ranking}
    assert any("yaw_rate was not tested" in n for n in d.notes)


def test_a_fit_beside_its_minimum_is_no_reason_where_the_fit_under_the_noise_reached_its_own():
    """The tests are made at the latter; neither at a minimum leaves the question open."""
    m = casid.Model("decay")
    x, a = m.state("x", "m"), m.parameter("a", "1/s", start=0.05)
    m.derivative(x, -a * x)
    m.output("x", x, "m")
    t = 0.1 * np.arange(400)
    y = np.exp(-0.05 * t) + 0.01 * np.random.default_rng(4).standard_normal(t.size)
    record = casid.Record({"x": y}, {"x": "m"}, Ts=0.1)
    criterion = SimulationError(m, [casid.Experiment(record, {}, "r")])
    fit = minimize_simulation_error(criterion)
    start = weighted_as_white(fit)
    beside = dataclasses.replace(
        fit, solution=dataclasses.replace(fit.solution, scaled_gradient=3e-3)
    )
    assert fit.solution.is_converged
    assert not beside.solution.is_converged

    def small(_: str) -> float:
        return 1e-3

    assert why_doubtful(beside, start, small) == ""
    assert "was not fitted to its minimum" in why_doubtful(
        beside, dataclasses.replace(start, fit=beside), small
    )


@pytest.mark.parametrize("readings", [16, 60])
def test_a_curve_that_is_read_here_and_there_is_no_noise(readings):
    """An uneven clock leaves most samples of its grid empty; the readings in their order count."""
    problem, record = roll_decay.problem, roll_decay.simulate(duration=30.0)
    (name,) = problem.model.outputs
    missing = np.ones(record.N, dtype=bool)
    missing[np.random.default_rng(1).choice(record.N // 2, readings, replace=False)] = False
    curve = np.exp(-np.arange(record.N) / record.N)
    scattered = dataclasses.replace(with_channels(record, **{name: curve}), missing={name: missing})
    split = split_records([problem.experiment(scattered)], 0.0)
    assert why_uninformative(problem.model, split) == ""


def test_doses_that_a_slow_clock_hardly_follows_are_no_noise():
    """One autocorrelation far beyond its bound is enough: a dose is gone after a few readings."""
    m = casid.Model("one compartment")
    c, u = m.state("c", "mg/L"), m.input("u", "mg/h", hold="zoh", known=True)
    CL = m.parameter("CL", "L/h", start=4.0, lower=0.1)
    m.balance(c, "plasma", inertia=m.constant("V", 18.0, "L"), terms=[u, -CL * c])
    m.output("c_p", c, "mg/L")
    rng = np.random.default_rng(3)
    grid = 0.05 * np.arange(1440)
    dose = np.where((grid % 12 < 0.5) & (rng.random(6).repeat(240) > 0.1), 800.0, 0.0)
    level = np.zeros(grid.size)
    for i in range(grid.size - 1):
        level[i + 1] = level[i] + 0.05 * (dose[i] - 4.0 * level[i]) / 18.0
    missing = np.ones(grid.size, dtype=bool)
    missing[rng.choice(grid.size, 90, replace=False)] = False
    read = level + 0.1 * rng.standard_normal(grid.size)
    channels = {"u": dose / 3.6e9, "c_p": read / 1e3}
    record = casid.Record(channels, {"u": "kg/s", "c_p": "kg/m^3"}, 180.0)
    record = record.mark_missing("c_p", missing)
    split = split_records([casid.Experiment(record, {}, "doses")], 0.0)
    assert why_uninformative(casid.Problem("doses", m).model, split) == ""


@pytest.mark.parametrize("known", [True, False])
def test_an_output_that_follows_a_command_between_its_samples_is_no_noise(known):
    """A store that forgets within a sample shows each command by itself: white, as they are."""
    rng = np.random.default_rng(2)
    command = rng.choice([0.0, 10.0], 400)
    level = np.append(0.0, command[:-1]) * (1 - np.exp(-5.0)) + 0.5 * rng.standard_normal(400)
    m = casid.Model("store")
    x, u = m.state("x", "K"), m.input("u", "W", hold="zoh", known=known)
    C = m.parameter("C", "J/K", start=1.0, lower=0.0)
    m.balance(x, "heat", inertia=C, terms=[u, -m.constant("h", 1.0, "W/K") * x])
    m.output("T", x, "K")
    for T, is_noise in ((level, False), (level[rng.permutation(400)], True)):
        record = casid.Record({"u": command, "T": T}, {"u": "W", "T": "K"}, Ts=5.0)
        reason = why_uninformative(m, split_records([casid.Experiment(record)], 0.3))
        assert ("noise alone: white, and uncorrelated with u" in reason) == is_noise
        assert bool(reason) == is_noise


def test_the_states_that_windows_begin_in_take_samples_of_their_own_and_no_more():
    """Of an unstable rod in 100 windows of 15 samples, one parameter is estimated by 1300."""
    m = casid.Model("rod")
    q, v = m.state("q", "rad"), m.state("v", "rad/s")
    u = m.input("u", "N m", hold="zoh", known=True)
    m.derivative(q, v)
    m.balance(
        v,
        "torque",
        inertia=m.constant("J", 1.0, "kg m^2"),
        terms=[u, m.parameter("c", "N m/rad", start=9.0) * q],
    )
    m.output("angle", q, "rad")
    rng = np.random.default_rng(1)
    record = casid.Record(
        {"u": rng.normal(size=1500), "angle": rng.normal(size=1500)},
        {"u": "N m", "angle": "rad"},
        Ts=0.01,
    )
    windows = SimulationError(m, [casid.Experiment(record, window=15)])
    assert len(windows.variables) == 201
    assert why_too_few(windows) == ""
    few = SimulationError(m, [casid.Experiment(record.between(0.0, 0.145), window=5)])
    assert "less 6 for the states that its windows begin in" in why_too_few(few)
