"""The error bars of a simulation-error fit, by how noise on its inputs was treated."""

from __future__ import annotations

from casid.arrays import Array
from casid.estimation.covariance import robust_covariance
from casid.estimation.errors_in_variables.removal import Corrected
from casid.estimation.noise.residual_autoregressions import (
    Autoregression,
    coloured_covariance,
    orders_text,
)
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation_estimate import (
    ASSUMES,
    BIASED,
    COLOURED,
    CORRECTED,
    INSTRUMENTED,
    WEIGHTED,
    ErrorBars,
)


def error_bars(found: Corrected) -> ErrorBars:
    """Covariance of an estimate, and what it assumes.

    That of the estimating equations where reference instruments or the correction for input noise
    were used; else that of the least-squares minimum under the spectrum of its residual, plain or
    weighted by it.
    """
    if found.covariance is None:
        return _bars_of_minimum(found.fit, ASSUMES + BIASED if found.why_not else ASSUMES)
    if found.reference:
        return ErrorBars(INSTRUMENTED, found.covariance)
    assumes = CORRECTED
    if found.weights is not None:
        assumes = WEIGHTED.format(orders=orders_text(found.weights.models))
    return ErrorBars(assumes, found.covariance, found.whiten, found.weigh)


def _bars_of_minimum(fit: Fit, assumes: str) -> ErrorBars:
    """The covariance of a plain minimum, under the spectrum of its residual or robust to it."""
    coloured = covariance_under_colour(fit, fit.solution.is_free)
    if coloured is None:
        return robust_bars(fit, assumes)
    in_words = COLOURED.format(orders=orders_text(coloured[1]))
    return ErrorBars(assumes.replace(ASSUMES, in_words), coloured[0])


def robust_bars(fit: Fit, assumes: str) -> ErrorBars:
    """The robust covariance of a minimum, with what the fit itself takes out of the residual.

    Parameters
    ----------
    assumes : with a place `{lags}` for its lags.
    """
    at = fit.solution
    residuals, jacobians = zip(*fit.criterion.rows(fit.x), strict=True)
    covariance, lags = robust_covariance(
        residuals, jacobians, at.hessian, at.is_free, at.constraint_jacobian
    )
    return ErrorBars(assumes.format(lags=lags), covariance)


def covariance_under_colour(fit: Fit, free: Array) -> tuple[Array, list[Autoregression]] | None:
    """Covariance (n, n) of a fit with a coloured residual, and its autoregressions.

    None where the residual is white, or the fit is in segments or under constraints.
    """
    if fit.criterion.segments > 1 or fit.solution.constraint_jacobian.size:
        return None
    return coloured_covariance(fit, free)
