"""Algorithm 8.1 (Linder 2017): iterative joint instruments from one external reference.

Step A: black-box models from the reference to every recorded channel give the first instruments.
Step B, repeated: estimate all records jointly within bounds, fit an ARMA model to each record's
equation error, prefilter with its inverse, simulate the loop with the new estimate from the
reference and the black-box inputs, (8.85)-(8.86), for new instruments. Step C stops it, (8.93).
Step A is `black_box_reference`, steps B and C are `casid.estimation.moments.stages.stage`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.estimation.moments.instruments.black_box_reference import (
    BlackBoxReferences,
    black_box_instruments,
    black_box_references,
)
from casid.estimation.moments.instruments.instruments import Instruments
from casid.estimation.moments.instruments.reference_filter import Filter
from casid.estimation.moments.stages.convergence import Convergence
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.stages.prior import Prior
from casid.identification.moment_estimators import instrumental_variables
from casid.model.model import Model
from casid.presentation import Presented


@dataclass(frozen=True, slots=True)
class BlackBoxSettings:
    """Step A: black-box models from the reference, and the instruments made of them.

    Attributes
    ----------
    channels : that get a black box; None: all inputs and outputs of the model but the reference.
    structure, na, nb, nk : of the black boxes, see `black_box_references`.
    n_y, n_u, n_delta : lags, see `black_box_instruments`. Fewer make a sharper test of the
        instruments' relevance, and less bias, where excitation is poor.
    known : eliminated input -> filter from the reference; None: nothing, G_dv = 0.
    """

    channels: Sequence[str] | None = None
    structure: Literal["arx", "oe"] = "arx"
    na: int = 4
    nb: int = 5
    nk: int = 0
    n_y: int = 16
    n_u: int = 16
    n_delta: int = 2
    known: Mapping[str, Filter] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class IterativeJoint(Presented):
    """The estimate of Algorithm 8.1, and its iterations.

    Attributes
    ----------
    estimate : with intervals, tests and everything else that `instrumental_variables` gives.
    black_boxes : models from the reference, and the records with their signals.
    instruments : as used.
    convergence : parameters and noise models of each iteration.
    """

    estimate: MomentEstimate
    black_boxes: BlackBoxReferences
    instruments: Instruments
    convergence: Convergence

    def __getitem__(self, name: str) -> float:
        """The value of a parameter, SI."""
        return self.estimate[name]

    def std_error(self, name: str) -> float:
        """Standard error of a parameter."""
        return self.estimate.std_error(name)

    def __repr__(self) -> str:
        return f"<IterativeJoint {self.estimate.estimate.problem}: {self.convergence!r}>"


def iterative_joint(
    problem: Problem | Model,
    experiments: Sequence[Experiment] | Experiment,
    reference: str,
    *,
    black_boxes: BlackBoxSettings | None = None,
    prior: Prior | None = None,
    settings: MomentSettings | None = None,
    truth: Mapping[str, float] | None = None,
) -> IterativeJoint:
    """Estimate all records jointly by Algorithm 8.1.

    Parameters
    ----------
    problem : whose model has its unknown inputs eliminated (`Model.eliminate`).
    experiments : nominal, calibrated, loaded, ..., each with its load case.
    reference : recorded channel that nothing else in the experiment reaches.
    black_boxes : orders and lags of step A; default those of Linder (2017), section 9.5.
    settings : default ``MomentSettings(form="lifted", iterations=15, stopping="norm")``, prefilter
        1, as in section 9.5; ``noise_model=(na, nc)`` for step B (b). Lifted, the program is sound
        where coefficients are nearly dependent.
    truth : true values, for the columns of errors of the convergence table.

    Raises
    ------
    IdentifiabilityError
        If the parameters are not identifiable from these experiments (the family is named), or the
        reference does not excite a direction.
    DataError, ModelError, SolveError
        As `black_box_references` and `instrumental_variables`.
    """
    model = problem.model if isinstance(problem, Problem) else problem
    wanted = [c for c in (*model.outputs, *model.inputs) if c != reference]
    s = black_boxes or BlackBoxSettings()
    boxes = black_box_references(
        experiments,
        reference,
        s.channels or wanted,
        structure=s.structure,
        na=s.na,
        nb=s.nb,
        nk=s.nk,
    )
    instruments = black_box_instruments(
        model, boxes, n_y=s.n_y, n_u=s.n_u, n_delta=s.n_delta, known=s.known
    )
    chosen = settings or MomentSettings(form="lifted", iterations=15, stopping="norm")
    estimate = instrumental_variables(
        problem, boxes.experiments, instruments, prior=prior, settings=chosen
    )
    if boxes.notes:
        shown = replace(estimate.estimate, warnings=(*estimate.estimate.warnings, *boxes.notes))
        estimate = replace(estimate, estimate=shown)
    return IterativeJoint(estimate, boxes, instruments, Convergence.of(estimate.stages[0], truth))


def family_values(estimate: MomentEstimate) -> dict[str, float]:
    """Numbers for the formulas of a `Family`, SI: all parameters, and each record's load case.

    What a record knows has the record's name behind it there: zbar_m_calibration.
    """
    import re

    out = {p.name: p.value for p in estimate.estimate.in_si().parameters}
    for stage in estimate.stages:
        for part, values in zip(stage.parts, stage.values, strict=True):
            word = re.sub(r"\W+", "_", part.record).strip("_") or "record"
            out |= {f"{n}_{word}": float(values[n]) for n in part.known}
    return out
