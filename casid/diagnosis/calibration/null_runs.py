"""One run of a calibration: a null record is drawn and diagnosed, in this process or in another."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from casid.campaigns.problem_origin import ProblemOrigin
from casid.data.problem import Problem
from casid.diagnosis.calibration.null_records import NullRecords, Recipe, null_noise
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.thresholds import CALIBRATING
from casid.diagnosis.verdict.cause import Cause, Ranked, Verdict
from casid.errors import CasidError
from casid.estimation.holdout import Split
from casid.estimation.simulation.minimization import Fit
from casid.time_limit import seconds_left

if TYPE_CHECKING:
    from numpy.random import SeedSequence


class Diagnosed(Protocol):
    """What a calibration reads of the diagnosis of a null record."""

    @property
    def verdict(self) -> Verdict:
        """The verdict."""
        ...

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The causes named."""
        ...

    @property
    def ranking(self) -> tuple[Ranked, ...]:
        """The first round's candidates."""
        ...


Diagnose = Callable[..., Diagnosed]
"""Called with problem and experiments, and `hold_out` and `false_alarm_rate` by name."""


def recipe_of(split: Split, at: Weighted, base_fit: Fit) -> Recipe:
    """What records are drawn from in which nothing is missing, for one problem and its records.

    Parameters
    ----------
    split : what was recorded, fitted and held out, with what is to be left out marked missing.
    at : the fitted model and its noise.
    base_fit : the fit of the model as it is.
    """
    noise = null_noise(at.full, at.criterion.outputs, at.input_sd)
    return Recipe.of(split, base_fit.criterion, (at.unbiased or at.fit).values, noise)


class NullRun:
    """One run of a calibration: draw a null record with a seed, and diagnose it."""

    def __init__(
        self, problem: Problem, recipe: Recipe, diagnose_null: Diagnose, alpha: float
    ) -> None:
        self.problem, self.recipe = problem, recipe
        self.diagnose_null, self.alpha = diagnose_null, alpha
        self.stop = threading.Event()
        self._records: NullRecords | None = None

    @property
    def records(self) -> NullRecords:
        """The null records, drawn by the recipe."""
        if self._records is None:
            self._records = NullRecords(self.problem.model, self.recipe)
        return self._records

    def __call__(self, seed: SeedSequence) -> dict[str, Any]:
        """Verdict, level of alarm and smallest adjusted p of one null record."""
        if self.stop.is_set():
            raise KeyboardInterrupt
        whole, apart = self.records.draw(np.random.default_rng(seed))
        d = self.diagnose_null(
            self.problem,
            whole,
            hold_out=apart or self.recipe.hold_out,
            false_alarm_rate=self.alpha,
        )
        if seconds_left() <= 0.0:
            raise KeyboardInterrupt  # ended in the middle: no answer
        smallest = min((r.adjusted for r in d.ranking), default=1.0)
        level = max(smallest, self.alpha)
        if d.verdict == "deficient":
            # An alarm at alpha, whatever p its causes have.
            level = min(
                min((c.p_value for c in d.causes), default=0.0), CALIBRATING.alarm * self.alpha
            )
        elif d.verdict == "undecided":
            level = 1.0
        return {"verdict": d.verdict, "level": float(level), "smallest": float(smallest)}

    def __reduce__(self) -> Any:
        origin = ProblemOrigin.of(self.problem)
        return _run_again, (origin, self.recipe, self.diagnose_null, self.alpha)


def _run_again(origin: ProblemOrigin, *rest: Any) -> NullRun:
    return NullRun(origin.problem(), *rest)


def can_travel(problem: Problem) -> bool:
    """True if another process gets the same problem from its file."""
    try:
        ProblemOrigin.of(problem).problem()
    except CasidError:
        return False
    return True
