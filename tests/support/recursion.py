"""Polynomial models by plain recursion, sample by sample: what casid's filters are held against."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

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


def simulated(
    e: np.ndarray,
    u: Mapping[str, np.ndarray] | None = None,
    *,
    A: Sequence[float] = (1.0,),
    B: Mapping[str, Sequence[float]] | None = None,
    C: Sequence[float] = (1.0,),
    D: Sequence[float] = (1.0,),
    F: Mapping[str, Sequence[float]] | None = None,
) -> np.ndarray:
    """A y = sum_i (B_i/F_i) u_i + (C/D) e."""
    total = filtered(C, D, e)
    for name, values in (u or {}).items():
        total = total + filtered((B or {})[name], (F or {}).get(name, (1.0,)), values)
    return filtered((1.0,), A, total)


def predicted_errors(
    y: np.ndarray,
    u: Mapping[str, np.ndarray] | None = None,
    *,
    A: Sequence[float] = (1.0,),
    B: Mapping[str, Sequence[float]] | None = None,
    C: Sequence[float] = (1.0,),
    D: Sequence[float] = (1.0,),
    F: Mapping[str, Sequence[float]] | None = None,
) -> np.ndarray:
    """(D/C) (A y - sum_i (B_i/F_i) u_i)."""
    total = filtered(A, (1.0,), y)
    for name, values in (u or {}).items():
        total = total - filtered((B or {})[name], (F or {}).get(name, (1.0,)), values)
    return filtered(D, C, total)
