"""The array type of annotations, and the number below which a divisor is taken for zero."""

from typing import Any

from numpy.typing import NDArray

Array = NDArray[Any]

TINY = 1e-300
"""Added to, or the least of, a divisor that may vanish: far below any physical square."""
