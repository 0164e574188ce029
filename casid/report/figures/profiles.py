"""Figures of intervals by profiling: what is minimised, against the values of a parameter."""

from __future__ import annotations

import math
from typing import Any

from casid.identifiability.records.profile_result import Profiles
from casid.identification.profile_interval import Profile
from casid.report.figures.style import AFTER, BEFORE, figure_text, visible_text


def profiles_figure(profiles: Profiles) -> Any:
    """Plotly figure: deviance against each parameter, with the threshold of the interval."""
    from plotly.subplots import make_subplots

    columns = min(2, len(profiles.profiles))
    rows = math.ceil(len(profiles.profiles) / columns)
    figure = make_subplots(rows=rows, cols=columns, vertical_spacing=0.35 / rows)
    for k, p in enumerate(profiles.profiles):
        at = {"row": k // columns + 1, "col": k % columns + 1}
        figure.add_scatter(
            x=p.grid,
            y=p.deviance,
            mode="lines+markers",
            line={"color": AFTER, "width": 2},
            name=figure_text(p.name),
            showlegend=False,
            **at,
        )
        figure.add_hline(y=p.threshold, line_dash="dash", line_color=BEFORE, **at)
        figure.add_vline(x=p.best, line_dash="dot", line_width=1, **at)
        figure.update_xaxes(title_text=figure_text(f"{p.name} [{p.unit}]"), **at)
        figure.update_yaxes(title_text="deviance", range=[0, 2.5 * p.threshold], **at)
    caption = (
        f"Profile likelihood of {visible_text(profiles.problem)}: deviance with all else estimated "
        f"again; below the dashed line lies the {100 * profiles.confidence:g} % interval. "
        + "; ".join(f"{visible_text(p.name)} {p.kind}" for p in profiles.profiles)
        + "."
    )
    figure.update_layout(
        template="plotly_white",
        title={"text": figure_text(caption, 200), "font": {"size": 13}},
        meta={"caption": caption},
        height=60 + 300 * rows,
    )
    return figure


def moment_profile_figure(profile: Profile) -> Any:
    """The drop over the values tried, with the level that bounds the interval."""
    import plotly.graph_objects as go
    from scipy.stats import chi2

    figure = go.Figure(go.Scatter(x=profile.grid, y=profile.drop, mode="lines+markers"))
    figure.add_hline(y=float(chi2.isf(1 - profile.level, 1)), line_dash="dash")
    figure.update_layout(
        template="plotly_white", xaxis_title=profile.name, yaxis_title="2 (V - V_min)"
    )
    return figure
