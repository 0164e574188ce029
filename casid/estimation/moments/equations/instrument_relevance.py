"""Relevance of instruments: are they correlated with what the free parameters affect?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from casid.arrays import TINY, Array
from casid.errors import IdentifiabilityError
from casid.estimation.moments.equations.moment_equations import Correlation, MomentEquations


def require_relevance(
    equations: Sequence[MomentEquations],
    jacobians: Sequence[Array],
    free: Sequence[str],
    theta_p: Array,
) -> list[Correlation]:
    """Canonical correlations of every part; refused where a free parameter is undetermined.

    What counts is not every coefficient but every direction that the free parameters move, and all
    parts together: the share of that motion's size that the instruments reproduce.

    Parameters
    ----------
    jacobians : d theta / d theta_p (ntheta, nfree) of each part.
    theta_p : (nfree,) where they were taken.

    Raises
    ------
    IdentifiabilityError
        If a direction of the free parameters is not correlated with the instruments, more than
        chance would have it; the parameters of that direction are named.
    """
    seen = np.zeros((len(free), len(free)))
    total = np.zeros_like(seen)
    surplus = -len(free)
    for e, J in zip(equations, jacobians, strict=True):
        w = e.whitener()
        surplus += len(w)
        weight = e.N / max(float(e.second[0, 0]), TINY)
        moved = w @ e.Phi @ J
        seen += weight * moved.T @ moved
        total += weight * J.T @ e.second[1:, 1:] @ J
    correlations = [e.correlation(with_memory=False) for e in equations]
    size = np.where(theta_p == 0.0, 1.0, np.abs(theta_p))
    moves = np.diag(total) * size**2
    if not np.all(np.isfinite(total)) or np.min(moves) < 1e-16 * np.max(moves):
        return correlations  # a special point, as a load of 0 kg: no conclusion there
    scale = 1 / np.sqrt(np.maximum(np.diag(total), TINY))
    values_, vectors = np.linalg.eigh(total * np.outer(scale, scale))
    root = vectors / np.sqrt(np.maximum(values_, 1e-14 * values_[-1]))
    shares, directions = np.linalg.eigh(root.T @ (seen * np.outer(scale, scale)) @ root)
    from scipy.special import chdtri  # scipy.stats takes longer than all of the above

    limit = float(chdtri(max(surplus + 1, 1), 1e-3))
    samples = float(sum(e.N for e in equations))
    if surplus >= 0 and samples * shares[0] > 1e3 * limit:
        return correlations  # no memory makes that chance
    correlations = [e.correlation() for e in equations]
    samples = sum(c.effective_samples for c in correlations)
    if surplus >= 0 and samples * shares[0] > limit:
        return correlations
    step = scale * (root @ directions[:, 0])
    step = step / size
    step /= step[np.argmax(np.abs(step))]
    named = " and ".join(f for f, v in zip(free, step, strict=True) if abs(v) > 0.05)
    rank = int(np.sum(samples * shares > limit))
    raise IdentifiabilityError(
        f"{', '.join(e.name for e in equations)}: Phi has rank {min(rank, len(free) - 1)} "
        f"of {len(free)} in the free parameters; the instruments are not correlated with "
        f"what {named} moves (correlation {np.sqrt(max(shares[0], 0.0)):.2g}, by chance "
        f"{np.sqrt(limit / samples):.2g}). Use a reference that drives the system, more lags, "
        "or fewer free parameters"
    )
