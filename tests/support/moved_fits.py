"""Fits as they would be with another value of one variable."""

from __future__ import annotations

from dataclasses import replace

from casid.estimation.simulation.minimization import Fit


def with_value(fit: Fit, name: str, value: float) -> Fit:
    """A copy of a fit in which one variable has another value; all else is unchanged."""
    x = fit.x.copy()
    x[fit.criterion.names.index(name)] = value
    return replace(fit, solution=replace(fit.solution, x=x))
