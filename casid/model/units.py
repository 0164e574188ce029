"""Unit names as engineers write them, turned into SI factors."""

from __future__ import annotations

import difflib
import math
import re
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from casid.errors import UnitError

Dimension = tuple[Fraction, ...]
BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd")


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit read from text: `SI value = factor * value + offset`.

    Attributes
    ----------
    text : str
        The unit as it was written.
    factor, offset : float
        SI value per unit; offset in SI units, other than zero for degC and degF alone. In products,
        quotients and powers they are temperature differences: `W/degC` is `W/K`.
    dimension : tuple of seven Fractions
        Exponents of kg, m, s, A, K, mol, cd. Angles are dimensionless; rpm is an angular rate
        (rad/s); Hz is 1/s.
    """

    text: str
    factor: float
    offset: float
    dimension: Dimension

    @property
    def is_si(self) -> bool:
        """True where a value needs no conversion."""
        return self.factor == 1.0 and self.offset == 0.0


class _Name(NamedTuple):
    factor: float
    si: tuple[tuple[str, int], ...]  # the same kind of quantity in SI names, for display
    pint: str  # the same unit as pint writes it
    offset: float = 0.0


# Names that are SI already: exponents of BASE_UNITS.
_SI: dict[str, tuple[int, int, int, int, int, int, int]] = {
    "1": (0, 0, 0, 0, 0, 0, 0),
    "rad": (0, 0, 0, 0, 0, 0, 0),
    "kg": (1, 0, 0, 0, 0, 0, 0),
    "m": (0, 1, 0, 0, 0, 0, 0),
    "s": (0, 0, 1, 0, 0, 0, 0),
    "A": (0, 0, 0, 1, 0, 0, 0),
    "K": (0, 0, 0, 0, 1, 0, 0),
    "mol": (0, 0, 0, 0, 0, 1, 0),
    "cd": (0, 0, 0, 0, 0, 0, 1),
    "Hz": (0, 0, -1, 0, 0, 0, 0),
    "N": (1, 1, -2, 0, 0, 0, 0),
    "J": (1, 2, -2, 0, 0, 0, 0),
    "W": (1, 2, -3, 0, 0, 0, 0),
    "Pa": (1, -1, -2, 0, 0, 0, 0),
    "V": (1, 2, -3, -1, 0, 0, 0),
    "ohm": (1, 2, -3, -2, 0, 0, 0),
    "H": (1, 2, -2, -2, 0, 0, 0),
}
_SI_PINT = {"1": "dimensionless", "rad": "radian", "A": "ampere", "K": "kelvin", "H": "henry"}

_DEGREE = math.pi / 180.0
_KNOT = 1852.0 / 3600.0
_NAMES: dict[str, _Name] = {
    name: _Name(1.0, () if name == "1" else ((name, 1),), _SI_PINT.get(name, name)) for name in _SI
} | {
    # angle
    "deg": _Name(_DEGREE, (("rad", 1),), "degree"),
    "mrad": _Name(1e-3, (("rad", 1),), "milliradian"),
    "arcmin": _Name(_DEGREE / 60, (("rad", 1),), "arcminute"),
    "arcsec": _Name(_DEGREE / 3600, (("rad", 1),), "arcsecond"),
    "rev": _Name(2 * math.pi, (("rad", 1),), "revolution"),
    "rpm": _Name(2 * math.pi / 60, (("rad", 1), ("s", -1)), "revolution / minute"),
    # length
    "mm": _Name(1e-3, (("m", 1),), "millimeter"),
    "cm": _Name(1e-2, (("m", 1),), "centimeter"),
    "um": _Name(1e-6, (("m", 1),), "micrometer"),
    "km": _Name(1e3, (("m", 1),), "kilometer"),
    "in": _Name(0.0254, (("m", 1),), "inch"),
    "ft": _Name(0.3048, (("m", 1),), "foot"),
    "nmi": _Name(1852.0, (("m", 1),), "nautical_mile"),
    "L": _Name(1e-3, (("m", 3),), "liter"),
    "mL": _Name(1e-6, (("m", 3),), "milliliter"),
    # speed, acceleration
    "kn": _Name(_KNOT, (("m", 1), ("s", -1)), "knot"),
    "km/h": _Name(1 / 3.6, (("m", 1), ("s", -1)), "kilometer / hour"),
    "mph": _Name(0.44704, (("m", 1), ("s", -1)), "mile / hour"),
    "g0": _Name(9.80665, (("m", 1), ("s", -2)), "standard_gravity"),
    # time, frequency
    "ms": _Name(1e-3, (("s", 1),), "millisecond"),
    "us": _Name(1e-6, (("s", 1),), "microsecond"),
    "min": _Name(60.0, (("s", 1),), "minute"),
    "h": _Name(3600.0, (("s", 1),), "hour"),
    "day": _Name(86400.0, (("s", 1),), "day"),
    "kHz": _Name(1e3, (("Hz", 1),), "kilohertz"),
    "MHz": _Name(1e6, (("Hz", 1),), "megahertz"),
    # mass
    "gram": _Name(1e-3, (("kg", 1),), "gram"),
    "mg": _Name(1e-6, (("kg", 1),), "milligram"),
    "t": _Name(1e3, (("kg", 1),), "metric_ton"),
    "lbm": _Name(0.45359237, (("kg", 1),), "pound"),
    # force, torque, energy, power
    "mN": _Name(1e-3, (("N", 1),), "millinewton"),
    "kN": _Name(1e3, (("N", 1),), "kilonewton"),
    "MN": _Name(1e6, (("N", 1),), "meganewton"),
    "lbf": _Name(0.45359237 * 9.80665, (("N", 1),), "force_pound"),
    "Nm": _Name(1.0, (("N", 1), ("m", 1)), "newton * meter"),
    "mNm": _Name(1e-3, (("N", 1), ("m", 1)), "millinewton * meter"),
    "kNm": _Name(1e3, (("N", 1), ("m", 1)), "kilonewton * meter"),
    "MNm": _Name(1e6, (("N", 1), ("m", 1)), "meganewton * meter"),
    "kJ": _Name(1e3, (("J", 1),), "kilojoule"),
    "MJ": _Name(1e6, (("J", 1),), "megajoule"),
    "Wh": _Name(3600.0, (("J", 1),), "watt_hour"),
    "kWh": _Name(3.6e6, (("J", 1),), "kilowatt_hour"),
    "MWh": _Name(3.6e9, (("J", 1),), "megawatt_hour"),
    "mW": _Name(1e-3, (("W", 1),), "milliwatt"),
    "kW": _Name(1e3, (("W", 1),), "kilowatt"),
    "MW": _Name(1e6, (("W", 1),), "megawatt"),
    # pressure
    "hPa": _Name(1e2, (("Pa", 1),), "hectopascal"),
    "kPa": _Name(1e3, (("Pa", 1),), "kilopascal"),
    "MPa": _Name(1e6, (("Pa", 1),), "megapascal"),
    "bar": _Name(1e5, (("Pa", 1),), "bar"),
    "mbar": _Name(1e2, (("Pa", 1),), "millibar"),
    # electricity
    "mV": _Name(1e-3, (("V", 1),), "millivolt"),
    "kV": _Name(1e3, (("V", 1),), "kilovolt"),
    "uA": _Name(1e-6, (("A", 1),), "microampere"),
    "mA": _Name(1e-3, (("A", 1),), "milliampere"),
    "kA": _Name(1e3, (("A", 1),), "kiloampere"),
    "mH": _Name(1e-3, (("H", 1),), "millihenry"),
    "mohm": _Name(1e-3, (("ohm", 1),), "milliohm"),
    "kohm": _Name(1e3, (("ohm", 1),), "kiloohm"),
    # temperature; the offset holds for the unit alone
    "degC": _Name(1.0, (("K", 1),), "degree_Celsius", 273.15),
    "degF": _Name(5 / 9, (("K", 1),), "degree_Fahrenheit", 459.67 * 5 / 9),
    # share
    "%": _Name(1e-2, (), "percent"),
}

_ALIASES: dict[str, str] = {
    "": "1",
    "-": "1",
    "[-]": "1",
    "none": "1",
    "dimensionless": "1",
    "radian": "rad",
    "radians": "rad",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "rad/sec": "rad/s",
    "radps": "rad/s",
    "radps2": "rad/s^2",
    "degps": "deg/s",
    "dps": "deg/s",
    "degps2": "deg/s^2",
    "RPM": "rpm",
    "rev/min": "rpm",
    "r/min": "rpm",
    "meter": "m",
    "meters": "m",
    "metre": "m",
    "metres": "m",
    "µm": "um",
    "μm": "um",
    "inch": "in",
    "foot": "ft",
    "feet": "ft",
    "l": "L",
    "liter": "L",
    "litre": "L",
    "ml": "mL",
    "lpm": "L/min",
    "knot": "kn",
    "knots": "kn",
    "kts": "kn",
    "kmh": "km/h",
    "kph": "km/h",
    "mps": "m/s",
    "mps2": "m/s^2",
    "mpss": "m/s^2",
    "g_0": "g0",
    "gee": "g0",
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "msec": "ms",
    "µs": "us",
    "μs": "us",
    "minute": "min",
    "minutes": "min",
    "hr": "h",
    "hour": "h",
    "hours": "h",
    "d": "day",
    "days": "day",
    "hertz": "Hz",
    "grams": "gram",
    "tonne": "t",
    "tonnes": "t",
    "newton": "N",
    "volt": "V",
    "volts": "V",
    "ampere": "A",
    "amp": "A",
    "watt": "W",
    "pascal": "Pa",
    "Ω": "ohm",
    "Ohm": "ohm",
    "°C": "degC",
    "celsius": "degC",
    "°F": "degF",
    "kelvin": "K",
    "percent": "%",
    "pct": "%",
}

_AMBIGUOUS: dict[str, str] = {
    "KN": "kN (kilonewton) or kn (knot)",
    "Kn": "kN (kilonewton) or kn (knot)",
    "KT": "kn (knot) or t (tonne)",
    "kt": "kn (knot) or 1000 t (kilotonne)",
    "nm": "nmi (nautical mile), N m (newton metre) or 0.001 um (nanometre)",
    "NM": "nmi (nautical mile) or N m (newton metre)",
    "nM": "nmi (nautical mile) or N m (newton metre)",
    "g": "gram (mass) or g0 (standard gravity, 9.80665 m/s^2)",
    "G": "g0 (standard gravity, 9.80665 m/s^2); gauss is not in the list",
    "gs": "g0 (standard gravity, 9.80665 m/s^2) or gram s",
    "M": "m (metre); mega alone is no unit",
    "T": "t (tonne) or s (time); tesla is not in the list",
    "S": "s (second); siemens is 1/ohm",
    "C": "degC (degree Celsius) or A s (coulomb)",
    "F": "degF (degree Fahrenheit) or A s/V (farad)",
    "lb": "lbm (mass) or lbf (force)",
    "lbs": "lbm (mass) or lbf (force)",
    "ton": "t (1000 kg); a short ton is 907.18474 kg, a long ton 1016.0469 kg",
    "tons": "t (1000 kg); a short ton is 907.18474 kg, a long ton 1016.0469 kg",
}

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_TOKEN = re.compile(
    r"\s*(?:(?P<name>(?:g_?0|mps2|degps2|radps2)(?![\w])|[A-Za-z°µμΩ%]+|1(?![\d.]))"
    r"(?P<power>(?:\s*(?:\^|\*\*)\s*(?:\(\s*[-+]?[\d./]+\s*\)|[-+]?\d+(?:\.\d+)?))|-?\d+)?"
    r"|(?P<op>\*\*|[*/()·⋅]))"
)
_Terms = list[tuple[str, Fraction]]


def parse_unit(text: str) -> Unit:
    """Read a unit such as `deg/s`, `kN`, `N m s^2/rad^2` or `kg m^2`.

    Products are written with a space, `*` or a middle dot; powers with `^`, `**`, a superscript or
    a plain digit (`m/s2`); one quotient, with brackets where the denominator is a product.

    Returns
    -------
    Unit

    Raises
    ------
    UnitError
        For a name outside the list, a name with two readings (`KN`, `nm`, `g`, `M`, `T`), or a
        quotient that can be read in two ways (`N/m s`).
    """
    if not isinstance(text, str):
        raise UnitError(
            f"a unit must be text, got {type(text).__name__} {text!r}. "
            "Write for example 'deg/s', or '1' for no unit."
        )
    return _parse(text)


@lru_cache(maxsize=1024)
def _parse(text: str) -> Unit:
    terms = _terms(text)
    factor, offset = 1.0, 0.0
    dimension = [Fraction(0)] * len(BASE_UNITS)
    for name, power in terms:
        entry = _NAMES[name]
        if len(terms) == 1 and power == 1:
            offset = entry.offset
        exponent = int(power) if power.denominator == 1 else float(power)
        factor *= entry.factor**exponent
        for si_name, si_power in entry.si:
            for i, e in enumerate(_SI[si_name]):
                dimension[i] += e * si_power * power
    return Unit(text, factor, offset, tuple(dimension))


def _clean(text: str) -> str:
    text = text.strip()
    if len(text) > 1 and text[0] == "[" and text[-1] == "]" and text != "[-]":
        text = text[1:-1].strip()
    return re.sub(r"([⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+)", r"^\1", text).translate(_SUPERSCRIPTS)


@lru_cache(maxsize=1024)
def _terms(text: str) -> _Terms:
    """Return (name of the list, power) of each factor in `text`, in order."""
    cleaned = _clean(text)
    if cleaned in _AMBIGUOUS:
        raise _ambiguous(text, cleaned)
    if cleaned in _ALIASES:
        cleaned = _ALIASES[cleaned]
    if cleaned in _NAMES:
        return [(cleaned, Fraction(1))]

    terms: _Terms = []
    position, sign, slashes, in_denominator = 0, 1, 0, False
    depth, expect_factor, after_quotient = 0, True, False
    while position < len(cleaned):
        token = _TOKEN.match(cleaned, position)
        if token is None or token.end() == position:
            if not cleaned[position:].strip():
                break
            raise _malformed(text, cleaned[position:].strip())
        position = token.end()
        operator = token.group("op")
        if operator == "/":
            if expect_factor or depth:
                raise _malformed(text, "/")
            slashes, sign, expect_factor, after_quotient = slashes + 1, -1, True, False
        elif operator in {"*", "·", "⋅"}:
            if expect_factor:
                raise _malformed(text, operator)
            expect_factor = True
        elif operator == "(":
            if depth or not expect_factor:
                raise _malformed(text, "(")
            depth, in_denominator = 1, sign < 0
        elif operator == ")":
            if not depth or expect_factor:
                raise _malformed(text, ")")
            depth, after_quotient = 0, in_denominator
        elif operator == "**":
            raise _malformed(text, "**")
        else:
            if after_quotient:
                raise UnitError(
                    f"unit {text!r} can be read in two ways: is {token.group('name')!r} above or "
                    "below the line? Write the denominator last, in brackets where it is a "
                    "product, for example 'N s/m' or 'N/(m s)'."
                )
            power = _power(token.group("power"), text)
            name = token.group("name")
            known = _lookup(name, text)
            if known == "1":
                pass
            elif "/" in known or "^" in known:  # aliases such as degps
                terms += [(n, p * power * sign) for n, p in _terms(known)]
            else:
                terms.append((known, power * sign))
            expect_factor = False
            after_quotient = sign < 0 and not depth
    if depth or expect_factor:
        raise _malformed(text, cleaned[-1:] or cleaned)
    return terms


def _power(text: str | None, unit: str) -> Fraction:
    if not text:
        return Fraction(1)
    digits = text.replace("**", "").strip().lstrip("^").strip().strip("()").replace(" ", "")
    try:
        return Fraction(digits)
    except (ValueError, ZeroDivisionError):
        raise _malformed(unit, text) from None


def _lookup(name: str, text: str) -> str:
    if name in _AMBIGUOUS:
        raise _ambiguous(text, name)
    if name in _NAMES:
        return name
    if name in _ALIASES:
        return _ALIASES[name]
    known = [*_NAMES, *(a for a in _ALIASES if a)]
    folded = {k.casefold(): k for k in known}
    near = difflib.get_close_matches(name.casefold(), list(folded), n=3, cutoff=0.5)
    hint = f"Nearest: {', '.join(folded[n] for n in near)}. " if near else ""
    raise UnitError(
        f"unit {text!r}: {name!r} is not in the list of units. {hint}"
        "Write products with a space, powers with ^, for example 'N m s/rad', and '1' for no unit."
    )


def _ambiguous(text: str, name: str) -> UnitError:
    return UnitError(
        f"unit {text!r} is ambiguous: {name!r} may mean {_AMBIGUOUS[name]}. Write which."
    )


def _malformed(text: str, part: str) -> UnitError:
    return UnitError(
        f"unit {text!r} cannot be read at {part!r}. Write products with a space, powers with ^ "
        "and one quotient, for example 'N m s^2/rad^2' or 'N/(m s)'."
    )


def si_unit(text: str) -> str:
    """Return the SI text for the same kind of quantity: `deg/s` gives `rad/s`, `kn` gives `m/s`.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    return _written(unit_powers(text))


def unit_powers(text: str) -> dict[str, Fraction]:
    """Return the SI names in a unit and their powers: `deg/s` gives rad: 1, s: -1.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    parse_unit(text)
    powers: dict[str, Fraction] = {}
    for name, power in _terms(text):
        for si_name, si_power in _NAMES[name].si:
            powers[si_name] = powers.get(si_name, Fraction(0)) + si_power * power
    return powers


def _written(powers: dict[str, Fraction]) -> str:
    """Write powers of names with one quotient: `N m/rad^2`, `N/(m s)`, or `1` for none."""
    above = [_with_power(n, p) for n, p in powers.items() if p > 0]
    below = [_with_power(n, -p) for n, p in powers.items() if p < 0]
    numerator = " ".join(above) or "1"
    if not below:
        return numerator
    return f"{numerator}/{below[0]}" if len(below) == 1 else f"{numerator}/({' '.join(below)})"


def _with_power(name: str, power: Fraction) -> str:
    if power == 1:
        return name
    return f"{name}^{power}" if power.denominator == 1 else f"{name}^({power})"


def same_dimension(a: str, b: str) -> bool:
    """Return whether two unit texts measure the same dimension (angles are dimensionless).

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    return parse_unit(a).dimension == parse_unit(b).dimension


def to_si(values: ArrayLike, unit: str, target_unit: str | None = None) -> NDArray[np.float64]:
    """Convert values written in `unit` to SI.

    Parameters
    ----------
    values : array of any shape, in `unit`
    unit : str
    target_unit : str, optional
        The unit the model expects. It fixes the dimension only; the result is in SI regardless.

    Returns
    -------
    float64 array of the same shape, SI

    Raises
    ------
    UnitError
        If `unit` cannot be read, or measures another dimension than `target_unit`. Hz against an
        angular rate is refused too: the factor 2 pi is not ours to guess.
    """
    parsed = parse_unit(unit)
    if target_unit is not None:
        target = parse_unit(target_unit)
        if parsed.dimension != target.dimension:
            raise UnitError(
                f"unit {unit!r} measures {describe_dimension(parsed.dimension)}, but "
                f"{target_unit!r} measures {describe_dimension(target.dimension)}. Give the unit "
                f"in which the column is written, of the same dimension as {target_unit!r}, "
                "or map another column."
            )
        cyclic = {_is_cyclic(unit), _is_cyclic(target_unit)}
        if cyclic == {True, False} and (_is_angular(unit) or _is_angular(target_unit)):
            raise UnitError(
                f"unit {unit!r} against {target_unit!r}: cycles and radians differ by 2 pi. "
                "Write rev/s or rpm for a speed of rotation that becomes rad/s."
            )
    array = np.asarray(values, dtype=np.float64)
    if parsed.is_si:
        return array.copy()
    return array * parsed.factor + parsed.offset


def from_si(values: ArrayLike, unit: str) -> NDArray[np.float64]:
    """Convert SI values to `unit`: 293.15 in `degC` is 20.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    parsed = parse_unit(unit)
    return (np.asarray(values, dtype=np.float64) - parsed.offset) / parsed.factor


def difference_from_si(values: ArrayLike, unit: str) -> NDArray[np.float64]:
    """Convert SI differences, rms errors or standard deviations to `unit`: 2 K is 2 `degC`.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    return np.asarray(values, dtype=np.float64) / parse_unit(unit).factor


def difference_to_si(values: ArrayLike, unit: str) -> NDArray[np.float64]:
    """Convert differences, rms errors or standard deviations in `unit` to SI.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    return np.asarray(values, dtype=np.float64) * parse_unit(unit).factor


def is_si(unit: str) -> bool:
    """True where a value in `unit` needs no conversion.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    return parse_unit(unit).is_si


_QUANTITIES = {
    "N": "force",
    "N m": "torque",
    "W": "heat flow",
    "V": "voltage",
    "A": "current",
    "m^3/s": "flow",
    "kg/s": "mass flow",
    "Pa": "pressure",
    "mol/s": "amount flow",
}
"""What a term of a balance is, by its SI unit."""


def quantity_of(unit: str) -> str:
    """What a quantity in `unit` is called in a sentence: `force`, `heat flow`, else `term`.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    own = parse_unit(unit)
    for text, word in _QUANTITIES.items():
        if parse_unit(text).dimension == own.dimension:
            return word
    return "term"


def unit_of_dimension(dimension: Dimension, *, is_rotation: bool = False) -> str:
    """The customary SI unit of a dimension: `N`, `W`, `V`; base units where there is none.

    `is_rotation` separates a torque, `N m`, from an energy, `J`, of the same dimension.
    """
    if is_rotation and dimension == parse_unit("N m").dimension:
        return "N m"
    for name in ("N", "J", "W", "V", "A", "Pa", "ohm", "H"):
        if parse_unit(name).dimension == dimension:
            return name
    return describe_dimension(dimension)


def _is_cyclic(text: str) -> bool:
    return any(name in {"Hz", "kHz", "MHz"} for name, _ in _terms(text))


def _is_angular(text: str) -> bool:
    return any(si == "rad" for name, _ in _terms(text) for si, _ in _NAMES[name].si)


def describe_dimension(dimension: Dimension) -> str:
    """Write a dimension in base units, for messages: `kg m/s^2`, or `1` for none."""
    return _written(dict(zip(BASE_UNITS, dimension, strict=True)))


def unit_names() -> tuple[str, ...]:
    """Return the names of the list, without aliases."""
    return tuple(_NAMES)


def unit_aliases() -> dict[str, str]:
    """Return the aliases and their meanings."""
    return dict(_ALIASES)


def ambiguous_units() -> dict[str, str]:
    """Return the names that are refused, and what each may mean."""
    return dict(_AMBIGUOUS)


def pint_expression(text: str) -> str:
    """Return the same unit in pint's own words, by which the list is checked.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    parse_unit(text)
    parts = [f"({_NAMES[name].pint}) ** ({power})" for name, power in _terms(text)]
    if len(parts) == 1 and _terms(text)[0][1] == 1:
        return _NAMES[_terms(text)[0][0]].pint
    return " * ".join(parts) or "dimensionless"


def unit_quotient(unit: str, other: str, power: int = 1) -> str:
    """Return the SI text of `unit / other^power`: `N m` by `rad/s` squared is `N m s^2/rad^2`.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    powers: dict[str, Fraction] = {}
    for text, sign in ((unit, 1), (other, -power)):
        parse_unit(text)
        for name, exponent in _terms(text):
            for si_name, si_power in _NAMES[name].si:
                powers[si_name] = powers.get(si_name, Fraction(0)) + si_power * exponent * sign
    return _written(powers)
