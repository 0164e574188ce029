"""Filters are linear, have no phase, and act on all channels alike."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from casid.data.alignment import align
from casid.data.fir_filter import FirFilter, anti_alias, equiripple
from casid.data.record import Record
from casid.errors import DataError

THESIS = dict(cutoff_hz=0.5, Ts=0.01, order=20)  # 21 taps at 100 Hz


def record(N: int = 600, Ts: float = 0.01, **channels: np.ndarray) -> Record:
    t = Ts * np.arange(N)
    values = channels or {"y": np.sin(6.7 * t), "u": np.cos(2.0 * t)}
    return Record(values, dict.fromkeys(values, "1"), Ts)


def test_the_gain_at_dc_is_one_and_the_design_s_own_is_reported():
    fir = equiripple(**THESIS)
    assert fir.taps.size == 21
    assert fir.taps.sum() == pytest.approx(1.0, abs=1e-14)
    assert "gain at DC set from 1.00" in fir.design
    assert "gain at DC      1.000000000" in fir.describe([0.5, 1.07])
    assert "gain at 1.07 Hz" in fir.describe([1.07])


def test_twenty_one_taps_at_100_hz_are_soft_the_roll_resonance_above_the_cutoff_passes():
    """A transition below 27/(14.6 order Ts) = 9.2 Hz is out of reach of 21 taps (Kaiser 1974)."""
    fir = equiripple(**THESIS)
    assert fir.gain(0.5) > 0.98
    assert fir.gain(1.07) > 0.95  # the pendulum's 6.7 rad/s
    assert np.abs(fir.gain(np.linspace(9.8, 50, 200))).max() < 0.02


def test_a_sine_passes_with_the_filter_s_gain_and_no_phase():
    """A symmetric filter has real eigenvalues on exp(i w k): the gain, and nothing else."""
    f = 2.5
    whole = record(y=np.sin(2 * np.pi * f * 0.01 * np.arange(600) + 0.3))
    fir = equiripple(**THESIS)
    filtered = fir.apply(whole)
    assert filtered.t0 == pytest.approx(10 * 0.01)
    assert filtered.N == 580
    expected = float(fir.gain(f)) * whole["y"][10:-10]
    assert np.allclose(filtered["y"], expected, rtol=0, atol=1e-14)


def test_the_impulse_response_is_even():
    y = np.zeros(601)
    y[300] = 1.0
    out = record(601, y=y).lowpass(0.5)["y"]
    assert np.array_equal(out, out[::-1])


def test_one_filter_on_all_channels_preserves_the_regression():
    """y(k) = a y(k-1) + b u(k-1) holds for the filtered signals with the same a and b."""
    rng = np.random.default_rng(3)
    u, y = rng.standard_normal(800), np.zeros(800)
    for k in range(1, 800):
        y[k] = 0.8 * y[k - 1] + 0.5 * u[k - 1]
    r = record(800, y=y, u=u).lowpass(0.5)
    Phi = np.column_stack([r["y"][:-1], r["u"][:-1]])
    a, b = np.linalg.lstsq(Phi, r["y"][1:], rcond=None)[0]
    assert (a, b) == pytest.approx((0.8, 0.5), abs=1e-10)


@settings(max_examples=25)
@given(scale=st.floats(1e-3, 1e3), shift=st.floats(-100, 100))
def test_filtering_commutes_with_a_change_of_units_and_keeps_a_constant(scale, shift):
    y = np.sin(0.067 * np.arange(200))
    plain = record(200, y=y).lowpass(0.5)["y"]
    scaled = record(200, y=scale * y + shift).lowpass(0.5)["y"]
    assert np.allclose(scaled, scale * plain + shift, rtol=0, atol=1e-12 * (scale + abs(shift)))


def test_marks_grow_by_half_the_filter_and_its_steps_are_kept():
    mask = np.zeros(600, dtype=bool)
    mask[300] = True
    values = np.sin(0.02 * np.arange(600))
    values[300] = np.nan
    r = Record({"y": values, "u": np.ones(600)}, {"y": "1", "u": "1"}, 0.01, missing={"y": mask})
    trimmed, kept = r.lowpass(0.5), r.lowpass(0.5, edges="reflect")
    assert np.flatnonzero(trimmed.is_missing("y")).tolist() == list(range(280, 301))
    assert np.flatnonzero(kept.is_missing("y")).tolist() == list(range(290, 311))
    assert not trimmed.is_missing("u").any()
    assert "on all channels; 10 samples trimmed" in trimmed.provenance[-1]
    assert kept.t0 == 0.0
    assert np.array_equal(kept["y"][10:-10], trimmed["y"])


def test_odd_reflection_continues_a_straight_line():
    y = 0.3 * np.arange(100.0) - 4.0
    out = record(100, y=y).lowpass(0.5, edges="reflect")["y"]
    assert np.allclose(out, y, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "what", "mend"),
    [
        (dict(order=21), "order 21", "even order"),
        (dict(cutoff_hz=60.0), "60 Hz", "half the sample rate"),
        (dict(cutoff_hz=-1.0), "-1 Hz", "0 < cutoff_hz < stop_hz < 50 Hz"),
        (dict(stop_hz=0.4), "0.4 Hz", "Choose 0 < cutoff_hz"),
        (dict(order=700), "701 taps", "lower the order"),
        (dict(edges="wrap"), "'wrap'", "'trim' or 'reflect'"),
    ],
)
def test_a_filter_that_cannot_be_is_refused_with_the_mend(options, what, mend):
    with pytest.raises(DataError) as caught:
        record().lowpass(**options)
    assert what in str(caught.value)
    assert mend in str(caught.value)


def test_a_filter_that_would_shift_the_record_is_refused():
    with pytest.raises(DataError, match="symmetric taps"):
        FirFilter(np.array([0.5, 0.5]), 0.01)
    with pytest.raises(DataError, match="symmetric taps"):
        FirFilter(np.array([0.5, 0.3, 0.2]), 0.01)
    with pytest.raises(DataError, match=r"Design it for the record.*Ts=0\.01"):
        equiripple(5.0, 0.001).apply(record())


def test_decimation_keeps_the_band_and_removes_what_would_alias():
    """1 Hz passes; 18 Hz, which 20 Hz sampling would show at 2 Hz, falls by 60 dB."""
    t = 0.01 * np.arange(4000)
    low, high = np.sin(2 * np.pi * 1.0 * t), np.sin(2 * np.pi * 18.0 * t)
    slow = record(4000, low=low, high=high).decimate(5)
    assert slow.Ts == pytest.approx(0.05)
    assert np.allclose(slow["low"], np.sin(2 * np.pi * slow.t), rtol=0, atol=1.5e-3)
    assert np.abs(slow["high"]).max() < 1.5e-3
    assert slow.decimate(1) is slow
    gains = anti_alias(5, 0.01).gain(np.linspace(0, 8, 100))
    assert np.abs(gains - 1).max() < 1.5e-3
    for factor in (0, 2.5, -3):
        with pytest.raises(DataError, match="integer of at least 2"):
            record().decimate(factor)


def test_detrending_removes_what_a_straight_line_explains_and_nothing_else():
    k = np.arange(600)
    wave = np.sin(2 * np.pi * k / 100)
    r = record(y=wave + 3.0 + 0.01 * k, u=np.full(600, 7.0))
    flat = r.detrend(1)
    assert abs(flat["y"].mean()) < 1e-12
    assert abs(flat["y"] @ k) < 1e-6
    assert np.allclose(r.detrend(0)["u"], 0.0, atol=1e-12)
    assert "subtracted from all channels: y" in r.detrend(0).provenance[-1]
    assert np.allclose(flat.detrend(1)["y"], flat["y"], rtol=0, atol=1e-12)
    with pytest.raises(DataError, match="Choose 0"):
        r.detrend(2)


def test_a_mean_is_taken_over_the_samples_that_are_there():
    values = np.ones(50)
    values[7] = 1e6
    mask = np.arange(50) == 7
    r = Record({"y": values}, {"y": "1"}, 1.0, missing={"y": mask}).detrend()
    assert np.allclose(r["y"][~mask], 0.0)


# ---------------------------------------------------------------------- two loggers


def tones(t: np.ndarray) -> np.ndarray:
    """Thirty tones below 4 Hz: a signal that does not repeat."""
    rng = np.random.default_rng(1)
    f, phase = rng.uniform(0.1, 4.0, 30), rng.uniform(0, 2 * np.pi, 30)
    return np.sin(2 * np.pi * np.outer(t, f) + phase).sum(axis=1) / 4


def loggers(offset: float, noise: float, seed: int, Ts: float = 0.01, Ts_other: float = 0.01):
    """A reference and another logger whose clock is `offset` seconds behind, half the scale."""
    rng = np.random.default_rng(seed)
    t, t_other = np.arange(0, 20, Ts), np.arange(0, 19, Ts_other)
    a = tones(t) + noise * rng.standard_normal(t.size)
    b = 0.5 * (tones(t_other + offset) + noise * rng.standard_normal(t_other.size))
    return (
        Record({"accel": a}, {"accel": "m/s^2"}, Ts, name="cart"),
        Record({"accel": b, "gyro": b}, {"accel": "m/s^2", "gyro": "1"}, Ts_other, name="mass"),
    )


@pytest.mark.parametrize("offset", [0.3337, -0.8, 0.0])
def test_without_noise_the_offset_is_found_to_a_thousandth_of_a_sample(offset):
    found = align(*loggers(offset, 0.0, 0), using="accel")
    assert found.offset == pytest.approx(offset, abs=1e-5)
    assert found.peak_correlation > 0.99


def test_loggers_of_different_rates_are_aligned():
    found = align(*loggers(0.3337, 0.0, 0, Ts_other=0.025), using="accel")
    assert found.offset == pytest.approx(0.3337, abs=1e-4)


@pytest.mark.slow
def test_the_standard_error_is_the_spread_over_many_records():
    """Over 80 records the spread is known to 1/sqrt(160) = 8 %, the mean to a ninth of it.

    The standard error of a single record rests on some twenty blocks, hence 10 % more.
    """
    found = [align(*loggers(0.3337, 0.3, seed), using="accel") for seed in range(80)]
    error = np.array([f.offset for f in found]) - 0.3337
    claimed = np.mean([f.std_error for f in found])
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(80)
    assert claimed / error.std() == pytest.approx(1.0, abs=3 * 0.13)


@settings(max_examples=10, deadline=None)
@given(t0=st.floats(-1e3, 1e3), scale=st.floats(0.01, 100))
def test_the_offset_follows_the_clocks_and_not_the_scale(t0, scale):
    a, b = loggers(0.3337, 0.1, 5)
    plain = align(a, b, using="accel")
    moved = Record({"accel": scale * b["accel"]}, {"accel": "m/s^2"}, b.Ts, t0)
    assert align(a, moved, using="accel").offset + t0 == pytest.approx(plain.offset, abs=1e-8)


def test_a_pure_sine_agrees_at_every_period_and_is_refused():
    t = 0.01 * np.arange(2000)
    a, b = record(2000, y=np.sin(6.0 * t)), record(2000, y=np.sin(6.0 * (t + 0.2)))
    with pytest.raises(DataError, match=r"offset is not unique.*does not repeat.*max_offset"):
        a.align(b, using="y")
    bounded = a.align(b, using="y", max_offset=0.4)  # less than half a period
    assert bounded.offset == pytest.approx(0.2, abs=1e-3)


def test_a_turned_sign_is_found_out():
    a, b = loggers(0.3, 0.05, 2)
    turned = b.with_channel("accel", -b["accel"], "m/s^2")
    with pytest.raises(DataError, match="flip one sign"):
        a.align(turned, using="accel")


def test_signals_with_nothing_in_common_are_refused():
    rng = np.random.default_rng(4)
    a, b = record(y=rng.standard_normal(600)), record(y=rng.standard_normal(600))
    with pytest.raises(DataError, match="not unique.*Choose a stretch"):
        a.align(b, using="y")
    with pytest.raises(DataError, match="y is constant.*Choose a channel"):
        a.align(record(y=np.ones(600)), using="y")
    with pytest.raises(DataError, match="no channel 'z'"):
        a.align(b, using="y", other_using="z")


def test_an_alignment_merges_both_records_on_the_first_clock():
    a, b = loggers(0.3337, 0.0, 0)
    both = align(a, b, using="accel").apply(a, b)
    assert both.names == ("accel", "accel_other", "gyro")
    assert both.t0 == pytest.approx(0.34)  # the other starts at 0.3337 s of the first clock
    assert np.allclose(both["accel_other"], 0.5 * both["accel"], rtol=0, atol=1e-3)
    assert "merged at an offset of 0.33" in both.provenance[-1]
    with pytest.raises(DataError, match="share no stretch"):
        align(a, b, using="accel").apply(a, Record(b.channels, b.units, b.Ts, 1e4))
