"""The characteristic polynomial and the adjugate of sI - A, division free but for integers.

Source: F. R. Gantmacher, The Theory of Matrices (1959), vol. 1, ch. IV, section 5.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

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
