"""One stage: the free parameters of some records, refined over instruments and noise models.

Algorithm 2.1 of Linder (2017) around any of the programs of `casid.instrumental.moment_nlp`:

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
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from casid.errors import IdentifiabilityError, ModelError, SolveError
from casid.instrumental.image import Image
from casid.instrumental.instruments import (
    Instruments,
    Loop,
    Simulated,
    UnstableLoop,
    from_channels,
    from_reference,
    reference_signals,
)
from casid.instrumental.moment_equations import (
    Correlation,
    Covariance,
    MomentEquations,
    Part,
    Weighting,
    moment_covariance,
    moment_equations,
    robust_weights,
    weighted_equations,
)
from casid.instrumental.moment_nlp import Condensed, Constraint, LinearNlp, PhysicalNlp
from casid.model import Model
from casid.solving.nlp import Solution, Solver
from casid.solving.nlp_solution import not_converged
from casid.solving.null_space import null_space_least_squares

Array = NDArray[Any]
Form = Literal["linear", "eliminated", "lifted"]


@dataclass(frozen=True, slots=True)
class MomentSettings:
    """How moment equations are made and solved.

    Attributes
    ----------
    method : discretisation of the model (`casid.linear.discretise.METHODS`).
    outputs : of the model that are used; None: all.
    form : ``"linear"`` (Approach 5.1: linear constraints, then the inverse map), ``"eliminated"``
        or ``"lifted"`` (Approach 5.2: bounds and constraints on the physical parameters).
    weighting : Q of (2.42), see `MomentEquations.root_weight`.
    noise_model : (autoregressive, moving average) orders of the ARMA model of the equation error,
        as (0, 4) for (7.58); None: prefilter 1, (7.60).
    iterations : refinements of instruments and prefilter after the first estimate.
    tolerance : relative change of parameters and noise model at which they have settled.
    stopping : how that change is measured: ``"relative"``, the largest of any parameter and, within
        ten times the tolerance, of any coefficient of a noise model; or ``"norm"``, (8.93),
        ||theta_p - last|| + sum over records of ||eta - last||, whatever the units.
    alpha : the function of (2.41) on errors in units of their spread; None: alpha(x) = x.
    covariance : see `casid.instrumental.moment_equations.moment_covariance`.
    constraints : each takes a mapping of parameters to symbols and returns what is to be zero.
    solver : of the programs; ``"null space"`` for the linear form's optimum in closed form, which
        takes a fifth of Ipopt's time and pays off where runs are counted in thousands.
    burn : samples left out at the start of every record.
    """

    method: str = "bilinear"
    outputs: Sequence[str] | None = None
    form: Form = "eliminated"
    weighting: Weighting = "2sls"
    noise_model: tuple[int, int] | None = None
    iterations: int = 5
    tolerance: float = 1e-4
    stopping: Literal["relative", "norm"] = "relative"
    alpha: Callable[[Array], Array] | None = None
    covariance: Covariance | None = None
    constraints: Sequence[Constraint] = ()
    solver: Solver | Literal["null space"] | None = None
    burn: int = 0


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
    parts : from `casid.instrumental.moment_equations.parts_of`.
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
        self.model, self.settings, self.instruments, self.name = model, settings, instruments, name
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
        self._loops = {} if loops is None else loops
        if instruments is not None:
            for p in parts:
                if p.Ts not in self._loops:
                    self._loops[p.Ts] = Loop(model, p.Ts, settings.method)
        self.image = Image(self.equations, self.parameters, self.known, name=name)
        # Of each record, with the reference they come from: the drives, the first instruments.
        self._driven: dict[str, tuple[tuple[Array, ...], dict[str, Array]]] = {}
        self._first: dict[str, tuple[Any, Simulated]] = {}
        self._physical: PhysicalNlp | None = None
        self._linear: dict[int, LinearNlp] = {}

    # -- solving -----------------------------------------------------------------------------

    def solve(
        self,
        equations: Sequence[MomentEquations],
        roots: Sequence[Array],
        values: Sequence[Mapping[str, float]],
        start: Array,
        *,
        on_the_way: bool = False,
    ) -> tuple[Array, list[Array], Solution]:
        """(theta_p, theta of each part, solution) of one set of moment equations.

        `on_the_way` to the last refinement the linear form is solved in closed form.
        """
        data = [Condensed.of(e, r) for e, r in zip(equations, roots, strict=True)]
        if self.settings.form == "linear":
            closed = on_the_way or isinstance(self.settings.solver, str)
            return self._solve_linear(data, values, start, closed=closed)
        if self._physical is None:
            if isinstance(self.settings.solver, str):
                raise ModelError(
                    f"{self.name}: solver {self.settings.solver!r} is for form='linear' alone; "
                    "leave it out, and the program is solved by Ipopt"
                )
            self._physical = PhysicalNlp(
                self.equations,
                self.parameters,
                self.known,
                lifted=self.settings.form == "lifted",
                constraints=self.settings.constraints,
                solver=self.settings.solver,
                name=self.name,
            )
        solution = self._physical.solve(data, values, start.tolist(), throw=False)
        if not solution.is_converged:
            solution = self._by_least_squares(data, values, solution)
        if solution.at_lower or solution.at_upper:
            solution = self._from_elsewhere(self._physical, data, values, start, solution)
        theta_p = np.array([solution[f] for f in self.free])
        return theta_p, self.image.split(self.image.theta(theta_p, values)), solution

    def _by_least_squares(
        self, data: Sequence[Condensed], values: Sequence[Mapping[str, float]], found: Solution
    ) -> Solution:
        """The optimum from where a solver stopped short, by orthogonal factors of the residual.

        A solver of general programs sees squares: where coefficients are nearly dependent half of
        the digits are gone. A scaled gradient is then the largest cosine between the residual and
        a column of its Jacobian.
        """
        if self.settings.constraints or not np.all(np.isfinite(found.x)):
            raise not_converged(self.name, found)
        from scipy.optimize import least_squares

        low = np.array([p.lower for p in self.parameters])
        high = np.array([p.upper for p in self.parameters])
        metric = _block_diagonal([d.right for d in data])
        left = np.concatenate([d.left for d in data])
        rest = sum(d.rest for d in data)
        x0 = np.clip(np.array([found[f] for f in self.free]), low, high)

        def residual(at: Array) -> Array:
            return np.asarray(left - metric @ self.image.theta(at, values))

        def jacobian(at: Array) -> Array:
            return np.asarray(-metric @ self.image.jacobian(at, values))

        result = least_squares(
            residual,
            x0,
            jacobian,
            bounds=(low, high),
            x_scale="jac",
            ftol=1e-14,
            xtol=1e-14,
            gtol=1e-14,
            max_nfev=200,
        )
        x, r = np.asarray(result.x), np.asarray(result.fun)
        J = jacobian(x)
        span = 1e-6 * np.maximum(np.abs(x), 1e-3)
        at_low, at_high = x <= low + span, x >= high - span
        inside = ~(at_low | at_high)
        length = max(float(np.sqrt(r @ r + rest)), 1e-300)
        cosines = np.abs(J.T @ r) / np.maximum(np.linalg.norm(J, axis=0), 1e-300) / length
        solution = replace(
            found,
            names=self.free,
            x=x,
            value=(float(r @ r) + rest) / 2,
            status=f"least squares after {found.status}",
            scaled_gradient=float(np.max(cosines[inside], initial=0.0)),
            constraint_violation=0.0,
            at_lower=tuple(f for f, held in zip(self.free, at_low, strict=True) if held),
            at_upper=tuple(f for f, held in zip(self.free, at_high, strict=True) if held),
            hessian=J.T @ J,
            constraint_jacobian=np.zeros((0, len(x))),
        )
        if not solution.is_converged:
            raise not_converged(self.name, solution)
        return solution

    def _from_elsewhere(
        self,
        nlp: PhysicalNlp,
        data: Sequence[Condensed],
        values: Sequence[Mapping[str, float]],
        start: Array,
        found: Solution,
    ) -> Solution:
        """A bound may hold a local optimum: four more starts, the best optimum counts."""
        rng = np.random.default_rng(17)
        low = np.array([p.lower for p in self.parameters])
        high = np.array([p.upper for p in self.parameters])
        for _ in range(4):
            beside = np.where(start == 0.0, 0.1, start) * np.exp(
                0.5 * rng.standard_normal(len(start))
            )
            try:
                other = nlp.solve(data, values, np.clip(beside, low, high).tolist())
            except SolveError:
                continue
            if other.value < found.value * (1 - 1e-9):
                found = other
        return found

    def _solve_linear(
        self,
        data: Sequence[Condensed],
        values: Sequence[Mapping[str, float]],
        start: Array,
        *,
        closed: bool,
    ) -> tuple[Array, list[Array], Solution]:
        if self.settings.constraints:
            raise ModelError(
                f"{self.name}: constraints on physical parameters need form='eliminated' or "
                "'lifted'; the linear form knows theta alone"
            )
        B, b = self.image.constraints(values, start)
        metric = _block_diagonal([d.right for d in data])
        if closed:
            solution = self._closed_form(data, metric, B, b)
        else:
            rows = len(b)
            if rows not in self._linear:
                solver = self.settings.solver
                self._linear[rows] = LinearNlp(
                    self.equations,
                    rows,
                    solver=None if isinstance(solver, str) else solver,
                    name=self.name,
                )
            theta0 = self.image.theta(start, values)
            solution = self._linear[rows].solve(data, B, b, theta0)
        theta_p = self.image.inverse(solution.x, values, start, metric)
        low = np.array([p.lower for p in self.parameters])
        high = np.array([p.upper for p in self.parameters])
        # Coefficients outside the image of the box: theta_p stands at its wall.
        at_lower = tuple(f for f, held in zip(self.free, theta_p <= low, strict=True) if held)
        at_upper = tuple(f for f, held in zip(self.free, theta_p >= high, strict=True) if held)
        solution = replace(solution, at_lower=at_lower, at_upper=at_upper)
        return theta_p, self.image.split(solution.x), solution

    def _closed_form(
        self, data: Sequence[Condensed], metric: Array, B: Array, b: Array
    ) -> Solution:
        """The optimum of the linear form by the null space of B."""
        left = np.concatenate([d.left for d in data])
        theta = null_space_least_squares(metric, left, B, b)
        residual = left - metric @ theta
        return Solution(
            names=tuple(f"{c}#{k}" for k, e in enumerate(self.equations) for c in e.coefficients),
            x=theta,
            value=(float(residual @ residual) + sum(d.rest for d in data)) / 2,
            status="Closed_Form",
            iterations=0,
            scaled_gradient=0.0,
            constraint_violation=float(np.max(np.abs(B @ theta - b), initial=0.0)),
            at_lower=(),
            at_upper=(),
            hessian=metric.T @ metric,
            constraint_jacobian=B,
            solver="null space",
        )

    # -- refining ----------------------------------------------------------------------------

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
        theta_p = (
            np.array([p.start for p in self.parameters], dtype=float) if start is None else start
        )
        if check:
            self.image.require_identifiable(theta_p, values)
        simulated: list[Simulated | None] = [None] * len(parts)
        first = simulated
        remarks: list[str] = []
        references = []
        if self.instruments is not None:
            references = [self._references(p) for p in parts]
            raw = [
                {k: p.channels[k] for k in dict.fromkeys(c for c, _ in self._drives(p).values())}
                for p in parts
            ]
            first = simulated = [from_reference(r, self.instruments.n_delta0) for r in raw]
            if self.instruments.initial == "channels":
                lags = self.instruments.first
                simulated = [from_channels(p.channels, lags, p.record) for p in parts]
                first = simulated
            if self.instruments.initial == "model":
                at = [
                    self._at(v, theta_p, fixed) for v, fixed in zip(values, self.known, strict=True)
                ]
                simulated = self._simulate(parts, references, at, simulated, remarks, -1)
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
                if j == 0 and first is not simulated:
                    remarks.append(
                        f"{self.name}: instruments simulated with the start values do not see all "
                        "coefficients; lags of the reference are used"
                    )
                    simulated = first
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
            at = [self._at(v, theta_p, fixed) for v, fixed in zip(values, self.known, strict=True)]
            moved = float(np.max(np.abs(theta_p - old) / np.maximum(np.abs(theta_p), 1e-12)))
            if j >= allowed:
                settled = settled or allowed == 0 or moved < s.tolerance
                break
            change, earlier = 0.0, prefilters
            if s.noise_model is not None:
                prefilters, change = self._noise_models(parts, thetas, prefilters, remarks, j)
            is_still = moved < s.tolerance and change < 10 * s.tolerance
            if s.stopping == "norm":
                sizes = [eta_distance(a, b) for a, b in zip(prefilters, earlier, strict=True)]
                is_still = float(np.linalg.norm(theta_p - old)) + sum(sizes) < s.tolerance
            if j > 0 and is_still:
                settled = True
                break
            if self.instruments is not None:
                simulated = self._simulate(parts, references, at, simulated, remarks, j)
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
            values=tuple(at),
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
        start = np.array([p.start for p in self.parameters], dtype=float)
        self.image.require_identifiable(start, values)
        correlations = self._seen(equations, values, start)
        roots = self._weigh(equations, parts)
        theta_p, thetas, solution = self.solve(equations, roots, values, start)
        at = [self._at(v, theta_p, fixed) for v, fixed in zip(values, self.known, strict=True)]
        return StageFit(
            stage=self,
            free=self.free,
            theta_p=theta_p,
            values=tuple(at),
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

    def _references(self, part: Part) -> dict[str, Array]:
        """The filtered references of a part, made again only for another reference."""
        assert self.instruments is not None
        direct = self._loops[part.Ts].direct
        channels = [c for c, _ in self.instruments.drives(direct).values()]
        raw = tuple(part.channels[c] for c in channels if c in part.channels)
        old, drives = self._driven.get(part.record, ((), {}))
        if drives and len(old) == len(raw) and all(a is b for a, b in zip(old, raw, strict=True)):
            return drives
        drives = reference_signals(self.instruments, direct, part.channels, part.Ts, part.record)
        if all(_is_constant(a) for a in raw):
            self._driven[part.record] = raw, drives
        return drives

    def _seen(
        self,
        equations: Sequence[MomentEquations],
        values: Sequence[Mapping[str, float]],
        theta_p: Array,
    ) -> list[Correlation]:
        """Canonical correlations of every part; refused where a free parameter stays unseen.

        What counts is not every coefficient but every direction that the free parameters move, and
        all parts together: the share of that motion's size that the instruments reproduce.
        """
        jacobians = np.split(
            self.image.jacobian(theta_p, values),
            np.cumsum([len(e.coefficients) for e in self.equations])[:-1],
        )
        seen = np.zeros((len(self.free), len(self.free)))
        total = np.zeros_like(seen)
        surplus = -len(self.free)
        for e, J in zip(equations, jacobians, strict=True):
            w = e.whitener()
            surplus += len(w)
            weight = e.N / max(float(e.second[0, 0]), 1e-300)
            moved = w @ e.Phi @ J
            seen += weight * moved.T @ moved
            total += weight * J.T @ e.second[1:, 1:] @ J
        correlations = [e.correlation(with_memory=False) for e in equations]
        size = np.where(theta_p == 0.0, 1.0, np.abs(theta_p))
        moves = np.diag(total) * size**2
        if not np.all(np.isfinite(total)) or np.min(moves) < 1e-16 * np.max(moves):
            return correlations  # a special point, as a load of 0 kg: nothing can be said there
        scale = 1 / np.sqrt(np.maximum(np.diag(total), 1e-300))
        values_, vectors = np.linalg.eigh(total * np.outer(scale, scale))
        root = vectors / np.sqrt(np.maximum(values_, 1e-14 * values_[-1]))
        shares, directions = np.linalg.eigh(root.T @ (seen * np.outer(scale, scale)) @ root)
        from scipy.special import chdtri  # scipy.stats takes longer than all of the above

        limit = float(chdtri(max(surplus + 1, 1), 1e-3))
        samples = float(sum(e.N for e in equations))
        if surplus >= 0 and samples * shares[0] > 1e3 * limit:
            return correlations  # no memory makes that chance
        correlations = [e.correlation() for e in equations]
        samples = sum(c.effective_samples for c in correlations)
        if surplus >= 0 and samples * shares[0] > limit:
            return correlations
        step = scale * (root @ directions[:, 0])
        step = step / size
        step /= step[np.argmax(np.abs(step))]
        named = " and ".join(f for f, v in zip(self.free, step, strict=True) if abs(v) > 0.05)
        rank = int(np.sum(samples * shares > limit))
        raise IdentifiabilityError(
            f"{', '.join(e.name for e in equations)}: Phi has rank {min(rank, len(self.free) - 1)} "
            f"of {len(self.free)} in the free parameters; the instruments are not correlated with "
            f"what {named} moves (correlation {np.sqrt(max(shares[0], 0.0)):.2g}, by chance "
            f"{np.sqrt(limit / samples):.2g}). Use a reference that drives the system, more lags, "
            "or fewer free parameters"
        )

    def _drives(self, part: Part) -> dict[str, tuple[str, Any]]:
        assert self.instruments is not None
        return self.instruments.drives(self._loops[part.Ts].direct)

    def _at(
        self, values: Mapping[str, float], theta_p: Array, fixed: frozenset[str]
    ) -> dict[str, float]:
        found = dict(zip(self.free, theta_p.tolist(), strict=True))
        return {**values, **{k: v for k, v in found.items() if k not in fixed}}

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

    def _noise_models(
        self,
        parts: Sequence[Part],
        thetas: Sequence[Array],
        old: Sequence[Any],
        remarks: list[str],
        j: int,
    ) -> tuple[list[Any], float]:
        from casid.prediction.arma import arma

        assert self.settings.noise_model is not None
        na, nc = self.settings.noise_model
        found: list[Any] = []
        change = 0.0
        for p, theta, before in zip(parts, thetas, old, strict=True):
            e = p.equation
            start = max(c.order for c in (e.left, *e.columns))
            error = e.left.samples(p.signals, start)
            for value, column in zip(theta, e.columns, strict=True):
                error = error - value * column.samples(p.signals, start)
            try:
                model = arma(error - error.mean(), na, nc)
            except (SolveError, IdentifiabilityError) as failure:
                remarks.append(
                    f"{p.name}: no ARMA({na}, {nc}) model of the equation error in iteration "
                    f"{j + 1} ({failure}); the prefilter "
                    f"{'of before is kept' if before is not None else 'stays 1'}"
                )
                found.append(before)
                continue
            if not model.is_invertible:
                remarks.append(
                    f"{p.name}: the noise model of iteration {j + 1} is not invertible, so its "
                    "inverse is no stable prefilter; the one of before is kept"
                )
                found.append(before)
                continue
            new = np.concatenate([model.ar, model.ma])
            if before is None:
                change = max(change, 1.0)
            else:
                change = max(change, float(np.max(np.abs(new - [*before.ar, *before.ma]))))
            found.append(model)
        return found, change

    def _simulate(
        self,
        parts: Sequence[Part],
        references: Sequence[Mapping[str, Array]],
        values: Sequence[Mapping[str, float]],
        old: Sequence[Simulated | None],
        remarks: list[str],
        j: int,
    ) -> list[Simulated | None]:
        assert self.instruments is not None
        out: list[Simulated | None] = []
        done: dict[str, Simulated] = {}
        for p, drives, v, before in zip(parts, references, values, old, strict=True):
            try:
                if p.record not in done:
                    outputs = [q.equation.output for q in parts if q.record == p.record]
                    kept, first = self._first.get(p.record, (None, None))
                    key = (drives, tuple(outputs), dict(v))
                    is_kept = self._driven.get(p.record, ((), None))[1] is drives and j < 0
                    if is_kept and kept is not None and first is not None:
                        if kept[0] is drives and kept[1:] == key[1:]:
                            done[p.record] = first
                            out.append(first)
                            continue
                    done[p.record] = self._loops[p.Ts].instruments(
                        drives, v, self.instruments, outputs
                    )
                    if is_kept:
                        self._first[p.record] = key, done[p.record]
                out.append(done[p.record])
            except UnstableLoop as unstable:
                what = "start values" if j < 0 else f"estimate of iteration {j + 1}"
                remarks.append(
                    f"{p.record}: the loop simulated with the {what} is unstable ({unstable}); "
                    + (
                        "lags of the reference are used"
                        if j < 0
                        else "the instruments of before are kept"
                    )
                )
                out.append(before)
        return out


def eta_distance(new: Any, old: Any) -> float:
    """||eta - last eta|| of two noise models; None is a prefilter 1."""
    if new is None or old is None:
        return 0.0 if new is old else float(np.linalg.norm((new or old).theta))
    return float(np.linalg.norm(new.theta - old.theta))


def _is_constant(array: Array) -> bool:
    """True for samples that nobody can write over."""
    return array.flags.owndata and not array.flags.writeable


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    n = sum(len(b) for b in blocks)
    out = np.zeros((n, n))
    at = 0
    for b in blocks:
        out[at : at + len(b), at : at + len(b)] = b
        at += len(b)
    return out
