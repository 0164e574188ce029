"""The adopted causes as a set: none superfluous, none for a better rival, none too small to matter.

Causes are adopted one after another, the first ones while the others are still missing. The
complete set is therefore refined by the errors of all causes together:

- a cause that the others have made insignificant is removed;
- where the noise model absorbed misfit, gains were no likelihoods: a cause is replaced by a rival
  that, beside the other causes, fits as well in practice and has a smaller held-out error, and a
  function without a name by a named effect that fits and predicts as well in practice, and leaves
  noise alone where the function does;
- a store whose time constant ends at a bound is replaced by a simpler effect that does the same;
- a cause that explains less than `JUDGING.practical` of the misfit is a small remainder: reported,
  but not as a cause, unless a parameter of the model is another one without it (`JUDGING.carried`):
  dry friction that viscous friction replaces but for little; or unless an output errs far more
  without it (`JUDGING.unlike`), by a share of its own misfit, or than the noise which all causes
  leave. A remainder leaves the extended model too, unless the sizes of the causes need it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from casid.arrays import TINY, Array
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.robust_errors import std_error, wald
from casid.diagnosis.evidence.whitening.weighted_model import Weighted, minus_log_likelihood
from casid.diagnosis.search.candidates import (
    Adopted,
    Candidate,
    Rival,
    as_placed,
    extended_by,
    is_needed,
    name_of,
    null_values,
    taken_out,
    values_by_new_names,
)
from casid.diagnosis.search.comparison.alternatives import TANGENTS, is_imitator
from casid.diagnosis.search.comparison.contributions import contributions_of, values_without_any
from casid.diagnosis.search.comparison.simulation_errors import (
    SimulationErrors,
    fitted_error,
    on_common_samples,
    simulation_errors,
    why_held_out,
)
from casid.diagnosis.search.disturbance.disturbance_price import explaining_disturbance
from casid.diagnosis.search.instants.instant_errors import moved_in_time
from casid.diagnosis.search.refits.swinging_parts import in_motion, may_move
from casid.diagnosis.search.refusals import SUPERFLUOUS, Refusal
from casid.diagnosis.search.residual_check import is_noise_alone, leaves_more
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import JUDGING, JUMPS, ROUNDS
from casid.errors import SolveError
from casid.estimation.holdout import Split, counted_by_all, why_worse
from casid.estimation.simulation.fit import FitSettings, fit_model, weighted_by_errors
from casid.estimation.simulation.minimization import DivergenceError, Fit
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class Adoption:
    """Adopted causes, the model with them weighted by its noise, and its simulation-error fit."""

    adopted: tuple[Adopted, ...]
    at: Weighted
    fit: Fit | None
    remainders: tuple[Adopted, ...] = ()  # significant, but too small to matter


@dataclass(frozen=True, eq=False)
class Refinement:
    """Steps that refine adopted causes as a set: each takes an `Adoption` and returns another.

    Attributes
    ----------
    units : of the outputs, see `simulation_errors`.
    start, base : the model without causes, weighted by its noise, and its simulation-error fit.
    """

    search: Search
    split: Split
    settings: FitSettings
    units: Array
    start: Weighted
    base: Fit

    @cached_property
    def before(self) -> SimulationErrors:
        """The errors of the model without causes, in the units in which all are compared."""
        return simulation_errors(self.base, self.split, self.units)

    def without_insignificant(self, found: Adoption) -> Adoption:
        """Without causes that are no longer significant beside those adopted later, last first."""
        kept, fit, refused = list(found.adopted), found.fit, []
        assert fit is not None
        least = max(self.search.distance_when_chosen, ROUNDS.backward_wald)
        for a in reversed(found.adopted):
            c = a.candidate
            first = c.names[0]
            if len(kept) == 1 or c.effect.test != "score":
                continue
            if abs(wald(fit, first, null_values(c)[first])) > least:
                continue
            without = self.fit_without(fit, c, kept)
            if c.effect.cost > 1 and self.is_missed(fit, without):
                continue  # its parameters exchange for each other, and none is known by itself
            refused.append((c, SUPERFLUOUS))
            kept.remove(a)
            fit = without
        lean = self._rebuilt_unless_worse(found, kept, fit) if refused else found
        if lean is not found:
            self.search.refused += refused
        return lean

    def without_unneeded(
        self, found: Adoption, why: Callable[[Adopted, Fit, Fit], Refusal]
    ) -> Adoption:
        """Without causes that are not needed beside the others, last first; one stays.

        Parameters
        ----------
        why : a cause is not needed, by the fits with it and without, if it is not.
        """
        kept, fit, refused = list(found.adopted), found.fit, []
        assert fit is not None
        for a in reversed(found.adopted):
            if len(kept) == 1:
                break
            without = self.fit_without(fit, a.candidate, kept)
            reason = why(a, fit, without)
            if reason:
                refused.append((a.candidate, reason))
                kept.remove(a)
                fit = without
        self.search.refused += refused
        return self.rebuilt(found, kept, fit) if refused else found

    def with_better_rivals(self, found: Adoption) -> Adoption:
        """With causes replaced by rivals that have a smaller held-out error."""
        if not self.start.noise_absorbs_misfit or found.fit is None:
            return found
        adopted, fit = list(found.adopted), found.fit
        errors = simulation_errors(fit, self.split, self.units)
        is_new = False
        for i in range(len(adopted)):
            is_limit = _is_at_its_limit(fit, adopted[i].candidate)
            rest = [a.candidate for k, a in enumerate(adopted) if k != i]
            if is_needed(self.start.model, rest):
                continue
            rivals = list(self._rivals(adopted, i, is_limit=is_limit))
            bare = self._errors_without(adopted, i, fit) if rivals else self.before
            for rival in rivals:
                pair = (
                    f"{name_of(adopted[i].candidate.effect)} with {name_of(rival.effect)} by the "
                    "held-out error"
                )
                self.search.progress(f"compare {pair}")
                others = [a.candidate for a in adopted]
                others[i] = rival
                tried = self.search.attempts.attempt(
                    f"the comparison of {pair}", partial(self._tried, others, fit)
                )
                if tried is None:
                    continue
                placed, other, after = tried
                own = adopted[i].candidate
                if self._is_preferred(own, bare, errors, after, is_limit=is_limit) and not (
                    own.effect.is_unnamed and leaves_more(self.search, found.at, other)
                ):
                    adopted = as_placed(adopted, placed)
                    adopted[i] = exchanged(found.adopted[i], placed[i])
                    fit, errors, is_new = other, after, True
        return self.reweighed(found, adopted, fit) if is_new else found

    def _tried(
        self, causes: Sequence[Candidate], near: Fit
    ) -> tuple[list[Candidate], Fit, SimulationErrors]:
        """Other causes by their new names, the fit of the model with them, and its errors."""
        placed, fit = self.with_causes(causes, near)
        return placed, fit, simulation_errors(fit, self.split, self.units)

    def with_initial_motion(self, found: Adoption) -> Adoption:
        """With the initial motion of the part adopted last estimated, where that is likelier.

        By Schwarz's criterion. A part is first adopted at rest: with free initial states, it
        imitates by its own decay the laws that are still missing.
        """
        last, fit = found.adopted[-1], found.fit
        if fit is None or not may_move(last.candidate):
            return found
        what = name_of(last.candidate.effect)
        self.search.progress(f"estimate how {what} moves when the record begins")
        causes = [a.candidate for a in found.adopted]
        causes[-1] = replace(causes[-1], effect=in_motion(self.start.model, causes[-1]))
        placed, other = self.with_causes(causes, fit)
        return self.if_worth(found, placed, other, len(other.x) - len(fit.x))

    def if_worth(
        self, found: Adoption, placed: Sequence[Candidate], fit: Fit, more: int
    ) -> Adoption:
        """The causes as in another fit, with more unknowns, where that pays for them (Schwarz)."""
        new = self.reweighed(found, as_placed(found.adopted, placed), fit)
        price = 0.5 * more * float(np.log(fit.criterion.n_samples))
        gain = minus_log_likelihood(found.at) - minus_log_likelihood(new.at)
        return new if gain > price else found

    def with_refitted_instants(self, found: Adoption) -> Adoption:
        """With the instants of changes refitted to the whole records, beside all causes.

        They were placed under the noise of a model without the cause, which may weigh the outputs
        by far larger errors than they have. Those beside a disturbance stay: the least simulation
        error lies where the disturbance is small as well.
        """
        adopted, fit = list(found.adopted), found.fit
        assert fit is not None
        if moved_in_time(self.start.model, adopted, fit) is None:
            return found  # the test for a disturbance takes seconds
        if explaining_disturbance(self.search, found.at, fit) is not None:
            return found
        for _ in range(JUMPS.moves):
            causes = moved_in_time(self.start.model, adopted, fit)
            if causes is None:
                break
            placed, other = self.with_causes(causes, fit)
            if not other.solution.value < fit.solution.value:
                break
            adopted = as_placed(adopted, placed)
            fit = other
        return found if fit is found.fit else self.reweighed(found, adopted, fit)

    def with_likelier_instants(self, found: Adoption) -> Adoption:
        """With refitted instants of changes found beside a disturbance, where that is likelier.

        A disturbance explains what a change leaves that was placed too early or too late.
        """
        if not any(a.candidate.effect.sets_in for a in found.adopted):
            return found
        return self.if_likelier(found, self.with_refitted_instants)

    def if_likelier(self, found: Adoption, refined: Callable[[Adoption], Adoption]) -> Adoption:
        """The likelier of `found` and `refined(found)`, each with the disturbance that it leaves.

        Parameters
        ----------
        found : what was found beside a disturbance.
        refined : a step that refines it by its simulation error alone.
        """
        if found.fit is None:
            return found
        placed, fit = self.with_causes([a.candidate for a in found.adopted], found.fit)
        adopted = as_placed(found.adopted, placed)
        new = refined(replace(found, adopted=tuple(adopted), fit=fit))
        return min(found, new, key=lambda each: minus_log_likelihood(each.at))

    def without_small(self, found: Adoption) -> Adoption:
        """Without causes that explain too little and bias no parameter; they become remainders.

        The smallest first. The effect of one stays in the model if a cause's size would otherwise
        move by more than its standard error: the errors would be small, and the size biased.
        """
        kept, fit, small = list(found.adopted), found.fit, list(found.remainders)
        assert fit is not None
        # Of two that do the same each is small beside the other: what is left is judged without
        # all that were taken out before, even those that stay in the model.
        bare, judged = fit, list(range(len(kept)))
        is_whole = len(kept) > 1 and is_noise_alone(found.at, self.search)
        while len(kept) > 1 and judged:
            losses = contributions_of(self.search.weighing, kept, bare, self.search.attempts)
            total = max(sum(losses), TINY)
            i = min(judged, key=lambda k: losses[k])
            if losses[i] >= JUDGING.practical * total:
                break
            without = self.fit_without(bare, kept[i].candidate, kept)
            judged.remove(i)
            is_seen = self._is_seen(bare, without, of_any_share=is_whole)
            if is_seen or _carries(self.start.model, bare, without):
                continue
            share = losses[i] / total
            small.append(replace(kept.pop(i), share=share))
            bare, judged = without, [k - (k > i) for k in judged]
            # What nobody would see is no part of a size: a hold that takes its share of a delay.
            stays = share >= JUDGING.visible and _moves(kept, fit, bare)
            fit = fit if stays else bare
        if len(kept) == len(found.adopted):
            return found
        return self._rebuilt_unless_worse(replace(found, remainders=tuple(small)), kept, fit)

    def _rivals(
        self, adopted: Sequence[Adopted], i: int, *, is_limit: bool = False
    ) -> Iterator[Candidate]:
        """Candidates to replace a cause: its rivals, and for an unnamed function all named effects.

        Parameters
        ----------
        is_limit : the cause does what a simpler effect does, with a name or without.
        """
        taken = {a.candidate.effect.key for a in adopted}
        own = adopted[i].candidate.effect
        candidates = [r.candidate for r in adopted[i].rivals]
        if own.is_unnamed or is_limit:
            candidates += [c for c in self.search.first_candidates if c.effect.where == own.where]
        count = 0
        for c in candidates:
            may_be = c.effect.kind != "unknown" or is_limit and c.effect.is_unnamed
            # A channel that predicts a noisy input errs less by that alone.
            may_be &= c.effect.kind != "extra_input" or not any(self.start.input_sd.values())
            is_new = c.effect.key not in taken and may_be and not is_imitator(c)
            # Near one level a constant fits as well as the law whose tangent it is.
            is_tangent = own.kind == "unknown" and not own.is_unnamed and c.effect.kind in TANGENTS
            if is_new and not is_tangent and count < ROUNDS.rivals:
                count += 1
                taken.add(c.effect.key)
                yield c

    def is_missed(self, fit: Fit, without: Fit) -> bool:
        """True if the error of the fitted part is larger without an effect, in practice."""
        now, then = self._compared(fit, without)
        return then.square > (1 + JUDGING.practical) * now.square

    def _is_seen(self, fit: Fit, without: Fit, *, of_any_share: bool) -> bool:
        """True if one output errs far more without an effect, by a share of what all explain in it.

        Sums hide it where the misfit of another output, or a cause in this one, is far larger. Of
        any share it counts where the causes together leave noise alone: what it takes away is then
        no part of the shape of a larger one, which would leave more.
        """
        errors = [fitted_error(f, self.split, self.units) for f in (fit, without)]
        errors = counted_by_all(*errors, self.before.fitted)
        now, then, before = (np.nansum(e**2, axis=0) for e in errors)
        is_seen = then > JUDGING.unlike**2 * now
        is_much = then - now >= JUDGING.practical * (before - now)
        return bool(np.any(is_seen & (is_much | of_any_share)))

    def _compared(self, *fits: Fit) -> list[SimulationErrors]:
        """Errors of fits, on the samples that all of them count."""
        return on_common_samples(*(simulation_errors(f, self.split, self.units) for f in fits))

    def _errors_without(self, adopted: Sequence[Adopted], i: int, fit: Fit) -> SimulationErrors:
        """The errors with all causes but one: a rival has to explain what that one does."""
        if len(adopted) == 1:
            return self.before
        without = self.fit_without(fit, adopted[i].candidate, adopted)
        return simulation_errors(without, self.split, self.units)

    def _is_preferred(
        self,
        own: Candidate,
        bare: SimulationErrors,
        old: SimulationErrors,
        new: SimulationErrors,
        *,
        is_limit: bool = False,
    ) -> bool:
        """True if a rival fits as well in practice, and predicts better or is the one with a name.

        In practice: it leaves less than `JUDGING.practical` more of what there is without the cause
        (`bare`), and takes more than that of the held-out error away.
        """
        bare, old, new = on_common_samples(bare, old, new)
        fits = new.square - old.square < JUDGING.practical * (bare.square - old.square)
        gained = bare.held_out_square - old.held_out_square
        lost = new.held_out_square - old.held_out_square
        if is_limit and not own.effect.is_store:  # of two simpler ones, the better
            return new.square < old.square and lost < 0.0
        if own.effect.is_unnamed or is_limit:
            return fits and lost <= JUDGING.practical * max(gained, 0.0)
        left = (1 - JUDGING.practical) * old.held_out_square  # less is no better in practice
        return fits and 0.0 <= new.held_out_square < left and not why_held_out(old, new)

    def with_causes(
        self, causes: Sequence[Candidate], near: Fit | None, substeps: int | None = None
    ) -> tuple[list[Candidate], Fit]:
        """These causes in the model as it is, by their new names, and its fit from `near`."""
        model, placed = extended_by(self.start.model, causes)
        known = {} if near is None else near.values
        values = {**self.start.fit.values, **known, **values_by_new_names(placed, causes)}
        settings = replace(self.settings, substeps=substeps or self.settings.substeps)
        return placed, whole_fit(model, self.split, settings, self.units, values)

    def fit_without(self, fit: Fit, c: Candidate, among: Sequence[Adopted]) -> Fit:
        """The model fitted again without one cause of those in it (`among`).

        From the fit with all of them or, should that diverge, from the model as it was before any.
        """
        model = taken_out(fit.criterion.model, null_values(c))
        for values in (fit.values, values_without_any(among, fit)):
            start = {k: v for k, v in values.items() if k not in c.names}
            with suppress(DivergenceError):
                return whole_fit(model, self.split, self.settings, self.units, start)
        raise SolveError(f"{model.name} diverges without {name_of(c.effect)}")

    def _rebuilt_unless_worse(self, found: Adoption, kept: Sequence[Adopted], fit: Fit) -> Adoption:
        """The model rebuilt with the causes kept; `found` itself where that loses too much."""
        return found if self._loses_too_much(found.fit, fit) else self.rebuilt(found, kept, fit)

    def rebuilt(self, found: Adoption, kept: Sequence[Adopted], fit: Fit) -> Adoption:
        """The model rebuilt with the causes kept: no removed term stays in it at its null value."""
        inside = [a for a in found.adopted if a.candidate.names[0] in fit.criterion.names]
        if len(inside) == len(found.adopted):
            return self.reweighed(found, kept, fit)
        # From where they are without the others, which may be far from where each was found.
        placed, fit = self.with_causes([replace(a.candidate, fit=fit) for a in inside], fit)
        own = zip(placed, inside, strict=True)
        new = {c.effect.key: replace(c, fit=a.candidate.fit) for c, a in own}

        def again(rows: Sequence[Adopted]) -> tuple[Adopted, ...]:
            return tuple(
                replace(a, candidate=new.get(a.candidate.effect.key, a.candidate)) for a in rows
            )

        return self.reweighed(replace(found, remainders=again(found.remainders)), again(kept), fit)

    def _loses_too_much(self, whole: Fit | None, lean: Fit) -> bool:
        """True if a fit without some effects errs by more than these can have explained.

        Or if it predicts the held-out part worse than the model without any cause, and the fit with
        them does not.
        """
        assert whole is not None
        old, new = self._compared(whole, lean)
        bare, *_ = on_common_samples(self.before, old)
        worse = [why_worse(bare.continued, errors.continued) for errors in (old, new)]
        if worse[1] and not worse[0]:
            return True
        return not new.square - old.square <= ROUNDS.lean * (bare.square - old.square)

    def reweighed(self, found: Adoption, kept: Sequence[Adopted], fit: Fit | None) -> Adoption:
        """The causes kept, with their fit weighted by the noise of its own residual."""
        assert fit is not None
        at = self.search.weighing.weigh(fit.criterion.model, fit, rounds=1)
        return replace(found, adopted=tuple(kept), at=at, fit=fit)


def whole_fit(
    model: Model, split: Split, settings: FitSettings, units: Array, start: Mapping[str, float]
) -> Fit:
    """The simulation-error fit of an extended model; `units` as in `simulation_errors`."""
    return fit_model(
        model, split.fitted, settings, start=start, weights=units, check_rank=False, throw=False
    )


def weighed_whole(weighing: Weighing, fit: Fit, settings: FitSettings) -> tuple[Fit, Weighted]:
    """A whole fit under its noise: in units of its own errors where only those leave noise alone.

    In units of the errors of the model as it is, an output whose error an effect explains nearly
    all of counts for little, and the small misfit that the fit leaves there passes for more to
    explain.
    """
    model = fit.criterion.model
    at = weighing.weigh(model, fit, rounds=1)
    if not at.noise_absorbs_misfit or weighing.takes_disturbances:
        return fit, at
    own = weighted_by_errors(fit, settings)
    of_own = at if own is fit else weighing.weigh(model, own, rounds=1)
    return (fit, at) if of_own.noise_absorbs_misfit else (own, of_own)


def _moves(kept: Sequence[Adopted], fit: Fit, other: Fit) -> bool:
    """True if the size of a cause differs between two fits by more than its standard error."""
    names = {a.candidate.names[0] for a in kept} & set(fit.criterion.names)
    shift = {n: abs(fit.values[n] - other.values[n]) for n in names}
    return any(d > std_error(fit, n) for n, d in shift.items())


def _is_at_its_limit(fit: Fit, c: Candidate) -> bool:
    """True of a store whose time constant ends at a bound: what it does, a simpler effect does.

    One that follows next to never is a flow that grows with the level; one that follows at once,
    a larger capacity.
    """
    held = {*fit.solution.at_lower, *fit.solution.at_upper}
    return c.effect.is_store and any(name in held for name in c.names[1:])


def _carries(model: Model, fit: Fit, without: Fit) -> bool:
    """True if a parameter of `model`, one that keeps its sign, is another one without a cause."""

    def is_moved(name: str) -> bool:
        shift = abs(without.values[name] - fit.values[name])
        far = JUDGING.carried * abs(fit.values[name])
        return shift > far and shift > JUDGING.clearly * std_error(fit, name)

    sized = {n for n, p in model.parameters.items() if p.lower >= 0.0 or p.upper <= 0.0}
    return any(is_moved(n) for n in sized & fit.values.keys() & without.values.keys())


def exchanged(taken: Adopted, chosen: Candidate) -> Adopted:
    """Another candidate in the place of one, which is its first rival then."""
    first = Rival(taken.candidate, 1.0)
    others = (r for r in taken.rivals if r.candidate.effect.key != chosen.effect.key)
    near = tuple(c for c in taken.near if c.effect.key != chosen.effect.key)
    return replace(taken, candidate=chosen, rivals=(first, *others), near=near)
