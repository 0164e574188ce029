"""Clocks that do not run evenly are refused, resampled on request, or read as even."""

from __future__ import annotations

import re

import numpy as np
import pytest

from casid.data.reading.clocks.even_clock import even_step, time_faults
from casid.data.reading.clocks.resampling import resample
from casid.data.reading.record_file import read_record
from casid.errors import DataError
from casid.model.quantities import window_text
from tests.support.text_tables import T, rows


def test_irregular_sampling_is_refused_with_numbers_and_an_offer(csv):
    times = T + 0.002 * (np.arange(50) % 2)
    with pytest.raises(DataError, match="irregular.*min 0.098, median 0.102, max 0.102") as caught:
        read_record(csv(rows(times)))
    assert "% of them outside 1 % of the median" in str(caught.value)
    assert "resample=0.102" in str(caught.value)
    assert "--resample 0.102" in str(caught.value)


def test_one_percent_of_the_median_is_the_bar():
    steps = np.full(100, 0.1)
    steps[50] = 0.1009
    assert time_faults(np.cumsum(steps), "run") == []
    steps[50] = 0.1011
    assert [f.kind for f in time_faults(np.cumsum(steps), "run")] == ["irregular"]


def test_a_few_uneven_intervals_are_jitter_where_the_stamps_stay_on_the_grid(csv):
    """One interval in 3000 is 1.5 % long: the record is off its clock by 0.015 samples at most."""
    steps = np.full(3000, 0.01)
    steps[1200] = 0.01015
    times = np.concatenate([[0.0], np.cumsum(steps)])
    assert time_faults(times, "run") == []
    record = read_record(csv(rows(times)))
    assert record.Ts == pytest.approx(0.01, rel=1e-5)
    assert any("1 of 3000 intervals are up to 1.5 % off" in line for line in record.provenance)
    steps[::200] = 0.0112  # as rare, but the stamps leave the grid by a sample
    assert [f.kind for f in time_faults(np.cumsum(steps), "run")] == ["irregular"]


def test_a_gap_is_refused_with_its_place_and_the_longest_stretch(csv):
    times = np.concatenate([T[:20], T[20:] + 2.0])
    path = csv(rows(times))
    with pytest.raises(DataError, match=r"1 gap longer.*2\.1 s from t = 1\.9 s") as caught:
        read_record(path)
    assert "window 4:6.9" in str(caught.value)
    assert "line 21" in str(caught.value)
    assert read_record(f"{path}@4:6.9").N == 30


def test_resampling_is_asked_for_recorded_and_marks_the_gaps(csv):
    times = np.concatenate([T[:20], T[20:] + 2.0])
    record = read_record(csv(rows(times, times, times)), resample=0.1)
    assert record.Ts == 0.1
    gap = (record.t > 1.96) & (record.t < 3.94)
    assert np.array_equal(record.is_missing("force_N"), gap)
    assert np.allclose(record["force_N"][~gap], record.t[~gap], rtol=0, atol=1e-9)
    assert "resampled by PCHIP onto Ts = 0.1 s" in record.provenance[-1]


def test_a_coarser_grid_is_reached_behind_an_anti_alias_filter(csv):
    rng = np.random.default_rng(3)
    times = 0.01 * np.arange(6000) + rng.uniform(-0.001, 0.001, 6000)
    y = np.sin(2 * np.pi * times) + np.sin(2 * np.pi * 19.0 * times)  # 19 Hz folds to 1 Hz at 20
    text = rows(times, y, header="t,y")
    record = read_record(csv(text), resample=0.05)
    assert record.Ts == pytest.approx(0.05)
    # PCHIP leaves (2 pi f Ts)^2/8 of a 19 Hz wave in error, 18 %, some of it within the band.
    assert np.abs(record["y"] - np.sin(2 * np.pi * record.t)).std() < 0.03
    assert any("decimated" in step for step in record.provenance)


def test_resampling_meets_straight_lines_exactly_and_never_overshoots():
    rng = np.random.default_rng(3)
    t = np.sort(rng.uniform(0, 10, 200))
    grid, line = resample(t, 3.0 * t - 1.0, 0.05)
    assert np.allclose(line, 3.0 * grid - 1.0, rtol=0, atol=1e-10)
    _, step = resample(t, (t > 5).astype(float), 0.01)
    assert step.min() >= 0.0
    assert step.max() <= 1.0
    with pytest.raises(DataError, match="strictly increasing.*drop doubled"):
        resample([0, 0, 1], [1, 2, 3], 0.1)
    with pytest.raises(DataError, match="median interval"):
        resample([0, 1, 2], [1, 2, 3], 9.0)


def test_doubled_stamps_are_refused_even_when_resampling(csv):
    with pytest.raises(DataError, match="stands still once.*drop doubled rows"):
        read_record(csv("t,y\n0,1\n1,2\n1,3\n2,4\n"), resample=1.0)
    with pytest.raises(DataError, match="resample = -1.*positive"):
        read_record(csv("t,y\n0,1\n1,2\n"), resample=-1.0)


def test_a_row_that_is_there_twice_is_read_once(csv):
    """Stamp and values alike it says nothing new; which of two different rows counts is unknown."""
    once = read_record(csv("t,y\n0,1\n1,2\n2,4\n3,5\n"))
    twice = read_record(csv("t,y\n0,1\n1,2\n1,2\n2,4\n3,5\n3,5\n"))
    assert np.array_equal(twice["y"], once["y"])
    assert (twice.Ts, twice.t0, twice.N) == (once.Ts, once.t0, once.N)
    assert any("2 rows repeat the one before" in step for step in twice.provenance)
    assert any("line 4" in step for step in twice.provenance)
    with pytest.raises(DataError, match="stands still 2 times"):
        read_record(csv("t,y\n0,1\n1,2\n1,2\n1,3\n2,4\n"))


@pytest.mark.parametrize(
    ("header", "step"),
    [
        ("ms", 1e-3),
        ("us", 1e-6),
        ("sec", 1.0),
        ("TimeUS", 1e-6),
        ("timeMs", 1e-3),
        ("timestamp_ns", 1e-9),
        ("x-axis [ms]", 1e-3),
        ("X (Second)", 1.0),
    ],
)
def test_a_clock_may_be_called_by_its_unit_or_end_with_it(csv, header, step):
    assert read_record(csv(f"{header},y\n0,1\n1,2\n2,4\n")).Ts == pytest.approx(step)


def test_an_axis_that_is_in_no_unit_of_time_is_no_clock(csv):
    with pytest.raises(DataError, match="no time column"):
        read_record(csv("x-axis [mm],y\n0,1\n1,2\n2,4\n"))


def test_a_clock_called_time_has_precedence_over_a_column_called_by_a_unit(csv):
    record = read_record(csv("time,ms,y\n0,7,1\n1,9,2\n2,8,4\n"))
    assert record.Ts == 1.0
    assert "ms" in record


def test_a_unit_of_two_readings_is_refused_with_the_option_to_copy(csv):
    text = "t,n [1/min]\n0,1\n1,2\n"
    with pytest.raises(DataError, match=re.escape("--map 'speed=n [1/min]:rpm'")):
        read_record(csv(text), {"speed": ("n [1/min]", None, "rad/s")})
    with pytest.raises(DataError, match=re.escape("--map 'mass=m [KN]:UNIT'")):
        read_record(csv("t,m [KN]\n0,1\n1,2\n"), {"mass": "m [KN]"})


def test_what_is_not_finite_is_marked_missing_on_request(csv):
    values = np.sin(T)
    values[[3, 7]] = np.nan, np.inf
    record = read_record(csv(rows(T, values, T)), mark_missing=True)
    assert np.flatnonzero(record.is_missing("phi_deg")).tolist() == [3, 7]
    assert "2 samples of phi_deg not finite, marked missing" in record.provenance


@pytest.mark.parametrize(
    ("times", "step"),
    [
        (np.round(33298 + 0.02 * np.arange(1500), 3), 0.02),
        (np.round(0.0125 * np.arange(800), 3), 0.0125),
        (60.0 * np.arange(50), 60.0),
        (1e-6 * np.arange(0, 3500, 7), 7e-6),
    ],
)
def test_the_step_of_a_clock_has_the_digits_that_its_stamps_determine(times, step):
    assert even_step(times) == step


def test_the_step_of_a_clock_keeps_its_last_stamp():
    """Thirtieths of a second in milliseconds: no rounding moves a stamp by one that it shows."""
    stamps = np.round(np.arange(1000) / 30, 3)
    assert abs(999 * even_step(stamps) - stamps[-1]) <= 0.5e-3
    exact = np.arange(1000) / 30
    assert even_step(exact) == pytest.approx(1 / 30, rel=1e-15)


def test_a_window_is_named_with_the_digits_that_tell_it_apart(csv):
    stamps = 33298 + 0.01 * np.arange(300)
    path = csv("t,y\n" + "".join(f"{t:.2f},{k}\n" for k, t in enumerate(stamps)))
    record = read_record(f"{path}@33298:33298.05")
    assert record.name == "run@33298:33298.05"
    assert record.between(33298.01, 33298.04).name.endswith("@33298.01:33298.04")
    assert window_text(1710404098.0, 1710404110.0) == "1710404098:1710404110"
    assert window_text(-np.inf, 1e-5) == ":0.00001"
    with pytest.raises(DataError, match=r"window 33298.01:33400.5 .* from 33298 to 33298.05"):
        record.between(33298.01, 33400.5)
