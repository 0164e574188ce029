"""What an actuator makes of a command: a lag, a limit, a dead zone, play."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import casadi as ca

from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.model.declarations import Input, Parameter, Stage
from casid.model.effects.channels.alike_commands import alike_commands
from casid.model.effects.channels.recorded_commands import (
    as_channels,
    carries,
    carry,
    commands_of,
    is_lagging,
    is_played,
    is_rate_limited,
    require_command,
    require_first,
)
from casid.model.effects.effect import Effect, Sizes, known_while_null, switched_on
from casid.model.effects.names import RATE, RATE_LIMIT
from casid.model.effects.search_ranges import ACTUATORS, RANGES
from casid.model.model import Model
from casid.model.units import unit_quotient


@names_wrong_types(ModelError)
def actuator_lag(model: Model, channel: str | Sequence[str], longest: float) -> Effect:
    """A recorded command that acts through 1/(tau s + 1), tau at most `longest` seconds.

    What the actuator did is computed exactly for the command held or joined by straight lines, and
    handed to the simulation as a line in each sample with the same mean and first moment: neither
    the lag nor its derivative moves anything by half a sample. Before the record the command was
    that of the rest in which the model begins, if one is known (`Model.state`), or what it is at
    its first sample, if it stands still there; else the first samples, which are due to what it
    did before, are left out of the fit.

    Parameters
    ----------
    channel : a command, or several whose actuators have one lag.

    Raises
    ------
    ModelError
        If the input is not recorded, stands in for an unknown one, or lags already.
    """
    channels = as_channels(channel)
    for name in channels:
        require_command(model, name, instead="sensor_lag")
        require_first(model, is_lagging(model, name), f"the command {name} acts through a lag")
    p = Parameter(f"tau_{'_'.join(channels)}", "s", 0.0, lower=0.0, upper=longest)

    return Effect(
        "actuator_lag",
        ", ".join(channels),
        (p,),
        carries("lag_input", channels),
        sided="positive",
        limit=longest,
        priority=1,
    )


def actuator_saturation(model: Model, channel: str, limit: float) -> Effect:
    """A recorded command that acts up to a limit alone, to both sides: clip(u, -limit, limit).

    `limit` (the channel's SI unit) is where the search starts, below the largest command. The blend
    `saturated` is 0 in the model and 1 in the extended one.
    """
    lower, upper = (share * limit for share in ACTUATORS.limit)
    parameters = (
        Parameter(f"saturated_{channel}", "1", 0.0, lower=0.0, upper=1.0),
        Parameter(f"limit_{channel}", model.inputs[channel].unit, limit, lower=lower, upper=upper),
    )

    def apply(new: Model, names: Sequence[str]) -> None:
        known_while_null(new, names)
        switched_on(new, names[0])
        u, (share, most) = new.symbol(channel), (new.symbol(n) for n in names)
        new.substitute_symbol(channel, u + share * (ca.fmin(ca.fmax(u, -most), most) - u))

    return Effect(
        "actuator_saturation",
        channel,
        parameters,
        apply,
        sided="positive",
        variant=limit,
        cost=2,
    )


@names_wrong_types(ModelError)
def rate_limit(model: Model, channel: str, rate: float, *, most: float | None = None) -> Effect:
    """A recorded command whose actuator moves at no more than a rate, to both sides.

    The actuator (a rudder, a valve, a driver limited in slope) is where the command is, or on its
    way there at that rate; it begins where the command begins. What it did is computed exactly for
    a command held or joined by straight lines. As with `actuator_saturation` the blend
    `rate_limited` is 0 in the model and 1 in the extended one.

    Parameters
    ----------
    rate : where the search starts (the channel's SI unit per second).
    most : upper bound of the rate, that of the command itself, beyond which the limit does nothing.

    Raises
    ------
    ModelError
        If the input is not recorded, stands in for an unknown one, is band-limited between its
        samples, or has a largest rate already.
    """
    require_command(model, channel, instead="no largest rate")
    limited = is_rate_limited(model, channel)
    require_first(model, limited, f"the actuator of {channel} has a largest rate")
    if model.acting_hold(channel) == "bandlimited":
        raise ModelError(
            f"{model.name}: the command {channel} is band-limited between its samples, and an "
            'actuator at its largest rate is not; declare it with hold="zoh" or "foh"'
        )
    unit = model.inputs[channel].unit
    highest = ACTUATORS.rate[1] * rate if most is None else max(most, rate)
    parameters = (
        Parameter(f"rate_limited_{channel}", "1", 0.0, lower=0.0, upper=1.0),
        Parameter(
            f"rate_{channel}",
            unit_quotient(unit, "s"),
            rate,
            lower=ACTUATORS.rate[0] * rate,
            upper=highest,
        ),
    )

    def apply(new: Model, names: Sequence[str]) -> None:
        known_while_null(new, names)
        switched_on(new, names[0])
        carry(new, Stage("rate_input", channel, names[1], share=names[0]))

    shown = model.declared_units.get(channel)
    return Effect(
        "actuator_saturation",
        channel,
        parameters,
        apply,
        sided="positive",
        variant=rate,
        cost=2,
        shape=RATE,
        description=RATE_LIMIT,
        declared_units={parameters[1].name: f"{shown}/s"} if shown else {},
    )


@names_wrong_types(ModelError)
def input_backlash(
    model: Model, channel: str, largest: float, *, least: float = 0.0, begins: float = 0.0
) -> Effect:
    """A recorded command that acts through play, as a valve's stem or a worn linkage does.

    What acts stays where it is until the command has moved by the gap on either side of it: w
    follows u - gap upwards and u + gap downwards. The gap is at most `largest` (the channel's SI
    unit), and more than `least`.

    Parameters
    ----------
    begins : where what acts stands as a record begins, in gaps beside the command: -1 to 1. A
        command that came from below has left it at -1.

    Parameters
    ----------
    model, channel : the model and its recorded input.

    Raises
    ------
    ModelError
        If the input is not recorded, or acts through play already, or `begins` is beyond the gap.
    """
    if not -1.0 <= begins <= 1.0:
        raise ModelError(
            f"{model.name}: play of {channel} begins={begins:g} gaps beside the command; "
            "give -1 to 1, between the two contacts"
        )
    entry = _command(model, channel, "backlash")
    require_first(model, is_played(model, channel), f"the command {channel} acts through play")
    p = Parameter(f"gap_{channel}", entry.unit, 0.0, lower=0.0, upper=largest)

    def apply(new: Model, names: Sequence[str]) -> None:
        carry(new, Stage("play_input", channel, names[0], least, begins=begins))

    return Effect(
        "backlash",
        channel,
        (p,),
        apply,
        sided="positive",
        limit=largest,
        priority=1,
        constants={
            "width": ACTUATORS.tick * largest,
            "least": least,
            **({"begins": begins} if begins else {}),
        },
    )


def input_deadzone(model: Model, channel: str, largest: float, *, least: float = 0.0) -> Effect:
    """A recorded command that acts beyond a gap alone, as that of a valve with overlap does.

    A command of one sign, as of a valve that only opens, acts once it has passed the gap.

    What acts is u - clip(u, -gap, gap). The gap is at most `largest` (the channel's SI unit), and
    more than `least`.

    Raises
    ------
    ModelError
        If the input is not recorded.
    """
    entry = _command(model, channel, "dead zone")
    p = Parameter(f"gap_{channel}", entry.unit, 0.0, lower=0.0, upper=largest)

    def apply(new: Model, names: Sequence[str]) -> None:
        u, gap = new.symbol(channel), new.symbol(names[0])
        new.substitute_symbol(channel, u - ca.sign(u) * ca.fmin(ca.fabs(u), gap))

    return Effect(
        "deadzone",
        channel,
        (p,),
        apply,
        sided="positive",
        limit=largest,
        constants={"least": least},
    )


def _command(model: Model, channel: str, what: str) -> Input:
    entry = model.inputs[channel]
    if entry.kind not in ("measured", "known"):
        raise ModelError(
            f"{model.name}: {channel} is no recorded command (it is {entry.kind}); request the "
            f"{what} of a recorded input"
        )
    return entry


def actuator_effects_of(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Lags, limits and play of every recorded command.

    A command lags by itself, or with those alike, unless it does already. Limits and play are those
    of commands that no elimination made of an output.
    """
    longest = RANGES.actuator_lag * (sizes.window[1] - sizes.window[0])
    free = [c for c in commands_of(model) if not is_lagging(model, c)]
    yield from (actuator_lag(model, c, longest) for c in (*free, *alike_commands(model, free)))
    eliminated = {m.output for m in model._measured}
    for channel, entry in model.inputs.items():
        low, high = sizes.readings.get(channel, (0.0, 0.0))
        if entry.kind not in ("measured", "known") or channel in eliminated or high <= low:
            continue
        largest = max(-low, high)
        for share in ACTUATORS.starts:
            yield actuator_saturation(model, channel, share * largest)
        if not is_rate_limited(model, channel) and model.acting_hold(channel) != "bandlimited":
            rates = sizes.rates_felt.get(channel, ())
            yield from (
                rate_limit(model, channel, r, most=sizes.largest_rates[channel]) for r in rates
            )
        widest, least = (
            ACTUATORS.gap * (high - low),
            ACTUATORS.noise * sizes.noise.get(channel, 0.0),
        )
        if not is_played(model, channel) and least < widest:
            yield input_backlash(model, channel, widest, least=least)
        comes_to_zero = max(low, -high, 0.0) <= ACTUATORS.zero * largest
        if comes_to_zero and least < widest:
            yield input_deadzone(model, channel, widest, least=least)
