"""How much of the misfit each adopted effect explains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from casid.diagnosis.attempts import Attempts
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.candidates import Adopted, name_of, null_values, taken_out
from casid.estimation.simulation.minimization import DivergenceError, Fit
from casid.estimation.simulation.simulation_error import SimulationError


def contributions_of(
    weighing: Weighing, adopted: Sequence[Adopted], fit: Fit, attempts: Attempts
) -> list[float]:
    """Sum of squares that returns when each effect is taken out and the rest refitted.

    The rest starts where it is and, should that diverge or leave more than the model as it was
    before any effect, there: far from its minimum the fit of a long swing has others.
    """
    c, bare_values = fit.criterion, values_without_any(adopted, fit)
    out = []
    for a in adopted:
        null = null_values(a.candidate)
        less = partial(
            SimulationError,
            taken_out(c.model, null),
            weighing.experiments,
            own=[n for n in c.own if n not in null],
            weights=c.weights,
            whiten=c.whiten,
            substeps=c.substeps,
        )
        bare = less(start=bare_values)
        most = bare.evaluate(bare.start).value
        what = f"the share of {name_of(a.candidate.effect)}"
        left = attempts.attempt(what, partial(_left, weighing, less, fit, bare, most))
        if left is None:
            left = most if np.isfinite(most) else fit.solution.value
        out.append(max(left - fit.solution.value, 0.0))
    return out


def _left(
    weighing: Weighing,
    less: Callable[..., SimulationError],
    fit: Fit,
    bare: SimulationError,
    most: float,
) -> float:
    """Sum of squares without one effect, the rest refitted."""
    try:
        left = weighing.minimum(less(start=fit.values)).solution.value
    except DivergenceError:
        left = np.inf
    return left if left <= most else min(weighing.minimum(bare).solution.value, most)


def values_without_any(adopted: Sequence[Adopted], fit: Fit) -> dict[str, float]:
    """The model as it was before any effect, by the names of `fit`: effects at null values."""
    nothing = {k: v for a in adopted for k, v in null_values(a.candidate).items()}
    bounds = {name: fit.criterion.model.parameters[name] for name in nothing}
    start = adopted[0].before.fit.values if adopted and adopted[0].before else fit.values
    return {
        **start,
        **{k: float(np.clip(v, bounds[k].lower, bounds[k].upper)) for k, v in nothing.items()},
    }
