"""Formulas read from text, as CasADi expressions.

Model lines come from strangers (equation files, command lines, data sheets). They are read by a
small precedence parser (V. R. Pratt, "Top down operator precedence", 1973) that knows numbers,
declared names, five operators and a list of functions, and nothing else: text never becomes code.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca

from casid.errors import ModelError, nearest

MAX_LENGTH = 20_000  # characters of one formula
MAX_DEPTH = 60  # brackets, signs and powers inside one another
MAX_EXPONENT = 100.0  # of a power whose exponent is a number

_UNARY: dict[str, Callable[[Any], Any]] = {
    "sin": ca.sin,
    "cos": ca.cos,
    "tan": ca.tan,
    "asin": ca.asin,
    "acos": ca.acos,
    "atan": ca.atan,
    "sinh": ca.sinh,
    "cosh": ca.cosh,
    "tanh": ca.tanh,
    "asinh": ca.asinh,
    "acosh": ca.acosh,
    "atanh": ca.atanh,
    "exp": ca.exp,
    "expm1": ca.expm1,
    "log": ca.log,
    "log10": ca.log10,
    "log1p": ca.log1p,
    "sqrt": ca.sqrt,
    "abs": ca.fabs,
    "sign": ca.sign,
    "floor": ca.floor,
    "ceil": ca.ceil,
}
_ALIASES = {
    "ln": "log",
    "fabs": "abs",
    "sgn": "sign",
    **{f"arc{f}": f"a{f}" for f in ("sin", "cos", "tan", "sinh", "cosh", "tanh")},
}
_UNARY |= {alias: _UNARY[name] for alias, name in _ALIASES.items() if name in _UNARY}
_BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "min": ca.fmin,
    "max": ca.fmax,
    "atan2": ca.atan2,
    "arctan2": ca.atan2,
    "hypot": lambda a, b: ca.sqrt(a * a + b * b),
    "pow": ca.power,
}
_CONSTANTS = {"pi": math.pi, "E": math.e}

FUNCTIONS: frozenset[str] = frozenset(_UNARY) | frozenset(_BINARY)
"""Names that may be called in a formula."""

CONSTANTS: frozenset[str] = frozenset(_CONSTANTS)
"""Names with a value of their own, unless a symbol of that name is declared."""

_TOKEN = re.compile(
    r"(?P<space>[ \t\r\n]+)"
    r"|(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<name>[A-Za-z_][A-Za-z_0-9]*)"
    r"|(?P<operator>\*\*|[-+*/^()\[\],])"
)
_CLOSING = {"(": ")", "[": "]"}
_BINDING = {"+": 10, "-": 10, "*": 20, "/": 20, "**": 40, "^": 40}
_SIGN_BINDING = 30  # between * and **: -x**2 is -(x**2), and 2**-1 is 0.5


def parse(text: str, symbols: Mapping[str, Any], *, where: str = "") -> Any:
    """Read one formula.

    Parameters
    ----------
    text : operators ``+ - * / ** ^``, round or square brackets, the functions in `FUNCTIONS`
        (``log`` is natural, ``min`` and ``max`` take two arguments), numbers, the names in
        `symbols`, and the constants ``pi`` and ``E`` (2.718...) where no symbol has that name.
    symbols : name -> SX, or name -> MX, expression; a number stands for a known value.
    where : prefix of error messages, such as the file and line the text is from.

    Returns
    -------
    SX or MX as the symbols are; DM if `symbols` holds no expression.

    Raises
    ------
    ModelError
        For anything else: a name not declared, a call of what is no function, brackets that do not
        match, a constant part without finite value, or a formula beyond `MAX_LENGTH`, `MAX_DEPTH`
        or `MAX_EXPONENT`. The message gives the character position, counted from 1.

    Example
    -------
    >>> import casadi as ca
    >>> from casid.model.expressions import parse
    >>> x = ca.SX.sym("x")
    >>> f = ca.Function("f", [x], [parse("2*exp[-x] - x^2", {"x": x})])
    >>> float(f(0.0))
    2.0
    """
    kinds = {type(s) for s in symbols.values() if isinstance(s, (ca.SX, ca.MX))}
    if len(kinds) > 1:
        raise ModelError(
            f"{where or 'formula'}: symbols mix SX and MX; declare all with the same kind"
        )
    value = _Parser(text, symbols, where).formula()
    if isinstance(value, float):
        return kinds.pop()(value) if kinds else ca.DM(value)
    return value


def names(text: str, *, where: str = "") -> tuple[str, ...]:
    """Names in a formula that are neither functions nor constants, in order of appearance.

    Raises
    ------
    ModelError
        If the text holds a character that no formula has.
    """
    tokens = _Parser(text, {}, where).tokens
    called = {
        i for i, t in enumerate(tokens[:-1]) if tokens[i + 1][1] in _CLOSING and t[1] in FUNCTIONS
    }
    found = (
        t[1]
        for i, t in enumerate(tokens)
        if t[0] == "name" and i not in called and t[1] not in CONSTANTS
    )
    return tuple(dict.fromkeys(found))


class _Parser:
    """One pass over the tokens of one formula; numbers are folded, so their faults are seen."""

    def __init__(self, text: str, symbols: Mapping[str, Any], where: str) -> None:
        if not isinstance(text, str):
            raise ModelError(
                f"{where or 'formula'}: expected text, got {type(text).__name__}; write it as a "
                "string, such as 'b1*exp(-b2*x)'"
            )
        self.text, self.symbols, self.where = text, symbols, where
        if len(text) > MAX_LENGTH:
            raise self._error(
                f"it has {len(text)} characters, more than {MAX_LENGTH}; split it into several", 0
            )
        self.tokens = self._split()
        self.at = 0
        self.depth = 0

    def formula(self) -> Any:
        """The whole text as one value: float, SX or MX."""
        value = self._expression(0)
        kind, word, start = self.tokens[self.at]
        if kind == "end":
            return value
        if word in (")", "]"):
            raise self._error(f"{word!r} closes nothing; remove it or open a bracket", start)
        raise self._error(
            f"expected an operator before {word!r}; write a product as 2*x, not 2x or 2 x", start
        )

    def _split(self) -> list[tuple[str, str, int]]:
        tokens = []
        position = 0
        while position < len(self.text):
            match = _TOKEN.match(self.text, position)
            if match is None:
                character = self.text[position]
                code = "" if character.isascii() else f" (U+{ord(character):04X})"
                raise self._error(
                    f"{character!r}{code} has no place in a formula; use ASCII letters, digits, _, "
                    "+ - * / ** ^, brackets () [] and commas",
                    position,
                )
            if match.lastgroup != "space":
                tokens.append((str(match.lastgroup), match.group(), position))
            position = match.end()
        return [*tokens, ("end", "", len(self.text))]

    def _expression(self, binding: int) -> Any:
        """Everything to the right that binds tighter than `binding`."""
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise self._error(
                f"nested more than {MAX_DEPTH} deep; name a part and substitute it",
                self.tokens[self.at][2],
            )
        left = self._operand()
        while True:
            operator, start = self.tokens[self.at][1:]
            strength = _BINDING.get(operator, 0)
            if strength <= binding:
                break
            self.at += 1
            is_power = operator in ("**", "^")
            right = self._expression(strength - 1 if is_power else strength)
            left = self._combine("**" if is_power else operator, left, right, start)
        self.depth -= 1
        return left

    def _operand(self) -> Any:
        kind, word, start = self.tokens[self.at]
        self.at += 1
        if kind == "number":
            return self._finite(float(word), word, start)
        if kind == "name":
            return self._name(word, start)
        if word in _CLOSING:
            value = self._expression(0)
            self._close(word, start)
            return value
        if word in ("+", "-"):
            value = self._expression(_SIGN_BINDING)
            return -value if word == "-" else value
        found = f"found {word!r}" if word else "the formula ends"
        raise self._error(f"expected a number, a name or a bracket, but {found}", start)

    def _name(self, word: str, start: int) -> Any:
        following = self.tokens[self.at][1]
        if following in _CLOSING:
            if word in FUNCTIONS:
                return self._call(word, start)
            if word in self.symbols or word in _CONSTANTS:
                raise self._error(
                    f"{word!r} is no function; write a product as {word}*{following}...", start
                )
            raise self._error(f"unknown function {word!r}{nearest(word, FUNCTIONS)}", start)
        if word in self.symbols:
            value = self.symbols[word]
            if isinstance(value, (ca.SX, ca.MX)):
                return value
            return self._finite(float(value), word, start)
        if word in _CONSTANTS:
            return _CONSTANTS[word]
        if word in FUNCTIONS:
            raise self._error(f"function {word!r} lacks its argument; write {word}(...)", start)
        known = [str(k) for k in self.symbols] + list(_CONSTANTS)
        raise self._error(f"{word!r} is not declared{nearest(word, known)}", start)

    def _call(self, word: str, start: int) -> Any:
        opening, opened_at = self.tokens[self.at][1:]
        self.at += 1
        arguments = []
        if self.tokens[self.at][1] != _CLOSING[opening]:
            arguments.append(self._expression(0))
            while self.tokens[self.at][1] == ",":
                self.at += 1
                arguments.append(self._expression(0))
        self._close(opening, opened_at)
        wanted = 1 if word in _UNARY else 2
        if len(arguments) != wanted:
            raise self._error(
                f"{word} takes {wanted} argument{'s' * (wanted > 1)}, got {len(arguments)}", start
            )
        function: Callable[..., Any] = _UNARY[word] if word in _UNARY else _BINARY[word]
        if word == "pow":
            return self._combine("**", arguments[0], arguments[1], start)
        if all(isinstance(a, float) for a in arguments):
            return self._finite(float(function(*map(ca.DM, arguments))), word + "(...)", start)
        return function(*arguments)

    def _combine(self, operator: str, left: Any, right: Any, start: int) -> Any:
        if operator == "**" and isinstance(right, float) and abs(right) > MAX_EXPONENT:
            raise self._error(
                f"exponent {right:g} lies beyond +-{MAX_EXPONENT:g}; write it as exp(...*log(...))",
                start,
            )
        if isinstance(left, float) and isinstance(right, float):
            a, b = ca.DM(left), ca.DM(right)
            folded = {"+": a + b, "-": a - b, "*": a * b, "/": a / b, "**": a**b}[operator]
            return self._finite(float(folded), f"{left:g} {operator} {right:g}", start)
        if operator == "+":
            return left + right
        if operator == "-":
            return left - right
        if operator == "*":
            return left * right
        if operator == "/":
            if isinstance(right, float) and right == 0.0:
                raise self._error("division by zero; remove it", start)
            return left / right
        return left**right

    def _close(self, opening: str, start: int) -> None:
        _, word, position = self.tokens[self.at]
        wanted = _CLOSING[opening]
        if word != wanted:
            found = repr(word) if word else "the end"
            raise self._error(
                f"{opening!r} at character {start + 1} needs {wanted!r}, but {found} follows; "
                f"close it with {wanted!r}",
                position,
            )
        self.at += 1

    def _finite(self, value: float, what: str, start: int) -> float:
        if not math.isfinite(value):
            raise self._error(f"{what!r} has no finite real value; rewrite that part", start)
        return value

    def _error(self, problem: str, position: int) -> ModelError:
        low = max(0, position - 30)
        excerpt = self.text[low : position + 30]
        excerpt = "..." * (low > 0) + excerpt + "..." * (position + 30 < len(self.text))
        prefix = f"{self.where}: " if self.where else ""
        return ModelError(f"{prefix}formula {excerpt!r}, character {position + 1}: {problem}")
