"""A false-alarm rate is measured where it is used, and a level that does not hold is corrected.

The diagnosis is an argument of `calibrate`, so most tests put one in its place whose p-values have
a known distribution under the null; the last one calibrates the true one.
"""

from __future__ import annotations

import functools
import json
import signal
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import butter, lfilter
from scipy.stats import beta, chi2, kstest

import casid
from casid.data.arguments import experiments_of
from casid.diagnosis.calibration.calibration import Calibration
from casid.diagnosis.calibration.false_alarm_rate import calibrate, require_runs
from casid.diagnosis.calibration.null_records import NullRecords, Recipe, null_noise
from casid.diagnosis.calibration.null_runs import recipe_of
from casid.diagnosis.diagnose import diagnose
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.errors import DataError, SolveError
from casid.estimation.disturbances.disturbance_estimation import with_disturbance_spectra
from casid.estimation.holdout import split_records
from casid.estimation.noise.variances import estimate_noise
from casid.estimation.simulation.fit import FitSettings, fit_model
from problems import pendulum, roll_decay
from tests.support.shared import ROOT


def pieces(problem, record, hold_out=0.3):
    """Split, weighted fit and fit, as `diagnose` has them when it calibrates."""
    split = split_records(experiments_of(problem, record), hold_out)
    fit = fit_model(problem.model, split.fitted, FitSettings(starts=1))
    weighing = Weighing(split.fitted, known_noise=problem.noise)
    return split, weighing.weigh(problem.model, fit), fit


@functools.cache
def decay():
    """A roll decay as the model has it, with sensor noise and no disturbance."""
    record = roll_decay.simulate(B_2=0.0, C_3=0.0, duration=12.0, seed=4)
    split, at, fit = pieces(roll_decay.problem, record)
    return split, replace(at, full=at.full.quiet({})), fit


def answer(p: float, alpha: float) -> SimpleNamespace:
    """What `calibrate` reads of a diagnosis whose smallest p-value is `p`."""
    is_alarm = p < alpha
    return SimpleNamespace(
        verdict="deficient" if is_alarm else "adequate",
        causes=[SimpleNamespace(p_value=p)] if is_alarm else [],
        ranking=[SimpleNamespace(adjusted=p)],
    )


def energy_p(problem, experiments, *, power=1.0, false_alarm_rate, hold_out):
    """p-value of the noise's energy about the fitted simulation: exact, and then raised."""
    split, at, fit = decay()
    assert hold_out == pytest.approx(0.3)
    y = experiments[0].record["phi"]
    whole = split_records([replace_record(split.whole[0], y)], hold_out)
    kept = whole.fitted[0].record["phi"]
    clean = at.criterion.simulate((at.unbiased or at.fit).x, 0)[0][:, 0]
    sd = at.full.output_sd[0]
    p = chi2.sf(np.sum((kept - clean) ** 2) / sd**2, len(kept))
    return answer(float(p) ** power, false_alarm_rate)


def replace_record(experiment, y):
    record = experiment.record.with_channel("phi", y, "rad")
    return casid.Experiment(record, experiment.known, experiment.name)


def calibrated(diagnose_null, *, runs=200, **more) -> Calibration:
    return calibrate(
        roll_decay.problem, recipe_of(*decay()), diagnose_null=diagnose_null, runs=runs, **more
    )


@pytest.mark.slow
def test_null_records_have_the_noise_of_the_fit_and_an_exact_test_keeps_its_rate():
    """The energy over sigma^2 of N white samples is chi^2(N): its p-value is uniform."""
    found = calibrated(energy_p)
    assert found.runs == 200
    assert kstest(found.smallest, "uniform").pvalue > 0.01
    low, high = found.interval
    assert low < 0.05 < high
    k = int(found.alarms.sum())
    # Clopper and Pearson (1934): quantiles of Beta(k, n - k + 1) and Beta(k + 1, n - k).
    assert low == pytest.approx(beta.ppf(0.025, k, 200 - k + 1))
    assert high == pytest.approx(beta.ppf(0.975, k + 1, 200 - k))


def test_a_test_that_raises_too_many_alarms_is_found_out_and_its_threshold_corrected():
    """p = u^2 of a uniform u is below 0.05 in 22.4 % of all cases, below 0.0025 in 5 %."""
    found = calibrated(functools.partial(energy_p, power=2.0))
    low, high = found.interval
    assert low > 0.05
    assert low < np.sqrt(0.05) < high
    assert found.is_corrected
    # k = 10 of 200: u is the tenth smallest of 200, Beta(10, 191).
    between = beta.ppf([0.001, 0.999], 10, 191) ** 2
    assert between[0] < found.threshold < between[1]
    # Fewer than alpha (runs + 1) lie below it.
    assert np.mean(found.levels < found.threshold) <= 0.05
    assert found.p_value(np.sort(found.levels)[8]) <= 0.05 < found.p_value(found.levels.max())
    assert "judged at" in found.sentence
    assert json.loads(json.dumps(found.to_json()))["threshold"] == found.threshold


def test_a_test_that_raises_too_few_alarms_keeps_its_level():
    """What a looser threshold would name, the runs do not tell."""
    found = calibrated(functools.partial(energy_p, power=0.25), runs=40)
    assert not found.alarms.any()
    assert found.threshold == found.alpha
    assert not found.is_corrected
    assert "the threshold is unchanged" in found.sentence


def test_fewer_runs_than_a_rank_needs_leave_the_threshold_and_say_how_many_it_takes():
    found = calibrated(functools.partial(energy_p, power=2.0), runs=5)
    assert found.threshold == 0.05
    assert "at least 19 null records" in found.sentence


def test_the_same_seed_gives_the_same_calibration_and_another_one_another():
    first, again, other = (calibrated(energy_p, runs=6, seed=s) for s in (3, 3, 4))
    assert first.levels.tolist() == again.levels.tolist()
    assert first.smallest.tolist() != other.smallest.tolist()
    # Run i depends on its seed alone: a longer calibration begins with a shorter one.
    assert calibrated(energy_p, runs=3, seed=3).smallest.tolist() == first.smallest[:3].tolist()


def mean_p(problem, experiments, *, false_alarm_rate, hold_out):
    """A diagnosis that other processes can import: a number from the record."""
    return answer(float(np.abs(np.mean(experiments[0].record["phi"]))), false_alarm_rate)


@pytest.mark.slow
def test_the_number_of_processes_changes_nothing():
    problem = casid.load_problem(ROOT / "problems" / "roll_decay.py")
    one, two = (
        calibrate(problem, recipe_of(*decay()), diagnose_null=mean_p, runs=6, jobs=jobs)
        for jobs in (1, 2)
    )
    assert one.smallest.tolist() == two.smallest.tolist()


def test_a_problem_without_a_file_is_calibrated_in_one_process_and_says_so():
    lines: list[str] = []
    calibrated(energy_p, runs=3, jobs=2, progress=lines.append)
    assert any("in one process" in line for line in lines)


def test_the_time_needed_is_told_before_it_is_spent():
    lines: list[str] = []
    calibrated(energy_p, runs=4, progress=lines.append)
    assert "one null record took" in lines[0]
    assert "all 4 take about" in lines[0]
    assert lines[-1] == "calibrate: 4 of 4 runs"


def test_an_interrupted_calibration_keeps_what_is_done_and_says_so():
    calls = []

    def interrupted(*args, **more):
        calls.append(1)
        if len(calls) == 24:
            signal.raise_signal(signal.SIGINT)
        return energy_p(*args, power=2.0, **more)

    before = signal.getsignal(signal.SIGINT)
    lines: list[str] = []
    found = calibrated(interrupted, runs=60, progress=lines.append)
    assert signal.getsignal(signal.SIGINT) is before
    assert found.is_interrupted
    assert found.runs == 23  # the run at hand is given up
    assert lines[-1] == "interrupted: the diagnosis continues with 23 of 60 null records"
    assert found.notes[0] == "interrupted: 23 of 60 null records were done"
    # 23 are enough for a rank at 5 %: the smallest of them.
    assert found.threshold == min(0.05, found.levels.min())


def test_runs_that_fail_are_counted_and_none_left_is_an_error():
    calls = []

    def failing(*args, **more):
        calls.append(1)
        if len(calls) % 2:
            raise SolveError("no optimum")
        return energy_p(*args, **more)

    found = calibrated(failing, runs=6)
    assert found.runs == 3
    assert found.failures == {"SolveError: no optimum": 3}
    assert "3 null records failed: SolveError: no optimum" in found.notes

    def never(*args, **more):
        raise SolveError("no optimum")

    with pytest.raises(SolveError, match=r"none of 3 null records.*without --calibrate"):
        calibrated(never, runs=3)


@pytest.mark.parametrize("runs", [0, -5, 2.5, True, "many"])
def test_a_number_of_runs_that_is_none_is_refused_with_the_mend(runs):
    with pytest.raises(DataError, match=r"whole number from 1 on.*--calibrate 200"):
        require_runs(runs)


def test_the_figure_shows_every_run_and_the_thresholds():
    found = calibrated(functools.partial(energy_p, power=2.0), runs=60)
    figure = found.plot()
    traces = {t.name: t for t in figure.data}
    assert sum(traces["null records"].y) == 60
    assert list(traces["corrected threshold"].x) == [found.threshold] * 2
    assert list(traces["requested level"].x) == [0.05, 0.05]


# -- what null records are ------------------------------------------------------------------------


def test_null_records_have_the_sea_that_was_found_and_no_white_force_in_its_place():
    """Of many draws the mean square about the simulation is that of the noise found."""
    n, Ts = 1200, 0.1
    m = casid.Model("oscillator")
    x, v = m.state("x", "m", start=0.5), m.state("v", "m/s")
    k, d = m.parameter("k", "1/s^2", start=4.0), m.parameter("d", "1/s", start=0.3)
    m.derivative(x, v)
    m.balance(v, "force", inertia=1, terms=[-k * x, -d * v], unit="m/s^2")
    m.output("position", x, "m")
    m.output("speed", v, "m/s")
    rng = np.random.default_rng(3)
    band = butter(1, [0.5, 0.7], "bandpass", fs=2 * np.pi / Ts)
    sea = lfilter(*band, rng.standard_normal(2 * n))[n:]
    y = np.zeros((n, 2))
    y[0] = 0.5, 0.0
    step = expm(np.array([[0.0, 1.0, 0.0], [-4.0, -0.3, 1.0], [0.0, 0.0, 0.0]]) * Ts)
    for i in range(n - 1):
        y[i + 1] = step[:2, :2] @ y[i] + step[:2, 2] * sea[i]
    y += 0.002 * rng.standard_normal((n, 2))
    units = {"position": "m", "speed": "m/s"}
    record = casid.Record(dict(zip(units, y.T, strict=True)), units, Ts=Ts)
    fit = fit_model(m, [casid.Experiment(record, {}, "r")], FitSettings(starts=1))
    noise = with_disturbance_spectra(estimate_noise(fit.criterion, fit.x), fit.criterion, fit.x)
    assert list(noise.spectra) == ["force"]
    split = split_records(fit.criterion.experiments, 0.0)
    drawn = NullRecords(
        m, Recipe.of(split, fit.criterion, fit.values, null_noise(noise, fit.criterion.outputs, {}))
    )
    clean = fit.criterion.simulated(fit.x, 0).y
    squares = []
    for _ in range(60):
        (e,), _ = drawn.draw(rng)
        moved = np.column_stack([e.record[name] for name in m.outputs]) - clean
        squares.append(np.mean(moved**2, axis=0))
    error = np.std(squares, axis=0) / np.sqrt(60)
    found, expected = np.mean(squares, axis=0), noise.floor(0) ** 2
    assert np.all(abs(found - expected) < 4 * error + 0.1 * expected), (found, expected, error)


def test_null_records_keep_gaps_lengths_and_what_is_held_out():
    record = pendulum.simulate(duration=8.0)
    gap = np.zeros(record.N, dtype=bool)
    gap[100:120] = True
    record = record.mark_missing("gyro", gap)
    aside = casid.Experiment(pendulum.simulate(duration=5.0, seed=2), {}, "aside")
    split, at, fit = pieces(pendulum.problem, record, [aside])
    noise = null_noise(at.full, fit.criterion.outputs, at.input_sd)
    drawn = NullRecords(fit.criterion.model, Recipe.of(split, fit.criterion, fit.values, noise))
    whole, apart = drawn.draw(np.random.default_rng(1))
    assert [e.record.N for e in whole + apart] == [800, 500]
    assert whole[0].record.is_missing("gyro").tolist() == gap.tolist()
    assert whole[0].record["ref"].tolist() == record["ref"].tolist()  # beside the model: as it is
    # The recorded input is the true one, and gets noise of the size found.
    added = whole[0].record["accel"] - record["accel"]
    sd = at.input_sd["accel"]
    assert sd > 0
    assert np.std(added) == pytest.approx(sd, rel=4 / np.sqrt(2 * 800))
    # Held out, the same system moves the same way: what differs is noise through its resonance.
    y, z = apart[0].record["gyro"], aside.record["gyro"]
    assert np.corrcoef(y, z)[0, 1] > 0.98


@pytest.mark.slow
def test_the_diagnosis_itself_is_calibrated_on_a_record_of_the_pendulum():
    """12 null records of 8 s: P(more than 3 alarms | 5 %) = 0.2 % (binomial)."""
    split, at, fit = pieces(pendulum.problem, pendulum.simulate(duration=8.0))
    search = functools.partial(diagnose, starts=1, max_causes=1, advise=False)
    found = calibrate(pendulum.problem, recipe_of(split, at, fit), diagnose_null=search, runs=12)
    assert found.runs == 12
    assert found.alarms.sum() <= 3
    assert found.threshold <= 0.05
    assert kstest(found.smallest, "uniform").pvalue > 0.001
