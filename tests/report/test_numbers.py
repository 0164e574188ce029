"""Numbers of a report: the units that people read."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from casid.diagnosis.verdict.cause import Cause
from casid.estimation.estimate import Estimated
from casid.report.numbers import in_readable_unit
from casid.report.pages.cause_parts import cause_part
from casid.report.pages.estimate_parts import parameter_table
from casid.report.texts.diagnosis import _cause


def _late(value: float, std_error: float) -> Cause:
    size = Estimated("delay_conc", value, "s", std_error=std_error)
    return Cause("time_delay", "conc", 1e-9, (size,))


def test_a_long_delay_is_told_in_minutes_in_the_text_and_on_the_page():
    late = _late(1702.0, 31.0)
    (line,) = _cause(1, late)
    assert "delay_conc = 28.37 +- 0.52 min" in line
    page = str(cause_part(1, late, None).parts)
    assert "'28.37', '0.52'" in page
    assert "'min'" in page
    assert "1702" not in page
    assert late.to_json()["parameters"]["delay_conc"]["unit"] == "s"


def test_a_short_delay_stays_in_seconds():
    (line,) = _cause(1, _late(0.0213, 0.0004))
    assert "delay_conc = 0.0213 +- 0.0004 s" in line


@pytest.mark.parametrize(
    ("value", "unit"), [(119.0, "s"), (121.0, "min"), (7300.0, "h"), (-7300.0, "h"), (1.8e5, "d")]
)
def test_times_from_two_of_a_unit_on_have_that_unit(value, unit):
    read = in_readable_unit(Estimated("tau", value, "s", std_error=3.0, ends=(1.0, 2.0)))
    assert read.unit == unit
    seconds = read.in_unit("s")
    assert seconds.value == pytest.approx(value)
    assert seconds.std_error == pytest.approx(3.0)
    assert seconds.ends == pytest.approx((1.0, 2.0))


def test_an_instant_and_what_is_no_time_keep_their_units():
    instant = Estimated("time", 1e5, "s", std_error=1.0, resolution=300.0)
    mass = Estimated("m", 1e5, "kg", std_error=1.0)
    assert in_readable_unit(instant) is instant
    assert in_readable_unit(mass) is mass


def test_a_table_of_estimates_has_the_times_of_its_causes_in_the_same_unit():
    """The delay of a blood sample is 28.4 min where its cause stands, and not 1702 s here."""
    delay = Estimated("delay", 1702.0, "s", std_error=40.0, start=600.0)
    e = SimpleNamespace(names=("delay",), parameters=(delay,), initial_states=())
    (row,) = parameter_table({"model": e}).rows  # type: ignore[dict-item]
    assert list(row[:5]) == ["delay", "min", "28.37", "0.67", "27.06 .. 29.67"]
    assert "10" in row  # where it started
