"""Effects in a channel: what sensors and loggers do to a signal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.model.declarations import HOLDS, Blend, Hold, Input, Parameter, Stage
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.channels.recorded_commands import (
    carriers_of,
    carry,
    is_lagging,
    is_late,
)
from casid.model.effects.effect import Effect, Sided, Sizes, switched_on
from casid.model.effects.names import (
    BESIDE_ITS_ZERO,
    BETWEEN_SAMPLES,
    BY_ANOTHER_GAIN,
)
from casid.model.effects.search_ranges import RANGES
from casid.model.model import Model
from casid.model.units import is_comparable, same_dimension, to_si, unit_quotient


def sensor_bias(model: Model, channel: str) -> Effect:
    """A constant added to a measured output or input; a known input acts beside its zero by it."""
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
    does = BESIDE_ITS_ZERO if is_command(model, channel) else ""
    return Effect("sensor_bias", channel, (p,), apply, priority=priority, description=does)


def is_command(model: Model, channel: str) -> bool:
    """True of an input that is declared known: it has no sensor, whose errors would be its own."""
    return channel in model.inputs and model.inputs[channel].kind == "known"


def sensor_scale(model: Model, channel: str, about: float = 0.0) -> Effect:
    """A sensor whose gain is 1 + s in place of 1; s = -2 is a wrong sign, and not searched here.

    What a recorded input did is its record over 1 + s; a known one has an actuator in the place of
    a sensor. A parameter often absorbs it, and the effect is then undetectable.

    Parameters
    ----------
    about : the reading that is right (the channel's SI unit): zero, or the operating point of a
        channel that stays away from zero, where a gain about zero is a bias to first order. Where
        it is the same thing as a bias, the bias is named: one number, at every reading.
    """
    point = carrying_unit(about) if about else 0.0
    if channel in model.outputs:

        def apply(new: Model, names: Sequence[str]) -> None:
            expression, unit = new.outputs[channel]
            s = new.symbol(names[0])
            new.replace_output(channel, expression + s * (expression - point), unit)

        priority = 1
    else:

        def apply(new: Model, names: Sequence[str]) -> None:
            s = new.symbol(names[0])
            scaled_input(new, channel, 1 / (1 + s), beside=s * point)

        priority = 2
    lower, upper = RANGES.lowest_scale, RANGES.highest_scale
    p = Parameter(f"scale_{channel}", "1", 0.0, lower=lower, upper=upper)
    constants = {"about": about} if about else {}
    priority += bool(about)
    does = BY_ANOTHER_GAIN if is_command(model, channel) else ""
    return Effect(
        "sensor_scale",
        channel,
        (p,),
        apply,
        priority=priority,
        description=does,
        constants=constants,
    )


def scaled_input(model: Model, channel: str, gain: Any, *, beside: Any = 0.0) -> None:
    """Put gain (u + beside) in the place of an input u, and of what carries its tangents."""
    model.substitute_symbol(channel, gain * (model.symbol(channel) + beside))
    for name in carriers_of(model, channel):
        model.substitute_symbol(name, gain * model.symbol(name))


def sensor_lag(model: Model, channel: str, longest: float) -> Effect:
    """A sensor that follows through 1/(tau s + 1), tau at most `longest` seconds.

    A measured input that lags is undone: what acted is u + tau du/dt, with the centred slope of
    the record. To first order in tau a lag is a delay. A lag comes before a delay of the same
    output: the two commute, and a delay between samples cannot shift an output that steps.

    Parameters
    ----------
    model, channel : the model and its output, or its measured input.
    """
    p = Parameter(f"lag_{channel}", "s", 0.0, lower=0.0, upper=longest)
    is_output = channel in model.outputs

    def apply(new: Model, names: Sequence[str]) -> None:
        """Put a lag behind the sensor, or in front of the input."""
        if is_output:
            place = _after_last_clip(new.stages, channel)
            lag = Stage("lag", channel, names[0])
            new.stages = (*new.stages[:place], lag, *new.stages[place:])
        else:
            carry(new, Stage("lead_input", channel, names[0]))

    return Effect(
        "sensor_lag",
        channel,
        (p,),
        apply,
        sided="positive",
        limit=longest,
        priority=1 if is_output else 2,  # where it is the same as a delay, a delay is named
    )


def _after_last_clip(stages: Sequence[Stage], channel: str) -> int:
    """Where a channel's delays and lags begin that nothing clips any more."""
    clips = [i for i, s in enumerate(stages) if (s.kind, s.channel) == ("clip", channel)]
    return clips[-1] + 1 if clips else 0


def cross_axis(model: Model, channel: str, source: str, unit: str) -> Effect:
    """An output that also depends on another channel of its dimension: a sensor mounted askew.

    `source` is an output of the model (what it would show without noise), one of its inputs, or a
    channel recorded beside the model, in `unit`. A temperature acts by its difference from this,
    and by a share of it: heat that a thermometer's stem leads draws its reading towards the other.
    """
    own = model.outputs[channel][1]
    is_temperature = same_dimension(own, "K")
    low, high = (0.0, 1.0) if is_temperature else (-np.inf, np.inf)
    quotient = unit_quotient(own, unit, 1)
    p = Parameter(f"cross_{channel}_{source}", quotient, 0.0, lower=low, upper=high)

    def apply(new: Model, names: Sequence[str]) -> None:
        """Add a share of the other channel to what this one reads."""
        expression, u = new.outputs[channel]
        if source in new.outputs:
            felt = new.outputs[source][0]
        else:
            felt = new.add_input(Input(source, unit, "known", "foh"))
        felt = felt - expression if is_temperature else felt
        new.replace_output(channel, expression + new.symbol(names[0]) * felt, u)

    sided: Sided = "positive" if is_temperature else "both"
    return Effect("cross_axis", channel, (p,), apply, sided=sided, priority=1)


@names_wrong_types(ModelError)
def hold(model: Model, channel: str, toward: Hold | None = None) -> Effect:
    """An input that does between its samples what the model does not say.

    The blend b moves it from what is declared to `toward`, by default from held to straight lines
    and else to held: b = 0 is the model, b = 1 an input that does what `toward` says. Extended from
    a b other than 0, the effect has no free parameter: an input does the one or the other. In a
    slow model a change between held and straight lines is a delay of half a sample. Where the
    record cannot separate them, the hold is named: a delay of just half a sample is rare.

    Parameters
    ----------
    channel : the recorded input.
    toward : what it does between its samples, "zoh", "foh" or "bandlimited".

    Raises
    ------
    ModelError
        If the input has this blend already, no record, or does what is requested.
    """
    entry = model.inputs[channel]
    if toward is None:
        toward = "foh" if entry.hold == "zoh" else "zoh"
    blends = {b.toward: b.parameter for b in entry.blends}
    if toward in blends or entry.kind not in ("measured", "known"):
        raise ModelError(
            f"{model.name}: input {channel} "
            + (f"has the blend {blends[toward]} already" if blends else f"is {entry.kind}")
            + "; request the hold of a recorded input that has none"
        )
    if toward == entry.hold or toward not in HOLDS:
        others = " or ".join(repr(h) for h in HOLDS if h != entry.hold)
        raise ModelError(
            f"{model.name}: toward={toward!r}, but input {channel} is declared "
            f"hold={entry.hold!r}; request {others}"
        )
    p = Parameter(f"{_BLENDS[entry.hold, toward]}_{channel}", "1", 0.0, lower=0.0, upper=1.0)

    def apply(new: Model, names: Sequence[str]) -> None:
        switched_on(new, names[0])
        for name in (channel, *carriers_of(new, channel)):
            entry = new.inputs[name]
            new.inputs[name] = replace(entry, blends=(*entry.blends, Blend(names[0], toward)))

    return Effect(
        "hold",
        channel,
        (p,),
        apply,
        sided="positive",
        cost=0,  # extended, it has no free parameter
        shape=toward if toward == "bandlimited" else "",
        description=COURSES[toward],
    )


def hold_of_all(model: Model, channels: Sequence[str], toward: Hold) -> Effect:
    """Several inputs that all do what the model does not say: one logger treats them alike."""
    each = [hold(model, channel, toward) for channel in channels]
    name = f"{_BLENDS[model.inputs[channels[0]].hold, toward]}_inputs"

    def apply(new: Model, names: Sequence[str]) -> None:
        for effect in each:
            effect.apply(new, names)

    p = replace(each[0].parameters[0], name=name)
    return replace(each[0], where=", ".join(channels), parameters=(p,), apply=apply)


def _holds_of_all(model: Model) -> Iterator[Effect]:
    """Inputs declared alike, held or joined by straight lines, that all do the other."""
    was_output = {m.output for m in model._measured}
    pairs: tuple[tuple[Hold, Hold], ...] = (("zoh", "foh"), ("foh", "zoh"))
    for declared, toward in pairs:
        channels = [
            name
            for name, entry in model.inputs.items()
            if entry.kind in ("measured", "known")
            and entry.hold == declared
            and not (entry.blends or name in was_output)
            and not (is_lagging(model, name) or is_late(model, name))
        ]
        if len(channels) > 1:
            yield hold_of_all(model, channels, toward)


COURSES: Mapping[Hold, str] = {
    "zoh": f"held{BETWEEN_SAMPLES}",
    "foh": f"joined by straight lines{BETWEEN_SAMPLES}",
    "bandlimited": f"band-limited{BETWEEN_SAMPLES}",
}
"""What each hold has an input do."""

_BLENDS: Mapping[tuple[Hold, Hold], str] = {
    ("zoh", "foh"): "ramp",
    ("foh", "zoh"): "ramp",
    ("bandlimited", "foh"): "ramp",
    ("bandlimited", "zoh"): "held",
    ("zoh", "bandlimited"): "smooth",
    ("foh", "bandlimited"): "smooth",
}
"""Declared hold and the other one -> what the blend's parameter is called."""


@names_wrong_types(ModelError)
def saturation(model: Model, channel: str, limit: float) -> Effect:
    """An output clipped at plus and minus a limit, near the largest value measured.

    Parameters
    ----------
    channel : an output of the model.
    limit : where the estimate of the limit starts, in the output's SI unit; its bounds are
        `RANGES.lowest_limit` and `RANGES.highest_limit` times that.
    """
    unit = model.outputs[channel][1]
    lower, upper = RANGES.lowest_limit * limit, RANGES.highest_limit * limit
    p = Parameter(f"limit_{channel}", unit, limit, lower=lower, upper=upper)

    def apply(new: Model, names: Sequence[str]) -> None:
        new.stages = (*new.stages, Stage("clip", channel, names[0]))

    return Effect("saturation", channel, (p,), apply, test="clip", variant=limit)


def channel_effects_of(model: Model, sizes: Sizes, recorded: Mapping[str, str]) -> list[Effect]:
    """What sensors and loggers may do to the model's channels, biases, delays and limits apart.

    Parameters
    ----------
    recorded : channels in every record that the model does not use, name -> unit.
    """
    effects: list[Effect] = []
    measured = [n for n, u in model.inputs.items() if u.kind == "measured"]
    units = {n: unit for n, (_, unit) in model.outputs.items()}
    units |= {n: model.inputs[n].unit for n in measured}
    for channel, unit in units.items():
        level = sizes.levels.get(channel, 0.0)
        points = dict.fromkeys((level, *zeros_of_reading(model, channel, unit, level)))
        effects += [sensor_scale(model, channel, point) for point in points]
        effects.append(sensor_lag(model, channel, RANGES.sensor_lag * sizes.longest_delay))
    effects += [sensor_scale(model, n) for n in model.inputs if is_command(model, n)]
    effects += [sensor_bias(model, channel) for channel in _commands_with_a_zero(model)]
    beside = units | dict(recorded)
    for channel, (_, own) in model.outputs.items():
        effects += [
            cross_axis(model, channel, source, unit)
            for source, unit in beside.items()
            if source != channel and is_comparable(own, unit)
        ]
    for channel, entry in model.inputs.items():
        if entry.kind in ("measured", "known") and not entry.blends:
            lines = Stage.line_of(channel)[0] in model.inputs
            others = [h for h in HOLDS if h != entry.hold and not (lines and h == "bandlimited")]
            effects += [hold(model, channel, other) for other in others]
    return [*effects, *_holds_of_all(model)]


def zeros_of_reading(model: Model, channel: str, unit: str, level: float) -> list[float]:
    """The readings from which a gain may err besides the operating point: the zero of the scale.

    A thermometer is adjusted at the zero of degC or degF. Absolute zero means nothing to it: one
    that is declared in K is adjusted in melting ice, unless it shows a difference.

    Parameters
    ----------
    level : where the channel stays, SI.
    """
    zero, ice = float(to_si(0.0, model.unit_of(channel))), float(to_si(0.0, "degC"))
    if zero or not same_dimension(unit, "K"):
        return [zero]
    return [ice] if level > 0.5 * ice else []


def _commands_with_a_zero(model: Model) -> list[str]:
    """Inputs that are known, and whose zero no constant term of one equation stands for.

    They act in several equations, as a wheel that steers beside its zero, or by a gain that a
    signal changes, as the opening of a valve does by the pressure before it.
    """
    known = [n for n, u in model.inputs.items() if u.kind == "known"]
    return [n for n in known if _gains(model, n) and constant_beside(model, n) is None]


def constant_beside(model: Model, command: str) -> str | None:
    """The balance or output in which a constant is the bias of an input; None where none is.

    The input acts there alone, by a gain that no signal changes. A rate without a balance has no
    constant term of its own.
    """
    signals = ca.vertcat(*(model.symbol(n) for n in (*model.states, *model.inputs)))
    gains = _gains(model, command)
    if len(gains) != 1 or any(any(ca.which_depends(g, signals)) for g in gains.values()):
        return None
    (where,) = gains
    return where or None


def _gains(model: Model, command: str) -> dict[str, Any]:
    """How the sides of the equations that an input enters move with it, by balance or output."""
    rows = {n: b.total for n, b in model.balances.items()}
    rows |= {n: e for n, (e, _) in model.outputs.items()}
    sides = [*rows.items(), *(("", e) for e in model._rates.values())]
    gains = ((n, ca.jacobian(ca.SX(side), model.symbol(command))) for n, side in sides)
    return {n: g for n, g in gains if g.nnz() and not g.is_zero()}
