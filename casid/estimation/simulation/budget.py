"""The time that an estimate may take."""

from __future__ import annotations

from collections.abc import Sequence

from casid.data.experiment import Experiment
from casid.errors import DataError
from casid.estimation.simulation.thresholds import FIT_BUDGET
from casid.model.model import Model


def fit_budget(model: Model, experiments: Sequence[Experiment], budget: float | None) -> float:
    """Seconds that an estimate from these records may take: as given, or as long as they are.

    By default a sum of a constant and of a share for each sample and unknown, initial states among
    them, up to a longest time (`FIT_BUDGET`): what it takes grows with both.

    Raises
    ------
    DataError
        For a budget that is no time.
    """
    if budget is not None:
        if not budget > 0.0:
            raise DataError(
                f"budget = {budget:g} s is no time; give the seconds that the estimate may take, "
                "for example 600 (--budget 600)"
            )
        return budget
    unknowns = len(model.states) + sum(not p.is_known for p in model.parameters.values())
    values = unknowns * sum(e.record.N for e in experiments)
    return min(FIT_BUDGET.seconds + FIT_BUDGET.per_value * values, FIT_BUDGET.longest)
