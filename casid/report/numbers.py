"""Numbers of a page as text, with the digits that their errors leave meaningful."""

from __future__ import annotations

import math

from casid.arrays import TINY
from casid.estimation.estimate import Estimated


def p_text(p: float) -> str:
    """A p-value as text."""
    if not math.isfinite(p):
        return "\u2013"
    if p <= TINY:
        return "< 1e-300"
    return f"{p:.2g}" if p >= 1e-3 else f"{p:.0e}"


def number_text(value: float) -> str:
    """Four digits, for numbers without a known error."""
    return f"{value:.4g}" if math.isfinite(value) else "not finite"


def value_text(value: float) -> str:
    """Six digits, for values."""
    return f"{value:.6g}" if math.isfinite(value) else "not finite"


def _decimals(std_error: float) -> int | None:
    """Decimals that show two digits of the error, None where fixed notation gets too long."""
    if not math.isfinite(std_error) or std_error <= 0:
        return None
    places = 1 - math.floor(math.log10(std_error))
    return max(places, 0) if -2 <= places <= 6 else None


def estimated_texts(p: Estimated) -> tuple[str, str, str]:
    """Estimate, standard error and interval, with the digits that the error leaves meaningful."""
    interval = p.interval
    if p.std_error is None or interval is None:
        return value_text(p.value), "\u2013", "\u2013"
    places = _decimals(p.std_error)
    if places is None or abs(p.value) >= 1e7:
        between = f"{number_text(interval[0])} .. {number_text(interval[1])}"
        return value_text(p.value), f"{p.std_error:.2g}", between
    return (
        f"{p.value:.{places}f}",
        f"{p.std_error:.{places}f}",
        f"{interval[0]:.{places}f} .. {interval[1]:.{places}f}",
    )


def plus_minus(p: Estimated) -> str:
    """Estimate and standard error."""
    value, error, _ = estimated_texts(p)
    return value if p.std_error is None else f"{value} \u00b1 {error}"


def change_text(before: float, after: float) -> str:
    """Change from `before` to `after` in per cent."""
    if not (math.isfinite(before) and math.isfinite(after)) or before <= 0:
        return "\u2013"
    change = 100 * (after / before - 1)
    return f"{change:+.0f} %".replace("-", "\u2212")
