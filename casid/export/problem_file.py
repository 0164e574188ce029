"""A fitted model as a problem file: Python that a person would have written.

The causes of a diagnosis are terms like all others. What a sensor or an actuator does to a whole
column is an extension of the model (`casid.time_delay` and its like), as in a file written by hand.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import casadi as ca

from casid.data.files import refuse_existing
from casid.errors import ModelError
from casid.estimation.fitted.fitted_model import FittedModel
from casid.export.naming import checked_path, identifiers, written_by
from casid.export.written_equations import (
    WrittenBalance,
    WrittenEquations,
    clock_names,
    written_equations,
)
from casid.model.clock_signals import ClockSignal
from casid.model.declarations import Input, Parameter, Stage, State
from casid.model.effects.effect import KINDS
from casid.model.effects.names import unsaid
from casid.model.formula_text import PYTHON, number_text
from casid.model.identifiers import docstring_text, quoted
from casid.model.model import Model
from casid.model.units import from_si

_TAKEN = ("ca", "casid", "problem")
_WIDTH = 100
_DIGITS = 9  # of a start: more than any fit determines

_EXTENSIONS = {
    "delay": ("time_delay", "longest"),
    "delay_input": ("time_delay", "longest"),
    "lag": ("sensor_lag", "longest"),
    "filter": ("digital_filter", "longest"),
    "lead_input": ("sensor_lag", "longest"),
    "late_input": ("dead_time", "longest"),
    "lag_input": ("actuator_lag", "longest"),
    "play_input": ("input_backlash", "largest"),
    "rate_input": ("rate_limit", "rate"),
    "clip": ("saturation", "limit"),
}
"""How a stage is written: the function that makes its effect, and the size that it takes."""


def write_problem_file(fitted: FittedModel, path: Path, *, force: bool = False) -> Path:
    """Write `path` (.py), a problem file with the fitted model in it; over another with `force`.

    Raises
    ------
    DataError
        If the file exists and `force` is not set.
    ModelError
        If an input is a function of the user's own.
    """
    path = checked_path(path, "problem")
    refuse_existing(path, force=force)
    path.write_text(problem_text(fitted), encoding="utf-8")
    return path


def problem_text(fitted: FittedModel) -> str:
    """The text of a problem file."""
    return _Writer(fitted.without_noise()).text()


def _without_stages(model: Model) -> Model:
    """The model before stages and blends, which the file adds with the functions that made them.

    A blend that is settled is declared as the hold that it is.
    """
    base = model.copy()
    base.stages = ()
    base.inputs = {
        n: replace(u, hold=model.acting_hold(n), blends=()) for n, u in base.inputs.items()
    }
    for stage in model.stages:
        ends = [end for n in (*stage.carriers, stage.channel) for end in Stage.line_of(n)]
        for name in (*stage.carriers, *ends):
            if stage.is_of_input and name in base.inputs:
                base.substitute_symbol(name, 0)
                del base.inputs[name]
    return base


class _Writer:
    def __init__(self, fitted: FittedModel) -> None:
        self.fitted = fitted
        self.whole = fitted.model
        blends = {b.parameter for u in self.whole.inputs.values() for b in u.blends}
        self.added = {n for s in self.whole.stages for n in s.parameters} | blends
        self.equations: WrittenEquations = written_equations(_without_stages(self.whole))
        self.model: Model = self.equations.model
        self.m = "m" if "m" not in self.model._symbols else "model"
        model = self.model
        parameters = [n for n in model.parameters if n not in self.added]
        names = [*model.states, *model.inputs, *parameters, *self.equations.parts]
        clocks = clock_names(model)
        symbols = identifiers(
            [clocks.get(n, n) for n in names], [*_TAKEN, self.m, *dir(__builtins__)]
        )
        self.names = {n: symbols[clocks.get(n, n)] for n in names}
        for e in self.equations.eliminations:
            self.names.setdefault(e.output, f"measured_{e.output}")
        rates = {f"der_{s}": f"{self.m}.der({self.names[s]})" for s in model.states}
        self.written = self.names | rates
        self.errors = dict(
            zip(fitted.covariance_names, fitted.covariance.diagonal().tolist(), strict=True)
        )

    def text(self) -> str:
        """The whole file."""
        body = [
            *_call_lines(f"{self.m} = casid.Model", [quoted(self._model_name())]),
            "",
            *self._section("States", self._states()),
            *self._section("Inputs", self._inputs()),
            *self._section("Parameters: an estimated one starts at its estimate", self._known()),
            *self._section("What several equations share", self._parts()),
            *self._section("Equations", self._equations()),
            *self._section("Sensors", self._outputs()),
            *self._section(
                "Inputs that are not measured, and the sensors that determine them",
                self._eliminations(),
            ),
            *self._section("What sensors and actuators do to their signals", self._extensions()),
            *self._problem(),
        ]
        code = "\n".join(body) + "\n"
        imports = ["import casadi as ca", ""] if "ca." in code else []
        return "\n".join([*self._docstring(), "", *imports, "import casid", "", code])

    def _model_name(self) -> str:
        """The model's own name, without the kinds of effects that extended it."""
        name, kinds = self.whole.name, {c.kind for c in self.fitted.causes} | KINDS
        while " + " in name and name.rpartition(" + ")[2] in kinds:
            name = name.rpartition(" + ")[0]
        return name

    def _section(self, title: str, lines: Sequence[str]) -> list[str]:
        return [f"# {title}", *lines, ""] if lines else []

    # -- what it is ----------------------------------------------------------------------------

    def _docstring(self) -> list[str]:
        records = ", ".join(r.name for r in self.fitted.records)
        first = f"{self.fitted.name}: a model fitted to {records}."
        if self.fitted.causes:
            first = (
                f"{self.fitted.name}: the model with what a diagnosis found missing in {records}."
            )
        lines = textwrap.wrap(docstring_text(first), _WIDTH - 3)
        lines[0] = f'"""{lines[0]}'
        lines.append("")
        for cause in self.fitted.causes:
            constants = "".join(
                f", {name.replace('_', ' ')} {value:.6g}" for name, value in cause.constants.items()
            )
            description = unsaid(cause.words, cause.description)
            what = f" ({description})" if description else ""
            text = f"{cause.words} [{cause.kind}]{what}: "
            text += f"{', '.join(cause.parameters)}{constants}"
            lines += textwrap.wrap(
                docstring_text(text), _WIDTH, initial_indent="- ", subsequent_indent="  "
            )
        if self.fitted.causes:
            lines.append("")
        lines += [
            f"Written by {written_by()}. Each number is in the unit beside it, expressions and",
            "numbers without a unit in SI.",
            '"""',
        ]
        return lines

    # -- declarations --------------------------------------------------------------------------

    def _call(self, target: str, what: str, *arguments: str, remark: str = "") -> list[str]:
        head = f"{self.m}.{what}"
        return _call_lines(f"{target} = {head}" if target else head, arguments, remark)

    def _number(self, name: str, value: float, *, is_start: bool = False) -> str:
        """An SI value in the declared unit; of a start the digits that mean something."""
        unit = self.whole.declared_units.get(name)
        shown = float(value if unit is None else from_si(value, unit))
        return number_text(float(f"{shown:.{_DIGITS}g}") if is_start or unit else shown)

    def _bounds(self, entry: Parameter | State) -> list[str]:
        return [
            f"{what}={self._number(entry.name, value)}"
            for what, value in (("lower", entry.lower), ("upper", entry.upper))
            if math.isfinite(value)
        ]

    def _states(self) -> list[str]:
        lines = []
        for name, state in self.model.states.items():
            given = [quoted(name), quoted(self.whole.unit_of(name))]
            start = self.fitted.si_initial_states[name]
            if state.initial is not None:
                given.append(f"initial={self._number(name, state.initial)}")
            elif start != 0.0:
                inside = min(max(start, state.lower), state.upper)
                given.append(f"start={self._number(name, inside, is_start=True)}")
            lines += self._call(self.names[name], "state", *given, *self._bounds(state))
        return lines

    def _inputs(self) -> list[str]:
        model, lines = self.model, []
        for name, entry in model.inputs.items():
            unit = quoted(self.whole.unit_of(name) if name in self.whole.inputs else entry.unit)
            lines += self._call(self.names[name], *self._declared_input(entry, unit))
        return lines

    def _declared_input(self, entry: Input, unit: str) -> list[str]:
        """The method that declares an input, and its arguments."""
        name = quoted(entry.name)
        if entry.kind == "unknown":
            return ["unknown_input", name, unit]
        hold = [] if entry.hold == "foh" else [f'hold="{entry.hold}"']
        if entry.kind == "generated":
            signal = entry.signal
            if not isinstance(signal, get_args(ClockSignal)):
                raise ModelError(
                    f"{self.fitted.name}: the input {entry.name!r} is a Python function of time, "
                    "which no file can be written from; make it of casid.StepAt, casid.RampOver or "
                    "casid.TimeSince"
                )
            return ["generated_input", name, unit, f"casid.{signal!r}", *hold]
        known = ["known=True"] if entry.kind == "known" else []
        return ["input", name, unit, *hold, *known]

    def _known(self) -> list[str]:
        lines = []
        for name, p in self.model.parameters.items():
            if name in self.added:
                continue
            unit, value = quoted(self.whole.unit_of(name)), self.fitted.si_values[name]
            variable = self.names[name]
            if p.is_constant:
                number = self._number(name, value)
                lines += self._call(variable, "constant", quoted(name), number, unit)
                continue
            is_free = self._is_estimated(name)
            if is_free:
                inside = min(max(value, p.lower), p.upper)
                size = f"start={self._number(name, inside, is_start=True)}"
            else:
                size = f"value={self._number(name, value)}"
            given = [quoted(name), unit, size, *self._bounds(p)]
            lines += self._call(variable, "parameter", *given, remark=self._remark(name))
        return lines

    def _is_estimated(self, name: str) -> bool:
        return any(n == name or n.startswith(f"{name}@") for n in self.errors)

    def _remark(self, name: str) -> str:
        """The standard error of an estimate, and the cause that a parameter belongs to."""
        said = []
        variance = self.errors.get(name)
        if variance is not None and variance > 0.0:
            unit = self.whole.declared_units.get(name)
            scale = 1.0 if unit is None else float(from_si(1.0, unit) - from_si(0.0, unit))
            said.append(f"std. error {math.sqrt(variance) * scale:.2g}")
        said += [c.words for c in self.fitted.causes if name in c.parameters]
        return ", ".join(said)

    # -- equations -----------------------------------------------------------------------------

    def _formula(self, expression: Any, defined: str = "") -> str:
        """An expression, or the definition of a shared part."""
        return self.equations.formula(expression, PYTHON, self.written, defined)

    def _parts(self) -> list[str]:
        return [
            f"{self.names[name]} = {self._formula(e, name)}"
            for name, e in self.equations.parts.items()
        ]

    def _equations(self) -> list[str]:
        lines: list[str] = []
        for s, e in self.equations.derivatives.items():
            lines += self._call("", "derivative", self.names[s], self._formula(e))
        for balance in self.equations.balances:
            lines += self._balance(balance)
        return lines

    def _balance(self, b: WrittenBalance) -> list[str]:
        lines = [
            f"{self.m}.balance(",
            f"    {self.names[b.rate]},",
            f"    {quoted(b.name)},",
            f"    inertia={self._formula(b.inertia)},",
            "    terms=[",
        ]
        for term in b.terms:
            symbols = {s.name() for s in ca.symvar(term)}
            causes = [c.words for c in self.fitted.causes if symbols & set(c.parameters)]
            line = f"        {self._formula(term)},"
            remark = f"# {', '.join(causes)}, found by the diagnosis" if causes else ""
            is_short = len(f"{line}  {remark}") <= _WIDTH
            if remark and not is_short:
                lines.append(f"        {remark}")
            lines.append(f"{line}  {remark}" if remark and is_short else line)
        return [*lines, "    ],", f"    unit={quoted(b.shown_unit)},", ")"]

    def _outputs(self) -> list[str]:
        lines: list[str] = []
        for n, e in self.equations.outputs.items():
            unit = quoted(self.whole.unit_of(n))
            lines += self._call("", "output", quoted(n), self._formula(e), unit)
        return lines

    def _eliminations(self) -> list[str]:
        lines = []
        for e in self.equations.eliminations:
            given = [quoted(e.unknown), f"using={quoted(e.output)}"]
            if e.solution is not None:
                symbol = self.names[e.output]
                if symbol in self._formula(e.solution):
                    lines.append(f"{symbol} = {self.m}.eliminated_symbol({quoted(e.output)})")
                given.append(f"solution={self._formula(e.solution)}")
            given += [] if e.hold == "foh" else [f'hold="{e.hold}"']
            lines += self._call(self.m, "eliminate", *given)
        return lines

    # -- stages and blends ---------------------------------------------------------------------

    def _extensions(self) -> list[str]:
        lines: list[str] = []
        for name, entry in self.whole.inputs.items():
            if entry.kind == "generated" or self.whole.acting_hold(name) != entry.hold:
                continue
            for blend in entry.blends:
                hold = f"{quoted(name)}, {quoted(blend.toward)}"
                lines += self._extended(f"casid.hold({self.m}, {hold})", blend.parameter)
        shared: dict[str, list[Stage]] = {}
        for stage in self.whole.stages:
            shared.setdefault(stage.parameter, []).append(stage)
        for stage, *others in shared.values():
            function, size = _EXTENSIONS[stage.kind]
            p = self.whole.parameters[stage.parameter]
            largest = p.upper if size == "longest" else self.fitted.si_values[p.name]
            number = f"{largest:.3g}" if size == "longest" else self._number(p.name, largest)
            number = f"{largest:.9g}" if size == "rate" else number  # SI, whatever the channel
            channel = ", ".join(quoted(s.channel) for s in (stage, *others))
            channel = f"[{channel}]" if others else channel
            begins = f", begins={stage.begins:g}" if stage.begins else ""
            made = f"casid.{function}({self.m}, {channel}, {size}={number}{begins})"
            lines += self._extended(made, stage.parameter)
            if stage.share:
                lines += self._valued(stage.share, is_free=False)
        return lines

    def _extended(self, effect: str, name: str) -> Iterator[str]:
        """A line that adds an effect, and one that gives its parameter its value."""
        yield from self._call(self.m, "extend", effect, remark=self._remark(name))
        yield from self._valued(name, is_free=self._is_estimated(name))

    def _valued(self, name: str, *, is_free: bool) -> Iterator[str]:
        """The line that gives a parameter its value, or its start where it is free."""
        value = self.fitted.si_values[name]
        how = "with_unknown" if is_free else "with_known"
        number = self._number(name, value, is_start=is_free)
        if name.isidentifier():
            yield f"{self.m} = {self.m}.{how}({name}={number})"
        else:
            yield f"{self.m} = {self.m}.{how}(**{{{quoted(name)}: {number}}})"

    # -- the problem ---------------------------------------------------------------------------

    def _problem(self) -> list[str]:
        channels = self.fitted.channels
        inputs = set(self.whole.inputs)
        recorded = {n: u for n, u in channels.recorded.items() if n not in inputs}
        lines = [
            f"# {name} was computed ({how}): copy its derived= from the problem that was fitted"
            for name, how in channels.derived.items()
        ]
        lines += [
            "problem = casid.Problem(",
            f"    name={quoted(self.fitted.name)},",
            f"    model={self.m},",
        ]
        for what, table in (("channels", channels.columns), ("recorded", recorded)):
            if table:
                rows = [f"{quoted(k)}: {quoted(v)}" for k, v in table.items()]
                lines += _braced(what, rows)
        if channels.time:
            lines.append(f"    time={quoted(channels.time)},")
        if channels.form is not None and channels.form.given:
            lines.append(f"    form={channels.form.code},")
        cases = self._load_cases()
        if cases:
            lines += _braced("load_cases", cases)
        return [*lines, ")"]

    def _load_cases(self) -> list[str]:
        """The values known in each record, by the load case in front of its name."""
        found: dict[str, str] = {}
        for record in self.fitted.records:
            known = {n: v for n, v in record.known.items() if n in self.whole.parameters}
            if known:
                values = ", ".join(f"{quoted(n)}: {self._number(n, v)}" for n, v in known.items())
                found[record.name.partition(":")[0]] = f"{{{values}}}"
        return [f"{quoted(case)}: {values}" for case, values in found.items()]


def _call_lines(head: str, arguments: Sequence[str], remark: str = "") -> list[str]:
    """A call on one line, or on several where it is long; the remark behind it, or above."""
    line = f"{head}({', '.join(arguments)})"
    if len(line) <= _WIDTH:
        if not remark:
            return [line]
        both = f"{line}  # {remark}"
        return [both] if len(both) <= _WIDTH else [f"# {remark}", line]
    inside = f"    {', '.join(arguments)}"
    lines = [inside] if len(inside) <= _WIDTH else [f"    {a}," for a in arguments]
    return [*([f"# {remark}"] if remark else []), f"{head}(", *lines, ")"]


def _braced(name: str, rows: Sequence[str]) -> list[str]:
    """A dictionary among the arguments of a call."""
    line = f"    {name}={{{', '.join(rows)}}},"
    if len(line) <= _WIDTH:
        return [line]
    return [f"    {name}={{", *(f"        {row}," for row in rows), "    },"]
