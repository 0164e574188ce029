"""All effects that the structure of a model and its records allow."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from casid.model.effects.balances.balance_effects import (
    coulomb_friction,
    cubic_damping,
    cubic_stiffness,
    deadzone,
    extra_inputs_of,
    further_places_of_inputs,
    offset,
    quadratic_damping,
    quadratic_stiffness,
)
from casid.model.effects.balances.contact_effects import Side, backlash, end_stop
from casid.model.effects.balances.flow_laws import (
    coefficients_of_flows,
    flow_law,
    is_never_negative,
    is_positive,
    power_law,
    radiation,
    saturating_law,
    states_with_one_law,
)
from casid.model.effects.balances.friction_effects import (
    asymmetric_coulomb,
    asymmetric_damping,
    hysteresis,
    stribeck_friction,
)
from casid.model.effects.balances.missing_parts import missing_parts_of
from casid.model.effects.balances.moving_media import moving_media_of
from casid.model.effects.balances.resistances import growing_resistances_of
from casid.model.effects.balances.unnamed_effects import (
    linear_loss,
    linear_restoring_force,
    missing_links,
    saturating_force,
    unnamed_effects,
    uptakes_of,
    vanishes_with,
)
from casid.model.effects.channels.actuator_effects import actuator_effects_of
from casid.model.effects.channels.channel_effects import channel_effects_of, saturation, sensor_bias
from casid.model.effects.channels.delays import dead_times_of, delays_of_records
from casid.model.effects.channels.digital_filters import digital_filters_of
from casid.model.effects.channels.laws_of_outputs import bends_of
from casid.model.effects.channels.sensor_effects import sensor_effects_of
from casid.model.effects.clock_effects import clock_effects_of
from casid.model.effects.effect import Effect, Motion, Sizes
from casid.model.effects.parameter_effects import (
    input_schedules_of,
    is_constant_term,
    jump_times,
    parameter_drift,
    parameter_jump,
    scheduled_parameter,
)
from casid.model.effects.places.place import Place
from casid.model.effects.places.places import places_of
from casid.model.effects.places.planes import planes_of
from casid.model.effects.search_ranges import (
    CONTACT_RANGES,
    FRICTION_RANGES,
    HYSTERESIS,
    RANGES,
    SMOOTHING,
    UNNAMED_EFFECTS,
)
from casid.model.effects.state_schedules import state_schedules_of
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
    (`casid.diagnosis.evidence.residual.spectral_peaks`).

    Parameters
    ----------
    recorded : channels in every record that the model does not use, name -> unit.
    extra : effects of the user's own.
    without : kinds to leave out.
    """
    effects: list[Effect] = []
    places = places_of(model)
    elements = [p for p in places if p.is_relative]
    for place in places:
        effects += forces_at(model, place, sizes)
        effects += _linear_and_power_laws(model, place, sizes)
        if place.has_own_force:
            effects.append(offset(model, place))
        if place.where in model.balances:
            for channel, unit in recorded.items():
                reading = sizes.channels.get(channel)
                effects += extra_inputs_of(model, place.where, channel, unit, reading)
    for plane in planes_of(model, elements):
        effects += _resistances_along(model, plane, sizes)
    effects += moving_media_of(model)
    effects += growing_resistances_of(model)
    effects += _power_laws(model, sizes)
    effects += uptakes_of(model, sizes.ranges)
    effects += missing_links(model, elements)
    measured = [n for n, u in model.inputs.items() if u.kind == "measured"]
    for channel in (*model.outputs, *measured):
        effects.append(sensor_bias(model, channel))
    effects += delays_of_records(model, sizes)
    effects += dead_times_of(model, sizes)
    effects += further_places_of_inputs(model, sizes)
    effects += channel_effects_of(model, sizes, recorded)
    effects += sensor_effects_of(model, sizes)
    effects += bends_of(model, sizes)
    effects += digital_filters_of(model, sizes)
    effects += actuator_effects_of(model, sizes)
    effects += missing_parts_of(model, places, sizes)
    effects += _parameter_variations(model, elements, sizes, recorded)
    effects += extra
    for channel, largest in sizes.largest.items():
        effects += [saturation(model, channel, share * largest) for share in RANGES.limits]
    return [e for e in effects if e.kind not in without]


def forces_at(model: Model, place: Place, sizes: Sizes) -> list[Effect]:
    """Forces in velocity and position of a place, with smoothing and ranges from the records."""
    effects: list[Effect] = []
    speed = 0.0
    if place.velocity is not None:
        motion = sizes.motion_of(place.velocity)
        rms = max(motion.rms, 1e-12)
        speed = SMOOTHING.speed * rms
        # Drag grows with the speed through the medium, a flow with the difference of two levels; a
        # temperature alone has no such zero.
        about = 0.0 if place.is_mechanical or place.is_relative else motion.operating_point
        levels = _levels_of_rest(model, place, motion) if about else [0.0]
        effects += [quadratic_damping(model, place, level) for level in levels]
        effects.append(cubic_damping(model, place, about))
        # Where the rate keeps its sign, dry friction is a constant force: between two bodies no
        # other effect is one.
        if place.is_relative:
            is_friction = place.is_mechanical
        else:
            is_friction = not motion.is_signed
        if is_friction:
            effects.append(coulomb_friction(model, place, speed))
        if not motion.is_signed and place.is_mechanical:
            effects.append(asymmetric_damping(model, place))
            effects.append(asymmetric_coulomb(model, place, speed))
            for share in FRICTION_RANGES.starts:
                effects.append(stribeck_friction(model, place, speed, share * rms, rms))
    found: list[Effect | None] = []
    if place.position is not None:
        motion = sizes.motion_of(place.position)
        # A machine's own zero, where its springs are at rest, may lie far from where it moves.
        zeros = {motion.operating_point, 0.0} if place.is_mechanical else {motion.operating_point}
        width = SMOOTHING.width * max(motion.rms, 1e-12)
        for about in sorted(zeros):
            found.append(cubic_stiffness(model, place, about))
            found.append(quadratic_stiffness(model, place, about))
        found.append(deadzone(model, place, width, motion.largest))
        if place.is_mechanical:
            found.append(backlash(model, place, width, motion.largest))
            found += _memories_at(model, place, sizes)
    found += _stops_at(model, place, sizes)
    effects += [e for e in found if e is not None]
    # The square and the root of what keeps its sign are a power law, or a tangent and a constant.
    is_signed = place.velocity is not None and sizes.motion_of(place.velocity).is_signed
    if is_signed and not place.is_mechanical and not place.is_relative:
        return effects
    return effects + unnamed_effects(model, place, speed, is_signed=is_signed)


def _resistances_along(model: Model, plane: Place, sizes: Sizes) -> list[Effect]:
    """Dry friction, or a dead voltage, and drag that oppose a vector."""
    rms = max(sizes.motion_of(plane.velocity).rms, 1e-12)
    dry = coulomb_friction(model, plane, SMOOTHING.speed * rms)
    return [dry, quadratic_damping(model, plane)] if plane.is_mechanical else [dry]


def _levels_of_rest(model: Model, place: Place, motion: Motion) -> list[float]:
    """Where the level of a loss that grows with a square is searched from.

    Zero, where the rest of the balance vanishes with the state: without cells there is no growth,
    and their loss has no other level. From far away its parabola would be a line.
    """
    balance = model.balances.get(place.where)
    if balance is not None and vanishes_with(balance.total, place.velocity):
        return [0.0]
    reach = 0.5 * (motion.high - motion.low)
    return sorted({motion.mean - reach, motion.mean, motion.mean + reach})


def _memories_at(model: Model, place: Place, sizes: Sizes) -> list[Effect | None]:
    """Hysteresis of a mechanical position; of a travel within one sample it is dry friction."""
    if place.velocity is None:
        return []
    motion = sizes.motion_of(place.position)
    reach = max(0.5 * (motion.high - motion.low), 1e-12)
    least = HYSTERESIS.travel[0] * reach
    if sizes.Ts is not None:
        step = sizes.motion_of(place.velocity).largest * sizes.Ts
        least = max(least, HYSTERESIS.samples * step)
    most = HYSTERESIS.travel[1] * reach
    starts = [share * reach for share in HYSTERESIS.starts]
    return [
        hysteresis(model, place, start, (least, most)) for start in starts if least < start < most
    ]


def _linear_and_power_laws(model: Model, place: Place, sizes: Sizes) -> list[Effect]:
    """The law of what passes between two places, or a loss or a spring that the model omits."""
    if place.velocity is None:
        return []
    motion = sizes.motion_of(place.velocity)
    if place.is_relative:
        found = [
            flow_law(model, place, motion.rms),
            radiation(model, place),
            saturating_force(model, place, motion.rms),
        ]
    else:
        far = _far_levels_of_rest(motion)
        found = [
            linear_loss(model, place, motion.operating_point),
            *(linear_loss(model, place, level, sided="positive") for level in far),
            linear_restoring_force(model, place),
        ]
        balance = model.balances.get(place.where)
        if balance and any(vanishes_with(term, place.velocity) for term in balance.terms):
            found.append(linear_loss(model, place, 0.0))  # a leak of what has a natural zero
    different = {(e.shape, *(p.start for p in e.parameters)): e for e in found if e is not None}
    return list(different.values())


def _far_levels_of_rest(motion: Motion) -> list[float]:
    """Where a loss may vanish besides at the mean, of what stays away from zero.

    The room that a hot body loses heat to is below all that the body is at. The signature of a loss
    about the mean has no constant part, and parameters of the model may absorb the rest of it.
    """
    reach = 0.5 * (motion.high - motion.low) if motion.is_signed else 0.0
    return [motion.mean + side * reach for side in UNNAMED_EFFECTS.rests if reach > 0.0]


def _power_laws(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """The laws of each positive state's flow, and one of those that the model takes as alike."""
    positive = [state for state, ends in sizes.ranges.items() if is_positive(ends)]
    groups: list[tuple[str, ...]] = [(state,) for state in positive]
    groups += [g for g in states_with_one_law(model) if set(g) <= set(positive)]
    for group in groups:
        law = power_law(model, group, [sizes.rates[state] for state in group])
        if law is not None:
            yield law
    for state in [name for name, ends in sizes.ranges.items() if is_never_negative(ends)]:
        for of in (None, *coefficients_of_flows(model, state)):
            law = saturating_law(model, state, sizes.rates[state], of=of)
            if law is not None:
                yield law


def _stops_at(model: Model, place: Place, sizes: Sizes) -> list[Effect | None]:
    """Stops of a mechanical position, or the overflow of a store that stays filled."""
    q = place.position if place.is_mechanical else place.velocity
    if q is None or (not place.is_mechanical and place.is_relative):
        return []
    motion = sizes.motion_of(q)
    if not place.is_mechanical and not motion.is_signed:
        return []
    sides: tuple[Side, ...] = ("upper",)
    starts = (*CONTACT_RANGES.of_stores, *CONTACT_RANGES.starts)
    if place.is_mechanical:
        sides, starts = ("both", "symmetric", "upper", "lower"), CONTACT_RANGES.starts
    middle, reach = 0.5 * (motion.low + motion.high), 0.5 * (motion.high - motion.low)
    if not np.isfinite(reach) or reach <= 0.0:
        return []
    width = SMOOTHING.stop * reach
    return [
        end_stop(model, place, side, middle, reach, width, start)
        for side in sides
        for start in starts
    ]


def _parameter_variations(
    model: Model, elements: Sequence[Place], sizes: Sizes, recorded: Mapping[str, str]
) -> Iterator[Effect]:
    """Jumps, drifts and schedules of parameters that a record may determine, and of constants."""
    times = [*jump_times(sizes.window), *sizes.events]
    for name, p in model.parameters.items():
        if p.is_constant:
            continue
        yield from (parameter_jump(model, name, t) for t in times)
        if p.is_known and p.value == 0.0:
            continue  # what is not there does not vary
        yield parameter_drift(model, name, sizes.window)
        for c, spread in sizes.channels.items():
            if not is_constant_term(model, name):
                yield scheduled_parameter(model, name, c, recorded[c], spread)
    yield from clock_effects_of(model, sizes.window, sizes.events, elements)
    yield from input_schedules_of(model, sizes)
    yield from state_schedules_of(model, sizes)
