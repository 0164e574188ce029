"""CasADi SX expressions read as algebra: in sympy, or in exact rational arithmetic.

CasADi evaluates and differentiates, sympy cancels, takes limits and proves. An SX function is a
straight-line program; it is walked instruction by instruction, with numbers of another kind in its
registers. Floats may be read as the shortest decimal that gives them back (0.218 is 109/500), so
that what is an identity on paper is one in the algebra, too.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any, TypeAlias

import casadi as ca

from casid.errors import ModelError

Expr: TypeAlias = Any  # a CasADi SX expression
Register: TypeAlias = Any  # what the walk computes with: sympy expressions or fractions
Operation: TypeAlias = Callable[..., Register]

_RATIONAL: dict[int, Operation] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_DIV: operator.truediv,
    ca.OP_NEG: operator.neg,
    ca.OP_SQ: lambda a: a**2,
    ca.OP_TWICE: lambda a: 2 * a,
    ca.OP_INV: lambda a: 1 / a,
}
_POWERS = (ca.OP_POW, ca.OP_CONSTPOW)
_CODES = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}


def exact(number: float) -> Fraction:
    """The shortest decimal that reads back as this float, as a fraction: 0.218 is 109/500.

    Raises
    ------
    ModelError
        If the number is not finite.
    """
    if number != number or number in (float("inf"), float("-inf")):
        raise ModelError(
            f"{number} is no number that algebra can use; look for a division by zero or a missing "
            "value among the known parameters"
        )
    return Fraction(repr(float(number)))


def to_sympy(
    expression: Expr, symbols: Mapping[str, Register] | None = None, *, exact_numbers: bool = False
) -> Any:
    """An SX expression as a sympy Matrix of the same shape.

    Parameters
    ----------
    expression : (m, n) SX.
    symbols : name of a CasADi symbol -> what replaces it in sympy (another symbol, a number);
        a name that is not in it becomes a sympy symbol of the same name.
    exact_numbers : floats become rationals, see `exact`;
        else sympy floats, with integers left as they are.

    Raises
    ------
    ModelError
        If two different CasADi symbols carry one name, or an operation has no sympy counterpart.

    Example
    -------
    >>> import casadi as ca
    >>> from casid.algebra.symbolic import to_sympy
    >>> x, k = ca.SX.sym("x"), ca.SX.sym("k")
    >>> to_sympy(0.5 * k * x**2, exact_numbers=True)[0]
    k*x**2/2
    """
    import sympy

    expression = ca.SX(expression)
    inside = ca.symvar(expression)
    names = [s.name() for s in inside]
    twice = [n for n in names if names.count(n) > 1]
    if twice:
        raise ModelError(
            f"two different symbols are called {twice[0]!r}; give one of them another name"
        )
    given = symbols or {}
    values = [sympy.sympify(given.get(n, sympy.Symbol(n))) for n in names]
    function = ca.Function("expression", [ca.vertcat(*inside)], [ca.densify(expression)])

    def number(value: float) -> Any:
        """A constant as sympy's number: exact if requested or whole."""
        if exact_numbers or float(value).is_integer():
            fraction = exact(value)
            return sympy.Rational(fraction.numerator, fraction.denominator)
        return sympy.Float(value)

    flat = walk(function, [values], _sympy_operations(), number)[0]
    m, n = expression.shape
    return sympy.Matrix(m, n, lambda i, j: flat[i + m * j])


def evaluate_exactly(
    function: ca.Function,
    *arguments: Sequence[Fraction],
    number: Callable[[float], Fraction] = exact,
) -> list[list[Fraction]]:
    """Evaluate a rational SX function in exact arithmetic.

    Parameters
    ----------
    function : SX function with dense vector arguments.
    arguments : one sequence of fractions for each argument.
    number : reads the function's constants.

    Returns
    -------
    One list of fractions for each result, column by column.

    Raises
    ------
    ModelError
        If the function is not rational (sin, exp, a square root, a branch, ...).
    ZeroDivisionError
        If the point is a pole of the function.
    """
    return walk(function, [list(a) for a in arguments], _fraction_operations(), number)


def walk(
    function: ca.Function,
    arguments: Sequence[Sequence[Register]],
    operations: Mapping[int, Operation],
    number: Callable[[float], Register],
) -> list[list[Register]]:
    """Run an SX function's instructions by a table: CasADi operation code -> what does it.

    Others as in `run_instructions`.

    Raises
    ------
    ModelError
        If the numbers of entries differ, or an operation is not among `operations`.
    """

    def operate(code: int, *registers: Register) -> Register:
        """The operation of CasADi's `code` on exact values; refused where there is none."""
        if code not in operations:
            raise ModelError(
                f"{function.name()}: {_CODES.get(code, code)} cannot be done in exact algebra; "
                "only numerical methods read such an expression"
            )
        return operations[code](*registers)

    return run_instructions(function, arguments, operate, number)


def run_instructions(
    function: ca.Function,
    arguments: Sequence[Sequence[Register]],
    operate: Operation,
    number: Callable[[float], Register],
) -> list[list[Register]]:
    """Run an SX function's instructions on registers of any kind.

    Parameters
    ----------
    function : SX function (an MX function is expanded), all arguments and results dense or with
        structural zeros, which come out as ``number(0)``.
    arguments : for each argument its entries, column by column.
    operate : (CasADi operation code, registers) -> register.
    number : turns a constant into a register.

    Returns
    -------
    For each result its entries, column by column.

    Raises
    ------
    ModelError
        If the numbers of entries differ.
    """
    if not function.is_a("SXFunction"):
        function = function.expand()
    for i, entries in enumerate(arguments):
        if len(entries) != function.numel_in(i):
            raise ModelError(
                f"{function.name()}: argument {i} has {function.numel_in(i)} entries, "
                f"{len(entries)} were given"
            )
    places = [_nonzeros(function.sparsity_in(i)) for i in range(function.n_in())]
    results = [[number(0.0)] * function.numel_out(i) for i in range(function.n_out())]
    goals = [_nonzeros(function.sparsity_out(i)) for i in range(function.n_out())]
    register: list[Register] = [None] * function.sz_w()
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        source, target = function.instruction_input(k), function.instruction_output(k)
        if code == ca.OP_INPUT:
            register[target[0]] = arguments[source[0]][places[source[0]][source[1]]]
        elif code == ca.OP_OUTPUT:
            results[target[0]][goals[target[0]][target[1]]] = register[source[0]]
        elif code == ca.OP_CONST:
            register[target[0]] = number(function.instruction_constant(k))
        else:
            register[target[0]] = operate(code, *[register[i] for i in source])
    return results


def operation_name(code: int) -> str:
    """The name of a CasADi operation, in lower case: ``fmin``."""
    return _CODES[code][3:].lower() if code in _CODES else f"operation {code}"


def _nonzeros(sparsity: Any) -> list[int]:
    """Position of each structural nonzero in the column-by-column list of entries."""
    rows = sparsity.size1()
    return [i + rows * j for i, j in zip(*sparsity.get_triplet(), strict=True)]


def rational_operations(power: Operation) -> dict[int, Operation]:
    """The operations of rational functions, for any kind of number with + - * /, and `power`."""
    return _RATIONAL | dict.fromkeys(_POWERS, power)


def _fraction_operations() -> dict[int, Operation]:
    def power(base: Fraction, exponent: Fraction) -> Fraction:
        """A whole power of a fraction; refused where the exponent is another."""
        if exponent.denominator != 1:
            raise ModelError(
                f"a power with the exponent {exponent} is not rational; only numerical methods "
                "read such an expression"
            )
        return base**exponent.numerator

    return rational_operations(power)


def _sympy_operations() -> dict[int, Operation]:
    import sympy as sp

    def holds(relation: Any) -> Any:
        return sp.Piecewise((sp.Integer(1), relation), (sp.Integer(0), True))

    return _RATIONAL | {
        ca.OP_POW: sp.Pow,
        ca.OP_CONSTPOW: sp.Pow,
        ca.OP_SQRT: sp.sqrt,
        ca.OP_EXP: sp.exp,
        ca.OP_LOG: sp.log,
        ca.OP_LOG1P: lambda a: sp.log(1 + a),
        ca.OP_EXPM1: lambda a: sp.exp(a) - 1,
        ca.OP_SIN: sp.sin,
        ca.OP_COS: sp.cos,
        ca.OP_TAN: sp.tan,
        ca.OP_ASIN: sp.asin,
        ca.OP_ACOS: sp.acos,
        ca.OP_ATAN: sp.atan,
        ca.OP_ATAN2: sp.atan2,
        ca.OP_SINH: sp.sinh,
        ca.OP_COSH: sp.cosh,
        ca.OP_TANH: sp.tanh,
        ca.OP_ASINH: sp.asinh,
        ca.OP_ACOSH: sp.acosh,
        ca.OP_ATANH: sp.atanh,
        ca.OP_ERF: sp.erf,
        ca.OP_HYPOT: lambda a, b: sp.sqrt(a**2 + b**2),
        ca.OP_FABS: sp.Abs,
        ca.OP_SIGN: sp.sign,
        ca.OP_FLOOR: sp.floor,
        ca.OP_CEIL: sp.ceiling,
        ca.OP_FMIN: sp.Min,
        ca.OP_FMAX: sp.Max,
        # CasADi's truth values are the numbers 0 and 1.
        ca.OP_LT: lambda a, b: holds(sp.Lt(a, b)),
        ca.OP_LE: lambda a, b: holds(sp.Le(a, b)),
        ca.OP_EQ: lambda a, b: holds(sp.Eq(a, b)),
        ca.OP_NE: lambda a, b: holds(sp.Ne(a, b)),
        ca.OP_NOT: lambda a: 1 - a,
        ca.OP_AND: lambda a, b: a * b,
        ca.OP_OR: lambda a, b: a + b - a * b,
        ca.OP_IF_ELSE_ZERO: lambda condition, a: condition * a,
    }
