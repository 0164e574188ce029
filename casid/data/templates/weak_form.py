"""Starting values from a record: a differential equation as a regression, without differentiating.

An equation that is linear in its coefficients is multiplied by a smooth function that vanishes at
both ends of a sliding window, and integrated by parts, which moves every derivative from the noisy
signal to that function (modulating functions: Shinbrot 1957, Trans. ASME 79, 573-588). The length
of the window decides between noise and excitation; of a few lengths the one with the smallest
relative standard errors is taken. Rough by design: the estimate is made by other means.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import Polynomial

from casid.arrays import FloatArray

_POWER = 6  # the modulating function (1 - s^2)^6 and its first five derivatives vanish at both ends
_SHORTEST = 8  # samples on either side of the centre
_RATIO = 1.6  # from one window to the next

Term = tuple[FloatArray, int]
"""A signal (N,) and how often it is differentiated."""


def weak_form(target: Term, terms: Sequence[Term], Ts: float) -> FloatArray | None:
    """Coefficients c of `target = c_1 term_1 + c_2 term_2 + ...`.

    Parameters
    ----------
    target, terms : signals (N,) with the order of their derivative.
    Ts : sample time [s].

    Returns
    -------
    (len(terms),) array; None where the record decides none of it (too short, nothing moves).
    """
    N = target[0].size
    best, smallest = None, np.inf
    half = float(_SHORTEST)
    while 4 * half < N:
        y, *columns = (
            _modulated(signal, order, round(half), Ts) for signal, order in (target, *terms)
        )
        Phi = np.column_stack(columns)
        scale = np.sqrt(np.mean(Phi**2, axis=0))
        if np.all(scale > 0):
            found, *_ = np.linalg.lstsq(Phi / scale, y, rcond=None)
            error = y - Phi / scale @ found
            # Windows overlap: independent are as many as lie side by side.
            independent = max(y.size / half, len(terms) + 1.0) - len(terms)
            gram = (Phi / scale).T @ (Phi / scale) / y.size
            if np.linalg.cond(gram) < 1e10:
                variance = np.mean(error**2) / independent * np.diag(np.linalg.inv(gram))
                relative = float(np.max(np.sqrt(variance) / np.maximum(np.abs(found), 1e-300)))
                if relative < smallest:
                    best, smallest = np.asarray(found / scale), relative
        half *= _RATIO
    return best


def _modulated(signal: FloatArray, order: int, half: int, Ts: float) -> FloatArray:
    """The signal's derivative, weighted by the modulating function around every sample."""
    from scipy.signal import fftconvolve

    s = np.arange(-half, half + 1) / half
    weights = (Polynomial([1.0, 0.0, -1.0]) ** _POWER).deriv(order)(s) / (half * Ts) ** order
    return np.asarray(fftconvolve(signal, weights / half, mode="valid"))
