"""The model: states, inputs, outputs and parameters with units, and balances with names.

A model is written once, as CasADi expressions. It is a set of equations linear in the state
derivatives and in every eliminated input, so one symbolic linear solve gives

    dx/dt = f(x, u, theta),    y = h(x, u, theta)                                           (1)

and eliminating an unknown input is adding one equation (the output that feels it) and one unknown:
the indirect model of Linder (2017, ch. 4), for gains that may depend on the state.

Numbers are given in the unit beside them and kept in SI; `Model.declared_units` remembers each unit
that was declared and is not SI. Expressions are between SI quantities: an angle declared in deg is
in rad wherever its symbol is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol, get_args

import casadi as ca
import numpy as np

from casid.errors import ModelError, nearest
from casid.model.declared_units import (
    common_unit,
    numbers_in_si,
    quantity_of,
    refuse_conversion,
    si_text,
)
from casid.model.serialisation import packed, unpacked
from casid.model.units import (
    difference_from_si,
    from_si,
    is_si,
    same_dimension,
    to_si,
    unit_quotient,
)
from casid.presentation import Viewed

Expr = Any  # a CasADi SX expression, or a number where one is meant
Hold = Literal["zoh", "foh", "bandlimited"]
HOLDS: tuple[Hold, ...] = get_args(Hold)
"""What a recorded signal may do between its samples."""


class Extension(Protocol):
    """What a model can be extended with: a `casid.Effect`."""

    def extend(self, model: Model) -> Model:
        """A copy of the model that holds it."""
        ...


@dataclass(frozen=True, slots=True)
class Parameter:
    """A physical parameter: unknown with a start and bounds, or known with a value (SI units)."""

    name: str
    unit: str
    start: float = 1.0
    lower: float = -np.inf
    upper: float = np.inf
    value: float | None = None
    is_constant: bool = False  # of nature or of geometry: no effect ever moves it

    def __post_init__(self) -> None:
        if self.lower > self.upper:
            raise ModelError(
                f"parameter {self.name}: lower bound {self.lower:g} lies above the upper bound "
                f"{self.upper:g}; exchange them"
            )
        if self.value is None and not self.lower <= self.start <= self.upper:
            raise ModelError(
                f"parameter {self.name}: start {self.start:g} lies outside its bounds "
                f"[{self.lower:g}, {self.upper:g}]; move the start inside or widen the bounds"
            )

    @property
    def is_known(self) -> bool:
        """True if the parameter has a value and is not estimated."""
        return self.value is not None


@dataclass(frozen=True, slots=True)
class State:
    """A state: its initial value is estimated from `start`, unless it is known. SI units."""

    name: str
    unit: str
    start: float = 0.0
    lower: float = -np.inf
    upper: float = np.inf
    initial: float | None = None


@dataclass(frozen=True, slots=True)
class Blend:
    """A parameter b in [0, 1] that moves an input towards another hold: all of it at b = 1."""

    parameter: str
    toward: Hold


@dataclass(frozen=True, slots=True)
class Input:
    """An input: a recorded channel, an unknown signal, or a generated function of time.

    Between its samples the signal is what `hold` says, u, plus b (w - u) for each of the `blends`,
    of parameter b towards a hold that gives w.
    """

    name: str
    unit: str
    kind: Literal["measured", "known", "unknown", "generated"] = "measured"
    hold: Hold = "foh"
    signal: Callable[[np.ndarray[Any, Any]], np.ndarray[Any, Any]] | None = None
    blends: tuple[Blend, ...] = ()

    @property
    def holds(self) -> frozenset[Hold]:
        """Every hold that the signal is a part of."""
        return frozenset({self.hold, *(b.toward for b in self.blends)})


@dataclass(frozen=True, slots=True)
class Balance:
    """A named force or torque balance: inertia * d(rate)/dt = sum of terms."""

    name: str
    rate: str
    inertia: Expr
    terms: tuple[Expr, ...]
    unit: str


@dataclass(frozen=True, slots=True)
class Stage:
    """What a sensor or an actuator does to its channel, beyond an expression.

    An output may be late (`delay`), pass a first-order lag (`lag`) or be clipped (`clip`). Of an
    input what acted is found: the recorded column moved ahead (`delay_input`), rid of its sensor's
    lag (`lead_input`), or sent through an actuator's lag (`lag_input`) or play (`play_input`). The
    column is prepared before the simulation; `carrier` is the generated input that brings its
    change with `parameter` into the sensitivities.
    """

    kind: Literal["delay", "lag", "clip", "delay_input", "lead_input", "lag_input", "play_input"]
    channel: str
    parameter: str

    @property
    def is_of_input(self) -> bool:
        """True if the stage prepares an input column."""
        return self.kind.endswith("_input")

    @property
    def carrier(self) -> str:
        """Name of the input that carries the tangent of an input stage."""
        if self.kind == "delay_input":
            return f"slope of {self.channel}"
        return f"change of {self.channel} with {self.parameter}"

    @staticmethod
    def line_of(channel: str) -> tuple[str, str]:
        """Names of the inputs that say where a lagged input's line in a sample begins and ends."""
        return f"start of {channel}", f"end of {channel}"


_SENSED: Mapping[str, Literal["delay", "lag"]] = {"delay_input": "delay", "lead_input": "lag"}
"""What the stages of a measured input are, once it is an output again."""


@dataclass(frozen=True, slots=True)
class _Measured:
    """What an elimination took away: the unknown input, and the output it was eliminated with."""

    unknown: Input
    output: str
    residual: Expr  # 0 = output's expression - its measured symbol, before any branch was chosen
    input_place: int
    output_place: int


@dataclass(frozen=True, slots=True)
class Explicit:
    """The model as (1): SX right-hand sides and outputs, and the symbols they are made of."""

    x: Any
    u: Any
    p: Any
    f: Any
    h: Any
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    eliminated: Mapping[str, Any] = field(default_factory=dict)


class Model(Viewed):
    """A physical model under construction.

    Example
    -------
    >>> m = Model("mass on a spring")
    >>> x, v = m.state("x", "m"), m.state("v", "m/s")
    >>> F = m.input("F", "N")
    >>> k, d, M = m.parameter("k", "N/m"), m.parameter("d", "N s/m"), m.parameter("M", "kg")
    >>> m.derivative(x, v)
    >>> m.balance(v, "force", inertia=M, terms=[-k * x, -d * v, F])
    >>> _ = m.output("position", x, "m")
    >>> m
    <Model mass on a spring: 2 states, 1 input, 1 output, 3 parameters (3 unknown)>
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.states: dict[str, State] = {}
        self.inputs: dict[str, Input] = {}
        self.parameters: dict[str, Parameter] = {}
        self.balances: dict[str, Balance] = {}
        self.outputs: dict[str, tuple[Expr, str]] = {}
        self.stages: tuple[Stage, ...] = ()
        self._symbols: dict[str, Any] = {}
        self._derivatives: dict[str, Any] = {}  # state -> symbol of its derivative
        self._rates: dict[str, Expr] = {}  # state -> explicit right-hand side
        self._eliminations: list[tuple[str, str, Expr]] = []  # (unknown, equation's name, residual)
        self._measured: list[_Measured] = []  # what each elimination took away, in that order
        self.eliminated_units: dict[str, str] = {}
        self.declared_units: dict[str, str] = {}  # name -> unit, where it is not SI
        self.takes_si = False  # True inside the library: numbers given by name are in SI
        self._explicit: Explicit | None = None

    # -- declaring ---------------------------------------------------------------------------

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

        `initial` fixes the initial value instead.
        """
        declared = State(name, unit, start, lower, upper, initial)
        self._remember_unit(name, unit)
        self.states[name] = numbers_in_si(declared, ("start", "lower", "upper", "initial"))
        self._derivatives[name] = ca.SX.sym(f"der_{name}")
        return self._declare(name)

    def input(self, name: str, unit: str, *, hold: Hold = "foh", known: bool = False) -> Any:
        """Declare an input that is recorded: measured (with noise), or exactly known.

        `hold` is what the signal does between samples: ``"zoh"`` for a held command, ``"foh"``
        (straight lines) for a sampled physical quantity, ``"bandlimited"`` for one that was
        filtered before it was sampled and holds nothing above half the sampling rate: its course
        between the samples is then determined by all of them (Shannon 1949).
        """
        if hold not in HOLDS:
            raise ModelError(
                f"input {name}: hold={hold!r} is not known; use 'zoh', 'foh' or 'bandlimited'"
            )
        kind: Literal["known", "measured"] = "known" if known else "measured"
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
        as a whole the signal is zero.
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
        return self.add_parameter(Parameter(name, unit, value, value=value, is_constant=True))

    def der(self, state: Any) -> Any:
        """The time derivative of a state, for use in balances and outputs."""
        return self._derivatives[self._state_name(state)]

    def derivative(self, state: Any, expression: Expr) -> None:
        """State that d(state)/dt = expression."""
        name = self._state_name(state)
        self._once(name)
        self._rates[name] = ca.SX(expression)
        self._explicit = None

    def balance(
        self,
        rate: Any,
        name: str,
        *,
        inertia: Expr,
        terms: Sequence[Expr],
        unit: str | None = None,
    ) -> None:
        """State that inertia * d(rate)/dt = sum(terms); missing effects enter such balances.

        `unit` of the terms, any of their dimension; by default that which most terms
        and inertia times d(rate)/dt have.
        """
        state = self._state_name(rate)
        self._once(state)
        if name in self.balances:
            raise ModelError(f"{self.name}: balance {name!r} stated twice; give it another name")
        terms = tuple(ca.SX(t) for t in terms)
        if unit is None:
            unit = self._balance_unit(state, ca.SX(inertia), terms)
        self.balances[name] = Balance(name, state, ca.SX(inertia), terms, si_text(unit))
        self._explicit = None

    def output(self, name: str, expression: Expr, unit: str) -> Any:
        """Declare what a sensor measures, shown in `unit`; returns the expression.

        The expression is in SI: `output("angle", phi, "deg")`, without a factor 180/pi.

        Raises
        ------
        ModelError
            If the channel exists already, or the expression converts to `unit` itself.
        """
        if name in self.outputs or name in self.inputs:
            raise ModelError(f"{self.name}: channel {name!r} declared twice; give it another name")
        expression = ca.SX(expression)
        refuse_conversion(self.name, name, expression, unit)
        self.outputs[name] = (expression, self._remember_unit(name, unit))
        self._explicit = None
        return self.outputs[name][0]

    def symbol(self, name: str) -> Any:
        """The CasADi symbol of a state, input or parameter."""
        try:
            return self._symbols[name]
        except KeyError:
            hint = nearest(name, self._symbols)
            raise ModelError(f"{self.name} has no {name!r}{hint}") from None

    # -- deriving ----------------------------------------------------------------------------

    def eliminate(self, unknown: Any, using: str, *, solution: Expr | None = None) -> Model:
        """Solve the output `using` for an unknown input and substitute it (the indirect model).

        The output becomes a measured input of the same name. Where the output is not linear in
        the unknown input the solution is not unique: give the branch as `solution`, an expression
        of states, inputs, parameters and the symbol of the output (see `eliminated_symbol`).

        Raises
        ------
        ModelError
            If the output does not feel the input, or the branch is missing or wrong.

        Source: Linder (2017), sections 4.2 and 7.3, (7.24) for the pendulum.
        """
        name = unknown if isinstance(unknown, str) else unknown.name()
        if name not in self.inputs or self.inputs[name].kind != "unknown":
            raise ModelError(
                f"{self.name}: {name!r} is not an unknown input; declare it with unknown_input"
            )
        if using not in self.outputs:
            raise ModelError(
                f"{self.name}: no output {using!r} to eliminate {name} with"
                f"{nearest(using, self.outputs)}"
            )
        new = self._copy(self.name)
        places = list(self.inputs).index(name), list(self.outputs).index(using)
        expression, unit = new.outputs.pop(using)
        measured = self.eliminated_symbol(using)
        residual = expression - measured
        if solution is not None:
            residual = self._symbols[name] - ca.SX(solution)
            self._check_branch(expression, measured, name, ca.SX(solution), using)
        new._symbols[using] = measured
        new._measured.append(_Measured(new.inputs[name], using, expression - measured, *places))
        new.eliminated_units[name] = new.inputs.pop(name).unit
        new.inputs[using] = Input(using, unit, "measured", "foh")
        new._eliminations.append((name, using, residual))
        new.explicit()  # refuse here, where the user can correct it
        return new

    def direct(self) -> Model:
        """This model with every elimination undone: unknown inputs and their outputs are back.

        The direct model has as its inputs what acts on the system, unknown inputs among them, and
        as an output each channel that an unknown input was eliminated with. Effects that came
        later stay: a bias of the input `accel` becomes the bias of the output `accel`.

        Raises
        ------
        ModelError
            If an effect made an equation depend nonlinearly on an eliminated channel.

        Source: Linder (2017), (4.1)-(4.4), (7.10) for the pendulum.
        """
        new = self._copy(self.name)
        new._eliminations, new._measured, new.eliminated_units = [], [], {}
        kept = list(self._measured)
        while kept:
            gone = kept.pop()
            measured, residual = self._symbols[gone.output], gone.residual
            for stage in new.stages:
                if stage.channel == gone.output and stage.kind in _SENSED:
                    # The output itself is late now; what carried the tangent goes.
                    residual = ca.substitute(residual, self._symbols[stage.carrier], 0)
                    del new.inputs[stage.carrier]
                    late = replace(stage, kind=_SENSED[stage.kind])
                    new.stages = tuple(late if s is stage else s for s in new.stages)
            for blend in new.inputs[gone.output].blends:
                # An output has no course between its samples: the blend has nothing left to do.
                p = new.parameters[blend.parameter]
                value = p.start if p.value is None else p.value
                new.parameters[blend.parameter] = replace(p, value=value)
            slope_of = ca.jacobian(residual, measured)
            if any(ca.which_depends(slope_of, measured)) or slope_of.nnz() == 0:
                raise ModelError(
                    f"{self.name}: {gone.output} enters its own equation nonlinearly, so it has "
                    "no direct model; call direct() before that effect extends the model"
                )
            expression = -ca.substitute(residual, measured, 0) / slope_of
            if slope_of.is_constant() and float(slope_of) == -1.0:
                expression = ca.substitute(residual, measured, 0)
            unit = new.inputs.pop(gone.output).unit
            new._swap(measured, expression)
            for i, k in enumerate(kept):
                kept[i] = replace(k, residual=ca.substitute(k.residual, measured, expression))
            new.inputs = _inserted(new.inputs, gone.input_place, gone.unknown.name, gone.unknown)
            new.outputs = _inserted(new.outputs, gone.output_place, gone.output, (expression, unit))
        new._explicit = None
        return new

    def eliminated_symbol(self, output: str) -> Any:
        """The symbol that `output` gets when an unknown input is eliminated with it."""
        if output not in self._symbols:
            self._symbols[output] = ca.SX.sym(output)
        return self._symbols[output]

    def extend(self, effect: Extension) -> Model:
        """A copy of this model with `effect` in it; the effect's parameters start at null."""
        return effect.extend(self)

    def with_known(self, **values: float) -> Model:
        """A copy in which the named parameters are known, each in the unit it was declared in."""
        return self.with_si_values(self.in_si(values))

    def with_si_values(self, values: Mapping[str, float]) -> Model:
        """A copy in which the named parameters are known; values in SI."""
        new = self._copy(self.name)
        for name, value in values.items():
            self.parameter_named(name)
            new.parameters[name] = replace(new.parameters[name], value=float(value))
        return new

    def with_unknown(self, *names: str, **starts: float) -> Model:
        """A copy in which the named parameters are estimated (again), from the given starts.

        Starts are in the units that the parameters were declared in.
        """
        new = self._copy(self.name)
        given = self.in_si(starts)
        for name in (*names, *starts):
            old = self.parameter_named(name)
            start = given.get(name, old.value if old.value is not None else old.start)
            new.parameters[name] = replace(old, value=None, start=float(start))
        return new

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

    def taking_si(self, yes: bool = True) -> Model:
        """A copy whose methods take numbers by name in SI, as the library's own calls do."""
        new = self._copy(self.name)
        new.takes_si = yes
        return new

    def parameter_named(self, name: str) -> Parameter:
        """The parameter called `name`, or an error that names the nearest."""
        if name not in self.parameters:
            raise ModelError(
                f"{self.name} has no parameter {name!r}{nearest(name, self.parameters)}"
            )
        return self.parameters[name]

    # -- what effects are made of ------------------------------------------------------------

    def add_term(self, balance: str, term: Expr) -> None:
        """Add a term to a balance (used by effects on their own copy)."""
        old = self.balances[balance]
        self.balances[balance] = replace(old, terms=(*old.terms, ca.SX(term)))
        self._explicit = None

    def add_rate(self, state: str, rate: Expr) -> None:
        """Add to the stated derivative of a state (used by effects on their own copy)."""
        self._rates[state] = self._rates[state] + ca.SX(rate)
        self._explicit = None

    def replace_output(self, name: str, expression: Expr, unit: str) -> None:
        """Give an output another expression (used by effects on their own copy)."""
        self.outputs[name] = (ca.SX(expression), unit)
        self._explicit = None

    def add_input(self, entry: Input) -> Any:
        """Add an input (used by effects on their own copy)."""
        if entry.name in self.inputs:
            return self._symbols[entry.name]
        self.inputs[entry.name] = entry
        return self._declare(entry.name)

    def add_parameter(self, entry: Parameter) -> Any:
        """Add a parameter, its numbers in its own unit (used by effects on their own copy)."""
        symbol = self._declare(entry.name)
        self._remember_unit(entry.name, entry.unit)
        self.parameters[entry.name] = numbers_in_si(entry, ("start", "lower", "upper", "value"))
        return symbol

    def substitute_symbol(self, name: str, expression: Expr) -> None:
        """Replace a parameter or input by an expression wherever it occurs (used by effects)."""
        self._swap(self._symbols[name], expression)

    def _swap(self, old: Any, expression: Expr) -> None:
        stated = [t for b in self.balances.values() for t in (b.inertia, *b.terms)]
        stated += [*self._rates.values(), *(e for e, _ in self.outputs.values())]
        stated += [r for _, _, r in self._eliminations]
        stated += [m.residual for m in self._measured]
        # All in one call: it costs the same for many expressions as for one.
        stated = [e if isinstance(e, ca.SX) else ca.SX(e) for e in stated]
        new = iter(ca.substitute(stated, [old], [ca.SX(expression)]))
        self.balances = {
            key: replace(b, inertia=next(new), terms=tuple(next(new) for _ in b.terms))
            for key, b in self.balances.items()
        }
        self._rates = {key: next(new) for key in self._rates}
        self.outputs = {key: (next(new), unit) for key, (_, unit) in self.outputs.items()}
        self._eliminations = [(w, y, next(new)) for w, y, _ in self._eliminations]
        self._measured = [replace(m, residual=next(new)) for m in self._measured]
        self._explicit = None

    def free_name(self, wanted: str) -> str:
        """`wanted`, or `wanted` with a number where the name is taken."""
        name, n = wanted, 2
        while name in self._symbols:
            name, n = f"{wanted}_{n}", n + 1
        return name

    def position_of(self, rate: str) -> str | None:
        """The state whose derivative is the state `rate`, if there is one."""
        for name, expression in self._rates.items():
            if ca.is_equal(expression, self._symbols[rate], 2):
                return name
        return None

    # -- the equations -----------------------------------------------------------------------

    def equations(self) -> list[tuple[str, Expr, str]]:
        """All equations as (name, residual = 0, unknown it is solved for)."""
        rows: list[tuple[str, Expr, str]] = []
        for name in self.states:
            if name in self._rates:
                rows.append((f"d{name}/dt", self._derivatives[name] - self._rates[name], name))
        for b in self.balances.values():
            total = sum(b.terms[1:], b.terms[0])
            rows.append((b.name, b.inertia * self._derivatives[b.rate] - total, b.rate))
        rows += [(f"{y} = ...", residual, w) for w, y, residual in self._eliminations]
        return rows

    def explicit(self) -> Explicit:
        """Solve the equations for the derivatives and the eliminated inputs, once.

        Raises
        ------
        ModelError
            If a state has no equation, the equations are singular, or not linear in an unknown.
        """
        if self._explicit is None:
            self._explicit = self._solve()
        return self._explicit

    def _solve(self) -> Explicit:
        stated = set(self._rates) | {b.rate for b in self.balances.values()}
        lacking = [s for s in self.states if s not in stated]
        if lacking:
            raise ModelError(
                f"{self.name}: state {lacking[0]} has no equation; state one with "
                f"derivative({lacking[0]}, ...) or balance({lacking[0]}, ...)"
            )
        # Eliminated inputs come first, each solved from its own output: no needless divisors.
        eliminated = [w for w, _, _ in self._eliminations]
        if not self.states and not eliminated:
            raise ModelError(
                f"{self.name} has no state, so there is nothing to simulate; fit a static relation "
                "with casid.regress, or declare a state"
            )
        rows = self.equations()
        rows = rows[len(rows) - len(eliminated) :] + rows[: len(rows) - len(eliminated)]
        z = ca.vertcat(
            *[self._symbols[w] for w in eliminated], *[self._derivatives[s] for s in self.states]
        )
        residual = ca.vertcat(*[r for _, r, _ in rows])
        matrix = ca.jacobian(residual, z)
        nonlinear = [
            str(z[j]) for j in range(z.numel()) if any(ca.which_depends(ca.vec(matrix), z[j]))
        ]
        if nonlinear:
            raise ModelError(
                f"{self.name}: the equations are not linear in {', '.join(nonlinear)}, so the "
                "solution is not unique; give the branch, eliminate(..., solution=expression)"
            )
        rhs = -ca.substitute(residual, z, ca.SX.zeros(z.numel()))
        symbols = [str(z[j]) for j in range(z.numel())]
        values = _linear_solve(matrix, rhs, self.name, symbols, len(eliminated))
        nw = len(eliminated)
        h = ca.vertcat(*[e for e, _ in self.outputs.values()]) if self.outputs else ca.SX(0, 1)
        # der() and eliminated inputs stand in the outputs: put their solutions there.
        h = ca.substitute(h, z, values)
        return Explicit(
            x=ca.vertcat(*[self._symbols[s] for s in self.states]),
            u=ca.vertcat(*[self._symbols[u] for u in self.inputs]),
            p=ca.vertcat(*[self._symbols[p] for p in self.parameters]),
            f=values[nw:],
            h=h,
            states=tuple(self.states),
            inputs=tuple(self.inputs),
            parameters=tuple(self.parameters),
            outputs=tuple(self.outputs),
            eliminated={w: values[i] for i, w in enumerate(eliminated)},
        )

    # -- showing -----------------------------------------------------------------------------

    def __repr__(self) -> str:
        unknown = sum(not p.is_known for p in self.parameters.values())

        def count(n: int, noun: str) -> str:
            return f"{n} {noun}{'' if n == 1 else 's'}"

        return (
            f"<Model {self.name}: {count(len(self.states), 'state')}, "
            f"{count(len(self.inputs), 'input')}, {count(len(self.outputs), 'output')}, "
            f"{count(len(self.parameters), 'parameter')} ({unknown} unknown)>"
        )

    def __str__(self) -> str:
        lines = [repr(self)]
        for b in self.balances.values():
            terms = " + ".join(f"({t})" for t in b.terms)
            lines.append(f"  {b.name}: ({b.inertia}) d{b.rate}/dt = {terms}   [{b.unit}]")
        lines += [f"  d{s}/dt = {e}" for s, e in self._rates.items()]
        lines += [f"  {name} = {e}   [{unit}]" for name, (e, unit) in self.outputs.items()]
        lines += [f"  {w} eliminated using {y}" for w, y, _ in self._eliminations]
        return "\n".join(lines)

    # -- inside ------------------------------------------------------------------------------

    def _declare(self, name: str) -> Any:
        if name in self._symbols:
            raise ModelError(f"{self.name}: {name!r} declared twice; give it another name")
        self._symbols[name] = ca.SX.sym(name)
        self._explicit = None
        return self._symbols[name]

    def _remember_unit(self, name: str, unit: str) -> str:
        """The SI text of a declared unit, which is remembered where it is another."""
        if not is_si(unit):
            self.declared_units[name] = unit
        return si_text(unit)

    def _balance_unit(self, rate: str, inertia: Expr, terms: Sequence[Expr]) -> str:
        """The unit that most of the terms and the inertia times d(rate)/dt have."""
        own = self.states[rate].unit
        units = {n: s.unit for n, s in self.states.items()}
        units |= {f"der_{n}": unit_quotient(s.unit, "s") for n, s in self.states.items()}
        units |= {n: u.unit for n, u in self.inputs.items()} | self.eliminated_units
        units |= {n: p.unit for n, p in self.parameters.items()}
        sides = [] if inertia.is_constant() else [inertia * self._derivatives[rate]]
        return common_unit([*sides, *terms], units, is_rotation=same_dimension(own, "rad/s"))

    def _state_name(self, state: Any) -> str:
        name = state if isinstance(state, str) else state.name()
        if name not in self.states:
            raise ModelError(
                f"{self.name}: {name!r} is not a state; states are {', '.join(self.states)}"
            )
        return str(name)

    def _once(self, name: str) -> None:
        if name in self._rates or any(b.rate == name for b in self.balances.values()):
            raise ModelError(f"{self.name}: state {name} has two equations; drop one")

    def _check_branch(
        self, expression: Expr, measured: Any, unknown: str, solution: Expr, using: str
    ) -> None:
        back = ca.substitute(expression, self._symbols[unknown], solution) - measured
        symbols = ca.symvar(ca.veccat(expression, measured, solution))
        rng = np.random.default_rng(1)
        error = ca.Function("b", symbols, [back])
        values = [error(*rng.uniform(0.1, 0.9, len(symbols))) for _ in range(5)]
        finite = [abs(float(v)) for v in values if np.isfinite(float(v))]
        if not finite or max(finite) > 1e-8:
            raise ModelError(
                f"{self.name}: the solution given for {unknown} does not satisfy the output "
                f"{using}; it must give {using} back when it is substituted"
            )

    def _copy(self, name: str) -> Model:
        new = Model.__new__(Model)
        new.__dict__.update(self.__dict__)
        new.name = name
        for key in ("states", "inputs", "parameters", "balances", "outputs"):
            setattr(new, key, dict(getattr(self, key)))
        new._symbols = dict(self._symbols)
        new._derivatives = dict(self._derivatives)
        new._rates = dict(self._rates)
        new._eliminations = list(self._eliminations)
        new._measured = list(self._measured)
        new.eliminated_units = dict(self.eliminated_units)
        new.declared_units = dict(self.declared_units)
        new._explicit = None
        return new

    def copy(self, name: str | None = None) -> Model:
        """An independent copy that shares the symbols."""
        return self._copy(name or self.name)

    def __copy__(self) -> Model:
        return self.copy()

    def __deepcopy__(self, memo: Any) -> Model:
        return self.copy()  # symbols and expressions never change

    def __reduce__(self) -> tuple[Any, ...]:  # an SX expression cannot be pickled by itself
        return _rebuilt, packed({**self.__dict__, "_explicit": None})


def _rebuilt(state: Mapping[str, Any], text: str) -> Model:
    """The model that was packed, with symbols of its own."""
    new = Model.__new__(Model)
    new.__dict__.update(unpacked(state, text))
    return new


def _inserted(entries: Mapping[str, Any], place: int, name: str, entry: Any) -> dict[str, Any]:
    """A dict with one more entry, at `place` in its order."""
    items = [(k, v) for k, v in entries.items() if k != name]
    return dict([*items[:place], (name, entry), *items[place:]])


def _linear_solve(matrix: Any, rhs: Any, model: str, names: list[str], n_first: int) -> Any:
    """Solve matrix @ z = rhs by symbolic Gauss elimination that keeps zeros zero.

    Pivots are judged at random points: structurally non-zero entries may vanish identically.
    """
    n = len(names)
    a = [[matrix[i, j] for j in range(n)] for i in range(n)]
    b = [rhs[i] for i in range(n)]
    symbols = ca.symvar(ca.veccat(matrix, rhs))
    rng = np.random.default_rng(7)
    points = [rng.uniform(0.2, 1.7, len(symbols)) for _ in range(3)]

    def size(entry: Any) -> float:
        """0 where the entry vanishes identically; larger where it is a simpler pivot."""
        if entry.is_zero():
            return 0.0
        if entry.is_constant():
            return 2.0
        value = ca.Function("v", symbols, [entry])
        if max(abs(float(value(*p))) for p in points) < 1e-12:
            return 0.0
        return 1.0 / (1.0 + ca.n_nodes(entry))

    order: list[int] = []
    borrowed: list[str] = []  # inputs solved from a balance, which then has to be made up for
    rows = list(range(n))
    for j in range(n):
        # An eliminated input is solved from its own output where that names it outright, and from
        # its balance where the output feels it through a derivative alone.
        own = [i for i in rows if i < n_first and size(a[i][j]) > 0.0] if j < n_first else []
        best = max(own or rows, key=lambda i: size(a[i][j]))
        if j < n_first and not own:
            borrowed.append(names[j])
        if size(a[best][j]) == 0.0:
            lacking = (borrowed or [names[j]])[0]
            raise ModelError(
                f"{model}: the equations do not determine {lacking}; an unknown input can only be "
                "eliminated with an output that feels it, and an inertia must not be zero"
            )
        rows.remove(best)
        order.append(best)
        for i in rows:
            if not a[i][j].is_zero():
                factor = a[i][j] / a[best][j]
                a[i] = [ca.SX(0) if c == j else a[i][c] - factor * a[best][c] for c in range(n)]
                b[i] = b[i] - factor * b[best]
    z: list[Any] = [ca.SX(0)] * n
    for j in reversed(range(n)):
        row = order[j]
        total = b[row]
        for c in range(j + 1, n):
            if not a[row][c].is_zero():
                total = total - a[row][c] * z[c]
        z[j] = total / a[row][j]
    return ca.vertcat(*z)
