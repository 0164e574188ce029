"""Files with a window and a load case in one argument."""

from __future__ import annotations

import numpy as np
import pytest

from casid.data.reading.record_file import read_record
from casid.data.reading.sources import parse_case, parse_source, parse_window
from casid.errors import DataError
from tests.support.text_tables import T, rows


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
    values[3] = np.inf
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
