"""One stage: the free parameters of some records, refined over instruments and noise models.

Algorithm 2.1 of Linder (2017) around any of the programs of `moment_nlp`:

    (a) estimate theta_p from the moment equations;
    (b) fit an ARMA model to the equation error left - columns' theta of the unfiltered data;
    (c) prefilter with its inverse;
    (d) simulate the loop from the external reference with the new theta_p: new instruments.

Repeated until neither theta_p nor the noise model moves (the "or" of Linder (2017) in the
condition to go on has to be "and"), or the allowed iterations are spent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from casid.arrays import Array
from casid.errors import IdentifiabilityError, ModelError
from casid.estimation.moments.equations.instrument_relevance import require_relevance
from casid.estimation.moments.equations.moment_covariance import moment_covariance
from casid.estimation.moments.equations.moment_equations import (
    Correlation,
    MomentEquations,
    moment_equations,
)
from casid.estimation.moments.equations.parts import Part
from casid.estimation.moments.equations.robust_weights import robust_weights, weighted_equations
from casid.estimation.moments.instruments.instruments import Instruments, Loop, Simulated
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.stages.noise_models import eta_distance, noise_models
from casid.estimation.moments.stages.stage_instruments import StageInstruments
from casid.estimation.moments.stages.stage_programs import StagePrograms
from casid.estimation.nlp.solution import Solution
from casid.grouping import Grouped
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """How instruments and prefilters were refined.

    Attributes
    ----------
    noise_models : Arma or None of each part, from the last equation error.
    iterations : estimates made; is_settled : the stopping rule was met.
    remarks : what went otherwise than planned.
    history : theta_p of each iteration.
    prefilters : noise models with which each iteration was estimated.
    """

    noise_models: tuple[Any, ...]
    iterations: int
    is_settled: bool
    remarks: tuple[str, ...] = ()
    history: tuple[Array, ...] = ()
    prefilters: tuple[tuple[Any, ...], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class StageFit:
    """The estimate of a stage, and all that its uncertainty needs."""

    stage: Stage
    theta_p: Array  # (nfree,)
    values: tuple[Mapping[str, float], ...]  # of each part, every parameter at the estimate
    parts: tuple[Part, ...]
    equations: tuple[MomentEquations, ...]
    roots: tuple[Array, ...]  # R of each part, R'R = Q
    thetas: tuple[Array, ...]  # (ntheta,) of each part
    solution: Solution
    correlations: tuple[Correlation, ...]
    refinement: Refinement

    free: ClassVar[Grouped[tuple[str, ...]]] = Grouped("stage")  # The parameters estimated here
    iterations: ClassVar[Grouped[int]] = Grouped("refinement")
    settled: ClassVar[Grouped[bool]] = Grouped("refinement", "is_settled")
    remarks: ClassVar[Grouped[tuple[str, ...]]] = Grouped("refinement")
    noise_models: ClassVar[Grouped[tuple[Any, ...]]] = Grouped("refinement")
    history: ClassVar[Grouped[tuple[Array, ...]]] = Grouped("refinement")
    prefilters: ClassVar[Grouped[tuple[tuple[Any, ...], ...]]] = Grouped("refinement")


class Stage:
    """The programs of a stage, derived once and solved for any data of the same form.

    Parameters
    ----------
    model : indirect model; `free` of its parameters are estimated, whatever it declares known.
    parts : from `casid.estimation.moments.equations.parts.parts_of`.
    instruments : None for least squares.
    """

    def __init__(
        self,
        model: Model,
        parts: Sequence[Part],
        free: Sequence[str],
        settings: MomentSettings,
        instruments: Instruments | None = None,
        *,
        loops: dict[float, Loop] | None = None,
        name: str = "stage",
    ) -> None:
        if not free:
            raise ModelError(f"{name}: no free parameter; name those to be estimated")
        self.model, self.settings, self.name = model, settings, name
        self.free = tuple(free)
        self.known = [frozenset(self.free) & p.known for p in parts]
        for f in self.free:
            model.parameter_named(f)
            if all(f in k for k in self.known):
                raise ModelError(
                    f"{name}: {f} is known in every record of this stage; free another parameter, "
                    "or take it out of the load cases"
                )
        self.equations = [p.equation for p in parts]
        self.parameters = [replace(model.parameters[f], value=None) for f in self.free]
        self.programs = StagePrograms(
            self.equations, self.parameters, self.known, settings, name=name
        )
        loops = {} if loops is None else loops
        self.instruments = (
            None
            if instruments is None
            else StageInstruments(model, parts, instruments, loops, settings.method)
        )

    def fit(
        self,
        parts: Sequence[Part],
        values: Sequence[Mapping[str, float]],
        start: Array | None = None,
        *,
        check: bool = True,
    ) -> StageFit:
        """Estimate by Algorithm 2.1, refining instruments and prefilters.

        Parameters
        ----------
        values : of each part, every parameter; the free ones are taken from `start`.
        start : (nfree,); default the starts of the model.
        check : refuse parameters that are not identifiable, and instruments that are not relevant.
        """
        theta_p = self._start() if start is None else start
        run = _Refining(self, parts, values, theta_p, check=check)
        while not run.is_done:
            run.form_equations()
            run.estimate()
            run.refine()
        return run.result()

    def fit_equations(
        self,
        equations: Sequence[MomentEquations],
        parts: Sequence[Part],
        values: Sequence[Mapping[str, float]],
    ) -> StageFit:
        """Estimate from moment equations as they are: no samples, so nothing to refine."""
        run = _Refining(self, parts, values, self._start(), check=True)
        run.form_equations(equations)
        run.estimate()
        run.refine()
        return run.result()

    def _start(self) -> Array:
        return np.array([p.start for p in self.parameters], dtype=float)

    def _first_instruments(
        self, parts: Sequence[Part]
    ) -> tuple[list[Simulated | None], list[dict[str, Array]]]:
        """Instruments before any refinement, and the references of the later ones."""
        if self.instruments is None:
            return [None] * len(parts), []
        references = [self.instruments.references(p) for p in parts]
        return self.instruments.first(parts), references

    def _equations(
        self,
        parts: Sequence[Part],
        simulated: Sequence[Simulated | None],
        prefilters: Sequence[Any],
    ) -> list[MomentEquations]:
        return [
            moment_equations(p, z, f, burn=self.settings.burn)
            for p, z, f in zip(parts, simulated, prefilters, strict=True)
        ]

    def _relevance(
        self,
        equations: Sequence[MomentEquations],
        values: Sequence[Mapping[str, float]],
        theta_p: Array,
    ) -> list[Correlation]:
        jacobians = np.split(
            self.programs.map.jacobian(theta_p, values),
            np.cumsum([len(e.coefficients) for e in self.equations])[:-1],
        )
        return require_relevance(equations, jacobians, self.free, theta_p)

    def _at(
        self, values: Sequence[Mapping[str, float]], theta_p: Array
    ) -> tuple[dict[str, float], ...]:
        """Every parameter of each part, the free ones at theta_p."""
        found = dict(zip(self.free, theta_p.tolist(), strict=True))
        return tuple(
            {**v, **{k: x for k, x in found.items() if k not in fixed}}
            for v, fixed in zip(values, self.known, strict=True)
        )

    def _weigh(self, equations: Sequence[MomentEquations], parts: Sequence[Part]) -> list[Array]:
        """R of each part, by the weighting of the settings."""
        weighting = self.settings.weighting
        if weighting == "identity":
            return [e.root_weight(weighting, np.zeros(0), None) for e in equations]
        thetas = [e.unconstrained() for e in equations]
        if weighting != "optimal":
            return [
                e.root_weight(weighting, t, None) for e, t in zip(equations, thetas, strict=True)
            ]
        covariance = moment_covariance(
            equations, thetas, [p.name for p in parts], how=self.settings.covariance
        )
        roots, at = [], 0
        for e, t in zip(equations, thetas, strict=True):
            n = len(e.Z)
            own = covariance[at : at + n, at : at + n] * e.N
            roots.append(e.root_weight("optimal", t, own))
            at += n
        return roots

    def _robust(
        self,
        equations: list[MomentEquations],
        values: Sequence[Mapping[str, float]],
        theta_p: Array,
        thetas: list[Array],
        alpha: Callable[[Array], Array],
    ) -> tuple[Array, list[Array], Solution, list[MomentEquations], list[Array]]:
        """(2.41) by iteratively reweighted moments."""
        for _ in range(30):
            heavy = [
                weighted_equations(e, robust_weights(e.error(t), alpha))
                for e, t in zip(equations, thetas, strict=True)
            ]
            roots = [e.root_weight("2sls", t, None) for e, t in zip(heavy, thetas, strict=True)]
            old = theta_p
            theta_p, thetas, solution = self.programs.solve(heavy, roots, values, theta_p)
            if np.max(np.abs(theta_p - old) / np.maximum(np.abs(theta_p), 1e-12)) < 1e-9:
                break
        return theta_p, thetas, solution, heavy, roots


class _Refining:
    """Algorithm 2.1 while it runs: instruments, prefilters and estimate of one iteration."""

    def __init__(
        self,
        stage: Stage,
        parts: Sequence[Part],
        values: Sequence[Mapping[str, float]],
        theta_p: Array,
        *,
        check: bool,
    ) -> None:
        self.stage, self.settings, self.check = stage, stage.settings, check
        self.parts, self.values, self.theta_p = parts, values, theta_p
        if check:
            stage.programs.map.require_identifiable(theta_p, values)
        self.remarks: list[str] = []
        self.lags, self.references = stage._first_instruments(parts)
        self.simulated = self.lags
        if stage.instruments is not None and stage.instruments.starts_from_model:
            self._simulate(-1)
        self.prefilters: list[Any] = [None] * len(parts)
        self.before = (self.simulated, self.prefilters)
        self.is_done = self.is_settled = False
        self.j, self.moved = 0, np.inf
        only_once = stage.instruments is None and self.settings.noise_model is None
        self.allowed = 0 if only_once else self.settings.iterations
        self.correlations: list[Correlation] = []
        self.history: list[Array] = []
        self.used: list[tuple[Any, ...]] = []

    def _simulate(self, j: int) -> None:
        """Step (d) with the estimate of iteration j."""
        instruments = self.stage.instruments
        assert instruments is not None
        at = self.stage._at(self.values, self.theta_p)
        self.simulated = instruments.simulate(
            self.parts, self.references, at, self.simulated, self.remarks, j
        )

    def _form(self, given: Sequence[MomentEquations] | None = None, *, check: bool) -> None:
        stage = self.stage
        self.equations = (
            stage._equations(self.parts, self.simulated, self.prefilters)
            if given is None
            else list(given)
        )
        if check:
            self.correlations = stage._relevance(self.equations, self.values, self.theta_p)

    def form_equations(self, given: Sequence[MomentEquations] | None = None) -> None:
        """Moment equations; by earlier instruments where the new ones are not relevant.

        Parameters
        ----------
        given : the equations, where there are no samples to form them from.
        """
        # Later instruments hardly differ: the first two and the last are checked.
        check = self.check and self.j <= 1
        try:
            self._form(given, check=check)
        except IdentifiabilityError as refusal:
            if self.j == 0 and self.simulated is self.lags:
                raise
            if self.j == 0:
                self.remarks.append(
                    f"{self.stage.name}: instruments simulated with the start values are not "
                    "correlated with all coefficients; lags of the reference are used"
                )
                self.simulated = self.lags
                self._form(check=check)
            else:
                self.remarks.append(
                    f"instruments simulated with the estimate of iteration {self.j} are worse than "
                    f"the earlier ones, which are kept ({refusal})"
                )
                self.simulated, self.prefilters = self.before
                self.is_settled, self.allowed = True, self.j
                self._form(check=True)
        self.before = (self.simulated, self.prefilters)

    def estimate(self) -> None:
        """Step (a)."""
        stage, alpha, old = self.stage, self.settings.alpha, self.theta_p
        self.roots = stage._weigh(self.equations, self.parts)
        self.theta_p, self.thetas, self.solution = stage.programs.solve(
            self.equations,
            self.roots,
            self.values,
            old,
            on_the_way=self.j < self.allowed and alpha is None,
        )
        self.history.append(self.theta_p)
        self.used.append(tuple(self.prefilters))
        if alpha is not None:
            self.theta_p, self.thetas, self.solution, self.equations, self.roots = stage._robust(
                self.equations, self.values, self.theta_p, self.thetas, alpha
            )
        self.step = self.theta_p - old
        self.moved = float(np.max(np.abs(self.step) / np.maximum(np.abs(self.theta_p), 1e-12)))

    def refine(self) -> None:
        """Steps (b) to (d), unless the estimate has settled or the iterations are spent."""
        s = self.settings
        if self.j >= self.allowed:
            self.is_done = True
            self.is_settled |= self.allowed == 0 or self.moved < s.tolerance
            return
        change, earlier = 0.0, self.prefilters
        if s.noise_model is not None:
            self.prefilters, change = noise_models(
                self.parts, self.thetas, earlier, s.noise_model, self.remarks, self.j
            )
        is_still = self.moved < s.tolerance and change < 10 * s.tolerance
        if s.stopping == "norm":
            sizes = [eta_distance(a, b) for a, b in zip(self.prefilters, earlier, strict=True)]
            is_still = float(np.linalg.norm(self.step)) + sum(sizes) < s.tolerance
        if self.j > 0 and is_still:
            self.is_done = self.is_settled = True
            return
        if self.stage.instruments is not None:
            self._simulate(self.j)
        self.j += 1

    def result(self) -> StageFit:
        """The last estimate, exact where an iteration on the way was solved in closed form."""
        stage, s = self.stage, self.settings
        theta_p, thetas, solution = self.theta_p, self.thetas, self.solution
        if self.j < self.allowed and s.alpha is None and s.form == "linear":
            theta_p, thetas, solution = stage.programs.solve(
                self.equations, self.roots, self.values, theta_p
            )
        if self.check and self.j > 1:
            self.correlations = stage._relevance(self.equations, self.values, theta_p)
        if not self.is_settled:
            self.remarks.append(
                f"{stage.name}: instruments and prefilter still move after {self.j} iterations "
                f"(last change {self.moved:.1e} relative); the estimate is consistent all the "
                "same, raise iterations= for the last bit of variance"
            )
        refinement = Refinement(
            tuple(self.prefilters),
            self.j + 1,
            self.is_settled,
            tuple(dict.fromkeys(self.remarks)),
            tuple(self.history),
            tuple(self.used),
        )
        return StageFit(
            stage=stage,
            theta_p=theta_p,
            values=stage._at(self.values, theta_p),
            parts=tuple(self.parts),
            equations=tuple(self.equations),
            roots=tuple(self.roots),
            thetas=tuple(thetas),
            solution=solution,
            correlations=tuple(self.correlations),
            refinement=refinement,
        )
