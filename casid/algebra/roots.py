"""Poles and zeros with their frequency, damping and stability."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Root:
    """A pole or zero.

    Attributes
    ----------
    value : in the plane of q or s.
    variable : "q" or "s".
    Ts : sample time [s]; None where it is not stated: frequencies are then in rad/sample.
    """

    value: complex
    variable: str = "q"
    Ts: float | None = None

    @property
    def is_stable(self) -> bool:
        """Strictly inside the unit circle, or strictly in the left half plane."""
        return self.value.real < 0 if self.variable == "s" else abs(self.value) < 1

    @property
    def exponent(self) -> complex:
        """The corresponding s: itself, or log(q) / Ts; -inf for q = 0."""
        if self.variable == "s":
            return self.value
        if self.value == 0:
            return complex(-math.inf)
        return cmath.log(self.value) / (self.Ts or 1.0)

    @property
    def frequency(self) -> float:
        """Natural frequency |s| [rad/s], or [rad/sample] without a sample time."""
        return abs(self.exponent)

    @property
    def damping(self) -> float:
        """Relative damping -Re s / |s|; 1 for s = 0."""
        s = self.exponent
        return 1.0 if s == 0 or math.isinf(abs(s)) else -s.real / abs(s)

    def __str__(self) -> str:
        v = self.value
        where = f"{v.real:.4g}" + (f" {'+-'[v.imag < 0]} {abs(v.imag):.4g}i" if v.imag else "")
        unit = "rad/s" if self.variable == "s" or self.Ts else "rad/sample"
        if math.isinf(self.frequency):
            return f"{self.variable} = 0 (a delay)"
        region = (
            "stable"
            if self.is_stable
            else "right half plane"
            if self.variable == "s"
            else f"|q| = {abs(v):.4g}, not inside the unit circle"
        )
        return f"{self.variable} = {where} ({region}, {self.frequency:.4g} {unit})"


def roots_of(
    coefficients: list[float], variable: str = "q", Ts: float | None = None
) -> tuple[Root, ...]:
    """The roots of a polynomial (descending powers), largest first."""
    found = sorted((complex(x) for x in np.roots(coefficients)), key=lambda x: (-abs(x), -x.imag))
    return tuple(Root(x, variable or "q", Ts) for x in found)
