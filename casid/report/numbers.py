"""Numbers of a page as text, with the digits that their errors leave meaningful."""

from __future__ import annotations

import math

from casid.arrays import TINY
from casid.estimation.estimate import Estimate, Estimated
from casid.model.quantities import common_prefix


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


def share_text(share: float, decimals: int = 1) -> str:
    """A share (0.25) in per cent (25.0 %)."""
    return f"{100 * share:.{decimals}f} %"


def _decimals(std_error: float) -> int | None:
    """Decimals that show two digits of the error, None where fixed notation gets too long."""
    if not math.isfinite(std_error) or std_error <= 0:
        return None
    places = 1 - math.floor(math.log10(std_error))
    return max(places, 0) if -2 <= places <= 6 else None


def estimated_texts(p: Estimated) -> tuple[str, str, str]:
    """Estimate, standard error and interval, with the digits that the error leaves meaningful."""
    between = interval_text(p)
    if p.std_error is None:
        return value_text(p.value), "\u2013", between
    places = _places(p)
    if places is None:
        return _rounded(p.value, p.std_error), f"{p.std_error:.2g}", between
    return f"{p.value:z.{places}f}", f"{p.std_error:.{places}f}", between


def in_readable_unit(p: Estimated) -> Estimated:
    """An estimated time of more than two minutes in minutes, hours or days; others as they are.

    The delay of a blood sample, in a file whose clock counts hours, is 28.4 min and not 1702 s.
    An instant has its own rule, what its sample time resolves (`instant_text`).
    """
    if p.unit != "s" or p.std_error is None or p.resolution is not None:
        return p
    return p.in_unit(common_prefix([p.value], p.unit)[1])


def _rounded(value: float, std_error: float) -> str:
    """A value with an exponent, to the second digit of its error; six digits at most."""
    if not (math.isfinite(value) and value and math.isfinite(std_error) and std_error > 0):
        return value_text(value)
    digits = math.floor(math.log10(abs(value))) - math.floor(math.log10(std_error)) + 2
    return f"{value:.{min(max(digits, 1), 6)}g}"


def _places(p: Estimated) -> int | None:
    """Decimals of an estimate, None where fixed notation gets too long."""
    places = None if p.std_error is None else _decimals(p.std_error)
    return None if abs(p.value) >= 1e7 else places


def interval_text(p: Estimated) -> str:
    """The 95 % interval, with its kind where that is not the normal one."""
    if p.interval is None:
        return "\u2013"
    places = _places(p)
    low, high = (_end_text(end, places) for end in p.interval)
    kind = "" if p.interval_kind in ("quick", "one-sided") else f" ({p.interval_kind})"
    if is_half_open(p):
        return (f"at most {high}" if math.isinf(p.interval[0]) else f"at least {low}") + kind
    return f"{low} .. {high}{kind}"


def is_half_open(p: Estimated) -> bool:
    """True of an interval with one end."""
    return p.interval is not None and sum(map(math.isinf, p.interval)) == 1


def _end_text(end: float, places: int | None) -> str:
    if math.isinf(end):
        return "no limit"
    return number_text(end) if places is None else f"{end:z.{places}f}"


def interval_lines(e: Estimate) -> list[str]:
    """What intervals of each kind there are in an estimate, and what they assume."""
    named = {kind: e.of_interval_kind(kind) for kind in e.intervals}
    return [f"{', '.join(named[k])}: {k}, {text}" for k, text in e.intervals.items() if named[k]]


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
