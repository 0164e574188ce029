"""Units are a fixed list of names, with pint as the authority."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from casid.errors import DataError, UnitError
from casid.model.unit_names import ALIASES, NAMES
from casid.model.units import (
    BASE_UNITS,
    declared_quotient,
    difference_from_si,
    from_si,
    parse_unit,
    pint_expression,
    same_dimension,
    si_unit,
    to_si,
    unit_powers,
    unit_quotient,
)

COMPOSITE = [
    "deg/s", "m/s^2", "m/s2", "m/s²", "N m", "N*m", "N·m", "N m s/rad", "kg m^2", "N s^2/m^2",
    "N m s^2/rad^2", "N/(m s)", "kg m^2/s^2", "1/s", "s-1", "V^0.5/s", "m^(1/2)", "kN s/m",
    "deg/s^2", "N/m/s", "kg**2 m", "rad/V", "g0/V", "km / h", "1/(rpm^2)",
    "mN/(rad/s)^2", "N/((m/s)^0.5 s)", "(N m)^2/s",
]  # fmt: skip

_PINT = [
    "[mass]", "[length]", "[time]", "[current]", "[temperature]", "[substance]", "[luminosity]"
]  # fmt: skip


@pytest.fixture(scope="module")
def registry():
    pint = pytest.importorskip("pint")
    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


@pytest.mark.parametrize("text", [*NAMES, *ALIASES, *COMPOSITE])
def test_every_unit_converts_as_pint_says(text, registry):
    """Two values fix factor and offset; the dimension is pint's, exponent for exponent."""
    unit = parse_unit(text)
    for value in (0.0, 3.7):
        quantity = registry.Quantity(value, registry.parse_units(pint_expression(text)))
        expected = quantity.to_base_units()
        got = float(to_si(value, text))
        # Twenty roundings of one unit in the last place each are room enough for any product.
        assert got == pytest.approx(expected.magnitude, rel=20 * 2**-52, abs=1e-13)
    exponents = dict(expected.dimensionality)
    assert unit.dimension == tuple(
        Fraction(exponents.get(name, 0)).limit_denominator(12) for name in _PINT
    )
    assert len(unit.dimension) == len(BASE_UNITS)


@pytest.mark.parametrize("text", [*NAMES, *ALIASES, *COMPOSITE])
def test_the_si_text_measures_the_same_dimension_and_needs_no_conversion(text):
    assert same_dimension(text, si_unit(text))
    assert parse_unit(si_unit(text)).is_si
    assert si_unit(si_unit(text)) == si_unit(text)


@pytest.mark.parametrize(
    ("text", "si"),
    [("deg/s", "rad/s"), ("kn", "m/s"), ("rpm", "rad/s"), ("kN m s^2/deg^2", "N m s^2/rad^2"),
     ("km/h", "m/s"), ("%", "1"), ("N s/(m rad)", "N s/(m rad)"), ("V^0.5/s", "V^(1/2)/s"),
     ("degC", "K"), ("g0", "m/s^2")],
)  # fmt: skip
def test_si_text_is_written_as_engineers_write_it(text, si):
    assert si_unit(text) == si


@pytest.mark.parametrize(
    ("unit", "other", "power", "quotient"),
    [("N m", "rad/s", 2, "N m s^2/rad^2"), ("kN", "s", 1, "N/s"), ("m", "m", 1, "1"),
     ("deg/s", "m", -1, "rad m/s"), ("1", "rad", 1, "1/rad")],
)  # fmt: skip
def test_the_quotient_of_two_units_is_written_in_si(unit, other, power, quotient):
    assert unit_quotient(unit, other, power) == quotient
    divided = parse_unit(f"({quotient})" if "/" not in quotient else quotient).dimension
    pairs = zip(parse_unit(unit).dimension, parse_unit(other).dimension, strict=True)
    assert divided == tuple(a - power * b for a, b in pairs)


@pytest.mark.parametrize(
    ("unit", "other", "power", "quotient"),
    [
        ("1", "mmol/L", 1, "L/mmol"),
        ("1", "%", 1, "1/%"),
        ("1", "m", 2, "1/m^2"),
        ("mg/h", "1", 1, "mg/h"),
        ("g/h", "mg/L", 1, "gram L/(h mg)"),  # `g L` alone would have two readings
        ("N", "mm/s", 2, "N s^2/mm^2"),
        ("kW", "kW", 1, "1"),
        ("kN s/m", "km/h", 2, "kN s h^2/(m km^2)"),  # a name with a quotient would be two in one
    ],
)
def test_the_quotient_of_two_declared_units_keeps_their_names(unit, other, power, quotient):
    assert declared_quotient(unit, other, power) == quotient
    assert parse_unit(quotient).factor == pytest.approx(
        parse_unit(unit).factor / parse_unit(other).factor ** power
    )


def test_kilonewton_and_knot_are_told_apart_by_case():
    assert to_si(1.0, "kN") == 1000.0
    assert to_si(1.0, "kn") == pytest.approx(1852 / 3600)
    assert not same_dimension("kN", "kn")


@pytest.mark.parametrize(
    ("text", "choices"),
    [("KN", ("kN", "kn")), ("nm", ("nmi", "N m", "nanometre")), ("g", ("gram", "g0")),
     ("M", ("metre",)), ("T", ("tonne", "s (time)")), ("m/g", ("gram", "g0")),
     ("ton", ("1000 kg", "907")), ("kg m/S", ("second",)),
     ("gpm", ("USgal/min", "UKgal/min")), ("gal/h", ("'USgal/h'", "UKgal")), ("oz in", ("ozf",)),
     ("mU/l", ("mIU", "nmol/min", "'mIU/l'")), ("µU/ml", ("uIU", "pmol/min", "'uIU/ml'"))],
)  # fmt: skip
def test_a_name_with_two_readings_is_refused_with_the_choice_named(text, choices):
    with pytest.raises(UnitError, match="ambiguous") as caught:
        parse_unit(text)
    assert all(choice in str(caught.value) for choice in choices)
    assert "Write which" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "factor"),
    [("mg/dl", 1e-2), ("ng/ml", 1e-6), ("pg/mL", 1e-9), ("ug/dl", 1e-5), ("cl", 1e-5), ("hl", 0.1),
     ("pmol/l", 1e-9), ("ha", 1e4)],
)  # fmt: skip
def test_units_of_laboratories_and_catchments_are_read(text, factor):
    assert to_si(1.0, text) == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "si"),
    [("cmH2O s/L", 98066.5), ("mL/cmH2O", 1e-6 / 98.0665), ("inH2O", 249.0889),
     ("USgal/min", 6.309020e-05), ("UKgal", 4.546090e-3), ("ozf in", 7.061552e-3)],
)  # fmt: skip
def test_columns_of_water_gallons_and_ounces_are_read(text, si):
    """Of ventilators, pumps and small motors; the values are those of NIST SP 811, appendix B."""
    assert to_si(1.0, text) == pytest.approx(si, rel=5e-7)  # seven digits


@pytest.mark.parametrize(
    ("text", "product"),
    [("mN/(rad/s)^2", "mN s^2/rad^2"), ("N/(m/s)", "N s/m"), ("kg/(m^2 s)^0.5", "kg/m/s^0.5"),
     ("(N m)²/((rad/s)^2 s)", "N^2 m^2 s/rad^2")],
)  # fmt: skip
def test_a_power_of_a_product_in_brackets_is_that_of_each_factor(text, product):
    assert unit_powers(text) == unit_powers(product)
    assert parse_unit(text).factor == pytest.approx(parse_unit(product).factor, rel=1e-15)


@pytest.mark.parametrize(("text", "si"), [("g/g", "1"), ("g/(g h)", "1/h"), ("T/T", "1")])
def test_a_name_with_two_readings_that_cancels_is_the_same_by_either(text, si):
    assert same_dimension(text, si)
    assert to_si(1.0, text) == to_si(1.0, si)
    with pytest.raises(UnitError, match="ambiguous"):
        parse_unit(f"{text.replace('/', '^2/')}")


@pytest.mark.parametrize(
    ("text", "factor", "si"),
    [("nanometre", 1e-9, "m"), ("nanometers", 1e-9, "m"), ("millisiemens", 1e-3, "siemens"),
     ("millitesla", 1e-3, "tesla"), ("nanometre/s", 1e-9, "m/s"), ("mIU/l", 1.0, "1/m^3")],
)  # fmt: skip
def test_the_readings_of_a_name_that_is_refused_are_names_of_the_list(text, factor, si):
    assert to_si(1.0, text) == pytest.approx(factor)
    assert same_dimension(text, si)


@pytest.mark.parametrize(
    ("text", "value", "si"),
    [("g/L", 1.0, "kg/m^3"), ("g/cm^3", 1000.0, "kg/m^3"), ("g/mol", 1e-3, "kg/mol"),
     ("g/h", 1e-3 / 3600.0, "kg/s"), ("lb/min", 0.45359237 / 60.0, "kg/s"),
     ("g/(l h)", 1.0 / 3600.0, "kg/(m^3 s)"), ("g / L/h", 1.0 / 3600.0, "kg/(m^3 s)")],
)  # fmt: skip
def test_a_quotient_says_which_of_two_readings_it_is(text, value, si):
    assert to_si(1.0, text) == pytest.approx(value)
    assert same_dimension(text, si)


def test_a_quotient_that_leaves_a_reading_open_is_refused_with_an_example_to_copy():
    with pytest.raises(UnitError, match=r"Write which, as in 'gram/\(m\^2 h\)'\."):
        parse_unit("g/(m^2 h)")


def test_a_quotient_with_two_readings_is_refused_with_both_ways_of_writing_it():
    with pytest.raises(UnitError, match="two ways") as caught:
        parse_unit("N/m s")
    assert "'N s/m'" in str(caught.value)
    assert "'N/(m s)'" in str(caught.value)


@pytest.mark.parametrize(
    "text", ["10", "m/", "m^", "(m", "m)", "m/()", "(m/)s", "/s", "m**", "*m", "m^(1/0)", "2 m"]
)
def test_text_that_is_no_unit_is_refused_with_an_example(text):
    with pytest.raises(UnitError, match="for example"):
        parse_unit(text)


def test_an_unknown_name_is_refused_with_the_nearest():
    with pytest.raises(UnitError, match="Nearest: kg"):
        parse_unit("Kg m^2")
    with pytest.raises(UnitError, match="must be text"):
        parse_unit(1.0)  # type: ignore[arg-type]


def test_a_temperature_has_an_offset_where_it_stands_alone():
    """In products and quotients it is a difference."""
    assert to_si([0.0, 20.0], "degC").tolist() == [273.15, 293.15]
    assert to_si([2.0], "W/degC").tolist() == [2.0]
    assert to_si([9.0], "degF/s").tolist() == pytest.approx([5.0])
    assert from_si([293.15], "degC").tolist() == pytest.approx([20.0])
    assert difference_from_si([2.0], "degF").tolist() == pytest.approx([3.6])


def test_a_unit_of_another_dimension_is_refused_with_both_named():
    with pytest.raises(UnitError, match=r"'kn' measures m/s, but 'N' measures kg m/s\^2") as caught:
        to_si([1.0], "kn", "N")
    assert "map another column" in str(caught.value)
    assert isinstance(caught.value, DataError)


def test_hertz_is_no_angular_rate_but_rpm_is():
    assert to_si(60.0, "rpm", "rad/s") == pytest.approx(2 * math.pi)
    with pytest.raises(UnitError, match="2 pi.*rev/s or rpm"):
        to_si(1.0, "Hz", "rad/s")


@given(
    value=st.floats(-1e6, 1e6),
    text=st.sampled_from(
        [n for n in NAMES if parse_unit(n).offset == 0.0 and n not in {"1", "km/h"}]
    ),
    power=st.integers(1, 3),
)
def test_a_unit_and_its_reciprocal_undo_each_other(value, text, power):
    there = to_si(value, f"{text}^{power}")
    assert to_si(there, f"1/{text}^{power}") == pytest.approx(value, rel=1e-12)


@given(factors=st.permutations(["kN", "m", "s^2", "deg^-1"]))
def test_the_order_of_factors_does_not_matter(factors):
    unit = parse_unit(" ".join(factors))
    assert unit.dimension == parse_unit("kN m s^2/deg").dimension
    assert unit.factor == pytest.approx(1000 * 180 / math.pi, rel=1e-14)


def test_conversion_keeps_the_shape_and_leaves_its_argument_alone():
    values = np.ones((3, 2))
    assert to_si(values, "deg").shape == (3, 2)
    to_si(values, "m")[0, 0] = 7.0
    assert values[0, 0] == 1.0
