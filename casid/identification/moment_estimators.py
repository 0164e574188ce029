"""Least squares and instrumental variables for physical parameters: joint and in stages.

The estimators of Linder (2017), chapters 5 and 7, for any model whose unknown inputs have been
eliminated: the records become moment equations (`moment_equations`), the parameters the
solution of a small program (`moment_nlp`), refined over instruments and noise models
(`stage`), with the noise of every record followed to every parameter (`propagation`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from casid.argument_types import names_wrong_types
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.errors import ModelError
from casid.estimation.moments.instruments.instruments import Instruments
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.stages.prior import Prior
from casid.estimation.moments.stages.stage_plan import StageSpec
from casid.estimation.moments.stages.staged_estimation import Programs, StagedEstimation
from casid.identifiability.requirement import require_identifiable
from casid.model.model import Model


@names_wrong_types()
def least_squares(
    problem: Problem | Model,
    experiments: Sequence[Experiment] | Experiment,
    *,
    free: Sequence[str] | None = None,
    settings: MomentSettings | None = None,
) -> MomentEstimate:
    """Least squares on the difference equations, (2.39) with the physics as constraints.

    Fast and of small variance, but biased where outputs or inputs carry noise, or a loop is closed:
    a start for the others, and a measure of the benefit of instruments. Parameters and errors as
    `instrumental_variables`; where the records are not excited, which instruments refuse, the
    estimate has a warning.

    Parameters
    ----------
    problem, experiments, free, settings : as in `instrumental_variables`.
    """
    stages = [StageSpec(free or ())]
    return _estimate(StagedEstimation(problem, stages, settings=settings), experiments)


@names_wrong_types()
def instrumental_variables(
    problem: Problem | Model,
    experiments: Sequence[Experiment] | Experiment,
    instruments: Instruments,
    *,
    free: Sequence[str] | None = None,
    prior: Prior | None = None,
    settings: MomentSettings | None = None,
) -> MomentEstimate:
    """All records at once: joint (extended, refined) instrumental variables, Approach 5.2.

    Parameters
    ----------
    problem : whose model has no unknown inputs left (`Model.eliminate`).
    experiments : each with its load case; sample times may differ.
    instruments : the external reference, and the lags.
    free : parameters to estimate; default those that the model declares unknown.
    prior : known values with their uncertainty, which is propagated.
    settings : of the programs that are solved; `MomentSettings`.

    Returns
    -------
    MomentEstimate

    Raises
    ------
    IdentifiabilityError
        If the parameters are not identifiable, or the instruments not relevant in a direction.
    DataError, ModelError, SolveError
        For unusable records, models and programs without an optimum.

    Notes
    -----
    Consistent for any noise that is independent of the reference, in closed loop and with noise on
    the measured inputs (Linder 2017, (2.44)). The covariance is the sandwich of (2.57)-(2.59).
    """
    stages = [StageSpec(free or ())]
    return _estimate(StagedEstimation(problem, stages, instruments, prior, settings), experiments)


def multistage(
    problem: Problem | Model,
    experiments: Sequence[Experiment] | Experiment,
    stages: Sequence[StageSpec],
    instruments: Instruments | None = None,
    *,
    prior: Prior | None = None,
    settings: MomentSettings | None = None,
) -> MomentEstimate:
    """One stage after the other, each given the ones before (Approaches 5.1 and 7.1).

    Parameters
    ----------
    problem, experiments, prior, settings : as in `instrumental_variables`.
    stages : in order; by default each is solved in the linear form.
    instruments : None: least squares.

    Returns
    -------
    MomentEstimate
        Its covariance propagates the earlier stages, which Linder (2017) takes as exact;
        `std_error(name, propagated=False)` gives the errors without.

    Raises
    ------
    ModelError
        If two stages estimate one parameter; else as `instrumental_variables`.
    """
    if not stages:
        raise ModelError("multistage: no stage given; name one with StageSpec(free=[...])")
    names = [n for s in stages for n in s.free]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise ModelError(
            f"multistage: {twice[0]} is estimated in two stages; leave it to the first of them, "
            "or estimate jointly with instrumental_variables"
        )
    chosen = settings or MomentSettings(form="linear")
    return _estimate(StagedEstimation(problem, stages, instruments, prior, chosen), experiments)


def _estimate(
    estimation: StagedEstimation,
    experiments: Sequence[Experiment] | Experiment,
    answers: dict[Any, str] | None = None,
) -> MomentEstimate:
    """Read the records of all stages, refuse what is not identifiable, and estimate.

    Parameters
    ----------
    answers : about identifiability, of earlier records with the same load cases.
    """
    chosen = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    answers = {} if answers is None else answers
    stages = estimation.read(chosen)
    for stage in stages:
        if stage.question not in answers:
            answers[stage.question] = require_identifiable(
                estimation.model, stage.experiments, free=stage.free
            )
    structural = "; ".join(dict.fromkeys(answers[stage.question] for stage in stages))
    return estimation.estimate(chosen, stages, structural)


@dataclass(frozen=True, slots=True, eq=False)
class Reusable:
    """A multistage or joint estimator whose programs are built once, for many data sets.

    Example
    -------
    ``estimator = Reusable(problem, stages, instruments); estimator(experiments)`` gives what
    `multistage` gives, at the cost of the data alone from the second call on.
    ``dataclasses.replace(estimator, prior=...)`` has the same programs and another prior.
    """

    problem: Problem | Model
    stages: Sequence[StageSpec]
    instruments: Instruments | None = None
    prior: Prior | None = None
    settings: MomentSettings | None = None
    _programs: Programs = field(default_factory=Programs)
    _answers: dict[Any, str] = field(default_factory=dict)

    def __call__(self, experiments: Sequence[Experiment] | Experiment) -> MomentEstimate:
        """The estimate from records of the same names, load cases and sample times."""
        estimation = StagedEstimation(
            self.problem, self.stages, self.instruments, self.prior, self.settings, self._programs
        )
        return _estimate(estimation, experiments, self._answers)
