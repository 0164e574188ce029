"""Monte Carlo studies: a problem simulates itself, many times, and is estimated every time.

What a covariance promises can be seen: estimates scatter as their standard errors say, and 95 % of
the intervals cover the truth, or they do not. Bias and coverage have errors of their own, since
runs are finite; they stand beside the numbers.
"""

from __future__ import annotations

import contextlib
import math
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.campaigns.accuracy import ENDS, STD_ERROR, Accuracy, accuracy
from casid.campaigns.campaign import Campaign, campaign
from casid.campaigns.manifest import manifest_of, name_of
from casid.campaigns.problem_origin import ProblemOrigin, digest
from casid.data.experiment import Experiment
from casid.data.problem import Problem, load_problem
from casid.errors import DataError, ModelError, OutOfTimeError, SolveError, UnknownNameError
from casid.estimation.estimate import Estimate
from casid.estimation.nlp.solver import _is_installed, as_solver
from casid.estimation.simulation.fit import FitSettings
from casid.identification.identify import identify
from casid.model.model import Model
from casid.presentation import Presented, present, write
from casid.saving.saved import Saved
from casid.time_limit import out_of_time_text, until, wall_clock

if TYPE_CHECKING:
    from numpy.random import SeedSequence

Method = Callable[[Problem, Sequence[Experiment], FitSettings], Any]
"""Returns a `casid.Estimate`, or what carries one as `.estimate` (`casid.MomentEstimate`, ...)."""


def simulation_error(
    problem: Problem, experiments: Sequence[Experiment], settings: FitSettings
) -> Estimate:
    """Estimate as `casid.identify` does."""
    return identify(problem, experiments, settings=settings)


METHODS: dict[str, Method] = {"identify": simulation_error}
"""What a study may estimate with, by name."""


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarlo(Presented, Saved):
    """The result of a study: every estimate, and how well each parameter is estimated.

    Attributes
    ----------
    campaign : the runs, each with its estimates and standard errors, or why it failed.
    parameters : bias, spread, RMS error and coverage of the intervals, each in its unit;
        `study["k"]` is that of one.
    settings, versions : what the runs were made with.
    """

    problem: str
    method: str
    campaign: Campaign
    parameters: tuple[Accuracy, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    sources: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Accuracy:
        """How well the parameter `name` is estimated."""
        for p in self.parameters:
            if p.name == name:
                return p
        raise UnknownNameError(
            f"no parameter {name!r}; there are {', '.join(p.name for p in self.parameters)}"
        )

    def estimates(self, name: str) -> Array:
        """(n,) the estimates of a parameter, failed runs left out, in its unit."""
        return self.campaign.column(self[name].name)

    @property
    def not_done(self) -> tuple[str, ...]:
        """What the budget of time left no time for."""
        left = self.campaign.not_done
        return (f"{left} of {left + self.campaign.runs} runs",) if left else ()

    @property
    def failures(self) -> dict[str, int]:
        """Message -> runs that failed with it, the commonest first."""
        return dict(Counter(self.campaign.failures.values()).most_common())

    def references(self) -> tuple[str, ...]:
        """The papers behind the methods used."""
        return self.sources

    def to_json(self) -> dict[str, Any]:
        """The content of `montecarlo.json` (schema casid.montecarlo/1)."""
        return {
            "schema": "casid.montecarlo/1",
            "problem": self.problem,
            "method": self.method,
            "seed": self.campaign.seed,
            "runs": self.campaign.runs,
            "failed": len(self.campaign.failures),
            "failures": self.failures,
            "not_done": list(self.not_done),
            "parameters": {p.name: p.to_json() for p in self.parameters},
            "settings": dict(self.settings),
            "versions": dict(self.versions),
        }

    def __repr__(self) -> str:
        remarks = sum(bool(p.remarks) for p in self.parameters)
        return (
            f"<MonteCarlo {self.problem}: {self.campaign.runs} runs, "
            f"{len(self.campaign.failures)} failed, {len(self.parameters)} parameters, "
            f"{remarks} with remarks>"
        )

    def plot(self) -> Any:
        """Histograms of the estimates with truth and reported normal density, Plotly."""
        return present(self, "figure")

    def write(self, folder: str | Path) -> Path:
        """Write `montecarlo.json` and `report.html` into `folder`; returns the former's path."""
        return write(self, folder).with_name("montecarlo.json")


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """What every run of a study does: simulate the problem, estimate it.

    Parameters
    ----------
    problem : with `simulate`. Worker processes load it again from its file; one that was changed
        since, or never had a file, can be studied in one process alone.
    method : a name of `METHODS`, or a function of problem, experiments and settings that returns a
        `casid.Estimate`, or what carries one as `.estimate`.
    settings : how a fit is sought.
    duration : use the first seconds of every record alone [s]; None: whole records.

    Raises
    ------
    DataError
        If the problem has no simulator, or there is no such method.
    SolveError
        If there is no such solver.
    """

    problem: Problem
    method: str | Method = "identify"
    settings: FitSettings | None = None
    duration: float | None = None

    def __post_init__(self) -> None:
        if self.settings is None:
            object.__setattr__(self, "settings", FitSettings(starts=self.problem.starts))
        if self.problem.simulate is None:
            self.problem.simulated(0)  # says how to give it one
        if isinstance(self.method, str) and self.method not in METHODS:
            raise DataError(f"no method {self.method!r}; there are {', '.join(METHODS)}")
        solver = as_solver(self.fit_settings.solver)
        if not _is_installed(solver.name):  # now, and not in every run
            raise SolveError(
                f"solver {solver.name!r} is no CasADi plug-in that loads here; use 'ipopt' or "
                "'sqpmethod', as Solver(name), or on the command line --solver name"
            )
        if self.duration is not None and not self.duration > 0:
            raise DataError(f"duration = {self.duration} s; give a positive number of seconds")
        if not any(not p.is_known for p in self.problem.model.parameters.values()):
            raise DataError(
                f"problem {self.problem.name} has no unknown parameter left to estimate; set fewer"
            )
        self._require_reachable_truth()

    def _require_reachable_truth(self) -> None:
        """Refuse a truth outside the bounds, which no estimate and no interval reaches."""
        model = self.problem.model
        for name, true in model.in_si(self.problem.truth).items():
            p = model.parameters[name]
            if not (p.is_known or p.lower <= true <= p.upper):
                low, high = (model.shown(name, x) for x in (p.lower, p.upper))
                raise DataError(
                    f"problem {self.problem.name}: the truth of {name}, "
                    f"{self.problem.truth[name]:g} {model.unit_of(name)}, lies outside its bounds, "
                    f"{low:g} to {high:g}; correct the truth, or widen the bounds"
                )

    def __call__(self, seed: SeedSequence) -> dict[str, Any]:
        """One run: the estimates and their standard errors, in the parameters' units."""
        number = int(seed.generate_state(1, np.uint64)[0])
        with contextlib.redirect_stdout(sys.stderr):  # standard output is for the result
            experiments = [self._cut(e) for e in self.problem.simulated(number)]
            method = METHODS[self.method] if isinstance(self.method, str) else self.method
            estimate = _estimate_in(method(self.problem, experiments, self.fit_settings))
        if estimate.not_done:  # what was cut off is no estimate of this study
            raise OutOfTimeError(out_of_time_text(estimate.not_done))
        row: dict[str, Any] = {}
        for p in estimate.parameters:
            if not p.known:
                row[p.name] = p.value
                row[p.name + STD_ERROR] = p.std_error
                if p.interval is not None:
                    row |= {p.name + end: v for end, v in zip(ENDS, p.interval, strict=True)}
        row |= {"converged": estimate.is_converged, "iterations": estimate.iterations}
        for record, by_output in estimate.rmse.items():
            row |= {f"rmse {record}/{output}": value for output, value in by_output.items()}
        return row

    def __reduce__(self) -> Any:
        origin = ProblemOrigin.of(self.problem)
        return _study_again, (origin, self.method, self.settings, self.duration)

    @property
    def fit_settings(self) -> FitSettings:
        """The settings of a fit, by default with the problem's number of starts."""
        assert self.settings is not None
        return self.settings

    @property
    def described(self) -> dict[str, Any]:
        """What the results of a run depend on besides its seed, as plain values."""
        fit = self.fit_settings
        model = self.problem.model
        return {
            "problem": self.problem.name,
            "problem sha256": digest(self.problem),
            "method": self.method if isinstance(self.method, str) else name_of(self.method),
            "duration": self.duration,
            "starts": fit.starts,
            "segments": fit.segments,
            "substeps": fit.substeps,
            "own": list(fit.own),
            "constraints": [name_of(c) for c in fit.constraints],
            "seed of the starts": fit.seed,
            "solver": asdict(as_solver(fit.solver)),
            "known": {n: p.value for n, p in model.parameters.items() if p.is_known},
        }

    def manifest(self, seed: int) -> dict[str, Any]:
        """What a folder of this study has in `campaign.json`."""
        return manifest_of(self, seed, self.described)

    def run(
        self,
        runs: int,
        *,
        seed: int = 0,
        out: str | Path | None = None,
        resume: bool = True,
        progress: bool | Callable[[str], None] = False,
        budget: float | None = None,
    ) -> MonteCarlo:
        """Do the runs through joblib, as `campaign.campaign` does, and sum them up.

        Parameters are those of `montecarlo`.
        """
        if budget is not None and not budget > 0.0:
            raise DataError(
                f"budget = {budget:g} s is no time; give the seconds that the study may take, for "
                "example 600 (--budget 600)"
            )
        with until(math.inf if budget is None else wall_clock() + budget):
            done = campaign(
                self,
                runs,
                seed=seed,
                out=out,
                resume=resume,
                settings=self.described,
                progress=progress,
            )
        if not done.runs:
            raise OutOfTimeError(
                f"{self.problem.name}: no run ended within the budget of time; raise it "
                "(--budget SECONDS)"
            )
        failures = Counter(done.failures.values())
        if len(done.failures) == done.runs:
            message, n = failures.most_common(1)[0]
            raise SolveError(f"all {done.runs} runs failed, {n} of them with: {message}")
        from casid.estimation.simulation_estimate import SOURCES
        from casid.versions import versions

        return MonteCarlo(
            problem=self.problem.name,
            method=self.described["method"],
            campaign=done,
            parameters=tuple(accuracy(self.problem, done)),
            settings=self.described,
            versions=versions(),
            sources=SOURCES if self.method == "identify" else (),
        )

    def _cut(self, experiment: Experiment) -> Experiment:
        if self.duration is None:
            return experiment
        record = experiment.record
        return replace(experiment, record=record.between(record.t0, record.t0 + self.duration))


@names_wrong_types()
def montecarlo(
    problem: Problem | str | Path,
    *,
    runs: int = 200,
    seed: int = 0,
    method: str | Method = "identify",
    settings: FitSettings | None = None,
    duration: float | None = None,
    out: str | Path | None = None,
    resume: bool = True,
    progress: bool | Callable[[str], None] = False,
    budget: float | None = None,
) -> MonteCarlo:
    """Simulate a problem with a seed of its own for every run, estimate it, and hold against truth.

    Runs where `joblib.parallel_config` says: one process by default.

    Parameters
    ----------
    problem : with `simulate` (and `truth`, for bias and coverage), or the path of its file. Values
        set known by `problem.with_known` are known to the estimate; the simulator keeps its own.
    runs : estimates wanted; a folder that has some of them is continued.
    method : a name of `monte_carlo.METHODS`, or a function of problem, experiments and
        settings that returns an `Estimate`, or what carries one as `.estimate` (as all of casid's
        estimators do): ``lambda problem, records, _: casid.multistage(problem, records, stages)``.
    settings : how a fit is sought.
    duration : use the first seconds of every record alone [s].
    out : folder for `results.parquet`; `result.write(folder)` adds numbers and report.
    resume, progress : as `casid.campaigns.campaign.campaign` has them.
    budget : seconds that the study may take: the runs done until then count, and the same call
        again does the others. Default as long as it takes, each fit within its own budget; a run
        that exceeds it has failed.

    Raises
    ------
    DataError
        A problem without a simulator, a folder of another study, a full disk.
    ModelError
        A problem that worker processes cannot load.
    SolveError
        If there is no such solver, or every run fails.
    """
    if isinstance(problem, Model):
        raise ModelError(
            f"model {problem.name} cannot simulate itself; give casid.Problem(name, model, "
            "simulate=f, truth={name: value})"
        )
    if not isinstance(problem, Problem):
        problem = load_problem(problem)
    study = Study(problem, method, settings, duration)
    return study.run(runs, seed=seed, out=out, resume=resume, progress=progress, budget=budget)


def _estimate_in(result: Any) -> Estimate:
    """The estimate that a method returns, itself or inside of its result."""
    estimate = result if isinstance(result, Estimate) else getattr(result, "estimate", None)
    if not isinstance(estimate, Estimate):
        raise DataError(
            f"the method returned {type(result).__name__}, which is no estimate; return a "
            "casid.Estimate, or what carries one as .estimate, as casid.identify, "
            "casid.multistage and casid.instrumental_variables do"
        )
    return estimate


def _study_again(origin: ProblemOrigin, *rest: Any) -> Study:
    """A study in another process, from the problem's file."""
    return Study(origin.problem(), *rest)
