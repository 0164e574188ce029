"""The characteristic polynomial and the adjugate of sI - A, division free but for integers.

Source: F. R. Gantmacher, The Theory of Matrices (1959), vol. 1, ch. IV, section 5.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np

from casid.algebra import polynomial as poly
from casid.algebra.polynomial import Polynomial
from casid.arrays import Array

Matrix: TypeAlias = Any  # of floats, fractions or CasADi expressions, with @


def faddeev_leverrier(
    A: Matrix, eye: Matrix, one: Any, trace: Callable[[Matrix], Any]
) -> tuple[list[Any], list[Matrix]]:
    """det(sI - A), (n+1) coefficients in descending powers of s; M_1 .. M_n of the adjugate.

    adj(sI - A) = sum_k M_k s^(n-k), so C (sI - A)^-1 B has the numerators C M_k B.

    Parameters
    ----------
    A, eye : (n, n), and the unit matrix of its kind.
    one : the number one of its kind.
    trace : of such a matrix.
    """
    coefficients, adjugate = [one], []
    M = eye
    for k in range(1, eye.shape[0] + 1):
        adjugate.append(M)
        AM = A @ M
        c = -trace(AM) / k
        coefficients.append(c)
        M = AM + c * eye
    return coefficients, adjugate


def fractions(values: Any) -> Array:
    """A matrix of fractions, as an array of objects."""
    given = np.asarray(values)
    made = np.empty(given.size, dtype=object)
    made[:] = [Fraction(v) for v in given.ravel()]
    return made.reshape(given.shape)


def transfer_polynomials(
    A: Array, B: Array, C: Array, D: Array
) -> tuple[list[list[Polynomial]], Polynomial]:
    """Numerators and common denominator of C (sI - A)^-1 B + D, matrices of fractions."""
    eye = fractions(np.eye(len(A)))
    coefficients, adjugate = faddeev_leverrier(A, eye, Fraction(1), np.trace)
    below = tuple(coefficients)
    parts = [C @ M @ B for M in adjugate]
    above = [
        [
            poly.add(poly.trimmed(M[i, k] for M in parts), poly.scale(below, D[i, k]))
            for k in range(D.shape[1])
        ]
        for i in range(len(D))
    ]
    return above, below
