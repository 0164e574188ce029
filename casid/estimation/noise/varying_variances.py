"""The likeliest variances of noise whose response changes along a record.

With e the innovation of each output at each sample, given all before, over its standard deviation
s, minus the log-likelihood and Fisher's information of the logarithms of variances are

    sum e^2 / 2 + log s,    I_kl = E sum (de/dk) (de/dl) + (dlog s/dk) (dlog s/dl)            (1)

(A. C. Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, section 3.4,
where the information is in terms of innovations that are not divided by s). One more filter a
variance gives the derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import TINY, Array, BoolArray
from casid.estimation.noise.noise_model import NoiseModel, Variance
from casid.estimation.noise.noise_response import Steps, joined_steps
from casid.estimation.noise.thresholds import VARYING_RESPONSE
from casid.estimation.noise.variances import known_sources
from casid.estimation.noise.varying_innovations import (
    VaryingInnovations,
    process_of,
    varying_innovations,
)
from casid.estimation.noise.whittle_scoring import At, impossible, minimum
from casid.estimation.simulation.records.signals import Signals
from casid.estimation.simulation.simulation_error import SimulationError


def filters_along(
    noise: NoiseModel, steps: Sequence[Steps], data: Sequence[Signals] = ()
) -> list[VaryingInnovations] | None:
    """The filters along the steps of each experiment; None where they diverge.

    Parameters
    ----------
    data : whose samples count; default all.
    """
    of = noise.output_sd, noise.source_sd, noise.spectra, noise.weights
    used = [_where_missing(d) for d in data] or [None] * len(steps)
    with np.errstate(all="ignore"):
        try:
            return [
                varying_innovations(joined_steps(s, noise.spectra), *of, used=u)
                for s, u in zip(steps, used, strict=True)
            ]
        except np.linalg.LinAlgError:
            return None


def weighted(noise: NoiseModel, data: Sequence[Signals], residuals: Sequence[Array]) -> list[Array]:
    """Residuals (N, ny) of each experiment as columns (N, ny, 1) that filters take."""
    return [
        (np.where(d.used, r, 0.0) * noise.weights)[:, :, None]
        for d, r in zip(data, residuals, strict=True)
    ]


def is_white(noise: NoiseModel, data: Sequence[Signals], residuals: Sequence[Array]) -> bool:
    """Whether residuals (N, ny) are noise of unit size under a noise, up to chance.

    By the mean square of what every output adds to those before it.
    """
    columns = weighted(noise, data, residuals)
    with np.errstate(all="ignore"):
        squares = sum(np.sum(noise.whiten(c, e) ** 2, axis=(0, 2)) for e, c in enumerate(columns))
    count = sum(d.used.sum(axis=0) for d in data)
    return bool(
        np.all(np.abs(squares - count) <= VARYING_RESPONSE.by_chance * np.sqrt(2.0 * count))
    )


def with_likeliest_variances(
    noise: NoiseModel,
    steps: Sequence[Steps],
    criterion: SimulationError,
    residuals: Sequence[Array],
) -> NoiseModel:
    """The noise with the likeliest variances along a path, by Fisher scoring, and their errors.

    Variances that are known stay, and those of sources that are too small to count.

    Parameters
    ----------
    noise : with innovations along the path (`NoiseModel.varying`), to begin with.
    steps : of each experiment.
    residuals : (N, ny) an experiment.
    """
    search = _Likelihood(noise, steps, criterion, residuals)
    none = np.zeros(0)
    z, at = minimum(search.at, search.start(), none, none)
    found = search.scaled(z)
    filters = filters_along(found, steps)
    if filters is None:
        return noise
    size = np.sqrt(np.maximum(np.diag(at.information), TINY))
    inverse = np.linalg.pinv(at.information / np.outer(size, size), hermitian=True)
    factor = search.variances(found) / size  # from logarithms of unit size
    covariance = {
        (a, b): float(factor[i] * inverse[i, j] * factor[j])
        for i, a in enumerate(search.keys)
        for j, b in enumerate(search.keys)
    }
    return replace(found, varying=filters, covariance={**found.covariance, **covariance})


class _Likelihood:
    """(1) over the logarithms of variances, relative to those to begin with."""

    def __init__(
        self,
        noise: NoiseModel,
        steps: Sequence[Steps],
        criterion: SimulationError,
        residuals: Sequence[Array],
    ) -> None:
        self.noise, self.data = noise, criterion.data
        moving = [n for n, sd in noise.source_sd.items() if sd > 0.0]
        joined = [joined_steps(s, noise.spectra) for s in steps]
        self.processes = [process_of(s, moving, noise.spectra, noise.weights) for s in joined]
        self.columns = weighted(noise, self.data, residuals)
        outputs, stated = criterion.outputs, known_sources(noise.known, criterion.model)
        self.outputs = [i for i, n in enumerate(outputs) if n not in noise.known]
        self.sources = [
            n
            for n in noise.source_sd
            if n not in stated and noise.makes(n, VARYING_RESPONSE.noticeable, self.data)
        ]
        self.keys: list[Variance] = [("output", outputs[i]) for i in self.outputs]
        self.keys += [("source", n) for n in self.sources]

    def variances(self, noise: NoiseModel) -> Array:
        """Variances that are estimated, in the order of `keys`."""
        sds = [*noise.output_sd[self.outputs], *(noise.source_sd[n] for n in self.sources)]
        return np.array(sds) ** 2

    def scaled(self, z: Array) -> NoiseModel:
        """The noise with its variances times exp(z)."""
        output_sd = self.noise.output_sd.copy()
        sds = np.sqrt(self.variances(self.noise) * np.exp(z))
        output_sd[self.outputs] = sds[: len(self.outputs)]
        moved = dict(zip(self.sources, sds[len(self.outputs) :].tolist(), strict=True))
        source_sd = {**self.noise.source_sd, **moved}
        return replace(self.noise, output_sd=output_sd, source_sd=source_sd)

    def start(self) -> Array:
        """The variances to begin with, all times one factor where that is likelier.

        Under variances all times a factor, innovations are the same times the inverse of its root:
        the likeliest factor is their mean square (Harvey, section 3.4). It is the factor of all
        but those that are known.
        """
        none = np.zeros(len(self.keys))
        here = self._innovations(none)
        count = sum(int(d.used.sum()) for d in self.data)
        squares = sum(float(np.sum(e**2)) for e, _ in here)
        if not here or not squares > 0.0:
            return none
        there = none + np.log(squares / count)
        return there if _value(self._innovations(there)) < _value(here) else none

    def at(self, z: Array) -> At:
        """Value, gradient and information at a point."""
        n = len(z)
        here = self._innovations(z)
        beside = [self._innovations(z + VARYING_RESPONSE.difference * step) for step in np.eye(n)]
        value, gradient, information = _value(here), np.zeros(n), np.zeros((n, n))
        for k in range(len(self.data)):
            if not all(beside) or not here:
                return impossible(n)
            e, logs = here[k]
            de = np.array([(b[k][0] - e).ravel() for b in beside]) / VARYING_RESPONSE.difference
            dlogs = (
                np.array([(b[k][1] - logs).ravel() for b in beside]) / VARYING_RESPONSE.difference
            )
            gradient += de @ e.ravel() - dlogs.sum(axis=1)
            information += de @ de.T + dlogs @ dlogs.T
        is_finite = np.isfinite(value) and np.all(np.isfinite(information))
        return At(value, gradient, information) if is_finite else impossible(n)

    def _innovations(self, z: Array) -> list[tuple[Array, Array]]:
        """e (N, ny) and -log s of each experiment; none where the filters diverge."""
        at = self.scaled(z)
        sizes, out = (at.output_sd * at.weights, at.source_sd), []
        with np.errstate(all="ignore"):
            try:
                for process, d, columns in zip(
                    self.processes, self.data, self.columns, strict=True
                ):
                    of = VaryingInnovations(process.under(*sizes), _where_missing(d))
                    out.append((of.whiten(columns)[:, :, 0], of.log_roots))
            except np.linalg.LinAlgError:
                return []
        return out


def _where_missing(data: Signals) -> BoolArray | None:
    """(N, ny) the samples that there are; None where none lacks."""
    return None if data.used.all() else data.used


def _value(innovations: Sequence[tuple[Array, Array]]) -> float:
    """Minus the log-likelihood of e and -log s of each experiment; infinite of none."""
    squares = [0.5 * float(np.sum(e**2)) - float(np.sum(logs)) for e, logs in innovations]
    return sum(squares) if squares else np.inf
