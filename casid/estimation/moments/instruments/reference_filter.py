"""F_delta: the filter from the external reference to the unmeasured input.

Instruments and validation simulate the loop from the reference, so they need a filter for the part
between it and the unknown input: an actuator, a rider's hand, a cart's drive. A guess will do for
instruments, since a wrong F_delta costs variance and not consistency (Linder 2017, section 5.1);
for validation by simulation it has to be right. Without a guess it is estimated
(`casid.estimation.moments.instruments.reference_filter_estimate`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from casid.arrays import Array
from casid.errors import DataError, ModelError


class Filter(Protocol):
    """A filter from a reference to an estimate of the unknown input."""

    def apply(self, reference: Array, Ts: float) -> Array:
        """F(q) reference for (N,) samples at sample time `Ts` [s]."""
        ...


@dataclass(frozen=True, slots=True)
class ReferenceFilter:
    """F_delta(s) = numerator / denominator, from the external reference to an unknown input.

    Attributes
    ----------
    numerator, denominator : coefficients in descending powers of s; gain 1 by default.
    """

    numerator: tuple[float, ...] = (1.0,)
    denominator: tuple[float, ...] = (1.0,)

    @classmethod
    def lag(cls, time_constant: float, gain: float = 1.0) -> ReferenceFilter:
        """gain / (time_constant s + 1), `time_constant` in seconds."""
        return cls((gain,), (time_constant, 1.0))

    @classmethod
    def nothing(cls) -> ReferenceFilter:
        """F_delta = 0: the effect of the reference on this input is left out of the simulation."""
        return cls((0.0,))

    def __post_init__(self) -> None:
        if not self.denominator or self.denominator[0] == 0.0:
            raise ModelError("F_delta: the leading coefficient of its denominator is zero; drop it")
        if len(self.numerator) > len(self.denominator):
            raise ModelError(
                "F_delta: its numerator has a higher degree than its denominator, so it would "
                "differentiate the reference; give a proper filter"
            )
        if np.any(np.real(np.roots(self.denominator)) >= 0):
            raise ModelError(
                f"F_delta: denominator {list(self.denominator)} has a root that is not stable; "
                "the reference would be filtered to infinity. Reflect the root"
            )

    def apply(self, reference: Array, Ts: float) -> Array:
        """F_delta discretised by the bilinear transform, applied to (N,) samples."""
        if len(self.denominator) == 1:
            return np.asarray(self.numerator[0] / self.denominator[0] * reference)
        from scipy.signal import bilinear, lfilter

        b, a = bilinear(self.numerator, self.denominator, 1 / Ts)
        return np.asarray(lfilter(b, a, reference))


@dataclass(frozen=True, slots=True, eq=False)
class SampledFilter:
    """F_delta(q) = b(q^-1) / a(q^-1) at one sample time, as estimated from a record.

    Attributes
    ----------
    b, a : ascending powers of q^-1; a is monic and stable.
    fit : NRMSE fit of the signal it was estimated with, simulated [%].
    """

    b: Array
    a: Array
    Ts: float
    fit: float = float("nan")

    def apply(self, reference: Array, Ts: float) -> Array:
        """F(q) reference.

        Raises
        ------
        DataError
            If the sample time is another than that of the estimation.
        """
        if abs(Ts / self.Ts - 1) > 1e-3:
            raise DataError(
                f"F_delta was estimated at Ts = {self.Ts:g} s, the record has {Ts:g} s; estimate "
                "it again from a record with that sample time"
            )
        from scipy.signal import lfilter

        return np.asarray(lfilter(self.b, self.a, reference))
