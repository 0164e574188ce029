"""Units at the end of a column's name whose quantity is known: `gyro_deg_s`, `p_bar`, `angleDeg`.

A header alone says less: the last words of `i_m_s` are metres a second or the motor and the stator.
A model that wants an angular rate of `gyro_deg_s` settles it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from itertools import product
from typing import NamedTuple

from casid.data.reading.header_units import fitting_readings, is_no_ending, one_reading
from casid.model.unit_names import AMBIGUOUS
from casid.model.units import parse_unit, same_dimension

_BETWEEN = re.compile(r"[\s,_.\-]+")
_CAPITAL = re.compile(r"(.*[a-z0-9])([A-Z][A-Za-z]*)")  # angleDeg, motorSpeedRPM
_LONGEST = 5  # words of a unit: W m2 per K s
# Units of the list that are words, too: of a foot, in calibrated, a minimum, a variance, a count.
_WORDS = frozenset("in min foot cal var rev mi VA cc none 1 -".split())


class NameEnding(NamedTuple):
    """What the last words of a column's name may be.

    Attributes
    ----------
    text : the words.
    units : of the list, of the quantity that is wanted; one but where the text has two readings.
    is_doubtful : they may as well be an index, or a word of the name.
    """

    text: str
    units: list[str]
    is_doubtful: bool


def name_ending(column: str, target: str) -> NameEnding | None:
    """The unit of the target's quantity that a column's name ends in.

    Doubtful are one letter (`T_C`, `a_g`: of a cold side, of the ground), a word (`h_in`) and a
    unit with two readings. None where there is no such unit, or one of the target's size alone.

    Parameters
    ----------
    column : the name as the file has it.
    target : unit that the model declares.
    """
    words = [w for w in _BETWEEN.split(column) if w]
    for count in range(min(_LONGEST, len(words) - 1), 1, -1):
        tail = words[-count:]
        if units := _others(_compounds(tuple(tail)), target):
            return NameEnding("_".join(tail), units, len(units) > 1)
    if len(words) > 1 and (found := _single(words[-1], target)):
        return found
    capital = _CAPITAL.fullmatch(words[-1]) if words else None
    return _capital(capital[2], target) if capital else None


def _single(word: str, target: str) -> NameEnding | None:
    """One word behind an underscore, a space, a dot or a hyphen."""
    reading = one_reading(word)
    units = _others([*filter(None, [reading]), *fitting_readings(word, target)], target)
    is_word = len(word) == 1 or word.casefold() in _WORDS or word in _WORDS
    is_doubtful = len(units) > 1 or (is_word and is_no_ending(word)) or word in AMBIGUOUS
    return NameEnding(word, units, is_doubtful) if units else None


def _capital(word: str, target: str) -> NameEnding | None:
    """One word that begins with a capital letter: Deg, Kmh, KPa, RPM."""
    if len(word) == 1:
        return _single(word, target)
    ways = dict.fromkeys((word, word[0].lower() + word[1:], word.lower()))
    found = [e for way in ways if (e := _single(way, target))]
    units = _others([u for e in found for u in e.units], target)
    return NameEnding(word, units, len(units) > 1 or found[0].is_doubtful) if units else None


def _others(readings: list[str], target: str) -> list[str]:
    """Units of the target's dimension, each size once; none where all have the target's size."""
    own = parse_unit(target)
    sizes: dict[tuple[float, float], str] = {}
    for unit in readings:
        if same_dimension(unit, target):
            parsed = parse_unit(unit)
            sizes.setdefault((round(parsed.factor / own.factor, 9), parsed.offset), unit)
    return [] if set(sizes) <= {(1.0, own.offset)} else list(sizes.values())


@lru_cache(maxsize=4096)
def _compounds(words: tuple[str, ...]) -> list[str]:
    """Products and quotients of units that words in a row may be: `deg s`, `W m2 K`, `km per h`."""
    if "per" in words:
        reading = one_reading(" ".join(words))
        return [reading] if reading else []
    if not all(map(_is_factor, words)):
        return []
    return [reading for text in _arrangements(words) if (reading := one_reading(text))]


def _is_factor(word: str) -> bool:
    return word[0].isalpha() and (one_reading(word) is not None or word in AMBIGUOUS)


def _arrangements(words: tuple[str, ...]) -> Iterator[str]:
    """Each word behind the first above or below the line of a quotient."""
    first, *others = words
    for is_below in product([True, False], repeat=len(others)):
        above = " ".join(
            [first, *(w for w, down in zip(others, is_below, strict=True) if not down)]
        )
        below = " ".join(w for w, down in zip(others, is_below, strict=True) if down)
        yield above if not below else f"{above}/({below})" if " " in below else f"{above}/{below}"
