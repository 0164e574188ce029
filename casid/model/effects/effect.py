"""An effect: a named, parameterised extension of a model or of a sensor, with its null value.

At the null value the extended model is the model. Balances may lack a force, parameters may change,
sensors and inputs may distort; the kinds and their names are those of `diagnosis.json`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import ModelError
from casid.model.declarations import Hold, Parameter
from casid.model.declared_units import unit_in_balance
from casid.model.effects.search_ranges import SMOOTHING
from casid.model.identifiers import made_identifier
from casid.model.model import Model
from casid.model.units import is_si, parse_unit, si_unit

Sided = Literal["positive", "both"]
Test = Literal["score", "clip", "peak"]

KINDS = frozenset(
    """quadratic_damping cubic_damping coulomb_friction asymmetric_friction stribeck_friction
    cubic_stiffness quadratic_stiffness deadzone backlash end_stop cogging offset extra_input
    periodic_disturbance parameter_drift parameter_jump scheduled_parameter sensor_bias sensor_scale
    sensor_lag time_delay cross_axis saturation rectified lever_arm outliers hold
    actuator_lag actuator_saturation missing_mode unknown""".split()
)
"""Names of kinds that mean what `diagnosis.json` says they mean, and nothing else."""

ON_THE_CLOCK = ("parameter_jump", "parameter_drift", "periodic_disturbance")
"""Kinds with an instant, a span or a phase on the clock of the record that they were found in."""

SWITCHED = ("hold", "rectified", "actuator_saturation")
"""Kinds whose first parameter blends from 0, the model, to 1: a channel does it or does not.

Extended from a start other than 0 the parameter is 1, and not estimated.
"""

LATE = ("time_delay", "sensor_lag", "actuator_lag")
"""Kinds whose parameter is a time, whatever the channel has for a unit."""

OF_SAMPLES = ("outliers", "saturation")
"""Kinds that spoil samples, and leave the rest of the record as it is."""

HYSTERESIS_SHAPE = "hysteresis"
"""Of a force that depends on the motion before, which no kind names."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and range of a recorded channel over the fitted records, in its own unit.

    `hold` is what it does between its samples.
    """

    mean: float
    lowest: float
    highest: float
    hold: Hold = "foh"


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """A named, parameterised extension of a model or sensor.

    Attributes
    ----------
    kind, where : as `diagnosis.json` names them.
    parameters : what the extension adds, with units; `start` is the null value of the first. The
        others do nothing while the first is null.
    sided : "positive" where physics allows one sign only.
    test : "score" where the simulation is differentiable in the first parameter at its null value;
        "clip" for a limit that is met or not; "peak" for a line in the residual's spectrum.
    variant : the value of what is searched rather than differentiated (the instant of a jump).
    shape : what distinguishes effects of one kind in one place ("p^3").
    description : the effect in words, where its kind is no name of `KINDS` that says it; of one
        that does, the equations that it enters where it acts on a relative motion.
    constants : numbers in it that are chosen rather than estimated, SI units: the `speed` below
        which dry friction is smoothed, the `time` of a jump, the `end` of what lasts for a while,
        the `least` play that is one.
    declared_units : parameter -> unit that it is shown in, where that is not SI.
    """

    kind: str
    where: str
    parameters: tuple[Parameter, ...]
    apply: Callable[[Model, Sequence[str]], None]  # changes a copy; gets the parameters' names
    sided: Sided = "both"
    test: Test = "score"
    variant: float | None = None
    priority: int = 0  # of two that are the same thing in this model, the lower is named
    limit: float | None = None  # largest |value| of the first parameter tried
    cost: int = 1  # parameters that it is charged for
    span: tuple[float, float] | None = None  # of the signal that moves a parameter
    shape: str = ""
    description: str = ""
    constants: Mapping[str, float] = field(default_factory=dict)
    declared_units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Names that casid makes of a channel's, `Temp [degC]`, become identifiers."""
        if self.kind in KINDS:
            own = tuple(replace(p, name=made_identifier(p.name)) for p in self.parameters)
            units = {made_identifier(name): unit for name, unit in self.declared_units.items()}
            object.__setattr__(self, "parameters", own)
            object.__setattr__(self, "declared_units", units)

    @property
    def has_states(self) -> bool:
        """True of what moves on its own; its states do nothing while it is null."""
        return self.kind == "missing_mode" or self.shape == HYSTERESIS_SHAPE

    @property
    def is_store(self) -> bool:
        """True of a store that follows another with a time constant: it has no frequency."""
        return self.kind == "missing_mode" and any(p.unit == "s" for p in self.parameters)

    @property
    def sets_in(self) -> bool:
        """True of what sets in at an instant, its `variant`, which is searched."""
        return "time" in self.constants

    @property
    def is_new_gain(self) -> bool:
        """True of a gain of a channel that changes at an instant."""
        return self.kind == "sensor_scale" and self.sets_in

    @property
    def end(self) -> float | None:
        """The instant [s] at which what set in is over, None where it stays."""
        return self.constants.get("end")

    @property
    def is_on_the_clock(self) -> bool:
        """True of what has an instant, a span or a phase on the clock of its record."""
        return self.kind in ON_THE_CLOCK or self.sets_in or "start" in self.constants

    @property
    def is_switched(self) -> bool:
        """True of what is present or absent: its first parameter is then 1, and not estimated."""
        return self.kind in SWITCHED

    @property
    def key(self) -> tuple[str, str]:
        """Kind and place, with the shape where several of a kind share the place."""
        return self.kind, f"{self.where}: {self.shape}" if self.shape else self.where

    @property
    def is_unnamed(self) -> bool:
        """True for a shape and no more; the law of a flow has a name, though no kind."""
        return self.kind == "unknown" and self.priority > 0

    def __repr__(self) -> str:
        return f"<Effect {self.kind} in {self.key[1]}>"

    def extend(self, model: Model, *, starts: Mapping[str, float] | None = None) -> Model:
        """A copy of `model` with this effect; `starts` by the effect's own parameter names."""
        new, _ = self.extended(model, starts=starts)
        return new

    def extended(
        self, model: Model, *, starts: Mapping[str, float] | None = None, upper: float | None = None
    ) -> tuple[Model, tuple[str, ...]]:
        """The extended model, with the names that the parameters got in it."""
        new = model.copy(f"{model.name} + {self.kind}")
        names = []
        for i, p in enumerate(self.parameters):
            name = new.free_name(p.name)
            start = (starts or {}).get(p.name, p.start)
            p = replace(p, name=name, start=float(np.clip(start, p.lower, p.upper)))
            if i == 0 and upper is not None:
                p = replace(p, upper=upper, start=min(p.start, upper))
            new.add_parameter(p)
            shown = self._shown_unit(model, self.parameters[i])
            new.declared_units |= {name: shown} if shown else {}
            names.append(name)
        try:
            self.apply(new, names)
        except KeyError as error:
            raise ModelError(
                f"{model.name}: {self.kind} in {self.where} needs {error}, which the model does "
                "not have; apply the effect that adds it first"
            ) from error
        return new, tuple(names)

    def _shown_unit(self, model: Model, p: Parameter) -> str | None:
        """The unit that a parameter is shown in: its own, or that of what it changes.

        A change of a temperature has no zero of its own; what declares degC for itself is a level.
        A time is shown as the model's own times are, where these have one unit.
        A delay or lag of a pulse width in microseconds is a time, and no change of that width.
        """
        if self.is_switched and p is self.parameters[0]:
            return None  # a share, also where the channel has per cent
        if p.unit == "1" and p.start == 1.0:
            return None  # an exponent, whose null value is 1, is no part of the channel
        own = self.declared_units.get(p.name)
        unit = own or (None if self.kind in LATE else model.declared_units.get(self.where))
        if p.unit == "s" and (unit is None or si_unit(unit) != "s"):
            return _time_unit(model)
        if unit is None or is_si(unit) or si_unit(unit) != p.unit:
            return None if own or self.kind in LATE else self._unit_in_balance(model, p)
        return unit if own or not parse_unit(unit).offset else None

    def _unit_in_balance(self, model: Model, p: Parameter) -> str | None:
        """The unit of a parameter in the balance that it acts in, by what the model declares."""
        own = model.balances.get(self.where)
        balances = [own] if own else list(model.balances.values())  # between two: of all alike
        forces = {(b.declared, b.unit) for b in balances}
        force, si = next(iter(forces), ("", ""))
        if len(forces) != 1 or not force:
            return None
        states = [u for n in model.states if (u := model.unit_of(n)) and not parse_unit(u).offset]
        return unit_in_balance(p.unit, force, list(dict.fromkeys(states)), si)


@dataclass(frozen=True, slots=True, eq=False)
class Sizes:
    """How large signals are in the records: they set smoothing and search ranges."""

    rates: Mapping[str, float]  # state -> rms
    largest: Mapping[str, float]  # output -> largest |measured|: a clipping cannot be below
    window: tuple[float, float]  # s, of the fitted part
    longest_delay: float  # s
    Ts: float | None = None  # s
    channels: Mapping[str, Spread] = field(default_factory=dict)  # recorded beside the model's
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # state -> least, most
    course: Callable[[Any], Array] | None = None  # expression in the simulation -> its samples
    readings: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # of each channel
    levels: Mapping[str, float] = field(default_factory=dict)  # channel -> its operating point
    noise: Mapping[str, float] = field(default_factory=dict)  # input -> bound on its white noise
    events: tuple[float, ...] = ()  # s, at which a misfit begins
    rates_felt: Mapping[str, tuple[float, ...]] = field(default_factory=dict)  # command -> 1/s
    largest_rates: Mapping[str, float] = field(default_factory=dict)  # of the same commands

    def motion_of(self, expression: Any) -> Motion:
        """How an expression of states and inputs moves in the simulation.

        Where no simulation is at hand, the rms is the sum of those of the states in it and the
        range four of them to both sides.
        """
        if self.course is not None:
            values = self.course(expression)
            rms = float(np.sqrt(np.mean(values**2)))
            return Motion(rms, float(values.min()), float(values.max()), float(values.mean()))
        names = [s.name() for s in ca.symvar(ca.SX(expression))]
        if len(names) == 1 and names[0] in self.ranges:
            low, high = self.ranges[names[0]]
            return Motion(self.rates[names[0]], low, high, 0.5 * (low + high))
        rms = sum(self.rates.get(n, 0.0) for n in names)
        most = SMOOTHING.motion * rms
        return Motion(rms, -most, most, 0.0)


@dataclass(frozen=True, slots=True)
class Motion:
    """RMS, range and mean of a quantity in the fitted simulation, SI units."""

    rms: float
    low: float
    high: float
    mean: float

    @property
    def largest(self) -> float:
        """Largest |value|."""
        return max(abs(self.low), abs(self.high))

    @property
    def is_signed(self) -> bool:
        """True if it stays on one side of zero, by a thousandth of its largest value at least."""
        return is_one_sided(self.low, self.high)

    @property
    def operating_point(self) -> float:
        """Where nonlinear terms are expanded: zero, or the mean of what stays away from zero."""
        return self.mean if self.is_signed else 0.0


def _time_unit(model: Model) -> str | None:
    """The unit that all times among a model's parameters declare, where it is one and not s."""
    times = {model.declared_units.get(n, "s") for n, p in model.parameters.items() if p.unit == "s"}
    unit = times.pop() if len(times) == 1 else "s"
    return None if is_si(unit) else unit


def is_one_sided(low: float, high: float) -> bool:
    """True if a range stays away from zero, by a thousandth of its largest value at least."""
    margin = SMOOTHING.above_zero * max(abs(low), abs(high))
    return low > margin or high < -margin


def switched_on(model: Model, name: str) -> None:
    """Fix the blend of a switched kind at 1 where the effect is not null."""
    p = model.parameters[name]
    if p.start > 0.0:
        model.parameters[name] = replace(p, start=1.0, lower=1.0, upper=1.0)


def added_state(model: Model, name: str, unit: str, **declared: Any) -> Any:
    """A state that an effect has of its own, under a name that is free (see `Model.state`)."""
    free = model.free_name(name)
    symbol = model.state(free, unit, **declared)
    model.states[free] = replace(model.states[free], is_added=True)
    return symbol


def is_null(model: Model, names: Sequence[str]) -> bool:
    """True where an effect, its parameters `names`, is in a model at its null value of zero."""
    return model.parameters[names[0]].start == 0.0


def known_while_null(model: Model, names: Sequence[str]) -> None:
    """Make an effect's further parameters known where its first is null: nothing shows them."""
    if is_null(model, names):
        for name in names[1:]:
            p = model.parameters[name]
            model.parameters[name] = replace(p, value=p.start)


_LATE = ("time_delay", "sensor_lag")


def extend_all(model: Model, effects: Sequence[Effect]) -> tuple[Model, list[Any]]:
    """A model with many effects at their null values, and each effect's first parameter name.

    The first parameter is held at null where that spares work: no sample is lost to a delay's
    run-in, and states on which nothing depends yet need no sensitivities.
    """
    new, names = model, []
    for n, effect in enumerate(effects, 1):
        is_pinned = effect.has_states or effect.kind in _LATE
        new, own = effect.extended(new, upper=0.0 if is_pinned else None)
        new.name = _name_with(model.name, effects[:n])
        names.append(own[0])
    return new, names


def _name_with(name: str, effects: Sequence[Effect]) -> str:
    """The name of a model with effects: the first few, and how many more."""
    kinds = [effect.kind for effect in effects]
    listed, more = kinds[:3], len(kinds[3:])
    return " + ".join([name, *listed, *([f"{more} more"] if more else [])])
