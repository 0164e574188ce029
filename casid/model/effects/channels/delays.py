"""Channels that are late: sensors whose record is, and inputs that act late."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.model.declarations import Parameter, Stage
from casid.model.effects.channels.alike_commands import alike_commands
from casid.model.effects.channels.channel_effects import is_command
from casid.model.effects.channels.recorded_commands import (
    as_channels,
    carries,
    commands_of,
    is_late,
    is_moved,
    require_command,
    require_first,
)
from casid.model.effects.effect import Effect, Sizes
from casid.model.effects.names import ACTS_LATE, LATER_THAN_RECORDED, RECORDED_LATE
from casid.model.effects.search_ranges import RANGES
from casid.model.model import Model


@names_wrong_types(ModelError)
def time_delay(model: Model, channel: str | Sequence[str], longest: float) -> Effect:
    """A channel that arrives late by a constant time, at most `longest` seconds.

    Parameters
    ----------
    channel : an output of `model`, whose simulation is delayed; a measured input, which is then
        moved ahead, or several that one instrument records late by one time; or a known one, which
        acts late (`dead_time`).
    longest : upper bound of the delay [s].

    Raises
    ------
    ModelError
        If one of several channels is no measured input.
    """
    if not isinstance(channel, str):
        return _delay_of_records(model, channel, longest)
    if is_command(model, channel):
        return dead_time(model, channel, longest)
    if channel in model.outputs:
        p = Parameter(f"delay_{channel}", "s", 0.0, lower=0.0, upper=longest)

        def apply(new: Model, names: Sequence[str]) -> None:
            new.stages = (*new.stages, Stage("delay", channel, names[0]))

        return Effect("time_delay", channel, (p,), apply, sided="positive", limit=longest)

    return _delay_of_records(model, [channel], longest)


def _delay_of_records(model: Model, channels: Sequence[str], longest: float) -> Effect:
    """Measured inputs that are recorded late by one time."""
    for name in channels:
        if name not in model.inputs or model.inputs[name].kind != "measured":
            raise ModelError(
                f"{model.name}: {name} is no measured input; request the delay of an output alone, "
                "and dead_time of commands that act late together"
            )

    return Effect(
        "time_delay",
        ", ".join(channels),
        (Parameter(f"delay_{'_'.join(channels)}", "s", 0.0, lower=0.0, upper=longest),),
        carries("delay_input", channels),
        sided="positive",
        limit=longest,
        priority=1,
        description=RECORDED_LATE,
    )


def delays_of_records(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Channels that are recorded late, each that is not moved in time yet, and all inputs at once.

    Of one instrument's record, of waves and their rate say, each alone would be late by a time of
    its own.
    """
    measured = [n for n, u in model.inputs.items() if u.kind == "measured"]
    free = [n for n in measured if not is_moved(model, n)]
    yield from (time_delay(model, n, sizes.longest_delay) for n in (*model.outputs, *free))
    if len(free) > 1:
        yield time_delay(model, free, sizes.longest_delay)


@names_wrong_types(ModelError)
def dead_time(model: Model, channel: str | Sequence[str], longest: float) -> Effect:
    """A recorded input that acts later than it is recorded, by at most `longest` seconds.

    A command has a dead time (a valve, a driver, a network), a measured input a transport delay (a
    flow in a pipe, whose sensor is upstream). The input, held, joined by straight lines or
    band-limited as declared, is delayed by any part of a sample. What it did before the record no
    sample shows: as many samples as `longest` has are left out of every output, unless the model
    begins in a known rest (`Model.state`), in which the input was until then.

    Parameters
    ----------
    channel : an input, or several that act late by one time.

    Raises
    ------
    ModelError
        If the input is not recorded, stands in for an unknown one, or acts late already.
    """
    channels = as_channels(channel)
    for name in channels:
        require_command(model, name, instead="time_delay")
        require_first(model, is_late(model, name), f"the input {name} acts late")
    p = Parameter(f"dead_time_{'_'.join(channels)}", "s", 0.0, lower=0.0, upper=longest)

    are_commands = all(is_command(model, name) for name in channels)
    late = f"{ACTS_LATE}, by a dead time" if are_commands else LATER_THAN_RECORDED
    return Effect(
        "time_delay",
        ", ".join(channels),
        (p,),
        carries("late_input", channels),
        sided="positive",
        limit=longest,
        priority=1,
        shape="" if are_commands else ACTS_LATE,
        description=late,
    )


def dead_times_of(model: Model, sizes: Sizes) -> list[Effect]:
    """Recorded inputs that may act late, each that is not moved in time yet, and those alike."""
    longest = max(RANGES.dead_time * (sizes.window[1] - sizes.window[0]), sizes.longest_delay)
    free = [n for n in commands_of(model) if not is_moved(model, n)]
    return [dead_time(model, n, longest) for n in (*free, *alike_commands(model, free))]
