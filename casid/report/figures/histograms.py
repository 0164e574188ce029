"""Histograms of the estimates of a Monte Carlo study."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.campaigns.accuracy import Accuracy
from casid.campaigns.monte_carlo import MonteCarlo
from casid.report.figures.panels import Panels
from casid.report.figures.style import AFTER, BEFORE, MEASURED, axis_text, hover_text, visible_text


def histogram_figure(result: MonteCarlo) -> Any:
    """Histograms of the estimates, one panel a parameter, with truth and reported density.

    The curve is the normal density about the mean estimate with the mean of the reported standard
    errors, scaled to the bars: where it is narrower than they are, the intervals are too.
    """
    shown = [p for p in result.parameters if p.n > 1]
    if not shown:
        raise ValueError("fewer than two runs have an estimate; there is nothing to draw")
    columns = min(2, len(shown))
    figure = Panels(panels=len(shown), columns=columns, row_height=260, gap=70)
    for k, p in enumerate(shown):
        _histogram_panel(figure, k, _Histogram.of(result, p))
        figure.label(k, x=axis_text(p.name, p.unit), y="runs" if k % columns == 0 else None)
    figure.figure.update_layout(bargap=0)
    figure.ticks = 5
    caption = (
        f"Estimates of {visible_text(result.problem)} in {shown[0].n} runs, against the truth and "
        "the normal density that their mean standard error promises."
    )
    return figure.done(caption, ())


@dataclass(frozen=True)
class _Histogram:
    """Bars of one parameter's estimates.

    count : runs in each bar.
    edge : between the bars, one more than bars.
    """

    accuracy: Accuracy
    values: Array
    count: Array
    edge: Array

    @classmethod
    def of(cls, result: MonteCarlo, p: Accuracy) -> _Histogram:
        """The estimates of one parameter in bars of Scott's width."""
        values = result.estimates(p.name).astype(float)
        values = values[np.isfinite(values)]
        # Scott (Biometrika 66 (1979) 605-610): 3.49 sigma n^(-1/3); at least 5 bars, at most 60.
        width = 3.49 * p.spread * values.size ** (-1 / 3)
        reach = float(np.ptp(values))
        bins = int(np.clip(math.ceil(reach / width), 5, 60)) if width > 0 and reach > 0 else 5
        return cls(p, values, *np.histogram(values, bins))

    @property
    def step(self) -> float:
        """The width of a bar."""
        return float(self.edge[1] - self.edge[0])

    def density(self) -> tuple[Array, Array] | None:
        """The normal density that the standard errors promise, scaled to the bars.

        It is cut where it is far from them; None without standard errors.
        """
        p, sigma = self.accuracy, self.accuracy.mean_std_error
        if not (math.isfinite(sigma) and sigma > 0):
            return None
        x = p.mean + sigma * np.linspace(-3.5, 3.5, 141)
        peak = self.values.size * self.step / (sigma * math.sqrt(2 * math.pi))
        density = peak * np.exp(-0.5 * ((x - p.mean) / sigma) ** 2)
        reach = 3 * (float(np.ptp(self.values)) + self.step)
        inside = (x > p.mean - reach) & (x < p.mean + reach)
        return x[inside], density[inside]


def _histogram_panel(figure: Panels, k: int, bars: _Histogram) -> None:
    """Draw bars, reported density, mean and truth of one parameter in panel `k`."""
    p, edge = bars.accuracy, bars.edge
    figure.add(
        k,
        kind="Bar",
        x=0.5 * (edge[1:] + edge[:-1]),
        y=bars.count,
        width=bars.step,
        name="estimates",
        marker={"color": MEASURED, "line": {"color": "#ffffff", "width": 1}},
        hovertemplate=hover_text(p.unit, "runs"),
    )
    top = float(bars.count.max())
    span = [float(edge[0]), float(edge[-1])]
    density = bars.density()
    if density is not None:
        x, y = density
        peak = float(y.max())
        if peak < 4 * top:  # far narrower than the bars, it would flatten them
            top = max(top, peak)
        name, hover = "predicted by the standard errors", hover_text(p.unit, "runs")
        figure.line(k, x, y, name, AFTER, hovertemplate=hover)
        span = [min(span[0], x[0]), max(span[1], x[-1])]
    for label, at, colour, dash in (
        ("mean", p.mean, "#222222", "dot"),
        ("truth", p.truth, BEFORE, "dash"),
    ):
        if at is None or not math.isfinite(at):
            continue
        span = [min(span[0], at), max(span[1], at)]
        hover = f"{label} %{{x:.6g}}<extra></extra>"
        ends = [0.0, 1.08 * top]
        figure.line(k, [at, at], ends, label, colour, dash=dash, hovertemplate=hover)
    margin = 0.04 * (span[1] - span[0]) or 1.0
    figure.x_range(k, [span[0] - margin, span[1] + margin])
    figure.y_range(k, [0, 1.1 * top])
