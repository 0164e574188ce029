"""How a parameter changes with a signal, judged once more beside the causes found since.

A parameter may fall with the size of a state or with its square, in proportion or less and less.
Which of these it does was chosen while other causes were missing, and their misfit favours one or
the other; the wrong one leaves a remainder that further effects then imitate. By a parabola and by
what levels off a small change is the same: the parabola is compared here alone. So is a power of
a recorded channel or an input, whose tangent at the mean is the line that was tested. Where none of
these leaves noise alone, slope and curvature may be missing together: a parabola about a vertex of
its own is one law, of which each of them is a part.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import casadi as ca
import numpy as np

from casid.diagnosis.evidence.records.signal_sizes import sizes_of
from casid.diagnosis.evidence.whitening.weighted_model import minus_log_likelihood
from casid.diagnosis.search.adoption.refinement import Adoption, Refinement, whole_fit
from casid.diagnosis.search.candidates import (
    Candidate,
    as_placed,
    extended_by,
    name_of,
    values_by_new_names,
)
from casid.diagnosis.search.comparison.simulation_errors import on_common_samples, simulation_errors
from casid.diagnosis.search.residual_check import is_noise_alone
from casid.diagnosis.thresholds import COMPARISON
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.effect import Effect
from casid.model.effects.parameter_effects import (
    has_powers,
    is_scheduled_by_channel,
    is_scheduled_by_power,
    power_scheduled_parameter,
    scheduled_parameter,
    spread_of_input,
)
from casid.model.effects.search_ranges import SATURATIONS
from casid.model.effects.state_schedules import (
    inhibited_parameter,
    is_inhibited,
    is_scheduled_by_state,
    parabolic_schedule,
    state_scheduled_parameter,
)


def with_better_powers(refine: Refinement, found: Adoption) -> Adoption:
    """The causes with the powers of signals that fit and predict better beside all others."""
    for i in range(len(found.adopted)):
        if found.fit is None:
            break
        effect = found.adopted[i].candidate.effect
        if is_scheduled_by_state(effect) or is_inhibited(effect):
            for other, step in _other_powers(refine, found, i):
                found = _by_the_better(refine, found, i, other, (step,))
            if is_scheduled_by_state(effect) and not is_noise_alone(found.at, refine.search):
                found = _along_a_parabola(refine, found, i)
        elif is_scheduled_by_channel(effect) and not _is_of_state(refine, effect):
            for other, step in _other_laws(refine, found, i):
                found = _by_the_better(refine, found, i, other, (step,), least=COMPARISON.likely)
    return found


def _other_powers(refine: Refinement, found: Adoption, i: int) -> Iterator[tuple[Effect, float]]:
    """The change by other laws, each with the size that makes it as large over the motion."""
    assert found.fit is not None
    own = found.adopted[i].candidate
    name, state = own.effect.where.split("~")
    sizes, model = sizes_of(found.at, refine.search.recorded), found.at.model
    motions = {
        power: sizes.motion_of(ca.fabs(model.symbol(state)) ** power)
        for power in range(1, SATURATIONS.powers + 1)
    }
    constants = {"power": 1.0, "straight": 0.0, **own.effect.constants}
    mine = motions[int(constants["power"])]
    size, mean = found.fit.values[own.names[0]], motions[1].mean
    p = found.fit.values.get(name, model.parameters[name].nominal)
    # What levels off is compared as the line that is as steep at the mean.
    slope = -p * size / (1 + size * mean) if is_inhibited(own.effect) else size
    change = slope * (mine.high - mine.low)
    for power, motion in motions.items():
        for is_straight in (True, False)[:power]:
            effect = state_scheduled_parameter(
                refine.start.model, name, state, motion, power, is_straight=is_straight
            )
            is_other = any(effect.constants[n] != constants[n] for n in ("power", "straight"))
            if is_other and motion.high > motion.low:
                yield effect, change / (motion.high - motion.low)
    falls_in_proportion = own.effect.constants.get("power") == 1.0 and slope < 0.0
    if falls_in_proportion and state in model.inputs:
        if sizes.motion_of(model.symbol(state)).low >= 0.0:
            effect = inhibited_parameter(refine.start.model, name, state, motions[1])
            yield effect, -slope / max(p + slope * mean, SATURATIONS.left * p)


def _is_of_state(refine: Refinement, effect: Effect) -> bool:
    """True of a parameter that changes with a state, which no record has."""
    return effect.where.split("~")[1] in refine.start.model.states


def _along_a_parabola(refine: Refinement, found: Adoption, i: int) -> Adoption:
    """The change along a parabola about a vertex of its own, where that pays for the vertex.

    It is searched from parabolas whose vertex is as far on either side of the mean as the signal
    ranges, with the change over the motion that the present law has.
    """
    assert found.fit is not None
    own = found.adopted[i].candidate
    name, state = own.effect.where.split("~")
    sizes, x = sizes_of(found.at, refine.search.recorded), found.at.model.symbol(state)
    line, square, size = (sizes.motion_of(e) for e in (x, x**2, ca.fabs(x)))
    mine = sizes.motion_of(ca.fabs(x) ** int(own.effect.constants["power"]))
    reach = line.high - line.low
    if not (reach > 0.0 and size.high > size.low):
        return found
    # By the sign of the state the size falls or grows with it.
    towards = 1.0 if line.mean >= 0.0 else -1.0
    change = towards * found.fit.values[own.names[0]] * (mine.high - mine.low)
    price = np.log(found.fit.criterion.n_samples)
    best = found
    for side in (-1.0, 1.0):
        effect = parabolic_schedule(
            refine.start.model, name, state, line, square, line.mean + side * reach
        )
        steps = (-side * change / (2 * reach**2), line.mean + side * reach)
        other = _by_the_better(refine, found, i, effect, steps, least=price)
        best = min(best, other, key=lambda each: minus_log_likelihood(each.at))
    return best


def _other_laws(refine: Refinement, found: Adoption, i: int) -> Iterator[tuple[Effect, float]]:
    """A power of the channel for a line, a line for a power, with the same slope at the mean."""
    assert found.fit is not None
    own, model = found.adopted[i].candidate, refine.start.model
    name, channel = own.effect.where.split("~")
    sizes = sizes_of(refine.start, refine.search.recorded)
    if channel in model.inputs:
        unit, spread = model.inputs[channel].unit, spread_of_input(sizes, channel)
    else:
        unit, spread = refine.search.recorded[channel], sizes.channels[channel]
    if not has_powers(spread, unit):
        return
    values = found.fit.values
    size, p = values[own.names[0]], values.get(name, model.parameters[name].nominal)
    if is_scheduled_by_power(own.effect):
        yield scheduled_parameter(model, name, channel, unit, spread), size * p / spread.mean
    elif p != 0.0:
        yield (
            power_scheduled_parameter(model, name, channel, unit, spread),
            size * spread.mean / p,
        )


def _by_the_better(
    refine: Refinement,
    found: Adoption,
    i: int,
    effect: Effect,
    steps: tuple[float, ...],
    least: float = 0.0,
) -> Adoption:
    """The causes with another effect in the place of one, if it is better.

    Parameters
    ----------
    steps : where the parameters of the effect start.
    least : twice the logarithm of how much likelier it is at least.
    """
    fit = found.fit
    assert fit is not None
    refine.search.progress(f"compare powers of the {name_of(effect)}")
    own = found.adopted[i].candidate
    causes = [a.candidate for a in found.adopted]
    causes[i] = replace(own, effect=effect, names=tuple(p.name for p in effect.parameters))
    what = f"the comparison of powers of the {name_of(effect)}"
    other = refine.search.attempts.attempt(what, lambda: _fitted(refine, causes, fit, i, steps))
    if other is None:
        return found
    placed, new = other
    before, after = on_common_samples(
        *(simulation_errors(f, refine.split, refine.units) for f in (fit, new))
    )
    if not after.square < before.square or after.held_out_square > before.held_out_square:
        return found
    adopted = as_placed(found.adopted, placed)
    at = refine.search.weighing.weigh(new.criterion.model, new, rounds=1)
    if least and not 2 * (minus_log_likelihood(found.at) - minus_log_likelihood(at)) > least:
        return found
    return replace(found, adopted=tuple(adopted), at=at, fit=new)


def _fitted(
    refine: Refinement, causes: list[Candidate], near: Fit, i: int, steps: tuple[float, ...]
) -> tuple[list[Candidate], Fit]:
    """Causes in the model as it is, and its fit from the last one, the i-th cause from `steps`."""
    model, placed = extended_by(refine.start.model, causes)
    others = [k for k in range(len(causes)) if k != i]
    values = dict(near.values)
    for name, step in zip(placed[i].names, steps, strict=True):
        # Far from where the effect was found, beside other causes, a slope may promise too much.
        p = model.parameters[name]
        values[name] = min(max(step, p.lower), p.upper)
    values |= values_by_new_names([placed[k] for k in others], [causes[k] for k in others])
    new = whole_fit(model, refine.split, refine.settings, refine.units, values)
    return [replace(c, fit=new) for c in placed], new
