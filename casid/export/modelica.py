"""A fitted model as Modelica text.

The equations are written as they were stated, balances with their terms: Modelica needs no explicit
form, and an eliminated input stays an unknown that its output determines. A delay is
Modelica's `delay`. All quantities are in SI units.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import casadi as ca

from casid.estimation.fitted.fitted_model import FittedModel
from casid.export.naming import checked_path, identifiers, written_by
from casid.export.plain_model import PlainModel, plain_model
from casid.export.written_equations import (
    WrittenBalance,
    WrittenEquations,
    clock_names,
    written_equations,
)
from casid.model.clock_signals import Always, RampOver, StepAt, TimeSince
from casid.model.formula_text import MODELICA, number_text
from casid.model.identifiers import identifier
from casid.model.model import Model
from casid.model.units import unit_powers

_WORDS = frozenset(
    """algorithm and annotation block break class connect connector constant constrainedby der
    discrete each else elseif elsewhen encapsulated end enumeration equation expandable extends
    external false final flow for function if import impure in initial inner input loop model not
    operator or outer output package parameter partial protected public pure record redeclare
    replaceable return stream then true type when while within
    abs sign sqrt div mod rem ceil floor integer sin cos tan asin acos atan atan2 sinh cosh tanh exp
    log log10 delay cardinality homotopy semiLinear inStream actualStream spatialDistribution
    getInstanceName terminal noEvent smooth sample pre edge change reinit min max sum product time
    Real Integer Boolean String StateSelect Connections""".split()
)
"""Words of the language and names that every model has."""


def write_modelica(fitted: FittedModel, path: Path) -> Path:
    """Write `path` (.mo), a file with one model named like the file.

    Raises
    ------
    ModelError
        If an input is a function of the user's own, or a formula has no word in Modelica.
    """
    path = checked_path(path, "modelica")
    path.write_text(modelica_text(fitted, identifier(path.stem)), encoding="utf-8")
    return path


def modelica_text(fitted: FittedModel, name: str) -> str:
    """The text of a Modelica model called `name`."""
    plain = plain_model(fitted, what="Modelica")
    return _Writer(fitted, plain, name).text()


class _Writer:
    def __init__(self, fitted: FittedModel, plain: PlainModel, name: str) -> None:
        self.fitted, self.plain, self.name = fitted, plain, name
        self.equations: WrittenEquations = written_equations(plain.model)
        self.model: Model = self.equations.model
        model, e = self.model, self.equations
        # A state and an output of its name that shows it are one variable.
        self.seen = {
            n for n, x in e.outputs.items() if n in model.states and _is(x, model.symbol(n))
        }
        signals = [n for n, u in model.inputs.items() if u.kind != "generated"]
        clocks = [n for n, u in model.inputs.items() if u.kind == "generated"]
        apart = [n for n in e.outputs if n not in self.seen]
        words = [*_WORDS, name]
        symbols = identifiers([*model.states, *signals, *model.parameters, *e.parts], words)
        for n, text in clock_names(model).items():
            symbols[n] = identifiers([text], [*words, *symbols.values()])[text]
        self.outputs = identifiers(
            [f"{n}_output" if n in symbols else n for n in apart], [*words, *symbols.values()]
        )
        self.outputs = dict(zip(apart, self.outputs.values(), strict=True))
        self.names = symbols
        self.written = symbols | {f"der_{s}": f"der({symbols[s]})" for s in model.states}
        for n, late in plain.dead_times.items():
            self.written[n] = f"delay({symbols[n]}, {number_text(late)})"
        # An unknown input is determined by the output that it was eliminated with.
        self.given = [n for n in signals if model.inputs[n].kind != "unknown"]
        self.given += [e.output for e in e.eliminations]
        self.unknown = [n for n in signals if model.inputs[n].kind == "unknown"]
        self.clocks = clocks

    def text(self) -> str:
        """The whole file."""
        says = f"{self.plain.name}: a fitted model in SI units, written by {written_by()}"
        lines = [
            f'model {self.name} "{_safe(says)}"',
            *self._comments(),
            *self._parameters(),
            *self._variables(),
            "equation",
            *self._equations(),
            *self._annotation(),
            f"end {self.name};",
        ]
        return "\n".join(lines) + "\n"

    def _formula(self, expression: Any, defined: str = "") -> str:
        """An expression, or the definition of a shared part."""
        return self.equations.formula(expression, MODELICA, self.written, defined)

    def _comments(self) -> list[str]:
        texts = [
            f"The diagnosis found {c.words} missing; its parameters: {', '.join(c.parameters)}."
            for c in self.fitted.causes
        ]
        texts += list(self.plain.notes)
        texts += [
            f"Before it acts late, {n} was {number_text(was)}; delay() takes its first value for "
            "that: begin the input there."
            for n, was in self.plain.rest.inputs.items()
            if n in self.plain.dead_times
        ]
        if self.clocks:
            texts.append("The time is that of the clock of the fitted record.")
        return [f"  // {line}" for text in texts for line in textwrap.wrap(text, 94)]

    # -- declarations --------------------------------------------------------------------------

    def _parameters(self) -> list[str]:
        stated = [
            *self.equations.parts.values(),
            *self.equations.derivatives.values(),
            *self.equations.outputs.values(),
            *(x for b in self.equations.balances for x in (b.inertia, *b.terms)),
        ]
        needed = {s.name() for s in ca.symvar(ca.vertcat(*stated))}
        lines = []
        errors = dict(zip(self.fitted.covariance_names, _errors(self.fitted), strict=True))
        for name, p in self.model.parameters.items():
            if name not in needed:
                continue
            says = "known"
            if name in errors:
                says = f"estimated, standard error {errors[name]:.3g}"
            value = number_text(self.plain.values[name])
            lines.append(
                f"  parameter Real {self.names[name]}{_unit(p.unit)} = {value} "
                f'"{_safe(_in_unit(says, p.unit))}";'
            )
        return lines

    def _variables(self) -> list[str]:
        model = self.model
        lines = []
        for name, state in model.states.items():
            kind = "output " if name in self.seen else ""
            start = number_text(float(self.plain.initial[name]))
            lines.append(
                f"  {kind}Real {self.names[name]}{_unit(state.unit, f'start={start}, fixed=true')};"
            )
        for name in self.given:
            unit = self._channel_unit(name)
            says = self._course(name)
            if name in self.outputs:  # an output that an unknown input was eliminated with
                lines.append(f"  input Real {self.outputs[name]}{_unit(unit)};")
            else:
                comment = f' "{says}"' if says else ""
                lines.append(f"  input Real {self.names[name]}{_unit(unit)}{comment};")
        for name in self.unknown:
            lines.append(
                f"  Real {self.names[name]}{_unit(model.inputs[name].unit)} "
                '"not measured; determined by the equations";'
            )
        for name in self.clocks:
            signal = _clock_text(model.inputs[name].signal)
            lines.append(f'  Real {self.names[name]} = {signal} "{_safe(name)}";')
        for name, text in self.outputs.items():
            if name not in self.given:
                lines.append(f"  output Real {text}{_unit(model.outputs[name][1])};")
        for name, expression in self.equations.parts.items():
            is_fixed = not self._moves(expression)
            kind = "final parameter " if is_fixed else ""
            lines.append(f"  {kind}Real {self.names[name]} = {self._formula(expression, name)};")
        return lines

    def _course(self, name: str) -> str:
        """What an input does between its samples, where that is no straight line."""
        if name not in self.model.inputs:
            return ""
        hold = self.model.acting_hold(name)
        held = {
            "zoh": "held between its samples",
            "bandlimited": "band-limited between its samples",
        }
        return held.get(hold, "")

    def _channel_unit(self, name: str) -> str:
        model = self.model
        return str(model.outputs[name][1] if name in model.outputs else model.inputs[name].unit)

    def _moves(self, expression: Any) -> bool:
        """True if an expression, or a part inside it, depends on more than parameters."""
        symbols = {s.name() for s in ca.symvar(expression)}
        return bool(symbols - set(self.model.parameters))

    # -- equations -----------------------------------------------------------------------------

    def _equations(self) -> list[str]:
        lines = [
            f"  der({self.names[s]}) = {self._formula(e)};"
            for s, e in self.equations.derivatives.items()
        ]
        for balance in self.equations.balances:
            lines += self._balance(balance)
        for name, expression in self.equations.outputs.items():
            if name in self.seen:
                continue
            text = self._formula(expression)
            late = self.plain.delays.get(name)
            if late is not None:
                text = f"delay({text}, {number_text(late)})"
            lines.append(f"  {self.outputs[name]} = {text};")
        return lines

    def _balance(self, b: WrittenBalance) -> list[str]:
        inertia, rate = self._formula(b.inertia), self.names[b.rate]
        if _is_sum(inertia):
            inertia = f"({inertia})"
        left = f"der({rate})" if inertia == "1" else f"{inertia} * der({rate})"
        lines = [f"  // balance {_safe(b.name)} [{b.unit}]", f"  {left} ="]
        for i, term in enumerate(b.terms):
            text = self._formula(term)
            sign = "" if i == 0 else "+ "
            if i > 0 and text.startswith("-"):
                sign, text = "- ", text[1:]  # of a sum too: + (-a + b) is - a + b
            elif i > 0 and _is_sum(text):
                text = f"({text})"
            end = ";" if i + 1 == len(b.terms) else ""
            lines.append(f"    {sign}{text}{end}{self._named(term)}")
        return lines

    def _named(self, term: Any) -> str:
        symbols = {s.name() for s in ca.symvar(term)}
        found = [c.words for c in self.fitted.causes if symbols & set(c.parameters)]
        return f"  // {', '.join(found)}" if found else ""

    def _annotation(self) -> list[str]:
        record = self.fitted.records[0]
        stop = record.t0 + (record.N - 1) * record.Ts
        return [
            "  annotation(experiment("
            f"StartTime={number_text(record.t0)}, StopTime={stop:.12g}, "
            f"Interval={number_text(record.Ts)}));"
        ]


def _errors(fitted: FittedModel) -> list[float]:
    return [float(max(v, 0.0)) ** 0.5 for v in fitted.covariance.diagonal()]


def _is(expression: Any, symbol: Any) -> bool:
    return bool(ca.is_equal(ca.SX(expression), symbol, 1))


def _is_sum(text: str) -> bool:
    """True if a formula has a plus or minus outside all brackets, its first sign apart."""
    depth = 0
    for i, c in enumerate(text):
        depth += (c == "(") - (c == ")")
        if i > 0 and depth == 0 and c in "+-" and text[i - 1] == " ":
            return True
    return False


def _clock_text(signal: Any) -> str:
    if isinstance(signal, StepAt):
        return f"if time >= {number_text(signal.time)} then 1.0 else 0.0"
    if isinstance(signal, RampOver):
        middle = 0.5 * (signal.start + signal.stop)
        return f"{_since(middle)} / {number_text(signal.stop - signal.start)}"
    if isinstance(signal, TimeSince):
        return _since(signal.origin)
    assert isinstance(signal, Always)
    return "1.0"


def _since(instant: float) -> str:
    return f"(time {'-' if instant >= 0 else '+'} {number_text(abs(instant))})"


def _unit(unit: str, more: str = "") -> str:
    """Modifications of a variable with its unit, where Modelica can write it."""
    text = modelica_unit(unit)
    inside = ", ".join(part for part in (f'unit="{text}"' if text else "", more) if part)
    return f"({inside})" if inside else ""


def _in_unit(says: str, unit: str) -> str:
    return says if modelica_unit(unit) else f"{says}; unit {unit}"


def modelica_unit(unit: str) -> str | None:
    """A unit as Modelica writes it: `N.m.s2/rad2`, `kg/(m.s)`; None for a fractional power."""
    powers: Mapping[str, Fraction] = unit_powers(unit)
    if any(p.denominator != 1 for p in powers.values()):
        return None
    above = ".".join(_raised(n, p) for n, p in powers.items() if p > 0) or "1"
    below = [_raised(n, -p) for n, p in powers.items() if p < 0]
    if not below:
        return above
    under = ".".join(below)
    return f"{above}/{under}" if len(below) == 1 else f"{above}/({under})"


def _raised(name: str, power: Fraction) -> str:
    text = {"ohm": "Ohm"}.get(name, name)
    return text if power == 1 else f"{text}{power}"


def _safe(text: str) -> str:
    return re.sub(r"[\n\r]+", " ", text).replace("\\", "/").replace('"', "'")
