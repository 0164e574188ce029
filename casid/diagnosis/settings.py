"""Settings of a diagnosis; those that mean nothing are refused before anything is fitted."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace

from casid.data.problem import Problem
from casid.diagnosis.solvers import EXACT
from casid.diagnosis.thresholds import BUDGET
from casid.errors import DataError, nearest
from casid.estimation.simulation.fit import FitSettings
from casid.model.effects.effect import KINDS
from casid.model.effects.user_effects import user_effects
from casid.time_limit import wall_clock

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class DiagnosisSettings:
    """Settings of the search for causes.

    Attributes
    ----------
    alpha : family-wise false-alarm rate of the whole catalogue.
    max_causes : the search stops there.
    without : kinds that are left out of the catalogue.
    fit : of the simulation-error fits.
    progress : called with a line of text at every step.
    budget : seconds that the diagnosis may take, from `began` of `wall_clock` on.
    calibration_ends : when the calibration has to end; it has no limit unless one is given.
    levels_by_outputs : whether levels of controlled inputs in gaps are estimated from outputs too.
    """

    alpha: float = 0.05
    max_causes: int = 4
    without: Collection[str] = ()
    fit: FitSettings = field(default_factory=FitSettings)
    progress: Progress = lambda _: None
    budget: float = math.inf
    began: float = field(default_factory=wall_clock)
    calibration_ends: float = math.inf
    levels_by_outputs: bool = True

    @property
    def refit(self) -> FitSettings:
        """Settings of a fit that starts next to its minimum: from that start alone."""
        return replace(self.fit, starts=1, solver=self.fit.solver or EXACT)

    @property
    def search_ends(self) -> float:
        """Time at which the search must end; the verdict needs the rest of the budget."""
        return self.began + BUDGET.search * self.budget

    @property
    def ends(self) -> float:
        """Time at which the diagnosis must end."""
        return self.began + self.budget


def require_settings(
    problem: Problem,
    false_alarm_rate: float,
    max_causes: int,
    without: Collection[str],
    budget: float | None = None,
) -> None:
    """Refuse settings of a diagnosis that mean nothing.

    Raises
    ------
    DataError
        For a rate outside (0, 1), fewer causes than one, a kind that there is none of, or a budget
        that is no time.
    """
    if budget is not None and not budget > 0.0:
        raise DataError(
            f"budget = {budget:g} s is no time; give the seconds that the diagnosis may take, for "
            "example 600 (--budget 600)"
        )
    if not 0.0 < false_alarm_rate < 1.0:
        raise DataError(
            f"false_alarm_rate = {false_alarm_rate:g} is no rate between 0 and 1; give the share "
            "of adequate models that may be called deficient, for example 0.05 "
            "(--false-alarm-rate 0.05)"
        )
    if max_causes < 1:
        raise DataError(
            f"max_causes = {max_causes}: the search looks for one cause at least; give 1 or more "
            "(--max-causes 4)"
        )
    if isinstance(without, str):
        raise DataError(
            f"without = {without!r} is one text; give kinds in a list, without=[{without!r}]"
        )
    kinds = sorted(KINDS | {e.kind for e in user_effects(problem.model, problem.effects)})
    for kind in without:
        if kind not in kinds:
            raise DataError(
                f"without {kind!r}: there is no such kind; there are {', '.join(kinds)}"
                f"{nearest(kind, kinds, is_listed=True)}"
            )
