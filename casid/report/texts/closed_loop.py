"""A closed-loop view as a document: the loop in symbols, its direct term, estimators, numbers."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import Any

import numpy as np

from casid.algebra.factoring import factored
from casid.linear.loops.closed_loop import ClosedLoopView
from casid.report.document import Document, Lines

Algebra = Any  # a sympy expression or matrix


def closed_loop_document(view: ClosedLoopView) -> Document:
    """The loop in symbols, its direct term, which estimators are consistent, and its numbers."""
    p, taus = view.p, view.disturbances_as_inputs
    short = _Denominators(p)
    title = f"Closed-loop view of {view.name}  ({p} = d/dt)"
    lines = [
        f"  outputs {', '.join(view.outputs)}; fed back: {', '.join(view.inputs)} (in place of "
        f"{', '.join(view.unknown)}); other inputs: {', '.join(view.others) or 'none'}",
        "",
        "  indirect model, y_O = G_O u_I + G_K u_K + H_O tau",
        *short.entries("G_O", view.G_O, view.outputs, view.inputs),
        *short.entries("G_K", view.G_K, view.outputs, view.others),
        *short.entries("H_O", view.H_O, view.outputs, taus),
        *short.listed(),
        "",
        f"  return path, u_I = F_y y_O + external  (by {', '.join(view.used) or 'the sensor'})",
        *short.entries("F_y", view.F_y, view.inputs, view.outputs),
        *[f"    external[{u}] = {_external(view, i)}" for i, u in enumerate(view.inputs)],
        "    F_y is never simulated: the loop is closed in algebra first",
        *short.listed(),
        "",
    ]
    if view.is_degenerate:
        lines.append("  nothing enters the loop from outside: the indirect model is an identity")
        return Document(title, [Lines(lines)])
    if view.has_direct_term:
        lines.append("  direct term, lim G_O F_y as p grows: not zero")
        lines += _Denominators(p).entries("lim", view.direct_term, view.outputs, view.outputs)
    else:
        lines.append("  direct term, lim G_O F_y as p grows: zero")
    lines += ["", "  estimators of G_O, with disturbances and noise on all sensors"]
    for v in view.estimators():
        lines.append(f"    {'consistent' if v.is_consistent else 'biased':12}{v.estimator}")
        lines += wrap(v.why, 96, initial_indent=" " * 16, subsequent_indent=" " * 16)
    return Document(title, [Lines(lines + _numbers(view))])


def _numbers(view: ClosedLoopView) -> list[str]:
    """The loop at the model's own values; nothing where they make it singular."""
    with np.errstate(all="ignore"):
        term = view.direct_term_at()
        indirect, direct = view.poles()
    if not np.all(np.isfinite(term)):
        return []
    ny = len(view.outputs)
    lines = [
        "",
        "  at the model's own values (starts where unknown)",
        f"    direct term {_list(term.ravel())}, det(1 - it) = "
        f"{np.linalg.det(np.eye(ny) - term):.4g}",
        f"    poles of the indirect model  {_list(indirect)} rad/s",
        f"    poles of the direct model    {_list(direct)} rad/s",
    ]
    if np.any(indirect.real > 0):
        lines.append(
            "    the indirect model is unstable by itself: simulate the loop, never G_O alone"
        )
    return lines


def _list(values: Any) -> str:
    parts = []
    for v in np.atleast_1d(values).tolist():
        if isinstance(v, complex) and v.imag:
            parts.append(f"{v.real:.4g}{v.imag:+.4g}i")
        else:
            parts.append(f"{complex(v).real:.4g}")
    return ", ".join(parts) or "none"


def _external(view: ClosedLoopView, i: int) -> str:
    parts = []
    names = [*view.unknown, *view.others, *view.disturbances_as_inputs]
    for F, name in zip(view.F_w.row_join(view.F_K).row_join(view.F_tau).row(i), names, strict=True):
        if F == 0:
            continue
        top, bottom = fraction_text(F, view.p)
        gain = _bracket(top) if bottom == "1" else f"{_bracket(top)} / {_bracket(bottom)}"
        parts.append({1: f"+ {name}", -1: f"- {name}"}.get(F, f"+ {gain} {name}"))
    joined = " ".join(parts) or "0"
    return joined[2:] if joined.startswith("+ ") else joined.replace("- ", "-", 1)


class _Denominators:
    """Rational functions as text, long denominators written once."""

    def __init__(self, p: Algebra) -> None:
        self._p = p
        self._names: dict[str, str] = {}
        self._listed = 0

    def entries(
        self, symbol: str, matrix: Algebra, rows: Sequence[str], columns: Sequence[str]
    ) -> list[str]:
        """A line for each entry that is not zero."""
        lines = []
        for i, row in enumerate(rows):
            for j, column in enumerate(columns):
                if matrix[i, j] != 0:
                    text = self._text(*fraction_text(matrix[i, j], self._p))
                    lines.append(f"    {symbol}[{row}, {column}] = {text}")
        return lines

    def listed(self) -> list[str]:
        """A line for each denominator not listed yet."""
        new = list(self._names.items())[self._listed :]
        self._listed = len(self._names)
        return [f"    with {name} = {text}" for text, name in new]

    def _text(self, top: str, bottom: str) -> str:
        if bottom == "1":
            return top
        if len(bottom) > 24 and str(self._p) in bottom:
            n = len(self._names)
            bottom = self._names.setdefault(bottom, "D" if not n else f"D{n + 1}")
        return f"{_bracket(top)} / {_bracket(bottom)}"


def fraction_text(entry: Algebra, p: Algebra) -> tuple[str, str]:
    """Numerator and denominator in descending powers of p, coefficients factored."""
    import sympy

    if entry.has(sympy.oo, sympy.zoo):
        return "infinite", "1"
    num, den = (sympy.Poly(e, p) for e in sympy.fraction(sympy.cancel(entry)))
    if factored(den.LC()).could_extract_minus_sign():
        num, den = -num, -den
    return _polynomial(num), _polynomial(den)


def _polynomial(q: Algebra) -> str:

    text = ""
    for (power,), value in q.terms():
        coefficient = factored(value)
        negative = bool(coefficient.could_extract_minus_sign())
        coefficient = -coefficient if negative else coefficient
        written = str(coefficient)
        if coefficient.is_Add and (power or text or negative):
            written = f"({written})"
        term = {0: "", 1: f"{q.gen}"}.get(power, f"{q.gen}^{power}")
        if term:
            written = term if written == "1" else f"{written} {term}"
        if text:
            text += f" {'-' if negative else '+'} {written}"
        else:
            text = f"-{written}" if negative else written
    return text.replace("**", "^").replace("*", " ") or "0"


def _bracket(text: str) -> str:
    """Brackets where a sum is outside of brackets."""
    depth = 0
    for i, sign in enumerate(text):
        depth += (sign == "(") - (sign == ")")
        if depth == 0 and i > 0 and text[i : i + 3] in (" + ", " - "):
            return f"({text})"
    return text
