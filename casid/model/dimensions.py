"""Check of a model's units: the dimensions of both sides of every equation agree."""

from __future__ import annotations

from typing import Any

import casadi as ca

from casid.errors import ModelError
from casid.model.dimensional_analysis import (
    Dimension,
    DimensionMismatch,
    dimension_of,
    dimension_text,
)
from casid.model.formula_text import shown_text
from casid.model.model import Model
from casid.model.units import parse_unit


def check_units(model: Model) -> None:
    """Refuse a model whose equations do not agree with its units.

    Raises
    ------
    ModelError
        Naming the equation, the term, both dimensions, and the remedy.
    """
    units = model.symbol_units

    def dimension(expression: Any, place: str) -> Dimension:
        """Dimension of an expression, None where any fits; a mismatch is refused with its place."""
        try:
            return dimension_of(expression, ca.symvar(ca.SX(expression)), units)
        except DimensionMismatch as error:
            symbols = ", ".join(f"{s.name()} [{units[s.name()]}]" for s in ca.symvar(expression))
            remedy = error.remedy or f"check the units of its symbols ({symbols})"
            raise ModelError(
                f"{model.name}: {place} {error}: {shown_text(expression)}; {remedy}"
            ) from None

    def require(expression: Any, unit: str, place: str) -> None:
        """Refuse an expression whose dimension is not that of `unit`."""
        found = dimension(expression, place)
        wanted = tuple(parse_unit(unit).dimension)
        if found is not None and found != wanted:
            raise ModelError(
                f"{model.name}: {place} is in {dimension_text(found)}, but should be in {unit} "
                f"({dimension_text(wanted)}): {shown_text(expression)}; correct the expression or "
                "a declared unit"
            )

    for name, balance in model.balances.items():
        for i, term in enumerate(balance.terms, 1):
            require(term, balance.unit, f"term {i} of balance {name!r}")
        rate = model.states[balance.rate].unit
        require(
            balance.inertia * model.der(balance.rate),
            balance.unit,
            f"inertia times d({balance.rate})/dt [{rate}/s] of balance {name!r}",
        )
    for name, expression in model._rates.items():
        require(expression, f"{model.states[name].unit}/s", f"the derivative of {name}")
    for name, (expression, unit) in model.outputs.items():
        require(expression, unit, f"output {name!r}")
    for unknown, using, residual in model._eliminations:
        dimension(residual, f"the output {using!r} that eliminates {unknown}")
