"""Robust moments, (2.41) of Linder (2017): samples weighted by the size of their equation error."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from casid.arrays import Array, robust_sd
from casid.estimation.moments.equations.moment_equations import MomentEquations


def robust_weights(error: Array, alpha: Callable[[Array], Array]) -> Array:
    """alpha(e)/e at every sample (N,), with e in units of its robust spread (1.4826 MAD)."""
    spread = robust_sd(error - np.median(error)) or 1.0
    e = error / spread
    with np.errstate(all="ignore"):
        w = alpha(e) / e
    return np.where(np.abs(e) < 1e-9, 1.0, w)


def huber(limit: float = 1.345) -> Callable[[Array], Array]:
    """alpha(x) = x within `limit` spreads, and its sign times `limit` beyond (Huber 1964)."""

    def alpha(x: Array) -> Array:
        return np.clip(x, -limit, limit)

    return alpha


def weighted_equations(equations: MomentEquations, weights: Array) -> MomentEquations:
    """The equations with every sample weighted, (N,): mean zeta w L error = 0, (2.41)."""
    from dataclasses import replace

    start = equations.start
    zeta = np.column_stack([c.samples(equations.signals, start) for c in equations.instruments])
    eq = equations.equation
    phi = np.column_stack([c.samples(equations.signals, start) for c in (eq.left, *eq.columns)])
    heavy = phi * weights[:, None]
    n = len(phi)
    cross = zeta.T @ heavy / n
    return replace(
        equations, Phi=cross[:, 1:], Y=cross[:, 0], second=phi.T @ heavy / n, Z=zeta.T @ zeta / n
    )
