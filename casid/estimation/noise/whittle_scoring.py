"""Fisher scoring of Whittle's likelihood of several outputs, over parameters and log variances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from casid.arrays import TINY, Array

STEPS = 15
"""Of the scoring, at most."""
SETTLED = 0.02
"""Units of log-likelihood that a step promises, at which it ends."""
HALVINGS = 6
"""Of a step that does not raise the likelihood."""
LONGEST = 1.0
"""Change of the logarithm of a variance or of a spectrum's shape in one step, at most."""


@dataclass(frozen=True, slots=True, eq=False)
class At:
    """Minus the log-likelihood at a point, its gradient and Fisher's information."""

    value: float
    gradient: Array
    information: Array


def impossible(n: int) -> At:
    """The value at a point outside the domain of a search over n variables: infinite."""
    return At(np.inf, np.zeros(n), np.zeros((n, n)))


def minimum(
    of: Callable[[Array], At], z: Array, lower: Array, upper: Array, damping: float = 1e-3
) -> tuple[Array, At]:
    """The point of least value from z, and what is there; z where its value is not finite.

    Parameters
    ----------
    lower, upper : of the first of the variables; the others are logarithms or of unit size.
    damping : of the first step.
    """
    at, n = of(z), len(lower)
    for _ in range(STEPS if np.isfinite(at.value) else 0):
        move = step(z, at, damping, lower, upper)
        if 0.5 * abs(float(move @ at.gradient)) < SETTLED:
            break
        for _ in range(HALVINGS):
            there = z + move
            there[:n] = np.clip(there[:n], lower, upper)
            new = of(there)
            if new.value < at.value:
                break
            move, damping = 0.5 * move, 4 * damping
        else:
            break
        gained, z, at, damping = at.value - new.value, there, new, 0.25 * damping
        if gained < SETTLED:
            break
    return z, at


def step(z: Array, at: At, damping: float, lower: Array, upper: Array) -> Array:
    """The step of Fisher scoring; variables at a bound that it would cross stay there.

    A variance of next to nothing hardly counts, and its logarithm would go far: it goes no
    farther than `LONGEST`, and all others where they are likeliest beside it.
    """
    n = len(lower)
    free = np.ones(len(z), bool)
    free[:n] &= ~((z[:n] <= lower) & (at.gradient[:n] > 0))
    free[:n] &= ~((z[:n] >= upper) & (at.gradient[:n] < 0))
    size = np.sqrt(np.maximum(np.diag(at.information), TINY))
    matrix = at.information / np.outer(size, size) + damping * np.eye(len(z))
    slope = at.gradient / size
    found = np.zeros(len(z))
    while free.any():
        there = slope[free] + matrix[np.ix_(free, ~free)] @ (found * size)[~free]
        step = np.linalg.lstsq(matrix[np.ix_(free, free)], there, rcond=1e-12)[0]
        found[free] = -step / size[free]
        far = np.flatnonzero(free[n:] & (np.abs(found[n:]) > LONGEST)) + n
        if not len(far):
            break
        found[far] = LONGEST * np.sign(found[far])
        free[far] = False
    return found


def of_spectra(
    z: Array, S: Array, slopes: dict[int, Array], count: Array, power: Array
) -> At | None:
    """Likelihood of mean cross-periodograms under S, and its derivatives in the places of z.

    None where S is singular: outputs that one source moves, and no other noise.

    Parameters
    ----------
    S, power : (F, ny, ny) in bands.
    slopes : place of z -> derivative of S (F, ny, ny).
    count : (F,) lines of each band.
    """
    try:
        inverse = np.linalg.inv(S)
    except np.linalg.LinAlgError:
        return None
    ny, n = S.shape[1], len(z)
    white = inverse @ power
    value = count @ (np.linalg.slogdet(S)[1] + np.real(np.einsum("fii->f", white)))
    gradient, information = np.zeros(n), np.zeros((n, n))
    if slopes:
        of = list(slopes)
        turned = inverse @ np.stack([slopes[k] for k in of])  # (k, F, ny, ny)
        left = np.eye(ny) - white
        gradient[of] = np.real(np.einsum("f,kfij,fji->k", count, turned, left))
        information[np.ix_(of, of)] = np.real(
            np.einsum("f,kfij,mfji->km", count, turned, turned, optimize=True)
        )
    return At(float(value), gradient, information)
