"""What a record is worth is told before anything is estimated from it."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from casid.data.channel_quality import quantisation_step
from casid.data.quality import check
from casid.data.record import Record
from casid.errors import DataError
from tests.support.shared import shared

N = 4096
TIME = 0.01 * np.arange(N)


def record(y: np.ndarray, unit: str = "1", **others: np.ndarray) -> Record:
    channels = {"y": y, **others}
    return Record(channels, dict.fromkeys(channels, "1") | {"y": unit}, 0.01, name="run")


def smooth(noise: float = 0.01, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.sin(3.1 * TIME) * np.cos(0.37 * TIME) + noise * rng.standard_normal(N)


def texts(report, channel="y"):
    return [f.text for f in report.findings if f.channel == channel]


def unevenly(values) -> Record:
    """Readings every 20 s to 95 s, as a logger takes them by hand, each at its own instant."""
    t = np.cumsum(np.random.default_rng(1).uniform(20.0, 95.0, len(values))).round()
    return Record.from_signals({"y": (t, values)}, {"y": "K"})


def test_a_sensor_that_is_stuck_or_cut_off_is_seen_on_an_uneven_clock_too():
    """Samples that the clock has none of, between the readings, part no run of equal ones."""
    y = 40 + 10 * np.sin(np.arange(600) / 25) + 0.05 * np.random.default_rng(2).normal(size=600)
    stuck = y.copy()
    stuck[300:380] = stuck[300]
    report = check(unevenly(stuck))
    assert report.channels[0].longest_run == 80
    assert any(text.startswith("80 equal samples in a row") for text in texts(report))
    assert any("possibly clipped" in text for text in texts(check(unevenly(np.minimum(y, 46.0)))))
    sound = check(unevenly(y))
    assert sound.channels[0].longest_run == 1
    assert not any("equal samples" in text for text in texts(sound))


def test_a_sound_record_has_no_findings():
    report = check(record(smooth()))
    assert report.findings == ()
    assert report.is_usable
    assert repr(report) == "<CheckReport run: 0 errors, 0 warnings, 0 notes>"
    assert "findings   none" in str(report)


def test_the_noise_floor_is_the_standard_deviation_of_white_noise():
    """Median of 41 lines, each averaged over 15 segments: 5 % of the density, half of it in sd.

    The median of a mean of chi-squares lies 1/(3 * 15) below its mean, 1 % in sd.
    """
    (y,) = check(record(smooth(noise=0.02))).channels
    assert y.noise == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize("levels", [2, 3, 8, 1000])
def test_a_command_that_rests_at_levels_has_no_noise(levels: int):
    """What its spectrum has at high frequencies are the leaps, here of one every half second."""
    rng = np.random.default_rng(4)
    command = np.repeat(rng.integers(0, levels, N // 50 + 1), 50)[:N] * 0.7
    y, u = check(record(smooth(), u=command)).channels
    assert u.noise is None
    assert y.noise == pytest.approx(0.01, rel=0.1)
    assert json.loads(json.dumps(check(record(command)).to_json()))["channels"][0]["noise"] is None


def test_a_rounded_reading_repeats_and_has_noise_nevertheless():
    """A slow temperature on a grid of 0.1: its noise dithers among neighbouring levels."""
    rng = np.random.default_rng(5)
    slow = np.sin(0.2 * TIME) + 0.01 * rng.standard_normal(N)
    assert check(record(0.1 * np.round(slow / 0.1))).channels[0].noise is not None
    resting = 0.1 * np.round((0.045 + 0.003 * rng.standard_normal(N)) / 0.1)
    assert np.unique(resting).size == 2
    assert check(record(resting)).channels[0].noise is not None


def test_a_smooth_command_that_is_never_held_keeps_its_noise():
    assert check(record(np.round(smooth(), 12))).channels[0].noise is not None


def test_the_bandwidth_is_where_the_signal_sinks_into_the_noise():
    wave = np.sin(2 * np.pi * 7.0 * TIME) + 0.01 * np.random.default_rng(3).standard_normal(N)
    (y,) = check(record(wave)).channels
    assert 6.5 < y.bandwidth_hz < 9.0  # lines of 0.2 Hz, a Hann window four lines wide


def test_a_clipped_signal_is_found_at_its_plateau():
    y = np.clip(smooth(), -0.6, 0.5)
    (finding,) = [f for f in check(record(y)).findings if "clipped" in f.text]
    assert finding.severity == "warning"
    assert "equal samples at the m" in finding.text
    assert "mark the plateau missing" in finding.remedy


def test_the_highest_rest_of_a_profile_of_ramps_is_no_clipping():
    """The speed of a lift is ramped to a level of its own in each trip: one of these is highest."""
    corners = np.repeat([0.0, 0.9, 0.9, 0.0, 0.0, 1.4, 1.4, 0.0, 0.0, -1.2, -1.2, 0.0], 2)[1:-1]
    at = np.cumsum(np.tile([0.7, 2.5], len(corners))[: len(corners)])
    profile = np.interp(TIME, at, corners)
    assert not any("clipped" in t for t in texts(check(record(profile))))
    assert any("equal samples in a row" in t for t in texts(check(record(profile))))
    noisy = np.minimum(profile + 0.01 * smooth(1.0), 1.3)
    assert any("clipped" in t for t in texts(check(record(noisy))))


LET_GO = 0.7 - np.round(3e4 * np.clip(TIME[:80] - 0.101, 0.0, None) ** 2) / 1e4
CUT_OFF = np.minimum(np.sin(1.0 + 3.0 * TIME[:80]), 0.5)


@pytest.mark.parametrize("end", [slice(None), slice(None, None, -1)])
@pytest.mark.parametrize(("y", "is_clipped"), [(LET_GO, False), (CUT_OFF, True)])
def test_motion_from_rest_gathers_speed_and_what_leaves_a_limit_has_its_speed(
    y: np.ndarray, is_clipped: bool, end: slice
) -> None:
    """An arm that is let go, or comes to rest, and a wave at the end of the sensor's range."""
    found = check(record(y[end]))
    assert any("clipped" in t for t in texts(found)) is is_clipped


def test_an_input_that_is_held_throughout_may_be_the_level_after_a_step():
    held = check(record(smooth(), u=np.full(N, 50.0)))
    (finding,) = [f for f in held.findings if f.channel == "u"]
    assert (finding.severity, finding.text) == ("warning", "constant at 50.")
    assert "as after a step at its start" in finding.remedy


def test_the_flat_top_of_a_rounded_wave_is_no_clipping():
    assert not any("clipped" in t for t in texts(check(record(np.round(smooth(0.0), 3)))))


@pytest.mark.parametrize("step", [0.05, 0.002, 1e-4])
def test_the_quantisation_step_is_found(step):
    y = step * np.round(smooth() / step)
    report = check(record(y))
    assert report.channels[0].step == pytest.approx(step, rel=1e-9)
    coarse = any("coarsely quantised" in t for t in texts(report))
    assert coarse == (step > (y.max() - y.min()) / 200)


def test_steps_below_the_noise_are_no_coarse_quantisation():
    """Noise dithers: rounding to 0.05 adds 0.3 % to the rms of noise of 0.2."""
    y = 0.05 * np.round(smooth(noise=0.2) / 0.05)
    report = check(record(y))
    assert report.channels[0].step == pytest.approx(0.05)
    assert not any("coarsely quantised" in t for t in texts(report))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rest_at_zero_is_no_clipping_but_any_other_plateau_is(sign):
    sun = sign * np.clip(smooth(), 0.0, None)
    assert not any("clipped" in t for t in texts(check(record(sun))))
    assert any("equal samples in a row" in t for t in texts(check(record(sun))))
    found = check(record(sun + 1.0)).findings
    assert {f.severity for f in found if "clipped" in f.text} == {"warning"}


def test_the_finer_clock_of_an_irregular_file_is_no_clock_of_a_channels_own(tmp_path):
    """It is said of the file once; a channel that misses rows of the file still says so."""
    rng = np.random.default_rng(4)
    t = np.cumsum(0.25 + 0.02 * rng.uniform(-1, 1, 80))
    lines = [f"{a:.4f},{np.sin(a):.4f},{np.cos(a):.4f}" for a in t]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["t [s],a,b", *lines]))
    report = check(path)
    assert any("the clock is irregular" in f.text for f in report.findings)
    assert not any("clock of its own" in f.text for f in report.findings)
    lines[20:60] = [line.rsplit(",", 1)[0] + "," for line in lines[20:60]]
    path.write_text("\n".join(["t [s],a,b", *lines]))
    assert any("missing" in x or "clock of its own" in x for x in texts(check(path), "b"))
    assert not texts(check(path), "a")


def test_an_irregular_clock_is_judged_by_its_own_samples(tmp_path):
    """Stamps of 0.1 s +- 30 ms; taken as even they would make noise of 3 % of the wave."""
    rng = np.random.default_rng(6)
    t = np.round(0.1 * np.arange(3000) + rng.uniform(-0.03, 0.03, 3000), 3)
    y = 60 * np.sin(2 * np.pi * 0.15 * t) + 0.5 * rng.standard_normal(3000)
    kept = np.ones(3000, dtype=bool)
    kept[1000:1030] = False
    lines = [f"{a:.3f},{b:.4f}" for a, b in zip(t[kept] - t[0], y[kept], strict=True)]
    path = tmp_path / "buoy.csv"
    path.write_text("\n".join(["t,y", *lines]) + "\n")
    report = check(path)
    assert report.channels[0].noise == pytest.approx(0.5, rel=0.5)
    assert report.channels[0].bandwidth_hz < 1.0
    (text,) = [t for t in texts(report) if "a clock of its own" in t]
    assert re.search(r"2970 samples.* about (29|30|31) \(1 %\) are missing in 1 gap, .* 3\.", text)
    assert not any(word in t for t in texts(report) for word in ("stretch", "does not fall"))


@pytest.mark.parametrize("at_random", ["uniform", "exponential"])
def test_nothing_is_missing_between_samples_at_random_instants(tmp_path, at_random):
    """Intervals of a Poisson process are of any length: an eighth exceeds three medians."""
    rng = np.random.default_rng(1)
    t = {
        "uniform": np.sort(rng.uniform(0, 300, 150)),
        "exponential": np.cumsum(rng.exponential(2.0, 200)),
    }[at_random]
    y = 20 + 5 * np.exp(-t / 50) + 0.02 * rng.standard_normal(t.size)
    path = tmp_path / "visits.csv"
    path.write_text("t,y\n" + "".join(f"{a:.3f},{b:.3f}\n" for a, b in zip(t, y, strict=True)))
    said = str(check(path))
    assert "the clock is irregular" in said
    assert "missing" not in said


@pytest.mark.parametrize(
    ("values", "is_told"),
    [
        (np.round(3 * np.sin(np.linspace(0, 20, 500))), True),  # a thermometer of 1 K
        (np.random.default_rng(0).integers(0, 7, 500), False),  # a command of seven levels
        (np.repeat([0.0, 1.0, 2.0, 3.0, 4.0, 5.0], 80), False),  # a staircase, once
        (np.tile(np.repeat([0.0, 1.0], 25), 10), False),  # on and off
    ],
)
def test_a_sensor_of_few_levels_goes_from_each_to_the_next(values, is_told):
    found = check(record(values.astype(float))).findings
    told = [f.remedy for f in found if "single steps of 1" in f.text]
    assert bool(told) is is_told
    assert all("0.289" in remedy for remedy in told)  # 1/sqrt 12


def test_continuous_samples_have_no_step():
    assert check(record(smooth())).channels[0].step is None


@pytest.fixture
def written(tmp_path):
    """A file of two temperatures and a speed of rotation, two of its rows absent."""
    rng = np.random.default_rng(4)
    rows = [
        f"{k},{20 + 0.01 * rng.standard_normal():.4f},{30 + 0.01 * rng.standard_normal():.4f},"
        f"{600 + rng.standard_normal():.2f}"
        for k in range(400)
        if k not in (100, 101)
    ]
    path = tmp_path / "oven.csv"
    path.write_text("\n".join(["t [s],T_in [degC],T_out [degC],n [1/min]", *rows]) + "\n")
    return path


def test_text_shows_the_units_of_the_file_and_json_si_units(written):
    """The rms of a temperature is that about 0 degC, 20 degC for a constant of so much."""
    report = check(written)
    numbers = report.to_json()["channels"][0]
    assert (numbers["unit"], numbers["written"]) == ("K", "degC")
    assert numbers["mean"] == pytest.approx(293.15, abs=0.01)
    (line,) = [row for row in str(report).splitlines() if row.strip().startswith("T_in")]
    cells = line.split()[2:]
    assert cells[0] == "degC"
    assert [float(x) for x in cells[1:5]] == pytest.approx([20.0] * 4, abs=0.05)


def test_a_unit_of_two_readings_keeps_no_number_from_being_judged(written):
    report = check(written)
    assert report.is_usable
    (doubt,) = [f for f in report.findings if "1/min" in f.text]
    assert (doubt.severity, doubt.channel) == ("warning", "n [1/min]")
    assert "--map 'SIGNAL=n [1/min]:rpm'" in doubt.remedy
    speed = next(c for c in report.channels if c.name == "n [1/min]")
    assert speed.mean == pytest.approx(600 * 2 * np.pi / 60, rel=1e-3)


def test_a_unit_that_is_not_in_the_list_is_named(tmp_path):
    path = tmp_path / "pump.csv"
    path.write_text("t [s],insulin [mU/L]\n0,1\n1,2\n2,4\n3,3\n")
    report = check(path)
    assert report.is_usable
    (doubt,) = [f for f in report.findings if "mU/L" in f.text]
    assert "is not in the list of units; numbers as written" in doubt.text


def test_what_is_the_same_of_several_channels_is_said_once(written):
    report = check(written)
    assert sum("are missing" in f.text for f in report.findings) == 3
    (line,) = [row for row in str(report).splitlines() if "are missing" in row]
    assert "T_in [degC], T_out [degC], n [1/min]: 2 samples" in line


def test_isolated_spikes_are_counted_and_placed():
    y = smooth()
    y[[700, 1500, 3000]] += 0.4
    report = check(record(y))
    assert report.channels[0].spikes == 3
    (finding,) = report.findings
    assert "t = 7, 15, 30 s" in finding.text
    assert "mark_missing('y', mask)" in finding.remedy


def test_a_spike_is_no_noise():
    """Its spectrum is flat, and one of 600 times the noise has the power of all noise."""
    y = smooth(noise=0.01)
    y[450] += 6.0
    found = check(record(y)).channels[0]
    assert found.spikes == 1
    assert found.noise == pytest.approx(
        check(record(smooth(noise=0.01))).channels[0].noise, rel=0.02
    )


def test_bends_of_a_slow_response_are_no_spikes():
    """A temperature that rises and falls as the heater is switched, noise far below its slope."""
    rng = np.random.default_rng(2)
    heater = np.repeat(rng.choice([0.0, 1.0], 40), 40)
    y = np.cumsum(heater - 0.5) + 0.05 * rng.standard_normal(heater.size)
    assert check(record(y)).channels[0].spikes == 0


def test_steps_of_an_input_are_no_spikes():
    telegraph = np.sign(np.sin(2.0 * TIME) + 1e-9)
    assert check(record(telegraph)).channels[0].spikes == 0


def test_the_unit_1_is_left_out_of_sentences():
    """Not "steps of 0.1 1", "a trend: 30 1 over the record"."""
    coarse = record(0.1 * np.round(10 * (smooth() + np.linspace(0, 5, N))))
    said = [f"{f.text} {f.remedy}" for f in check(coarse).findings]
    assert any("steps of 0.1, " in text for text in said)
    assert any(re.search(r"a trend: [45]\S* over the record", text) for text in said)
    assert not any(re.search(r"\d 1\b", text) for text in said)


def test_the_last_stamp_is_that_of_the_file_and_of_a_refused_window(tmp_path):
    """The last sample of the even clock that stands for uneven stamps is another one."""
    steps = 0.001 * np.random.default_rng(3).integers(3, 9, 300)
    t = 5.3057 + np.concatenate([[0.0], np.cumsum(steps)])
    path = tmp_path / "run.csv"
    rows = [f"{a:.6f},{np.sin(3 * a):.5f}" for a in t]
    path.write_text("\n".join(["t [s],x", *rows]) + "\n")
    assert f"from t0 = 5.3057 s, the last at {t[-1]:.9g} s" in str(check(path))
    (refused,) = check(path, window=(0.0, 100.0)).findings
    assert f"runs from 5.3057 to {t[-1]:.9g} s" in refused.text


def test_a_stuck_sensor_a_constant_and_a_copy_are_named():
    y = smooth()
    y[1000:1100] = y[1000]
    report = check(record(y, u=np.full(N, 2.5), copy=y))
    assert any("100 equal samples in a row from t = 10 s" in t for t in texts(report))
    assert texts(report, "u") == ["constant at 2.5."]
    assert "holds the same samples as y." in texts(report, "copy")
    assert report.channels[0].longest_run == 100
    assert report.is_usable


def test_an_angle_that_wraps_is_found_and_unwrapped_by_the_mend():
    angle = np.mod(0.9 * TIME + 0.1 * np.sin(TIME), 2 * np.pi)
    (finding,) = [f for f in check(record(angle, "rad")).findings if "wraps" in f.text]
    assert "numpy.unwrap(record['y'])" in finding.remedy
    mended = record(angle, "rad").with_channel("y", np.unwrap(angle), "rad")
    assert not any("wraps" in t for t in texts(check(mended)))


def test_a_step_and_what_follows_it_are_no_trend():
    """A step halfway is 3.5 times its scatter about a line; a response to it as well."""
    step = np.where(np.arange(N) < 0.4 * N, 0.0, 9.0)
    late = np.where(step > 0, 9 * (1 - np.exp(-(TIME - TIME[int(0.4 * N)]) / 0.05)), 0.0)
    for y in (step, late + 0.01 * smooth()):
        assert not any("a trend" in t for t in texts(check(record(y))))
    assert any("a trend" in t for t in texts(check(record(TIME + 0.1 * step))))


def test_a_trend_and_missing_samples_are_noted():
    mask = np.arange(N) < 10
    y = smooth() + 0.2 * TIME
    report = check(record(y).mark_missing("y", mask))
    assert any("a trend: 8.1" in t for t in texts(report))
    assert any(t.startswith("10 samples (0.244 %) are missing, in 1 gap") for t in texts(report))
    assert report.channels[0].missing == 10
    gone = record(y).mark_missing("y", np.ones(N, dtype=bool))
    assert texts(check(gone)) == ["every sample is missing."]


@settings(max_examples=15, deadline=None)
@given(scale=st.sampled_from([1e-6, 0.25, 8.0, 1e5]), sign=st.sampled_from([-1.0, 1.0]))
def test_findings_do_not_depend_on_the_unit(scale, sign):
    y = np.clip(smooth(), -5, 0.5)
    y[700] -= 0.9
    plain, scaled = check(record(y)), check(record(sign * scale * y))
    assert [f.remedy for f in plain.findings] == [f.remedy for f in scaled.findings]
    assert scaled.channels[0].noise == pytest.approx(scale * plain.channels[0].noise, rel=1e-9)
    assert scaled.channels[0].bandwidth_hz == plain.channels[0].bandwidth_hz


def test_all_faults_of_a_file_are_told_at_once(tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text("t,a,b,c\n0,1,1,1\n1,x,2,2\n2,3,,3\n3,4,4,4\n9,5,inf,5\n")
    report = check(path)
    assert not report.is_usable
    errors = [f for f in report.findings if f.severity == "error"]
    assert [f.channel for f in errors] == ["a", "b"]
    assert "line 3: 'x'" in errors[0].text
    assert "1 empty or NaN, 1 Inf" in errors[1].text
    assert any("5 of 10 rows are absent from an even clock" in f.text for f in report.findings)
    assert all(f.remedy for f in errors)
    assert report.clock is not None
    assert report.clock.interval_max == 6.0


def test_a_record_with_one_bad_column_still_has_its_others_looked_at(tmp_path):
    path = tmp_path / "half.csv"
    path.write_text("t,a,b\n" + "".join(f"{k},{'x' if k == 3 else k},{k * k}\n" for k in range(9)))
    report = check(path)
    assert [f.severity for f in report.findings][0] == "error"
    assert [c.name for c in report.channels] == ["b"]


def test_a_file_that_cannot_be_opened_is_a_report_too(tmp_path):
    report = check(tmp_path / "none.csv")
    assert not report.is_usable
    assert report.N is None
    assert "no such file" in str(report)
    with pytest.raises(DataError, match="12:194"):
        check("run.csv@a:b")


def test_a_clock_that_drifts_is_noticed_although_every_interval_is_within_one_percent(tmp_path):
    """An interval that changes by 1 % over 1000 samples bends the grid by a sample and more."""
    times = np.cumsum(np.linspace(0.0995, 0.1004, 1000))
    path = tmp_path / "drift.csv"
    path.write_text("t,y\n" + "".join(f"{t!r},{float(np.sin(t))!r}\n" for t in times.tolist()))
    (finding,) = [f for f in check(path).findings if "drifts" in f.text]
    assert "Resample onto Ts = 0.09995" in finding.remedy


def test_the_report_as_json_is_plain_and_complete():
    data = check(record(np.clip(smooth(), -5, 0.5))).to_json()
    assert data["schema"] == "casid.check/1"
    assert data["N"] == N
    assert data["channels"][0]["name"] == "y"
    assert data["findings"][0]["severity"] == "warning"
    assert json.loads(json.dumps(data, allow_nan=False)) == data


def test_real_measurements_tell_what_is_known_of_them():
    """The tanks' sensor saturates at 10 V; the roll angle comes in steps of 0.005 deg."""
    tanks = check(shared("data/cascaded_tanks/estimation.csv"))
    assert any("maximum 10 V" in t for t in texts(tanks, "y_V"))
    ship = check(shared("data/kvlcc2_rolldecay_sspa/run_21337.csv"))
    roll = next(c for c in ship.channels if c.name == "phi_rad")
    assert roll.step == pytest.approx(np.radians(0.005), rel=1e-3)
    assert tanks.is_usable
    assert ship.is_usable


def test_text_in_one_cell_is_a_fault_beside_a_unit_of_two_readings(tmp_path):
    """1/min may be rpm or rad/min; the column that holds it is looked through all the same."""
    rows = [f"{10 * i};{'ERR' if i == 50 else 100 + i}" for i in range(100)]
    file = tmp_path / "log.csv"
    file.write_text("\n".join(["t [ms];n [1/min]", *rows]) + "\n")
    found = check(file)
    assert not found.is_usable
    assert any("line 52: 'ERR'" in f.text for f in found.findings)


def test_the_step_of_a_sensor_is_found_behind_the_rounding_of_its_print() -> None:
    """Sixteenths of a degree with three decimals: 0.062 and 0.063 from level to level."""
    sixteenths = 400 + np.cumsum(np.random.default_rng(3).integers(1, 11, 80))
    assert quantisation_step(np.round(sixteenths / 16, 3)) == pytest.approx(1 / 16, rel=1e-3)
    shown = np.round(np.concatenate([sixteenths, sixteenths[:40] + 1]) / 16, 3) + 273.15
    assert quantisation_step(shown) == pytest.approx(1 / 16, rel=1e-3)
    assert quantisation_step(np.random.default_rng(4).standard_normal(200)) is None


def test_a_column_that_counts_its_rows_is_no_sensor_that_drifts() -> None:
    """Its scatter about the line is rounding: "1.44e+16 times the scatter" said nothing."""
    (said,) = [t for t in texts(check(record(np.arange(float(N))))) if "over the record" in t]
    assert (
        said
        == "a straight line, 4095 over the record, as of a ramp, a counter of rows, or a clock."
    )
    noisy = np.arange(N) + np.random.default_rng(1).standard_normal(N)
    assert any("a trend" in t for t in texts(check(record(noisy))))
