"""The equations of a fitted model as text, LaTeX and MathML, what was added marked."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from casid.errors import ModelError
from casid.estimation.fitted.numbers_with_units import GUARD, MARK, with_units
from casid.model.clock_signals import Always, TimeSince
from casid.model.declarations import Hold, Input
from casid.model.formula_text import formula_text, summands
from casid.model.model import Model
from casid.model.quantities import unit_text
from casid.model.units import unit_quotient

Expr = Any  # a CasADi SX expression

_STAGES = {
    "delay": ("{c}(t - {p})", "the sensor is late"),
    "lag": ("{c} behind a lag of {p}", "the sensor lags"),
    "filter": ("{c} behind a digital filter of {p}", "the samples are filtered"),
    "clip": ("{c} clipped at {p}", "the sensor is limited"),
    "delay_input": ("{c}(t + {p})", "the record is late"),
    "lead_input": ("{c} + {p} d{c}/dt", "the record lags"),
    "late_input": ("{c}(t - {p})", "the input acts late"),
    "lag_input": ("{c} behind a lag of {p}", "the actuator lags"),
    "play_input": ("{c} behind play of {p} to either side", "the actuator has play"),
    "rate_input": ("{c} followed at a rate of {p} at most", "the actuator's rate is limited"),
}
"""Kind of a stage -> what becomes of a channel c with the parameter p, and in words."""


_LONG = re.compile(r"\d+\.\d{6,}(?:e[-+]\d+)?")  # numbers of more digits than a reader wants
_GUARD = re.compile(r" [+-] \d+(?:\.\d+)?e-1\d\d\b")  # keeps a division finite, and is nothing
_PRODUCT, _GAP = "<mo>&InvisibleTimes;</mo>", '<mspace width="0.2em"></mspace>'
_TURN = re.compile(r"(?<![\w.])6\.28318530717\d+(?![\w.^])")  # rad in a turn


@dataclass(frozen=True, slots=True)
class Term:
    """A term of a sum, with its sign, as text and as LaTeX.

    Attributes
    ----------
    mathml : without a minus sign in front; empty where text reads better.
    is_new : whether the model before had no such term in this equation.
    """

    text: str
    latex: str
    mathml: str = ""
    is_new: bool = False


@dataclass(frozen=True, slots=True)
class ModelEquation:
    """left = sum of terms, in `unit` (SI).

    Attributes
    ----------
    name : of the balance, derivative, output or stage.
    left, left_latex, left_mathml : the left side; `left_is_new` where the model before had another.
    note : what a stage says.
    mark : what a term is called that the model before had not.
    """

    name: str
    left: str
    left_latex: str
    terms: tuple[Term, ...]
    unit: str = ""
    note: str = ""
    left_is_new: bool = False
    left_mathml: str = ""
    mark: str = "new"

    @property
    def is_changed(self) -> bool:
        """True if a term of it is new, or its left side."""
        return self.left_is_new or any(term.is_new for term in self.terms)

    def __str__(self) -> str:
        words = [f"[{self.mark}: {term.text}]" if term.is_new else term.text for term in self.terms]
        right = words[0] if words else "0"
        for word in words[1:]:
            right += f" - {word[1:]}" if word.startswith("-") else f" + {word}"
        left = f"[{self.mark}: {self.left}] = " if self.left_is_new else f"{self.left} = "
        after = "   ".join(f"[{part}]" for part in (self.unit, self.note) if part)
        return f"{left}{right}" + (f"   {after}" if after else "")

    def latex(self) -> str:
        """The equation in LaTeX, for a line of an `aligned` environment; new terms in boxes."""
        right = ""
        for term in self.terms:
            is_negative = term.latex.startswith("-")
            shown = rf"\boxed{{{term.latex}}}" if term.is_new else term.latex
            sign = "" if not right else " " if is_negative and not term.is_new else " + "
            right += sign + shown
        left = rf"\boxed{{{self.left_latex}}}" if self.left_is_new else self.left_latex
        return f"{left} &= {right or '0'}"


@dataclass(frozen=True, slots=True)
class ModelEquations:
    """All equations of a model, and those of the model before; `print` shows the text.

    Attributes
    ----------
    after : derivatives, balances, outputs, and what sensors and actuators do.
    before : those that the causes changed, as they were; empty where nothing was added.
    """

    after: tuple[ModelEquation, ...]
    before: tuple[ModelEquation, ...] = ()

    @property
    def changed(self) -> tuple[ModelEquation, ...]:
        """The equations with a new term."""
        return tuple(e for e in self.after if e.is_changed)

    def __repr__(self) -> str:
        changed = f", {len(self.changed)} with new terms" if self.changed else ""
        return f"<ModelEquations {', '.join(e.left for e in self.after)}{changed}>"

    def __str__(self) -> str:
        return "\n".join(str(e) for e in self.after)

    def latex(self) -> str:
        """The equations as one LaTeX `aligned` environment, new terms in boxes."""
        lines = " \\\\\n".join(e.latex() for e in self.after)
        return f"\\begin{{aligned}}\n{lines}\n\\end{{aligned}}"

    def _repr_latex_(self) -> str:
        return f"$$\n{self.latex()}\n$$"


def equations_of(model: Model, baseline: Model | None = None) -> ModelEquations:
    """The equations of a model; terms that `baseline` has not are marked as new."""
    after = tuple(_equations(model))
    if baseline is None:
        return ModelEquations(after)
    old = {e.name: e for e in _equations(baseline)}
    marked = []
    for equation in after:
        before = old.get(equation.name)
        known = {term.text for term in before.terms} if before else set()
        terms = tuple(replace(t, is_new=t.text not in known) for t in equation.terms)
        is_other = before is not None and before.left != equation.left
        marked.append(replace(equation, terms=terms, left_is_new=is_other))
    changed = [e.name for e in marked if e.is_changed]
    return ModelEquations(tuple(marked), tuple(old[name] for name in changed if name in old))


def _equations(model: Model) -> Iterator[ModelEquation]:
    shown = _shown_inputs(model)

    def read(expression: Expr, unit: str) -> Expr:
        return shown(with_units(model, expression, unit))

    for state, expression in model._rates.items():
        right = [read(expression, unit_quotient(model.states[state].unit, "s"))]
        equation = _equation(f"d{state}/dt", f"d{state}/dt", rf"\dot{{{_symbol(state)}}}", right)
        yield replace(equation, left_mathml=_rate_mathml(state))
    for b in model.balances.values():
        mass = with_units(model, b.inertia)
        inertia, latex = _written(mass), _latex(mass)
        rate, dot = f"d{b.rate}/dt", rf"\dot{{{_symbol(b.rate)}}}"
        is_one = inertia == "1"
        left = rate if is_one else f"({inertia}) {rate}"
        bracketed = latex if ca.SX(mass).is_leaf() else rf"\left({latex}\right)"
        terms = [read(term, b.unit) for term in b.terms]
        equation = _equation(b.name, left, dot if is_one else rf"{bracketed}\,{dot}", terms, b.unit)
        factor, rate = _mathml(mass), _rate_mathml(b.rate)
        if not is_one:  # an inertia that has no MathML leaves none to the left side
            rate = factor and f"{factor}{_GAP}{rate}"
        yield replace(equation, left_mathml=rate)
    for name, (expression, unit) in model.outputs.items():
        equation = _equation(f"output {name}", name, _symbol(name), [read(expression, unit)], unit)
        yield replace(equation, left_mathml=_mathml(ca.SX.sym(name)))
    for unknown, output, residual in model._eliminations:
        parts = _equation(f"elimination of {unknown}", "0", "0", [read(residual, "")])
        parts = replace(parts, left_mathml="<mn>0</mn>")
        yield replace(parts, note=f"gives {unknown}, with {output} as an input")
    for stage in model.stages:
        text, note = _STAGES[stage.kind]
        what = "acting" if stage.is_of_input else "measured"
        yield _in_words(
            stage.kind, what, stage.channel, text.format(c=stage.channel, p=stage.parameter), note
        )
    for name, entry in model.inputs.items():
        if entry.blends and entry.kind != "generated":
            yield _in_words("hold", "acting", name, _course(model, entry), "between its samples")


def _shown_inputs(model: Model) -> Callable[[Expr], Expr]:
    """Puts the time t, and 1, in the place of generated inputs that are these.

    What acts late or lags is what `acting` says of it; the inputs that carry tangents are zero.
    """
    found: dict[str, Expr] = {}
    for stage in model.stages:
        if stage.is_of_input:
            found[stage.channel] = ca.SX.sym(f"acting {stage.channel}")
            found |= dict.fromkeys(stage.carriers, ca.SX(0))
    for name, entry in model.inputs.items():
        if isinstance(entry.signal, TimeSince):
            found[name] = ca.SX.sym(f"(t - {entry.signal.origin:.6g} s)".replace("- -", "+ "))
        elif isinstance(entry.signal, Always):
            found[name] = ca.SX(1)
    symbols = [model.symbol(name) for name in found]

    def read(expression: Expr) -> Expr:
        (out,) = ca.substitute([ca.SX(expression)], symbols, list(found.values()))
        return out

    return read if found else lambda expression: expression


def _course(model: Model, entry: Input) -> str:
    """What a blended input does between its samples."""
    name = entry.name
    courses: Mapping[Hold, str] = {
        "zoh": f"{name}[k]",
        "foh": f"{name}[k] + ({name}[k+1] - {name}[k]) (t - t[k]) / Ts",
        "bandlimited": f"sum over j of {name}[j] sinc((t - t[j]) / Ts)",
    }
    acting = model.acting_hold(name)
    if acting != entry.hold:
        return courses[acting]
    blends = {b.toward: b.parameter for b in entry.blends}
    if len(blends) == 1 and "bandlimited" not in entry.holds:
        (b,) = blends.values()
        share = b if entry.hold == "zoh" else f"(1 - {b})"
        return f"{name}[k] + {share} ({name}[k+1] - {name}[k]) (t - t[k]) / Ts"
    first = " - ".join(["1", *blends.values()])
    rest = "".join(f" + {b} ({courses[hold]})" for hold, b in blends.items())
    return f"({first}) ({courses[entry.hold]}){rest}"


def _in_words(kind: str, what: str, channel: str, right: str, note: str) -> ModelEquation:
    """What is done to a whole column, which is no expression of the model."""
    left = f"{what} {channel}"
    return ModelEquation(
        f"{kind} of {channel}", left, _text(left), (Term(right, _text(right)),), "", note
    )


def _equation(
    name: str, left: str, left_latex: str, terms: list[Expr], unit: str = ""
) -> ModelEquation:
    parts = [part for term in terms for part in summands(term)]
    shown = tuple(_term(part) for part in parts)
    return ModelEquation(name, left, left_latex, shown, unit)


def _term(part: Expr) -> Term:
    text = _written(part)
    return Term(text, _latex(part), _mathml(-part if text.startswith("-") else part))


def _written(expression: Expr) -> str:
    """An expression as text, derivatives of states as d/dt."""
    names = [s.name() for s in ca.symvar(ca.SX(expression))]
    shown = {n: f"d{n[4:]}/dt" for n in names if n.startswith("der_")}
    shown |= {n: n.removeprefix(MARK) for n in names if n.startswith(MARK)}
    text = formula_text(expression, names=shown)
    text = _TURN.sub("2 pi", _GUARD.sub("", text))
    return _LONG.sub(lambda number: f"{float(number[0]):.6g}", text)


def _text(words: str) -> str:
    return r"\text{" + words.replace("_", r"\_") + "}"


def _symbol(name: str) -> str:
    """A name as LaTeX: Greek letters and indices where it has some, upright where it is a word."""
    import sympy

    if name.startswith(MARK):
        return re.sub(r"\^(-?[\d.]+)", r"$^{\1}$", _text(name.removeprefix(MARK)))
    if not name.replace("_", "").isalnum():
        return _text(name)
    latex = str(sympy.latex(sympy.Symbol(name)))
    head = latex.partition("_")[0]
    return (
        latex
        if len(head) < 2 or head.startswith("\\")
        else rf"\mathrm{{{head}}}{latex[len(head) :]}"
    )


def _latex(expression: Expr) -> str:
    """An expression as LaTeX; as text where algebra does not know an operation in it."""
    import sympy

    algebra = _algebra(expression)
    if algebra is None:
        return _text(_written(expression))
    names = {s: _derivative(s.name) for s in algebra.free_symbols}
    return str(sympy.latex(algebra, symbol_names=names, mul_symbol=r" \, "))


def _mathml(expression: Expr) -> str:
    """Presentation MathML, a sum in brackets; empty where text reads better."""
    import sympy
    from sympy.printing.mathml import mathml

    algebra = _algebra(expression)
    if algebra is None or algebra.has(sympy.Piecewise):
        return ""
    # What sympy's printer is given as a name it writes unescaped, and names come from files.
    names = {s: html.escape(unit_text(s.name)) for s in algebra.free_symbols}
    names = {s: f"d{name[4:]}/dt" if name.startswith("der_") else name for s, name in names.items()}
    safe = algebra.xreplace({s: sympy.Symbol(name) for s, name in names.items()})
    content = str(mathml(safe, printer="presentation")).replace("<mo>-</mo>", "<mo>\u2212</mo>")
    content = content.replace(f">{MARK}", ">").replace(_PRODUCT, f"{_PRODUCT}{_GAP}")
    return f"<mrow><mo>(</mo>{content}<mo>)</mo></mrow>" if safe.is_Add else content


def _rate_mathml(state: str) -> str:
    above = f"<mrow><mi>d</mi>{_mathml(ca.SX.sym(state))}</mrow>"
    return f"<mfrac>{above}<mrow><mi>d</mi><mi>t</mi></mrow></mfrac>"


def _algebra(expression: Expr) -> Any:
    """An expression in sympy with numbers as they are written; None where it has no operation."""
    import sympy

    from casid.algebra.symbolic import to_sympy

    try:
        algebra = to_sympy(expression)[0]
    except ModelError:
        return None
    floats = algebra.atoms(sympy.Float)

    def short(x: Any) -> Any:
        """A number as it is printed: 2 pi as such, others with six digits."""
        if abs(x) < GUARD:
            return sympy.Integer(0)
        if math.isclose(abs(x), 2 * math.pi, rel_tol=1e-12):
            return 2 * sympy.pi * (1 if x > 0 else -1)
        return sympy.Integer(x) if x == int(x) else sympy.Float(x, 6)

    return algebra.xreplace({x: short(x) for x in floats})


def _derivative(name: str) -> str:
    """The derivative of a state is called der_ and its name."""
    state = name.removeprefix("der_")
    return _symbol(name) if state == name else rf"\dot{{{_symbol(state)}}}"
