"""The equations of a model as parts of documents."""

from __future__ import annotations

import html
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import casadi as ca

from casid.errors import ModelError
from casid.model.formula_text import formula_text, summands
from casid.model.model import Model
from casid.report.document import Equation, Equations, Formula
from casid.report.figures.style import visible_text

Expr = Any  # a CasADi SX expression

_LARGEST = 150  # operations of an expression that is set as a formula
_LONGEST = 400  # characters of one that is written


def model_equations(model: Model) -> Equations:
    """Balances with their terms, the other derivatives, outputs, and eliminated inputs."""
    return Equations(list(_equations(model)))


def changed_equations(before: Model, after: Model) -> tuple[Equations, Equations]:
    """The equations that an extension changed or added, before and after, new terms marked."""
    old = {_key(e): e for e in _equations(before)}
    first, second = [], []
    for equation in _equations(after):
        known = old.get(_key(equation))
        texts = [term.text for term in known.terms] if known else []
        new = [i for i, term in enumerate(equation.terms) if term.text not in texts]
        if new:
            first += [known] if known else []
            second.append(replace(equation, new=new))
    return Equations(first), Equations(second)


def _key(equation: Equation) -> tuple[str, str]:
    return equation.name, equation.left.text


def _equations(model: Model) -> Iterator[Equation]:
    for b in model.balances.values():
        inertia = formula(b.inertia)
        rate = _rate(b.rate)
        text = "" if inertia.text == "1" else f"({inertia.text}) "
        factor = f'{inertia.mathml}<mspace width="0.2em"></mspace>' if text else ""
        mathml = inertia.mathml and factor + rate.mathml
        terms = [formula(part) for term in b.terms for part in summands(term)]
        yield Equation(Formula(text + rate.text, mathml), terms, b.unit, b.name)
    for state, expression in model._rates.items():
        yield Equation(_rate(state), [formula(term) for term in summands(expression)])
    for name, (expression, unit) in model.outputs.items():
        terms = [formula(term) for term in summands(expression)]
        yield Equation(formula(ca.SX.sym(name)), terms, unit)


def _rate(state: str) -> Formula:
    return Formula(
        f"d{state}/dt",
        f"<mfrac><mrow><mi>d</mi>{formula(ca.SX.sym(state)).mathml}</mrow>"
        "<mrow><mi>d</mi><mi>t</mi></mrow></mfrac>",
    )


def formula(expression: Expr) -> Formula:
    """An expression as text and, where it is no longer than a line, as MathML."""
    e = ca.SX(expression)
    size = ca.Function("size", ca.symvar(e), [e]).n_instructions()
    try:
        text = formula_text(e)
        if len(text) > _LONGEST:
            text = f"({size} operations)"
    except ModelError as reason:
        return Formula(f"({reason})")
    if size > _LARGEST or len(text) > _LONGEST:
        return Formula(text)
    try:
        return Formula(text, _mathml(-e if text.startswith("-") else e))
    except ModelError:  # an operation that algebra does not know
        return Formula(text)


def _mathml(expression: Expr) -> str:
    """Presentation MathML, a sum in brackets; empty where text reads better."""
    import sympy
    from sympy.printing.mathml import mathml

    from casid.algebra.symbolic import to_sympy

    # What is not text for sympy's printer would be markup: names come from files.
    names = {s.name() for s in ca.symvar(expression)}
    symbols = {name: sympy.Symbol(html.escape(visible_text(name))) for name in names}
    algebra = to_sympy(expression, symbols)[0]
    if algebra.has(sympy.Piecewise):
        return ""
    numbers = {x: sympy.Integer(x) if x == int(x) else sympy.Float(x, 6)
               for x in algebra.atoms(sympy.Float)}  # fmt: skip
    algebra = algebra.xreplace(numbers)
    content = str(mathml(algebra, printer="presentation"))
    if algebra.is_Add:
        content = f"<mo>(</mo>{content}<mo>)</mo>"
    return f"<mrow>{content}</mrow>"
