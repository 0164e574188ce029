"""The catalogue of effects: what a model of mechanics usually lacks, generated from its structure.

Every effect is an extension of the model with parameters that have a null value, at which the
extended model is the model. Balances may lack a force, parameters may change, sensors and inputs
may distort: the kinds and their names are those of `diagnosis.json`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import casadi as ca
import numpy as np

from casid.model import Input, Model, Parameter, Stage
from casid.units import unit_quotient

Array = np.ndarray[Any, Any]
Sided = Literal["positive", "both"]
Test = Literal["score", "clip"]

JUMP_TIMES = 12
"""Instants, evenly inside the window, that a jump is first searched at."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and range of a recorded channel over the fitted records, in its own unit."""

    mean: float
    lowest: float
    highest: float


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """A named, parameterised extension of a model or sensor.

    Attributes
    ----------
    kind, where : as `diagnosis.json` names them.
    parameters : what the extension adds, with units; `start` is the null value.
    sided : "positive" where physics allows one sign only.
    test : "score" where the simulation is differentiable in the first parameter at its null value.
    variants : further values of what is searched rather than differentiated (jump times).
    """

    kind: str
    where: str
    parameters: tuple[Parameter, ...]
    apply: Callable[[Model, Sequence[str]], None]  # changes a copy; gets the parameters' names
    sided: Sided = "both"
    test: Test = "score"
    variant: float | None = None
    priority: int = 0  # of two that are the same thing in this model, the lower is named
    limit: float | None = None  # largest |value| of the first parameter worth trying
    cost: int = 1  # parameters that it is charged for
    span: tuple[float, float] | None = None  # of the signal that moves a parameter

    @property
    def key(self) -> tuple[str, str]:
        """Kind and place."""
        return self.kind, self.where

    def __repr__(self) -> str:
        return f"<Effect {self.kind} in {self.where}>"

    def extend(
        self, model: Model, *, starts: Mapping[str, float] | None = None, upper: float | None = None
    ) -> Model:
        """A copy of `model` with this effect; `starts` by the effect's own parameter names."""
        new, _ = self.extended(model, starts=starts, upper=upper)
        return new

    def extended(
        self, model: Model, *, starts: Mapping[str, float] | None = None, upper: float | None = None
    ) -> tuple[Model, tuple[str, ...]]:
        """As `extend`, with the names that the parameters got in the extended model."""
        new = model.copy(f"{model.name} + {self.kind}")
        names = []
        for i, p in enumerate(self.parameters):
            name = new.free_name(p.name)
            start = (starts or {}).get(p.name, p.start)
            p = replace(p, name=name, start=float(np.clip(start, p.lower, p.upper)))
            if i == 0 and upper is not None:
                p = replace(p, upper=upper, start=min(p.start, upper))
            new.parameter(name, p.unit, start=p.start, lower=p.lower, upper=p.upper)
            names.append(name)
        self.apply(new, names)
        return new, tuple(names)


def quadratic_damping(model: Model, balance: str) -> Effect:
    """-d_2 |v| v in a balance (drag, eddies), d_2 >= 0."""
    b = model.balances[balance]
    unit = unit_quotient(b.unit, model.states[b.rate].unit, 2)

    def apply(new: Model, names: Sequence[str]) -> None:
        v = new.symbol(b.rate)
        new.add_term(balance, -new.symbol(names[0]) * ca.fabs(v) * v)

    p = Parameter("d_2", unit, 0.0, lower=0.0)
    return Effect("quadratic_damping", balance, (p,), apply, sided="positive")


def coulomb_friction(model: Model, balance: str, speed: float) -> Effect:
    """-F_c tanh(v / v_0) in a balance: dry friction, smoothed below `speed` = v_0 (rate's unit).

    The smoothing keeps the simulation differentiable; it is small against the speeds met.
    """
    b = model.balances[balance]

    def apply(new: Model, names: Sequence[str]) -> None:
        new.add_term(balance, -new.symbol(names[0]) * ca.tanh(new.symbol(b.rate) / speed))

    p = Parameter("F_c", b.unit, 0.0, lower=0.0)
    return Effect("coulomb_friction", balance, (p,), apply, sided="positive")


def cubic_stiffness(model: Model, balance: str) -> Effect | None:
    """-k_3 q^3 in a balance, q the position; hardening or softening."""
    b = model.balances[balance]
    position = model.position_of(b.rate)
    if position is None:
        return None
    unit = unit_quotient(b.unit, model.states[position].unit, 3)

    def apply(new: Model, names: Sequence[str]) -> None:
        new.add_term(balance, -new.symbol(names[0]) * new.symbol(position) ** 3)

    return Effect("cubic_stiffness", balance, (Parameter("k_3", unit, 0.0),), apply)


def offset(model: Model, balance: str) -> Effect:
    """A constant force or torque in a balance."""
    b = model.balances[balance]

    def apply(new: Model, names: Sequence[str]) -> None:
        new.add_term(balance, new.symbol(names[0]))

    symbol = "tau_0" if b.unit == "N m" else "F_0"
    return Effect("offset", balance, (Parameter(symbol, b.unit, 0.0),), apply)


def extra_input(model: Model, balance: str, channel: str, unit: str) -> Effect:
    """A recorded channel that acts in a balance although the model does not use it."""
    b = model.balances[balance]
    p = Parameter(f"b_{channel}", unit_quotient(b.unit, unit, 1), 0.0)

    def apply(new: Model, names: Sequence[str]) -> None:
        u = new.add_input(Input(channel, unit, "known", "foh"))
        new.add_term(balance, new.symbol(names[0]) * u)

    return Effect("extra_input", channel, (p,), apply)


def parameter_jump(model: Model, name: str, time: float) -> Effect:
    """A parameter that changes its value at `time` (seconds of the record's clock).

    A jump at a searched instant costs as much as three parameters (Zhang and Siegmund 2007).
    """
    old = model.parameters[name]

    def step(t: Array) -> Array:
        # A fraction where the jump falls between two samples, so that its time moves smoothly.
        Ts = t[1] - t[0]
        return np.asarray(np.clip((t - time) / Ts + 0.5, 0.0, 1.0))

    def apply(new: Model, names: Sequence[str]) -> None:
        s = new.add_input(Input(f"step at {time:.9g} s", "1", "generated", "zoh", step))
        new.substitute_symbol(name, new.symbol(name) + new.symbol(names[0]) * s)

    p = Parameter(f"jump_{name}", old.unit, 0.0)
    return Effect("parameter_jump", name, (p,), apply, variant=time, cost=3)


def scheduled_parameter(model: Model, name: str, channel: str, unit: str, spread: Spread) -> Effect:
    """A parameter p that depends on a recorded channel c: p + s (c - c_mean).

    The mean is that of the fitted records, so that p stays what it is on average there, and its
    estimate and that of s hardly depend on each other. Noise on c makes s too small: a channel that
    is noisy beside its own changes is better smoothed first.
    """
    old = model.parameters[name]
    p = Parameter(f"slope_{name}_{channel}", unit_quotient(old.unit, unit, 1), 0.0)

    def apply(new: Model, names: Sequence[str]) -> None:
        c = new.add_input(Input(channel, unit, "known", "foh"))
        moved = new.symbol(name) + new.symbol(names[0]) * (c - spread.mean)
        new.substitute_symbol(name, moved)

    span = spread.lowest - spread.mean, spread.highest - spread.mean
    # Of two that act alike, the one that is estimated is named.
    priority = int(old.is_known)
    return Effect(
        "scheduled_parameter", f"{name}~{channel}", (p,), apply, span=span, priority=priority
    )


def sensor_bias(model: Model, channel: str) -> Effect:
    """A constant added to a measured output or input."""
    if channel in model.outputs:
        unit = model.outputs[channel][1]

        def apply(new: Model, names: Sequence[str]) -> None:
            expression, u = new.outputs[channel]
            new.replace_output(channel, expression + new.symbol(names[0]), u)

        priority = 1
    else:
        unit = model.inputs[channel].unit

        def apply(new: Model, names: Sequence[str]) -> None:
            new.substitute_symbol(channel, new.symbol(channel) - new.symbol(names[0]))

        priority = 2
    p = Parameter(f"bias_{channel}", unit, 0.0)
    return Effect("sensor_bias", channel, (p,), apply, priority=priority)


def time_delay(model: Model, channel: str, longest: float) -> Effect:
    """A channel that arrives late by a constant time, at most `longest` seconds."""
    p = Parameter(f"delay_{channel}", "s", 0.0, lower=0.0, upper=longest)
    if channel in model.outputs:

        def apply(new: Model, names: Sequence[str]) -> None:
            new.stages = (*new.stages, Stage("delay", channel, names[0]))

        return Effect("time_delay", channel, (p,), apply, sided="positive", limit=longest)

    entry = model.inputs[channel]

    def apply_input(new: Model, names: Sequence[str]) -> None:
        # The simulation moves the column ahead by the delay; the slope carries the tangent.
        slope = new.add_input(
            Input(f"slope of {channel}", unit_quotient(entry.unit, "s", 1), "generated", "foh")
        )
        new.substitute_symbol(channel, new.symbol(channel) + new.symbol(names[0]) * slope)
        new.stages = (*new.stages, Stage("delay_input", channel, names[0]))

    return Effect(
        "time_delay", channel, (p,), apply_input, sided="positive", limit=longest, priority=1
    )


def saturation(model: Model, channel: str, limit: float) -> Effect:
    """An output clipped at plus and minus a limit, near the largest value measured."""
    unit = model.outputs[channel][1]
    p = Parameter(f"limit_{channel}", unit, limit, lower=0.8 * limit, upper=1.2 * limit)

    def apply(new: Model, names: Sequence[str]) -> None:
        new.stages = (*new.stages, Stage("clip", channel, names[0]))

    return Effect("saturation", channel, (p,), apply, test="clip", variant=limit)


@dataclass(frozen=True, slots=True, eq=False)
class Sizes:
    """How large signals are in the records at hand: what smoothing and search ranges go by."""

    rates: Mapping[str, float]  # state -> rms
    largest: Mapping[str, float]  # output -> largest |measured|: a clipping cannot be below
    window: tuple[float, float]  # s, of the fitted part
    longest_delay: float  # s
    channels: Mapping[str, Spread] = field(default_factory=dict)  # recorded beside the model's


def jump_times(window: tuple[float, float]) -> list[float]:
    """The instants that a jump is first searched at."""
    start, stop = window
    return [float(t) for t in np.linspace(start, stop, JUMP_TIMES + 2)[1:-1]]


def catalogue(model: Model, sizes: Sizes, recorded: Mapping[str, str]) -> list[Effect]:
    """All effects that this model's structure and these records allow.

    Parameters
    ----------
    recorded : channels in every record that the model does not use, name -> unit.
    """
    effects: list[Effect] = []
    for balance, b in model.balances.items():
        speed = 0.03 * max(sizes.rates[b.rate], 1e-12)
        effects.append(quadratic_damping(model, balance))
        effects.append(coulomb_friction(model, balance, speed))
        cubic = cubic_stiffness(model, balance)
        if cubic is not None:
            effects.append(cubic)
        effects.append(offset(model, balance))
        effects += [extra_input(model, balance, c, u) for c, u in recorded.items()]
    measured = [n for n, u in model.inputs.items() if u.kind == "measured"]
    for channel in (*model.outputs, *measured):
        effects.append(sensor_bias(model, channel))
        effects.append(time_delay(model, channel, sizes.longest_delay))
    times = jump_times(sizes.window)
    for name, p in model.parameters.items():
        if not p.is_constant:
            effects += [parameter_jump(model, name, float(t)) for t in times]
            effects += [
                scheduled_parameter(model, name, c, recorded[c], spread)
                for c, spread in sizes.channels.items()
                if not (p.is_known and p.value == 0.0)  # what is not there does not vary
            ]
    for channel, largest in sizes.largest.items():
        effects += [saturation(model, channel, share * largest) for share in (0.96, 0.98, 0.995)]
    return effects


def extend_all(model: Model, effects: Sequence[Effect]) -> tuple[Model, list[Any]]:
    """A model with many effects at their null values, and each effect's first parameter name."""
    new, names = model, []
    for effect in effects:
        new, own = effect.extended(new, upper=0.0 if effect.kind == "time_delay" else None)
        names.append(own[0])
    return new, names
