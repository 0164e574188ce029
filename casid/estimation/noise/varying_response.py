"""Whether what a source of noise moves is whitened by a response that changes along the record.

`noise_model` whitens by one response, the average of a record. Where a flow, a speed or a load
changes what a force or the noise of an input does, the residual that it leaves is neither
stationary nor white under that, and passes for a function of what changed the response. A filter
along the path (`varying_innovations`) is used in its place where the residual is likelier under it,
at the same variances and spectra, or with the noise of the inputs in place of a force; variances
under which it is not white are estimated anew (`varying_likelihood`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import TINY, Array
from casid.estimation.noise.input_noise_floor import input_noise_floor
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.noise_response import may_vary, multiplied_inputs
from casid.estimation.noise.thresholds import VARYING_RESPONSE
from casid.estimation.noise.variances import estimate_noise
from casid.estimation.noise.varying_innovations import smoothed_sources
from casid.estimation.noise.varying_likelihood import (
    filters_along,
    is_white,
    weighted,
    with_likeliest_noise,
    with_spectra_along,
)
from casid.estimation.noise.varying_steps import Steps, steps_along
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.declarations import Stage


def with_varying_response(
    noise: NoiseModel,
    criterion: SimulationError,
    x: Array,
    known: Mapping[str, float],
    *,
    residuals: Sequence[Array] | None = None,
    seeks_spectra: bool = False,
) -> NoiseModel:
    """The noise at `x` with the innovations of a response that varies, where it is seen to.

    The same as given of a model that is linear and constant, but in windows, where whatever moves
    the plant begins anew; with delays and clippings beside its equations, or noise that passes an
    actuator; and of inputs that are filled between their samples. Where the input of a product is
    noisy, its average response may fit the residual less well than that of a force: noise of the
    inputs alone, at the floors of their channels, is what such forces are compared with.

    Parameters
    ----------
    known : channel -> standard deviation of its white noise, where it is known.
    residuals : (N, ny) an experiment, default those at `x`.
    seeks_spectra : whether forces that are white may get spectra along the path. Average spectra
        hardly show what moves an unstable plant for the length of a window.
    """
    records = range(len(criterion.data))
    if not _varies(noise, criterion):
        return noise
    if residuals is None:
        residuals = [criterion.simulated(x, e).residual for e in records]
    recorded = [steps_along(criterion, x, e) for e in records]
    states = _tangents_of_states(criterion, x)
    alternatives: list[tuple[float, NoiseModel, list[Steps]]] = []
    for alike in _alternatives(noise, criterion, x, known, residuals):
        steps = _followed(alike, recorded, criterion, x, residuals, states)
        filters = None if steps is None else filters_along(alike, steps)
        if steps is None or filters is None:
            continue
        varying = replace(alike, varying=filters)
        misfit = _misfit(varying, criterion, residuals, states)
        alternatives.append((misfit, varying, steps))
    # Variances by an average response may be far from the likeliest: of a model that integrates a
    # force, a missing sample leaves more in every line of the spectrum than its sensor's noise.
    # What is the better one by the average response is refined as well before it is given up.
    by_average = min((varying.misfit for _, varying, _ in alternatives), default=np.inf)
    found, least, path = noise, np.inf, recorded
    for misfit, varying, steps in sorted(alternatives, key=lambda a: a[0]):
        left = _less_states_of_windows(varying, criterion, residuals, states)
        refined = varying
        if varying.spectra or not is_white(varying, criterion.data, left):
            refined = with_likeliest_noise(varying, steps, criterion, left)
            misfit = _misfit(refined, criterion, residuals, states)
        if misfit < least - VARYING_RESPONSE.likelier:
            found, least, path = refined, misfit, steps
        if varying.misfit == by_average:
            break
    if not found.varying:
        return noise
    if seeks_spectra:
        left = _less_states_of_windows(found, criterion, residuals, states)
        found = with_spectra_along(found, path, criterion, left)
        least = _misfit(found, criterion, residuals, states)
    average = _misfit(noise, criterion, residuals, states)
    return found if least < average - VARYING_RESPONSE.likelier else noise


def followed_path(noise: NoiseModel, criterion: SimulationError, x: Array) -> NoiseModel | None:
    """The noise of forces with spectra along the path at `x`, at the variances likeliest there.

    None where the response does not vary, or a filter along the path diverges.
    """
    if not noise.spectra or not _varies(noise, criterion):
        return None
    residuals = [criterion.simulated(x, e).residual for e in range(len(criterion.data))]
    steps = [steps_along(criterion, x, e) for e in range(len(criterion.data))]
    filters = filters_along(noise, steps)
    if filters is None:
        return None
    along = replace(noise, varying=filters)
    states = _tangents_of_states(criterion, x)
    left = _less_states_of_windows(along, criterion, residuals, states)
    return with_likeliest_noise(along, steps, criterion, left)


def _varies(noise: NoiseModel, criterion: SimulationError) -> bool:
    """Whether what noise moves may vary along a record that a filter can follow."""
    is_cut = any(criterion.is_cut(e) for e in range(len(criterion.data)))
    is_moved = any(sd > 0.0 for sd in noise.source_sd.values())
    is_followed = criterion.segments == 1 and not any(d.filled for d in criterion.data)
    is_followed = is_followed and all(_is_followed(s, noise) for s in criterion.model.stages)
    return is_moved and is_followed and (is_cut or may_vary(criterion))


def _is_followed(stage: Stage, noise: NoiseModel) -> bool:
    """Whether the steps of a record hold what a stage does to noise (`varying_steps`)."""
    return stage.kind in ("lag", "filter") or (
        stage.is_of_input and not noise.source_sd.get(stage.channel)
    )


def along_record(noise: NoiseModel, criterion: SimulationError, x: Array) -> NoiseModel:
    """The noise for the records of another criterion; a response that varies is that at `x` there.

    The average response where the filter diverges there.
    """
    alone = replace(noise, used=[d.used for d in criterion.data], varying=())
    if not noise.varying:
        return alone
    steps = [steps_along(criterion, x, e) for e in range(len(criterion.data))]
    return replace(alone, varying=filters_along(noise, steps) or ())


def less_states(
    noise: NoiseModel, residuals: Sequence[Array], states: Sequence[Array]
) -> list[Array]:
    """Residuals (N, ny) less the change by initial states that makes them likeliest.

    Every window of a record begins in one of its own, fitted under another noise: what that leaves
    where the windows begin is none of this noise.

    Parameters
    ----------
    states : (N, ny, m) of each experiment, what initial states change.
    """
    out = []
    for e, (residual, columns) in enumerate(zip(residuals, states, strict=True)):
        stack = np.concatenate([residual[:, :, None], columns], axis=2)
        if noise.used:
            stack = np.where(noise.used[e][:, :, None], stack, 0.0)
        with np.errstate(all="ignore"):
            white = noise.whiten(stack * noise.weights[None, :, None], e)
            white = white.reshape(residual.size, -1)
            size = np.linalg.norm(white, axis=0)
        if not np.isfinite(size).all():
            out.append(residual)
            continue
        scale = np.maximum(size[1:], TINY)
        change = np.linalg.lstsq(white[:, 1:] / scale, white[:, 0])[0] / scale
        out.append(residual - columns @ change)
    return out


def _less_states_of_windows(
    noise: NoiseModel,
    criterion: SimulationError,
    residuals: Sequence[Array],
    states: Sequence[Array],
) -> Sequence[Array]:
    """`less_states` where records are cut; of a whole record the one state counts for nothing."""
    is_cut = any(criterion.is_cut(e) for e in range(len(criterion.data)))
    return less_states(noise, residuals, states) if is_cut else residuals


def _followed(
    noise: NoiseModel,
    recorded: list[Steps],
    criterion: SimulationError,
    x: Array,
    residuals: Sequence[Array],
    states: Sequence[Array],
) -> list[Steps] | None:
    """The steps along what noisy inputs are expected to have been, given the residuals.

    What follows the noise of an input has it in common with the residual, and moves the mean of
    their product; what is expected given that residual has nothing in common with it. Of a product
    of an input and a state, what noise moves is linear in it along the simulated state and the
    input as it was, exactly.

    Parameters
    ----------
    recorded : the steps along the recorded inputs.
    states : (N, ny, m) of each experiment, what initial states change.

    Returns
    -------
    The steps of each experiment; None where the filter along the recorded inputs diverges.
    """
    noisy = _noisy_inputs(noise, criterion)
    if not noisy:
        return recorded
    filters = filters_along(noise, recorded, criterion.data)
    if filters is None:
        return None
    along = replace(noise, varying=filters)
    out, left = [], _less_states_of_windows(along, criterion, residuals, states)
    for e, columns in enumerate(weighted(noise, criterion.data, left)):
        off = smoothed_sources(filters[e], recorded[e], noisy, noise.weights, columns)
        out.append(steps_along(criterion, x, e, off))
    return out


def _tangents_of_states(criterion: SimulationError, x: Array) -> list[Array]:
    """(N, ny, m) of each experiment, by its initial states.

    A fit far from the truth may begin in a state that it leaves at once: what is likelier for the
    rest of a record is not judged by that.
    """
    names = criterion.model.states
    states = [i for i, v in enumerate(criterion.variables) if v.source in names]
    records = range(len(criterion.data))
    return [criterion.simulated(x, e).jacobian[:, :, states] for e in records]


def _misfit(
    noise: NoiseModel,
    criterion: SimulationError,
    residuals: Sequence[Array],
    states: Sequence[Array],
) -> float:
    """Minus the log-likelihood; forces and their spectra are priced by Schwarz's criterion."""
    inputs = criterion.model.inputs
    forces = sum(sd > 0.0 and name not in inputs for name, sd in noise.source_sd.items())
    price = 0.5 * forces * float(np.log(criterion.n_samples))
    price += noise.price_of_shapes(criterion.n_samples)
    return noise.minus_log_likelihood(residuals, states) + price


def _alternatives(
    noise: NoiseModel,
    criterion: SimulationError,
    x: Array,
    known: Mapping[str, float],
    residuals: Sequence[Array],
) -> Iterator[NoiseModel]:
    """Noise that may act through a varying response: as found, or that of inputs alone.

    What is found by the average response is no better than that. Floors do not need one. What white
    forces move in a window, from nothing to what the plant magnifies, has no average.
    """
    inputs = criterion.model.inputs
    measured = [n for n, u in inputs.items() if u.kind == "measured"]
    is_cut = any(criterion.is_cut(e) for e in range(len(criterion.data)))
    if is_cut or noise.spectra or any(noise.source_sd.get(n, 0.0) > 0.0 for n in measured):
        yield noise
    floors = input_noise_floor(criterion.data, list(inputs))
    held = {n: known.get(n, floors[n]) for n in measured}
    noisy = {n: sd for n, sd in held.items() if sd > 0.0}
    if noisy and noisy != {n: sd for n, sd in noise.source_sd.items() if sd > 0.0}:
        of_inputs = estimate_noise(
            criterion,
            x,
            known={**known, **held},
            residuals=residuals,
            responses=noise.responses,
            has_disturbances=False,
        )
        yield replace(of_inputs, known=noise.known)


def _noisy_inputs(noise: NoiseModel, criterion: SimulationError) -> dict[str, float]:
    """Standard deviations of those that multiply, and make a noticeable part of the residual."""
    inputs = criterion.model.inputs
    return {
        name: noise.source_sd[name]
        for name in multiplied_inputs(criterion)
        if inputs[name].kind == "measured"
        and noise.makes(name, VARYING_RESPONSE.noticeable, criterion.data)
    }
