"""How near to the unit circle the slowest mode of a discrete system lies."""

from __future__ import annotations

import numpy as np

from casid.arrays import Array

LAST_STABLE = 1 - 1e-9  # a pole nearer to the unit circle counts as lying on it


def spectral_radius(A: Array) -> float:
    """Largest modulus of an eigenvalue, 0 of an empty matrix."""
    return float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0))


def largest_root(polynomial: Array) -> float:
    """Largest modulus of the roots in z of a polynomial in ascending powers of q^-1."""
    return float(np.max(np.abs(np.roots(polynomial)), initial=0.0))


def modulus_text(modulus: float) -> str:
    """The modulus of a refused pole, so that one inside the circle is not taken for one on it."""
    if LAST_STABLE <= modulus < 1:
        return f"modulus 1 - {1 - modulus:.2g}, within {1 - LAST_STABLE:.0e} of the unit circle"
    return f"modulus {modulus:.4g}"
