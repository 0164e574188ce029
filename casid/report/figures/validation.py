"""Figure of a validation: measured and simulated channels against time."""

from __future__ import annotations

from typing import Any

from casid.estimation.moments.validation import Validation
from casid.report.figures.panels import Panels
from casid.report.figures.style import AFTER, MEASURED, axis_text, visible_text


def validation_figure(validation: Validation, *, seconds: float = 20.0) -> Any:
    """Measured and simulated channels over the first `seconds` of every record (Fig. 7.14)."""
    figure = Panels(rows=len(validation.channels), row_height=190, gap=60)
    for k, c in enumerate(validation.channels):
        t = validation.t[c.record]
        shown = t - t[0] <= seconds
        for name, source, colour in (
            ("measured", validation.measured, MEASURED),
            ("simulated", validation.simulated, AFTER),
        ):
            figure.line(k, t[shown], source[c.record][c.channel][shown], name, colour, width=1.4)
        figure.label(k, x="time [s]", y=axis_text(c.channel, c.unit))
    fits = "; ".join(f"{c.channel} in {c.record}, fit {c.fit:.1f} %" for c in validation.channels)
    return figure.done(f"Measured and simulated from the reference: {visible_text(fits)}.", ())
