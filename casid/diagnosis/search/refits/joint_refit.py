"""One effect refitted jointly with all parameters, and what it gains:

    gain = 2 (J_model - J_extended)                                                            (1)

with J the whitened simulation error less what input noise alone gives to it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from casid.diagnosis.attempts import Attempts
from casid.diagnosis.evidence.scores.divergence import diverging_size
from casid.diagnosis.evidence.whitening.fit_points import use_samples_of
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.robust_errors import wald
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate, found_values, name_of
from casid.diagnosis.solvers import COMPARED
from casid.diagnosis.thresholds import REFITS, RESTARTS
from casid.errors import SolveError
from casid.estimation.nlp.solver import LEADS_TO_KNOWN
from casid.estimation.noise.variances import error_over_noise
from casid.estimation.simulation.minimization import Fit, minimize_simulation_error
from casid.estimation.simulation.short_horizons import fit_of_short_horizons
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.effect import KINDS, SWITCHED, Effect
from casid.model.model import Model


@dataclass(slots=True)
class Refitting:
    """Refits of candidates under the noise of the model that they extend."""

    weighing: Weighing
    left_out: dict[tuple[str, str], str] = field(default_factory=dict)  # a user's effect -> why
    attempts: Attempts = field(default_factory=Attempts)
    _before: tuple[Weighted, float] | None = None  # J of the last model requested

    def refit(
        self,
        at: Weighted,
        effect: Effect,
        step: float,
        *,
        starts: Mapping[str, float] | None = None,
        near: bool = False,
        below: float = np.inf,
    ) -> Candidate | None:
        """Fit the model with `effect` in it, from one or several starts of its first parameter.

        `starts` of its further parameters, by the effect's own names; `near` where `step` and those
        are known to be right: no others are tried. A fit that comes neither `below` a value of the
        criterion nor below the best before it ends early.
        """
        best: Candidate | None = None
        if self.attempts.attempt(name_of(effect), partial(self._runs_away, at, effect)):
            return None
        for start, upper in _starts(at, effect, step, near=near):
            first = {**(starts or {}), effect.parameters[0].name: start}
            values = {**at.fit.values, **(best.fit.values if best else {})}
            low = _lower(below, best)
            found = self.attempts.attempt(
                name_of(effect), partial(self._from, at, effect, first, upper, values, low, best)
            )
            best = _better(best, found)
        best = self._from_shorter_step(at, effect, step, starts or {}, best)
        best = self._from_declared_starts(at, effect, starts or {}, 0.0, best, below)
        if is_dead_time(effect):
            best = self._from_declared_starts(at, effect, starts or {}, step, best, below)
        if best is None:
            return None
        best = self._with_higher_bound(at, best)
        self.attempts.succeeded(name_of(effect))
        return best if _is_plausible(best) else None

    def _from_shorter_step(
        self,
        at: Weighted,
        effect: Effect,
        step: float,
        starts: Mapping[str, float],
        best: Candidate | None,
    ) -> Candidate | None:
        """The better of `best` and a fit from a part of the step, where that led away.

        At its null value an effect leaves the model as it is: a fit that ends farther from the
        records than that one began where the line does not hold that gave the step.
        """
        if effect.limit is not None or effect.kind in SWITCHED or effect.test == "clip":
            return best
        first = effect.parameters[0]
        for share in RESTARTS.shorter:
            if best is not None and not _is_farther(at, best.fit):
                break
            begun = {**starts, first.name: first.start + share * step}
            part = partial(self._from, at, effect, begun, None, at.fit.values)
            found = self.attempts.attempt(name_of(effect), part)
            best = _better(best, found)
        return best

    def _with_higher_bound(self, at: Weighted, best: Candidate) -> Candidate:
        """A delay or lag that ends at its upper bound, refitted from there under a higher one.

        Later fits of the same model, under other noise or to whole records, need that as well: the
        delay may be longer there.
        """
        effect, name = best.effect, best.names[0]
        while effect.limit is not None:
            reached, end = best.fit.values[name], best.model.parameters[name].upper
            if end >= effect.limit or reached < REFITS.inside * end:
                break
            first = {**found_values(best), effect.parameters[0].name: reached}
            upper = _upper_bound(at, effect, reached)
            on = partial(self._from, at, effect, first, upper, best.fit.values)
            found = self.attempts.attempt(name_of(effect), on)
            if found is None or found.gain <= best.gain:
                break
            best = found
        if effect.limit is None:
            return best
        model = best.model.copy()
        p = model.parameters[name]
        upper = max(p.upper, _upper_bound(at, effect, best.fit.values[name]))
        model.parameters[name] = replace(p, upper=upper)
        return replace(best, model=model)

    def _from_declared_starts(
        self,
        at: Weighted,
        effect: Effect,
        starts: Mapping[str, float],
        step: float,
        best: Candidate | None,
        below: float,
    ) -> Candidate | None:
        """The better of `best` and a fit from where the user would start, the effect from `step`.

        A model that is far from what was measured fits it with parameters that are far away, too,
        and the way back may lead over a hill. So it may for a change of a parameter of which the
        fit without it has left next to nothing: that bounds the change. Over windows of an unstable
        model the way begins at what fits over a short part of each.
        """
        if not _is_of_lost_parameter(at, effect):
            if error_over_noise(at.fit, at.noise) < RESTARTS.far:
                return best
            if best is not None and error_over_noise(best.fit, at.noise) < RESTARTS.explained:
                return best
        start, upper = _starts(at, effect, step, near=True)[0]
        first = {**starts, effect.parameters[0].name: start}
        afresh = partial(self._from, at, effect, first, upper, {}, _lower(below, best), best)
        found = self.attempts.attempt(name_of(effect), afresh)
        return _better(best, found)

    def _from(
        self,
        at: Weighted,
        effect: Effect,
        starts: Mapping[str, float],
        upper: float | None,
        values: Mapping[str, float],
        below: float = np.inf,
        best: Candidate | None = None,
    ) -> Candidate:
        """The refit from one start; `values` of everything else, `below` as in `refit`.

        `best` is what other starts led to, and is returned where this one leads there, too.
        """
        model, names = effect.extended(at.model, starts=starts, upper=upper)
        moved = moved_parameter(effect)
        if moved is not None and np.isinf(effect.parameters[0].lower):  # else it keeps the sign
            p = at.model.parameters.get(moved)
            begun = values.get(moved, p.nominal if p is not None else 0.0)
            _keep_sign(model, names[0], begun, effect)
        values = {name: value for name, value in values.items() if name not in names}
        solver = self.weighing.solver or COMPARED
        criterion = self.weighing.criterion(model, at.noise, values, at.criterion)
        if not values:
            short = fit_of_short_horizons(criterion.whitened(None), solver=solver)
            if short is not None:
                criterion = self.weighing.criterion(model, at.noise, short.values, at.criterion)
        fit = minimize_simulation_error(
            criterion,
            solver=replace(solver, below=below, known=_known(criterion, best)),
            check_rank=False,
            retry="none",
        )
        if best is not None and fit.solution.status == LEADS_TO_KNOWN:
            return best
        found = self.judged(at, effect, names, model, fit)
        if not (np.isfinite(found.gain) and np.isfinite(found.wald)):
            raise SolveError("its gain is not finite")
        if found.gain > 0 and _is_farther(at, fit):
            # The model without the effect is one of its own: it gains by what noise would leave.
            raise SolveError("its fit ended farther from the records than the model without it")
        return found

    def again(self, at: Weighted, found: Candidate, *, near: bool = True) -> Candidate | None:
        """A candidate refitted into another model or on other records, from what it was.

        Where the model without it is far from the records, from all that it was fitted with, too.
        """
        effect, values = found.effect, found_values(found)
        first = effect.parameters[0]
        new = self.refit(at, effect, values[first.name] - first.start, starts=values, near=near)
        is_far = error_over_noise(at.fit, at.noise) >= RESTARTS.far
        if new and not is_far and error_over_noise(new.fit, at.noise) < RESTARTS.explained:
            return new
        whole = partial(self._from, at, effect, values, None, found.fit.values, best=new)
        other = self.attempts.attempt(name_of(effect), whole)
        if other is None or not _is_plausible(other):
            return new
        return other if new is None or other.gain > new.gain else new

    def from_where_best_led(self, at: Weighted, found: Sequence[Candidate]) -> list[Candidate]:
        """Those that promise much, refitted from the parameters that the best of all led to.

        A model that is far from what was measured has fitted it by parameters that are far away,
        and a refit may find the way back with one cause and not with another. An effect begins
        small there: its size beside the far parameters is too large as a rule. What an input does
        between samples it does or does not: that may change the model much at once, wherever it is.
        """
        best = max(found, key=lambda c: c.gain, default=None)
        if best is None:
            return []
        is_far = error_over_noise(at.fit, at.noise) >= RESTARTS.far

        def is_tried(c: Candidate) -> bool:
            if c.effect.kind in SWITCHED:
                return c.gain < best.gain
            is_promising = is_far and RESTARTS.promising * best.gain <= c.gain < best.gain
            return is_promising and error_over_noise(c.fit, at.noise) >= RESTARTS.explained

        return [self._from_another(at, c, best) if is_tried(c) else c for c in found]

    def _from_another(self, at: Weighted, found: Candidate, other: Candidate) -> Candidate:
        """The better of a candidate and its refit from the parameters that another led to."""
        effect, best = found.effect, found
        there = {n: v for n, v in other.fit.values.items() if n not in other.names}
        values, first = found_values(found), effect.parameters[0]
        step = RESTARTS.shorter[0] * (values[first.name] - first.start)
        for start, upper in _starts(at, effect, step if effect.sided == "both" else abs(step)):
            begun = {**values, first.name: start}
            again = partial(self._from, at, effect, begun, upper, there, best=best)
            new = self.attempts.attempt(name_of(effect), again)
            if new is not None and _is_plausible(new) and new.gain > best.gain:
                best = replace(new, score=found.score)
        return best

    def moved(self, at: Weighted, found: Candidate, effect: Effect) -> Candidate | None:
        """A candidate refitted with its `effect` at another instant, from all that it was."""
        below = found.fit.solution.value
        there = partial(self._from, at, effect, found_values(found), None, found.fit.values, below)
        other = self.attempts.attempt(name_of(effect), there)
        return other if other is not None and _is_plausible(other) else None

    def judged(
        self, at: Weighted, effect: Effect, names: tuple[str, ...], model: Model, fit: Fit
    ) -> Candidate:
        """Gain over the model without the effect, on the samples that both use."""
        criterion = fit.criterion
        pairs = list(zip(at.criterion.data, criterion.data, strict=True))
        if all(np.array_equal(mine.used, other.used) for mine, other in pairs):
            before = self.value(at)
        else:
            base = self.weighing.criterion(at.model, at.noise, at.fit.values, at.criterion)
            use_samples_of(base, criterion)
            before = self.weighing.compensated_criterion(at, base, base.start)
        after = self.weighing.compensated_criterion(at, criterion, fit.x)
        windows = sum(criterion.parts(e) - 1 for e in range(len(pairs)))
        of_windows = windows * (len(model.states) - len(at.model.states))
        return Candidate(
            effect=effect,
            names=names,
            model=model,
            fit=fit,
            gain=2 * (before - after),
            cost=(effect.cost + of_windows) * float(np.log(criterion.n_samples)),
            of_windows=of_windows,
            of_inputs=fit.solution.value - after,
            wald=wald(fit, names[0], effect.parameters[0].start),
        )

    def value(self, at: Weighted) -> float:
        """J of a model as it was weighed; that of the last one requested is kept."""
        if self._before is None or self._before[0] is not at:
            self._before = at, self.weighing.compensated_criterion(at, at.criterion, at.fit.x)
        return self._before[1]

    def _runs_away(self, at: Weighted, effect: Effect) -> bool:
        """True if a user's effect makes the simulation diverge; `left_out` then notes it."""
        if effect.kind in KINDS:
            return False
        if effect.key not in self.left_out:
            size, first = diverging_size(at.fit, effect), effect.parameters[0]
            self.left_out[effect.key] = (
                f"{name_of(effect)} was left out: its simulation diverges already "
                f"at {first.name} = {size:.2g} {first.unit}: turn its sign round, bound it, or "
                "state it so that it stays small"
                if size is not None
                else ""
            )
        return bool(self.left_out[effect.key])


def _better(best: Candidate | None, found: Candidate | None) -> Candidate | None:
    """The candidate of two refits of an effect that gains more; of equal ones the first."""
    if best is None or found is None:
        return best or found
    return found if found.gain > best.gain else best


def _is_farther(at: Weighted, fit: Fit) -> bool:
    """True of an effect's fit that ended farther from the records than the model without it."""
    return fit.solution.value > (1 + REFITS.enough) * at.fit.solution.value


def _is_plausible(found: Candidate) -> bool:
    """False of an effect below its least size."""
    effect = found.effect
    size = found.fit.values[found.names[0]] - effect.parameters[0].start
    return abs(size) >= effect.constants.get("least", 0.0)


def _known(criterion: SimulationError, best: Candidate | None) -> tuple[float, ...]:
    """The minimum of a candidate, if it is one of this criterion, too: of its variables, inside."""
    if best is None or best.fit.criterion.names != criterion.names:
        return ()
    x = best.fit.x.tolist()
    inside = (v.lower <= a <= v.upper for v, a in zip(criterion.variables, x, strict=True))
    same = zip(criterion.data, best.fit.criterion.data, strict=True)
    is_same = all(inside) and all(np.array_equal(d.used, its.used) for d, its in same)
    return tuple(x) if is_same else ()


def _lower(below: float, best: Candidate | None) -> float:
    """The value of the criterion that a further start has to reach."""
    return below if best is None else min(below, best.fit.solution.value)


def is_dead_time(effect: Effect) -> bool:
    """True of an input that acts late."""
    return effect.kind == "time_delay" and effect.parameters[0].name.startswith("dead_time_")


def moved_parameter(effect: Effect) -> str | None:
    """The parameter that an effect moves, if it moves one."""
    if effect.kind == "scheduled_parameter":
        return effect.where.partition("~")[0]
    return effect.where if effect.kind in ("parameter_jump", "parameter_drift") else None


def _is_of_lost_parameter(at: Weighted, effect: Effect) -> bool:
    """True of a change of a parameter that is a small part of its declared start without it."""
    name = moved_parameter(effect)
    if name is None or name not in at.fit.values or name not in at.model.parameters:
        return False
    return abs(at.fit.values[name]) < RESTARTS.lost * abs(at.model.parameters[name].nominal)


def _starts(
    at: Weighted, effect: Effect, step: float, *, near: bool = False
) -> list[tuple[float, float | None]]:
    """Values of the first parameter to start from, each with its upper bound."""
    tick = _tick(at, effect)
    if effect.kind in SWITCHED:
        return [(effect.parameters[0].upper, None)]  # an input does the one or the other
    if effect.limit is not None:
        # A large delay or lag is far from its linearised size, and the fit has local minima.
        factors = REFITS.factors if at.noise_absorbs_misfit or abs(step) > tick else (1.0,)
        factors = (1.0,) if near else factors
        grid = {min(max(k * abs(step), REFITS.least_delay * tick), effect.limit) for k in factors}
        return [(g, _upper_bound(at, effect, g)) for g in sorted(grid)]
    if near:
        return [(effect.parameters[0].start + step, None)]
    if effect.test == "clip" and effect.variant is not None:
        return [(effect.variant, None)]
    if effect.kind == "parameter_jump":
        # A linearised step can exceed what the parameter itself can lose.
        name = effect.where
        now = abs(at.fit.values.get(name, 0.0)) or abs(step) * REFITS.unknown_size
        step = float(np.clip(step, -REFITS.step_share * now, REFITS.step_share * now))
    moved = moved_parameter(effect)
    value = at.fit.values.get(moved, 0.0) if moved is not None else 0.0
    if effect.span is not None and value != 0.0:
        low, high = _slopes_to_zero(effect.span, value)
        step = float(np.clip(step, REFITS.step_share * low, REFITS.step_share * high))
    null = effect.parameters[0].start
    if effect.cost > 1 and effect.sided == "both":
        # Its further parameters do nothing at zero, which no fit crosses by itself.
        return [(null + step, None), (null - step, None)]
    if effect.kind == "end_stop":
        return [(null + k * max(step, 0.0), None) for k in REFITS.stiffer]
    return [(null + (step if effect.sided == "both" else max(step, 0.0)), None)]


def _upper_bound(at: Weighted, effect: Effect, start: float) -> float:
    """The upper bound of a delay or lag that is searched from a start."""
    assert effect.limit is not None
    return min(REFITS.room * start + REFITS.room_samples * _tick(at, effect), effect.limit)


def _tick(at: Weighted, effect: Effect) -> float:
    """The step in which a delay is resolved, of a gap one of the corners beside it."""
    Ts = at.criterion.data[0].Ts
    return Ts if effect.parameters[0].unit == "s" else effect.constants.get("width", Ts)


def _keep_sign(model: Model, change: str, value: float, effect: Effect) -> None:
    """Bound a change so that the parameter keeps its sign and its order of magnitude.

    A slope may move twice as far: the value, here that of the model without it, may yet grow. For a
    while it may be many times as large, as what a room loses by an open door.
    """
    if value == 0.0:
        return
    if effect.span is None:
        growth = REFITS.growth if effect.end is None else REFITS.growth_for_a_while
        low, high = sorted((-REFITS.loss * value, growth * value))
    else:
        low, high = sorted(
            REFITS.slope_room * slope for slope in _slopes_to_zero(effect.span, value)
        )
    p = model.parameters[change]
    start = float(np.clip(p.start, REFITS.inside * low, REFITS.inside * high))
    model.parameters[change] = replace(p, lower=low, upper=high, start=start)


def _slopes_to_zero(span: tuple[float, float], value: float) -> tuple[float, float]:
    """The slopes at which a parameter of `value` is zero at one end of its channel's range."""
    low, high = sorted((-value / span[0], -value / span[1]))
    return low, high
