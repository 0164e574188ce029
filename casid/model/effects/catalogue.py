"""All effects that the structure of a model and its records allow."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

from casid.model.effects.balance_effects import (
    coulomb_friction,
    cubic_stiffness,
    deadzone,
    extra_input,
    offset,
    quadratic_damping,
)
from casid.model.effects.channel_effects import (
    channel_effects_of,
    saturation,
    sensor_bias,
    time_delay,
)
from casid.model.effects.effect import Effect, Sizes
from casid.model.effects.parameter_effects import (
    jump_times,
    parameter_drift,
    parameter_jump,
    scheduled_parameter,
)
from casid.model.effects.search_ranges import RANGES, SMOOTHING
from casid.model.effects.structure_effects import missing_modes_of, structure_effects_of
from casid.model.effects.unnamed_effects import is_positive, power_law, unnamed_effects
from casid.model.model import Model


def catalogue(
    model: Model,
    sizes: Sizes,
    recorded: Mapping[str, str],
    *,
    extra: Sequence[Effect] = (),
    without: Collection[str] = (),
) -> list[Effect]:
    """All effects that this model's structure and these records allow.

    A periodic disturbance is not among them: its frequency comes from the residual's spectrum
    (`casid.diagnosis.evidence.spectral_peaks`).

    Parameters
    ----------
    recorded : channels in every record that the model does not use, name -> unit.
    extra : effects of the user's own.
    without : kinds to leave out.
    """
    effects: list[Effect] = []
    for balance, b in model.balances.items():
        speed = SMOOTHING.speed * max(sizes.rates[b.rate], 1e-12)
        effects.append(quadratic_damping(model, balance))
        if not is_positive(sizes.ranges.get(b.rate, (-1.0, 1.0))):
            # Where the rate keeps its sign, dry friction is a constant force.
            effects.append(coulomb_friction(model, balance, speed))
        cubic = cubic_stiffness(model, balance)
        if cubic is not None:
            effects.append(cubic)
        position = model.position_of(b.rate)
        if position is not None:
            largest = sizes.largest_motion(position)
            width = SMOOTHING.width * max(sizes.rates[position], 1e-12)
            play = deadzone(model, balance, width, largest)
            effects += [play] if play is not None else []
        effects.append(offset(model, balance))
        effects += unnamed_effects(model, balance, speed)
        effects += [extra_input(model, balance, c, u) for c, u in recorded.items()]
    for state, ends in sizes.ranges.items():
        law = power_law(model, state, sizes.rates[state]) if is_positive(ends) else None
        effects += [law] if law is not None else []
    measured = [n for n, u in model.inputs.items() if u.kind == "measured"]
    for channel in (*model.outputs, *measured):
        effects.append(sensor_bias(model, channel))
        effects.append(time_delay(model, channel, sizes.longest_delay))
    effects += channel_effects_of(model, sizes, recorded)
    effects += structure_effects_of(model, sizes)
    effects += missing_modes_of(model, sizes, sizes.Ts)
    effects += _parameter_variations(model, sizes, recorded)
    effects += extra
    for channel, largest in sizes.largest.items():
        effects += [saturation(model, channel, share * largest) for share in RANGES.limits]
    return [e for e in effects if e.kind not in without]


def _parameter_variations(
    model: Model, sizes: Sizes, recorded: Mapping[str, str]
) -> Iterator[Effect]:
    """Jumps, drifts and schedules of the parameters that a record may determine."""
    times = jump_times(sizes.window)
    for name, p in model.parameters.items():
        if p.is_constant:
            continue
        yield from (parameter_jump(model, name, float(t)) for t in times)
        if p.is_known and p.value == 0.0:
            continue  # what is not there does not vary
        yield parameter_drift(model, name, sizes.window)
        for c, spread in sizes.channels.items():
            yield scheduled_parameter(model, name, c, recorded[c], spread)
