"""Subspaces of linear systems: null spaces, zeros, unobservable subspaces.

Ranks and pseudo-inverses take absolute tolerances, relative to the size of the factors that a
matrix was made of: a product that vanishes in algebra is 1e-16 in numbers, and a tolerance relative
to itself would invert it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casid.arrays import TINY, Array

TOLERANCE = 1e-9
"""Singular values below this, in units of the factors' size, count as zero."""


def size(M: Array) -> float:
    """The largest singular value, 0 of an empty matrix."""
    return float(np.linalg.norm(M, 2)) if M.size else 0.0


def pseudo_inverse(M: Array, tolerance: float) -> Array:
    """Moore-Penrose inverse; singular values up to the absolute `tolerance` count as zero."""
    if not M.size:
        return np.zeros(M.shape[::-1])
    U, s, Vt = np.linalg.svd(M, full_matrices=False)
    kept = s > tolerance
    return np.asarray((Vt[kept].T / s[kept]) @ U[:, kept].T)


def null_space(M: Array, tolerance: float) -> Array:
    """Orthonormal basis (columns, k) of {x : M x = 0}, with an absolute tolerance."""
    columns = M.shape[1]
    if not M.size:
        return np.eye(columns)
    _, s, Vt = np.linalg.svd(M)
    rank = int(np.sum(s > tolerance))
    return np.asarray(Vt[rank:].conj().T)


def row_space(M: Array, tolerance: float) -> Array:
    """Orthonormal basis (rows, columns of M) of the rows of M, with an absolute tolerance."""
    if not M.size:
        return np.zeros((0, M.shape[1]))
    _, s, Vt = np.linalg.svd(M, full_matrices=False)
    return np.asarray(Vt[s > tolerance])


def rank(M: Array, tolerance: float) -> int:
    """Number of singular values above an absolute tolerance."""
    return int(np.sum(np.linalg.svd(M, compute_uv=False) > tolerance)) if M.size else 0


def unobservable_subspace(A: Array, C: Array, relative: float = TOLERANCE) -> Array:
    """Orthonormal basis (nx, k) of the largest A-invariant subspace in the null space of C."""
    A, T = _balanced(A)
    C = _unit_rows(C @ T)
    A = A / max(size(A), TINY)
    V = null_space(C, relative)
    while V.shape[1]:
        leaves = A @ V - V @ (V.T @ A @ V)
        W = null_space(leaves, relative)
        if W.shape[1] == V.shape[1]:
            break
        V = V @ W
    return np.asarray(np.linalg.qr(T @ V)[0]) if V.shape[1] else V


def input_scale(E: Array, F: Array) -> Array:
    """(nu,) sizes of the unknown inputs' columns: their units must not decide what is zero."""
    norm = np.hypot(np.linalg.norm(E, axis=0), np.linalg.norm(F, axis=0))
    return np.asarray(np.where(norm > 0, norm, 1.0))


def _balanced(A: Array) -> tuple[Array, Array]:
    """T^-1 A T with rows and columns of like size, T diagonal: units of the states taken out."""
    from scipy.linalg import matrix_balance

    if not A.size:
        return A, np.eye(len(A))
    balanced, T = matrix_balance(A, permute=False)
    return np.asarray(balanced), np.asarray(T)


def _unit_rows(M: Array) -> Array:
    norm = np.linalg.norm(M, axis=1, keepdims=True)
    return np.asarray(M / np.where(norm > 0, norm, 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class Zeros:
    """Invariant zeros of (A, E, C, F): where [A - s I, E; C, F] loses rank.

    Attributes
    ----------
    values : (k,) complex.
    states : (nx, k) complex, of each zero the initial state with which an input exp(zero t) is
        undetectable, of unit norm.
    hidden_inputs : (nu, m) undetectable directions of input, or such that another direction
        repeats; with any, the rank is too low at every s and `values` has no meaning.
    """

    values: Array
    states: Array
    hidden_inputs: Array


def invariant_zeros(A: Array, E: Array, C: Array, F: Array, relative: float = TOLERANCE) -> Zeros:
    """Zeros from the largest output-nulling subspace: x with A x + E u in it and C x + F u = 0.

    Source: H. L. Trentelman, A. A. Stoorvogel, M. Hautus, Control Theory for Linear Systems (2001),
    section 7.3: the zeros are the eigenvalues of A + E U on it, where u = U x keeps x there.
    """
    n, nu = E.shape
    speed = max(size(A), TINY)
    A, T = _balanced(A / speed)
    rows = _unit_rows(np.hstack([C @ T, F]))
    E, C, F = np.linalg.solve(T, E) / speed, rows[:, :n], rows[:, n:]
    for _ in range(3):  # rows and columns of size one, as well as both can be
        scale = input_scale(E, F)
        E, F = E / scale, F / scale
        rows = _unit_rows(np.hstack([C, F]))
        C, F = rows[:, :n], rows[:, n:]
    V = np.eye(n)
    while True:
        off = np.eye(n) - V @ V.T
        M = np.block([[off @ A @ V, off @ E], [C @ V, F]])
        null = null_space(M, relative)
        kept = row_space(null[: V.shape[1]].T, relative).T
        if kept.shape[1] == V.shape[1]:
            break
        V = V @ kept
    left = np.vstack([(np.eye(n) - V @ V.T) @ E, F])
    hidden = null_space(left, relative)
    if hidden.shape[1]:
        return Zeros(np.zeros(0), np.zeros((n, 0)), hidden)
    if V.shape[1] == 0:
        return Zeros(np.zeros(0), np.zeros((n, 0)), np.zeros((nu, 0)))
    U = -pseudo_inverse(left, relative) @ np.vstack([(np.eye(n) - V @ V.T) @ A @ V, C @ V])
    values, vectors = np.linalg.eig(V.T @ (A @ V + E @ U))
    values = np.where(np.abs(values) < 1e-8, 0.0, values * speed)  # a double zero at 0 is split
    states = T @ V @ vectors
    return Zeros(values, states / np.linalg.norm(states, axis=0), np.zeros((nu, 0)))
