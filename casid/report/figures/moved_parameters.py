"""Parameters that moved when the missing causes were named: where they were, where they went."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from casid.diagnosis.verdict.remainder import Moved
from casid.report.figures.panels import Panels
from casid.report.figures.style import AFTER, BEFORE, MEASURED, figure_text, visible_text

_SHOWN = 8


def moved_figure(moved: Sequence[Moved], problem: str) -> Any:
    """One row a parameter, in its own unit: before and after with 95 % intervals, and the move.

    Raises
    ------
    ValueError
        If no parameter moved.
    """
    if not moved:
        raise ValueError("no parameter moved, so there is nothing to draw")
    shown = moved[:_SHOWN]
    figure = Panels(rows=len(shown), row_height=52, gap=44)
    for k, m in enumerate(shown):
        _move(figure, k, m)
    figure.ticks = 6
    figure.figure.update_yaxes(tickvals=[0.0], showgrid=False, zeroline=False)
    for k, m in enumerate(shown):
        unit = f"<br>[{figure_text(m.unit, 16)}]" if m.unit else ""
        figure.figure.update_yaxes(ticktext=[figure_text(m.name, 16) + unit], row=k + 1, col=1)
    caption = (
        f"Parameters of {visible_text(problem)} that moved when the causes were named, each in its "
        "own unit, with 95 % intervals. Intervals before the extension assume the model without "
        "the causes, so they do not include the bias that this caused."
    )
    if len(moved) > len(shown):
        caption += f" The first {len(shown)} of {len(moved)}."
    return figure.done(caption, ())


def _move(figure: Panels, k: int, m: Moved) -> None:
    """Draw one parameter's move in panel `k`: a line between two points with intervals."""
    plain: dict[str, Any] = {"in_legend": False, "hoverinfo": "skip"}
    figure.line(k, [m.before, m.after], [0.0, 0.0], "moved", MEASURED, width=3, **plain)
    ends = (
        ("before", m.before, m.std_error_before, BEFORE, "circle-open"),
        ("after", m.after, m.std_error_after, AFTER, "circle"),
    )
    reach = [m.before, m.after]
    for label, value, error, colour, symbol in ends:
        half = 1.96 * error if error is not None and math.isfinite(error) else None
        # An interval far wider than the move would hide the move.
        reach += [value + s * min(half, 3 * abs(m.bias)) for s in (-1, 1)] if half else []
        outline = {"width": 2, "color": colour}
        figure.points(
            k,
            [value],
            [0.0],
            label,
            {"color": colour, "size": 11, "symbol": symbol, "line": outline},
            error_x={"type": "data", "array": [half], "color": colour, "thickness": 2},
            hovertemplate=f"%{{x:.5g}} {figure_text(m.unit)}",
        )
    low, high = min(reach), max(reach)
    room = 0.12 * (high - low) or 0.1 * abs(high) or 1.0
    figure.x_range(k, [low - room, high + room])
    figure.y_range(k, [-1.0, 1.0])
