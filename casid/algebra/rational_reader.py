"""What a user has at hand, read as a `Rational`: numbers, sympy, python-control, CasADi."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from numbers import Integral, Real
from typing import Any

from casid.algebra import polynomial as poly
from casid.algebra.polynomial import Coefficient, Polynomial
from casid.algebra.rational import Rational
from casid.errors import ModelError

_VARIABLES = {"q": "q", "z": "q", "s": "s"}


def rational(
    value: Any,
    *,
    Ts: float | None = None,
    values: Mapping[str, Any] | None = None,
    variable: str | None = None,
) -> Rational:
    """Read one transfer function.

    Parameters
    ----------
    value : a number; a `Rational`; a sympy expression in q (q**-1, z) or s; a SISO
        `control.TransferFunction` or `control.StateSpace`; a rational CasADi SX expression. Symbols
        other than the variable are parameters.
    Ts : sample time [s] of what does not carry its own.
    values : numbers for parameters; those without stay symbolic.
    variable : name of the symbol that is the shift or s, where it cannot be told by its name.

    Raises
    ------
    ModelError
        If the expression is not rational, both q and s occur, or the object is not SISO.
    """
    out = _read(value, variable)
    if values:
        out = out.substitute(values)
    if Ts is not None and out.variable == "q":
        if out.Ts is not None and abs(out.Ts - Ts) > 1e-12 * abs(Ts):
            raise ModelError(
                f"{out} has the sample time {out.Ts:g} s, not {Ts:g} s; resample it, or "
                "leave out Ts"
            )
        out = Rational(out.numerator, out.denominator, "q", Ts)
    return out


def coefficient(value: Any) -> Coefficient:
    """A number as a Fraction (a float as its shortest decimal), a sympy expression as it is."""
    if isinstance(value, Fraction):
        return value
    if isinstance(value, Integral):
        return Fraction(int(value))
    if isinstance(value, Real):
        return _decimal(float(value))
    if hasattr(value, "free_symbols"):
        return _sympy_coefficient(value)
    raise ModelError(
        f"{value!r} is no coefficient; give a real number or a sympy expression of parameters"
    )


def cancelled(above: Polynomial, below: Polynomial) -> tuple[Polynomial, Polynomial]:
    """Common factors of two polynomials with symbolic coefficients cancelled, by sympy."""
    import sympy

    x = sympy.Dummy("x")
    ratio = sympy.cancel(
        sympy.sympify(poly.evaluate([sympy.sympify(c) for c in above], x))
        / sympy.sympify(poly.evaluate([sympy.sympify(c) for c in below], x))
    )
    top, bottom = (_coefficients(part, x) for part in sympy.fraction(ratio))
    if isinstance(bottom[0], Fraction):
        top, bottom = tuple(c / bottom[0] for c in top), poly.monic(bottom)
    return top, bottom


def _read(value: Any, variable: str | None) -> Rational:
    if isinstance(value, Rational):
        return value
    if isinstance(value, Real) or type(value).__module__.startswith("numpy"):
        return Rational(poly.trimmed([_number(value)]))
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
        from casid.algebra.from_control import entries

        rows = entries(value)
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
        mend = " (ca.SX.sym for ca.MX.sym)" if kind == "MX" else ""
        raise ModelError(
            f"a CasADi {kind} cannot be read as a transfer function; write it with SX symbols"
            f"{mend}, sympy symbols or Rational.shift()"
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
    return _decimal(float(np.asarray(value).item()))


def _decimal(number: float) -> Fraction:
    if number != number or number in (float("inf"), float("-inf")):
        raise ModelError(f"{number} is no coefficient of a transfer function; look for a 1/0")
    return Fraction(repr(number))


def _sympy_coefficient(value: Any) -> Coefficient:
    import sympy

    value = sympy.nsimplify(value, rational=True) if value.has(sympy.Float) else value
    if value.is_Rational:
        return Fraction(int(value.p), int(value.q))
    if value.is_number and not value.is_real:
        raise ModelError(f"{value} is no real coefficient of a transfer function; look for a 1/0")
    if value.is_number:  # irrational: as its nearest float
        return _decimal(float(value))
    return value


def _from_sympy(value: Any, variable: str | None) -> Rational:
    import sympy

    names = {str(x): x for x in value.free_symbols}
    found = [n for n in names if n in _VARIABLES] if variable is None else [variable]
    if len(found) > 1:
        raise ModelError(
            f"{value} holds {' and '.join(sorted(found))}; name the one that is the shift or "
            "differentiation with variable=, and substitute the other"
        )
    if not found or found[0] not in names:
        return Rational(poly.trimmed([_sympy_coefficient(value)]))
    x = names[found[0]]
    value = sympy.together(_with_rationals(value))
    if not value.is_rational_function(x):
        raise ModelError(
            f"{value} is not rational in {x}; approximate it by a rational function (a delay of n "
            "samples is q**-n, one in continuous time a Pade approximation, control.pade)"
        )
    above, below = (_coefficients(part, x) for part in sympy.fraction(value))
    return Rational(above, below, _VARIABLES.get(found[0], "q"))


def _with_rationals(value: Any) -> Any:
    import sympy

    return value.xreplace(
        {f: sympy.Rational(str(_decimal(float(f)))) for f in value.atoms(sympy.Float)}
    )


def _coefficients(expression: Any, x: Any) -> Polynomial:
    import sympy

    return poly.trimmed(
        _sympy_coefficient(c) for c in sympy.Poly(sympy.expand(expression), x).all_coeffs()
    )
