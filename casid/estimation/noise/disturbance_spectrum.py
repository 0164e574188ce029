"""The spectrum of a force that nobody recorded: waves, wind, a road, the heat of occupants.

    first order    S(w) ~ 1 / (1 + (w / w_0)^2)                                                (1)
    resonance      S(w) ~ 1 / ((1 - (w / w_0)^2)^2 + (2 zeta w / w_0)^2)                       (2)
    band           S(w) ~ (w / w_0)^2 / ((1 - (w / w_0)^2)^2 + (2 zeta w / w_0)^2)             (3)

with w_0 the corner or the peak, zeta half the relative width of the peak. (3) is the usual linear
model of a sea (Fossen 2011, section 8.2.6).

One force may act in several balances, in a fixed ratio: a crosswind pushes a car and turns it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft

from casid.arrays import TINY, Array

GRID = 4001
"""Even frequencies over which the power of a spectrum is added up."""


@dataclass(frozen=True, slots=True)
class Part:
    """One balance in which a force acts, and the ratio in which it does.

    Attributes
    ----------
    ratio : of what it does there to what it does in the first of them, in SI.
    error : standard error of the ratio.
    """

    place: str
    ratio: float
    error: float = 0.0


@dataclass(frozen=True, slots=True)
class DisturbanceSpectrum:
    """A spectrum (1), (2) or (3): of unit variance, over frequencies.

    Attributes
    ----------
    frequency : w_0 [rad/s].
    damping : zeta; None: (1).
    is_band : (3), without power at low frequencies.
    parts : of a force that acts in several balances; empty of one that acts in one.
    """

    frequency: float
    damping: float | None = None
    is_band: bool = False
    parts: tuple[Part, ...] = ()

    def at(self, omega: Array, Ts: float) -> Array:
        """The spectrum (F,) of unit variance a sample at `omega` [rad/sample], even from 0 to pi.

        Its mean over these frequencies is one, as that of white noise of unit variance is.
        """
        s = self._shape(omega, Ts)
        return np.asarray(s / max(float(np.mean(s)), TINY))

    def of(self, omega: Array, Ts: float) -> Array:
        """The spectrum of unit variance at any frequencies `omega` (F,) [rad/sample]."""
        even = self._shape(np.linspace(0.0, np.pi, GRID), Ts)
        return np.asarray(self._shape(omega, Ts) / max(float(np.mean(even)), TINY))

    def draw(self, n: int, Ts: float, rng: np.random.Generator) -> Array:
        """(n,) samples of a Gaussian force of this spectrum and unit variance."""
        # Drawn on a circle that is twice as long: its ends, which follow each other, are cut off.
        line = rfft(rng.standard_normal(2 * n))
        omega = np.linspace(0.0, np.pi, len(line))
        return np.asarray(irfft(line * np.sqrt(self.at(omega, Ts)), 2 * n)[:n])

    def is_between(self, low: DisturbanceSpectrum, high: DisturbanceSpectrum) -> bool:
        """True where neither frequency nor width is that of `low` or `high`, or beyond."""
        inside = low.frequency < self.frequency < high.frequency
        if self.damping is None or low.damping is None or high.damping is None:
            return inside
        return inside and low.damping < self.damping < high.damping

    def _shape(self, omega: Array, Ts: float) -> Array:
        r2 = (omega / (Ts * self.frequency)) ** 2
        if self.damping is None:
            return np.asarray(1 / (1 + r2))
        lower = r2 if self.is_band else 1.0
        return np.asarray(lower / ((1 - r2) ** 2 + 4 * self.damping**2 * r2 + TINY))


def parts_of(source: str, spectra: Mapping[str, DisturbanceSpectrum]) -> tuple[Part, ...]:
    """Where a source acts, and in which ratio: in the balance of its name, or in several."""
    parts = spectra[source].parts if source in spectra else ()
    return parts or (Part(source, 1.0),)
