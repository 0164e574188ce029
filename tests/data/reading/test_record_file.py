"""Files become records in SI units, or are refused with the place and the remedy."""

from __future__ import annotations

import hashlib
import re
from datetime import datetime, timedelta

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from casid.data.quality import check
from casid.data.reading.chunks import iter_chunks
from casid.data.reading.clocks.even_clock import time_faults
from casid.data.reading.clocks.resampling import resample
from casid.data.reading.columns import ColumnSpec
from casid.data.reading.header_units import header_unit
from casid.data.reading.record_file import column_names, read_record
from casid.data.reading.sources import parse_case, parse_source, parse_window
from casid.data.reading.survey import survey
from casid.errors import DataError, UnitError
from tests.support.shared import shared


@pytest.fixture
def csv(tmp_path):
    def write(text: str, name: str = "run.csv", encoding: str = "utf-8"):
        path = tmp_path / name
        path.write_bytes(text.encode(encoding))
        return path

    return write


def rows(times, *columns, header="t,phi_deg,force_N", separator=","):
    """A table as text, every number written so that it reads back to the last bit."""
    lines = [header]
    columns = columns or (np.sin(times), np.cos(times))
    for values in zip(times, *columns, strict=True):
        lines.append(separator.join(repr(float(v)) for v in values))
    return "\n".join(lines) + "\n"


T = np.arange(50) / 10


# ---------------------------------------------------------------------- what is read


def test_a_file_is_read_in_si_units_with_its_history(csv):
    path = csv(rows(T, np.full(50, 180.0), T))
    record = read_record(path)
    assert record.names == ("phi_deg", "force_N")
    assert record["phi_deg"][0] == pytest.approx(np.pi)
    assert dict(record.units) == {"phi_deg": "rad", "force_N": "N"}
    assert record.Ts == pytest.approx(0.1, rel=1e-14)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert f"sha256 {digest}" in record.provenance[0]
    step = "column phi_deg [deg] to phi_deg [rad]: times 0.0174532925; unit from its name"
    assert step in record.provenance


def test_a_name_that_is_a_unit_itself_may_be_in_another_unit(csv):
    """As a product of units, tonne inch second and metre inch kilogram, they named no quantity."""
    path = csv("t in ms,m in kg,h in cm,V in V\n0,1,100,3\n500,2,200,4\n1000,3,300,5\n")
    record = read_record(path)
    assert record.Ts == pytest.approx(0.5)
    assert dict(record.units) == {"m in kg": "kg", "h in cm": "m", "V in V": "V"}
    assert record["h in cm"].tolist() == [1.0, 2.0, 3.0]


def test_a_unit_that_a_column_s_name_ends_in_stands_once(csv):
    record = read_record(csv(rows(np.arange(9.0), header="Zeit [s],u [V],kraft_N")))
    said = "; ".join(record.provenance)
    assert "time column Zeit [s];" in said
    assert "column u [V] to u [V];" in said
    assert "column kraft_N [N] to kraft_N [N];" in said


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


def test_columns_are_mapped_with_their_own_units(csv):
    path = csv(rows(T, np.full(50, 180.0), np.full(50, 2.0), header="t,roll,pull"))
    record = read_record(
        path, {"phi": ColumnSpec("roll", "deg", "rad"), "f": ("pull", "kN", "N"), "g": "pull"}
    )
    assert record["phi"][3] == pytest.approx(np.pi)
    assert record["f"][3] == 2000.0
    assert record.units["g"] == "1"


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
    ("column", "unit"),
    [("phi_rad", "rad"), ("q_meas_m", "m"), ("u_V", "V"), ("p_degps", "degps"), ("n_rpm", "rpm"),
     ("v [m/s]", "m/s"), ("u (V)", "V"), ("x_g", None), ("x_bar", None), ("a_s", None),
     ("x_min", None), ("y", None), ("x []", "1"), ("u_ms", None), ("T [degC]", "degC"),
     ("u [Volt]", "V"), ("v (Meters per Second)", "m/s"), ("M in Newton metre", "N m"),
     ("p [Kilopascal]", "kPa"), ("T [Degree Celsius]", "degC"), ("m [Pound]", None),
     ("x_Second", None), ("x_Bar", None), ("h (in cm)", "cm"), ("h(t) (in cm)", "cm"),
     ("h(t) [mm]", "mm"), ("t (in sec)", "sec"), ("h (in)", "in"), ("h (in in)", "in"),
     ("P [in W (mean)]", None), ("M (in lbf)", None), ("phi [deg] (filtered)", "deg")],
)  # fmt: skip
def test_the_ending_of_a_name_gives_the_unit_where_it_has_one_reading(column, unit):
    found = header_unit(column)
    assert (found.unit if found else None) == unit


@given(
    name=st.sampled_from(["v", "pitch_rate", "q_in", "T_2"]),
    above=st.sampled_from(["deg", "m", "m3", "m^3", "kg", "N*m", "kN", "J", "m²", "rad"]),
    below=st.sampled_from(["s", "min", "h", "s^2", "s²", "ms"]),
)
def test_a_quotient_behind_the_last_underscore_is_one_unit(name, above, below):
    """A name ends at its last underscore: what stands behind a slash is a part of a unit."""
    found = header_unit(f"{name}_{above}/{below}")
    assert found is not None
    assert (found.unit, found.stem) == (f"{above}/{below}", name)


@pytest.mark.parametrize(
    ("column", "unit", "stem"),
    [("T_N*m", "N*m", "T"), ("A_m²", "m²", "A"), ("a_m^2", "m^2", "a"), ("Q_kJ/kg", "kJ/kg", "Q"),
     ("n_1/min", None, "n"), ("q_l/min", "l/min", "q"), ("i_a/mA", "mA", "i_a"),
     ("T_in/degC", "degC", "T_in"), ("u_d/V", "V", "u_d"), ("x_1/m", "m", "x_1"),
     ("dp_dt/Pa", "Pa", "dp_dt")],
)  # fmt: skip
def test_a_compound_ending_is_a_unit_and_an_index_before_a_slash_is_none(column, unit, stem):
    """n_1/min has two readings, as n [1/min] has; an index before a unit stays in the name."""
    found = header_unit(column)
    assert found is not None
    assert (found.unit, found.stem) == (unit, stem)


@pytest.mark.parametrize("name", ["q", "H(t)", "omega_1"])
@pytest.mark.parametrize("unit", ["deg/s", "m/s^2", "N m"])
@pytest.mark.parametrize("between", ["/", " / ", " /"])
def test_a_quotient_of_quantity_and_compound_unit_has_brackets_around_the_unit(name, unit, between):
    """ISO 80000-1 writes the heading of a column as q/(deg/s): the slash is no part of the name."""
    found = header_unit(f"{name}{between}({unit})")
    assert found is not None
    assert (found.unit, found.stem, found.is_sure) == (unit, name, True)


@pytest.mark.parametrize("unit", ["W/m^2", "degC", "km/h", "l/min", "m³/h", "Meter per second"])
@pytest.mark.parametrize("between", [" in ", ", in "])
def test_the_word_in_between_name_and_unit_belongs_to_neither(unit, between):
    """Also where the unit is a quotient, whose slash alone would tell it from the name."""
    found = header_unit(f"solar radiation{between}{unit}")
    assert found is not None
    assert (found.text, found.stem, found.is_sure) == (unit, "solar radiation", True)


# ---------------------------------------------------------------------- the measurements


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


# ---------------------------------------------------------------------- sources and windows


def test_a_source_may_carry_its_window_and_load_case():
    path, window = parse_source("run.csv@12:194")
    assert (path.name, window) == ("run.csv", (12.0, 194.0))
    assert parse_source("run.csv") == (path, None)
    assert parse_source("run.csv@12:")[1] == (12.0, np.inf)
    assert parse_source("a@b/run.csv@:3")[1] == (-np.inf, 3.0)
    assert parse_source("me@home.csv")[1] is None
    assert parse_case("nominal=a.csv@1:2") == ("nominal", parse_source("a.csv")[0], (1.0, 2.0))
    assert parse_case("a.csv")[0] is None


@pytest.mark.parametrize(
    ("text", "remedy"),
    [("run.csv@a:3", "12:194"), ("run.csv@5:5", "earlier time first"), ("run.csv@9:3", "earlier"),
     ("run.csv@12", "12: and :194"), ("@1:2", "run.csv@12:194"), ("run.csv@1:2:3", "12:194")],
)  # fmt: skip
def test_a_window_that_cannot_be_read_is_refused_with_an_example(text, remedy):
    with pytest.raises(DataError) as caught:
        parse_source(text)
    assert remedy in str(caught.value)


def test_an_empty_load_case_is_refused():
    with pytest.raises(DataError, match="nominal=run.csv"):
        parse_case("=a.csv")
    with pytest.raises(DataError, match="Write it as 12:194"):
        parse_window("x")


def test_only_what_is_inside_the_window_is_judged(csv):
    values = np.sin(T)
    values[3] = np.nan
    path = csv(rows(T, values, T))
    with pytest.raises(DataError, match="not finite"):
        read_record(path)
    record = read_record(f"{path}@1:2")
    assert (record.N, record.t0, record.name) == (11, 1.0, "run@1:2")
    assert read_record(path, window=(1.0, np.inf)).N == 40


def test_a_window_outside_the_record_is_refused_with_the_record_s_own_span(csv):
    path = csv(rows(T))
    for window in ("3:9", "-5:2", "7:9"):
        with pytest.raises(DataError, match="outside the record.*from 0 to 4.9 s") as caught:
            read_record(f"{path}@{window}")
        assert "leave an end open" in str(caught.value)
    with pytest.raises(DataError, match="keeps 1 sample[;].*Widen"):
        read_record(f"{path}@1:1.01")


# ---------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("text", "what", "remedy"),
    [
        ("", "the file is empty", "Export the measurement again"),
        ("\n\n", "no header and no samples", "Export the measurement again"),
        ("t,y\n", r"a header \(t, y\) and no samples", "Export the measurement again"),
        ("0,1\n1,2\n2,3\n", "no time column.*no line of names", "--map t=COLUMN"),
        ("t,y\n0,1\n", "1 sample; a record needs at least 2", "longer file"),
        ("t,y\n0,1,2\n1,2,3\n", "names 2 columns, the first row holds 3", "Give every column"),
        ("t,y\n0,1\n1,2,3,4\n2,3\n", "table is broken.*line 3", "as many values"),
        ("t,y\n0,a\n1,b\n", "no column of numbers", "with measurements"),
        ("t,y\n0,1\nx,2\n2,3\n", "'t'.*holds text in 1 of 3 cells.*line 3: 'x'", "Correct"),
        ("t,y\n0,1\n,2\n2,3\n", r"'t'.*1 empty or NaN, 0 Inf.*line 3", "give Ts"),
        ("t,y\n0,1\n1,off\n\n2,x\n", "'y'.*text in 2 of 3 cells.*line 3: 'off'", "Correct"),
        ("t,y\n0,1\n\n1,\n2,inf\n", r"'y'.*2 samples.*1 empty or NaN, 1 Inf.*line 4", "mark_miss"),
        (
            "t,y\n0,1\n1,2\n1,3\n0,2\n2,4\n",
            "stands still once.*runs backward once.*line 4",
            "Sort",
        ),
    ],
)
def test_a_file_that_is_no_record_is_refused_with_place_and_remedy(csv, text, what, remedy):
    with pytest.raises(DataError, match=f"(?s){what}") as caught:
        read_record(csv(text), {"y": "y"} if "off" in text else None)
    assert remedy in str(caught.value)
    assert "run.csv" in str(caught.value)


def test_a_path_that_is_no_file_is_refused_with_the_nearest(csv, tmp_path):
    csv(rows(T), "roll_21337.csv")
    with pytest.raises(DataError, match="Did you mean 'roll_21337.csv'"):
        read_record(tmp_path / "roll_2133.csv")
    with pytest.raises(DataError, match="The folder holds roll_21337.csv"):
        read_record(tmp_path / "zz.parquet")
    with pytest.raises(DataError, match="is a folder.*one of its files: roll_21337.csv"):
        read_record(tmp_path)
    with pytest.raises(DataError, match="there is no folder.*Check the path"):
        read_record(tmp_path / "nowhere" / "a.csv")


def test_columns_of_one_name_are_told_apart_by_their_numbers(csv):
    path = csv("t,y,y\n0,1,2\n1,2,3\n")
    assert read_record(path)["y#3"].tolist() == [2.0, 3.0]
    with pytest.raises(DataError, match="more than one column is named 'y'.*--map v=y#2"):
        read_record(path, {"v": "y"})


def test_bytes_that_are_no_table_are_refused(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"t,y\n\0\0\0")
    with pytest.raises(DataError, match="not a text file.*UTF-8"):
        read_record(tmp_path / "a.csv")
    (tmp_path / "a.parquet").write_bytes(b"PAR1 no more")
    with pytest.raises(DataError, match="not a readable Parquet file.*as CSV"):
        read_record(tmp_path / "a.parquet")


def test_a_wrong_column_is_refused_with_the_nearest_and_all_there_are(csv):
    path = csv(rows(T))
    with pytest.raises(DataError, match="Did you mean 'phi_deg'.*holds t, phi_deg, force_N") as e:
        read_record(path, {"phi": "Phi_Deg"})
    assert "--map phi=phi_deg" in str(e.value)
    with pytest.raises(DataError, match="no column 'clock' for t"):
        read_record(path, time="clock")


def test_units_that_do_not_match_or_are_ambiguous_are_refused_with_channel_and_column(csv):
    path = csv(rows(T))
    with pytest.raises(UnitError, match="channel phi from column 'force_N'.*'kN' measures"):
        read_record(path, {"phi": ("force_N", "kN", "rad")})
    with pytest.raises(UnitError, match=r"channel f .*ambiguous.*nmi \(nautical mile\).*nanometre"):
        read_record(path, {"f": ("force_N", "nm", "m")})
    with pytest.raises(DataError, match=r"Give \(column, unit in the file, SI target\)"):
        read_record(path, {"f": ("a", "b", "c", "d")})


@pytest.mark.parametrize(
    ("given", "target", "size"),
    [("g", "m/s^2", 9.80665), ("g", "kg", 1e-3), ("KN", "N", 1e3), ("F", "K", 5 / 9)],
)
def test_of_two_readings_of_a_given_unit_the_one_that_fits_the_model_is_taken(
    csv, given, target, size
):
    record = read_record(csv(rows(T)), {"f": ("force_N", given, target)})
    plain = read_record(csv(rows(T)), {"f": ("force_N", "1", "1")})
    np.testing.assert_allclose(np.diff(record["f"]), size * np.diff(plain["f"]), atol=1e-9)


def test_a_unit_in_brackets_is_the_file_s_word_and_an_ending_only_a_hint(csv):
    path = csv(rows(T, header="t,pull [KN],f_deg"))
    with pytest.raises(UnitError, match="ambiguous.*Write which"):
        read_record(path)
    record = read_record(path, {"f": ColumnSpec("f_deg", target="N")})
    assert record["f"][0] == 1.0
    path = csv(rows(T, header="t,pull [deg],f"))
    with pytest.raises(UnitError, match="'deg' measures 1, but 'N'"):
        read_record(path, {"f": ColumnSpec("pull [deg]", target="N")})
    assert read_record(path, {"f": ("pull [deg]", "N", "N")}).units["f"] == "N"


@pytest.mark.parametrize(
    ("header", "given", "severity", "words"),
    [("P [W]", "kW", "warning", "in kW, the unit given, though the file states W: .* 1000 times"),
     ("P [degC]", "K", "warning", "the file states degC. Leave the unit out, as in --map 'P=P"),
     ("P [deg]", "N", "warning", "the file states deg"),
     ("P_deg", "rad", "note", "its name ends with deg: its numbers count 57.2958 times"),
     ("P_deg", "N", "", ""), ("P [W]", "J/s", "", ""), ("P [KN]", "kN", "", ""),
     ("P", "kW", "", "")],
)  # fmt: skip
def test_a_unit_other_than_the_one_that_the_file_states_is_reported(
    csv, header, given, severity, words
):
    path, columns = csv(rows(T, header=f"t,{header},f")), {"P": (header, given)}
    reported = [f for f in check(path, columns).findings if "the unit given" in f.text]
    assert [f.severity for f in reported] == ([severity] if severity else [])
    assert all(re.search(words, str(f)) for f in reported)
    remarks = [s for s in read_record(path, columns).provenance if "the unit given" in s]
    assert len(remarks) == len(reported)


def test_a_unit_of_time_other_than_the_one_that_the_file_states_is_reported(csv):
    found = check(csv(rows(T, header="t [s],y,f")), time=ColumnSpec("t [s]", "min"))
    (finding,) = [f for f in found.findings if f.channel == "t"]
    assert "though the file states s: its numbers count 60 times as much" in finding.text


def test_the_nearest_column_is_no_time_stamp_and_none_that_is_taken(csv):
    path = csv(rows(T, header="Timestamp [s],Wave (cm),eta2"))
    with pytest.raises(DataError, match=r"for eta\. The file holds .* as in --map eta=COLUMN\.$"):
        read_record(path, {"eta": ColumnSpec("timestam"), "x": "eta2"})
    with pytest.raises(DataError, match="Did you mean 'eta2'.* as in --map eta=eta2"):
        read_record(path, {"eta": "eta"})
    with pytest.raises(DataError, match=r"for eta\. The file .* as in --map eta=COLUMN\.$"):
        read_record(path, {"eta": "eta", "x": "eta2"})


def test_a_parquet_file_written_with_its_index_is_read(tmp_path):
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    frame = pd.DataFrame({"y": [1.0, 2.0, 3.0]}, index=pd.Index([0.0, 0.5, 1.0], name="t"))
    frame.to_parquet(tmp_path / "a.parquet")
    assert read_record(tmp_path / "a.parquet").t.tolist() == [0.0, 0.5, 1.0]
    frame.index = pd.to_timedelta(frame.index, unit="s")
    frame.to_parquet(tmp_path / "b.parquet")
    assert read_record(tmp_path / "b.parquet").Ts == 0.5


def test_text_among_decimal_commas_is_found(csv):
    with pytest.raises(DataError, match="text in 1 of . cells.*line 3: 'xx'"):
        read_record(csv("t;y\n0,0;1,5\n0,1;xx\n0,2;2,5\n"))


def test_a_grid_far_too_coarse_is_refused_with_a_better_one(csv):
    with pytest.raises(DataError, match=r"Resample nearer to the median interval, resample=0\.1"):
        read_record(csv(rows(T)), resample=2.0)


def test_random_instants_are_refused_with_the_option_that_takes_them(csv):
    """Every sample is then found again within a tenth of the median interval of its stamp."""
    t = np.cumsum(np.random.default_rng(2).exponential(1.0, 30))
    path = csv(rows(t, t, header="t,y"))
    with pytest.raises(DataError, match="mark_missing=True takes every sample at its own instant"):
        read_record(path)
    found = read_record(path, mark_missing=True)
    there = ~found.is_missing("y")
    assert found["y"][there].tolist() == t.tolist()
    assert np.abs(found.t[there] - t + t[0] - found.t[0]).max() <= 0.1 * np.median(np.diff(t))


# ---------------------------------------------------------------------- the clock


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


# ---------------------------------------------------------------------- larger than memory


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


# ---------------------------------------------------------------------- the columns


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
