"""Fits as they would be with another value of one variable."""

from __future__ import annotations

from dataclasses import replace

from casid.estimation.simulation.minimization import Fit


def with_value(fit: Fit, name: str, value: float) -> Fit:
    """A fit of which one variable has another value, and nothing else is another."""
    x = fit.x.copy()
    x[fit.criterion.names.index(name)] = value
    return replace(fit, solution=replace(fit.solution, x=x))
