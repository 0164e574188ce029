"""Numbers, sympy, python-control and CasADi expressions read as rational functions."""

from __future__ import annotations

from fractions import Fraction
from numbers import Real
from typing import Any

from casid.algebra import polynomial as poly
from casid.algebra.coefficients import coefficient, coefficients, decimal
from casid.algebra.control_reader import control_entries
from casid.algebra.polynomial import Polynomial
from casid.errors import ModelError

Parts = tuple[Polynomial, Polynomial, str, float | None]
"""Numerator, denominator, variable and sample time of a rational function."""

_VARIABLES = {"q": "q", "z": "q", "s": "s"}


def read(value: Any, variable: str | None = None) -> Parts:
    """Numerator and denominator, variable and sample time of whatever `rational` takes."""
    if isinstance(value, Real) or type(value).__module__.startswith("numpy"):
        return poly.trimmed([_number(value)]), poly.ONE, "", None
    if hasattr(value, "free_symbols"):
        return _from_sympy(value, variable)
    module = type(value).__module__
    if module.startswith("casadi"):
        from casid.algebra.symbolic import to_sympy

        _refuse_opaque(value)
        if tuple(value.shape) != (1, 1):
            raise ModelError(
                f"a CasADi expression of shape {tuple(value.shape)} is no single transfer function;"
                " use casid.algebra.transfer_matrix.transfer_matrix"
            )
        return _from_sympy(to_sympy(value, exact_numbers=True)[0], variable)
    if module.startswith("control"):
        rows = control_entries(value)
        if len(rows) != 1 or len(rows[0]) != 1:
            raise ModelError(
                f"a control object with {len(rows)} outputs and {len(rows[0])} inputs is no single "
                "transfer function; use casid.algebra.transfer_matrix.transfer_matrix"
            )
        return rows[0][0]
    raise ModelError(
        f"{value!r} is no transfer function; give a number, a Rational, a sympy expression in q or "
        "s, a control.TransferFunction or StateSpace, or a CasADi SX expression"
    )


def _refuse_opaque(value: Any) -> None:
    """CasADi MX and functions, whose insides cannot be read as a fraction."""
    kind = type(value).__name__
    if kind not in ("SX", "DM"):
        remedy = " (ca.SX.sym for ca.MX.sym)" if kind == "MX" else ""
        raise ModelError(
            f"a CasADi {kind} cannot be read as a transfer function; write it with SX symbols"
            f"{remedy}, sympy symbols or Rational.shift()"
        )


def _number(value: Any) -> Fraction:
    import numpy as np

    if np.size(value) != 1 or not np.isrealobj(value):
        raise ModelError(
            f"{value!r} is no real number; a matrix is read by "
            "casid.algebra.transfer_matrix.transfer_matrix"
        )
    if isinstance(value, Fraction):
        return value
    return decimal(float(np.asarray(value).item()))


def _from_sympy(value: Any, variable: str | None) -> Parts:
    import sympy

    names = {str(x): x for x in value.free_symbols}
    found = [n for n in names if n in _VARIABLES] if variable is None else [variable]
    if len(found) > 1:
        raise ModelError(
            f"{value} holds {' and '.join(sorted(found))}; name the one that is the shift or "
            "differentiation with variable=, and substitute the other"
        )
    if not found or found[0] not in names:
        return poly.trimmed([coefficient(value)]), poly.ONE, "", None
    x = names[found[0]]
    value = sympy.together(_with_rationals(value))
    if not value.is_rational_function(x):
        raise ModelError(
            f"{value} is not rational in {x}; approximate it by a rational function (a delay of n "
            "samples is q**-n, one in continuous time a Pade approximation, control.pade)"
        )
    above, below = (coefficients(part, x) for part in sympy.fraction(value))
    return above, below, _VARIABLES.get(found[0], "q"), None


def _with_rationals(value: Any) -> Any:
    import sympy

    return value.xreplace(
        {f: sympy.Rational(str(decimal(float(f)))) for f in value.atoms(sympy.Float)}
    )
