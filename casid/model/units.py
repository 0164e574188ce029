"""Unit names as engineers write them, turned into SI factors."""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from casid.errors import UnitError
from casid.model.unit_names import ALIASES, AMBIGUOUS, NAMES, SI

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


_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_TOKEN = re.compile(
    r"\s*(?:(?:(?P<name>(?:[muµμ]?g_?[0n]|mps2|degps2|radps2|(?:mm|cm|in)H2O)(?![\w])"
    r"|[A-Za-z°µμΩ%‰]+|1(?![\d.]))"
    r"|\((?P<product>[^()]*(?:\([^()]*\)[^()]*)*)\))"
    r"(?P<power>(?:\s*(?:\^|\*\*)\s*(?:\(\s*[-+]?[\d./]+\s*\)|[-+]?\d+(?:\.\d+)?))|-?\d+)?"
    r"|(?P<op>\*\*|[*/·⋅]|\.(?=[A-Za-z°µμΩ])))"
)
_Terms = list[tuple[str, Fraction]]


def parse_unit(text: str) -> Unit:
    """Read a unit such as `deg/s`, `kN`, `N m s^2/rad^2` or `kg m^2`.

    Products are written with a space, `*`, a dot or a middle dot; powers with `^`, `**`, a
    superscript or a plain digit (`m/s2`), also of a product or quotient in brackets
    (`N/(rad/s)^2`); one quotient, with brackets where the denominator is a product.

    Returns
    -------
    Unit

    Raises
    ------
    UnitError
        For a name outside the list, a name with two readings (`KN`, `nm`, `g`, `M`, `T`) that does
        not cancel as in `g/g`, or a quotient that can be read in two ways (`N/m s`).
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
        entry = NAMES[name]
        if len(terms) == 1 and power == 1:
            offset = entry.offset
        exponent = int(power) if power.denominator == 1 else float(power)
        factor *= entry.factor**exponent
        for si_name, si_power in entry.si:
            for i, e in enumerate(SI[si_name]):
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
    if cleaned in AMBIGUOUS:
        raise _ambiguous(text, cleaned)
    with_carets = re.sub(r"(?<=[a-z])(?=\d)", "^", cleaned)  # g/cm3
    cleaned = ALIASES.get(cleaned) or ALIASES.get(with_carets) or cleaned
    if cleaned in NAMES:
        return [(cleaned, Fraction(1))]
    return _settled(_UnitReader(text).terms_of(_with_grams(cleaned)), text)


def _settled(terms: _Terms, text: str) -> _Terms:
    """The factors without names of two readings: those of `g/(g h)` are 1/h by either."""
    for name in dict.fromkeys(name for name, _ in terms if name in AMBIGUOUS):
        if sum(power for of, power in terms if of == name) != 0:
            raise _ambiguous(text, name)
    return [(name, power) for name, power in terms if name not in AMBIGUOUS]


def _with_grams(text: str) -> str:
    """A quotient such as `g/(l h)` with `gram` for `g`, where `g/l` alone is grams by the list."""
    quotient = re.fullmatch(r"g\s*/\s*(?:\(\s*)?([^\s*/()·⋅]+).*", text)
    return f"gram{text[1:]}" if quotient and f"g/{quotient[1]}" in ALIASES else text


class _UnitReader:
    """The factors of a unit, read from left to right: products, powers and one quotient."""

    def __init__(self, text: str) -> None:
        self.text = text
        self._terms: _Terms = []
        self._expects_factor = True
        self._sign = 1  # of the powers: -1 behind the slash
        self._after_quotient = False  # a further factor might be above or below the line

    def terms_of(self, part: str) -> _Terms:
        """The factors in `part`, the unit's whole text or what stands in brackets."""
        position = 0
        while part[position:].strip():
            token = _TOKEN.match(part, position)
            if token is None:
                raise _malformed(self.text, part[position:].strip())
            position = token.end()
            self._read(token)
        if self._expects_factor:
            raise _malformed(self.text, part[-1:] or "()")
        return self._terms

    def _read(self, token: re.Match[str]) -> None:
        """Take in the next operator, factor, or product in brackets."""
        operator, power = token.group("op"), token.group("power")
        if operator is not None:
            self._operator(operator)
        elif token.group("product") is not None:
            product = _UnitReader(self.text).terms_of(token.group("product"))
            self._take(token.group(0).strip(), product, power)
        else:
            name = token.group("name")
            self._take(name, _factor(name, self.text), power)

    def _operator(self, operator: str) -> None:
        if self._expects_factor or operator == "**":
            raise _malformed(self.text, operator)
        self._expects_factor = True
        if operator == "/":
            self._sign, self._after_quotient = -1, False

    def _take(self, written: str, factors: _Terms, power: str | None) -> None:
        if self._after_quotient:
            raise UnitError(
                f"unit {self.text!r} can be read in two ways: is {written!r} above or "
                "below the line? Write the denominator last, in brackets where it is a "
                "product, for example 'N s/m' or 'N/(m s)'."
            )
        exponent = _power(power, self.text) * self._sign
        self._terms += [(name, p * exponent) for name, p in factors]
        self._expects_factor = False
        self._after_quotient = self._sign < 0


def _factor(name: str, text: str) -> _Terms:
    known = name if name in AMBIGUOUS else _lookup(name, text)
    if "/" in known or "^" in known:  # aliases such as degps
        return _terms(known)
    return [(known, Fraction(1))] if known != "1" else []


def _power(text: str | None, unit: str) -> Fraction:
    if not text:
        return Fraction(1)
    digits = text.replace("**", "").strip().lstrip("^").strip().strip("()").replace(" ", "")
    try:
        return Fraction(digits)
    except (ValueError, ZeroDivisionError):
        raise _malformed(unit, text) from None


def _lookup(name: str, text: str) -> str:
    if name in NAMES:
        return name
    if name in ALIASES:
        return ALIASES[name]
    folded = {k.casefold(): k for k in (*NAMES, *filter(None, ALIASES))}
    near = difflib.get_close_matches(name.casefold(), list(folded), n=3, cutoff=0.5)
    hint = f"Nearest: {', '.join(folded[n] for n in near)}. " if near else ""
    raise UnitError(
        f"unit {text!r}: {name!r} is not in the list of units. {hint}"
        "Write products with a space, powers with ^, for example 'N m s/rad', and '1' for no unit."
    )


def _ambiguous(text: str, name: str) -> UnitError:
    first = AMBIGUOUS[name].split(" (")[0]
    example = re.sub(rf"(?<![A-Za-z]){name}(?![\w])", first, text)
    is_part = text.strip() != name and first in NAMES
    return UnitError(
        f"unit {text!r} is ambiguous: {name!r} may mean {AMBIGUOUS[name]}. Write which"
        + (f", as in {example!r}." if is_part else ".")
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
        for si_name, si_power in NAMES[name].si:
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


def is_comparable(a: str, b: str) -> bool:
    """True if both unit texts can be read and measure the same dimension."""
    try:
        return same_dimension(a, b)
    except UnitError:
        return False


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
    return any(si == "rad" for name, _ in _terms(text) for si, _ in NAMES[name].si)


def describe_dimension(dimension: Dimension) -> str:
    """Write a dimension in base units, for messages: `kg m/s^2`, or `1` for none."""
    return _written(dict(zip(BASE_UNITS, dimension, strict=True)))


def pint_expression(text: str) -> str:
    """Return the same unit in pint's own words, by which the list is checked.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    parse_unit(text)
    parts = [f"({NAMES[name].pint}) ** ({power})" for name, power in _terms(text)]
    if len(parts) == 1 and _terms(text)[0][1] == 1:
        return NAMES[_terms(text)[0][0]].pint
    return " * ".join(parts) or "dimensionless"


def unit_quotient(unit: str, other: str, power: int | Fraction = 1) -> str:
    """Return the SI text of `unit / other^power`: `N m` by `rad/s` squared is `N m s^2/rad^2`.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    return _divided(list(unit_powers(unit).items()), list(unit_powers(other).items()), power)


def declared_quotient(unit: str, other: str, power: int = 1) -> str:
    """Return `unit / other^power` in their own names of the list: `mg/h` by `mg/L` is `L/h`.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    return _divided(_terms(unit), _terms(other), power)


def times_in(unit: str) -> set[str]:
    """The units of time that a unit is written with: `mm/h` has h, `W` none.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    return {name for name, _ in _terms(unit) if NAMES[name].si == (("s", 1),)}


def _divided(above: _Terms, below: _Terms, power: int | Fraction) -> str:
    """The text of a unit over a power of another one, both by their factors."""
    powers = {"1": Fraction(0)}
    for name, exponent in [*above, *((n, -power * e) for n, e in below)]:
        powers[name] = powers.get(name, Fraction(0)) + exponent
    del powers["1"]
    return _written(powers)
