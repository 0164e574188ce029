"""The array types of annotations, and numbers: divisors next to zero, and what JSON can hold."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

TINY = 1e-300
"""Added to, or the least of, a divisor that may vanish: far below any physical square."""


def finite_or_none(value: float) -> float | None:
    """The number, or None where it is infinite or not a number: what JSON can hold."""
    return float(value) if math.isfinite(value) else None
