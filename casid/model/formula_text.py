"""CasADi expressions written as text: as Python, as Modelica, or plainly for a reader.

The text says what the expression graph says, operation by operation, in the order of the graph;
numbers are written with all digits that they have. Brackets stand where they are needed, repeated
factors are powers, and parts that several formulas share may get names (`shared_parts`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from casid.errors import ModelError

Expr = Any  # a CasADi SX expression

_SHOWN = 400
"""Characters of an expression in a message; a longer one is cut in its middle."""

_SUM, _PRODUCT, _SIGN, _POWER, _ATOM = 1, 2, 3, 4, 5  # how strongly a text holds together

_UNARY = {
    name: getattr(ca, f"OP_{name.upper()}")
    for name in (
        "sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh "
        "exp expm1 log log1p sqrt fabs sign floor ceil erf"
    ).split()
}
_BINARY = {
    name: getattr(ca, f"OP_{name.upper()}")
    for name in "fmin fmax atan2 hypot copysign fmod".split()
}
_CALLED = {code: name for name, code in (_UNARY | _BINARY).items()}
_RELATIONS = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}


class _Text(NamedTuple):
    text: str
    binding: int
    is_negative: bool = False  # begins with a minus sign


@dataclass(frozen=True, slots=True)
class Notation:
    """How formulas are written in one language.

    Attributes
    ----------
    functions : CasADi's name of a function -> how it is called, with {0} and {1} for arguments.
    power : the operator of a power.
    hugs : True if a power of a name is written without spaces, x**2.
    choice : of a condition and two values.
    relation : of two texts and one of < <= == !=, as a condition.
    truth : of a condition, the number 1 or 0.
    conjunction, disjunction, negation : of conditions.
    """

    name: str
    functions: Mapping[str, str]
    power: str
    hugs: bool
    choice: str
    truth: str
    conjunction: str
    disjunction: str
    negation: str


PYTHON = Notation(
    name="Python with CasADi",
    functions={n: f"ca.{n}({{0}})" for n in _UNARY} | {n: f"ca.{n}({{0}}, {{1}})" for n in _BINARY},
    power="**",
    hugs=True,
    choice="ca.if_else({0}, {1}, {2})",
    truth="{0}",
    conjunction="ca.logic_and({0}, {1})",
    disjunction="ca.logic_or({0}, {1})",
    negation="ca.logic_not({0})",
)
"""Expressions of CasADi, imported as `ca`."""

MODELICA = Notation(
    name="Modelica",
    functions={
        n: f"{n}({{0}})"
        for n in ("sin cos tan asin acos atan sinh cosh tanh exp log sqrt sign floor ceil".split())
    }
    | {
        "asinh": "log({0} + sqrt(({0})^2 + 1))",
        "acosh": "log({0} + sqrt(({0})^2 - 1))",
        "atanh": "(0.5*log((1 + ({0}))/(1 - ({0}))))",
        "expm1": "(exp({0}) - 1)",
        "log1p": "log(1 + ({0}))",
        "fabs": "abs({0})",
        "fmin": "min({0}, {1})",
        "fmax": "max({0}, {1})",
        "atan2": "atan2({0}, {1})",
        "hypot": "sqrt(({0})^2 + ({1})^2)",
        "fmod": "rem({0}, {1})",
    },
    power="^",
    hugs=True,
    choice="(if {0} then {1} else {2})",
    truth="(if {0} then 1.0 else 0.0)",
    conjunction="({0} and {1})",
    disjunction="({0} or {1})",
    negation="not ({0})",
)
"""Equations of Modelica, functions of the language alone."""

PLAIN = Notation(
    name="text",
    functions={n: f"{n}({{0}})" for n in _UNARY}
    | {n: f"{n}({{0}}, {{1}})" for n in _BINARY}
    | {"fabs": "|{0}|", "fmin": "min({0}, {1})", "fmax": "max({0}, {1})"},
    power="^",
    hugs=True,
    choice="({1} if {0} else {2})",
    truth="({0})",
    conjunction="{0} and {1}",
    disjunction="{0} or {1}",
    negation="not {0}",
)
"""For a reader."""


def formula_text(
    expression: Expr,
    notation: Notation = PLAIN,
    *,
    names: Mapping[str, str] | None = None,
    parts: Mapping[int, str] | None = None,
) -> str:
    """One scalar expression as text.

    Parameters
    ----------
    names : how a symbol is written, by its CasADi name; itself by default.
    parts : names of shared parts, as `shared_parts` gives them; where a part is defined, those of
        the others.

    Raises
    ------
    ModelError
        If the notation has no word for an operation.
    """
    return _Writer(notation, names or {}, parts or {}).text(ca.SX(expression)).text


def shown_text(expression: Expr) -> str:
    """One scalar expression as text for a message: every part where it stands, as written.

    CasADi itself prints a part that occurs twice as `@1`, with its definition in front.
    """
    try:
        text = formula_text(expression)
    except ModelError:  # an operation without a word
        return str(expression)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN // 2]} ... {text[-_SHOWN // 2 :]}"


def summands(expression: Expr) -> list[Expr]:
    """The terms of a sum, in the order of the graph; the expression itself where it is none.

    What is subtracted is negated.
    """
    e = ca.SX(expression)
    if e.is_leaf():
        return [e]
    if e.op() == ca.OP_ADD:
        return [*summands(e.dep(0)), *summands(e.dep(1))]
    if e.op() == ca.OP_SUB:
        return [*summands(e.dep(0)), *(-term for term in summands(e.dep(1)))]
    return [e]


class Part(NamedTuple):
    """A part that several formulas have in common."""

    key: int  # as `formula_text(parts=...)` names it
    expression: Expr


def shared_parts(expressions: Sequence[Expr]) -> tuple[list[Expr], list[Part]]:
    """The expressions with equal parts united, and the parts that are worth a name.

    A part is worth a name where it occurs twice or more and has at least three operations. Parts
    come in an order in which each needs those before it alone.
    """
    if not expressions:
        return [], []
    united = ca.vertsplit(ca.cse(ca.densify(ca.vertcat(*[ca.SX(e) for e in expressions]))))
    order: list[Expr] = []
    uses: dict[int, int] = {}
    size: dict[int, int] = {}

    def visit(e: Expr) -> None:
        """Count the uses of a subexpression and of its parts; these come first in `order`."""
        key = e.element_hash()
        uses[key] = uses.get(key, 0) + 1
        if e.is_leaf() or uses[key] > 1:
            return
        size[key] = 0  # of the operations inside it that have no name of their own
        for i in range(e.n_dep()):
            visit(e.dep(i))
        order.append(e)

    for e in united:
        visit(e)
    found: list[Part] = []
    for e in order:
        key = e.element_hash()
        named = {part.key for part in found}
        inner = [e.dep(i).element_hash() for i in range(e.n_dep())]
        size[key] = 1 + sum(size.get(k, 0) for k in inner if k not in named)
        if uses[key] > 1 and size[key] >= 3:
            found.append(Part(key, e))
    return united, found


def number_text(value: float) -> str:
    """A finite number with all its digits, whole ones without a point: 2, 0.1, 1e-06."""
    if value == int(value) and abs(value) < 1e15:
        return str(int(value))
    return repr(float(value))


class _Writer:
    """Writes one expression after the other in one notation."""

    def __init__(
        self, notation: Notation, names: Mapping[str, str], parts: Mapping[int, str]
    ) -> None:
        self.notation, self.names, self.parts = notation, names, parts

    def text(self, e: Expr) -> _Text:
        """The expression, or the name that it has as a shared part."""
        named = self.parts.get(e.element_hash())
        if named is not None:
            return _Text(named, _ATOM)
        if e.is_constant():
            return self._number(float(e))
        if e.is_symbolic():
            return _Text(self.names.get(e.name(), e.name()), _ATOM)
        write = _WRITERS.get(e.op())
        if write is not None:
            return write(self, *(e.dep(i) for i in range(e.n_dep())))
        if e.op() in _CALLED:
            return self._call(_CALLED[e.op()], *(e.dep(i) for i in range(e.n_dep())))
        raise ModelError(f"an operation of {e} cannot be written as {self.notation.name}")

    def _number(self, value: float) -> _Text:
        if not math.isfinite(value):
            raise ModelError(f"the number {value} cannot be written as {self.notation.name}")
        negative = value < 0
        return _Text(number_text(value), _SIGN if negative else _ATOM, negative)

    def _call(self, name: str, *arguments: Expr) -> _Text:
        form = self.notation.functions.get(name)
        if form is None:
            raise ModelError(f"{name} cannot be written as {self.notation.name}")
        texts = [self.text(a).text for a in arguments]
        return _Text(form.format(*texts), _ATOM)

    def _within(self, e: Expr, least: int, *, leads: bool = False) -> str:
        """A part of a text that holds its parts with strength `least`, in brackets if needed.

        A sign in front may stay bare only at the beginning (`leads`).
        """
        return self._bracketed(self.text(e), least, leads=leads)

    @staticmethod
    def _bracketed(part: _Text, least: int, *, leads: bool = False) -> str:
        bare = part.binding >= least and (leads or not part.is_negative)
        return part.text if bare else f"({part.text})"

    # -- sums ---------------------------------------------------------------------------------

    def _add(self, a: Expr, b: Expr) -> _Text:
        either = self._either(a, b)
        if either is not None:
            return either
        left, right = self.text(a), self.text(b)
        if right.is_negative:
            return _Text(f"{left.text} - {right.text[1:]}", _SUM, left.is_negative)
        return _Text(f"{left.text} + {right.text}", _SUM, left.is_negative)

    def _either(self, a: Expr, b: Expr) -> _Text | None:
        """One choice for (c ? x : 0) + (not c ? y : 0), as CasADi stores it."""
        if any(e.is_leaf() or e.op() != ca.OP_IF_ELSE_ZERO for e in (a, b)):
            return None
        condition, other = a.dep(0), b.dep(0)
        if other.is_leaf() or other.op() != ca.OP_NOT:
            return None
        if not ca.is_equal(other.dep(0), condition, 3):
            return None
        values = (self.text(e.dep(1)).text for e in (a, b))
        return _Text(self.notation.choice.format(self._condition(condition), *values), _ATOM)

    def _subtract(self, a: Expr, b: Expr) -> _Text:
        left = self.text(a)
        right = self._within(b, _PRODUCT)
        return _Text(f"{left.text} - {right}", _SUM, left.is_negative)

    def _negate(self, a: Expr) -> _Text:
        return _Text(f"-{self._within(a, _PRODUCT)}", _SIGN, True)

    def _twice(self, a: Expr) -> _Text:
        return _Text(f"2 * {self._within(a, _PRODUCT)}", _PRODUCT)

    # -- products -----------------------------------------------------------------------------

    def _multiply(self, a: Expr, b: Expr) -> _Text:
        parts: list[tuple[Expr, int]] = []
        for factor in (a, b):
            self._collect(factor, 1, parts)
        texts = [self._power_text(base, n) for base, n in parts]
        first = self._bracketed(texts[0], _PRODUCT, leads=True)
        rest = [self._bracketed(t, _PRODUCT) for t in texts[1:]]
        binding = _PRODUCT if rest else texts[0].binding
        return _Text(" * ".join([first, *rest]), binding, texts[0].is_negative)

    def _collect(self, e: Expr, power: int, parts: list[tuple[Expr, int]]) -> None:
        """The factors of a product with their whole powers, equal ones united."""
        if not e.is_leaf() and e.element_hash() not in self.parts:
            if e.op() == ca.OP_MUL:
                self._collect(e.dep(0), power, parts)
                self._collect(e.dep(1), power, parts)
                return
            if e.op() == ca.OP_SQ:
                self._collect(e.dep(0), 2 * power, parts)
                return
        for i, (base, n) in enumerate(parts):
            if ca.is_equal(base, e, 1) and not e.is_constant():
                parts[i] = (base, n + power)
                return
        parts.append((e, power))

    def _power_text(self, base: Expr, n: int) -> _Text:
        if n == 1:
            return self.text(base)
        return self._raised(base, str(n))

    def _raised(self, base: Expr, exponent: str) -> _Text:
        text = self._within(base, _ATOM)
        simple = text.replace(".", "").replace("_", "").isalnum()
        hugs = self.notation.hugs and simple and exponent.lstrip("-").replace(".", "").isalnum()
        space = "" if hugs else " "
        return _Text(f"{text}{space}{self.notation.power}{space}{exponent}", _POWER)

    def _square(self, a: Expr) -> _Text:
        parts: list[tuple[Expr, int]] = []
        self._collect(a, 2, parts)
        if len(parts) == 1:
            return self._power_text(*parts[0])
        return self._raised(a, "2")

    def _power(self, a: Expr, b: Expr) -> _Text:
        exponent = self.text(b)
        bare = exponent.binding == _ATOM or (self.notation is PYTHON and b.is_constant())
        return self._raised(a, exponent.text if bare else f"({exponent.text})")

    def _divide(self, a: Expr, b: Expr) -> _Text:
        left = self.text(a)
        above = self._bracketed(left, _PRODUCT, leads=True)
        return _Text(f"{above} / {self._within(b, _POWER)}", _PRODUCT, left.is_negative)

    def _invert(self, a: Expr) -> _Text:
        return _Text(f"1 / {self._within(a, _POWER)}", _PRODUCT)

    # -- conditions ---------------------------------------------------------------------------

    def _condition(self, e: Expr) -> str:
        """An expression that is 0 or 1, as a condition."""
        if not e.is_leaf():
            code = e.op()
            if code in _RELATIONS:
                sides = (self._within(e.dep(i), _SUM, leads=True) for i in (0, 1))
                return f" {self._relation(code)} ".join(sides)
            forms = {
                ca.OP_AND: self.notation.conjunction,
                ca.OP_OR: self.notation.disjunction,
                ca.OP_NOT: self.notation.negation,
            }
            if code in forms:
                inner = [self._condition(e.dep(i)) for i in range(e.n_dep())]
                return forms[code].format(*inner)
        return f"{self._within(e, _SUM, leads=True)} {self._relation(ca.OP_NE)} 0"

    def _relation(self, code: int) -> str:
        return "<>" if self.notation is MODELICA and code == ca.OP_NE else _RELATIONS[code]

    def _chosen(self, condition: Expr, value: Expr) -> _Text:
        texts = self._condition(condition), self.text(value).text, "0"
        return _Text(self.notation.choice.format(*texts), _ATOM)

    def _truth(self, e: Expr) -> _Text:
        text = self.notation.truth.format(self._condition(e))
        return _Text(text, _ATOM if text.startswith(("(", "ca.")) else 0)


def _held(code: int) -> Callable[..., _Text]:
    """A relation or a connective in the place of a number."""

    def write(writer: _Writer, *sides: Expr) -> _Text:
        """The text of the relation between `sides`, as a condition that is 1 or 0."""
        if code == ca.OP_NOT:
            return writer._truth(ca.logic_not(sides[0]))
        makers = {
            ca.OP_LT: lambda a, b: a < b,
            ca.OP_LE: lambda a, b: a <= b,
            ca.OP_EQ: lambda a, b: a == b,
            ca.OP_NE: lambda a, b: a != b,
            ca.OP_AND: ca.logic_and,
            ca.OP_OR: ca.logic_or,
        }
        return writer._truth(makers[code](*sides))

    return write


_WRITERS: dict[int, Callable[..., _Text]] = {
    ca.OP_ADD: _Writer._add,
    ca.OP_SUB: _Writer._subtract,
    ca.OP_NEG: _Writer._negate,
    ca.OP_TWICE: _Writer._twice,
    ca.OP_MUL: _Writer._multiply,
    ca.OP_SQ: _Writer._square,
    ca.OP_POW: _Writer._power,
    ca.OP_CONSTPOW: _Writer._power,
    ca.OP_DIV: _Writer._divide,
    ca.OP_INV: _Writer._invert,
    ca.OP_IF_ELSE_ZERO: _Writer._chosen,
    **{code: _held(code) for code in (*_RELATIONS, ca.OP_NOT, ca.OP_AND, ca.OP_OR)},
}
