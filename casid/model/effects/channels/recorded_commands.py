"""Recorded inputs that act on a model, and the stages that their columns pass through."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from casid.errors import ModelError
from casid.model.declarations import Input, Stage, StageKind
from casid.model.effects.places.place import recorded_inputs
from casid.model.model import Model
from casid.model.units import unit_quotient


def as_channels(channel: str | Sequence[str]) -> list[str]:
    """One channel or several, as a list."""
    return [channel] if isinstance(channel, str) else list(channel)


def commands_of(model: Model) -> list[str]:
    """Recorded inputs that no elimination made of an output."""
    gone = {m.output for m in model._measured}
    return [n for n in recorded_inputs(model) if n not in gone]


def require_command(model: Model, channel: str, *, instead: str) -> None:
    """Refuse an input that is no recorded command, with the effect to request `instead`.

    Raises
    ------
    ModelError
        If the input is not recorded, or stands in for an unknown one.
    """
    if channel not in commands_of(model):
        raise ModelError(
            f"{model.name}: {channel} is no recorded command (it is {model.inputs[channel].kind}, "
            f"or was an output before an elimination); request {instead} of such a channel"
        )


def require_first(model: Model, is_second: bool, what: str) -> None:
    """Refuse an effect that the model has already, said in words, `what`.

    Raises
    ------
    ModelError
        If it `is_second`.
    """
    if is_second:
        raise ModelError(f"{model.name}: {what} already; extend the model before that one")


def is_lagging(model: Model, channel: str) -> bool:
    """True if an input acts through an actuator's lag already."""
    return _has_stage(model, channel, "lag_input")


def is_rate_limited(model: Model, channel: str) -> bool:
    """True if the actuator of an input has a largest rate already."""
    return _has_stage(model, channel, "rate_input")


def is_late(model: Model, channel: str) -> bool:
    """True if an input acts through a dead time already."""
    return _has_stage(model, channel, "late_input")


def is_played(model: Model, channel: str) -> bool:
    """True if an input acts through play already."""
    return _has_stage(model, channel, "play_input")


def is_moved(model: Model, channel: str) -> bool:
    """True if an input acts late, or its record is late: of both, only the difference shows."""
    return _has_stage(model, channel, "late_input", "delay_input")


def _has_stage(model: Model, channel: str, *kinds: str) -> bool:
    return any(s.kind in kinds and s.channel == channel for s in model.stages)


def carries(kind: StageKind, channels: Sequence[str]) -> Callable[[Model, Sequence[str]], None]:
    """The `apply` of an effect that sends input columns through stages with one parameter."""

    def apply(new: Model, names: Sequence[str]) -> None:
        for name in channels:
            carry(new, Stage(kind, name, names[0]))

    return apply


def carry(model: Model, stage: Stage) -> None:
    """Add a stage that prepares an input column, with the input that carries its tangent.

    The carrier does between its samples what the channel does, so that the tangent is exact. An
    input that acts late or lags is a line in each sample, with columns for its ends; a band-limited
    one stays so.
    """
    entry = model.inputs[stage.channel]
    changed = model.symbol(stage.channel)
    for parameter, name in zip(stage.parameters, stage.carriers, strict=True):
        slope = unit_quotient(entry.unit, model.parameters[parameter].unit, 1)
        carrier = model.add_input(Input(name, slope, "generated", entry.hold, blends=entry.blends))
        changed = changed + model.symbol(parameter) * carrier
    model.substitute_symbol(stage.channel, changed)
    model.stages = (*model.stages, stage)
    is_line = any(s.makes_lines and s.channel == stage.channel for s in model.stages)
    if is_line and model.acting_hold(stage.channel) != "bandlimited":
        for name in (stage.channel, *carriers_of(model, stage.channel)):
            unit = model.inputs[name].unit
            for end in Stage.line_of(name):
                model.add_input(Input(end, unit, "generated", "zoh"))


def carriers_of(model: Model, channel: str) -> list[str]:
    """Inputs that carry the tangents of what is done to an input's column."""
    mine = [s for s in model.stages if s.is_of_input and s.channel == channel]
    return list(dict.fromkeys(name for s in mine for name in s.carriers))
