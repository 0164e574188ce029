"""The estimate of a simulation-error fit: values, standard errors, measures of fit, provenance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.data.channel_quality import stuck_channels
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.data.reading.clocks.unit_of_time import is_open
from casid.estimation.estimate import Agreement, Estimate, Estimated
from casid.estimation.estimate_builder import EstimateBuilder, origin_of, solver_evidence
from casid.estimation.fit_statistics import nrmse_fit, rms
from casid.estimation.fitted.from_fit import fitted_model
from casid.estimation.holdout import HeldOut
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.record_agreement import disagreements
from casid.estimation.simulation.records.input_gaps import gap_notes
from casid.estimation.simulation.simulation_error import SimulationError, Whitener
from casid.estimation.simulation.thresholds import TANGENTS
from casid.model.model import Model

SOURCES = (
    "H. G. Bock, in Numerical Treatment of Inverse Problems, Birkhauser 1983: multiple shooting",
    "L. Ljung, System Identification, 2nd ed., Prentice Hall 1999: simulation error",
    "W. K. Newey, K. D. West, Econometrica 55 (1987) 703-708: robust covariance",
    "D. W. K. Andrews, Econometrica 59 (1991) 817-858: its bandwidth",
    "A. C. Aitken, Proc. Roy. Soc. Edinburgh 55 (1935) 42-48: generalised least squares",
    "M. G. Kenward, J. H. Roger, Biometrics 53 (1997) 983-997: the error of its weights",
    "J. A. Hausman, Econometrica 46 (1978) 1251-1271: whether a model is right for it",
    "R. Pintelon, J. Schoukens, System Identification, 2nd ed., Wiley 2012: errors in variables",
    "A. Waechter, L. T. Biegler, Math. Program. 106 (2006) 25-57: Ipopt",
    "J. A. E. Andersson et al., Math. Program. Comput. 11 (2019) 1-36: CasADi",
)
"""Papers behind the methods of an estimate."""


ASSUMES = (
    "autocorrelation-robust sandwich (Newey-West, {lags} lags): residuals of zero mean with a "
    "short correlation time compared with the record"
)
COLOURED = (
    "least squares under the spectrum of the residual, an autoregression of order {orders}: "
    "residuals of zero mean, stationary"
)
WEIGHTED = (
    "generalised least squares by the spectrum of the residual, an autoregression of order "
    "{orders}, whose own error is included: residuals of zero mean, stationary"
)
BIASED = "; the bias from noise on measured inputs is not included"
CORRECTED = (
    "errors in variables: sensors and measured inputs have white noise of the sizes found, whose "
    "own errors are included; the bias of the inputs' noise is removed"
)

INSTRUMENTED = (
    "instrumental variables: the reference is independent of all noise and disturbances, and the "
    "model is right for what it drives"
)


@dataclass(frozen=True, slots=True, eq=False)
class ErrorBars:
    """What the standard errors of a fit assume, and where they come from.

    Attributes
    ----------
    covariance : (n, n), in SI.
    whiten : by the spectrum that the covariance rests on.
    weigh : the same for columns that are fitted: white noise does not stand in for missing samples.
    """

    assumes: str
    covariance: Array
    whiten: Whitener | None = None
    weigh: Whitener | None = None

    def whitened(self, residual: Array, experiment: int) -> Array:
        """A weighted residual (N, ny) without the colour that it is to have."""
        if self.whiten is None:
            return residual
        return np.asarray(self.whiten(residual[:, :, None], experiment)[:, :, 0])


def channel_notes(model: Model, experiments: Sequence[Experiment]) -> list[str]:
    """Warnings of inputs with gaps, of a unit of time that was assumed, and of channels that are
    constant or at a limit.

    Inputs have to be so for a tenth of the record; commands may rest at a limit.
    """
    commands = [name for name, u in model.inputs.items() if u.kind == "known"]
    measured = [name for name in model.inputs if name not in commands]
    groups = ((measured, 0.1, True), (commands, 0.1, False), (model.outputs, 0.0, True))
    assumed = [
        f"{e.name}: {line.removeprefix('remark: ')}"
        for e in experiments
        for line in e.record.provenance
        if is_open(line.removeprefix("remark: "))
    ]
    units = model.declared_units
    return [*gap_notes(experiments), *assumed] + [
        f"{e.name}: {f.channel}: {f.text} {f.remedy}"
        for e in experiments
        for names, least, measured_ones in groups
        for f in stuck_channels(
            e.record, names, least=least, are_measured=measured_ones, units=units
        )
    ]


def estimate_of(
    problem: Problem,
    fit: Fit,
    held: Sequence[HeldOut] = (),
    *,
    bars: ErrorBars,
    method: str | None = None,
    notes: Sequence[str] = (),
) -> Estimate:
    """The `Estimate` of a fit: errors, fit, rank, whiteness, provenance."""
    criterion, solution = fit.criterion, fit.solution
    model = criterion.model
    builder = EstimateBuilder(problem.name, model, notes)
    units = {n: s.unit for n, s in model.states.items()}
    units |= {n: p.unit for n, p in model.parameters.items()}
    rows = [
        None  # inner nodes of multiple shooting
        if v.is_inner
        else Estimated(v.name, value, units[v.source], False, None, fit.begun.get(v.name, v.start))
        for v, value in zip(criterion.variables, fit.x.tolist(), strict=True)
    ]
    steep = steeper_than_simulation(criterion, fit.x, solution.hessian)
    uncertainty = builder.add_minimum(
        criterion, solution, rows, bars.covariance, bars.assumes, steep
    )
    for e, d in enumerate(criterion.data):
        at = criterion.simulated(fit.x, e)
        residual, error_e = at.residual, np.where(d.used, d.y - at.y, np.nan)
        builder.add_fits(d.name, criterion.outputs, np.where(d.used, d.y, np.nan), error_e)
        left = bars.whitened(residual * criterion.weights, e)
        for i, name in enumerate(criterion.outputs):
            where = f"{d.name}/{name}" if len(criterion.data) > 1 else name
            builder.add_whiteness(where, left[d.used[:, i], i])
    builder.warn_of_poor_fits()
    builder.warnings += disagreements(fit, bars.weigh)
    return builder.build(
        method or method_of(fit),
        uncertainty,
        solver_evidence(solution, fit.starts_tried, fit.starts_agreeing),
        origin_of(criterion.experiments, SOURCES),
        held_out=_held_out(criterion.outputs, held),
        model=fitted_model(problem, fit, uncertainty.covariance),
    )


def method_of(fit: Fit) -> str:
    """The name of the method."""
    segments = fit.criterion.segments
    shooting = "single shooting" if segments == 1 else f"multiple shooting ({segments})"
    return f"simulation error, {shooting}"


def _held_out(outputs: Sequence[str], held: Sequence[HeldOut]) -> Agreement:
    """RMS error and fit of what was held out."""

    def by_output(values: Array) -> dict[str, float]:
        return dict(zip(outputs, values.tolist(), strict=True))

    errors = {h.name: h.measured - h.simulated for h in held}
    return Agreement(
        {h.name: by_output(rms(errors[h.name])) for h in held},
        {h.name: by_output(nrmse_fit(h.measured, errors[h.name])) for h in held},
    )


_ROOT = float(np.sqrt(np.finfo(float).eps))  # the relative step of a difference quotient


def steeper_than_simulation(criterion: SimulationError, x: Array, hessian: Array) -> list[str]:
    """Unknowns whose tangents promise far more than the simulation does, a small step away.

    Every standard error takes the tangent of a simulation to be its slope. Where a model is
    singular or its steps are unstable, a tangent grows without bound while the simulation itself
    stays in its range: it changes direction at every rounding. J'J is then huge, and its inverse
    no covariance.

    Only where the criterion alone would determine one to within that step: others need no test.
    """
    found = []
    slope = np.sqrt(np.maximum(np.diag(hessian), 0.0))  # of the weighted simulation, all samples
    for i, v in enumerate(criterion.variables):
        h = _ROOT * abs(float(x[i]))
        if h == 0.0 or slope[i] * h <= 1.0:  # with errors of about one unit of their spread
            continue
        there = x.copy()
        there[i] += h
        total = 0.0
        with np.errstate(all="ignore"):
            for e, d in enumerate(criterion.data):
                moved = criterion.simulate(there, e)[0] - criterion.simulate(x, e)[0]
                total += float(np.sum((moved * d.used * criterion.weights) ** 2))
        if not slope[i] * h <= TANGENTS.ratio * np.sqrt(total):
            found.append(v.name)
    return found
