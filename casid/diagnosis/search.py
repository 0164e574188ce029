"""The search for causes: score, refit the best candidates, compare, adopt, until nothing is left.

Each round tests every effect against the model as it stands (`scores`), refits the most
promising ones jointly with all parameters under one whitening, ranks them by

    gain - k log N,   gain = 2 (J_model - J_extended)                                          (1)

with J the whitened simulation error less what input noise alone gives to it, and adopts the best
if it is significant for the family and improves what was held out.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import chi2, norm

from casid.data import Experiment
from casid.diagnosis.evidence.peaks import PeriodicCandidate, periodic_candidates
from casid.diagnosis.evidence.runaway import destabilises
from casid.diagnosis.evidence.scores import (
    INVISIBLE,
    LONGEST,
    Score,
    ScoreTable,
    scan,
    score_test,
    step_without_bias,
)
from casid.diagnosis.preselection import preselected
from casid.diagnosis.result import Alternative
from casid.effects.catalogue import catalogue
from casid.effects.effect import KINDS, Effect, Sizes, Spread
from casid.effects.parameter_effects import JUMP_TIMES, parameter_jump
from casid.effects.user_effects import UserEffect, user_effects
from casid.errors import SolveError
from casid.model import Model
from casid.noise import NoiseModel, estimate_noise, input_noise_floor
from casid.simulation_error import Fit, SimulationError, minimize_simulation_error
from casid.solving.nlp import Solver
from casid.uncertainty import bartlett_lags, long_run_covariance, sandwich

if TYPE_CHECKING:
    from casid.diagnosis.evidence.residual_tests import ResidualTests

Array = np.ndarray[Any, Any]
Progress = Callable[[str], None]


HIDDEN = 1.1
"""Residual over the sensors' noise beyond which misfit is taken to hide in the noise model.

More where the record is so short, or the resonance so sharp, that chance gives as much.
"""


STRONG = 6.0
"""Units of BIC that reject a rival."""


NEAR = Solver(
    max_iterations=25,
    options={"ipopt.mu_strategy": "monotone", "ipopt.mu_init": 1e-7, "ipopt.tol": 1e-6},
)
"""For fits that start next to their minimum: a large barrier would only lead away from it."""

EXACT = Solver(options={**NEAR.options, "ipopt.mu_init": 1e-6, "ipopt.tol": 1e-8})
"""The same for fits that are reported."""

IMITATORS = ("parameter_jump", "parameter_drift", "periodic_disturbance", "missing_mode")
"""Kinds with a time or a frequency of their own."""

SMALL = 0.0005
"""Share of the misfit's rms that counts as white noise where the misfit is most of the residual."""

PREDICTED = 10.0
"""How far a predicted gain may be off, besides: chi^2 of one degree of freedom and more."""

WORTH = 0.3
"""Share of the best predicted or found gain below which a candidate cannot win."""


@dataclass(frozen=True, slots=True, eq=False)
class Weighted:
    """A model fitted under one noise model."""

    model: Model
    fit: Fit
    noise: NoiseModel  # what it is fitted under
    full: NoiseModel  # with whatever passes for a disturbance
    input_sd: Mapping[str, float]
    is_hidden: bool  # much is unexplained by sensors and measured inputs
    unbiased: Fit | None = None  # where the noise of the inputs has no part in the estimate

    @property
    def criterion(self) -> SimulationError:
        """The whitened criterion at its minimum."""
        return self.fit.criterion


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One effect, refitted together with everything else."""

    effect: Effect
    names: tuple[str, ...]
    model: Model
    fit: Fit
    gain: float  # (1)
    cost: float  # k log N
    wald: float  # robust z of the first parameter
    score: Score | None = None

    @property
    def merit(self) -> float:
        """What candidates are ranked by."""
        return self.gain - self.cost


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """A candidate compared with the chosen one."""

    candidate: Candidate
    p_value: float  # that the chosen one is better by chance (Vuong 1989)


@dataclass(frozen=True, slots=True, eq=False)
class Adopted:
    """An effect adopted in one round, with what that round saw."""

    candidate: Candidate
    p_value: float
    rivals: tuple[Rival, ...]
    before: Weighted | None = None  # the model that it was adopted into


def _keep_sign(model: Model, change: str, value: float, effect: Effect) -> None:
    """Bound a change so that the parameter keeps its sign and its order of magnitude.

    A slope gets twice the room: the value, here that of the model without it, may yet grow.
    """
    if value == 0.0:
        return
    if effect.span is None:
        low, high = sorted((-0.95 * value, 3.0 * value))
    else:
        low, high = sorted(2.0 * slope for slope in _slopes_to_zero(effect.span, value))
    p = model.parameters[change]
    model.parameters[change] = replace(
        p, lower=low, upper=high, start=float(np.clip(p.start, 0.9 * low, 0.9 * high))
    )


def _slopes_to_zero(span: tuple[float, float], value: float) -> tuple[float, float]:
    """The slopes at which a parameter of `value` is zero at one end of its channel's range."""
    low, high = sorted((-value / span[0], -value / span[1]))
    return low, high


def _parameter_of(effect: Effect) -> str | None:
    """The parameter that an effect moves, if it moves one."""
    if effect.kind == "scheduled_parameter":
        return effect.where.partition("~")[0]
    return effect.where if effect.kind in ("parameter_jump", "parameter_drift") else None


def null_values(candidate: Candidate) -> dict[str, float]:
    """The values of an effect's parameters at which it does nothing."""
    effect = candidate.effect
    starts = [1e9 if effect.test == "clip" else p.start for p in effect.parameters]
    return dict(zip(candidate.names, starts, strict=True))


def _is_plausible(candidate: Candidate) -> bool:
    """False for a hold that is neither the one nor the other: signals are held or they are not."""
    share = candidate.fit.values.get(candidate.names[0], 1.0)
    return candidate.effect.kind != "hold" or share > 0.5


def _peak_score(found: PeriodicCandidate) -> Score:
    """A line of the residual's spectrum as a candidate among the others."""
    first = found.effect.parameters[0].name
    return Score(
        effect=found.effect,
        z=float(np.sqrt(found.statistic)),
        p_value=found.peak.p_value,
        adjusted=found.peak.p_value,
        energy=0.0,
        step=found.starts[first],
        unrobust=found.statistic,
        visible=1.0,
        starts=found.starts,
    )


def _not_below(noise: NoiseModel, criterion: SimulationError, x: Array) -> NoiseModel:
    """The noise with a white floor that is small against the misfit.

    Where sensors are all but free of noise, whitening would give the word to frequencies at which
    hardly anything is left, and misfit of another kind, beside what is to be named.
    """
    parts = [criterion.simulated(x, e).residual for e in range(len(criterion.data))]
    left = np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0))
    return replace(noise, output_sd=np.maximum(noise.output_sd, SMALL * left))


@dataclass(slots=True)
class Search:
    """State of the search, round by round."""

    experiments: Sequence[Experiment]
    recorded: Mapping[str, str]
    alpha: float = 0.05
    max_causes: int = 4
    known_noise: Mapping[str, float] = field(default_factory=dict)
    solver: Solver | None = None
    seed: int = 0
    progress: Progress = lambda _: None
    effects: Sequence[UserEffect] = ()  # the user's own
    without: Collection[str] = ()  # kinds left out
    tested: tuple[Weighted, ResidualTests] | None = None  # the last model whose residual was tested
    first_table: ScoreTable | None = None
    first_candidates: list[Candidate] = field(default_factory=list)
    refused: list[tuple[Candidate, str]] = field(default_factory=list)
    left_out: dict[tuple[str, str], str] = field(default_factory=dict)  # a user's effect -> why
    _events: list[float | None] = field(default_factory=list)

    # -- fitting -----------------------------------------------------------------------------

    def weigh(self, model: Model, fit: Fit, *, rounds: int = 2) -> Weighted:
        """Estimate the noise at a fit and fit again under it.

        Where much is unexplained by sensors and measured inputs, misfit would pass for a
        disturbance and hide its own cause: the fit is then made under the sensors' noise alone.
        """
        found = self._estimate(fit)
        if found.is_hidden:
            at = self._without_bias(found)
            if at is None or at.is_hidden:
                noise = _not_below(found.full.quiet(found.input_sd), found.criterion, fit.x)
                criterion = self._criterion(model, noise, fit.values, fit.criterion)
                return replace(found, fit=self._minimum(criterion), noise=noise)
            found = at
        for _ in range(rounds):
            criterion = self._criterion(model, found.full, found.fit.values, fit.criterion)
            found = self._estimate(self._minimum(criterion))
        at = self._without_bias(found) or found
        criterion = self._criterion(model, at.full, found.fit.values, fit.criterion)
        return replace(
            at,
            fit=self._minimum(criterion),
            noise=at.full,
            is_hidden=False,
            unbiased=None if at is found else at.fit,
        )

    def _without_bias(self, found: Weighted, steps: int = 40, patience: int = 8) -> Weighted | None:
        """The root of (2) in `scores`, with the noise found there; None if none is near.

        Where much is unexplained, the noise meanwhile is that of sensors and inputs alone. Given up
        where as many steps as `patience` come no nearer: a bound holds a parameter back, say.
        """
        if not any(found.input_sd.values()):
            return None
        at = found
        shortest, since = np.inf, 0
        for _ in range(steps):
            noise = at.full.quiet(at.input_sd) if at.is_hidden else at.full
            criterion = self._criterion(at.model, noise, at.fit.values, found.criterion)
            for mine, other in zip(criterion.data, found.criterion.data, strict=True):
                mine.used[:] = other.used
            x, length = step_without_bias(criterion, criterion.start, at.input_sd, seed=self.seed)
            moved = replace(at.fit, criterion=criterion, solution=replace(at.fit.solution, x=x))
            if not np.isfinite(criterion.evaluate(x).value):
                return None
            at = self._estimate(moved)
            if length < 0.05:
                return at
            shortest, since = (length, 0) if length < 0.98 * shortest else (shortest, since + 1)
            if since >= patience and length < LONGEST:
                return None
        return None

    def _estimate(self, fit: Fit) -> Weighted:
        full = estimate_noise(fit.criterion, fit.x, known=self.known_noise)
        input_sd = self._input_sd(full, fit.criterion)
        quiet = full.quiet(input_sd)
        ratio, spread = full.excess(quiet, [d.N for d in fit.criterion.data])
        is_hidden = ratio > max(HIDDEN**2, 1 + 2 * spread)
        return Weighted(fit.criterion.model, fit, full, full, input_sd, is_hidden)

    def fitted(self, model: Model, like: Weighted, start: Mapping[str, float]) -> Fit:
        """Another model under the noise and the weights of one that was judged."""
        return self._minimum(self._criterion(model, like.noise, start, like.criterion))

    def _minimum(self, criterion: SimulationError) -> Fit:
        return minimize_simulation_error(
            criterion, solver=self.solver or NEAR, check_rank=False, throw=False, near=True
        )

    def _criterion(
        self,
        model: Model,
        noise: NoiseModel,
        start: Mapping[str, float],
        like: SimulationError,
    ) -> SimulationError:
        return SimulationError(
            model,
            self.experiments,
            own=[n for n in like.own if n in model.parameters],
            weights=like.weights,
            whiten=noise.whiten,
            substeps=like.substeps,
            start=start,
        )

    def _input_sd(self, noise: NoiseModel, criterion: SimulationError) -> dict[str, float]:
        """Input noise: what the residual shows, but no more than the channels' own floors."""
        measured = [n for n, u in criterion.model.inputs.items() if u.kind == "measured"]
        floors = input_noise_floor(criterion.data, list(criterion.model.inputs))
        largest = {n: self.known_noise.get(n, floors[n]) for n in measured}
        return {**dict.fromkeys(measured, 0.0), **noise.of_inputs(largest)}

    def compensated(self, at: Weighted, criterion: SimulationError, x: Array) -> float:
        """J of (1) at `x`: the whitened criterion less what input noise alone gives to it."""
        value = criterion.evaluate(x).value
        names = list(criterion.model.inputs)
        sd = np.array([at.input_sd.get(n, 0.0) for n in names])
        if not np.any(sd > 0):
            return value
        rng = np.random.default_rng(self.seed)
        order = sorted(range(len(names)), key=lambda i: names[i])
        for e, d in enumerate(criterion.data):
            w = np.zeros(d.u.shape)
            for i in order:  # the same draw for a channel in every model
                if sd[i] > 0:
                    w[:, i] = sd[i] * rng.standard_normal(d.N)
            up = criterion.simulate(x, e, signals=replace(d, u=d.u + w))[0]
            down = criterion.simulate(x, e, signals=replace(d, u=d.u - w))[0]
            moved = 0.5 * (up - down) * d.used * criterion.weights
            assert criterion.whiten is not None
            white = criterion.whiten(moved[:, :, None], e)
            value -= 0.5 * float(np.sum(white**2))
        return value

    def sizes(self, at: Weighted) -> Sizes:
        """How large the signals of the fitted model are."""
        sims = [at.criterion.simulated(at.fit.x, e) for e in range(len(self.experiments))]
        x = np.concatenate([s.x for s in sims])
        d = at.criterion.data[0]
        rms = np.sqrt(np.mean(x**2, axis=0))
        return Sizes(
            rates={n: float(r) for n, r in zip(at.model.states, rms, strict=True)},
            largest={
                n: max(float(np.max(np.abs(s.y[:, i]), initial=0.0)) for s in at.criterion.data)
                for i, n in enumerate(at.criterion.outputs)
            },
            window=(float(d.t[0]), float(d.t[-1])),
            longest_delay=float(min(0.3, 0.02 * d.N * d.Ts)),
            Ts=min(s.Ts for s in at.criterion.data),
            channels={c: self._spread(c) for c in self.recorded},
            ranges={
                n: (float(low), float(most))
                for n, low, most in zip(at.model.states, x.min(axis=0), x.max(axis=0), strict=True)
            },
        )

    def _spread(self, channel: str) -> Spread:
        """Mean and range of a channel over the fitted records."""
        c = np.concatenate([e.record[channel] for e in self.experiments])
        return Spread(float(c.mean()), float(c.min()), float(c.max()))

    # -- one candidate -----------------------------------------------------------------------

    def refit(
        self,
        at: Weighted,
        effect: Effect,
        step: float,
        *,
        starts: Mapping[str, float] | None = None,
        near: bool = False,
    ) -> Candidate | None:
        """Fit the model with `effect` in it, from one or several starts of its first parameter.

        `starts` of its further parameters, by the effect's own names; `near` where `step` and those
        are known to be right: no others are tried.
        """
        best: Candidate | None = None
        if self._runs_away(at, effect):
            return None
        for start, upper in self._starts(at, effect, step, near=near):
            model, names = effect.extended(
                at.model, starts={**(starts or {}), effect.parameters[0].name: start}, upper=upper
            )
            moved = _parameter_of(effect)
            if moved is not None:
                _keep_sign(model, names[0], at.fit.values.get(moved, 0.0), effect)
            values = {**at.fit.values, **(best.fit.values if best else {})}
            for name in names:
                values.pop(name, None)
            try:
                criterion = self._criterion(model, at.noise, values, at.criterion)
                fit = minimize_simulation_error(
                    criterion,
                    solver=self.solver or NEAR,
                    check_rank=False,
                    throw=False,
                    retry=False,
                )
            except SolveError:
                continue  # this start diverges; the others decide
            found = self._judge(at, effect, names, model, fit)
            if np.isfinite(found.gain) and (best is None or found.gain > best.gain):
                best = found
        return best

    def again(self, at: Weighted, found: Candidate) -> Candidate | None:
        """A candidate refitted into another model or on other records, from what it was."""
        effect = found.effect
        values = {
            p.name: found.fit.values[name]
            for p, name in zip(effect.parameters, found.names, strict=True)
            if name in found.fit.values
        }
        first = effect.parameters[0]
        step = values[first.name] - first.start
        return self.refit(at, effect, step, starts=values, near=True)

    def _runs_away(self, at: Weighted, effect: Effect) -> bool:
        """True if a user's effect makes the simulation run away; `left_out` then says it."""
        if effect.kind in KINDS:
            return False
        if effect.key not in self.left_out:
            size, first = destabilises(at.fit, effect), effect.parameters[0]
            self.left_out[effect.key] = (
                f"{effect.kind} in {effect.where} was left out: its simulation runs away already "
                f"at {first.name} = {size:.2g} {first.unit}: turn its sign round, bound it, or "
                "state it so that it stays small"
                if size is not None
                else ""
            )
        return bool(self.left_out[effect.key])

    def _starts(
        self, at: Weighted, effect: Effect, step: float, *, near: bool = False
    ) -> list[tuple[float, float | None]]:
        Ts = at.criterion.data[0].Ts
        if effect.limit is not None:
            # A large delay or lag is far from its linearised size, and the fit has local minima.
            factors = (0.5, 1.0, 2.0, 4.0) if at.is_hidden or abs(step) > Ts else (1.0,)
            factors = (1.0,) if near else factors
            grid = {min(max(k * abs(step), 0.2 * Ts), effect.limit) for k in factors}
            return [(g, min(2.0 * g + 4 * Ts, effect.limit)) for g in sorted(grid)]
        if near:
            return [(effect.parameters[0].start + step, None)]
        if effect.test == "clip" and effect.variant is not None:
            return [(effect.variant, None)]
        if effect.kind == "parameter_jump":
            # A linearised step can exceed what the parameter itself can lose.
            name = effect.where
            now = abs(at.fit.values.get(name, 0.0)) or abs(step) * 4
            step = float(np.clip(step, -0.4 * now, 0.4 * now))
        moved = _parameter_of(effect)
        value = at.fit.values.get(moved, 0.0) if moved is not None else 0.0
        if effect.span is not None and value != 0.0:
            low, high = _slopes_to_zero(effect.span, value)
            step = float(np.clip(step, 0.4 * low, 0.4 * high))
        null = effect.parameters[0].start
        return [(null + (step if effect.sided == "both" else max(step, 0.0)), None)]

    def _judge(
        self, at: Weighted, effect: Effect, names: tuple[str, ...], model: Model, fit: Fit
    ) -> Candidate:
        """Gain over the model without the effect, on the samples that both use."""
        criterion = fit.criterion
        pairs = list(zip(at.criterion.data, criterion.data, strict=True))
        if all(np.array_equal(mine.used, other.used) for mine, other in pairs):
            before = self._base_value(at)
        else:
            base = self._criterion(at.model, at.noise, at.fit.values, at.criterion)
            for mine, other in zip(base.data, criterion.data, strict=True):
                mine.used[:] = other.used
            before = self.compensated(at, base, base.start)
        after = self.compensated(at, criterion, fit.x)
        return Candidate(
            effect=effect,
            names=names,
            model=model,
            fit=fit,
            gain=2 * (before - after),
            cost=effect.cost * float(np.log(criterion.n_samples)),
            wald=self.wald(fit, names[0], effect.parameters[0].start),
        )

    def _base_value(self, at: Weighted) -> float:
        key = id(at)
        if self._cache.get("key") != key:
            self._cache = {"key": key, "value": self.compensated(at, at.criterion, at.fit.x)}
        return float(self._cache["value"])

    _cache: dict[str, float] = field(default_factory=dict)

    def wald(self, fit: Fit, name: str, null: float = 0.0) -> float:
        """Distance of an estimate from its null value in robust standard errors."""
        criterion = fit.criterion
        i = criterion.names.index(name)
        free = np.ones(len(fit.x), dtype=bool)
        covariance, _ = sandwich(fit.solution.hessian, criterion.scores(fit.x), free)
        sd = float(np.sqrt(max(covariance[i, i], 0.0)))
        return float((fit.x[i] - null) / sd) if sd > 0 else 0.0

    def std_error(self, at: Weighted, name: str) -> float:
        """Robust standard error of one variable."""
        criterion = at.criterion
        free = np.ones(len(at.fit.x), dtype=bool)
        covariance, _ = sandwich(at.fit.solution.hessian, criterion.scores(at.fit.x), free)
        i = criterion.names.index(name)
        return float(np.sqrt(max(covariance[i, i], 0.0)))

    def input_floor(self, at: Weighted, channel: str) -> float:
        """Noise of a measured input, as far as it is known."""
        return float(at.input_sd.get(channel, 0.0))

    def invisible(self) -> set[tuple[str, str]]:
        """Effects that the baseline's own parameters absorb in these records."""
        if self.first_table is None:
            return set()
        seen = {s.effect.key for s in self.first_table.scores if s.is_visible}
        return {s.effect.key for s in self.first_table.scores} - seen

    def aliases(self, effect: Effect) -> list[Alternative]:
        """Effects whose signature is that of `effect`, or turned round: the same in this model.

        Parameters that depend on one channel may act alike; those refitted are judged by `rivals`.
        """
        table = self.first_table
        if table is None:
            return []
        keys = [s.effect.key for s in table.scores]
        refitted = {c.effect.key for c in self.first_candidates}
        out: list[Alternative] = []
        for i, key in enumerate(keys):
            if key != effect.key:
                continue
            for j, other in enumerate(keys):
                c = float(table.cosines[i, j])
                if other == key or table.scores[j].visible <= INVISIBLE or abs(c) < 0.99:
                    continue
                kind, where = other
                if kind == effect.kind == "scheduled_parameter" and other not in refitted:
                    why = f"with this record, {where} acts as {effect.where} does"
                    out.append(Alternative(kind, where, 1.0, why))
                if kind == effect.kind == "time_delay" and c < 0.0:
                    why = f"an advance of {where} looks the same as a delay of {effect.where}"
                    out.append(Alternative(kind, where, 1.0, why))
        return out[:3]

    def contributions(self, adopted: Sequence[Adopted], fit: Fit) -> list[float]:
        """Sum of squares that returns when each effect is taken out and the rest refitted.

        The rest starts where it is and, should that leave more than the model as it was before any
        effect, there: far from its minimum the fit of a long swing has others.
        """
        c = fit.criterion
        start = adopted[0].before.fit.values if adopted and adopted[0].before else fit.values
        nothing = {k: v for a in adopted for k, v in null_values(a.candidate).items()}
        out = []
        for a in adopted:
            null = null_values(a.candidate)
            less = partial(
                SimulationError,
                c.model.with_known(**null),
                self.experiments,
                own=[n for n in c.own if n not in null],
                weights=c.weights,
                substeps=c.substeps,
            )
            bare = less(start={**start, **nothing})
            most = bare.evaluate(bare.start).value
            try:
                left = self._minimum(less(start=fit.values)).solution.value
                if left > most:
                    left = min(self._minimum(bare).solution.value, most)
            except SolveError:
                left = most if np.isfinite(most) else fit.solution.value
            out.append(max(left - fit.solution.value, 0.0))
        return out

    def placed(self, at: Weighted, found: list[Candidate]) -> list[Candidate]:
        """Jumps refitted at the instants that leave least; coarse scores place them roughly only.

        The most promising one is placed first, the others start from its instant too: they may be
        the same event, seen in another parameter.
        """
        top = max(c.gain for c in found)
        out, instant = [], None
        for c in sorted(found, key=lambda c: -c.gain):
            if c.effect.kind == "parameter_jump" and c.gain > 0.6 * top:
                self.progress(f"place {c.effect.kind} in {c.effect.where}")
                if instant is not None:
                    c = self._better_at(at, c, instant)
                c = self._placed(at, c)
                instant = instant if instant is not None else c.effect.variant
            out.append(c)
        return out

    def _placed(self, at: Weighted, found: Candidate) -> Candidate:
        """Scan ever finer, linearly about the last refit: a ringing leaves many local minima."""
        start, stop = self.sizes(at).window
        reach = 1.5 * (stop - start) / (JUMP_TIMES + 1)
        for _ in range(3):
            now = found.effect.variant
            assert now is not None
            times = now + reach * np.linspace(-1, 1, 101)
            inside = [float(t) for t in times if start < t < stop]
            model = found.model
            effects = [parameter_jump(model, found.effect.where, t) for t in inside]
            left = scan(found.fit, found.names[0], effects)
            found = self._better_at(at, found, inside[int(np.argmin(left))])
            if reach < 50 * at.criterion.data[0].Ts:
                break
            reach /= 12
        return found

    def _better_at(self, at: Weighted, found: Candidate, instant: float) -> Candidate:
        """The jump refitted at another instant, if it explains more there."""
        if instant == found.effect.variant:
            return found
        other = parameter_jump(at.model, found.effect.where, instant)
        if self._is_known_event(at, other):
            return found
        again = self.refit(at, other, float(found.fit.values[found.names[0]]))
        if again is None or again.gain <= found.gain:
            return found
        return replace(again, score=found.score)

    # -- one round ---------------------------------------------------------------------------

    def table(self, at: Weighted, adopted: Sequence[Candidate]) -> ScoreTable:
        """Score every effect not adopted yet."""
        taken = {c.effect.key for c in adopted}
        sizes = self.sizes(at)
        every = catalogue(
            at.model,
            sizes,
            self.recorded,
            extra=user_effects(at.model, self.effects),
            without=self.without,
        )
        effects = [e for e in every if e.key not in taken]
        own = {n for c in adopted for n in c.names}
        self._events = [c.effect.variant for c in adopted if c.effect.kind == "parameter_jump"]
        effects = [
            e
            for e in effects
            if e.kind != "parameter_jump" or not (e.where in own or self._is_known_event(at, e))
        ]
        # A slope of a cause's own size would be a second effect in the place of a first one.
        effects = [e for e in effects if e.span is None or _parameter_of(e) not in own]
        judged = at.unbiased or at.fit
        table = score_test(judged, effects, input_sd=at.input_sd, seed=self.seed)
        if "periodic_disturbance" in self.without:
            return table
        found = periodic_candidates(judged, sizes.window)
        return table.with_peaks([_peak_score(c) for c in found])

    def _is_known_event(self, at: Weighted, effect: Effect) -> bool:
        """True if a jump is already adopted at about the same instant: one event, named once."""
        d = at.criterion.data[0]
        near = 1.2 * d.N * d.Ts / (JUMP_TIMES + 1)
        return any(
            t is not None and effect.variant is not None and abs(t - effect.variant) < near
            for t in self._events
        )

    def shortlist(self, at: Weighted, table: ScoreTable) -> list[Score]:
        """The best six kinds by robust p and the best six by unrobust score, one variant each.

        Neighbours without a name come beside them, four of each order: they crowd out nobody.
        """
        visible = [s for s in table.tested if s.unrobust > 0.0]
        if not at.is_hidden:
            # Under the right noise the score predicts what a refit of a small effect gains.
            least = WORTH * max((s.unrobust for s in visible), default=0.0) - PREDICTED
            visible = [s for s in visible if s.unrobust > least]
        strongest: dict[tuple[str, str], Score] = {}
        for s in sorted(visible, key=lambda s: -s.unrobust):
            strongest.setdefault(s.effect.key, s)  # the variant that stands for its kind
        chosen: dict[tuple[str, str], Score] = {}
        for order in (
            sorted(visible, key=lambda s: (s.p_value, -s.unrobust)),
            sorted(visible, key=lambda s: -s.unrobust),
        ):
            keys = list(dict.fromkeys(s.effect.key for s in order))
            named = [key for key in keys if key[0] != "unknown"]
            for key in (*named[:6], *[key for key in keys if key[0] == "unknown"][:4]):
                chosen.setdefault(key, strongest[key])
        return list(chosen.values())

    def has_alarm(self, at: Weighted, table: ScoreTable) -> bool:
        """True if something is wrong: much is unexplained, or a test is significant."""
        best = table.smallest
        return at.is_hidden or (best is not None and best.adjusted < self.alpha)

    def round(self, at: Weighted, table: ScoreTable) -> list[Candidate]:
        """Refit the shortlist; best first."""
        found: list[Candidate] = []
        short = preselected(self, at, self.shortlist(at, table))
        for i, start in enumerate(short):
            s = start.score
            self.progress(f"refit {i + 1}/{len(short)}: {s.effect.kind} in {s.effect.key[1]}")
            candidate = (
                self.refit(at, s.effect, s.step, starts=s.starts)
                if start.found is None
                else self.again(at, start.found)
            )
            if candidate is not None and _is_plausible(candidate):
                found.append(replace(candidate, score=s))
        if not found:
            return found
        found = self.placed(at, found)
        found.sort(key=lambda c: -c.merit)
        return self.by_what_is_left(at, found) if at.is_hidden else self.rejudge(at, found)

    def by_what_is_left(self, at: Weighted, found: list[Candidate]) -> list[Candidate]:
        """Rank by n log(S_model / S_extended), S the sums of squares, n the samples that count.

        The noise's size is then not known, only what each candidate leaves. n is the number of
        independent samples worth as much as the residual of the best: misfit is no white noise.
        """
        r2 = self._losses(max(found, key=lambda c: c.gain))
        spread = float(np.var(r2)) * len(r2)
        long_run = float(long_run_covariance(r2[:, None], bartlett_lags(r2[:, None]))[0, 0])
        n = float(np.clip(len(r2) * spread / max(long_run, 1e-300), 8.0, len(r2)))
        out = []
        before = self._base_value(at)
        for c in found:
            # Less what input noise gives to each: a noise-free channel must not win by that alone.
            after = max(before - 0.5 * c.gain, 1e-12 * before)
            k = c.effect.cost
            gain = n * float(np.log(before / after))
            out.append(replace(c, gain=gain, cost=k * float(np.log(n)) + k))
        # In a decay, time and amplitude go together, and what happens in time, or rings on its own,
        # imitates whatever depends on amplitude: it must explain clearly more than the best that
        # does, half as much again (a heuristic).
        lasting = max((c.gain for c in out if c.effect.kind not in IMITATORS), default=0.0)
        out.sort(key=lambda c: -(c.merit - (0.5 * lasting if c.effect.kind in IMITATORS else 0.0)))
        return out

    def rejudge(
        self, at: Weighted, found: list[Candidate], count: int = 6, rounds: int = 2
    ) -> list[Candidate]:
        """Compare the leaders again under the noise that the best of them leaves.

        Under the first whitening the unexplained misfit counts as noise and hides differences.
        """
        best = found[0]
        noise = estimate_noise(best.fit.criterion, best.fit.x, known=self.known_noise)
        criterion = self._criterion(at.model, noise, at.fit.values, at.criterion)
        base_fit = self._minimum(criterion)
        again = replace(
            at, fit=base_fit, noise=noise, full=noise, input_sd=self._input_sd(noise, criterion)
        )
        out = []
        for c in found[:count]:
            if c is not best and c.gain <= WORTH * best.gain:
                continue
            criterion = self._criterion(c.model, noise, c.fit.values, at.criterion)
            for mine, other in zip(criterion.data, c.fit.criterion.data, strict=True):
                mine.used[:] = other.used
            fit = self._minimum(criterion)
            judged = self._judge(again, c.effect, c.names, c.model, fit)
            out.append(replace(judged, score=c.score))
        out.sort(key=lambda c: -c.merit)
        if out[0].effect.key != best.effect.key and rounds > 1:
            return self.rejudge(at, out, count, rounds - 1)
        return out

    def p_value(self, table: ScoreTable, candidate: Candidate) -> float:
        """Family-wise p: of the score, or of the refit once something is known to be wrong.

        A closed test: the family's smallest p, or misfit beyond the noise, tells that something is
        missing; its refits then tell what. A large effect is far from its linearised size, and its
        own score may be small.
        """
        score = table.adjusted(candidate.effect.key)
        count, test = len(table.tested), candidate.effect.test
        if test == "peak":
            lines = sum(d.N for d in candidate.fit.criterion.data) / 2
            refit = lines * float(chi2.sf(max(candidate.gain, 0.0), 3))
        elif test == "clip":
            # A clipping has no null value to be far from: its gain is judged.
            refit = 2 * count * float(norm.sf(np.sqrt(max(candidate.gain, 0.0) / 3)))
        else:
            refit = 2 * count * float(norm.sf(abs(candidate.wald)))
        return float(max(min(score, refit, 1.0), 1e-300))

    def rivals(
        self, at: Weighted, best: Candidate, found: Sequence[Candidate]
    ) -> tuple[Rival, ...]:
        """Candidates that the record cannot reject against the best one (Vuong 1989, (5.6)).

        Where the noise is known, six units of BIC are Kass and Raftery's (1995) "strong" evidence;
        where misfit hides it, gains are no likelihoods, and Vuong's test counts as well.
        """
        out = []
        mine = self._losses(best)
        for c in found:
            if c is best or c.effect.key == best.effect.key:
                continue
            difference = self._losses(c) - mine
            lags = bartlett_lags(difference[:, None])
            sd = float(np.sqrt(long_run_covariance(difference[:, None], lags)[0, 0]))
            total = float(difference.sum()) + 0.5 * (c.cost - best.cost)
            p = float(norm.sf(total / sd)) if sd > 0 else 1.0
            is_open = at.is_hidden and p > 0.05 and c.merit > 0.5 * best.merit
            if c.merit > best.merit - STRONG or is_open:
                out.append(Rival(c, max(p, 1e-300)))
        return tuple(sorted(out, key=lambda r: -r.p_value))

    def _losses(self, c: Candidate) -> Array:
        parts = []
        for e in range(len(c.fit.criterion.data)):
            r, _ = c.fit.criterion.columns(c.fit.x, e)
            parts.append(0.5 * np.sum(r**2, axis=1))
        return np.concatenate(parts)
