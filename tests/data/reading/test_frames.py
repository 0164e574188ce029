"""Tables in memory are read as files are, and records become tables."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import casid
from tests.estimation.fitted.test_fitted_model import TS, record
from tests.support.fitted_models import driven_mass


def test_a_record_comes_back_from_its_table():
    gap = np.arange(400) == 7
    run = record(name="run-3").mark_missing("position", gap)
    frame = run.to_frame()
    assert (frame.index.name, list(frame.columns)) == ("t", ["force", "position"])
    assert np.isnan(frame["position"].to_numpy()).sum() == 1
    again = casid.Record.from_frame(frame)
    assert (again.name, again.units) == (run.name, run.units)
    assert again.Ts == pytest.approx(TS, rel=1e-12)
    assert np.array_equal(again["force"], run["force"])
    assert np.array_equal(again.is_missing("position"), gap)
    frame.loc[0.0, "force"] = np.inf
    with pytest.raises(casid.DataError, match="1 sample that is not finite .*, 1 Inf.*from_frame"):
        casid.Record.from_frame(frame)
    marked = casid.Record.from_frame(frame, mark_missing=True)
    assert np.flatnonzero(marked.is_missing("force")).tolist() == [0]


def test_units_are_given_or_read_from_the_names_and_kept_in_si():
    t = 0.1 * np.arange(5)
    frame = pd.DataFrame({"t": t, "angle [deg]": 180 * np.ones(5), "u": np.ones(5)})
    found = casid.Record.from_frame(frame, units={"u": "kN"})
    assert found["angle [deg]"] == pytest.approx(np.pi)
    assert (found["u"][0], found.units["u"]) == (1000.0, "N")
    with pytest.raises(casid.DataError, match="a unit is given for v, which is no column"):
        casid.Record.from_frame(frame, units={"v": "kN"})


def test_the_time_may_be_the_index_dates_or_durations():
    values = {"u": np.arange(4.0)}
    dates = pd.DataFrame(values, index=pd.date_range("2026-03-01 12:00", periods=4, freq="250ms"))
    spans = pd.DataFrame(values, index=pd.timedelta_range("1s", periods=4, freq="250ms"))
    seconds = pd.DataFrame(values, index=0.25 * np.arange(4))
    for frame in (dates, spans, seconds):
        found = casid.Record.from_frame(frame)
        assert found.Ts == pytest.approx(0.25)
        assert found.names == ("u",)
    assert casid.Record.from_frame(pd.DataFrame(values), Ts=0.5).Ts == 0.5
    with pytest.raises(casid.DataError, match="no time column found"):
        casid.Record.from_frame(pd.DataFrame(values))
    with pytest.raises(casid.DataError, match="1 gap longer than 1.5 times"):
        casid.Record.from_frame(pd.DataFrame(values, index=[0.0, 1.0, 1.5, 4.0]))


def test_an_uneven_clock_is_taken_as_it_is_where_the_refusal_says_so():
    """Blood samples are drawn often at first, and seldom later."""
    t = 3600.0 * np.array([0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0])
    frame = pd.DataFrame({"t": t, "c": np.exp(-t / 7200.0)})
    with pytest.raises(casid.DataError, match="mark_missing=True takes every sample at its own"):
        casid.Record.from_frame(frame)
    found = casid.Record.from_frame(frame, mark_missing=True)
    taken = ~found.is_missing("c")
    assert found.t[taken] == pytest.approx(t)
    assert found["c"][taken] == pytest.approx(frame["c"].to_numpy())


def test_what_is_no_table_of_one_experiment_is_refused():
    with pytest.raises(casid.DataError, match="list is no table; give a pandas DataFrame"):
        casid.Record.from_frame([1.0, 2.0])
    levels = pd.MultiIndex.from_product([["a"], [0.0, 1.0]])
    with pytest.raises(casid.DataError, match="index of 2 levels; give one experiment"):
        casid.Record.from_frame(pd.DataFrame({"u": [1.0, 2.0]}, index=levels))
    with pytest.raises(casid.DataError, match="holds no rows"):
        casid.Record.from_frame(pd.DataFrame({"t": [], "u": []}))


def test_a_table_given_to_identify_is_read_through_the_problems_channels():
    """Columns of other names and units: the estimates are those of the record."""
    channels = {"position": "x_mm:mm", "force": "F"}
    problem = casid.Problem("oscillator", driven_mass(), channels, starts=1)
    run = record()
    frame = pd.DataFrame({"t": run.t, "F": run["force"], "x_mm": 1000 * run["position"]})
    from_table, from_record = casid.identify(problem, frame), casid.identify(problem, run)
    assert from_table["k"] == pytest.approx(from_record["k"], rel=1e-6)
    residual = from_record.model.residuals(frame)["position"]
    assert residual == pytest.approx(from_record.model.residuals(run)["position"], abs=1e-9)
    assert from_record.model.simulate(frame[["t", "F"]]).N == run.N
    with pytest.raises(casid.DataError, match="no column 'x_mm' for position"):
        casid.identify(problem, frame.rename(columns={"x_mm": "y"}))


@pytest.mark.parametrize("header", ["F [kN]", "F / kN", "F in kN"])
def test_a_channel_is_found_by_its_name_where_the_header_has_a_unit_behind_it(header):
    """The unit is the header's; a second such column, or one that is mapped, is not guessed."""
    run = record()
    problem = casid.Problem("oscillator", driven_mass(), {"position": "position", "force": "F"})
    frame = pd.DataFrame({"t": run.t, header: run["force"] / 1000, "position": run["position"]})
    found = problem.read_frame(frame).record
    assert found["force"] == pytest.approx(run["force"], rel=1e-12)
    two = frame.assign(**{"F [N]": run["force"]})
    with pytest.raises(casid.DataError, match="no column 'F' for force"):
        problem.read_frame(two)
    assert problem.read_frame(two, mapping={"force": "F [N]"}).record["force"] == pytest.approx(
        run["force"], rel=1e-12
    )


def test_a_clock_is_found_by_its_name_where_the_header_has_a_unit_behind_it():
    run = record()
    problem = casid.Problem("oscillator", driven_mass(), {"position": "x", "force": "F"}, time="T")
    frame = pd.DataFrame({"T [ms]": 1000 * run.t, "x": run["position"], "F": run["force"]})
    assert problem.read_frame(frame).record.Ts == pytest.approx(run.Ts, rel=1e-9)


def test_a_dataset_of_xarray_has_units_and_the_time_as_its_coordinate():
    pytest.importorskip("xarray")
    run = record()
    found = run.to_xarray()
    assert np.array_equal(found["force"].to_numpy(), run["force"])
    assert found["force"].attrs["units"] == "N"
    assert found.sel(t=TS * 10, method="nearest")["position"] == run["position"][10]


def test_a_temperature_called_t_in_capitals_is_no_second_clock():
    """A clock runs forward; a temperature rises and falls, whatever its letter."""
    t = 10.0 * np.arange(100)
    frame = pd.DataFrame({"t": t, "T": 20 + 5 * np.sin(t / 90), "P": 100.0 * (t > 500)})
    found = casid.Record.from_frame(frame)
    assert found.names == ("T", "P")
    assert found.Ts == 10.0
    rising = frame.assign(T=1.5 * t)
    with pytest.raises(casid.DataError, match="two clocks, columns 't' and 'T'"):
        casid.Record.from_frame(rising)
