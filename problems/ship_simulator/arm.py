"""Where a heeled hull finds its righting arm: cross curves as a polynomial or a table.

arm(phi) [m] is the distance from the CO at which the hull's buoyancy acts on a ship that heels by
phi [rad]; the weights' part is taken from it in `hull.Ship.restoring`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casid.errors import DataError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PolynomialArm:
    """Cross curve arm(phi) = c_1 phi + c_3 phi^3 + c_5 phi^5 + ... [m], odd."""

    odd: tuple[float, ...]

    def __call__(self, phi: Any) -> Any:
        """The arm [m] at heel phi [rad]: a number, an array or a CasADi expression."""
        square, total = phi * phi, 0.0
        for c in reversed(self.odd):
            total = total * square + c
        return total * phi

    def integral(self, phi: Array) -> Array:
        """The arm's integral from 0 to phi [m rad]."""
        powers = [c * phi ** (2 * i + 2) / (2 * i + 2) for i, c in enumerate(self.odd)]
        return np.asarray(sum(powers), dtype=np.float64)

    @property
    def slope(self) -> float:
        """Of the arm at zero heel [m/rad]."""
        return self.odd[0]

    @property
    def reach(self) -> float:
        """Heel up to which the arm means something [rad]."""
        return math.pi / 2


@dataclass(frozen=True, slots=True)
class TabulatedArm:
    """Cross curve through a table of heel [rad] and arm [m], odd, by the natural cubic spline.

    It has two continuous derivatives, zero heel included, so that Runge-Kutta 4 keeps its order.

    Parameters
    ----------
    phi : heels, increasing from 0.
    arm : arms, the first zero.

    Raises
    ------
    DataError
        If the table is too short, does not begin at (0, 0) or does not increase.
    """

    phi: tuple[float, ...]
    arm: tuple[float, ...]
    _jumps: tuple[float, ...] = field(init=False, repr=False, compare=False)
    _slope: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        x, y = np.asarray(self.phi, dtype=np.float64), np.asarray(self.arm, dtype=np.float64)
        if x.shape != y.shape or x.size < 3 or not np.all(np.isfinite(x) & np.isfinite(y)):
            raise DataError(
                f"restoring arm: {x.size} heels and {y.size} arms, finite or not. "
                "Give at least three heels [rad] and as many finite arms [m]."
            )
        if x[0] != 0.0 or y[0] != 0.0 or np.any(np.diff(x) <= 0.0):
            raise DataError(
                "restoring arm: the table must begin at (0, 0) and its heels must increase. "
                "Give the starboard half; the port half is its mirror image."
            )
        object.__setattr__(self, "phi", tuple(float(a) for a in x))
        object.__setattr__(self, "arm", tuple(float(a) for a in y))
        h, n = np.diff(x), x.size
        A, b = np.eye(n), np.zeros(n)  # second derivatives, zero at both ends
        for i in range(1, n - 1):
            A[i, i - 1 : i + 2] = h[i - 1], 2.0 * (h[i - 1] + h[i]), h[i]
            b[i] = 6.0 * ((y[i + 1] - y[i]) / h[i] - (y[i] - y[i - 1]) / h[i - 1])
        second = np.linalg.solve(A, b)
        slope = (y[1] - y[0]) / h[0] - h[0] * second[1] / 6.0
        third = np.append(np.diff(second) / h, 0.0)
        jumps = np.diff(third, prepend=0.0) / 6.0
        object.__setattr__(self, "_slope", float(slope))
        object.__setattr__(self, "_jumps", tuple(float(a) for a in jumps))

    def __call__(self, phi: Any) -> Any:
        """The arm [m] at heel phi [rad]: a number, an array or a CasADi expression."""
        symbolic = isinstance(phi, ca.SX | ca.MX)
        heel = ca.fabs(phi) if symbolic else np.abs(phi)
        total = self._slope * heel
        for knot, jump in zip(self.phi, self._jumps, strict=True):
            beyond = ca.fmax(heel - knot, 0.0) if symbolic else np.maximum(heel - knot, 0.0)
            total = total + jump * (beyond * beyond * beyond)
        return (ca.sign(phi) if symbolic else np.sign(phi)) * total

    def integral(self, phi: Array) -> Array:
        """The arm's integral from 0 to phi [m rad]."""
        heel = np.abs(phi)
        total = self._slope * heel**2 / 2
        for knot, jump in zip(self.phi, self._jumps, strict=True):
            total = total + jump * np.maximum(heel - knot, 0.0) ** 4 / 4
        return np.asarray(total, dtype=np.float64)

    @property
    def slope(self) -> float:
        """Of the arm at zero heel [m/rad]."""
        return self._slope

    @property
    def reach(self) -> float:
        """Heel up to which the arm means something [rad]: the table's last."""
        return self.phi[-1]
