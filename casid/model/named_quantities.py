"""Quantities declared by name, each with a unit: states, inputs and parameters of a model.

Numbers are given in the unit beside them and kept in SI; `NamedQuantities.declared_units` remembers
each unit that was declared and is not SI.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Literal

import casadi as ca
import numpy as np

from casid.argument_types import methods_name_wrong_types
from casid.errors import ModelError, nearest, require_texts
from casid.model.declarations import (
    Expr,
    Hold,
    Input,
    Parameter,
    State,
    checked_hold,
    symbol_name,
)
from casid.model.declared_units import numbers_in_si, quantity_of, si_text
from casid.model.explicit_form import Explicit
from casid.model.units import difference_from_si, from_si, is_si, to_si, unit_quotient


@methods_name_wrong_types(ModelError)
class NamedQuantities:
    """States, inputs and parameters with their symbols and units, and numbers in those units."""

    def __init__(self, name: str) -> None:
        require_texts("the model", name=[name])
        self.name = name
        self.states: dict[str, State] = {}
        self.inputs: dict[str, Input] = {}
        self.parameters: dict[str, Parameter] = {}
        self.outputs: dict[str, tuple[Expr, str]] = {}
        self._symbols: dict[str, Any] = {}
        self._derivatives: dict[str, Any] = {}  # state -> symbol of its derivative
        self.eliminated_units: dict[str, str] = {}
        self.declared_units: dict[str, str] = {}  # name -> unit, where it is not SI
        self.takes_si = False  # True inside the library: numbers given by name are in SI
        self._explicit: Explicit | None = None

    def state(
        self,
        name: str,
        unit: str,
        *,
        start: float = 0.0,
        lower: float = -np.inf,
        upper: float = np.inf,
        initial: float | None = None,
    ) -> Any:
        """Declare a state; `start` is where its estimated initial value starts, in `unit`.

        `initial` fixes the initial value instead. A model of which every state is fixed, and rests
        there under one value of an input whatever its parameters, had that value before the record:
        to an input that acts late or lags, and to a sensor that does.
        """
        require_texts(f"{self.name}: state {name!r}", name=[name])
        declared = State(name, unit, start, lower, upper, initial)
        self._remember_unit(name, unit)
        self.states[name] = numbers_in_si(declared, ("start", "lower", "upper", "initial"))
        self._derivatives[name] = ca.SX.sym(f"der_{name}")
        return self._declare(name)

    def input(self, name: str, unit: str, *, hold: Hold = "foh", known: bool = False) -> Any:
        """Declare an input that is recorded: measured (with noise), or known without noise.

        `known` says that the record has no noise and no sensor: it is a command, and what errs is
        what it acts through. Its gain, its dead time, a lag or a limit of the actuator, and a zero
        beside its own are tested by a diagnosis all the same; where its bias is just a constant
        term of one balance or output, that is named.

        `hold` is what the signal does between samples: ``"zoh"`` for a held command, ``"foh"``
        (straight lines) for a sampled physical quantity, ``"bandlimited"`` for one that was
        filtered before it was sampled and holds nothing above half the sampling rate: its course
        between the samples is then determined by all of them (Shannon 1949).
        """
        kind: Literal["known", "measured"] = "known" if known else "measured"
        hold = checked_hold(name, hold)
        self.inputs[name] = Input(name, self._remember_unit(name, unit), kind, hold)
        return self._declare(name)

    def acting_hold(self, name: str) -> Hold:
        """What a recorded input does between its samples: as declared, or as a blend of one has it.

        A blend whose parameter can be nothing but 1 is settled: the input does what it says.
        """
        entry = self.inputs[name]
        for blend in entry.blends:
            p = self.parameters[blend.parameter]
            if p.value == 1.0 or (p.value is None and p.lower == p.upper == 1.0):
                return blend.toward
        return entry.hold

    def unknown_input(self, name: str, unit: str) -> Any:
        """Declare an input that nobody measures; `eliminate` it before estimating."""
        self.inputs[name] = Input(name, self._remember_unit(name, unit), "unknown")
        return self._declare(name)

    def generated_input(
        self,
        name: str,
        unit: str,
        signal: Callable[[np.ndarray[Any, Any]], np.ndarray[Any, Any]],
        *,
        hold: Hold = "foh",
    ) -> Any:
        """Declare an input that is a function of the record's clock, as `casid.StepAt(12.5)`.

        `signal` is called with the times (N,) [s] and returns the samples (N,), SI units. What
        depends on the clock of one record says nothing of another: in a record that is held out
        as a whole, and is no window of a fitted record or its file, the signal is zero.
        """
        self.inputs[name] = Input(name, unit, "generated", hold, signal)
        return self._declare(name)

    def parameter(
        self,
        name: str,
        unit: str,
        *,
        start: float | None = None,
        lower: float = -np.inf,
        upper: float = np.inf,
        value: float | None = None,
    ) -> Any:
        """Declare a parameter: known where `value` is given, else estimated from `start`.

        All numbers are in `unit`. Default start: 1, or the bound nearest to it.
        """
        if start is None:
            start = value if value is not None else float(np.clip(1.0, lower, upper))
        return self.add_parameter(Parameter(name, unit, start, lower, upper, value))

    def constant(self, name: str, value: float, unit: str) -> Any:
        """Declare a constant of nature or geometry: known, and no diagnosis suspects it to move.

        `value` is in `unit`.
        """
        if isinstance(value, str) and isinstance(unit, int | float):
            raise ModelError(
                f"{self.name}: {name!r}: value {value!r} and unit {unit!r} seem to be swapped; "
                f"write constant({name!r}, {unit!r}, {value!r})"
            )
        return self.add_parameter(Parameter(name, unit, value, value=value, is_constant=True))

    def symbol(self, name: str) -> Any:
        """The CasADi symbol of a state, input or parameter."""
        try:
            return self._symbols[name]
        except KeyError:
            hint = nearest(name, self._symbols)
            raise ModelError(f"{self.name} has no {name!r}{hint}") from None

    def unit_of(self, name: str) -> str:
        """The unit that a state, input, output or parameter was declared in."""
        if name in self.declared_units:
            return self.declared_units[name]
        if name in self.outputs:
            return self.outputs[name][1]
        for kind in (self.parameters, self.inputs, self.states):
            if name in kind:
                return str(kind[name].unit)
        self.symbol(name)  # names the nearest, where there is none
        return self.eliminated_units[name]

    @property
    def symbol_units(self) -> dict[str, str]:
        """Symbol -> SI unit: states, their derivatives (`der_x`), inputs and parameters."""
        units = {n: s.unit for n, s in self.states.items()}
        units |= {f"der_{n}": unit_quotient(s.unit, "s") for n, s in self.states.items()}
        units |= {n: u.unit for n, u in self.inputs.items()} | self.eliminated_units
        return units | {n: p.unit for n, p in self.parameters.items()}

    def in_si(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values by name in SI, given in the units that the model was declared in.

        An initial state is named by its state, with or without `(0)`.
        """
        return {n: self._converted(n, v, to_si) for n, v in values.items()}

    def in_declared_units(self, values: Mapping[str, float]) -> dict[str, float]:
        """SI values by name in the units that the model was declared in."""
        return {n: self._converted(n, v, from_si) for n, v in values.items()}

    def _converted(self, name: str, value: float, convert: Callable[..., Any]) -> float:
        unit = self.declared_units.get(quantity_of(name))
        return value if unit is None or self.takes_si else float(convert(value, unit))

    def shown(self, name: str, value: float) -> float:
        """An SI value of a parameter, state, input or output in the unit that it declares."""
        return float(from_si(value, self.unit_of(name)))

    def shown_size(self, name: str, size: float) -> float:
        """An SI difference, RMS error or standard deviation in the unit that `name` declares."""
        return float(difference_from_si(size, self.unit_of(name)))

    def parameter_named(self, name: str) -> Parameter:
        """The parameter called `name`, or an error that names the nearest."""
        if name not in self.parameters:
            raise ModelError(
                f"{self.name} has no parameter {name!r}{nearest(name, self.parameters)}"
            )
        return self.parameters[name]

    @property
    def nominal_values(self) -> dict[str, float]:
        """Parameter -> SI value: known, or where its estimate starts."""
        return {name: p.nominal for name, p in self.parameters.items()}

    def add_input(self, entry: Input) -> Any:
        """Add an input, its unit remembered as that of a declared one (used by effects)."""
        if entry.name in self.inputs:
            return self._symbols[entry.name]
        self.inputs[entry.name] = replace(entry, unit=self._remember_unit(entry.name, entry.unit))
        return self._declare(entry.name)

    def add_parameter(self, entry: Parameter) -> Any:
        """Add a parameter, its numbers in its own unit (used by effects on their own copy)."""
        symbol = self._declare(entry.name)
        self._remember_unit(entry.name, entry.unit)
        self.parameters[entry.name] = numbers_in_si(entry, ("start", "lower", "upper", "value"))
        return symbol

    def free_name(self, wanted: str) -> str:
        """`wanted`, or `wanted` with a number where the name is taken."""
        name, n = wanted, 2
        while name in self._symbols:
            name, n = f"{wanted}_{n}", n + 1
        return name

    def _declare(self, name: str) -> Any:
        require_texts(f"{self.name}: {name!r}", name=[name])
        if name in self._symbols:
            raise ModelError(f"{self.name}: {name!r} declared twice; give it another name")
        self._symbols[name] = ca.SX.sym(name)
        self._explicit = None
        return self._symbols[name]

    def _remember_unit(self, name: str, unit: str) -> str:
        """The SI text of a declared unit, which is remembered where it is another."""
        require_texts(f"{self.name}: {name!r}", unit=[unit])
        if not is_si(unit):
            self.declared_units[name] = unit
        return si_text(unit)

    def _state_name(self, state: Any) -> str:
        name = symbol_name(f"{self.name}: state", state)
        if name not in self.states:
            rate = (
                "; the rate of an input is an input of its own, recorded or computed from it "
                "(Problem(derived=...))"
            )
            raise ModelError(
                f"{self.name}: {name!r} is not a state; states are {', '.join(self.states)}"
                + (rate if name in self.inputs else "")
            )
        return name
