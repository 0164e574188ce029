"""Units as headers write them: `phi [deg]`, `h (in cm)`, `P in kW`, `q/(deg/s)`, `phi_deg`."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import NamedTuple

from casid.errors import UnitError
from casid.model.unit_names import ALIASES, AMBIGUOUS, NAMES
from casid.model.units import parse_unit, same_dimension

_ENCLOSED = r"\s*/?\s*(?:\[\s*([^\]]*?)\s*\]|\(\s*([^)]*?)\s*\)|<\s*([^>]*?)\s*>)"
_BRACKET = re.compile(rf"(.*?){_ENCLOSED}\s*(.*)")
_LAST = re.compile(rf"(.*[\])>]){_ENCLOSED}")
_IN_WORD = re.compile(r"in\s+(\S.*)", re.IGNORECASE)  # of "(in cm)"
_IN = re.compile(r"(.+?)[\s_,]+in[\s_]+(\S.*)", re.IGNORECASE)
_SLASH = re.compile(r"(.+?)\s*/\s*([^\s\d].*)")
_COMPOUND = re.compile(r"\S[/*·^]\S|[²³]$")  # signs that a compound has and a name has not
_SPACE = re.compile(r"(.*\S)[\s,]+(\S+)")
_LAST_IN = re.compile(r"[\s,]+in$", re.IGNORECASE)  # the word before the unit: sun in W/m^2
_QUOTIENT = re.compile(r"(.+?)_([^_]+)_(per_)?([^_]+)")  # name, above and below the line
_RATE = re.compile(r"s2?|sec|second|min|minute|hr?|hour|ms")  # below the line of a rate
_SPACE_UNIT = re.compile(r"[cdm]?m[23]|[lL]")  # and of a density: an area or a volume
_WITH_TIME = ("A", "W", "V", "N", "Pa", "J")  # as in A h, W h, V s, N s, Pa s
_CAPITALS = ("N", "W", "J")  # single letters that are rather units than indices
# Endings that are more often a word, an index or another unit than what the list reads: x_in is an
# input, x_bar a mean, x_min a minimum, a_s a sensor's signal, u_ms metres a second, r_psi a
# heading, x_var a variance, x_hp high-pass filtered, x_cal calibrated.
_NO_ENDINGS = frozenset(
    "none 1 h hr min t s in rev bar L l ms us mg sec second seconds minute minutes hour hours "
    "foot feet amp psi psia var hp cal mi cc VA percent pct d day days - % gram grams".split()
)
# What the list of units does not have, as loggers write it.
_WRITTEN = {
    "ms2": "m/s^2",
    "inches": "in",
    "nmm": "N mm",
    "ftlb": "ft lbf",
    "ft-lb": "ft lbf",
    "sek": "s",
    "sekunde": "s",
    "sekunden": "s",
    "msek": "ms",
    "millisekunden": "ms",
    "milliseconds": "ms",
    "microseconds": "us",
    "millis": "ms",
    "micros": "us",
    "minuten": "min",
    "mins": "min",
    "std": "h",
    "stunde": "h",
    "stunden": "h",
    "umdr/min": "rpm",
    "umin": "rpm",
    "u/min": "rpm",
    "1/min (rpm)": "rpm",
    "grad celsius": "degC",
    "grad c": "degC",
    "deg c": "degC",
    "deg_c": "degC",
    "°celsius": "degC",
    "º": "deg",
    "ºc": "degC",
    "prozent": "%",
    "liter/min": "L/min",
    "w/m²": "W/m^2",
    "arb. units": "1",
    "a.u.": "1",
    "raw": "1",
    "counts": "1",
    "count": "1",
    "digits": "1",
    "lsb": "1",
    "bool": "1",
    "0/1": "1",
}
# Names in full, in small letters and in the singular.
_IN_FULL = {alias: name for alias, name in ALIASES.items() if len(alias) > 2 and alias.isalpha()}
_IN_FULL |= {
    entry.pint.casefold().replace("_", " "): name
    for name, entry in reversed(NAMES.items())
    if entry.pint.isidentifier() and len(entry.pint) > 2 and entry.pint != "pound"  # mass or force
}
_IN_FULL |= {w.replace("meter", "metre").replace("liter", "litre"): n for w, n in _IN_FULL.items()}
_IN_FULL["kilogram"] = "kg"
# Names with two readings, as units of the list; the model's unit may settle which.
_READINGS = {
    "C": ("degC", "coulomb"),
    "F": ("degF", "farad"),
    "g": ("gram", "g0"),
    "G": ("g0",),
    "mg": ("mg", "mg0"),
    "mG": ("mg0",),
    "ug": ("ug", "ug0"),
    "µg": ("ug", "ug0"),
    "KN": ("kN", "kn"),
    "Kn": ("kN", "kn"),
    "KT": ("kn", "t"),
    "kt": ("kn", "t"),
    "nm": ("nmi", "N m", "nanometre"),
    "NM": ("nmi", "N m"),
    "nM": ("nmi", "N m"),
    "T": ("t", "s", "tesla"),
    "S": ("s", "siemens"),
    "gal": ("USgal", "UKgal"),
    "gallon": ("USgal", "UKgal"),
    "gallons": ("USgal", "UKgal"),
    "gpm": ("USgal/min", "UKgal/min"),
    "gph": ("USgal/h", "UKgal/h"),
    "oz": ("ozm", "ozf"),
    "lb": ("lbm", "lbf"),
    "lbs": ("lbm", "lbf"),
    "grad": ("deg", "degC"),
    "in lb": ("in lbf", "lbm", "lbf"),
    "in lbf": ("in lbf", "lbf"),
    "ton": ("t",),
    "tons": ("t",),
    "degs": ("deg", "deg/s"),
    "rads": ("rad", "rad/s"),
}
_LIKELY = {"1/min": "rpm", "min-1": "rpm", "min^-1": "rpm", "/min": "rpm"}
_TWO_FOLD = {
    "grad": "deg (degree of angle) or degC (degree Celsius)",
    "1/min": "rpm (revolutions a minute) or rad/min",
    "min-1": "rpm (revolutions a minute) or rad/min",
    "min^-1": "rpm (revolutions a minute) or rad/min",
    "/min": "rpm (revolutions a minute) or rad/min",
    "in lb": "in lbf (inch times pound-force), lbm or lbf",
    "in lbf": "in lbf (inch times pound-force) or lbf",
}


class HeaderUnit(NamedTuple):
    """A unit that a header may name.

    Attributes
    ----------
    text : as written.
    unit : as the list of units reads it; None where it cannot be read in one way.
    stem : the header without it.
    is_sure : it stands in brackets, behind "in" or a slash, or in a row of units; a mere ending of
        the name is a hint.
    why : where it cannot be read, the readings or that there is none.
    """

    text: str
    unit: str | None
    stem: str
    is_sure: bool
    why: str = ""


def header_unit(column: str) -> HeaderUnit | None:
    """The unit that a column's name ends with; None where it has none."""
    last = _LAST.fullmatch(column)  # H(t) (cm)
    if last:
        found = written_unit(next(t for t in last.groups()[1:4] if t is not None), last[1])
        if found.unit is not None or found.why:
            return found
    bracket = _BRACKET.fullmatch(column)
    if bracket and bracket[1] and (bracket[2] is not None or not bracket[5]):
        text = next(t for t in bracket.groups()[1:4] if t is not None)
        found = written_unit(text, bracket[1])
        if found.unit is not None or found.why or bracket[2] is not None:
            return found
        return None  # (filtered) is part of the name
    named = " / " in column or column[:2] == "t/" or _IN.fullmatch(column)
    if not named and one_reading(column) is not None:
        return None  # a unit without a name; t / s and t in s are times in seconds, not tonnes
    space = _SPACE.fullmatch(column)
    if space and "/" in space[2][1:] and not space[1].endswith("/") and one_reading(space[2]):
        return HeaderUnit(space[2], one_reading(space[2]), _LAST_IN.sub("", space[1]), True)
    if compound := _compound_ending(column):
        return compound
    for pattern in (_IN, _SLASH):
        match = pattern.fullmatch(column)
        if match:
            found = written_unit(match[2], match[1])
            if found.unit is not None or found.why:
                return found
    if quotient := _quotient_ending(column):
        return quotient if quotient.unit else None
    stem, underscore, ending = column.rpartition("_")
    if stem and underscore and ending:
        hint = None if is_no_ending(ending) else one_reading(ending)
        return HeaderUnit(ending, hint, stem, False) if hint else None
    if space and not is_no_ending(space[2]) and (len(space[2]) > 1 or not space[2].isalpha()):
        hint = one_reading(space[2])
        return HeaderUnit(space[2], hint, space[1], space[2][0] in "°%") if hint else None
    return None


def _compound_ending(column: str) -> HeaderUnit | None:
    """A quotient, a power or a product of units behind the last underscore: rate_deg/s, q_m3/h.

    A word before a slash that is rather the end of a name belongs to the name, as of T_in/degC,
    unless it is a rate: q_l/min.
    """
    stem, underscore, ending = column.rpartition("_")
    if not (stem and underscore and _COMPOUND.search(ending)):
        return None
    above, slash, below = ending.partition("/")
    if slash and is_no_ending(above) and not (_is_time(below) and not _is_time(above)):
        return None
    found = written_unit(ending, stem)
    return found if found.unit is not None or found.why else None


def _quotient_ending(column: str) -> HeaderUnit | None:
    """A quotient whose slash is an underscore: rate_deg_s, rho_kg_m3, turn_deg_per_s.

    Its unit is None where the words may be a product as well: torque_N_m, charge_mA_h.
    """
    match = _QUOTIENT.fullmatch(column)
    if match is None or not match[2][0].isalpha():
        return None
    stem, above, per, below = match.groups()
    unit = one_reading(f"{above}/{below}")
    flow = above in {"l", "L"} and _is_time(below)
    if unit is None or not (per or flow or not is_no_ending(above)):
        return None
    is_rate = _RATE.fullmatch(below) and not any(same_dimension(above, u) for u in _WITH_TIME)
    is_density = _SPACE_UNIT.fullmatch(below) and not (above == "kg" and below.endswith("2"))
    if per or flow or (is_rate and (len(above) > 1 or above == "m")):
        return HeaderUnit(f"{above}_{per or ''}{below}", unit, stem, False)
    if len(above) == 1 and above not in _CAPITALS:
        return None  # an index: of i_d_A, the direct axis
    return HeaderUnit(f"{above}_{below}", unit if is_density else None, stem, False)


def _is_time(text: str) -> bool:
    unit = one_reading(text)
    return unit is not None and same_dimension(unit, "s")


def is_no_ending(text: str) -> bool:
    """Whether an ending is rather a word; of single letters the case tells."""
    return text in _NO_ENDINGS or (len(text) > 1 and text.casefold() in _NO_ENDINGS)


def written_unit(text: str, stem: str = "") -> HeaderUnit:
    """A unit where one is written: in brackets, or in a row of units."""
    text = text.strip()
    text = re.sub(r"^[\[(<]\s*(.*?)\s*[\])>]$", r"\1", text) if len(text) > 1 else text
    word = _IN_WORD.fullmatch(text) if text.casefold() not in _TWO_FOLD else None
    if word and (one_reading(word[1]) is not None or _readings_of(word[1])):  # no inch times cm
        text = word[1]
    unit = one_reading(text)
    if unit is not None:
        return HeaderUnit(text, unit, stem, True)
    if re.fullmatch(r"\d+", text):  # an index
        return HeaderUnit(text, "1", stem, False)
    return HeaderUnit(text, None, stem, True, _readings_of(text))


@lru_cache(maxsize=4096)
def one_reading(text: str) -> str | None:
    """The unit of the list that `text` stands for, where there is one alone."""
    if not text:
        return "1"
    if text.casefold() in _TWO_FOLD:
        return None
    for candidate in (_WRITTEN.get(text.casefold()), text, _symbols(text)):
        if candidate is None:
            continue
        try:
            parse_unit(candidate)
        except UnitError:
            continue
        return candidate
    return None


def _symbols(text: str) -> str:
    """A unit in words as symbols: Meter per second, Newton metre."""
    parts = re.split(r"\s+per\s+|\s*/\s*", text)
    return "/".join(
        _in_full(part) or " ".join(_in_full(word) or word for word in part.split())
        for part in parts
    )


def _in_full(word: str) -> str | None:
    word = word.casefold()
    return _IN_FULL.get(word) or _IN_FULL.get(word.removesuffix("s"))


def _readings_of(text: str) -> str:
    return AMBIGUOUS.get(text) or _TWO_FOLD.get(text.casefold(), "")


def settled(found: HeaderUnit, target: str) -> str | None:
    """The one reading of an ambiguous unit that has the target's dimension; None otherwise."""
    fits = fitting_readings(found.text, target)
    return fits[0] if len(fits) == 1 else None


def fitting_readings(text: str, target: str) -> list[str]:
    """The readings of an ambiguous unit that have the target's dimension."""
    readings = _READINGS.get(text) or _READINGS.get(text.casefold(), ())
    return [u for u in readings if same_dimension(u, target)]


def likely_reading(text: str) -> str | None:
    """The reading of an ambiguous unit that a draft may take, to be checked; None for none.

    Revolutions a minute are what tachometers show.
    """
    return _LIKELY.get(text)


def looks_like_unit(cell: str) -> bool:
    """Whether a cell may be one of a row of units; empty ones and dashes may."""
    cell = cell.strip()
    if not cell or cell in {"-", "--"}:
        return True
    if re.fullmatch(r"[hdmyHMSDYTjJ:./\- ]{5,}", cell):  # hh:mm:ss, dd.mm.yyyy
        return True
    found = written_unit(cell)
    return found.is_sure and (found.unit is not None or bool(found.why))
