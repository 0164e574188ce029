"""What a quantity is called in sentences and equations, by its unit: a force F, a voltage V."""

from __future__ import annotations

from casid.model.units import parse_unit, same_dimension

_QUANTITIES = {
    "N": ("force", "F"),
    "N m": ("torque", "tau"),
    "W": ("heat flow", "Q"),
    "V": ("voltage", "V"),
    "A": ("current", "I"),
    "m^3/s": ("flow", "q"),
    "kg/s": ("mass flow", "q"),
    "Pa": ("pressure", "p"),
    "mol/s": ("amount flow", "q"),
}
"""What a term of a balance is, and the letter that it has in equations, by its SI unit."""

_NO_QUANTITY = "term", "c"

_POWER = "power", "P"
"""What watts are that heat nothing: those of a turbine, or into a store of energy."""


def quantity_of(unit: str, rate_unit: str = "K") -> str:
    """What a quantity in `unit` is called in a sentence: `force`, `heat flow`, else `term`.

    Parameters
    ----------
    rate_unit : of the state whose balance it is a term of; watts are a heat flow where that is a
        temperature.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    return _quantity(unit, rate_unit)[0]


def letter_of(unit: str, rate_unit: str = "K") -> str:
    """The letter of a quantity in `unit` in equations: `F` of a force, else that of a coefficient.

    Raises
    ------
    UnitError
        As `parse_unit`.
    """
    return _quantity(unit, rate_unit)[1]


def _quantity(unit: str, rate_unit: str) -> tuple[str, str]:
    own = parse_unit(unit)
    if own.dimension == parse_unit("W").dimension and not same_dimension(rate_unit, "K"):
        return _POWER
    for text, found in _QUANTITIES.items():
        if parse_unit(text).dimension == own.dimension:
            return found
    return _NO_QUANTITY
