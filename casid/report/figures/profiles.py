"""Figures of intervals by profiling: what is minimised, against the values of a parameter."""

from __future__ import annotations

from typing import Any

from casid.identifiability.records.profile_result import Profiles
from casid.identification.profile_interval import Profile
from casid.model.units import from_si
from casid.report.figures.panels import Panels
from casid.report.figures.style import AFTER, BEFORE, axis_text, visible_text


def profiles_figure(profiles: Profiles) -> Any:
    """Deviance against each parameter, all else estimated again, and the interval's threshold."""
    count = len(profiles.profiles)
    panel = Panels(panels=count, columns=min(2, count), row_height=250, gap=80)
    for k, p in enumerate(profiles.profiles):
        panel.line(
            k,
            from_si(p.grid, p.shown_unit),
            p.deviance,
            "deviance",
            AFTER,
            mode="lines+markers",
            in_legend=False,
            hovertemplate="%{x:.5g}: %{y:.3g}<extra></extra>",
        )
        panel.mark(k, y=p.threshold, line_dash="dash", line_color=BEFORE)
        panel.mark(k, x=p.shown[0], line_dash="dot", line_width=1)
        panel.label(k, x=axis_text(p.name, p.shown_unit), y="deviance")
        panel.y_range(k, [0.0, 2.5 * p.threshold])
    kinds = "; ".join(f"{visible_text(p.name)} {p.kind}" for p in profiles.profiles)
    return panel.done(
        f"Profile likelihood of {visible_text(profiles.problem)}, all other parameters estimated "
        f"again at every point; the {100 * profiles.confidence:g} % interval lies below the dashed "
        f"line. {kinds}.",
        (),
    )


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
