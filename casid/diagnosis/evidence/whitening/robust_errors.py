"""Sandwich standard errors of a fit, valid for an imperfectly whitened residual; Wald distances."""

from __future__ import annotations

import numpy as np

from casid.estimation.covariance import sandwich
from casid.estimation.simulation.minimization import Fit


def std_error(fit: Fit, name: str) -> float:
    """Robust (sandwich) standard error of one variable, in its unit."""
    criterion = fit.criterion
    free = np.ones(len(fit.x), dtype=bool)
    covariance, _ = sandwich(fit.solution.hessian, criterion.scores(fit.x), free)
    i = criterion.names.index(name)
    return float(np.sqrt(max(covariance[i, i], 0.0)))


def wald(fit: Fit, name: str, null: float = 0.0) -> float:
    """Distance of an estimate from its null value in robust standard errors."""
    sd = std_error(fit, name)
    return float((fit.x[fit.criterion.names.index(name)] - null) / sd) if sd > 0 else 0.0
