"""Charts of studies: what is in the legend, and where traces stand."""

from __future__ import annotations

import pytest

from analysis.common.figures import Chart


@pytest.fixture
def chart() -> Chart:
    made = Chart("Heel grows with the load", 300, cols=2)
    for col in (1, 2):
        made.line([0, 1], [0, col], "heel", "red", at=(1, col))
        made.points([0], [0], at=(1, col), marker={"size": 3})
    return made


def test_each_name_is_in_the_legend_once(chart: Chart) -> None:
    assert [(t.name, t.showlegend) for t in chart.figure.data] == [
        ("heel", True), ("", False), ("heel", False), ("", False),
    ]  # fmt: skip


def test_the_title_is_the_caption(chart: Chart) -> None:
    assert chart.figure.layout.title.text == chart.figure.layout.meta["caption"]


def test_a_trace_keeps_its_panel_and_look(chart: Chart) -> None:
    line, points = chart.figure.data[2:]
    assert (line.xaxis, line.line.color, points.marker.size) == ("x2", "red", 3)
    assert list(line.y) == [0, 2]
