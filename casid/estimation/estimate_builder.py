"""Assembly of an `Estimate`: rows, warnings, fit and provenance, alike for every method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.estimation.covariance import sandwich
from casid.estimation.estimate import (
    Agreement,
    Bound,
    Estimate,
    Estimated,
    Identifiability,
    Origin,
    SolverEvidence,
    Trust,
    Uncertainty,
)
from casid.estimation.fit_statistics import nrmse_fit, poor_fit_text, rms
from casid.estimation.fitted.fitted_model import FittedModel
from casid.estimation.local_rank import LocalRank, describe_null, rank_of
from casid.estimation.nlp.solution import Solution
from casid.estimation.unknowns import Variable
from casid.estimation.whiteness import Meaning, Whiteness, measured_whiteness
from casid.model.model import Model
from casid.versions import versions

ONE_SIDED = 1.645
"""Standard errors of a normal estimate that 5 % exceed on one side."""


class Scored(Protocol):
    """A minimised sum over samples."""

    @property
    def variables(self) -> Sequence[Variable]:
        """The unknowns, n of them."""
        ...

    def scores(self, x: Array) -> Array:
        """(N, n) derivatives of each sample's term at x (n,)."""
        ...


def bound_of(solution: Solution, name: str) -> Bound:
    """The bound a variable is at, "lower" or "upper"; empty if none."""
    if name in solution.at_lower:
        return "lower"
    return "upper" if name in solution.at_upper else ""


def one_sided(row: Estimated, bound: Bound, error: float) -> Estimated:
    """A row at the end of a search, with the 95 % interval that is open beyond that end.

    `error` is the standard error that the row has where nothing holds it: the records prefer what
    lies beyond the end, so that an interval from the end leaves out less than its 5 %.
    """
    room = ONE_SIDED * error
    ends = (row.value - room, np.inf) if bound == "upper" else (-np.inf, row.value + room)
    note, kind = f"at {bound} bound of what was searched", "one-sided"
    return replace(row, std_error=None, ends=ends, interval_kind=kind, note=note, bound=bound)


def origin_of(experiments: Sequence[Experiment], sources: tuple[str, ...]) -> Origin:
    """Provenance of the records, versions of the packages, papers behind the methods."""
    lines = tuple(f"{e.name}: {line}" for e in experiments for line in e.record.provenance)
    return Origin(lines, versions(), sources)


class EstimateBuilder:
    """Collects what a method found and assembles the `Estimate`.

    Parameters
    ----------
    problem : name of the problem or model.
    warnings : that come before those of the estimate itself.
    units : name -> unit of what is fitted; default the outputs'.
    """

    def __init__(
        self,
        problem: str,
        model: Model,
        warnings: Sequence[str] = (),
        units: Mapping[str, str] | None = None,
    ) -> None:
        self.problem, self.model = problem, model
        self.warnings = list(warnings)
        self.units = units or {name: unit for name, (_, unit) in model.outputs.items()}
        self.identifiability = Identifiability(0, 0, 0.0)
        self._parameters: list[Estimated] = []
        self._initial_states: list[Estimated] = []
        self._rmse: dict[str, dict[str, float]] = {}
        self._nrmse: dict[str, dict[str, float]] = {}
        self._residuals: dict[str, Whiteness] = {}

    def add(
        self,
        row: Estimated,
        bound: Bound = "",
        *,
        determined: bool = True,
        is_state: bool = False,
        unheld: float = np.nan,
    ) -> None:
        """One row: without standard error at a bound, or where the data do not determine it.

        `unheld` is the standard error without the bound, where that is the end of a search.
        """
        if bound:
            if np.isfinite(unheld) and unheld > 0.0:
                row = one_sided(row, bound, unheld)
            else:
                note = f"at {bound} bound: no standard error"
                row = replace(row, std_error=None, note=note, bound=bound)
            self.warnings.append(
                f"{row.name} is at its {bound} bound: other standard errors are conditional on it"
            )
        elif not determined:
            row = replace(row, std_error=None, note="not identifiable at the estimate")
        (self._initial_states if is_state else self._parameters).append(row)

    def add_minimum(
        self,
        criterion: Scored,
        solution: Solution,
        rows: Sequence[Estimated | None],
        covariance: Array,
        assumes: str,
        steep: Sequence[str] = (),
    ) -> Uncertainty:
        """The unknowns of a minimum with their standard errors, its rank and its status.

        Parameters
        ----------
        rows : one for each unknown, its error still to be given; None where it is no result.
        covariance : (n, n), in SI.
        assumes : what the covariance assumes.
        steep : unknowns whose tangents are not the slopes of the simulation: no error is valid.
        """
        names = tuple(v.name for v in criterion.variables)
        if steep:
            covariance = np.zeros_like(covariance)
            self.warnings.append(
                f"no standard error is valid: a rounding of {' or '.join(steep)} changes the "
                "simulation as much as it can change, so that its sensitivities are no slopes. An "
                "inertia may come near zero, or the model be singular there: bound the parameters "
                "away from it, or simulate in segments"
            )
        rank = rank_of(criterion.variables, solution.hessian, solution.x)
        chaotic = "no standard error: the simulation is chaotic here"
        undetermined = {n for direction in rank.null for n in direction}
        sd = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
        unheld = {} if steep else self._unheld(criterion, solution)
        for v, row, error in zip(criterion.variables, rows, sd, strict=True):
            if row is not None:
                self.add(
                    replace(row, std_error=None, note=chaotic)
                    if steep
                    else replace(row, std_error=error),
                    bound_of(solution, v.name),
                    determined=bool(steep) or v.name not in undetermined,
                    is_state=v.source in self.model.states,
                    unheld=unheld.get(v.name, np.nan),
                )
        self.add_rank(rank)
        self.warn_unless_converged(solution)
        return Uncertainty(names, covariance, assumes)

    def _unheld(self, criterion: Scored, solution: Solution) -> dict[str, float]:
        """Standard errors of what ended at an end of its search, as they are without that end."""
        searched = [
            v.source in self.model.parameters
            and self.model.parameters[v.source].is_searched
            and bool(bound_of(solution, v.name))
            for v in criterion.variables
        ]
        if not any(searched):
            return {}
        covariance, _ = sandwich(
            solution.hessian,
            criterion.scores(solution.x),
            solution.is_free | np.array(searched),
            solution.constraint_jacobian,
        )
        errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        names = [v.name for v in criterion.variables]
        return {n: float(e) for n, e, s in zip(names, errors, searched, strict=True) if s}

    def add_known(self) -> None:
        """The parameters of the model that have a known value and no row yet."""
        present = {row.name for row in self._parameters}
        for p in self.model.parameters.values():
            if p.value is not None and p.name not in present:
                self._parameters.append(Estimated(p.name, p.value, p.unit, True))

    def add_rank(self, rank: LocalRank) -> None:
        """Identifiability at the estimate, with a warning if it is not full."""
        text = "" if rank.is_full else describe_null(rank)
        if text:
            self.warnings.append(text)
        self.identifiability = Identifiability(rank.rank, rank.unknowns, rank.smallest, text)

    def warn_unless_converged(self, solution: Solution) -> None:
        """A warning with the solver's status where it found no optimum."""
        if not solution.is_converged:
            self.warnings.append(f"{solution.ending}: {solution.remedy}")

    def add_fit(self, record: str, output: str, rmse: float, nrmse: float) -> None:
        """RMS error, and fit in per cent, of one output of one record."""
        self._rmse.setdefault(record, {})[output] = rmse
        self._nrmse.setdefault(record, {})[output] = nrmse

    def add_fits(self, record: str, outputs: Sequence[str], measured: Array, error: Array) -> None:
        """RMS error and fit of all outputs of a record; both arrays (N, ny), NaN where not used."""
        measures = zip(outputs, rms(error), nrmse_fit(measured, error), strict=True)
        for output, rmse, nrmse in measures:
            self.add_fit(record, output, float(rmse), float(nrmse))

    def warn_of_poor_fits(self) -> None:
        """A warning where the model explains next to nothing of an output."""
        if text := poor_fit_text(self._nrmse):
            self.warnings.append(text)

    def add_whiteness(
        self,
        where: str,
        residual: Array,
        what: str = "whiteness",
        coloured: Meaning = "incomplete",
    ) -> None:
        """How many of the first 20 autocorrelations of a residual lie outside the 95 % band."""
        self._residuals[where] = measured_whiteness(residual, what, coloured)

    def build(
        self,
        method: str,
        uncertainty: Uncertainty,
        solver: SolverEvidence,
        origin: Origin,
        *,
        held_out: Agreement | None = None,
        measured_by: str = Agreement().measured_by,
        evidence: Mapping[str, str] | None = None,
        model: FittedModel | None = None,
    ) -> Estimate:
        """The estimate; known parameters without a row are added to it."""
        self.add_known()
        return Estimate(
            problem=self.problem,
            method=method,
            parameters=tuple(self._parameters),
            initial_states=tuple(self._initial_states),
            uncertainty=uncertainty,
            solver=solver,
            fit=Agreement(self._rmse, self._nrmse, self._residuals, measured_by),
            held_out=held_out or Agreement(),
            identifiability=self.identifiability,
            units=self.units,
            warnings=tuple(dict.fromkeys(self.warnings)),
            origin=origin,
            trust=Trust(evidence or {}),
            model=model,
        )


def solver_evidence(solution: Solution, starts: int = 1, agreeing: int = 1) -> SolverEvidence:
    """The solver's evidence of an optimum, from its solution."""
    return SolverEvidence(
        solution.status,
        solution.is_converged,
        solution.iterations,
        solution.scaled_gradient,
        starts,
        agreeing,
    )
