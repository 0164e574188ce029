"""Linear recursions that may be unstable: the stable part runs forward, the other backward.

    x[t+1] = A x[t] + v[t]                                                                  (1)

has one bounded solution over all times where no eigenvalue of A lies on the unit circle: with
T^-1 A T = diag(As, Aa), As stable and Aa anti-stable,

    xs[t+1] = As xs[t] + vs[t],    xa[t] = Aa^-1 (xa[t+1] - va[t]).                          (2)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from casid.arrays import Array
from casid.linear.filtering.recursion import recursion
from casid.linear.stability import spectral_radius


@dataclass(frozen=True, slots=True, eq=False)
class SplitDynamics:
    """Recursion (2). T (nx, nx): stable coordinates first; T_inv its inverse."""

    T: Array
    T_inv: Array
    forward: Array
    backward: Array

    def run(self, v: Array) -> Array:
        """(N, nx) solution of (1) for v (N, nx), from zero at either end.

        What the ends should have been instead dies out inwards, like the eigenvalues of `forward`
        from the first sample on, of the inverse of `backward` from the last.
        """
        moved = v @ self.T_inv.T
        ns = len(self.forward)
        ahead = recursion(self.forward, moved[:, :ns], np.zeros(ns))[:-1]
        na = len(self.backward)
        inverse = np.linalg.inv(self.backward) if na else self.backward
        reverse = -(moved[::-1, ns:] @ inverse.T)
        back = recursion(inverse, reverse, np.zeros(na))[1:][::-1]
        return np.asarray(np.hstack([ahead, back]) @ self.T.T)

    def settling(self, fraction: float = 1e-3) -> tuple[int, int]:
        """Samples until the ends' errors have died out to a fraction: (from start, from end)."""
        return _samples(self.forward, fraction), _samples(
            np.linalg.inv(self.backward) if len(self.backward) else self.backward, fraction
        )


def split_dynamics(A: Array) -> SplitDynamics:
    """Split (1) at the unit circle; eigenvalues on it count as stable.

    Ordered Schur form, then a Sylvester equation takes the coupling away (G. H. Golub,
    C. F. Van Loan, Matrix Computations, 2013, section 7.6).
    """
    n = len(A)
    if n == 0:
        return SplitDynamics(A, A, A, A)
    S, Z, ns = linalg.schur(A, output="real", sort=lambda a, b: np.hypot(a, b) <= 1 + 1e-12)
    forward, backward = S[:ns, :ns], S[ns:, ns:]
    T, T_inv = Z, Z.T
    if 0 < ns < n:
        X = linalg.solve_sylvester(forward, -backward, -S[:ns, ns:])
        couple = np.eye(n)
        couple[:ns, ns:] = X
        undo = np.eye(n)
        undo[:ns, ns:] = -X
        T, T_inv = Z @ couple, undo @ Z.T
    return SplitDynamics(np.asarray(T), np.asarray(T_inv), forward, backward)


def _samples(A: Array, fraction: float) -> int:
    radius = spectral_radius(A)
    if radius <= 1e-12:
        return len(A)
    if radius >= 1.0:
        return 2**31
    return int(np.ceil(np.log(fraction) / np.log(radius))) + len(A)
