"""A record is uniform, finite, in SI units, and never changes."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_equal

import casid.data.record as record_module
from casid.data.alignment import Alignment
from casid.data.derived import Derived, derive
from casid.data.experiment import Experiment
from casid.data.missing_samples import some_missing
from casid.data.reading.record_file import read_record
from casid.data.record import Record
from casid.errors import DataError, UnitError


def roll(N: int = 400, t0: float = 0.0, Ts: float = 0.1) -> Record:
    t = Ts * np.arange(N)
    return Record(
        {"phi": np.sin(t), "p": np.cos(t)},
        {"phi": "rad", "p": "rad/s"},
        Ts,
        t0,
        "roll-03",
        provenance=("made",),
    )


def test_a_record_prints_itself_in_one_line():
    assert repr(roll()) == ("<Record roll-03: N = 400, 2 channels (phi, p), Ts = 0.1 s, 40 s long>")


def test_the_report_and_the_page_name_every_channel_unit_and_step():
    for text in (str(roll()), roll()._repr_html_()):
        assert all(word in text for word in ("phi", "rad/s", "made"))


def test_samples_are_copied_and_read_only():
    values = np.zeros(10)
    record = Record({"y": values}, {"y": "1"}, 0.1)
    values[0] = 7.0
    assert record["y"][0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        record["y"][0] = 1.0
    with pytest.raises(TypeError):
        record.channels["z"] = values  # type: ignore[index]


def test_a_record_survives_pickling():
    record = roll().mark_missing("p", np.arange(400) < 3)
    again = pickle.loads(pickle.dumps(record))
    assert repr(again) == repr(record)
    assert all(np.array_equal(again[n], record[n]) for n in record)
    assert again.is_missing("p").sum() == 3
    experiment = pickle.loads(pickle.dumps(Experiment(record, {"M": 22.04})))
    assert dict(experiment.known) == {"M": 22.04}


@pytest.mark.parametrize(
    ("arguments", "what", "mend"),
    [
        (({}, {}, 0.1), "at least one channel", "Give Record"),
        (
            ({"y": np.ones(3), "u": np.ones(4)}, {"y": "1", "u": "1"}, 0.1),
            "y has 3, u has 4",
            "Cut",
        ),
        (({"y": np.ones(1)}, {"y": "1"}, 0.1), "1 sample;", "Widen the window"),
        (({"y": np.ones((2, 3))}, {"y": "1"}, 0.1), r"shape \(2, 3\)", r"values\[:, 0\]"),
        (({"y": ["a", "b"]}, {"y": "1"}, 0.1), "else than numbers", "Convert"),
        (({"y": np.ones(3)}, {}, 0.1), "no unit for y", "'1' where it has none"),
        (({"y": np.ones(3)}, {"y": "1", "u": "1"}, 0.1), "u, which is no channel", "remove"),
        (({"y": np.ones(3)}, {"y": "1"}, 0.0), "Ts = 0.0", "positive number of seconds"),
        (({"y": np.ones(3)}, {"y": "1"}, float("nan")), "Ts = nan", "positive number"),
        (({"y": np.ones(3)}, {"y": "1"}, 0.1, float("inf")), "t0 = inf", "finite number"),
    ],
)
def test_what_is_no_record_is_refused_with_the_mend(arguments, what, mend):
    with pytest.raises(DataError, match=what) as caught:
        Record(*arguments)
    with pytest.raises(DataError, match=mend):
        raise caught.value


def test_a_unit_that_is_not_si_is_refused_with_the_conversion():
    with pytest.raises(DataError, match=r"to_si\(values, 'deg'\).*'rad'"):
        Record({"phi": np.ones(3)}, {"phi": "deg"}, 0.1)
    with pytest.raises(UnitError, match="ambiguous"):
        Record({"phi": np.ones(3)}, {"phi": "g"}, 0.1)


def test_samples_that_are_not_finite_are_refused_with_number_place_and_time():
    values = np.zeros(10)
    values[[4, 6, 7]] = np.nan, np.inf, np.nan
    with pytest.raises(DataError, match=r"y holds 3 .*\(2 NaN, 1 Inf\)") as caught:
        Record({"y": values}, {"y": "1"}, 0.5, t0=10.0)
    message = str(caught.value)
    assert "k = 4 (t = 12 s)" in message
    assert "record.between(t0, t1)" in message
    assert "missing" in message


def test_samples_that_are_not_finite_are_welcome_where_marked_missing():
    values = np.array([0.0, np.nan, 2.0, 3.0])
    record = Record({"y": values}, {"y": "1"}, 1.0, missing={"y": ~np.isfinite(values)})
    assert record.filled("y").tolist() == [0.0, 1.0, 2.0, 3.0]
    with pytest.raises(DataError, match="which is no channel.*remove the mask"):
        Record({"y": np.ones(4)}, {"y": "1"}, 1.0, missing={"u": np.zeros(4, dtype=bool)})
    with pytest.raises(DataError, match=r"Give a bool array of shape \(4,\)"):
        Record({"y": np.ones(4)}, {"y": "1"}, 1.0, missing={"y": np.zeros(3, dtype=bool)})
    gone = roll().mark_missing("p", np.ones(400, dtype=bool))
    with pytest.raises(DataError, match=r"every sample of p is missing.*without\('p'\)"):
        gone.filled("p")


def test_constant_channels_are_named_not_refused():
    record = Record({"y": np.ones(5), "u": np.arange(5.0)}, {"y": "1", "u": "1"}, 1.0)
    assert record.constant_channels() == ("y",)


@given(t0=st.floats(-1e4, 1e4), first=st.integers(0, 100), length=st.integers(1, 200))
def test_a_window_is_equivariant_to_the_origin_of_time(t0, first, length):
    """Moving the clock moves the window, and not the samples it keeps."""
    still, moved = roll(), roll(t0=t0)
    start, stop = 0.1 * first, 0.1 * (first + length)
    a, b = still.between(start, stop), moved.between(t0 + start, t0 + stop)
    assert a.N == b.N == length + 1
    assert np.array_equal(a["phi"], b["phi"])
    assert b.t0 - t0 == pytest.approx(a.t0, abs=1e-9)
    assert np.allclose(b.t, moved.t[first : first + length + 1], rtol=0, atol=1e-9)


def test_a_window_remembers_its_parent_and_keeps_masks_in_step():
    mask = np.zeros(400, dtype=bool)
    mask[105] = True
    cut = roll().mark_missing("p", mask).between(10.0, 20.0)
    assert cut.name == "roll-03@10:20"
    assert cut.provenance[-1] == "window 10:20 s: samples 100 to 200"
    assert np.flatnonzero(cut.is_missing("p")).tolist() == [5]
    assert roll().between(-np.inf, 1.0).N == 11


def test_the_end_of_a_record_is_where_its_length_says() -> None:
    """N samples last N Ts: `check` prints that length, and the last sample a sample before it."""
    record = roll()
    end = record.t0 + record.N * record.Ts
    assert record.between(record.t0, end).N == record.N
    with pytest.raises(DataError, match="outside the record"):
        record.between(record.t0, end + 0.1 * record.Ts)


@pytest.mark.parametrize(
    ("window", "what", "mend"),
    [((50.0, 60.0), "outside", "0 to 39.9 s"), ((3.0, 2.0), "backward", "earlier time first"),
     ((1.01, 1.05), "keeps 0 samples", "Widen"), ((float("nan"), 3.0), "empty", "earlier")],
)  # fmt: skip
def test_a_bad_window_is_refused_with_the_record_s_own_span(window, what, mend):
    with pytest.raises(DataError, match=what) as caught:
        roll().between(*window)
    assert mend in str(caught.value)
    assert "runs from 0 to 39.9 s of its own clock" in str(caught.value)


def test_changes_give_new_records_that_say_what_was_done():
    record = roll()
    more = record.with_channel("delta", np.full(400, 180.0), "deg")
    assert more["delta"][0] == pytest.approx(np.pi)
    assert more.units["delta"] == "rad"
    assert "delta" not in record
    assert more.without("p").names == ("phi", "delta")
    renamed = more.rename({"p": "gyro"})
    assert renamed.names == ("phi", "gyro", "delta")
    assert renamed.units["gyro"] == "rad/s"
    assert "renamed p to gyro" in renamed.provenance
    assert len(renamed.provenance) == 3


def test_changes_that_cannot_be_made_are_refused():
    record = roll()
    with pytest.raises(DataError, match="it holds phi, p; did you mean 'phi'"):
        record["ph"]
    with pytest.raises(DataError, match="3 samples, the record 400.*Resample"):
        record.with_channel("y", np.ones(3), "1")
    with pytest.raises(DataError, match="name phi to two channels.*different names"):
        record.rename({"p": "phi"})
    with pytest.raises(DataError, match="at least one channel"):
        record.without("p", "phi")
    with pytest.raises(DataError, match="no channel 'q'"):
        record.without("q")


def test_a_load_case_holds_finite_numbers():
    experiment = Experiment(roll(), {"M": 22})
    assert experiment.name == "roll-03"
    assert "M = 22" in repr(experiment)
    with pytest.raises(DataError, match="known value M = 'heavy'.*number in the unit"):
        Experiment(roll(), {"M": "heavy"})  # type: ignore[dict-item]
    with pytest.raises(DataError, match="needs a Record.*read_record"):
        Experiment({"phi": 1})  # type: ignore[arg-type]


def test_the_order_of_channels_is_the_caller_s_and_changes_nothing():
    record = roll()
    turned = Record(
        dict(reversed(record.channels.items())), record.units, record.Ts, name=record.name
    )
    assert turned.names == ("p", "phi")
    assert np.array_equal(turned.between(3, 9)["p"], record.between(3, 9)["p"])


@pytest.mark.parametrize(("marked", "said"), [(1, "1 sample"), (3, "3 samples")])
def test_one_sample_is_not_said_in_the_plural(marked, said):
    record = roll()
    gone = np.arange(record.N) < marked
    made = record.mark_missing("phi", gone)
    assert made.provenance[-1] == f"{said} of phi marked missing"
    verb = "is" if marked == 1 else "are"
    assert f"%) {verb} missing, in 1 gap, the longest" in some_missing(made, "phi").text


def test_all_that_is_made_of_a_record_is_on_its_clock():
    """Windows, filtered and renamed: a step at an instant of one is one of all."""
    t = 0.1 * np.arange(400)
    own = Record({"x": np.sin(t)}, {"x": "m"}, Ts=0.1)
    made = [
        own.between(10.0, 20.0).between(12.0, 14.0),
        own.lowpass(1.0),
        own.decimate(2),
        own.detrend(1),
        own.with_channel("y", t, "m").mark_missing("y", t > 30.0).rename({"y": "z"}).without("x"),
    ]
    assert {record.clock for record in made} == {own.clock}
    assert pickle.loads(pickle.dumps(made[0])).clock == own.clock
    assert Record({"x": np.cos(t)}, {"x": "m"}, Ts=0.1).clock != own.clock
    assert Record({"x": np.sin(t)}, {"x": "m"}, Ts=0.1, t0=40.0).clock != own.clock


def test_a_record_of_arrays_names_its_clock_once_for_all_windows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The name is a digest of every sample."""
    named: list[str] = []
    of_samples = record_module._clock_of

    def counted(record: Record) -> str:
        named.append(record.name)
        return of_samples(record)

    monkeypatch.setattr(record_module, "_clock_of", counted)
    record = roll()
    windows = [record.between(1.0, 2.0), record.between(5.0, 8.0)]
    assert {made.clock for made in windows} == {record.clock}
    assert named == ["roll-03"]


def full() -> Record:
    """A record whose every field is another than the default."""
    t = 12.0 + 0.1 * np.arange(400)
    gone = {"x": t > 50.0}
    return Record(
        {"x": np.sin(t), "v": np.cos(t)},
        {"x": "m", "v": "m/s"},
        0.1,
        12.0,
        "run",
        gone,
        ("made",),
        {"v": 0.01 * np.sin(3 * t)},
        "clock of the run",
    )


def merged(record: Record) -> Record:
    other = record.without("v").rename({"x": "theirs"})
    offset = Alignment(0.0, 0.01, 1.0, 0.1, 40.0, record.name, "other", "x", "theirs")
    return offset.apply(record, other)


SAMPLES = {"channels", "missing", "late"}
OPERATIONS: dict[str, tuple[Callable[[Record], Record], set[str]]] = {
    "a window": (lambda r: r.between(20.0, 30.0), {*SAMPLES, "t0", "name"}),
    "a channel more": (lambda r: r.with_channel("a", np.ones(r.N), "m"), {"channels", "units"}),
    "a channel less": (lambda r: r.without("x"), {"channels", "units", "missing"}),
    "another name": (lambda r: r.rename({"x": "y"}), {"channels", "units", "missing"}),
    "a mark": (lambda r: r.mark_missing("v", r["v"] > 0.9), {"missing"}),
    "without its mean": (lambda r: r.detrend(), {"channels"}),
    "filtered": (lambda r: r.lowpass(1.0), {*SAMPLES, "t0"}),
    "every second sample": (lambda r: r.decimate(2), {*SAMPLES, "t0", "Ts"}),
    "merged": (merged, {"channels", "units", "name", "missing"}),
    "a channel derived": (
        lambda r: derive(r, {"double": Derived("m/s", {"v": "m/s"}, lambda r: 2 * r["v"])}),
        {"channels", "units"},
    ),
    "a channel derived by a filter": (
        lambda r: derive(r, {"a": Derived("m/s", {"v": "m/s"}, lambda r: r["v"], margin=1.0)}),
        {*SAMPLES, "units", "t0"},
    ),
}


@pytest.mark.parametrize("operation", OPERATIONS)
def test_what_is_made_of_a_record_keeps_all_that_it_does_not_change(operation: str) -> None:
    record, (make, changes) = full(), OPERATIONS[operation]
    made = make(record)
    for name in {f.name for f in fields(Record)} - {*changes, "provenance"}:
        assert_equal(dict(content(made, name)), dict(content(record, name)), name)
    assert made.provenance[:1] == record.provenance


def content(record: Record, name: str) -> Mapping[str, object]:
    value = getattr(record, name)
    return value if isinstance(value, Mapping) else {name: value}


def test_a_sample_that_stays_keeps_by_how_much_it_is_late() -> None:
    record = full()
    for made in (merged(record), OPERATIONS["a channel derived by a filter"][0](record)):
        first = round((made.t0 - record.t0) / record.Ts)
        assert_equal(made.late["v"], record.late["v"][first : first + made.N])


def test_windows_of_a_file_are_on_one_clock_and_another_file_is_on_its_own(tmp_path: Path):
    rows = [f"{0.1 * k:.1f},{k % 7},{k + 0.5}" for k in range(100)]
    run, copy, longer = (tmp_path / f"{name}.csv" for name in ("run", "copy", "longer"))
    for path, last in ((run, 100), (copy, 100), (longer, 99)):
        path.write_text("\n".join(["t,a,b", *rows[:last]]) + "\n")
    first = read_record(f"{run}@0:4", {"a": "a"})
    later = read_record(f"{run}@5:9", {"b": "b"})
    assert first.clock == later.clock == read_record(copy).clock
    assert read_record(longer).clock != first.clock
    assert read_record(run, {"a": "a"}, time="b").clock != first.clock
