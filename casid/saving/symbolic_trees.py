"""Sympy expressions as nested lists, and back: no text is ever evaluated."""

from __future__ import annotations

from typing import Any

from casid.errors import DataError

_HEADS = frozenset(
    "Add Mul Pow Abs sign exp log sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh "
    "atanh Min Max Piecewise ExprCondPair Equality Unequality StrictLessThan LessThan "
    "StrictGreaterThan GreaterThan And Or Not erf floor ceiling Derivative Tuple".split()
)
_CONSTANTS = {
    "Pi": "pi",
    "Exp1": "E",
    "ImaginaryUnit": "I",
    "Infinity": "oo",
    "NegativeInfinity": "-oo",
    "ComplexInfinity": "zoo",
    "NaN": "nan",
    "BooleanTrue": "true",
    "BooleanFalse": "false",
}


def is_symbolic(value: Any) -> bool:
    """True of a sympy expression; sympy is not loaded to find out."""
    return type(value).__module__.partition(".")[0] == "sympy"


def tree_of(expression: Any) -> Any:
    """A sympy expression as [head, arguments ...].

    Raises
    ------
    DataError
        For a function that is not among those of physical models.
    """
    head = type(expression).__name__
    if head in _CONSTANTS:
        return [head]
    if expression.is_Symbol:
        facts = {name: fact for name, fact in expression.assumptions0.items() if fact is not None}
        return ["Symbol", expression.name, facts]
    if expression.is_Rational:
        return ["Rational", str(expression.p), str(expression.q)]
    if expression.is_Float:
        sign, mantissa, exponent, _ = expression._mpf_
        return ["Float", int(sign), str(int(mantissa)), int(exponent), int(expression._prec)]
    if head not in _HEADS:
        raise DataError(f"the symbolic expression {expression} has {head}, which no file can keep")
    return [head, *(tree_of(argument) for argument in expression.args)]


def symbolic_of(tree: Any) -> Any:
    """The sympy expression of a tree.

    Raises
    ------
    DataError
        For a tree that `tree_of` does not make.
    """
    import sympy

    head, *rest = tree
    if head in _CONSTANTS:
        name = _CONSTANTS[head]
        return -sympy.oo if name == "-oo" else getattr(sympy, name)
    if head == "Symbol":
        return sympy.Symbol(str(rest[0]), **{str(name): bool(v) for name, v in rest[1].items()})
    if head == "Rational":
        return sympy.Rational(int(rest[0]), int(rest[1]))
    if head == "Float":
        sign, mantissa, exponent, precision = (int(part) for part in rest)
        return sympy.Float((sign, mantissa, exponent), precision=precision)
    if head not in _HEADS:
        raise DataError(f"holds the symbolic function {head!r}, which casid does not know")
    kind = sympy.functions.elementary.piecewise.ExprCondPair
    function = kind if head == "ExprCondPair" else getattr(sympy, head)
    parts = [symbolic_of(argument) for argument in rest]
    if head in ("Add", "Mul", "Pow"):
        return function(*parts, evaluate=False)
    return function(*parts)
