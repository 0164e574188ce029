"""Kinds of file that people have: each is read right, or refused with what, where and the option.

Every file is written by the test itself, from the same twelve samples: a force in newtons and an
angle in degrees, every 0.5 s (or as its time column can say). Values and times are compared exactly
where the file writes them exactly.
"""

from __future__ import annotations

import gzip
import io
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from casid.data.quality import check
from casid.data.reading.file_format import FileFormat
from casid.data.reading.record_file import read_record
from casid.data.reading.survey import survey
from casid.errors import DataError

N = 12
T = 0.5 * np.arange(N)
FORCE = np.array([1.5, -2.25, 0.125, 1234.5, 17.0, 3.75, -0.5, 2.5, 999.25, 4.0, 0.0, -8.5])
ANGLE = np.array([90.0, 45.0, -180.0, 10.0, 0.5, 30.0, 60.0, -1.25, 0.25, 2.0, 12.5, 180.0])
RAD = ANGLE * (np.pi / 180)


def table(
    header: str = "t,F [N],phi [deg]",
    *,
    times: Any = T,
    separator: str = ",",
    number: Callable[[float], str] = repr,
    rows: int = N,
) -> str:
    """The samples as text, a line each."""
    lines = [header.replace(",", separator)]
    for k in range(rows):
        t = times[k] if isinstance(times[k], str) else number(float(times[k]))
        lines.append(separator.join([t, number(float(FORCE[k])), number(float(ANGLE[k]))]))
    return "\n".join(lines) + "\n"


def comma(x: float) -> str:
    return repr(x).replace(".", ",")


def german(x: float) -> str:
    return f"{x:,.3f}".translate(str.maketrans(",.", ".,"))


def stamps(form: str, step: str = "500ms", start: str = "2025-01-06 23:59:58") -> list[str]:
    import pandas as pd

    moments = pd.date_range(start, periods=N, freq=step)
    return [m.strftime(form.replace("%f3", f"{m.microsecond // 1000:03d}")) for m in moments]


Content = str | bytes | Callable[[Path], None]


@dataclass
class Kind:
    """A file and what is to be read from it.

    Attributes
    ----------
    refused, remedy : what the refusal says, and the option in it; read with `options` otherwise.
    said : what the record's provenance says.
    """

    name: str
    content: Content
    file: str = "run.csv"
    force: str = "F [N]"
    angle: str | None = "phi [deg]"
    times: Any = None
    options: dict[str, Any] = field(default_factory=dict)
    refused: str = ""
    remedy: str = ""
    said: str = ""

    def write(self, folder: Path) -> Path:
        path = folder / self.file
        if callable(self.content):
            self.content(path)
        elif isinstance(self.content, bytes):
            path.write_bytes(self.content)
        else:
            path.write_bytes(self.content.encode())
        return path


def form(**given: Any) -> dict[str, Any]:
    return {"form": FileFormat(**given)}


def packed(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("logs/run.csv", table())


def packed_twice(path: Path) -> None:
    packed(path)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("other.csv", table())


def frame(**columns: Any) -> Any:
    import pandas as pd

    return pd.DataFrame({"t": T, "F [N]": FORCE, "phi [deg]": ANGLE, **columns})


def excel(path: Path) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["Prüfstand 3"])
    sheet.append([])
    sheet.append([None, "Zeit", "F", "phi"])
    sheet.append([None, "s", "N", "°"])
    for k in range(N):
        sheet.append([None, float(T[k]), float(FORCE[k]), float(ANGLE[k])])
    book.create_sheet("Notizen").append(["nothing"])
    book.save(path)


def excel_dates(path: Path) -> None:
    import pandas as pd

    times = pd.date_range("2025-01-06 23:00", periods=N, freq="5min")
    pd.DataFrame({"Datum": times, "F [N]": FORCE, "phi [deg]": ANGLE}).to_excel(path, index=False)


def two_sheets(path: Path) -> None:
    import pandas as pd

    with pd.ExcelWriter(path) as book:
        frame().to_excel(book, sheet_name="run", index=False)
        frame().head(5).to_excel(book, sheet_name="calibration", index=False)


def matlab(path: Path) -> None:
    from scipy.io import savemat

    run = {"t": T[:, None], "F": FORCE[None, :], "phi": ANGLE}
    savemat(path, {"run": run, "mass": 2.0, "note": "a"})


def matlab_73(path: Path) -> None:
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("t", T), ("F", FORCE), ("phi", ANGLE)):
            file[name] = values[None, :]
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file")


def hdf5(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, values, unit in (("t", T * 1e3, "ms"), ("F", FORCE, "N"), ("phi", ANGLE, "deg")):
            file[f"run/{name}"] = values
            file[f"run/{name}"].attrs["unit"] = unit


def tdms(path: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(path) as file:
        clock = {"wf_increment": 0.5, "wf_start_offset": 0.0}
        channels = [("F", FORCE, "N"), ("phi", ANGLE, "deg")]
        file.write_segment(
            [ChannelObject("run", n, v, {**clock, "unit_string": u}) for n, v, u in channels]
        )


def mf4(path: Path) -> None:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        signals = [Signal(FORCE, T, name="F", unit="N"), Signal(ANGLE, T, name="phi", unit="deg")]
        file.append(signals)
        file.save(path, overwrite=True)


def ros_bag(path: Path) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    kind = store.types["geometry_msgs/msg/Vector3"]
    with Writer(path) as bag:
        topic = bag.add_connection("/rig", kind.__msgtype__, typestore=store)
        for k in range(N):
            message = kind(x=float(FORCE[k]), y=float(ANGLE[k]), z=float(k % 2))
            stamp = 1_736_000_000_000_000_000 + 500_000_000 * k
            bag.write(topic, stamp, store.serialize_ros1(message, kind.__msgtype__))


LABVIEW = (
    "LabVIEW Measurement\t\nWriter_Version\t2\t\nSeparator\tTab\t\nDate\t2025/01/06\t\n"
    "***End_of_Header***\t\n\t\nChannels\t2\t\t\nSamples\t12\t12\t\nY_Unit_Label\tN\tdeg\t\n"
    "X0\t0.0\t0.0\t\nDelta_X\t0.5\t0.5\t\n***End_of_Header***\t\t\t\n"
    + table("X_Value,F [N],phi [deg]", separator="\t")
)
TWO_MARKS = table(separator=";", number=german)
SLOW = [repr(float(x)) for x in 300.0 * np.arange(N)]
LATE = ["F [N],phi [deg],time [ms]"] + [f"{FORCE[k]},{ANGLE[k]},{500 * k}" for k in range(N)]
QUOTED = "\n".join(
    ['"t","F [N]","phi [deg]"']
    + [",".join(f'"{comma(float(x))}"' for x in (T[k], FORCE[k], ANGLE[k])) for k in range(N)]
)
DOTTED = stamps("%d.%m.%Y %H:%M:%S,%f3")
US = stamps("%m/%d/%Y %I:%M:%S.%f3 %p", start="2025-01-12 23:59:58")
OPEN = [
    f"0{1 + k}/0{1 + k}/2025 00:00" if k < 1 else f"0{1 + k % 9}/02/2025 00:00" for k in range(N)
]
AUTUMN = stamps("%d.%m.%Y %H:%M", "15min", "2025-10-26 01:00")
AUTUMN[8:] = stamps("%d.%m.%Y %H:%M", "15min", "2025-10-26 02:00")[: N - 8]
CLOCK_PAIR = [s.replace(" ", ",") for s in stamps("%d.%m.%Y %H:%M:%S", "60s", "2025-01-06 23:57")]
SERIAL = [repr(45658.0 + k / 288) for k in range(N)]

KINDS = [
    # ------------------------------------------------------------------ plain text, well written
    Kind("comma-separated", table()),
    Kind("tab-separated", table(separator="\t"), "run.tsv"),
    Kind("separated by spaces", table("t F_N phi_deg", separator=" "), "run.dat", "F_N", "phi_deg"),
    Kind("semicolons and decimal commas", table(separator=";", number=comma)),
    Kind("decimal commas in tabs", table(separator="\t", number=comma)),
    Kind("decimal commas in quotes between commas", QUOTED),
    Kind("thousands as 1.234,500", TWO_MARKS),
    Kind("thousands as 1,234.500", table(separator=";", number=lambda x: f"{x:,.3f}")),
    Kind("byte order mark", b"\xef\xbb\xbf" + table().encode()),
    Kind("Latin-1", table("t;F [N];Neigung [°]", separator=";").encode("latin-1"),
         angle="Neigung [°]", said="text read as cp1252"),
    Kind("UTF-16 as Excel's Unicode text", table(separator="\t").encode("utf-16"), said="utf-16"),
    Kind("UTF-16 without a mark", table().encode("utf-16-le"), said="utf-16-le"),
    Kind("line ends of old Macs", table().replace("\n", "\r")),
    Kind("line ends of Windows, blank lines", table().replace("\n", "\r\n\r\n")),
    Kind("gzip", gzip.compress(table().encode()), "run.csv.gz", said="gzip"),
    Kind("zip", packed, "run.zip", said="unpacked logs/run.csv"),
    # ------------------------------------------------------------------ headers
    Kind("row of units", "t;F;phi\ns;N;°\n" + table(separator=";").partition("\n")[2],
         force="F", angle="phi", said="units from a row of units"),
    Kind("row of units that is a comment",
         table("t,F,phi").replace("\n", "\n#s,N,°\n", 1),
         force="F", angle="phi", said="units from a row of units"),
    Kind("names and units in comments",
         table("# t,F,phi").replace("\n", "\n# s,N,°\n# from the second rig\n", 1),
         force="F", angle="phi", said="units from a row of units"),
    Kind("units in full below the names, as oscilloscopes write them",
         "DSO\n\n" + table("x-axis,F,phi").replace("\n", "\nsecond,Newton,Degree\n", 1),
         force="F", angle="phi", said="units from a row of units"),
    Kind("line breaks in the names, as Excel has them", table('"t\n(s)","F\r\n[N]","phi\n[deg]"')),
    Kind("a line above the names with a quote of its own", '5" drum\n' + table()),
    Kind("row of units at the end", table("t,F,phi") + "[s],[N],[deg]\n", force="F", angle="phi"),
    Kind("i/mA, P in kW, name and unit apart", table("Zeit / s,F in N,phi deg"), force="F in N",
         angle="phi deg"),
    Kind("metadata above the names, as LabVIEW writes it", LABVIEW, "run.lvm",
         said="lines above the names"),
    Kind("a few lines of metadata above a few rows", "Gerät;XY\nSeriennr.;12345\n\n"
         "Zeit [s];F [N]\n" + "\n".join(f"{comma(T[k].item())};{comma(FORCE[k].item())}"
         for k in range(N)), angle=None),
    Kind("sep= of Excel, comments between the rows",
         "sep=;\n# rig 4\n" + table(separator=";").replace("\n2.0;", "\n# paused\n2.0;")),
    Kind("names in a comment, as numpy.savetxt writes them",
         "# " + table("t F_N phi_deg", separator=" "), "run.txt", "F_N", "phi_deg"),
    Kind("an empty column, one of text", table().replace("\n", ",,ok\n")
         .replace("[deg],,ok", "[deg],void,Bemerkung"), said="column void left out: it is empty"),
    Kind("sum below the last row", table() + "\n;Mittelwert;\nEnde\n".replace(";", ","),
         said="lines below the last row not read"),
    Kind("time in the last column", "\n".join(LATE)),
    # ------------------------------------------------------------------ clocks
    Kind("milliseconds", table("t_ms,F [N],phi [deg]", times=1e3 * T)),
    Kind("hours", table("t_h,F [N],phi [deg]", times=T / 900), times=T * 4),
    Kind("ISO dates with a zone", table("time,F [N],phi [deg]",
         times=stamps("%Y-%m-%dT%H:%M:%S.%f3+01:00"))),
    Kind("German dates", table("Zeitstempel;F [N];phi [deg]", times=DOTTED, separator=";"),
         said="day, month, year, first 06 January 2025"),
    Kind("American dates, a day above 12 decides", table("Date,F [N],phi [deg]", times=US),
         said="month, day, year, first 12 January 2025"),
    Kind("names of months", table("Zeit;F [N];phi [deg]", times=[f"6. Mai 2025 10:{k:02d}"
         for k in range(N)], separator=";"), times=60.0 * np.arange(N)),
    Kind("dates that no cell decides", table("date,F [N],phi [deg]", times=OPEN),
         refused="and no cell decides", remedy="--dates dmy, mdy or ymd"),
    Kind("time of day past midnight", table("Uhrzeit,F [N],phi [deg]",
         times=stamps("%H:%M:%S.%f3")), times=86398.0 + T, said="past midnight 1 time"),
    Kind("day and time in two columns", table("Datum,Uhrzeit,F [N],phi [deg]", times=CLOCK_PAIR),
         times=60.0 * np.arange(N)),
    Kind("hours and minutes, or minutes and seconds", table("time,F [N],phi [deg]",
         times=stamps("%H:%M", "1min", "2025-01-06 10:00")),
         refused="may be hours and minutes, or minutes and seconds", remedy="COLUMN:mm:ss"),
    Kind("end of summer time", table("Zeit,F [N],phi [deg]", times=AUTUMN),
         refused="jump back by an hour from 2025-10-26 02:45:00", remedy="--time-zone"),
    Kind("end of summer time, zone named", table("Zeit,F [N],phi [deg]", times=AUTUMN),
         times=900.0 * np.arange(N), options=form(time_zone="Europe/Berlin"),
         said="set back by 1 h"),
    Kind("seconds since 1970", table("timestamp,F [N],phi [deg]", times=1.7365e9 + T),
         said="seconds since 1970, first 2025-01-10"),
    Kind("milliseconds since 1970", table("timestamp,F [N],phi [deg]",
         times=[str(1_736_500_000_000 + 500 * k) for k in range(N)]), said="milliseconds since"),
    Kind("nanoseconds since 1970", table("timestamp,F [N],phi [deg]",
         times=[str(1_736_500_000_000_000_001 + 500_000_000 * k) for k in range(N)])),
    Kind("serial days of Excel", table("t,F [N],phi [deg]", times=SERIAL),
         times=300.0 * np.arange(N), said="serial days of Excel, first 2025-01-01"),
    Kind("seconds of a day are no serial days", table(times=40000.0 + T), times=40000.0 + T),
    Kind("no time column", table("x,F [N],phi [deg]"),
         refused="no time column found among x, F", remedy="--sample-time 0.01"),
    Kind("no time column, sample time given", table("x,F [N],phi [deg]"), options=form(Ts=0.5)),
    Kind("time going backwards", table(times=[*T[:6], *T[:6]]), refused="runs backward once",
         remedy="cut it where the clock was reset"),
    Kind("gap", table(times=[*T[:6], *(T[6:] + 9)]), refused="1 gap longer", remedy="--resample"),
    Kind("two clocks", "\n".join(["t,F [N],t,phi [deg]"]
         + [f"{T[k]},{FORCE[k]},{T[k] * 1.5},{ANGLE[k]}" for k in range(N)]),
         refused="two clocks, columns 't#1' and 't#3'", remedy="--map t='t#3'"),
    # ------------------------------------------------------------------ cells
    Kind("NaN, dashes and #N/A", table().replace("1234.5", "NaN").replace("17.0", "-")
         .replace("999.25", "#N/A"), said="3 samples of F [N] not finite, marked missing"),
    Kind("Inf", table().replace("1234.5", "Inf"), refused="1 sample that is not finite.*line 5",
         remedy="--mark-missing"),
    Kind("text that stands for no value", table().replace("17.0", "Fehler"),
         refused="text in 1 of 12 cells.*line 6: 'Fehler'",
         remedy="--missing Fehler --mark-missing"),
    Kind("9999 that stands for no value", table().replace(",17.0,", ",9999,"),
         options={**form(missing=("9999",)), "mark_missing": True}, said="1 sample of F [N] not"),
    Kind("mixed sampling, a value in every fourth row",
         "\n".join(f"{line},{k if k % 4 == 0 else ''}" if k >= 0 else line + ",slow"
         for k, line in enumerate(table().splitlines(), start=-1)),
         said="9 samples of slow not finite, marked missing"),
    Kind("1,234 in quotes", table().replace("1234.5", '"1,234"').replace("999.25", "999"),
         refused="'1,234', which may be 1.234 or 1234", remedy="--decimal"),
    Kind("decimal commas between commas", table(number=comma), refused="names 3 columns",
         remedy="decimal commas need semicolons, tabs or quotes"),
    Kind("two columns of one name", table("t,F [N],F [N]"), force="F [N]#2", angle=None,
         said="they are called F [N]#2, F [N]#3"),
    Kind("a unit of two readings", table("t,F [KN],phi [deg]"),
         refused=r"ambiguous: 'KN' may mean kN \(kilonewton\) or kn \(knot\)", remedy=":UNIT"),
    Kind("revolutions or radians a minute", table("t,n [1/min],phi [deg]"),
         refused="rpm .revolutions a minute. or rad/min", remedy=":rpm"),
    # ------------------------------------------------------------------ no tables
    Kind("empty file", "", refused="the file is empty", remedy="Export the measurement again"),
    Kind("one row", table(rows=1), refused="1 sample; a record needs at least 2", remedy="longer"),
    Kind("numbers without names", table().partition("\n")[2],
         refused="The file has no line of names", remedy="--map t=COLUMN"),
    Kind("binary", bytes(range(256)) * 8, refused="not a text file", remedy="CSV in UTF-8"),
    Kind("binary without zeros", np.random.default_rng(1).integers(1, 255, 3000, "u1").tobytes(),
         refused="full of control characters", remedy="CSV in UTF-8"),
    Kind("old Excel workbook", b"\xd0\xcf\x11\xe0" + bytes(600), "run.xls",
         refused="an old Excel workbook", remedy="Save it as .xlsx or CSV"),
    Kind("broken gzip", gzip.compress(table().encode())[:60], "run.csv.gz",
         refused="cannot be unpacked", remedy="Pack or send it again"),
    Kind("archive of several files", packed_twice, "run.zip", refused="the archive holds 2 files",
         remedy="--table NAME"),
    # ------------------------------------------------------------------ other formats
    Kind("Parquet", lambda path: frame().to_parquet(path), "run.parquet"),
    Kind("NumPy archive", lambda path: np.savez(path, t_ms=T * 1e3, F_N=FORCE, phi_deg=ANGLE),
         "run.npz", "F_N", "phi_deg"),
    Kind("Excel with a title and a row of units", excel, "run.xlsx", "F", "phi", said="sheet"),
    Kind("Excel with dates", excel_dates, "run.xlsx", times=300.0 * np.arange(N)),
    Kind("Excel with two tables", two_sheets, "run.xlsx", refused="2 sheets: run .12 rows",
         remedy="--table NAME"),
    Kind("Excel, the sheet named", two_sheets, "run.xlsx", options=form(table="run")),
    Kind("MATLAB 5, a structure", matlab, "run.mat", "F", "phi", said="variable run"),
    Kind("MATLAB 7.3", matlab_73, "run.mat", "F", "phi"),
    Kind("HDF5 with units", hdf5, "run.h5", "F", "phi", said="group run"),
    Kind("TDMS", tdms, "run.tdms", "F", "phi"),
    Kind("MF4", mf4, "run.mf4", "F", "phi"),
    Kind("ROS bag", ros_bag, "run.bag", "x", "y"),
]  # fmt: skip
NO_UNITS = {"MATLAB 5, a structure", "MATLAB 7.3", "ROS bag"}


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_each_kind_is_read_right_or_refused_with_the_option_that_helps(kind, tmp_path):
    path = kind.write(tmp_path)
    if kind.refused:
        with pytest.raises(DataError, match=f"(?s){kind.refused}") as caught:
            read_record(path, **kind.options)
        assert kind.remedy in str(caught.value)
        assert path.name in str(caught.value)
        return
    record = read_record(path, **kind.options)
    expected = T if kind.times is None else kind.times
    assert record.t == pytest.approx(expected, rel=1e-12, abs=1e-9)
    shown = ~record.is_missing(kind.force)
    assert np.array_equal(record[kind.force][shown], FORCE[shown])
    if kind.name not in NO_UNITS:
        assert record.units[kind.force] == "N"
    if kind.angle is not None:
        exact = ANGLE if kind.name in NO_UNITS else RAD
        assert record[kind.angle] == pytest.approx(exact, rel=1e-15)
    assert kind.said in "\n".join(record.provenance)


def test_there_are_forty_kinds_and_more():
    assert len(KINDS) >= 40
    assert len({kind.name for kind in KINDS}) == len(KINDS)


@pytest.mark.parametrize(("options", "step"), [({"dates": "dmy"}, None), ({"dates": "mdy"}, None)])
def test_an_order_of_dates_is_taken_as_given(options, step, tmp_path):
    path = tmp_path / "run.csv"
    dates = [f"{d:02d}/02/2025" for d in range(1, 10)]
    path.write_text("date,y\n" + "\n".join(f"{d},{k}" for k, d in enumerate(dates)))
    if options["dates"] == "dmy":
        assert read_record(path, form=FileFormat(**options)).Ts == 86400.0
    else:
        with pytest.raises(DataError, match="irregular"):  # months have 28 to 31 days
            read_record(path, form=FileFormat(**options))


@pytest.mark.parametrize(("rows", "said"), [(range(60), "are swapped"), ((3, 2, 1), "backward")])
def test_dates_that_run_forward_only_with_day_and_month_swapped_are_refused(rows, said, tmp_path):
    """A spreadsheet took 02/01 for the first of February, and 13/01 for what it is."""
    path = tmp_path / "run.csv"
    days = [date(2014, 1, 1) + timedelta(days=k) for k in rows]
    written = [f"{d:%Y-%d-%m}" if d.day <= 12 and said == "are swapped" else f"{d}" for d in days]
    path.write_text("date,y\n" + "\n".join(f"{d},{k}" for k, d in enumerate(written)))
    with pytest.raises(DataError, match=said) as caught:
        read_record(path)
    assert ("2014-12-01 is followed by 2014-01-13" in str(caught.value)) == (said == "are swapped")
    assert any(said in f.text for f in check(path).findings)


@pytest.mark.parametrize(
    ("file", "package", "extra"),
    [("run.xlsx", "openpyxl", "excel"), ("run.h5", "h5py", "matlab"), ("run.tdms", "nptdms", "daq"),
     ("run.mf4", "asammdf", "daq"), ("run.bag", "rosbags", "daq")],
)  # fmt: skip
def test_a_format_whose_package_is_absent_is_refused_with_its_extra(
    file, package, extra, tmp_path, monkeypatch
):
    content = {"xlsx": None, "h5": b"\x89HDF\r\n\x1a\n", "tdms": b"TDSm", "mf4": b"MDF     ",
               "bag": b"#ROSBAG V2.0\n"}[file.partition(".")[2]]  # fmt: skip
    if content is None:
        packed_book = io.BytesIO()
        with zipfile.ZipFile(packed_book, "w") as archive:
            archive.writestr("xl/workbook.xml", "")
        content = packed_book.getvalue()
    path = tmp_path / file
    path.write_bytes(content)
    monkeypatch.setitem(__import__("sys").modules, package, None)
    with pytest.raises(DataError, match=rf"needs the package {package}.*casid\[{extra}\]"):
        read_record(path)


def test_a_point_that_may_separate_thousands_is_remarked(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t;n\n0;1.234\n1;2.345\n2;3.456\n")
    record = read_record(path)
    assert record["n"].tolist() == [1.234, 2.345, 3.456]
    assert "'1.234' was read with a decimal point" in str(record)
    assert read_record(path, form=FileFormat(decimal=","))["n"].tolist() == [1234.0, 2345.0, 3456.0]


def test_a_value_far_off_that_comes_back_is_remarked(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(table().replace(",17.0,", ",9999,").replace(",4.0,", ",9999,"))
    (column,) = [c for c in survey(path).columns if c.name == "F [N]"]
    assert any("9999" in remark and "--missing 9999" in remark for remark in column.remarks)
