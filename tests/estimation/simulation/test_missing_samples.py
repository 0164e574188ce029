"""Samples that were not measured: they count for nothing, and the others for what they are.

The truth is an oscillator under a force that is held, sampled exactly (matrix exponential), with
white noise of known size on its position. Estimates of it are Gaussian with the covariance of
least squares, sigma^2 (J'J)^-1, the sum over the samples that there are.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.errors import DataError
from casid.estimation.simulation.records.input_gaps import (
    filled,
    filling_error,
    long_gaps,
    with_gaps_treated,
)
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.simulation.thresholds import INPUT_GAPS
from casid.report.verdicts import judged_estimate

TS, N, SIGMA = 0.05, 1200, 0.02
TRUE = {"k": 4.0, "d": 0.6}


def model(hold: str = "zoh") -> casid.Model:
    """m x'' = F - k x - d x', m = 1 kg, whose position and speed are measured."""
    m = casid.Model("oscillator")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", known=True, hold=hold)
    k = m.parameter("k", "N/m", start=3.0, lower=0.1, upper=50)
    d = m.parameter("d", "N s/m", start=0.5, lower=0.0, upper=10)
    M = m.parameter("M", "kg", value=1.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=M, terms=[F, -k * x, -d * v])
    m.output("position", x, "m")
    m.output("speed", v, "m/s")
    return m


def signals(seed: int, held: int = 10) -> dict[str, np.ndarray]:
    """Force, position and speed with noise; the force moves every `held` samples."""
    rng = np.random.default_rng(seed)
    A = np.array([[0.0, 1.0], [-TRUE["k"], -TRUE["d"]]])
    whole = expm(TS * np.block([[A, np.array([[0.0], [1.0]])], [np.zeros((1, 3))]]))
    F = np.repeat(rng.standard_normal(N // held), held)
    x, out = np.zeros(2), np.empty((N, 2))
    for i in range(N):
        out[i] = x
        x = whole[:2, :2] @ x + whole[:2, 2] * F[i]
    noisy = out + SIGMA * rng.standard_normal(out.shape)
    return {"F": F, "position": noisy[:, 0], "speed": noisy[:, 1]}


def record(channels: dict[str, np.ndarray], name: str = "run") -> casid.Record:
    """NaN is missing."""
    missing = {n: np.isnan(v) for n, v in channels.items() if np.isnan(v).any()}
    units = {"F": "N", "position": "m", "speed": "m/s"}
    return casid.Record(channels, units, Ts=TS, name=name, missing=missing)


def without(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
    return np.where(mask, np.nan, values)


def fifth_gone(seed: int) -> np.ndarray:
    return np.random.default_rng(1000 + seed).random(N) < 0.2


SETTINGS = casid.FitSettings(starts=1, substeps=4)


def fit(run: casid.Record, hold: str = "zoh") -> casid.Estimate:
    return casid.identify(casid.Problem("oscillator", model(hold)), run, settings=SETTINGS)


# -- outputs --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_estimate_with_a_fifth_missing_lies_within_its_error_bars():
    """chi^2 of 2 parameters over 12 records: 24 degrees of freedom, mean 24 and sd 7."""
    total, widths = 0.0, []
    for seed in range(12):
        s = signals(seed)
        whole = fit(record(s))
        mask = fifth_gone(seed)
        part = fit(record({**s, "position": without(s["position"], mask),
                           "speed": without(s["speed"], mask)}))  # fmt: skip
        for name, true in TRUE.items():
            p = part.parameter(name)
            total += ((p.value - true) / p.std_error) ** 2
            widths.append(p.std_error / whole.parameter(name).std_error)
    assert 24 - 3 * 7 < total < 24 + 3.5 * 7
    # sqrt(1 / 0.8) = 1.118. An error bar is one from 1000 samples: it scatters by some per cent,
    # and both share most of it; the mean of 24 is known to two per cent or so.
    assert np.mean(widths) == pytest.approx(np.sqrt(1 / 0.8), abs=0.06)


def test_what_was_deleted_does_not_matter():
    """Numbers under a mask, and samples that are NaN, are one and the same."""
    s, mask = signals(3), fifth_gone(3)
    wild = record({**s, "position": np.where(mask, 1e6, s["position"])})
    one = fit(wild.mark_missing("position", mask))
    two = fit(record({**s, "position": without(s["position"], mask)}))
    for name in TRUE:
        assert one[name] == two[name]
        assert one.parameter(name).std_error == two.parameter(name).std_error


def test_deleting_samples_moves_an_estimate_by_what_their_information_says():
    """Var(theta_part - theta_whole) = P_part - P_whole for an efficient estimate (Hausman 1978)."""
    for seed in range(4):
        s, mask = signals(20 + seed), fifth_gone(seed)
        gone = {n: without(s[n], mask) for n in ("position", "speed")}
        points, covariances = [], []
        for run in (record(s), record({**s, **gone})):
            criterion = SimulationError(
                model(), [casid.Experiment(run)], weights=np.full(2, 1 / SIGMA), substeps=4
            )
            x = np.array([TRUE["k"], TRUE["d"], 0.0, 0.0])
            for _ in range(6):
                at = criterion.evaluate(x)
                x = x - np.linalg.solve(at.hessian, at.gradient)
            points.append(x)
            covariances.append(np.linalg.inv(at.hessian))
        moved, between = points[1] - points[0], covariances[1] - covariances[0]
        statistic = float(moved @ np.linalg.solve(between, moved))
        assert statistic < 18.5  # the 99.9 % quantile of chi^2 of 4


def test_interpolated_gaps_are_overconfident_and_gaps_are_not():
    """Straight lines over three of four samples claim four times the information.

    The error bars of the missing samples are twice as wide, sqrt(4), up to the colour that lines
    between samples have; and theirs cover the truth.
    """
    ratios, inside = [], 0
    for seed in range(8):
        s = signals(40 + seed)
        mask = np.arange(N) % 4 != 0
        gone = record({n: without(s[n], mask) if n != "F" else s[n] for n in s})
        joined = record({**s, **{n: gone.filled(n) for n in ("position", "speed")}})
        claimed, honest = [
            np.linalg.inv(
                SimulationError(
                    model(), [casid.Experiment(run)], weights=np.full(2, 1 / SIGMA), substeps=4
                ).evaluate(np.array([4.0, 0.6, 0.0, 0.0])).hessian
            )[0, 0]
            for run in (joined, gone)
        ]  # fmt: skip
        ratios.append(np.sqrt(honest / claimed))
        p = fit(gone).parameter("k")
        inside += abs(p.value - TRUE["k"]) < 3 * p.std_error
    assert np.mean(ratios) == pytest.approx(2.0, abs=0.1)
    assert inside == 8


# -- several rates --------------------------------------------------------------------------------


def test_a_slow_channel_beside_a_fast_one_counts_at_its_own_samples_alone():
    """The criterion of a file with empty cells is the sum over what was measured, term by term."""
    s = signals(7)
    slow = without(s["position"], np.arange(N) % 10 != 0)
    run = record({**s, "position": slow})
    criterion = SimulationError(
        model(), [casid.Experiment(run)], weights=np.full(2, 1 / SIGMA), substeps=4
    )
    x = np.array([3.5, 0.5, 0.01, 0.0])
    y, _, _ = criterion.simulate(x, 0)
    errors = np.concatenate([(slow - y[:, 0])[::10], s["speed"] - y[:, 1]])
    assert criterion.evaluate(x).value == pytest.approx(0.5 * np.sum((errors / SIGMA) ** 2))
    assert criterion.n_samples == N + N // 10
    estimate = fit(run)
    for name, true in TRUE.items():
        p = estimate.parameter(name)
        assert abs(p.value - true) < 3.5 * p.std_error


# -- inputs ---------------------------------------------------------------------------------------


def test_a_held_input_with_gaps_is_held_and_a_straight_one_is_joined():
    F = np.array([np.nan, 1.0, np.nan, np.nan, 4.0, 5.0, np.nan])
    run = casid.Record({"F": F}, {"F": "N"}, Ts=1.0, missing={"F": np.isnan(F)})
    assert filled(run, "F", "zoh").tolist() == [1, 1, 1, 1, 4, 5, 5]
    assert filled(run, "F", "foh").tolist() == [1, 1, 2, 3, 4, 5, 5]


def test_an_input_of_a_slower_clock_is_what_it_is():
    """A force that moves every tenth sample and is written then alone: held, it is the same."""
    s = signals(11)
    sparse = without(s["F"], np.arange(N) % 10 != 0)
    a, b = fit(record(s)), fit(record({**s, "F": sparse}))
    for name in TRUE:
        assert a[name] == b[name]
    assert any("F has a value in one sample of 10 alone: it is held" in w for w in b.warnings)


def test_gaps_within_a_step_of_a_held_input_are_filled_without_a_warning():
    """Between two equal levels it has not stepped: the verdict is that of the whole record."""
    s = signals(12)
    mask = np.zeros(N, dtype=bool)
    mask[[41, 42, 303, 655]] = True  # within a step of the force
    a, b = fit(record(s)), fit(record({**s, "F": without(s["F"], mask)}))
    for name in TRUE:
        assert a[name] == b[name]
    assert b.warnings == a.warnings
    assert judged_estimate(b).word == judged_estimate(a).word == "usable"
    assert any("F misses 4 samples (0.33 %) in 3 gaps of up to 0.1 s" in p for p in b.provenance)


def test_a_gap_of_a_held_input_between_two_levels_is_filled_with_a_warning():
    """The input may have stepped anywhere in it, which moves estimates by standard errors."""
    s = signals(12)
    mask = np.zeros(N, dtype=bool)
    mask[40] = True  # the first sample of a level
    b = fit(record({**s, "F": without(s["F"], mask)}))
    assert any("F misses 1 sample (0.083 %) in 1 gap of up to 0.05 s" in w for w in b.warnings)
    assert judged_estimate(b).word == "use with care"


def test_filling_errs_by_the_bend_of_an_input_over_the_gap():
    """A sine joined by lines over h is off by a w^2 h^2 / 8 at most; a share s of it by sqrt(s)."""
    w, gaps = 2 * np.pi / 50, np.arange(10, 490, 20)
    mask = np.zeros(500, dtype=bool)
    mask[gaps] = True
    sine = np.sin(w * np.arange(500.0))
    run = casid.Record({"F": without(sine, mask)}, {"F": "N"}, Ts=1.0, missing={"F": mask})
    bound = w**2 * 2**2 / 8 * np.sqrt(gaps.size / 500)
    assert filling_error(run, "F", "foh") == pytest.approx(bound, rel=0.02)
    left = run.filled("F") - sine
    assert np.std(left) / np.std(sine) <= bound
    # Known from one side alone, a sample may be off by as much as the input moves.
    mask = np.arange(500) == 0
    run = casid.Record({"F": without(sine, mask)}, {"F": "N"}, Ts=1.0, missing={"F": mask})
    assert filling_error(run, "F", "foh") == pytest.approx(500**-0.5)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_filling_leaves_no_error_in_an_input_of_one_level(hold):
    """Of a slower clock, too, which has no three samples in a row to show a bend."""
    mask = np.arange(100) % 10 != 0
    level = np.full(100, 0.1)
    run = casid.Record({"F": without(level, mask)}, {"F": "N"}, Ts=1.0, missing={"F": mask})
    assert filling_error(run, "F", hold) == 0.0


def test_inputs_with_the_same_gaps_are_named_together():
    """Rows that a file leaves out are gaps of every input: one sentence says so."""
    m = casid.Model("two forces")
    v = m.state("v", "m/s")
    pushes = [m.input(n, "N", hold="zoh") for n in ("F", "G")]
    m.balance(v, "force", inertia=m.constant("M", 1.0, "kg"), terms=pushes)
    m.output("v", v, "m/s")
    mask = np.zeros(50, dtype=bool)
    mask[[20, 21]] = True
    channels = {"F": np.ones(50), "G": np.ones(50), "v": np.arange(50.0)}
    units = {"F": "N", "G": "N", "v": "m/s"}
    run = casid.Record(channels, units, Ts=1.0, missing={"F": mask, "G": mask})
    (whole,) = with_gaps_treated(m, [casid.Experiment(run, {}, "run")])
    said = [s for s in whole.record.provenance if "F" in s]
    assert said == [
        "remark: F and G miss 2 samples (4 %) in 1 gap of up to 2 s: they are held there"
    ]


def test_a_long_gap_of_an_input_cuts_the_record():
    """Two parts, each with initial states of its own; nothing is simulated over the gap."""
    s = signals(13)
    mask = (np.arange(N) >= 500) & (np.arange(N) < 540)
    run = record({**s, "F": without(s["F"], mask)})
    parts = with_gaps_treated(model(), [casid.Experiment(run, name="run")])
    assert [p.record.N for p in parts] == [500, 660]
    assert [p.name for p in parts] == ["run@0:24.95", "run@27:59.95"]
    estimate = fit(run)
    assert {"x(0)@run@0:24.95", "v(0)@run@27:59.95"} <= {p.name for p in estimate.initial_states}
    assert any("cut at long gaps of F: part 1 of 2" in w for w in estimate.warnings)
    for name, true in TRUE.items():
        p = estimate.parameter(name)
        assert abs(p.value - true) < 3.5 * p.std_error


def test_a_gap_is_long_by_the_intervals_of_its_own_clock():
    mask = np.zeros(100, dtype=bool)
    mask[20 : 20 + INPUT_GAPS.longest - 1] = True
    F = without(np.ones(100), mask)
    assert not long_gaps(record({"F": F, "position": F, "speed": F}), "F").any()
    mask[20 + INPUT_GAPS.longest - 1] = True
    F = without(np.ones(100), mask)
    assert np.array_equal(long_gaps(record({"F": F, "position": F, "speed": F}), "F"), mask)
    slow = np.arange(100) % 10 != 0
    F = without(np.ones(100), slow)
    assert not long_gaps(record({"F": F, "position": F, "speed": F}), "F").any()


def test_between_random_instants_no_interval_is_long():
    """Of 100 exponential intervals 3 exceed five medians, and 0.001 five times their 90 % point."""
    rng = np.random.default_rng(3)
    instants = np.unique(np.cumsum(1 + rng.exponential(10.0, 100).astype(int)))
    F = without(np.ones(instants[-1] + 1), ~np.isin(np.arange(instants[-1] + 1), instants))
    intervals = np.diff(instants)
    assert np.any(intervals > INPUT_GAPS.longest * np.median(intervals))
    assert not long_gaps(record({"F": F, "position": F, "speed": F}), "F").any()


def test_an_input_that_is_mostly_missing_is_refused():
    s = signals(14)
    mask = np.arange(N) % 100 >= INPUT_GAPS.shortest - 10
    with pytest.raises(DataError, match=r"input F misses .* gaps longer .* Cut the record"):
        fit(record({**s, "F": without(s["F"], mask)}))


# -- files ----------------------------------------------------------------------------------------


def write(path: Path, table: dict[str, np.ndarray], rows: np.ndarray | None = None) -> Path:
    rows = np.arange(N) if rows is None else rows
    t = TS * np.arange(N)
    lines = ["t,F,position,speed"]
    for k in rows:
        cells = [float(table[n][k]) for n in ("F", "position", "speed")]
        lines.append(",".join([f"{t[k]:.6f}", *("" if np.isnan(c) else repr(c) for c in cells)]))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_file_with_empty_cells_and_absent_rows_is_read_as_it_is(tmp_path: Path):
    """What is there is what was written, at its own instant."""
    s = signals(15)
    s["position"] = without(s["position"], np.arange(N) % 5 != 0)
    absent = np.array([100, 101, 640])
    rows = np.setdiff1d(np.arange(N), absent)
    problem = casid.Problem("oscillator", model())
    run = problem.read(write(tmp_path / "run.csv", s, rows)).record
    assert run.N == N
    assert run.Ts == pytest.approx(TS)
    assert np.flatnonzero(run.is_missing("speed")).tolist() == absent.tolist()
    assert np.array_equal(run["speed"][rows], s["speed"][rows])
    text = "3 of 1200 rows are absent from an even clock of 0.05 s"
    assert any(text in line for line in run.provenance)
    report = casid.check(tmp_path / "run.csv")
    assert report.is_usable
    texts = {f.channel: f.text for f in report.findings if f.channel}
    assert "one row of 5 alone: a clock of its own, of 0.25 s" in texts["position"]
    assert "3 samples (0.25 %) are missing, in 2 gaps, the longest of 0.1 s" in texts["speed"]


def test_stamps_of_an_irregular_clock_count_where_they_are(tmp_path: Path) -> None:
    """Exact samples at uneven instants: the estimate lies within its error bars at each of them.

    The places are a fifth of the median interval apart: none is more than a tenth of it off. At a
    speed of 1 m/s or less that is an error of 3 mm rms against 20 mm of noise.
    """
    rng = np.random.default_rng(21)
    steps = TS * rng.uniform(0.6, 1.4, N - 1)
    t = np.concatenate([[0.0], np.cumsum(steps)])
    F = np.repeat(rng.standard_normal(N // 10), 10)
    A = np.array([[0.0, 1.0], [-TRUE["k"], -TRUE["d"]]])
    x, out = np.zeros(2), np.empty((N, 2))
    for i in range(N):
        out[i] = x
        if i < N - 1:
            whole = expm(steps[i] * np.block([[A, np.array([[0.0], [1.0]])], [np.zeros((1, 3))]]))
            x = whole[:2, :2] @ x + whole[:2, 2] * F[i]
    noisy = out + SIGMA * rng.standard_normal(out.shape)
    lines = ["t,F,position,speed"]
    lines += [
        f"{time!r},{force!r},{p!r},{v!r}"
        for time, force, (p, v) in zip(t.tolist(), F.tolist(), noisy.tolist(), strict=True)
    ]
    path = tmp_path / "uneven.csv"
    path.write_text("\n".join(lines) + "\n")
    run = casid.Problem("oscillator", model()).read(path).record
    there = ~run.is_missing("position")
    assert np.array_equal(run["position"][there], noisy[:, 0])
    assert np.abs(run.t[there] - t).max() <= 0.1 * np.median(steps) * (1 + 1e-9)
    assert any("every sample counts at its own instant" in line for line in run.provenance)
    estimate = fit(run)
    for name, true in TRUE.items():
        p = estimate.parameter(name)
        assert abs(p.value - true) < 3.5 * p.std_error
