"""Intervals by the parametric bootstrap: the estimator on records simulated with its own estimate.

The outputs are those of the fitted model with noise of the spectrum of the residual (its
autoregressions, correlated between outputs); where the bias of noise on inputs was removed, with
white noise of the sizes found on outputs and inputs. The interval is that of bias-corrected
percentiles (Efron 1987): it has the shape of the distribution of the estimates, whatever unknown a
curve makes of another.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter
from scipy.stats import norm

from casid.arrays import Array, BoolArray
from casid.data.experiment import Experiment
from casid.data.record import with_samples
from casid.errors import CasidError, OutOfTimeError
from casid.estimation.errors_in_variables.removal import (
    Corrected,
    with_spectral_weights,
    without_input_noise,
)
from casid.estimation.intervals.thresholds import BOOTSTRAP_RUNS, PROFILE_SEARCH
from casid.estimation.noise.residual_autoregressions import residual_autoregressions
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.input_noise.input_noise import with_input_noise
from casid.time_limit import seconds_left


@dataclass(frozen=True, slots=True, eq=False)
class Bootstrapped:
    """Estimates from simulated records.

    Attributes
    ----------
    names : of the unknowns.
    values : (runs, n) those of the fits that ended.
    failed, not_done : fits without an optimum, and those that no time was left for.
    """

    names: tuple[str, ...]
    values: Array
    failed: int
    not_done: int

    def interval(self, name: str, estimate: float) -> tuple[float, float]:
        """95 % interval of an unknown from bias-corrected percentiles of its values."""
        values = self.values[:, self.names.index(name)]
        least = 1 / (len(values) + 1)
        below = float(np.mean(values < estimate) + 0.5 * np.mean(values == estimate))
        shift = float(norm.ppf(np.clip(below, least, 1 - least)))
        reach = float(norm.ppf(0.5 + 0.5 * PROFILE_SEARCH.level))
        low, high = np.quantile(values, norm.cdf([2 * shift - reach, 2 * shift + reach]))
        return float(low), float(high)


def bootstrapped(
    found: Corrected,
    settings: FitSettings,
    known: Mapping[str, float],
    progress: Callable[[str], None] = lambda _: None,
) -> Bootstrapped | None:
    """The estimates from as many simulated records as `BOOTSTRAP_RUNS` has, or time allows.

    None where too few of them ended for an interval.

    Parameters
    ----------
    found : the estimate.
    settings : of its fit; the fits start from the estimate.
    known : channel -> standard deviation of its white noise, as for the estimate.
    """
    fit = found.fit
    draw = _Draw(found)
    quick = replace(settings, starts=1, substeps=fit.criterion.substeps)
    rows: list[Array] = []
    failed, runs = 0, BOOTSTRAP_RUNS.runs
    every = max(runs // 8, 1)
    for run in range(runs):
        if seconds_left() <= 0.0:
            break
        if run % every == 0:
            progress(f"bootstrap: {run} of {runs} simulated records")
        rng = np.random.default_rng((settings.seed, run))
        try:
            again = fit_model(
                fit.criterion.model, draw(rng), quick, start=fit.values, check_rank=False
            )
            if found.is_removed:
                again = without_input_noise(again, known, seed=settings.seed).fit
            elif found.weights is not None:
                again = with_spectral_weights(Corrected(again)).fit
        except OutOfTimeError:
            break
        except CasidError:
            failed += 1
            continue
        rows.append(again.x)
    if len(rows) < BOOTSTRAP_RUNS.least:
        return None
    return Bootstrapped(fit.criterion.names, np.array(rows), failed, runs - failed - len(rows))


class _Draw:
    """Records simulated with an estimate, each call others."""

    def __init__(self, found: Corrected) -> None:
        self.criterion, self.x = found.fit.criterion, found.fit.x
        self.input_sd = dict(found.input_sd or {}) if found.is_removed else {}
        self.output_sd = found.noise.output_sd if found.noise is not None else None
        n = range(len(self.criterion.data))
        self.clean = [self.criterion.simulated(self.x, e) for e in n]
        free = found.fit.solution.is_free
        self.models = None
        if self.output_sd is None:
            self.models = residual_autoregressions(found.fit, free)

    def __call__(self, rng: np.random.Generator) -> list[Experiment]:
        """The experiments of the fit with other outputs, and inputs where these have noise."""
        out = []
        for e, experiment in enumerate(self.criterion.experiments):
            record = experiment.record
            d = self.criterion.data[e]
            y = self.clean[e].y + d.relative_sizes * self._noise(d.used, rng)
            for i, name in enumerate(self.criterion.outputs):
                record = with_samples(record, name, y[:, i])
            record = with_input_noise(record, self.criterion, e, self.input_sd, rng)
            out.append(replace(experiment, record=record))
        return out

    def _noise(self, used: BoolArray, rng: np.random.Generator) -> Array:
        """(N, ny) noise of the outputs at the samples that they have, 0 elsewhere."""
        samples, ny = used.shape
        if self.models is None:
            assert self.output_sd is not None
            return np.asarray(self.output_sd * rng.standard_normal((samples, ny)))
        models, together = self.models
        before = min(samples, 1000)  # from which a decaying start has gone
        root = np.linalg.cholesky(together + 1e-12 * np.eye(ny))
        white = rng.standard_normal((samples + before, ny)) @ root.T
        out = np.zeros(used.shape)
        for i, m in enumerate(models):
            a = np.concatenate([[1.0], m.coefficients])
            column = lfilter([np.sqrt(m.variance)], a, white[:, i])[before:]
            out[used[:, i], i] = column[: int(used[:, i].sum())]
        return np.asarray(out / self.criterion.weights)
