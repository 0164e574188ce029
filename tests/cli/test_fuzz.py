"""Readers, options and problem files under what nobody would write: an answer or one clear error.

Whatever is in a file or on the command line, a command ends with status 0, or with 2 and a message
that says why the input cannot be used. An exception that casid does not raise on purpose is a fault
of casid. The examples are few and drawn from a fixed seed, so that all take seconds; Hypothesis
shrinks what it finds. To look for more, raise `max_examples` and drop `derandomize`.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import casid
from casid.cli.main import main
from casid.data.reading.survey import survey
from casid.errors import CasidError

few = settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
fewer = settings(few, max_examples=25)

# -- files ----------------------------------------------------------------------------------------

NUMBERS = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True).map(repr),
    st.integers(-(10**25), 10**25).map(str),
    st.sampled_from(["1,5", "1.234,5", "1'000", "1e400", "-", "NaN", "#NV", "0x1F", "١٢", "5 V"]),
)
TIMES = st.one_of(
    NUMBERS,
    st.sampled_from(["01.02.2025 03:04:05", "2025-13-45", "12:61", "24:00:00", "0:00", "T"]),
    st.datetimes().map(lambda t: t.isoformat(" ")),
)
NAMES = st.one_of(
    st.sampled_from(["t", "t [ms]", "Zeit", "x [m]", "F (N)", "U / V", "a [", "]", "", '"', "°C"]),
    st.text(max_size=12),
)


@st.composite
def tables(draw: st.DrawFn) -> bytes:
    """A table of some columns, with what files have about them."""
    width = draw(st.integers(1, 4))
    separator = draw(st.sampled_from([",", ";", "\t", " ", "|"]))
    lines = [separator.join(draw(NAMES) for _ in range(width))]
    if draw(st.booleans()):
        lines.append(
            separator.join(draw(st.sampled_from(["s", "ms", "V", ""])) for _ in range(width))
        )
    is_even = draw(st.booleans())
    for k in range(draw(st.integers(0, 12))):
        time = repr(0.1 * k) if is_even else draw(TIMES)
        cells = [
            time,
            *(draw(NUMBERS) for _ in range(width - 1 + draw(st.sampled_from([0, 0, 0, 1])))),
        ]
        lines.append(separator.join(cells))
    text = draw(st.sampled_from(["\n", "\r\n", "\r"])).join([*draw(above), *lines])
    return draw(marks) + text.encode(draw(st.sampled_from(["utf-8", "utf-16"])), "replace")


above = st.lists(st.sampled_from(["# log", "sep=;", "", "Prüfstand 3", '"']), max_size=2)
marks = st.sampled_from(
    [b"", b"", b"\xef\xbb\xbf", b"\xff\xfe", b"PK\x03\x04", b"\x1f\x8b", b"PAR1"]
)


@contextlib.contextmanager
def a_file(content: bytes, name: str) -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content)
        yield path


@few
@given(tables(), st.sampled_from(["run.csv", "run.txt", "run.mat", "run.xlsx", "run.parquet"]))
@pytest.mark.filterwarnings("ignore")
def test_any_table_is_read_or_refused(content: bytes, name: str) -> None:
    """What is read has finite samples on an even clock; what is not has a fault that says why."""
    with a_file(content, name) as path:
        try:
            found = survey(path)
        except CasidError:
            return
        if found.record is None:
            assert found.faults
            assert all(str(fault) for fault in found.faults)
            return
        assert found.record.Ts > 0
        for channel in found.record.channels:
            held = ~found.record.is_missing(channel)
            assert all(map(math.isfinite, found.record[channel][held].tolist()))


@fewer
@given(
    st.binary(max_size=300), st.sampled_from(["run.csv", "run.mat", "run.h5", "run.tdms", "a.mf4"])
)
@pytest.mark.filterwarnings("ignore")
def test_any_bytes_are_read_or_refused(content: bytes, name: str) -> None:
    with a_file(content, name) as path, contextlib.suppress(CasidError):
        survey(path)


@fewer
@given(tables())
@pytest.mark.filterwarnings("ignore")
def test_a_problem_file_is_written_for_any_table_or_refused(content: bytes) -> None:
    """What is written is Python that defines a problem."""
    with a_file(content, "run.csv") as path:
        try:
            casid.new_problem(path, "free", path.with_suffix(".py"))
        except CasidError:
            return
        casid.load_problem(path.with_suffix(".py"))


# -- options --------------------------------------------------------------------------------------

WORDS = st.one_of(
    st.sampled_from(
        ["nan", "inf", "-1", "0", "1e-300", "1e300", "99999999999", "", "=", "x=", "=1"]
    ),
    st.sampled_from(["x=nan", "k=1", "F=x:deg", "a:b:c", "@", "0:1:2", ":", "5:1", "é", "\x1b[2J"]),
    st.text(max_size=8).filter(lambda text: "\0" not in text and not text.startswith("-")),
)
OPTIONS = {
    "check": ["--map", "--window", "--resample", "--sample-time", "--decimal", "--missing"]
    + ["--dates", "--time-zone", "--encoding", "--table"],
    "identify": [
        "--map",
        "--window",
        "--set",
        "--segments",
        "--lowpass",
        "--decimate",
        "--hold-out",
    ]
    + ["--method", "--reference", "--lag", "--free", "--ignore"],
    "diagnose": ["--budget", "--max-causes", "--without", "--false-alarm-rate", "--jobs", "--set"],
    "identifiability": ["--replicas", "--known", "--at", "--sensor", "--known-initial", "--profile"]
    + ["--shared-input", "--time-limit"],
    "simulate": ["--x0", "--set", "--duration", "--window", "--resample"],
    "montecarlo": ["--duration", "--set", "--method", "--starts", "--runs"],
}
REQUESTS = st.sampled_from(sorted(OPTIONS)).flatmap(
    lambda command: st.tuples(
        st.just(command),
        st.lists(st.tuples(st.sampled_from(OPTIONS[command]), WORDS), min_size=1, max_size=2),
    )
)


@settings(few, max_examples=40)
@given(REQUESTS)
def test_any_option_is_taken_or_refused(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    wanted: tuple[str, list[tuple[str, str]]],
) -> None:
    """The data do not exist: options are judged, and nothing is fitted."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "p.py").write_text(PROBLEM.format(name="p", unit="m", start="1.0"))
    command, given_options = wanted
    files = ["none.csv"] if command == "check" else ["p.py"]
    files += ["none.csv"] if command in ("identify", "diagnose", "simulate") else []
    more = ["--out", "o.csv"] if command == "simulate" else []
    words = [word for pair in given_options for word in pair]
    result = CliRunner().invoke(main, [command, *files, *words, *more])
    assert isinstance(result.exception, SystemExit | None), result.exception
    assert result.exit_code in (0, 2)
    if result.exit_code == 2:
        assert "error: " in result.output
    assert "\x1b" not in result.output


# -- problem files --------------------------------------------------------------------------------

PROBLEM = """
import casid

m = casid.Model("p")
x = m.state("x", "{unit}")
k = m.parameter("{name}", "1/s", start={start}, lower=0, upper=10)
m.derivative(x, -k * x)
m.output("y", x, "{unit}")
problem = casid.Problem("p", m)
"""
VALUES = st.sampled_from(
    ["1", "-1", "11", "None", "'1'", "nan", "float('nan')", "1e400", "[1]", "m", "k", "1j", "1/0"]
    + ["True", "lambda: 1", "__import__('sys').exit(1)", "casid", "(", "..."]
)
LINES = st.sampled_from(
    ["m.balance(x, 'b', inertia={v}, terms=[-k * x])", "m.output({v}, x, 'm')"]
    + ["m.derivative({v}, x)", "m.input('u', {v})", "m.input({v}, 'N')", "m.parameter('q', {v})"]
    + ["m.constant('c', {v}, 'm')", "m.state('z', 'm', initial={v})", "x = x + {v}", "raise {v}"]
    + ["problem = casid.Problem({v}, m)", "problem = casid.Problem('p', {v})", "problem = {v}"]
    + [
        "problem = casid.Problem('p', m, channels={v})",
        "problem = casid.Problem('p', m, noise={v})",
    ]
    + [
        "problem = casid.Problem('p', m, load_cases={v})",
        "problem = casid.Problem('p', m, starts={v})",
    ]
)


@settings(few, max_examples=120)
@given(
    st.sampled_from(["k", "y", "x", "", "k k", "\\x1b[2J", "class", "é"]),
    st.sampled_from(["m", "1", "", "furlong", "m/s^2", "degC", "m^400", "m/"]),
    VALUES,
    st.lists(st.tuples(LINES, VALUES), max_size=2),
)
def test_any_problem_file_is_loaded_or_refused(
    name: str, unit: str, start: str, more: list[tuple[str, str]]
) -> None:
    text = PROBLEM.format(name=name, unit=unit, start=start)
    text += "\n".join(line.format(v=value) for line, value in more) + "\n"
    with a_file(text.encode(), "p.py") as path:
        result = CliRunner().invoke(
            main, ["simulate", str(path), "--out", str(path.with_name("o.csv"))]
        )
    assert isinstance(result.exception, SystemExit | None), result.exception
    assert result.exit_code in (0, 2)
    assert "\x1b" not in result.output
