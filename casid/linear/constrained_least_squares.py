"""Least squares under linear constraints, in closed form."""

from __future__ import annotations

import numpy as np

from casid.arrays import TINY, Array
from casid.errors import IdentifiabilityError, SolveError


def null_space_least_squares(Phi: Array, Y: Array, B: Array, b: Array) -> Array:
    """theta that minimises ||Phi theta - Y|| subject to B theta = b, by the null space of B.

    With B' = [Q1 Q2] [R; 0], theta = Q1 R^-T b + Q2 v: the rest is ordinary least squares in v,
    solved by QR (Golub & Van Loan 2013, section 6.2.3). No iterations, no tolerance.

    Parameters
    ----------
    Phi : (N, d) regressors; Y : (N,)
    B : (m, d), m <= d; b : (m,). Rows that repeat others are dropped if they agree with them.

    Returns
    -------
    (d,)

    Raises
    ------
    SolveError
        If B theta = b has no solution.
    IdentifiabilityError
        If Phi does not determine a direction that B leaves free; the direction is named.
    """
    from scipy.linalg import qr, solve_triangular

    Phi, Y = np.asarray(Phi, dtype=float), np.asarray(Y, dtype=float).ravel()
    B, b = np.atleast_2d(np.asarray(B, dtype=float)), np.asarray(b, dtype=float).ravel()
    d = Phi.shape[1]
    B = B.reshape(-1, d)
    if Phi.shape[0] != len(Y) or len(B) != len(b):
        raise SolveError(
            f"constrained least squares: Phi {Phi.shape} and Y {Y.shape}, B {B.shape} and "
            f"b {b.shape} do not go together; give (N, d), (N,), (m, d), (m,)"
        )
    size = np.linalg.norm(Phi, axis=0)
    size = np.where(size > 0, size, 1.0)  # a column of zeros shows in the rank below
    Phi, B = Phi / size, B / size
    length = np.linalg.norm(B, axis=1)
    length = np.where(length > 0, length, 1.0)
    B, b = B / length[:, None], b / length
    Q, R, order = qr(B.T, pivoting=True)  # B.T[:, order] = Q R
    diagonal = np.abs(np.diagonal(R))
    rank = int(np.sum(diagonal > 1e-12 * max(diagonal.max(initial=0.0), TINY)))
    R1, Q1, Q2 = R[:rank], Q[:, :rank], Q[:, rank:]
    w = solve_triangular(R1[:, :rank], b[order[:rank]], trans="T") if rank else np.zeros(0)
    gap = np.abs(R1.T @ w - b[order])
    if gap.max(initial=0.0) > 1e-9 * max(np.abs(b).max(initial=0.0), TINY):
        row = int(order[int(np.argmax(gap))])
        raise SolveError(
            f"constrained least squares: row {row} of B theta = b contradicts the others; drop it "
            "or correct the known values that it was made of"
        )
    theta = Q1 @ w
    if Q2.shape[1]:
        reduced = Phi @ Q2
        _require_full_rank(reduced, Q2, size)
        Qr, Rr = np.linalg.qr(reduced)
        theta = theta + Q2 @ solve_triangular(Rr, Qr.T @ (Y - Phi @ theta))
    return np.asarray(theta / size)


def _require_full_rank(reduced: Array, Q2: Array, size: Array) -> None:
    """Refuse regressors (N, k) of the free directions Q2 (d, k) that leave one undetermined."""
    values, directions = np.linalg.svd(reduced, full_matrices=False)[1:]
    rank = int(np.sum(values > 1e-12 * max(values.max(initial=0.0), TINY)))
    if rank < Q2.shape[1]:
        V = np.linalg.svd(reduced)[2] if len(values) < Q2.shape[1] else directions
        lost = Q2 @ V[-1] / size
        shown = ", ".join(f"{v:.3g}" for v in lost / np.abs(lost).max())
        raise IdentifiabilityError(
            f"constrained least squares: the regressors have rank {rank} where the constraints "
            f"leave {Q2.shape[1]} directions free; undetermined: [{shown}]. Excite the system "
            "there, or constrain that direction"
        )
