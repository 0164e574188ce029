"""When a random disturbance explains a residual, and what an effect in its place is charged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import TINY
from casid.diagnosis.evidence.residual.residual_tests import depends_beyond_doubt
from casid.diagnosis.evidence.whitening.holding_bounds import held_beyond_chance
from casid.diagnosis.evidence.whitening.weighted_model import Weighted, minus_log_likelihood
from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.search.residual_check import is_more_than_noise
from casid.diagnosis.search.rounds import Search
from casid.estimation.simulation.minimization import Fit


def under_likelier_disturbance(search: Search, start: Weighted, fit: Fit) -> Weighted | None:
    """A model under the disturbances that its residual shows, where these may explain its misfit.

    None where the sensors' noise holds no misfit, where a bound holds a parameter beyond chance
    under them, too, which leaves misfit of its own, or where white noise is likelier.

    Parameters
    ----------
    start, fit : the model, under the sensors' noise and by its simulation error.
    """
    if not start.noise_absorbs_misfit:
        return None
    bare = search.under_disturbance(fit)
    if held_beyond_chance(bare.unbiased or bare.fit):
        return None
    return bare if minus_log_likelihood(bare) <= as_white(fit) else None


def explaining_disturbance(search: Search, start: Weighted, fit: Fit) -> Weighted | None:
    """A model under a disturbance with which its residual is random; None where none explains it.

    Parameters
    ----------
    start, fit : as for `under_likelier_disturbance`.
    """
    if not start.noise_absorbs_misfit or is_no_disturbance(search, fit):
        return None
    bare = under_likelier_disturbance(search, start, fit)
    if bare is None or is_more_than_noise(bare, search.with_disturbances()):
        return None
    return bare


def is_random(search: Search, fit: Fit) -> bool:
    """True if nothing but a random disturbance shows in what a fit leaves."""
    if is_no_disturbance(search, fit):
        return False
    return not is_more_than_noise(search.under_disturbance(fit), search.with_disturbances())


def is_no_disturbance(search: Search, fit: Fit) -> bool:
    """True if what a fit leaves depends on states or inputs, whatever disturbance acts as well.

    Its spectra are those that the residual shows there. To fit the model again under them, from
    several starts, takes ten times as long, and is of no use.
    """
    memory, of = search.memory, search.weighing.with_disturbances()
    if fit in memory.disturbed:
        return False
    if fit not in memory.shown:
        memory.shown[fit] = of.estimated(fit)
    here = memory.shown[fit]
    return depends_beyond_doubt(here, of.experiments, search.recorded, seed=of.seed)


def as_white(fit: Fit) -> float:
    """Minus the log-likelihood of a residual as white noise of its own size in each output.

    A disturbance that is less likely than that is no explanation: its estimate went astray.
    """
    c = fit.criterion
    parts = [np.where(d.used, c.simulated(fit.x, e).residual, 0.0) for e, d in enumerate(c.data)]
    samples = np.sum([d.used.sum(axis=0) for d in c.data], axis=0)
    squares = np.sum([np.sum(p**2, axis=0) for p in parts], axis=0)
    seen = samples > 0
    means = np.maximum(squares[seen] / samples[seen], TINY)
    return float(0.5 * np.sum(samples[seen] * (1 + np.log(means))))


def price_of(cost: int, samples: int, tested: int) -> float:
    """Penalty of an effect by the extended BIC, in units of twice the log-likelihood.

    Parameters
    ----------
    cost : parameters of the effect.
    tested : effects among which it was chosen.
    """
    return cost * math.log(samples) + 2 * math.log(max(tested, 1))


def pays(bare: Weighted, left: Weighted, causes: Sequence[Candidate], tested: int) -> bool:
    """True if causes beside a disturbance are likelier than a disturbance alone, for their price.

    Parameters
    ----------
    bare : the model as it is, under the disturbances of its residual.
    left : the extended model, under those that it leaves.
    tested : effects among which each cause was chosen.
    """
    n = bare.criterion.n_samples
    return _gain(bare, left) > sum(price_of(c.effect.cost, n, tested) for c in causes)


def pays_at_best(search: Search, fit: Fit, cause: Candidate, tested: int) -> bool:
    """True if a candidate pays beside what it leaves, and not by a maximum that is there without.

    Of several maxima of the likelihood the model alone may be at a lower one, with the disturbance
    in other places, say. The higher one that an extension leads to is kept as the model's.

    Parameters
    ----------
    fit : the model without the candidate, by its simulation error.
    """
    bare, left = search.under_disturbance(fit), search.under_disturbance(cause.fit)
    if not pays(bare, left, [cause], tested):
        return False
    best = search.with_disturbances().weighing.from_disturbance_of(bare, left)
    search.memory.disturbed[fit] = best
    return best is bare or pays(best, left, [cause], tested)


def _gain(bare: Weighted, left: Weighted) -> float:
    """Twice the gain in log-likelihood of an extended model, each under its own disturbances."""
    return 2 * (minus_log_likelihood(bare) - minus_log_likelihood(left, bare.criterion))


def with_lines_beside_disturbances(
    search: Search, fit: Fit, found: Sequence[Candidate], tested: int
) -> list[Candidate]:
    """Candidates none of which pays by what it leaves: lines with their gains beside disturbances.

    A choice without a parameter, as a hold is, pays by the least gain.
    In a sea a line and its neighbours are so narrow a band that what it takes out of the misfit
    counts as a few independent samples. The likelihoods tell it from a narrow band of waves.

    Parameters
    ----------
    fit : the model without the candidates, by its simulation error.
    tested : effects among which each was chosen.
    """
    if any(c.merit > 0 and c.unknowns for c in found):
        return list(found)
    out = []
    for c in found:
        if c.effect.kind == "periodic_disturbance":
            bare = search.under_disturbance(fit)
            gain = _gain(bare, search.under_disturbance(c.fit))
            cost = price_of(c.effect.cost, bare.criterion.n_samples, tested)
            c = replace(c, gain=gain, cost=cost) if gain > cost else c
        out.append(c)
    return sorted(out, key=lambda c: -c.merit)
