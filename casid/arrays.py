"""The array types of annotations, rows between cuts, spreads, divisors, and what JSON can hold."""

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casid.errors import SolveError

Array = NDArray[Any]
FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

TINY = 1e-300
"""Added to, or the least of, a divisor that may vanish: far below any physical square."""


def require_finite(what: str, *arrays: Array) -> None:
    """Refuse numbers that no linear algebra has an answer for.

    Raises
    ------
    SolveError
        If any is infinite or not a number.
    """
    if not all(np.all(np.isfinite(a)) for a in arrays):
        raise SolveError(
            f"{what} are not finite: the simulation overflows; shorten the window, or bound the "
            "parameters that make it grow"
        )


def scaled_inverse(matrix: Array) -> Array:
    """(n, n) pseudo-inverse of an information matrix, in the sizes that its own diagonal gives.

    Of unknowns in units of very different size no digit is lost, and directions without information
    (1e-13 of the largest) are left out.
    """
    d = 1 / np.sqrt(np.maximum(np.abs(np.diag(matrix)), TINY))
    units = np.outer(d, d)
    return np.asarray(units * np.linalg.pinv(matrix * units, rcond=1e-13))


def robust_sd(errors: Array) -> float:
    """Standard deviation of normal errors about zero by the median of their sizes, NaN left out.

    A few large ones hardly move it (F. R. Hampel, J. Am. Stat. Assoc. 69 (1974) 383-393).
    """
    return 1.4826 * float(np.nanmedian(np.abs(errors)))


def finite_or_none(value: float) -> float | None:
    """The number, or None where it is infinite or not a number: what JSON can hold."""
    return float(value) if math.isfinite(value) else None


def rows_between(cuts: Iterable[int]) -> list[slice]:
    """The rows from each cut to the next."""
    return [slice(int(first), int(last)) for first, last in pairwise(cuts)]


def basis_of(columns: Array) -> Array:
    """(N, r) orthonormal basis of columns (N, k), which may be nearly dependent."""
    size = np.sqrt(np.maximum(np.einsum("ij,ij->j", columns, columns), TINY))
    u, s, _ = np.linalg.svd(columns / size, full_matrices=False)
    return np.asarray(u[:, s > 1e-8 * s[:1]])
