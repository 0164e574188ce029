"""What rows span, modulo a prime: a basis that grows, and what can be read off it."""

from __future__ import annotations

import numpy as np

from casid.algebra.prime_field import echelon, matmul
from casid.arrays import Array


class Basis:
    """Reduced row echelon form that grows."""

    def __init__(self, columns: int, p: int) -> None:
        self.p = p
        self.rows: Array = np.zeros((0, columns), dtype=np.int64)
        self.pivots: list[int] = []

    @property
    def rank(self) -> int:
        """Number of rows."""
        return len(self.pivots)

    def add(self, rows: Array) -> int:
        """Add (m, n) rows; how many of them are new."""
        p = self.p
        if self.pivots:
            rows = (rows - matmul(rows[:, self.pivots], self.rows, p)) % p
        new, pivots = echelon(rows, p)
        if pivots:
            if self.pivots:
                self.rows = (self.rows - matmul(self.rows[:, pivots], new, p)) % p
            self.rows = np.vstack([self.rows, new])
            self.pivots += pivots
        return len(pivots)


def unit_vectors(rows: Array) -> list[bool]:
    """Per column of a reduced row echelon form: its unit vector lies in the span of the rows."""
    alone = np.count_nonzero(rows, axis=1) == 1
    out = np.zeros(rows.shape[1], dtype=bool)
    if alone.any():
        out[np.argmax(rows[alone] != 0, axis=1)] = True
    return [bool(v) for v in out]


def leading(rows: Array, columns: int) -> int:
    """Number of echelon rows whose pivot lies in the first columns."""
    return int(np.count_nonzero(rows[:, :columns].any(axis=1))) if columns else 0


def padded(rows: Array, before: int) -> Array:
    """Rows with so many zero columns in front."""
    return np.hstack([np.zeros((len(rows), before), dtype=np.int64), rows])
