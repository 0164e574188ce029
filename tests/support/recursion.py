"""Polynomial models by plain recursion, sample by sample: what casid's filters are held against."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypedDict, Unpack

import numpy as np


def filtered(b: Sequence[float], a: Sequence[float], x: np.ndarray) -> np.ndarray:
    """y_t = sum_k b_k x_{t-k} - sum_{k>0} a_k y_{t-k}, a_0 = 1, from rest."""
    y = np.zeros(len(x))
    for t in range(len(x)):
        total = 0.0
        for k, value in enumerate(b):
            if t >= k:
                total += value * x[t - k]
        for k, value in enumerate(a[1:], start=1):
            if t >= k:
                total -= value * y[t - k]
        y[t] = total
    return y


ONE = (1.0,)


class Polynomials(TypedDict, total=False):
    """In ascending powers of q^-1, the first coefficient of all but B being 1; B and F by input."""

    A: Sequence[float]
    B: Mapping[str, Sequence[float]]
    C: Sequence[float]
    D: Sequence[float]
    F: Mapping[str, Sequence[float]]


def _of(p: Polynomials) -> tuple[Sequence[float], Sequence[float], Sequence[float]]:
    return p.get("A", ONE), p.get("C", ONE), p.get("D", ONE)


def _driven(u: Mapping[str, np.ndarray] | None, p: Polynomials) -> np.ndarray | float:
    """sum_i (B_i/F_i) u_i."""
    F = p.get("F", {})
    return sum(filtered(p["B"][n], F.get(n, ONE), values) for n, values in (u or {}).items())


def simulated(
    e: np.ndarray,
    u: Mapping[str, np.ndarray] | None = None,
    **polynomials: Unpack[Polynomials],
) -> np.ndarray:
    """A y = sum_i (B_i/F_i) u_i + (C/D) e."""
    A, C, D = _of(polynomials)
    return filtered(ONE, A, filtered(C, D, e) + _driven(u, polynomials))


def predicted_errors(
    y: np.ndarray,
    u: Mapping[str, np.ndarray] | None = None,
    **polynomials: Unpack[Polynomials],
) -> np.ndarray:
    """(D/C) (A y - sum_i (B_i/F_i) u_i)."""
    A, C, D = _of(polynomials)
    return filtered(D, C, filtered(A, ONE, y) - _driven(u, polynomials))
