"""Gains of sensors that are those of a wrong unit: degrees that were read as radians."""

from __future__ import annotations

from itertools import permutations

from casid.diagnosis.thresholds import DESCRIPTION
from casid.estimation.estimate import Estimated
from casid.model.units import difference_to_si

_CONFUSED = (
    ("rad", "deg", "rev"),
    ("rad/s", "deg/s", "rpm"),
    ("rad/s^2", "deg/s^2"),
    ("m", "cm", "mm"),
    ("m/s", "km/h", "kn", "mm/s"),
    ("m/s^2", "g0"),
    ("N", "kN", "kgf"),
    ("Pa", "kPa", "bar"),
    ("W", "kW"),
    ("A", "mA"),
    ("V", "mV"),
)
"""Units of one quantity that loggers use; the first is that of records."""


def said_of_gain(scale: Estimated, unit: str, *, is_about_zero: bool = True) -> str:
    """What a sensor's gain looks like: a mistaken unit, or none that a sensor has; else empty.

    Parameters
    ----------
    scale, unit : as for `unit_mistaken`.
    is_about_zero : whether zero is read right, as in a wrong unit, and not some other reading.
    """
    mistaken = unit_mistaken(scale, unit) if is_about_zero else ""
    if mistaken:
        return mistaken
    gain = 1.0 + scale.value
    if 1 / DESCRIPTION.gain <= abs(gain) <= DESCRIPTION.gain:
        return ""
    return (
        f"as if it showed {gain:.3g} times what it measures: no unit that is often mistaken has "
        "this factor, and a length, a gear ratio or the zero of an angle in the model is as likely "
        "to be wrong"
    )


def unit_mistaken(scale: Estimated, unit: str) -> str:
    """Which unit was probably read as which other one, or an empty text.

    Parameters
    ----------
    scale : s of a sensor that shows 1 + s times what it measures.
    unit : SI unit of the channel.
    """
    gain = 1.0 + scale.value
    names = next((names for names in _CONFUSED if names[0] == unit), ())
    for right, read in permutations(names, 2):
        ratio = float(difference_to_si(1.0, read)) / float(difference_to_si(1.0, right))
        if abs(gain / ratio - 1.0) < DESCRIPTION.unit:
            return f"as if {right} had been read as {read}, a factor of {ratio:.4g}"
    return ""
