"""The variances of the noise of a simulation error: of sensors, measured inputs and disturbances.

They minimise Whittle's likelihood of the residual under (1) of `noise_model`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import lsq_linear, nnls

from casid.arrays import TINY, Array, BoolArray, require_finite
from casid.estimation.noise.forces import name_of_force
from casid.estimation.noise.noise_model import NoiseModel, Variance
from casid.estimation.noise.noise_response import Response, noise_response
from casid.estimation.noise.residual_periodograms import (
    Spectra,
    restricted,
    spectra_of,
    with_floors,
)
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.records.signals import Signals
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class ResidualWindows:
    """Which samples residuals have, what their fit absorbed, and what is known of inputs.

    Attributes
    ----------
    windows : (N, ny) an experiment, the samples that there are.
    absorbed : what the fit took out of the spectra (`absorbed_noise`); None: nothing.
    floors : input -> its variance as its own channel shows it, and the standard error of that. Each
        counts as one more line of the spectra, once for every output, as the lines of these do.
    """

    windows: Sequence[BoolArray]
    absorbed: Sequence[Array] | None = None
    floors: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def estimate_noise(
    criterion: SimulationError,
    x: Array,
    *,
    known: Mapping[str, float] | None = None,
    residuals: Sequence[Array] | None = None,
    responses: Sequence[Response] | None = None,
    has_disturbances: bool = True,
    seen_through: ResidualWindows | None = None,
) -> NoiseModel:
    """Estimate the noise from the residuals at `x` by Fisher scoring of Whittle's likelihood.

    Sources whose responses have the same shape (an input and a balance it enters) are
    indistinguishable: the variance is given to the first, measured inputs before balances, and
    `alike` lists them. A source whose noise is known is counted on its own. There is no white noise
    in stated rates: integrated, it would be any slow error.

    Parameters
    ----------
    known : channel -> standard deviation that is known and not estimated; of the force in a balance
        by the name that `with_forces` gives it.
    residuals : (N, ny) an experiment, default those at `x`.
    responses : of the experiments, where they are known already.
    has_disturbances : False: of sensors and measured inputs alone.
    seen_through : which samples `residuals` have, and what the fit absorbed; default those that
        count, and nothing.
    """
    known = with_rounding(criterion.data, known or {})
    stated = known_sources(known, criterion.model)
    ny = len(criterion.outputs)
    if responses is None:
        responses = [noise_response(criterion, x, e) for e in range(len(criterion.data))]
    if residuals is None:
        residuals = [criterion.simulated(x, e).residual for e in range(len(criterion.data))]
    every = list(responses[0].sources)
    alike: list[tuple[str, ...]] = [(name,) for name in every if name in stated]
    found_in = [*criterion.model.inputs, *(criterion.model.balances if has_disturbances else ())]
    rest = [name for name in every if name not in stated and name in found_in]
    alike += _alike(responses, criterion.weights, every, rest)
    sources = [group[0] for group in alike]
    given = given_variances(criterion.outputs, sources, known, stated)
    used = [d.used.copy() for d in criterion.data]
    shown = seen_through or ResidualWindows(used)
    spectra = spectra_of(residuals, responses, sources, ny, shown.windows, absorbed=shown.absorbed)
    require_finite("the residual's spectra", spectra.power, spectra.design)
    floors = {g[0]: shown.floors[n] for g in alike for n in g if n in shown.floors}
    with_lines = with_floors(spectra, floors, sources)
    value = variances(with_lines, given)
    output_sd = np.sqrt(np.maximum(value[:ny], spectra.least))
    found = {name: float(np.sqrt(v)) for name, v in zip(sources, value[ny:], strict=True)}
    is_felt = np.any(spectra.design * value > spectra.floor[:, None], axis=0)
    is_input = np.array([False] * ny + [name in criterion.model.inputs for name in sources])
    sought = np.isnan(given) & (is_felt | is_input)
    keys: list[Variance] = [("output", n) for n in criterion.outputs]
    keys += [("source", n) for n in sources]
    return NoiseModel(
        output_sd=output_sd,
        source_sd={name: found.get(name, 0.0) for name in every},
        responses=responses,
        weights=criterion.weights,
        alike=tuple(alike),
        covariance=_covariance(with_lines, value, keys, sought),
        misfit=whittle(spectra, value),
        used=() if all(mask.all() for mask in used) else used,
        known=known,
    )


def whittle(spectra: Spectra, value: Array) -> float:
    """Minus Whittle's log-likelihood of periodograms under the variances `value`.

    The restricted one, where the spectra have a tangent.
    """
    s = np.maximum(spectra.design @ value, spectra.floor)
    return float(spectra.count @ (np.log(s) + spectra.power / s) + restricted(spectra, s))


def _covariance(
    spectra: Spectra, value: Array, keys: Sequence[Variance], sought: Array
) -> dict[tuple[Variance, Variance], float]:
    """Covariance of the variances that were `sought`: the inverse of Whittle's information."""
    index = np.flatnonzero(sought)
    design = spectra.design[:, index] / np.maximum(spectra.design @ value, spectra.floor)[:, None]
    size = np.sqrt(np.maximum(np.sum(spectra.count[:, None] * design**2, axis=0), TINY))
    scaled = design / size
    inverse = np.linalg.pinv((scaled * spectra.count[:, None]).T @ scaled) / np.outer(size, size)
    return {
        (keys[i], keys[j]): float(inverse[a, b])
        for a, i in enumerate(index.tolist())
        for b, j in enumerate(index.tolist())
    }


def variances(spectra: Spectra, given: Array, *, tolerance: float = 0.0) -> Array:
    """Variances that minimise Whittle's likelihood by scoring; `given` ones (else NaN) are kept.

    `tolerance` is the relative change of the spectrum at which it ends early.
    """
    design, power, count, floor = spectra.design, spectra.power, spectra.count, spectra.floor
    fixed = np.isfinite(given)
    value = np.where(fixed, given, 0.0)
    offset = design @ value
    free = design[:, ~fixed]
    if not free.shape[1]:
        return value
    s = np.maximum(power, 1e-4 * floor) + offset
    solution = new = np.zeros(free.shape[1])
    for k in range(60):
        weight = np.sqrt(count) / s
        scale = np.sqrt(np.sum((free * weight[:, None]) ** 2, axis=0)) + TINY
        target = np.maximum(power - offset, 0.0) * weight
        new = _least(free * (weight[:, None] / scale), target, new) / scale
        solution = new if k == 0 else 0.5 * (solution + new)
        before, s = s, np.maximum(free @ solution + offset, floor)
        if np.all(np.abs(s - before) < tolerance * s):
            break
    value[~fixed] = solution
    return value


def _least(a: Array, b: Array, near: Array) -> Array:
    """Non-negative x that minimises |a x - b|; the one with the zeros of `near`, if it is."""
    held = near <= 0.0
    if not held.all():
        x = np.zeros(a.shape[1])
        x[~held], _, rank, _ = np.linalg.lstsq(a[:, ~held], b, rcond=None)
        if rank == np.sum(~held) and np.all(x[~held] > 0.0):
            # Lawson and Hanson's condition, columns of unit size: none held at zero would grow.
            if np.all(a[:, held].T @ (b - a @ x) <= 1e-12 * np.linalg.norm(b)):
                return x
    return non_negative(a, b)


def non_negative(a: Array, b: Array) -> Array:
    """(k,) non-negative x that minimises |a x - b|, for a (B, k) and b (B,)."""
    try:
        return np.asarray(nnls(a, b)[0])
    except RuntimeError:  # its active set cycles where columns are nearly dependent
        return np.asarray(lsq_linear(a, b, bounds=(0.0, np.inf)).x)


def _alike(
    responses: Sequence[Response], weights: Array, sources: list[str], candidates: Sequence[str]
) -> list[tuple[str, ...]]:
    """`candidates` in groups whose |G|^2 are multiples of one another, without those that are 0.

    Outputs, which may differ by orders of magnitude in SI, count in the criterion's weights. What
    acts on one output alone is not like what acts on that and on another.
    """
    groups: list[list[str]] = []
    if not sources:
        return []
    weighted = [r.gain2 * weights[:, None] ** 2 for r in responses]
    stacked = np.concatenate([g.reshape(-1, len(sources)) for g in weighted])
    logs = 0.5 * np.log(np.maximum(stacked, TINY))
    strong = stacked > 1e-6 * stacked.max(axis=0, initial=0.0)
    for name in candidates:
        j = sources.index(name)
        if not strong[:, j].any():
            continue
        for group in groups:
            head = sources.index(group[0])
            either = strong[:, j] | strong[:, head]
            if float(np.std(logs[either, j] - logs[either, head])) < 0.25:
                group.append(name)
                break
        else:
            groups.append([name])
    return [tuple(group) for group in groups]


def with_rounding(signals: Sequence[Signals], known: Mapping[str, float]) -> dict[str, float]:
    """The noise of channels that is known: of rounded inputs that of rounding, else as stated."""
    out: dict[str, float] = {}
    for d in signals:
        for name, sd in d.rounding.items():
            out[name] = max(sd, out.get(name, 0.0))
    return out | dict(known)


def known_sources(known: Mapping[str, float], model: Model) -> dict[str, float]:
    """The known noise of inputs, and of forces by their balances.

    The law of a state is a balance by the state's name, and so may be an output.
    """
    inputs = {name: known[name] for name in model.inputs if name in known}
    forces = {place: name_of_force(place) for place in model.balances}
    return inputs | {place: known[n] for place, n in forces.items() if n in known}


def given_variances(
    outputs: Sequence[str],
    sources: Sequence[str],
    known: Mapping[str, float],
    known_forces: Mapping[str, float],
) -> Array:
    """(ny + ns,) variances of outputs and sources that are known, NaN of the others."""
    sds = [known.get(n, np.nan) for n in outputs] + [known_forces.get(n, np.nan) for n in sources]
    return np.array(sds) ** 2


def error_over_noise(fit: Fit, noise: NoiseModel) -> float:
    """The largest error of an output over its white noise, both rms."""
    white = np.maximum(np.asarray(noise.output_sd, dtype=float), TINY)
    c = fit.criterion
    squares = [np.sum(c.simulated(fit.x, e).residual ** 2, axis=0) for e in range(len(c.data))]
    samples = np.sum([d.used.sum(axis=0) for d in c.data], axis=0)
    return float(np.max(np.sqrt(np.sum(squares, axis=0) / np.maximum(samples, 1)) / white))
