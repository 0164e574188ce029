"""Values with their units as people read them: prefixes, and times in minutes, hours, days."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from decimal import Decimal

from casid.arrays import TINY

_PREFIXED = re.compile(r"(rad|Hz|Pa|[mNVAWJ])(?![\w^])")
"""Units that take a prefix where they stand first, to the power of one."""
_PREFIXES = {-3: "n", -2: "\u00b5", -1: "m", 0: "", 1: "k", 2: "M", 3: "G"}
_TIMES = ((86400.0, "d"), (3600.0, "h"), (60.0, "min"))
_POWERS = {"^2": "\u00b2", "^3": "\u00b3"}


def unit_text(unit: str) -> str:
    """A unit as it is read: m^2 with a raised 2."""
    return re.sub(r"\^[23](?![.\d])", lambda m: _POWERS[m[0]], unit)


def quantity_texts(values: Sequence[float], unit: str) -> tuple[list[str], str]:
    """Values of one quantity with a common prefix of their unit, and that unit.

    The prefix is that of the largest value; a time longer than two minutes is in minutes, hours or
    days. Units that take no prefix (deg, kg, %) keep their values; the unit 1 is left out.
    """
    scale, shown = common_prefix(values, unit)
    return [_three_digits(v / scale) for v in values], shown


def common_prefix(values: Sequence[float], unit: str) -> tuple[float, str]:
    """What values are divided by, and the unit that they then have (see `quantity_texts`)."""
    sizes = [abs(v) for v in values if math.isfinite(v) and v]
    largest = max(sizes, default=0.0)
    scale, shown = 1.0, unit if unit != "1" else ""
    if unit == "s":
        scale, shown = next(((s, n) for s, n in _TIMES if largest >= 2 * s), (1.0, unit))
    elif _PREFIXED.match(unit) and largest > 0:
        steps = math.floor(math.log10(largest) / 3)
        if 0.1 <= largest < 1e4:  # 0.187 m is left alone, 0.187 and 0.001 m are 187 and 1 mm
            steps = -1 if largest < 1 and min(sizes) < 0.01 else 0
        steps = min(max(steps, -3), 3)
        scale, shown = 1000.0**steps, _PREFIXES[steps] + unit
    return scale, shown


def quantity_text(value: float, unit: str) -> str:
    """A value with its unit as people read it: 1.2e6 s is 13.9 d, 0.0002 rad is 0.2 mrad."""
    (number,), shown = quantity_texts([value], unit)
    return f"{number} {shown}".rstrip()


def _three_digits(value: float) -> str:
    """Three digits; the smaller ones of a common prefix without an exponent."""
    if not math.isfinite(value):
        return "not finite"
    if 1000 <= abs(value) < 1e5:
        return f"{value:.0f}"
    return f"{value:.3g}"


def span_text(start: float, stop: float) -> str:
    """An interval of time [s] with the decimals that separate its ends: 86393.1 to 86395.4 s."""
    length = abs(stop - start)
    places = max(0, 1 - math.floor(math.log10(length))) if 0 < length < math.inf else 3
    if places > 3 and abs(start) < 1:  # microseconds read better with an exponent
        return f"{start:.3g} to {stop:.3g} s"
    return f"{start:.{places}f} to {stop:.{places}f} s"


def instant_text(seconds: float, resolution: float) -> str:
    """An instant [s] to within `resolution`: 30.4 h to within 300 s, 27.99 s to within 10 ms.

    In minutes, hours or days where two decimals show what is resolved; in hours where a hundredth
    of a day is more than twice of that.
    """
    return _instant_texts([seconds], resolution)[0]


def while_text(start: float, stop: float) -> str:
    """When something that lasts for a while does [s], to a thirtieth of it: "50.0 h to 51.5 h"."""
    return " to ".join(_instant_texts([start, stop], max(stop - start, 1e-9) / 30))


def _instant_texts(instants: Sequence[float], resolution: float) -> list[str]:
    """Instants in one unit, with the decimals that show the resolution (both in s)."""
    scale, shown = common_prefix(instants, "s")
    if shown == "d" and 2 * resolution < 0.01 * scale:
        scale, shown = 3600.0, "h"
    if resolution / scale < 10**-2.5:  # a third decimal
        scale, shown = 1.0, "s"
    places = min(max(0, round(-math.log10(resolution / scale))), 9)
    return [f"{t / scale:.{places}f} {shown}" for t in instants]


def percent_text(value: float) -> str:
    """A percentage with two digits, or all of those before the point: 0.76 %, 12 %, 150 %."""
    return f"{value:.0f} %" if abs(value) >= 10 else f"{value:.2g} %"


def growth_text(times: float) -> str:
    """How much larger something became: by 13 %, or 4.6 times as large where that reads better."""
    return (
        f"by {percent_text(100 * (times - 1))}"
        if times < 4
        else f"{_three_digits(times)} times as large"
    )


def window_text(start: float, stop: float) -> str:
    """A window of time [s] as the option --window has it, "10:30"; an open end is left empty.

    Twelve digits tell milliseconds of a clock that counts since 1970.
    """
    ends = [Decimal(f"{end:.12g}") if math.isfinite(end) else None for end in (start, stop)]
    return ":".join("" if end is None else f"{end:f}" for end in ends)


def count_text(n: int, noun: str) -> str:
    """A number of things, the noun in the plural unless it is one: 0 gaps, 1 gap, 2 gaps."""
    return f"{n} {noun}{'' if n == 1 else 's'}"


def times_text(factor: float) -> str:
    """By how much: twice, 4 times."""
    return "twice" if factor == 2 else f"{factor:g} times"


def are(n: int) -> str:
    """The verb of so many things: 1 gap is, 2 gaps are."""
    return "is" if n == 1 else "are"


def p_statement(p: float, form: str = ".2g") -> str:
    """A p-value in a sentence: `p = 0.012`, and `p < 1e-300` where it is computed as zero."""
    return f"p < {TINY:g}" if p <= TINY else f"p = {p:{form}}"


def listed(names: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def shortened(names: Sequence[str], most: int = 40) -> str:
    """Names with commas; of very many the first, and how many more there are."""
    if len(names) <= most:
        return ", ".join(names)
    return f"{', '.join(names[:most])} and {len(names) - most} more"
