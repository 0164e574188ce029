"""Files become records in SI units."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from casid.data.reading.chunks import iter_chunks
from casid.data.reading.clocks.even_clock import time_faults
from casid.data.reading.record_file import column_names, read_record
from casid.data.reading.survey import survey
from casid.errors import DataError
from tests.support.shared import shared
from tests.support.text_tables import T, rows


def test_a_header_with_more_names_than_columns_is_not_taken_for_numbers(csv):
    path = csv(rows(np.arange(9.0), header="# time,box temp,P,I,D"))
    with pytest.raises(DataError) as refused:
        read_record(path)
    assert "the header names 5 columns, the rows hold 3 values" in str(refused.value)
    assert "the last names are I, D. Take away the names that have no column" in str(refused.value)


def test_a_comment_above_numbers_is_no_header(csv):
    path = csv(rows(np.arange(9.0), header="# test of 3 May, second run"))
    record = read_record(path, time="column 1")
    assert record["column 2"] == pytest.approx(np.sin(np.arange(9.0)))
    assert any("no line of names" in p for p in record.provenance)


def test_a_file_without_names_is_read_by_the_places_of_its_columns(tmp_path):
    """As programs write it: in columns of even width, with an exponent, a separator at the end."""
    y = np.linspace(20.0, 30.0, 40)
    lines = [f"{2 * k:7.2f}   {9.0:.3f}  {v:.7e}\t" for k, v in enumerate(y)]
    path = tmp_path / "run.dat"
    path.write_text("\n".join(lines) + "\n")
    columns = {"u": "column 2", "T": ("column 3", "degC", "degC")}
    record = read_record(path, columns, time="column 1")
    assert record.Ts == 2.0
    assert record["u"] == pytest.approx(9.0)
    assert record["T"] - 273.15 == pytest.approx(y)
    path.write_text("\n" + "".join(f"{0.1 * k:.1f},{v:.3f},\n" for k, v in enumerate(y)) + "4.0,3")
    record = read_record(path, time="column 1")
    assert list(record) == ["column 2"]
    assert record.N == 41
    path.write_text("\n\n".join(f"{v:.2f}" for v in y))
    assert read_record(path, Ts=0.5)["column 1"] == pytest.approx(y, abs=0.006)


@pytest.mark.parametrize("content", ["#", "# a remark\n# another\n", "\n#\n"])
def test_a_file_of_comments_alone_holds_nothing(tmp_path, content):
    path = tmp_path / "run.csv"
    path.write_text(content)
    with pytest.raises(DataError, match="holds no header and no samples. Export"):
        read_record(path)


def test_a_line_that_counts_the_columns_is_not_taken_for_samples(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("0,1,2\n" + "".join(f"{0.1 * k:.1f},{k},{k * k}\n" for k in range(9)))
    with pytest.raises(DataError, match="the first line holds numbers, not column names"):
        read_record(path)


@pytest.mark.parametrize(("separator", "bom"), [(",", ""), (";", "\ufeff"), ("\t", "\ufeff")])
def test_separator_and_byte_order_mark_change_nothing(csv, separator, bom):
    plain = read_record(csv(rows(T)))
    text = rows(T, header=separator.join(["t", "phi_deg", "force_N"]), separator=separator)
    other = read_record(csv(bom + text, "other.csv"))
    assert all(np.array_equal(plain[n], other[n]) for n in plain)


def test_decimal_commas_are_read_between_semicolons(csv):
    record = read_record(csv("t;y\n0,0;1,5\n0,1;2,5\n0,2;-3,5e1\n"))
    assert record["y"].tolist() == [1.5, 2.5, -35.0]


def test_comments_blank_lines_and_latin_letters_are_read(csv):
    text = "# logger 7\n\nt [ms],Neigung [°]\n0,180\n\n10,180\n20,180\n\n"
    record = read_record(csv(text, encoding="latin-1"))
    assert record["Neigung [°]"].tolist() == pytest.approx([np.pi] * 3)
    assert record.Ts == pytest.approx(0.01)


def test_parquet_and_csv_give_the_same_record(tmp_path, csv):
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    frame = pd.DataFrame({"t": T, "phi_deg": np.sin(T), "force_N": np.cos(T)})
    frame.to_parquet(tmp_path / "run.parquet")
    a, b = read_record(csv(rows(T))), read_record(tmp_path / "run.parquet")
    assert all(np.array_equal(a[n], b[n]) for n in a)
    assert a.Ts == b.Ts
    pieces = list(iter_chunks(tmp_path / "run.parquet", size=7))
    assert np.array_equal(np.concatenate([p["phi_deg"] for p in pieces]), a["phi_deg"])


def test_the_columns_of_a_file_are_named_in_order(csv):
    path = csv(rows(T))
    assert column_names(path) == column_names(f"{path}@1:2") == ("t", "phi_deg", "force_N")
    with pytest.raises(DataError, match="the file is empty"):
        column_names(csv("", "none.csv"))


def test_a_separator_at_the_end_of_every_line_is_no_column(csv):
    record = read_record(csv("t,y\n0,1,\n1,2,\n2,3,\n"))
    assert record.names == ("y",)
    assert record["y"].tolist() == [1.0, 2.0, 3.0]


def test_dates_become_seconds_since_the_first(csv):
    text = "time,y\n2024-05-01T12:00:00.0,1\n2024-05-01T12:00:00.5,2\n2024-05-01T12:00:01.0,3\n"
    path = csv(text)
    assert read_record(path).t.tolist() == [0.0, 0.5, 1.0]
    assert [p["t"].tolist() for p in iter_chunks(path, size=2)] == [[0.0, 0.5], [1.0]]


@pytest.mark.parametrize(
    "form",
    ["%a %b %e %H:%M:%S %Y", "%a %b %d %H:%M:%S CEST %Y", "%a, %d %b %Y %H:%M:%S +0200",
     "%b %d %H:%M:%S %Y", "%b %d, %Y %H:%M:%S", "%A, %d. %B %Y %H:%M:%S",
     "%A, %B %d, %Y %I:%M:%S %p"],
)  # fmt: skip
@pytest.mark.parametrize("name", ["Date", "logged"])
def test_dates_in_words_are_read(tmp_path, form, name):
    moments = [datetime(2019, 4, 3, 21, 46, 7) + timedelta(seconds=90 * k) for k in range(15)]
    path = tmp_path / "run.csv"
    rows = [f"{moment.strftime(form)};{k % 4}" for k, moment in enumerate(moments)]
    path.write_text("\n".join([f"{name};x", *rows]) + "\n")
    record = read_record(path)
    assert (record.Ts, record.N) == (90, 15)
    assert any("first 03 April 2019" in line for line in record.provenance)


def test_time_stamps_that_cannot_be_read_are_not_to_be_declared_missing(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time;x\n" + "".join(f"morning {k};{k}\n" for k in range(5)))
    with pytest.raises(
        DataError, match=r"'morning 0'. Correct the cells: time stamps are"
    ) as error:
        read_record(path)
    assert "--missing" not in str(error.value)


def test_a_file_without_time_stamps_needs_a_sample_time(csv):
    path = csv("y,u\n1,2\n3,4\n")
    assert read_record(path, Ts=0.5).t.tolist() == [0.0, 0.5]
    with pytest.raises(DataError, match=r"no time column.*among y, u.*Ts=0\.01"):
        read_record(path)


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(order=st.permutations([0, 1, 2]))
def test_the_order_of_columns_changes_nothing(csv, order):
    names, columns = ["t", "phi_deg", "force_N"], [T, np.sin(T), np.cos(T)]
    text = rows(*(columns[i] for i in order), header=",".join(names[i] for i in order))
    record, plain = read_record(csv(text)), read_record(csv(rows(T), "plain.csv"))
    assert sorted(record.names) == sorted(plain.names)
    assert all(np.array_equal(record[n], plain[n]) for n in plain)


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(t0=st.floats(-1e5, 1e5), Ts=st.sampled_from([1e-3, 0.02, 0.1, 4.0]))
def test_the_origin_of_time_moves_the_clock_and_nothing_else(csv, t0, Ts):
    """Rounding of the stamps is 2^-53 of 1e5 s: 1e-11 s, far below 1 % of a millisecond."""
    times = t0 + Ts * np.arange(50)
    record = read_record(csv(rows(times)))
    assert record.t0 == times[0]
    assert record.Ts == pytest.approx(Ts, rel=1e-7)
    assert np.array_equal(record["force_N"], np.cos(times))


def test_stamps_rounded_to_single_precision_are_uniform():
    """At 90 s single precision moves a stamp by 4e-6 s, well within 1 % of 0.01 s."""
    times = (0.01 * np.arange(9000)).astype(np.float32).astype(float)
    assert time_faults(times, "run") == []


@pytest.mark.parametrize(
    ("path", "N", "Ts"),
    [
        ("data/cascaded_tanks/estimation.csv", 1024, 4.0),
        ("data/emps/estimation.csv", 24841, 1e-3),
        ("data/kvlcc2_rolldecay_sspa/run_21337.csv", 9166, 0.01),
        ("data/kvlcc2_rolldecay_sspa/run_21338.csv", 19464, 0.01),
        ("data/kvlcc2_marin_free/zz_10.csv", 3844, 0.1353),
        ("data/kvlcc2_marin_free/zz_20.csv", 4481, 0.1353),
        ("data/multiarm_single_pendulum/est_1.csv", 9167, 1e-3),
        ("data/multiarm_single_pendulum/est_2.csv", 9167, 1e-3),
        ("data/multiarm_single_pendulum/est_3.csv", 9167, 1e-3),
        ("data/silverbox/multisine.csv", 50000, 1 / 610.35),
        ("cases/pendulum/case_000.csv", 10562, 0.01),
    ],
)
def test_real_measurements_are_read_as_they_are(path, N, Ts):
    """The sample times are those of the sidecars, given there to four digits."""
    record = read_record(shared(path))
    assert record.N == N
    assert record.Ts == pytest.approx(Ts, rel=5e-4)
    assert not record.missing


@pytest.mark.parametrize("size", [2, 7, 50, 1000])
def test_chunks_joined_are_the_record(csv, size):
    path = csv(rows(T))
    whole, pieces = read_record(path), list(iter_chunks(path, size=size))
    for name in whole:
        assert np.array_equal(np.concatenate([p[name] for p in pieces]), whole[name])
    assert np.array_equal(np.concatenate([p["t"] for p in pieces]), T)
    assert all(p["t"].size <= size for p in pieces)


def test_a_fault_between_two_chunks_is_seen(csv):
    times = np.concatenate([T[:20], T[20:] + 2.0])
    with pytest.raises(DataError, match=r"gap|1 % of 0\.1 s"):
        list(iter_chunks(csv(rows(times)), size=20))
    values = np.sin(T)
    values[33] = np.nan
    with pytest.raises(DataError, match="line 35"):
        list(iter_chunks(csv(rows(T, values, T)), {"phi": "phi_deg"}, size=10))
    with pytest.raises(DataError, match="size of at least 2"):
        next(iter_chunks(csv(rows(T)), size=1))


def test_a_survey_says_what_every_column_is(csv):
    """Also of a file that is no record: here the time stamps stand still."""
    lines = [f"{k // 2},{k},{2 * k + 1},{k if k % 3 == 0 else ''},7,a," for k in range(12)]
    path = csv("t_s,x [mm],twice,slow_V,flat,note,none\n" + "\n".join(lines) + "\n")
    found = survey(path)
    assert found.record is None
    assert found.clock == "t_s"
    kinds = {c.name: c.kind for c in found.columns}
    assert list(kinds.values()) == ["time", *4 * ["numeric"], "text", "empty"]
    named = {c.name: c for c in found.columns}
    assert (named["x [mm]"].unit, named["slow_V"].unit, named["flat"].unit) == ("mm", "V", None)
    assert named["twice"].remarks == ("a copy of column 'x [mm]', up to scale and offset",)
    assert named["slow_V"].remarks == ("8 of 12 rows have no value",)
    assert named["flat"].remarks == ("constant",)


def test_a_slow_column_has_its_own_sample_time(csv):
    lines = [f"{k / 10},{k},{k if k % 5 == 0 else ''}" for k in range(51)]
    found = survey(csv("t,x,slow\n" + "\n".join(lines) + "\n"))
    assert [c.Ts for c in found.columns] == pytest.approx([0.1, 0.1, 0.5])
