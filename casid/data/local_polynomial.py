"""Smoothing and differentiation of samples by local polynomials, with what they do to noise.

A polynomial is fitted by least squares to the samples within half a window of each instant; its
value or derivative there is a fixed weighted sum of them (Savitzky and Golay 1964, Analytical
Chemistry 36, 1627-1639): a symmetric (or antisymmetric) FIR filter, of zero phase (or 90 degrees).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from casid.arrays import FloatArray
from casid.errors import DataError


@dataclass(frozen=True, slots=True)
class LocalPolynomial:
    """A local polynomial smoother and differentiator.

    Attributes
    ----------
    window : s, from the first sample used to the last.
    degree : of the polynomial; polynomials of that degree pass unchanged.

    Example
    -------
    >>> import numpy as np
    >>> from casid.data.local_polynomial import LocalPolynomial
    >>> t = 0.1 * np.arange(50)
    >>> rate = LocalPolynomial(1.0).apply(t**3, 0.1, derivative=1)
    >>> bool(np.allclose(rate, 3 * t**2))
    True
    """

    window: float
    degree: int = 3

    def half(self, Ts: float) -> int:
        """Samples on either side of the centre: half the window, rounded.

        Raises
        ------
        DataError
            If the window holds no more samples than the polynomial has coefficients.
        """
        M = round(self.window / (2 * Ts))
        if not (math.isfinite(self.window) and 2 * M + 1 > self.degree + 1 and self.degree >= 1):
            raise DataError(
                f"a window of {self.window:g} s holds {2 * M + 1} samples at Ts = {Ts:g} s, which "
                f"leaves nothing to smooth for a polynomial of degree {self.degree}; take a window "
                f"of at least {(self.degree + 2) * Ts:.3g} s"
            )
        return M

    def _fit(self, Ts: float) -> FloatArray:
        """(degree + 1, 2 M + 1): samples of a window to coefficients of powers of t/(M Ts)."""
        M = self.half(Ts)
        x = np.arange(-M, M + 1) / M
        return np.asarray(np.linalg.pinv(np.vander(x, self.degree + 1, increasing=True)))

    def taps(self, Ts: float, derivative: int = 0) -> FloatArray:
        """(2 M + 1,) weights of the samples k - M .. k + M, in 1/s^derivative."""
        scale = math.factorial(derivative) / (self.half(Ts) * Ts) ** derivative
        return np.asarray(self._fit(Ts)[derivative] * scale)

    def apply(self, values: ArrayLike, Ts: float, derivative: int = 0) -> FloatArray:
        """The smoothed samples, or their derivative, (N,).

        The first and last M samples come from the polynomial of the first and last window, off its
        centre: they carry several times the noise, and a record is better cut there.

        Parameters
        ----------
        values : (N,) samples, finite.
        Ts : sample time [s].
        derivative : 0, 1, ... up to the degree.

        Raises
        ------
        DataError
            If there are fewer samples than a window holds, or `derivative` is above the degree.
        """
        y = np.asarray(values, dtype=np.float64)
        M = self.half(Ts)
        if not 0 <= derivative <= self.degree:
            raise DataError(
                f"derivative {derivative} of a polynomial of degree {self.degree}; choose one from "
                f"0 to {self.degree}, or a higher degree"
            )
        if y.ndim != 1 or len(y) < 2 * M + 1:
            raise DataError(
                f"values of shape {y.shape} do not fill a window of {2 * M + 1} samples "
                f"({self.window:g} s); give (N,) samples, or a shorter window"
            )
        out = np.empty_like(y)
        out[M : len(y) - M] = np.convolve(y, self.taps(Ts, derivative)[::-1], mode="valid")
        fit, powers = self._fit(Ts), np.arange(derivative, self.degree + 1)
        factor = np.array([math.perm(int(k), derivative) for k in powers]) / (M * Ts) ** derivative
        x = np.arange(-M, M + 1)[:, None] / M
        inside = (x ** (powers - derivative)) * factor
        out[:M] = (inside @ fit[derivative:] @ y[: 2 * M + 1])[:M]
        out[len(y) - M :] = (inside @ fit[derivative:] @ y[-(2 * M + 1) :])[M + 1 :]
        return out

    def gain(self, frequencies_hz: ArrayLike, Ts: float, derivative: int = 0) -> FloatArray:
        """Gain at frequencies f [Hz] relative to that of the exact operator, (2 pi f)^derivative.

        Negative where the sign turns; 1 at f = 0.
        """
        f = np.asarray(frequencies_hz, dtype=np.float64)
        taps, M = self.taps(Ts, derivative), self.half(Ts)
        w = 2 * np.pi * np.maximum(f, 1e-9 / (M * Ts))
        turn = np.exp(1j * w[..., np.newaxis] * Ts * np.arange(-M, M + 1))
        return np.asarray(np.real(turn @ taps / (1j * w) ** derivative))

    def bandwidth_hz(self, Ts: float, derivative: int = 0) -> float:
        """Frequency at which `gain` has fallen to 1/sqrt(2) [Hz]; Nyquist's where it never does."""
        grid = np.linspace(0.0, 0.5 / Ts, 4001)
        below = np.flatnonzero(self.gain(grid, Ts, derivative) < np.sqrt(0.5))
        return float(grid[below[0]] if below.size else grid[-1])

    def describe(self, Ts: float, derivative: int = 0) -> str:
        """What it does, with bandwidth, for a record's provenance."""
        what = "smoothed" if derivative == 0 else f"differentiated {derivative} x"
        return (
            f"{what} by polynomials of degree {self.degree} over {2 * self.half(Ts) * Ts:.3g} s "
            f"(half power at {self.bandwidth_hz(Ts, derivative):.3g} Hz)"
        )
