"""Derived channels: exact where theory is, noise carried through, refusals with their mend."""

from __future__ import annotations

import dataclasses
import importlib

import numpy as np
import pytest
from click.testing import CliRunner

import casid
from casid.cli.main import main
from casid.data.derived import Derived, derive, propagated_noise
from casid.data.example_files import write_examples
from casid.data.local_polynomial import LocalPolynomial
from casid.errors import DataError, ModelError

Ts = 0.05


def record(N=400, **more):
    t = Ts * np.arange(N)
    channels = {"v": np.sin(0.7 * t), "psi": 0.1 * t, **more}
    return casid.Record(channels, {n: "m/s" if n == "v" else "rad" for n in channels}, Ts)


RATE = LocalPolynomial(1.0)


def acceleration(r):
    return RATE.apply(r["v"], r.Ts, derivative=1)


ENTRY = Derived("m/s^2", {"v": "m/s"}, acceleration, "d/dt of v", margin=0.5)


# -- the local polynomial --------------------------------------------------------------------------


@pytest.mark.parametrize("derivative", [0, 1, 2, 3])
def test_polynomials_of_its_degree_pass_unchanged_up_to_the_ends(derivative):
    t = Ts * np.arange(60)
    c = np.poly1d([0.3, -1.0, 2.0, 5.0])
    found = LocalPolynomial(1.0, degree=3).apply(c(t), Ts, derivative=derivative)
    expected = c.deriv(derivative)(t) if derivative else c(t)
    # Rounding of values of size 10, divided by the half window to the power of the derivative.
    assert np.abs(found - expected).max() < 1e-12 * 10 / 0.5**derivative * 100


def test_its_taps_are_those_of_savitzky_and_golay():
    """Quadratic over five points: (-3, 12, 17, 12, -3)/35, derivative (-2, -1, 0, 1, 2)/10."""
    five = LocalPolynomial(4 * Ts, degree=2)
    np.testing.assert_allclose(35 * five.taps(Ts), [-3, 12, 17, 12, -3], atol=1e-12)
    np.testing.assert_allclose(10 * Ts * five.taps(Ts, 1), [-2, -1, 0, 1, 2], atol=1e-12)


@pytest.mark.parametrize("derivative", [0, 1])
def test_a_sine_passes_with_the_gain_that_is_told(derivative):
    f = 0.8
    t = Ts * np.arange(800)
    phase = np.exp(2j * np.pi * f * t)
    gain = float(RATE.gain(f, Ts, derivative))
    expected = np.real(gain * (2j * np.pi * f) ** derivative * phase)
    found = RATE.apply(np.real(phase), Ts, derivative=derivative)
    inside = slice(RATE.half(Ts), -RATE.half(Ts))
    assert np.abs(found - expected)[inside].max() < 1e-10
    assert float(RATE.gain(RATE.bandwidth_hz(Ts, derivative), Ts, derivative)) == pytest.approx(
        np.sqrt(0.5), abs=0.01
    )


def test_white_noise_grows_by_the_gain_that_is_told():
    """Within four standard errors; neighbours share up to 21 samples, so N/21 count."""
    e = np.random.default_rng(3).standard_normal(100_000)
    for derivative in (0, 1):
        found = np.std(RATE.apply(e, Ts, derivative))
        expected = np.linalg.norm(RATE.taps(Ts, derivative))
        assert abs(found / expected - 1) < 4 * np.sqrt(21 / (2 * len(e)))


def test_a_window_too_short_is_refused_with_one_that_is_not():
    with pytest.raises(DataError, match=r"take a window of at least 0\.25 s"):
        LocalPolynomial(0.1).apply(np.zeros(50), Ts)
    with pytest.raises(DataError, match="shorter window"):
        LocalPolynomial(1.0).apply(np.zeros(15), Ts)
    with pytest.raises(DataError, match="from 0 to 3"):
        LocalPolynomial(1.0).apply(np.zeros(50), Ts, derivative=4)


# -- derived channels ------------------------------------------------------------------------------


def test_a_derived_channel_is_computed_and_the_ends_that_its_filter_spoils_are_cut():
    before = record()
    after = derive(before, {"a": ENTRY}, {"v": 0.01})
    assert after.N == before.N - 20
    assert after.t0 == pytest.approx(0.5)
    gain = float(RATE.gain(0.7 / (2 * np.pi), Ts, 1))
    np.testing.assert_allclose(after["a"], gain * 0.7 * np.cos(0.7 * after.t), atol=1e-9)
    np.testing.assert_array_equal(after["v"], before["v"][10:-10])
    assert after.units["a"] == "m/s^2"
    assert "a [m/s^2] derived from v: d/dt of v; noise" in "\n".join(after.provenance)


def test_a_record_that_has_the_channel_is_left_alone():
    once = derive(record(), {"a": ENTRY})
    assert derive(once, {"a": ENTRY}) is once


def test_the_noise_of_a_linear_derivation_is_its_noise_gain():
    """Eight draws of N samples that share up to 21: four standard errors of an rms."""
    long = record(4000)
    found = propagated_noise("a", ENTRY, long, {"v": 0.02, "psi": 9.0})
    assert found == pytest.approx(
        0.02 * np.linalg.norm(RATE.taps(Ts, 1)), rel=4 * np.sqrt(21 / (2 * 8 * long.N))
    )
    assert propagated_noise("a", ENTRY, long, {"psi": 9.0}) == 0.0


def test_the_noise_of_a_rotation_is_that_of_both_sources():
    """w = v cos(psi): var = cos^2 var(v) + v^2 sin^2 var(psi), averaged over the record."""
    turned = Derived("m/s", {"v": "m/s", "psi": "rad"}, lambda r: r["v"] * np.cos(r["psi"]))
    r = record(8000)
    sd = {"v": 0.01, "psi": 0.02}
    v, psi = r["v"], r["psi"]
    expected = np.mean((np.cos(psi) * 0.01) ** 2 + (v * np.sin(psi) * 0.02) ** 2)
    found = propagated_noise("w", turned, r, sd)
    assert found**2 == pytest.approx(expected, rel=4 * np.sqrt(2 * 3 / (8 * r.N)))


def test_a_gap_of_a_source_is_one_of_the_derived_channel_as_far_as_its_filter_reaches():
    whole, gap = record(), record().mark_missing("v", np.arange(400) == 107)
    found, other = derive(gap, {"a": ENTRY}), derive(whole, {"a": ENTRY})
    there = ~found.is_missing("a")
    # Ten samples are cut at the beginning; half a second are ten samples.
    assert np.flatnonzero(~there).tolist() == list(range(87, 108))
    np.testing.assert_array_equal(found["a"][there], other["a"][there])
    assert any("a: 21 samples missing, at gaps of v" in line for line in found.provenance)


def test_sources_that_cannot_be_used_are_named_with_the_mend():
    with pytest.raises(DataError, match=r"no v; .*--map v=column"):
        derive(record().without("v"), {"a": ENTRY})
    sparse = record().mark_missing("v", np.arange(400) % 15 != 0)
    with pytest.raises(DataError, match=r"none of a is 0\.5 s away from a gap; give a part"):
        derive(sparse, {"a": ENTRY})
    with pytest.raises(DataError, match="widen the window"):
        derive(record(21), {"a": ENTRY})
    short = Derived("m/s", {"v": "m/s"}, lambda r: r["v"][1:])
    with pytest.raises(DataError, match=r"shape \(399,\).*correct the function"):
        derive(record(), {"a": short})
    with pytest.raises(ModelError, match="needs sources"):
        Derived("m/s", {}, lambda r: r["v"])
    with pytest.raises(ModelError, match="0 without a filter"):
        Derived("m/s", {"v": "m/s"}, lambda r: r["v"], margin=-1.0)


# -- in a problem ----------------------------------------------------------------------------------


def cart():
    m = casid.Model("mass in a stream")
    w = m.state("w", "m/s")
    a = m.input("a", "m/s^2")
    M, c = m.constant("M", 2.0, "kg"), m.parameter("c", "N s/m", start=1.0)
    m.balance(w, "force", inertia=M, terms=[-c * w, M * a])
    m.output("w", w, "m/s")
    return casid.Problem(
        "stream", m, channels={"v": "v_kn:kn"}, derived={"a": ENTRY}, time="t", noise={"v": 0.01}
    )


def table(tmp_path, **columns):
    t = Ts * np.arange(200)
    all_columns = {"t": t, "v_kn": np.sin(t) / 0.514444, "w": 0 * t, **columns}
    path = tmp_path / "run.csv"
    rows = np.column_stack(list(all_columns.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(all_columns), comments="", fmt="%.12g")
    return path


def test_reading_takes_the_sources_in_the_units_of_the_file(tmp_path):
    e = cart().read(table(tmp_path))
    gain = float(RATE.gain(1 / (2 * np.pi), Ts, 1))
    np.testing.assert_allclose(e.record["a"], gain * np.cos(e.record.t), atol=1e-5)
    assert "derived from v" in "\n".join(e.record.provenance)


def test_a_column_mapped_to_the_derived_channel_goes_before(tmp_path):
    path = table(tmp_path, acc=np.full(200, 3.0))
    e = cart().read(path, mapping={"a": "acc:m/s^2"})
    assert np.all(e.record["a"] == 3.0)
    assert "v" not in e.record
    assert e.record.N == 200


def test_a_derived_channel_beside_the_model_is_left_out_where_its_sources_are_absent(tmp_path):
    beside = Derived("rad", {"heading": "rad"}, lambda r: 2 * r["heading"])
    problem = dataclasses.replace(
        cart(), recorded={"twice": "rad"}, derived={"a": ENTRY, "twice": beside}
    )
    assert "twice" not in problem.read(table(tmp_path)).record
    there = problem.read(
        table(tmp_path, heading=np.full(200, 0.5)), mapping={"heading": "heading:"}
    )
    assert np.all(there.record["twice"] == 1.0)


def test_check_requires_no_source_that_reading_does_without(tmp_path, monkeypatch):
    """It checks the columns that `Problem.read` reads: sources of channels beside are optional."""
    beside = Derived("rad", {"heading": "rad"}, lambda r: 2 * r["heading"])
    problem = dataclasses.replace(
        cart(), recorded={"twice": "rad"}, derived={"a": ENTRY, "twice": beside}
    )
    monkeypatch.setattr(importlib.import_module("casid.cli.check"), "load", lambda path: problem)
    checked = CliRunner().invoke(main, ["check", str(table(tmp_path)), "--problem", "stream.py"])
    assert (checked.exit_code, checked.stderr) == (0, "")
    assert list(problem.columns_in(["t", "v_kn", "w"])) == ["v", "w"]


def test_a_record_in_hand_gets_its_derived_channels_too():
    r = record().with_channel("w", np.zeros(400), "m/s")
    assert "a" in cart().experiment(r).record


def test_what_a_problem_may_not_derive_is_refused():
    with pytest.raises(ModelError, match=r"derived channel 'b' is no input or output.*a, w"):
        dataclasses.replace(cart(), derived={"b": ENTRY}, channels={}, noise={})
    chain = {"a": Derived("m/s^2", {"w": "m/s"}, acceleration), "w": ENTRY}
    with pytest.raises(ModelError, match="compute 'a' from the sources of 'w'"):
        dataclasses.replace(cart(), derived=chain, channels={}, noise={})


@pytest.mark.parametrize("made", [lambda e: e, lambda e: [e], lambda e: e.record])
def test_an_example_of_one_record_is_written_with_the_sources_of_its_derived_channels(
    tmp_path, made
):
    """A file holds what a channel is derived from, and the example may be one experiment."""
    own = record().rename({"psi": "w"})
    problem = dataclasses.replace(
        cart(), example=lambda: made(casid.Experiment(own)), channels={"v": "v", "w": "w"}
    )
    (path,) = write_examples(problem, tmp_path / "run.csv").values()
    header = path.read_text().split("\n", 1)[0]
    assert header == "t,v,w"
