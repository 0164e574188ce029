"""Which causes are adopted: significant, and borne out by what was held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from casid.arrays import Array
from casid.diagnosis.evidence.prewhitening import EXACT, Weighted
from casid.diagnosis.evidence.robust_errors import wald
from casid.diagnosis.search.alternatives import IMITATORS, p_value, rivals_of
from casid.diagnosis.search.candidates import (
    Adopted,
    Candidate,
    Rival,
    name_of,
    null_values,
    taken_out,
)
from casid.diagnosis.search.reconsideration import better_rivals
from casid.diagnosis.search.residual_check import is_more_than_noise
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import COMPARISON, ROUNDS
from casid.estimation.holdout import Split, held_out_error, why_no_better, why_worse
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.effect import ON_THE_CLOCK


def adopt_causes(
    search: Search, at: Weighted, base_fit: Fit, split: Split, settings: FitSettings
) -> tuple[list[Adopted], Weighted, Fit | None]:
    """Adopt effects until nothing significant is left that improves what was held out.

    Returns what was adopted, the last model under its noise, and its simulation-error fit.
    """
    once = replace(settings, starts=1, solver=settings.solver or EXACT)
    error = held_out_error(base_fit, split)
    state = _Selection(search, split, once, start=at, at=at, fit=base_fit, error=error)
    while len(state.adopted) < search.max_causes and state.adopt_next():
        state.exchange_last()
    adopted, at = state.adopted, state.at
    extended = state.fit if adopted else None
    if extended is not None and len(adopted) > 1:
        left = search.attempts.attempt(
            "the test whether later causes make earlier ones superfluous",
            partial(_eliminated, search, adopted, extended, split, once),
        )
        adopted, at, extended = left or (adopted, at, extended)
    return adopted, at, extended


@dataclass(slots=True)
class _Selection:
    """Forward selection: the model as extended so far."""

    search: Search
    split: Split
    settings: FitSettings
    start: Weighted  # the model as it is
    at: Weighted
    fit: Fit  # simulation error, whole records
    error: Array  # held out
    adopted: list[Adopted] = field(default_factory=list)

    def adopt_next(self) -> bool:
        """One round of the search; False where nothing was adopted."""
        search, at = self.search, self.at
        search.progress(f"test every effect (round {len(self.adopted) + 1})")
        named = [a.candidate for a in self.adopted]
        attempt = search.attempts.attempt
        table = attempt(f"round {len(named) + 1} of the search", lambda: search.table(at, named))
        if table is None:
            return False
        if search.first_table is None:
            search.first_table = table
        # A score is robust by what repeats: misfit in one short burst, which no score can see,
        # shows in the residual's kind.
        is_scored = search.has_alarm(at, table)
        if not is_scored and not attempt(
            "the test of the residual", lambda: is_more_than_noise(at, search)
        ):
            return False
        found = attempt("the refits of the candidates", lambda: search.round(at, table, named))
        if not found:
            return False
        if not self.adopted:
            search.first_candidates = found
        # The first alarm has the rate that the user set, and is named unless the held-out data
        # speak against it; a further cause has to earn its place there.
        is_alarm = is_scored and not (self.adopted or at.noise_absorbs_misfit)
        for best in _named_first(at, found):
            p = p_value(table, best)
            if p >= search.alpha or (best.merit <= 0 and not is_alarm):
                continue
            if self._adopt(best, is_alarm=is_alarm):
                self.adopted.append(Adopted(best, p, rivals_of(at, best, found), at))
                return True
        return False

    def _adopt(self, best: Candidate, *, is_alarm: bool) -> bool:
        """Extend the model, unless the held-out data speak against it, or the fit fails."""
        attempts, what = self.search.attempts, f"the extension by {name_of(best.effect)}"
        why = attempts.attempt(what, partial(self._extend, best, is_alarm=is_alarm))
        if why is None:
            why = attempts.failed.pop(what, "no time was left to extend the model by it")
        if why:
            self.search.refused.append((best, why))
        return not why

    def _extend(self, best: Candidate, *, is_alarm: bool) -> str:
        """Extend the model; why the held-out data speak against it, or an empty text."""
        fit = _whole_fit(best, self.split, self.settings)
        error = held_out_error(fit, self.split)
        refuse = why_worse if is_alarm else why_no_better
        why = refuse(self.error, error)
        if why and best.effect.kind not in ON_THE_CLOCK:
            # The errors that an integrator has gathered say little: judge the end anew as well,
            # where the cause means something on a clock that starts anew.
            why = refuse(*(held_out_error(f, self.split, anew=True) for f in (self.fit, fit)))
        if not why:
            at = self.search.weighing.weigh(best.model, fit, rounds=1)
            self.error, self.fit, self.at = error, fit, at
        return why

    def exchange_last(self) -> None:
        """Take a rival of the last cause instead, where that leaves noise and the cause does not.

        Only where the noise model absorbed misfit before the cause was adopted.
        """
        search, taken = self.search, self.adopted[-1]
        is_open = taken.rivals and taken.before is not None and taken.before.noise_absorbs_misfit
        if not is_open or self.at.noise_absorbs_misfit or not is_more_than_noise(self.at, search):
            return
        search.progress(f"compare the rivals of {taken.candidate.effect.kind} by their residuals")
        for other in better_rivals(search, self.adopted, self.start, self.at):
            what = f"the extension by {name_of(other.effect)}"
            if search.attempts.attempt(what, partial(self._exchange, taken, other)):
                return

    def _exchange(self, taken: Adopted, other: Candidate) -> bool:
        """Take another candidate in the place of the last one, if it leaves noise alone."""
        fit = _whole_fit(other, self.split, self.settings)
        instead = self.search.weighing.weigh(other.model, fit, rounds=1)
        if is_more_than_noise(instead, self.search):
            return False
        error = held_out_error(fit, self.split)
        self.adopted[-1] = replace(taken, candidate=other, rivals=_others(taken, other))
        self.error, self.fit, self.at = error, fit, instead
        return True


def _whole_fit(candidate: Candidate, split: Split, settings: FitSettings) -> Fit:
    return fit_model(
        candidate.model,
        split.fitted,
        settings,
        start=candidate.fit.values,
        check_rank=False,
        throw=False,
    )


def _others(taken: Adopted, chosen: Candidate) -> tuple[Rival, ...]:
    """The rivals of one that was exchanged for one of them; all are judged once more."""
    first = Rival(taken.candidate, 1.0)
    return (first, *(r for r in taken.rivals if r.candidate.effect is not chosen.effect))


def _eliminated(
    search: Search, adopted: Sequence[Adopted], fit: Fit, split: Split, settings: FitSettings
) -> tuple[list[Adopted], Weighted, Fit]:
    """Take back, last first, what later causes have made insignificant; refit what is left."""
    kept, refused = list(adopted), []
    for a in reversed(adopted):
        c = a.candidate
        null = null_values(c)
        first = c.names[0]
        if len(kept) == 1 or c.effect.test != "score":
            continue
        if abs(wald(fit, first, null[first])) > ROUNDS.backward_wald:
            continue
        refused.append((c, "the other causes together leave nothing for it to explain"))
        kept.remove(a)
        model = taken_out(fit.criterion.model, null)
        values = {k: v for k, v in fit.values.items() if k not in c.names}
        fit = fit_model(model, split.fitted, settings, start=values, check_rank=False, throw=False)
    at = search.weighing.weigh(fit.criterion.model, fit, rounds=1)
    search.refused += refused
    return kept, at, fit


def _named_first(at: Weighted, found: list[Candidate]) -> list[Candidate]:
    """By merit; of those that are the same thing in this model, the one named by convention.

    A neighbour without a name goes behind the best named one that the record cannot reject against
    it: catalogued effects have higher prior plausibility.
    """
    order = list(found)
    likely = COMPARISON.likely
    if at.noise_absorbs_misfit:
        likely = max(
            COMPARISON.likely, COMPARISON.likely_share * max((c.merit for c in order), default=0.0)
        )
    for i in range(1, len(order)):
        for j in range(i, 0, -1):
            near = abs(order[j - 1].merit - order[j].merit) < likely
            if near and order[j].effect.priority < order[j - 1].effect.priority:
                order[j - 1], order[j] = order[j], order[j - 1]
    if order and order[0].effect.kind == "unknown" and order[0].effect.priority > 0:
        open_ = {id(r.candidate) for r in rivals_of(at, order[0], order)}
        catalogued = [c for c in order if c.effect.kind not in ("unknown", *IMITATORS)]
        named = [c for c in catalogued if id(c) in open_]
        order = [*named[:1], *[c for c in order if c not in named[:1]]]
    return order
