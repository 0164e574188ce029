"""Linear combinations of signals, written as text or as sympy expressions.

Text is read by casid's own parser, never evaluated as code.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from casid.errors import ModelError

Expression = Any  # a sympy expression, or a float


def is_symbolic(value: Any) -> bool:
    """Whether it is a symbolic sympy expression."""
    return bool(getattr(value, "free_symbols", None))


def as_expression(value: Any, where: str) -> Expression:
    """A number as float; text or sympy with symbols as a sympy expression.

    Raises
    ------
    ModelError
        If it is neither number, text nor expression.
    """
    if isinstance(value, str):
        value = _from_text(value, where)
    if is_symbolic(value):
        return plain(value)
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ModelError(
            f"{where} is {value!r}; give a number, a formula as text, or a sympy expression"
        ) from None


def plain(expression: Expression) -> Expression:
    """The expression in symbols without assumptions: a symbol is known by its name alone."""
    import sympy

    return expression.xreplace({s: sympy.Symbol(s.name) for s in expression.free_symbols})


def linear_terms(value: Any, known: Sequence[str], where: str) -> dict[str, Expression]:
    """The coefficients of a linear combination of known signals.

    Parameters
    ----------
    value : text or sympy expression; its symbols that are in `known` are signals, all others
        are parameters.

    Raises
    ------
    ModelError
        If it is not linear in the signals, or has a constant part.
    """
    import sympy

    expression = _from_text(value, where) if isinstance(value, str) else sympy.sympify(value)
    signals = [s for s in expression.free_symbols if str(s) in known]
    if not signals:
        raise ModelError(
            f"{where} = {expression} holds none of the signals {', '.join(known)}; name the "
            "externals in variances={..}, and signals before they are used"
        )
    try:
        poly = sympy.Poly(expression, *signals)
        if poly.total_degree() != 1 or poly.coeff_monomial(1) != 0:
            raise sympy.PolynomialError
    except sympy.PolynomialError:
        raise ModelError(
            f"{where} = {expression} is no linear combination of "
            f"{', '.join(sorted(map(str, signals)))}; write it as a sum of coefficient times signal"
        ) from None
    found = {str(s): poly.coeff_monomial(s) for s in signals}
    return {n: as_expression(found[n], where) for n in known if n in found}


def _from_text(text: str, where: str) -> Expression:
    import casadi as ca

    from casid.algebra.symbolic import to_sympy
    from casid.model.expressions import names, parse

    symbols = {name: ca.SX.sym(name) for name in names(text, where=where)}
    read = ca.SX(parse(text, symbols, where=where))
    return to_sympy(read, exact_numbers=True)[0]
