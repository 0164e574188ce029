"""What a model is declared in: numbers become SI, and a balance's unit follows from its terms."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from casid.errors import ModelError
from casid.model.dimensional_analysis import DimensionMismatch, dimension_of
from casid.model.units import (
    Dimension,
    declared_quotient,
    is_si,
    parse_unit,
    same_dimension,
    si_unit,
    to_si,
    unit_of_dimension,
    unit_powers,
)

Declared = TypeVar("Declared", bound=Any)  # a dataclass with a `unit`


def si_text(unit: str) -> str:
    """`unit` itself where it is SI, else the SI unit of the same quantity.

    Raises
    ------
    UnitError
        For a unit that cannot be read.
    """
    return unit if is_si(unit) else si_unit(unit)


def quantity_of(variable: str) -> str:
    """The parameter or state in the name of a variable: `phi` of `phi(0)@run`."""
    return variable.partition("@")[0].partition("(")[0]


def numbers_in_si(declared: Declared, fields: Sequence[str]) -> Declared:
    """A copy of a parameter or state with the numbers in `fields`, and its unit, in SI."""
    unit = declared.unit
    if is_si(unit):
        return declared
    given = {name: getattr(declared, name) for name in fields}
    changes = {n: None if v is None else float(to_si(v, unit)) for n, v in given.items()}
    changed: Declared = replace(declared, unit=si_unit(unit), **changes)
    return changed


def common_unit(expressions: Sequence[Any], units: Mapping[str, str], *, is_rotation: bool) -> str:
    """The SI unit that most of the SX expressions have; of a force or torque where none has one.

    Parameters
    ----------
    units : of every symbol in the expressions, by name.
    is_rotation : of the dimension of a torque, `N m` in place of `J`.
    """
    found: Counter[Dimension] = Counter()
    for expression in expressions:
        try:
            dimension = dimension_of(expression, ca.symvar(expression), dict(units))
        except DimensionMismatch:
            continue  # refused with its place, once the problem is made
        if dimension is not None:
            found[dimension] += 1
    if not found:
        return "N m" if is_rotation else "N"
    return unit_of_dimension(found.most_common(1)[0][0], is_rotation=is_rotation)


def rate_in_own_unit(unit: str, si: str) -> str:
    """What changes an angle or a share in `unit`, over s: deg/s^2 of one in deg/s; else `si`."""
    if is_si(unit) or not any(same_dimension(unit, of) for of in ("rad", "rad/s")):
        return si
    text = declared_quotient(unit, "s")
    return text if same_dimension(text, si) else si


def unit_in_balance(unit: str, force: str, coordinates: Sequence[str], si: str) -> str | None:
    """The SI `unit` as that of a force, or of one by a power of a coordinate, in declared units.

    A drag in a balance of mg/h whose state is in mg/L has L^2/(mg h). None where it is another.

    Parameters
    ----------
    force, si : the unit that the balance is shown in, and its own. An angle has no dimension: by
        how often it is in `unit`, and in `si`, a power of an angle is known.
    """
    angles = _angles(unit) - _angles(si)
    if same_dimension(force, unit) and not angles:
        return force
    for power in (1, 2, 3, 4, 5):
        for coordinate in coordinates:
            text = declared_quotient(force, coordinate, power)
            if same_dimension(text, unit) and angles == -power * _angles(coordinate):
                return text
    return None


def _angles(unit: str) -> Fraction:
    """The power of an angle in a unit."""
    return unit_powers(unit).get("rad", Fraction(0))


def refuse_conversion(model: str, output: str, expression: Any, unit: str) -> None:
    """Refuse an SX output that converts to its unit itself: it would be converted twice.

    Raises
    ------
    ModelError
        If the expression is a multiple by the factor from SI to `unit`.
    """
    factor, multiple = parse_unit(unit).factor, _literal_factor(expression)
    if factor != 1.0 and np.isclose(multiple * factor, 1.0, rtol=1e-4):
        raise ModelError(
            f"{model}: output {output!r} multiplies by {multiple:g}, as if to convert to {unit}; "
            "expressions are in SI and casid converts, so leave the factor out, or declare the SI "
            "unit"
        )


def _literal_factor(expression: Any) -> float:
    """The number that multiplies the whole of an SX expression: 30/pi of `30 * w / pi`."""
    factor = 1.0
    while not expression.is_leaf() and expression.op() in (ca.OP_MUL, ca.OP_DIV, ca.OP_TWICE):
        if expression.op() == ca.OP_TWICE:
            factor, expression = 2.0 * factor, expression.dep(0)
            continue
        first, second = expression.dep(0), expression.dep(1)
        if second.is_constant():
            power = 1 if expression.op() == ca.OP_MUL else -1
            factor, expression = factor * float(second) ** power, first
        elif first.is_constant() and expression.op() == ca.OP_MUL:
            factor, expression = factor * float(first), second
        else:
            break
    return factor
