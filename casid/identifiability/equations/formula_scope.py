"""Formulas of an equation file, in a scope of declared names that definitions extend."""

from __future__ import annotations

import graphlib
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import casadi as ca

from casid.errors import ModelError, nearest
from casid.identifiability.equations.system import Expr
from casid.model.expressions import CONSTANTS, FUNCTIONS, names, parse

_NAME = re.compile(r"(?<![0-9A-Za-z_.])[A-Za-z_][A-Za-z_0-9]*")


class FormulaScope:
    """The formulas of one data set."""

    def __init__(self, scope: dict[str, Any], outputs: frozenset[str], where: str) -> None:
        self.scope, self.outputs, self.where = scope, outputs, where

    def define(self, definitions: Mapping[str, Any]) -> None:
        """Put definitions into the scope, each after those it is made of."""
        needs = {
            name: [n for n, _ in _names_in(text) if n in definitions]
            for name, text in definitions.items()
        }
        try:
            order = list(graphlib.TopologicalSorter(needs).static_order())
        except graphlib.CycleError as error:
            loop = error.args[1][:0:-1]
            places = {name: i for i, name in enumerate(definitions)}
            first = min(range(len(loop)), key=lambda i: places[loop[i]])
            loop = loop[first:] + loop[:first]
            raise ModelError(
                f"{self.where}, definitions: algebraic loop {' -> '.join([*loop, loop[0]])}; solve "
                "it for one of them, or make one of them a state"
            ) from None
        for name in order:
            value = self._formula(definitions[name], f"{self.where}, definitions.{name}")
            # A number goes on as one: the parser then sees a division by it if it is zero.
            self.scope[name] = float(value) if value.is_constant() else value

    def read(self, field: str, texts: Mapping[str, Any], order: Iterable[str]) -> Expr:
        """(n, 1) expressions in the order given."""
        found = {n: self._formula(texts[n], f"{self.where}, {field}.{n}") for n in order}
        together = ca.vertcat(ca.SX(0, 1), *found.values())
        if not is_finite(together):
            invalid = next(n for n, e in found.items() if not is_finite(e))
            raise _pole(f"{self.where}, {field}.{invalid}")
        return together

    def _formula(self, text: Any, where: str) -> Expr:
        if isinstance(text, int | float) and not isinstance(text, bool):
            text = _printed(text, where)
        names(text, where=where)  # refuses what is not text, too long, or no formula's character
        self._refuse_undeclared(text, where)
        needed = {n: self.scope[n] for n, _ in _names_in(text) if n in self.scope}
        expression = ca.SX(parse(text, needed, where=where))
        if expression.is_constant() and not math.isfinite(float(expression)):
            raise _pole(where)
        return expression

    def _refuse_undeclared(self, text: str, where: str) -> None:
        for name, follows in _names_in(text):
            is_called = follows[:1] in ("(", "[")
            if is_called and name in self.scope and re.match(r"[(\[]\s*t\s*[)\]]", follows):
                raise ModelError(f"{where}: write {name}, not {name}(t); a signal goes by its name")
            if name == "E" and not is_called and name not in self.scope:
                raise ModelError(
                    f"{where}: 'E' is not declared; add it to states, params or where it belongs. "
                    "If it is 2.718..., write exp(1)"
                )
            if is_called or name in self.scope or name in CONSTANTS | FUNCTIONS:
                continue  # the parser checks calls
            if name in ("t", "time"):
                raise ModelError(
                    f"{where}: {name!r} is not declared; if it is time, make it a state with "
                    f'derivative 1: add "{name}" to states, "{name}": "1" to equations, and to '
                    "known_initial"
                )
            if name in self.outputs:
                raise ModelError(
                    f"{where}: {name!r} is an output, which no formula can use; write what it is, "
                    "or move it to definitions"
                )
            raise ModelError(
                f"{where}: {name!r} is not declared; add it to params, known_inputs, "
                "unknown_inputs, known_constants, states or definitions"
                f"{nearest(name, self.scope)}"
            )


def _names_in(text: Any) -> Iterator[tuple[str, str]]:
    """Names in a formula, called ones too, each with the text that follows it."""
    for match in _NAME.finditer(text) if isinstance(text, str) else ():
        yield match.group(), text[match.end() : match.end() + 20].lstrip()


def _printed(number: float, where: str) -> str:
    """A number in the place of a formula, as text."""
    try:
        value = float(number)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise ModelError(f"{where}: {value} is no formula; write a finite number or text")
    return repr(value)


def _pole(where: str) -> ModelError:
    return ModelError(
        f"{where}: division by zero, or a part without finite value, wherever it is evaluated; "
        "correct the denominator"
    )


def is_finite(expression: Expr) -> bool:
    """False where CasADi has folded a part of an SX expression into inf or NaN."""
    function = ca.Function("formula", ca.symvar(expression), [expression])
    return all(
        math.isfinite(function.instruction_constant(k))
        for k in range(function.n_instructions())
        if function.instruction_id(k) == ca.OP_CONST
    )
