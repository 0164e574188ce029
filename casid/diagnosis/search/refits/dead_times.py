"""Dead times that are far from zero: a scan in the place of a score.

The score of a delay is its effect to first order, which says nothing of one that is longer than
what moves the model: half a period of an oscillator turns its sign round. Where the model errs by
far more than its noise the delays up to the longest are tried one by one, the parameters moved from
their declared starts by a few Gauss-Newton steps. A refit then starts from the best of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.diagnosis.attempts import Attempts
from casid.diagnosis.evidence.scores.score_tests import Score, ScoreTable
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import name_of
from casid.diagnosis.search.refits.joint_refit import is_dead_time
from casid.diagnosis.search.refits.preselection import head_of
from casid.diagnosis.thresholds import DEAD_TIMES, RESTARTS
from casid.estimation.noise.variances import error_over_noise
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.effect import Effect


def with_far_dead_times(
    at: Weighted, experiments: Sequence[Experiment], table: ScoreTable, attempts: Attempts
) -> ScoreTable:
    """The table with the steps of dead times that a scan finds far from zero."""
    late = [s for s in table.scores if is_dead_time(s.effect)]
    if not late or error_over_noise(at.fit, at.noise) < RESTARTS.far:
        return table
    share = min(1.0, DEAD_TIMES.part / sum(d.N for d in at.criterion.data))
    heads = [e if share == 1.0 else head_of(e, share) for e in experiments]
    found: dict[tuple[str, str], Score] = {}
    # What was tried is refitted before what a first order promises.
    most = max(s.unrobust for s in table.scores)
    for s in late:
        best = attempts.attempt(name_of(s.effect), partial(best_delay, at, heads, s.effect))
        if best:
            found[s.effect.key] = replace(s, step=best, unrobust=most)
    return replace(table, scores=tuple(found.get(s.effect.key, s) for s in table.scores))


def best_delay(at: Weighted, experiments: Sequence[Experiment], effect: Effect) -> float:
    """The delay [s] that leaves least; 0 where none leaves clearly less than none does.

    From the declared starts; where a model with causes in it diverges from them, from its fit.
    """
    assert effect.limit is not None
    model, names = effect.extended(at.model)
    delays = np.linspace(0.0, effect.limit, DEAD_TIMES.delays + 1)
    for start in ({}, at.fit.values):
        c = SimulationError(
            model,
            experiments,
            own=[n for n in at.criterion.own if n in model.parameters],
            substeps=at.criterion.substeps,
            start=start,
        )
        place = c.names.index(names[0])
        left = np.array([_left(c, place, float(delay)) for delay in delays])
        if np.isfinite(left[0]):
            best = int(np.nanargmin(left))
            return float(delays[best]) if left[best] < DEAD_TIMES.less * left[0] else 0.0
    return 0.0


def _left(c: SimulationError, place: int, delay: float) -> float:
    """The criterion at a delay, after a few Gauss-Newton steps of everything else."""
    x = np.array(c.start)
    x[place] = delay
    others = np.array([i for i in range(len(x)) if i != place])
    lower = np.array([v.lower for v in c.variables])
    upper = np.array([v.upper for v in c.variables])
    value_of = c.value_alone
    assert value_of is not None  # one segment
    value = np.nan
    for _ in range(DEAD_TIMES.steps):
        e = c.evaluate(x)
        value = float(e.value)
        if not (np.isfinite(value) and np.all(np.isfinite(e.hessian))):
            return np.nan  # it diverges from there, or its derivatives do
        step = _gauss_newton(e.hessian[np.ix_(others, others)], e.gradient[others])
        for shorter in (1.0, 0.5, 0.25):
            new = x.copy()
            new[others] = np.clip(x[others] + shorter * step, lower[others], upper[others])
            after = value_of(new)
            if after < value:
                x, value = new, after
                break
        else:
            break
    return value


def _gauss_newton(hessian: Array, gradient: Array) -> Array:
    size = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    scaled = hessian / np.outer(size, size)
    return np.asarray(-np.linalg.lstsq(scaled, gradient / size, rcond=1e-8)[0] / size)
