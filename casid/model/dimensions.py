"""Dimensional analysis of a model: every sum adds like to like, every function takes a number.

The CasADi expressions are walked as straight-line programs with a dimension for every node. A
literal number is taken as dimensionless where it is an integer or a simple fraction; any other
literal (9.81) may carry whatever dimension its place requires: give it a unit with
`model.constant` to have it checked.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import casadi as ca

from casid.errors import ModelError
from casid.model.model import Model
from casid.model.units import describe_dimension, parse_unit

Dimension = tuple[Fraction, ...] | None  # None: whatever fits
_ONE: tuple[Fraction, ...] = (Fraction(0),) * 7

_SAME = {"OP_ADD", "OP_SUB", "OP_FMIN", "OP_FMAX", "OP_HYPOT"}
_COMPARE = {"OP_LT", "OP_LE", "OP_EQ", "OP_NE"}
_KEEP = {"OP_NEG", "OP_FABS", "OP_ASSIGN", "OP_FLOOR", "OP_CEIL", "OP_TWICE"}
_FREE = {"OP_SIGN", "OP_NOT", "OP_AND", "OP_OR"}


class _Mismatch(Exception):
    pass


def _ops() -> dict[int, str]:
    return {getattr(ca, n): n for n in dir(ca) if n.startswith("OP_")}


def _simple(value: float) -> bool:
    return float(value * 12).is_integer() and abs(value) < 1e6


def _text(d: Dimension) -> str:
    return "any" if d is None else describe_dimension(tuple(d))


def dimension_of(expression: Any, symbols: list[Any], units: dict[str, str]) -> Dimension:
    """Dimension of a scalar SX expression; `units` gives each symbol's.

    Raises ModelError where a sum or function is not consistent.
    """
    function = ca.Function("d", symbols, [expression])
    known = [tuple(parse_unit(units[s.name()]).dimension) for s in symbols]
    ops = _ops()
    work: dict[int, Dimension] = {}
    numbers: dict[int, float] = {}
    result: Dimension = _ONE
    for k in range(function.n_instructions()):
        op = ops[function.instruction_id(k)]
        ins, outs = function.instruction_input(k), function.instruction_output(k)
        if op == "OP_INPUT":
            work[outs[0]] = known[ins[0]]
            numbers.pop(outs[0], None)
            continue
        if op == "OP_OUTPUT":
            result = work[ins[0]]
            continue
        if op == "OP_CONST":
            value = float(function.instruction_constant(k))
            work[outs[0]] = _ONE if _simple(value) and value != 0.0 else None
            numbers[outs[0]] = value
            continue
        args = [work[i] for i in ins]
        value_of = [numbers.get(i) for i in ins]
        work[outs[0]] = _apply(op, args, value_of)
        numbers.pop(outs[0], None)
    return result


def _apply(op: str, args: list[Dimension], values: list[float | None]) -> Dimension:
    a = args[0]
    b = args[1] if len(args) > 1 else None
    if op in _SAME:
        if a is not None and b is not None and a != b:
            raise _Mismatch(f"adds {_text(a)} to {_text(b)}")
        return a if a is not None else b
    if op in _COMPARE:
        if a is not None and b is not None and a != b:
            raise _Mismatch(f"compares {_text(a)} with {_text(b)}")
        return _ONE
    if op in _KEEP:
        return a
    if op in _FREE:
        return _ONE
    if op == "OP_MUL":
        return None if a is None or b is None else tuple(x + y for x, y in zip(a, b, strict=True))
    if op == "OP_DIV":
        return None if a is None or b is None else tuple(x - y for x, y in zip(a, b, strict=True))
    if op == "OP_INV":
        return None if a is None else tuple(-x for x in a)
    if op == "OP_SQ":
        return None if a is None else tuple(2 * x for x in a)
    if op == "OP_SQRT":
        return None if a is None else tuple(x / 2 for x in a)
    if op in ("OP_CONSTPOW", "OP_POW"):
        exponent = values[1]
        if a is None or a == _ONE:
            return a
        if exponent is None:
            raise _Mismatch(f"raises {_text(a)} to a power that is not a number")
        q = Fraction(exponent).limit_denominator(12)
        return tuple(x * q for x in a)
    if op == "OP_IF_ELSE_ZERO":
        return b
    if op == "OP_COPYSIGN":
        return a
    if op == "OP_ATAN2":
        if a is not None and b is not None and a != b:
            raise _Mismatch(f"takes atan2 of {_text(a)} and {_text(b)}")
        return _ONE
    # sin, exp, tanh ... take numbers and give numbers.
    for d in args:
        if d is not None and d != _ONE:
            name = op.removeprefix("OP_").lower()
            raise _Mismatch(f"takes {name} of {_text(d)}")
    return _ONE


def check_units(model: Model) -> None:
    """Refuse a model whose equations do not agree with its units.

    Raises
    ------
    ModelError
        Naming the equation, the term, both dimensions, and the remedy.
    """
    units: dict[str, str] = {s.name: s.unit for s in model.states.values()}
    units |= {u.name: u.unit for u in model.inputs.values()}
    units |= {p.name: p.unit for p in model.parameters.values()}
    for state in model.states.values():
        units[f"der_{state.name}"] = f"{state.unit}/s" if state.unit != "1" else "1/s"
    for unknown, _using, _ in model._eliminations:
        units.setdefault(unknown, model.eliminated_units[unknown])

    def dimension(expression: Any, place: str) -> Dimension:
        try:
            return dimension_of(expression, ca.symvar(ca.SX(expression)), units)
        except _Mismatch as error:
            raise ModelError(
                f"{model.name}: {place} {error}: {expression}; check the units of its symbols "
                f"({', '.join(f'{s.name()} [{units[s.name()]}]' for s in ca.symvar(expression))})"
            ) from None

    def require(expression: Any, unit: str, place: str) -> None:
        found = dimension(expression, place)
        wanted = tuple(parse_unit(unit).dimension)
        if found is not None and found != wanted:
            raise ModelError(
                f"{model.name}: {place} is in {_text(found)}, but should be in {unit} "
                f"({_text(wanted)}): {expression}; correct the expression or a declared unit"
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
