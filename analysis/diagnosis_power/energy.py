"""How visible an effect is: the energy of the whitened misfit that no parameter can take away.

    lambda = 2 min_theta J(theta),   J = sum |E|^2 / (2 S)                                    (1)

over the fitted part of a record without noise, E the simulation error of the model without the
effect and S the spectrum that the true noise of the sensors leaves in it,

    S = sigma_y^2 + |G(theta)|^2 sigma_u^2.                                                   (2)

For an effect that spoils single samples there is nothing to fit. Of `saturation`, lambda is the
energy of what the clipping cut off: the squared distance of clipped from true samples, in units of
the output's noise; `jitter` and `multiplicative_noise`, which no catalogue has, alike.

The places of `outliers` are unknown, so that their own energy cannot be seen: a heavy tail can. A
sample is e + b h with e normal of sd 1, b one with the share q = 1 % and zero otherwise, and h of
either sign, its height even between 0.7 and 1.3 times the size. Whoever knows of no outliers takes
the samples as normal with a sd of their own; what is gained by knowing the true density f is

    lambda = 2 N E_f[log f - log n_v] = 2 N KL(f || n_v),   v = E_f[x^2] = 1 + q E[h^2]      (3)

with n_v the normal density of variance v, the nearest to f. This is the mean of twice the log
likelihood ratio, as (1) is. It is integrated over a fine grid.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping

import numpy as np
from scipy.integrate import simpson
from scipy.optimize import brentq
from scipy.stats import norm

import casid
from casid.data.experiment import Experiment
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.noise_response import noise_response
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit, minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError

FITTED = 0.7
"""Share of a record that is fitted, as `diagnose` has it by default."""

OF_SAMPLES = {"saturation", "outliers", "jitter", "multiplicative_noise"}
"""Kinds that spoil samples, each for itself."""

SHARE = 0.01
HEIGHTS = (0.7, 1.3)
"""Of the outliers: their share of the samples, and their heights in units of the size."""

HEIGHT_2 = (HEIGHTS[0] ** 2 + HEIGHTS[0] * HEIGHTS[1] + HEIGHTS[1] ** 2) / 3.0
"""Mean square of the heights."""

SUBSTEPS = 2
"""Runge-Kutta steps a sample: at 50 Hz and 7 rad/s the error stays far below the noise."""


def visible_energy(
    problem: casid.Problem,
    clean: casid.Record,
    sd: Mapping[str, float],
    start: Mapping[str, float],
) -> float:
    """(1) for a record without noise.

    Parameters
    ----------
    sd : the true noise of each sensor.
    start : the true parameters without the effect; the fit starts there.
    """
    return 2.0 * fit_with_true_noise(problem, clean, sd, start).solution.value


def fit_with_true_noise(
    problem: casid.Problem,
    clean: casid.Record,
    sd: Mapping[str, float],
    start: Mapping[str, float],
) -> Fit:
    """The model fitted to the first part of a record, whitened by (2) with the true noise."""
    part = clean.between(clean.t0, clean.t0 + (FITTED * clean.N - 0.5) * clean.Ts)
    experiments = [Experiment(part, {}, clean.name)]
    settings = FitSettings(starts=1, substeps=SUBSTEPS)
    fit = fit_model(
        problem.model, experiments, settings, start=start, check_rank=False, throw=False
    )
    for _ in range(2):
        criterion = fit.criterion
        response = noise_response(criterion, fit.x, 0)
        noise = NoiseModel(
            np.array([sd[name] for name in criterion.outputs]),
            {name: sd.get(name, 0.0) for name in response.sources},
            [response],
            criterion.weights,
        )
        white = SimulationError(
            problem.model,
            experiments,
            weights=criterion.weights,
            whiten=noise.whiten,
            substeps=criterion.substeps,
            start=fit.values,
        )
        fit = minimize_simulation_error(white, check_rank=False)
    return fit


def energy_of_samples(kind: str, strength: float, N: int) -> float:
    """Energy of an effect that spoils single samples of a record of N, of which a share is fitted.

    Parameters
    ----------
    strength : rms of what was added to all N samples, in units of the noise.
    """
    if kind == "outliers":
        size = strength / math.sqrt(SHARE * HEIGHT_2)
        return 2.0 * FITTED * N * divergence_of_outliers(size)
    return strength**2 * FITTED * N


@functools.lru_cache(maxsize=1024)
def divergence_of_outliers(size: float, share: float = SHARE) -> float:
    """KL(f || n_v) of (3) for a sample [-]; `size` in units of the noise.

    The integral is of the difference of the logarithms times f, which is smooth on the scale of
    the noise: Simpson's rule with 32 points a standard deviation.
    """
    if size < 1e-3:
        return 0.0  # it falls with the fourth power
    reach = 12.0 + HEIGHTS[1] * size
    x = np.linspace(0.0, reach, 2 * math.ceil(16.0 * reach) + 1)  # even in x
    low, high = (height * size for height in HEIGHTS)
    tall = [norm.cdf(s * x - low) - norm.cdf(s * x - high) for s in (1.0, -1.0)]
    f = (1.0 - share) * norm.pdf(x) + share * 0.5 * (tall[0] + tall[1]) / (high - low)
    sd = math.sqrt(1.0 + share * HEIGHT_2 * size**2)
    seen = f > 0.0
    ratio = np.zeros_like(x)
    ratio[seen] = np.log(f[seen]) - norm.logpdf(x[seen], scale=sd)
    return max(2.0 * float(simpson(f * ratio, x=x)), 0.0)


def strength_of_outliers(energy: float, N: int) -> float:
    """The rms of outliers over a record of N samples, in units of the noise, that has an energy."""

    def beyond(log_strength: float) -> float:
        return math.log(energy / energy_of_samples("outliers", math.exp(log_strength), N))

    return math.exp(brentq(beyond, math.log(0.05), math.log(1e3), xtol=1e-6))


def with_energy(row: Mapping[str, object]) -> dict[str, object]:
    """A row of the file of cases with the energies of its outliers as (3) has them.

    All that (3) needs is in the row, so that rows written under another definition need no run.
    """
    out = dict(row)
    N = row.get("N")
    if not isinstance(N, int):
        return out
    if row.get("kind") == "outliers" and isinstance(strength := row.get("strength"), float):
        out["energy"] = energy_of_samples("outliers", strength, N)
    second = row.get("second")
    if isinstance(second, Mapping) and second.get("kind") == "outliers":
        out["second_energy"] = energy_of_samples("outliers", float(second["strength"]), N)
    return out
