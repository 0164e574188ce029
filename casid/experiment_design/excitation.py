"""Shapes of a designed input: piecewise constant, piecewise linear, multisine.

Every input is u(t) = rest + B(t) w with the decision variables w: values of the intervals, values
at their ends, or amplitudes of cosines and sines. B is the same for all inputs.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import Literal

import numpy as np
import scipy.sparse as sp

from casid.arrays import Array
from casid.errors import DataError

Shape = Literal["constant", "linear", "multisine"]
SHAPES: tuple[Shape, ...] = ("constant", "linear", "multisine")


@dataclass(frozen=True, slots=True)
class Excitation:
    """The basis of an input on a record of N samples.

    Attributes
    ----------
    per : samples an interval.
    frequencies : of a multisine [Hz].
    """

    shape: Shape
    N: int
    Ts: float
    per: int
    frequencies: tuple[float, ...] = ()

    @property
    def intervals(self) -> int:
        """Intervals of the record."""
        return ceil(self.N / self.per)

    @property
    def n(self) -> int:
        """Decision variables an input."""
        if self.shape == "multisine":
            return 2 * len(self.frequencies)
        return self.intervals + (self.shape == "linear")

    @property
    def hold(self) -> Literal["zoh", "foh"]:
        """What the input does between its samples."""
        return "zoh" if self.shape == "constant" else "foh"

    @property
    def samples(self) -> Array:
        """(N, n) basis at the samples."""
        return np.asarray(self._at(np.arange(self.N) / self.per, None).toarray())

    @property
    def inside(self) -> Array:
        """(3, L): the input at begin, middle and end of a step, by its local values.

        The local values are the constant, those at both ends, or, of a multisine, all three.
        """
        if self.shape == "multisine":
            return np.eye(3)
        part = np.linspace(0, 1, 3)[:, None]
        return np.ones((3, 1)) if self.shape == "constant" else np.hstack([1 - part, part])

    def local(self, steps: int) -> sp.csr_matrix:
        """(L * steps * intervals, n): local values of all steps, by the decision variables."""
        k, j = np.divmod(np.arange(steps * self.intervals), steps)
        if self.shape == "constant":
            return self._at(k, k)
        part = np.linspace(0, 1, len(self.inside.T))
        place = (k + j / steps)[:, None] + part / steps
        return self._at(place.ravel(), np.repeat(k, len(part)))

    def _at(self, place: Array, inside: Array | None) -> sp.csr_matrix:
        """Basis (M, n) at places in intervals; `inside` says which interval an end belongs to."""
        if self.shape == "multisine":
            angle = 2 * np.pi * np.outer(place * self.per * self.Ts, self.frequencies)
            return sp.csr_matrix(np.hstack([np.cos(angle), np.sin(angle)]))
        k = np.floor(place + 1e-9).astype(int) if inside is None else inside
        rows = np.arange(len(place))
        if self.shape == "constant":
            return sp.csr_matrix((np.ones(len(place)), (rows, k)), (len(place), self.n))
        part = np.clip(place - k, 0.0, 1.0)
        entries = np.concatenate([1 - part, part])
        return sp.csr_matrix(
            (entries, (np.tile(rows, 2), np.concatenate([k, k + 1]))), (len(place), self.n)
        )

    def nearest(self, u: Array) -> Array:
        """(n, nu) decision variables of the input nearest to samples `u` (N, nu)."""
        return np.asarray(np.linalg.lstsq(self.samples, u, rcond=None)[0])


def excitation_of(
    shape: Shape,
    N: int,
    Ts: float,
    *,
    intervals: int,
    band: tuple[float, float] | None = None,
    lines: int = 20,
) -> Excitation:
    """The basis for a record of N samples.

    Parameters
    ----------
    intervals : wished for; an interval is a whole number of samples.
    band : of a multisine [Hz]; default all its lines.
    lines : of a multisine, at most, evenly spread over the band.

    Raises
    ------
    DataError
        For a shape that is not known, or a band without a line.
    """
    if shape not in SHAPES:
        raise DataError(f"shape {shape!r} is not known; use {', '.join(SHAPES)}")
    if intervals < 1:
        raise DataError(f"{intervals} intervals: give at least one")
    per = max(1, round(N / intervals))
    if shape != "multisine":
        return Excitation(shape, N, Ts, per)
    first = 1 / (N * Ts)
    low, high = band or (first, 0.5 / (per * Ts))
    if not 0 <= low < high <= 0.5 / Ts:
        raise DataError(
            f"a band from {low:g} to {high:g} Hz: give two frequencies up to half the sampling "
            f"rate, {0.5 / Ts:g} Hz"
        )
    harmonics = np.arange(max(1, ceil(low / first - 1e-9)), int(high / first + 1e-9) + 1)
    if not len(harmonics):
        raise DataError(
            f"a band from {low:g} to {high:g} Hz holds no multiple of {first:g} Hz, one over the "
            "duration; widen it, or record longer"
        )
    chosen = np.unique(np.linspace(0, len(harmonics) - 1, min(lines, len(harmonics))).round())
    return Excitation(shape, N, Ts, per, tuple((first * harmonics[chosen.astype(int)]).tolist()))
