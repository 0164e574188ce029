"""The list of unit names: what each is in SI, its aliases, and names with two readings."""

from __future__ import annotations

import math
from typing import NamedTuple


class Name(NamedTuple):
    """A unit of the list: SI value = factor * value + offset."""

    factor: float
    si: tuple[tuple[str, int], ...]  # the same kind of quantity in SI names, for display
    pint: str  # the same unit as pint writes it
    offset: float = 0.0


SI: dict[str, tuple[int, int, int, int, int, int, int]] = {
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
"""Names that are SI already: exponents of kg, m, s, A, K, mol, cd."""

_SI_PINT = {"1": "dimensionless", "rad": "radian", "A": "ampere", "K": "kelvin", "H": "henry"}

_DEGREE = math.pi / 180.0
_KNOT = 1852.0 / 3600.0
NAMES: dict[str, Name] = {
    name: Name(1.0, () if name == "1" else ((name, 1),), _SI_PINT.get(name, name)) for name in SI
} | {
    # angle
    "deg": Name(_DEGREE, (("rad", 1),), "degree"),
    "mrad": Name(1e-3, (("rad", 1),), "milliradian"),
    "arcmin": Name(_DEGREE / 60, (("rad", 1),), "arcminute"),
    "arcsec": Name(_DEGREE / 3600, (("rad", 1),), "arcsecond"),
    "rev": Name(2 * math.pi, (("rad", 1),), "revolution"),
    "rpm": Name(2 * math.pi / 60, (("rad", 1), ("s", -1)), "revolution / minute"),
    # length
    "mm": Name(1e-3, (("m", 1),), "millimeter"),
    "cm": Name(1e-2, (("m", 1),), "centimeter"),
    "um": Name(1e-6, (("m", 1),), "micrometer"),
    "km": Name(1e3, (("m", 1),), "kilometer"),
    "in": Name(0.0254, (("m", 1),), "inch"),
    "ft": Name(0.3048, (("m", 1),), "foot"),
    "nmi": Name(1852.0, (("m", 1),), "nautical_mile"),
    "L": Name(1e-3, (("m", 3),), "liter"),
    "mL": Name(1e-6, (("m", 3),), "milliliter"),
    # speed, acceleration
    "kn": Name(_KNOT, (("m", 1), ("s", -1)), "knot"),
    "km/h": Name(1 / 3.6, (("m", 1), ("s", -1)), "kilometer / hour"),
    "mph": Name(0.44704, (("m", 1), ("s", -1)), "mile / hour"),
    "g0": Name(9.80665, (("m", 1), ("s", -2)), "standard_gravity"),
    # time, frequency
    "ms": Name(1e-3, (("s", 1),), "millisecond"),
    "us": Name(1e-6, (("s", 1),), "microsecond"),
    "min": Name(60.0, (("s", 1),), "minute"),
    "h": Name(3600.0, (("s", 1),), "hour"),
    "day": Name(86400.0, (("s", 1),), "day"),
    "kHz": Name(1e3, (("Hz", 1),), "kilohertz"),
    "MHz": Name(1e6, (("Hz", 1),), "megahertz"),
    # mass
    "gram": Name(1e-3, (("kg", 1),), "gram"),
    "mg": Name(1e-6, (("kg", 1),), "milligram"),
    "t": Name(1e3, (("kg", 1),), "metric_ton"),
    "lbm": Name(0.45359237, (("kg", 1),), "pound"),
    # force, torque, energy, power
    "mN": Name(1e-3, (("N", 1),), "millinewton"),
    "kN": Name(1e3, (("N", 1),), "kilonewton"),
    "MN": Name(1e6, (("N", 1),), "meganewton"),
    "lbf": Name(0.45359237 * 9.80665, (("N", 1),), "force_pound"),
    "Nm": Name(1.0, (("N", 1), ("m", 1)), "newton * meter"),
    "mNm": Name(1e-3, (("N", 1), ("m", 1)), "millinewton * meter"),
    "kNm": Name(1e3, (("N", 1), ("m", 1)), "kilonewton * meter"),
    "MNm": Name(1e6, (("N", 1), ("m", 1)), "meganewton * meter"),
    "kJ": Name(1e3, (("J", 1),), "kilojoule"),
    "MJ": Name(1e6, (("J", 1),), "megajoule"),
    "Wh": Name(3600.0, (("J", 1),), "watt_hour"),
    "kWh": Name(3.6e6, (("J", 1),), "kilowatt_hour"),
    "MWh": Name(3.6e9, (("J", 1),), "megawatt_hour"),
    "mW": Name(1e-3, (("W", 1),), "milliwatt"),
    "kW": Name(1e3, (("W", 1),), "kilowatt"),
    "MW": Name(1e6, (("W", 1),), "megawatt"),
    # pressure
    "hPa": Name(1e2, (("Pa", 1),), "hectopascal"),
    "kPa": Name(1e3, (("Pa", 1),), "kilopascal"),
    "MPa": Name(1e6, (("Pa", 1),), "megapascal"),
    "bar": Name(1e5, (("Pa", 1),), "bar"),
    "mbar": Name(1e2, (("Pa", 1),), "millibar"),
    # electricity
    "mV": Name(1e-3, (("V", 1),), "millivolt"),
    "kV": Name(1e3, (("V", 1),), "kilovolt"),
    "uA": Name(1e-6, (("A", 1),), "microampere"),
    "mA": Name(1e-3, (("A", 1),), "milliampere"),
    "kA": Name(1e3, (("A", 1),), "kiloampere"),
    "mH": Name(1e-3, (("H", 1),), "millihenry"),
    "mohm": Name(1e-3, (("ohm", 1),), "milliohm"),
    "kohm": Name(1e3, (("ohm", 1),), "kiloohm"),
    # temperature; the offset holds for the unit alone
    "degC": Name(1.0, (("K", 1),), "degree_Celsius", 273.15),
    "degF": Name(5 / 9, (("K", 1),), "degree_Fahrenheit", 459.67 * 5 / 9),
    # share
    "%": Name(1e-2, (), "percent"),
}
"""All names of the list."""

ALIASES: dict[str, str] = {
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
    # A concentration, density, share, molar mass or mass flow: what `g` alone may not say.
    "g/L": "gram/L",
    "g/l": "gram/L",
    "g/mL": "gram/mL",
    "g/ml": "gram/mL",
    "g/m^3": "gram/m^3",
    "g/cm^3": "gram/cm^3",
    "g/kg": "gram/kg",
    "g/mol": "gram/mol",
    "g/s": "gram/s",
    "g/min": "gram/min",
    "g/h": "gram/h",
    "lb/s": "lbm/s",
    "lb/min": "lbm/min",
    "lb/h": "lbm/h",
}

AMBIGUOUS: dict[str, str] = {
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
"""Names that are refused, and what each may mean."""
