"""One stage: the free parameters of some records, refined over instruments and noise models.

Algorithm 2.1 of Linder (2017) around any of the programs of `casid.estimation.moments.moment_nlp`:

    (a) estimate theta_p from the moment equations;
    (b) fit an ARMA model to the equation error left - columns' theta of the unfiltered data;
    (c) prefilter with its inverse;
    (d) simulate the loop from the external reference with the new theta_p: new instruments.

Repeated until neither theta_p nor the noise model moves (the "or" of Linder (2017) in the
condition to go on has to be "and"), or the allowed iterations are spent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.errors import IdentifiabilityError, ModelError
from casid.estimation.moments.coefficient_map import CoefficientMap
from casid.estimation.moments.instrument_relevance import require_relevance
from casid.estimation.moments.instruments import Instruments, Loop, Simulated
from casid.estimation.moments.moment_covariance import moment_covariance
from casid.estimation.moments.moment_equations import Correlation, MomentEquations, moment_equations
from casid.estimation.moments.moment_settings import MomentSettings
from casid.estimation.moments.noise_models import eta_distance, noise_models
from casid.estimation.moments.parts import Part
from casid.estimation.moments.robust_weights import robust_weights, weighted_equations
from casid.estimation.moments.stage_instruments import StageInstruments
from casid.estimation.moments.stage_programs import StagePrograms
from casid.estimation.nlp.nlp import Solution
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class StageFit:
    """What a stage found, and all that its uncertainty needs."""

    stage: Stage
    free: tuple[str, ...]
    theta_p: Array  # (nfree,)
    values: tuple[Mapping[str, float], ...]  # of each part, every parameter at the estimate
    parts: tuple[Part, ...]
    equations: tuple[MomentEquations, ...]
    roots: tuple[Array, ...]  # R of each part, R'R = Q
    thetas: tuple[Array, ...]  # (ntheta,) of each part
    solution: Solution
    correlations: tuple[Correlation, ...]
    noise_models: tuple[Any, ...]  # Arma or None of each part
    iterations: int
    settled: bool
    remarks: tuple[str, ...] = ()
    history: tuple[Array, ...] = field(default_factory=tuple)  # theta_p of each iteration
    prefilters: tuple[tuple[Any, ...], ...] = ()  # noise models with which each was estimated


class Stage:
    """The programs of a stage, derived once and solved for any data of the same form.

    Parameters
    ----------
    model : indirect model; `free` of its parameters are estimated, whatever it declares known.
    parts : from `casid.estimation.moments.parts.parts_of`.
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

    @property
    def image(self) -> CoefficientMap:
        """theta = g(theta_p) of all parts."""
        return self.programs.image

    def solve(
        self,
        equations: Sequence[MomentEquations],
        roots: Sequence[Array],
        values: Sequence[Mapping[str, float]],
        start: Array,
        *,
        on_the_way: bool = False,
    ) -> tuple[Array, list[Array], Solution]:
        """As `StagePrograms.solve`."""
        return self.programs.solve(equations, roots, values, start, on_the_way=on_the_way)

    def fit(
        self,
        parts: Sequence[Part],
        values: Sequence[Mapping[str, float]],
        start: Array | None = None,
        *,
        check: bool = True,
    ) -> StageFit:
        """Estimate, refine, and say what happened."""
        s = self.settings
        theta_p = self._start() if start is None else start
        if check:
            self.image.require_identifiable(theta_p, values)
        remarks: list[str] = []
        lags, references = self._first_instruments(parts)
        simulated = lags
        if self.instruments is not None and self.instruments.starts_from_model:
            at = self._at(values, theta_p)
            simulated = self.instruments.simulate(parts, references, at, lags, remarks, -1)
        prefilters: list[Any] = [None] * len(parts)
        history: list[Array] = []
        used: list[tuple[Any, ...]] = []
        settled, j = False, 0
        correlations: list[Correlation] = []
        before = (simulated, prefilters)
        allowed = 0 if self.instruments is None and s.noise_model is None else s.iterations
        while True:
            try:
                equations = self._equations(parts, simulated, prefilters)
                if check and j <= 1:  # later instruments hardly differ; the last are looked at
                    correlations = self._seen(equations, values, theta_p)
            except IdentifiabilityError as blind:
                if j == 0 and lags is not simulated:
                    remarks.append(
                        f"{self.name}: instruments simulated with the start values do not see all "
                        "coefficients; lags of the reference are used"
                    )
                    simulated = lags
                    continue
                if j == 0:
                    raise
                remarks.append(
                    f"instruments simulated with the estimate of iteration {j} are worse than "
                    f"those of before, which are kept ({blind})"
                )
                simulated, prefilters, settled = *before, True
                equations = self._equations(parts, simulated, prefilters)
                correlations = self._seen(equations, values, theta_p)
                allowed = j
            before = (simulated, prefilters)
            roots = self._weigh(equations, parts)
            old = theta_p
            theta_p, thetas, solution = self.solve(
                equations, roots, values, theta_p, on_the_way=j < allowed and s.alpha is None
            )
            history.append(theta_p)
            used.append(tuple(prefilters))
            if s.alpha is not None:
                theta_p, thetas, solution, equations, roots = self._robust(
                    equations, roots, values, theta_p, thetas, solution, s.alpha
                )
            moved = float(np.max(np.abs(theta_p - old) / np.maximum(np.abs(theta_p), 1e-12)))
            if j >= allowed:
                settled = settled or allowed == 0 or moved < s.tolerance
                break
            change, earlier = 0.0, prefilters
            if s.noise_model is not None:
                prefilters, change = noise_models(
                    parts, thetas, prefilters, s.noise_model, remarks, j
                )
            is_still = moved < s.tolerance and change < 10 * s.tolerance
            if s.stopping == "norm":
                sizes = [eta_distance(a, b) for a, b in zip(prefilters, earlier, strict=True)]
                is_still = float(np.linalg.norm(theta_p - old)) + sum(sizes) < s.tolerance
            if j > 0 and is_still:
                settled = True
                break
            if self.instruments is not None:
                at = self._at(values, theta_p)
                simulated = self.instruments.simulate(parts, references, at, simulated, remarks, j)
            j += 1
        if j < allowed and s.alpha is None and s.form == "linear":
            theta_p, thetas, solution = self.solve(equations, roots, values, theta_p)
        if check and j > 1:
            correlations = self._seen(equations, values, theta_p)
        if not settled:
            remarks.append(
                f"{self.name}: instruments and prefilter still move after {j} iterations (last "
                f"change {moved:.1e} relative); the estimate is consistent all the same, raise "
                "iterations= for the last bit of variance"
            )
        return StageFit(
            stage=self,
            free=self.free,
            theta_p=theta_p,
            values=self._at(values, theta_p),
            parts=tuple(parts),
            equations=tuple(equations),
            roots=tuple(roots),
            thetas=tuple(thetas),
            solution=solution,
            correlations=tuple(correlations),
            noise_models=tuple(prefilters),
            iterations=j + 1,
            settled=settled,
            remarks=tuple(dict.fromkeys(remarks)),
            history=tuple(history),
            prefilters=tuple(used),
        )

    def fit_equations(
        self,
        equations: Sequence[MomentEquations],
        parts: Sequence[Part],
        values: Sequence[Mapping[str, float]],
    ) -> StageFit:
        """Estimate from moment equations as they are: no samples, so nothing to refine."""
        start = self._start()
        self.image.require_identifiable(start, values)
        correlations = self._seen(equations, values, start)
        roots = self._weigh(equations, parts)
        theta_p, thetas, solution = self.solve(equations, roots, values, start)
        return StageFit(
            stage=self,
            free=self.free,
            theta_p=theta_p,
            values=self._at(values, theta_p),
            parts=tuple(parts),
            equations=tuple(equations),
            roots=tuple(roots),
            thetas=tuple(thetas),
            solution=solution,
            correlations=tuple(correlations),
            noise_models=(None,) * len(parts),
            iterations=1,
            settled=True,
            history=(theta_p,),
        )

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

    def _seen(
        self,
        equations: Sequence[MomentEquations],
        values: Sequence[Mapping[str, float]],
        theta_p: Array,
    ) -> list[Correlation]:
        jacobians = np.split(
            self.image.jacobian(theta_p, values),
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
        roots: list[Array],
        values: Sequence[Mapping[str, float]],
        theta_p: Array,
        thetas: list[Array],
        solution: Solution,
        alpha: Callable[[Array], Array],
    ) -> tuple[Array, list[Array], Solution, list[MomentEquations], list[Array]]:
        """(2.41) by iteratively reweighted moments."""
        heavy = equations
        for _ in range(30):
            heavy = [
                weighted_equations(e, robust_weights(e.error(t), alpha))
                for e, t in zip(equations, thetas, strict=True)
            ]
            roots = [e.root_weight("2sls", t, None) for e, t in zip(heavy, thetas, strict=True)]
            old = theta_p
            theta_p, thetas, solution = self.solve(heavy, roots, values, theta_p)
            if np.max(np.abs(theta_p - old) / np.maximum(np.abs(theta_p), 1e-12)) < 1e-9:
                break
        return theta_p, thetas, solution, heavy, roots
