"""Which causes are adopted: significant, and with smaller errors on all that was measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from casid.arrays import Array
from casid.diagnosis.evidence.scores.score_tests import ScoreTable
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.adoption.clipped_readings import why_no_limit
from casid.diagnosis.search.adoption.event_renaming import with_last_event_renamed
from casid.diagnosis.search.adoption.first_contacts import with_first_contact
from casid.diagnosis.search.adoption.friction_sharpness import (
    with_sharp_friction,
    with_sharp_friction_beside,
    without_blunt_reversals,
)
from casid.diagnosis.search.adoption.instants_beside import with_last_change_placed
from casid.diagnosis.search.adoption.powers_of_signals import with_better_powers
from casid.diagnosis.search.adoption.reconsideration import better_rivals
from casid.diagnosis.search.adoption.refinement import (
    Adoption,
    Refinement,
    exchanged,
    weighed_whole,
    whole_fit,
)
from casid.diagnosis.search.candidates import Adopted, Candidate, name_of
from casid.diagnosis.search.comparison.alternatives import (
    Losses,
    is_imitator,
    laws_before_memory,
    near_ones,
    p_value,
    rivals_of,
    without_imitations,
)
from casid.diagnosis.search.comparison.simulation_errors import (
    SimulationErrors,
    Soundness,
    is_as_good_held_out,
    on_common_samples,
    simulation_errors,
    why_much_worse,
    why_not_adopted,
)
from casid.diagnosis.search.disturbance.disturbance_price import (
    is_random,
    pays,
    with_lines_beside_disturbances,
)
from casid.diagnosis.search.disturbance.sole_disturbance import pays_beside, sole_disturbance
from casid.diagnosis.search.refits.soft_stops import is_soft_stop
from casid.diagnosis.search.refusals import ACCEPTED, LEAVES_MORE, Refusal
from casid.diagnosis.search.residual_check import is_more_than_noise, is_noise_alone
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import BUDGET, COMPARISON, FRICTION, ROUNDS
from casid.estimation.holdout import Split, why_worse
from casid.estimation.local_rank import rank_of
from casid.estimation.simulation.fit import FitSettings, weighted_by_errors
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.effect import HYSTERESIS_SHAPE, LATE

SHARPNESS = "the sharpness of a reversal"
BLUNT = "the test of causes that a blunt reversal brings about"
POWERS = "the powers by which parameters change with states and channels"
INSTANTS = "the instants of changes in the whole records"
LINES = "the likelihoods of lines beside a random disturbance"
BESIDE = "the instant of a change beside a random disturbance"
EVENT = "the comparison of what sets in with other changes at its instant"
MOTION = "the motion of a further part when the record begins"
CONTACT = "the place of a command in its play when the record begins"
PREDICTION = "the comparison of the causes with their rivals by what was held out"


def adopt_causes(
    search: Search,
    at: Weighted,
    base_fit: Fit,
    split: Split,
    once: FitSettings,
    first: Sequence[Candidate] = (),
) -> Adoption:
    """Adopt effects until no significant one lowers the errors; keep those that matter.

    Parameters
    ----------
    once : of fits that start next to their minimum.
    first : candidates among which the first cause is sought before all others.
    """
    units = base_fit.criterion.weights
    under = at.noise if search.weighing.takes_disturbances else None
    errors = simulation_errors(base_fit if under is None else at.fit, split, units, under)
    state = Selection(search, split, once, units, at, base_fit, errors, at, base_fit, errors, first)
    refine = Refinement(search, split, once, units, at, base_fit)
    with search.attempts.within(BUDGET.rounds):
        while len(state.adopted) < search.max_causes and not state.is_done and state.adopt_next():
            state.exchange_last()
            state.refine(refine)
    if not state.adopted:
        return Adoption((), at, None)
    found, attempt = state.found, search.attempts.attempt
    superfluous = "the test whether later causes make earlier ones superfluous"
    if under is not None:
        found = attempt(superfluous, partial(refine.without_insignificant, found)) or found
        found = attempt(SHARPNESS, partial(with_sharp_friction_beside, refine, found)) or found
        return attempt(INSTANTS, partial(refine.with_likelier_instants, found)) or found
    # A cause matters by what it explains in units of the error that all causes leave.
    what = "the fit of the extended model in units of its errors"
    fit = attempt(what, partial(weighted_by_errors, state.fit, once)) or state.fit
    fit = fit if Soundness(base_fit, split)(fit) else state.fit
    found, units = replace(found, fit=fit), fit.criterion.weights
    refine = Refinement(search, split, once, units, at, base_fit)
    for what, step in (
        (superfluous, refine.without_insignificant),
        (POWERS, partial(with_better_powers, refine)),
        (SHARPNESS, partial(with_sharp_friction, refine)),
        (BLUNT, partial(without_blunt_reversals, refine)),
        (INSTANTS, refine.with_refitted_instants),
        ("the test whether every cause matters", refine.without_small),
    ):
        found = attempt(what, partial(step, found)) or found
    if found.remainders:  # they made up for what a blunt reversal leaves
        found = attempt(SHARPNESS, partial(with_sharp_friction, refine, found)) or found
    return found


@dataclass(slots=True)
class Selection:
    """State of the forward selection: the model extended by the causes adopted so far."""

    search: Search
    split: Split
    settings: FitSettings
    units: Array  # of the outputs, see `simulation_errors`
    start: Weighted  # the model as it is
    base: Fit  # of it, as `fit`
    before: SimulationErrors  # of it
    at: Weighted
    fit: Fit  # simulation error, whole records
    errors: SimulationErrors
    first: Sequence[Candidate] = ()
    adopted: list[Adopted] = field(default_factory=list)
    stores: list[Adopted] = field(default_factory=list)  # significant in the last round
    imitations: list[Adopted] = field(default_factory=list)  # of better laws, in the last round

    @property
    def found(self) -> Adoption:
        """The causes adopted so far."""
        return Adoption(tuple(self.adopted), self.at, self.fit)

    @property
    def is_done(self) -> bool:
        """True if a random disturbance explains all that the causes adopted leave.

        A change in time may have followed a disturbance, or imitate what is sought next. One that
        stays is enough where with it a disturbance is likelier than one alone.
        """
        named = [a.candidate for a in self.adopted]
        search = self.search
        if not named or search.weighing.takes_disturbances:
            return False
        imitators = [c for c in named if is_imitator(c)]
        if not all(c.effect.sets_in and c.effect.end is None for c in imitators):
            return False
        what = "the test whether a random disturbance explains all that the causes leave"
        alone = partial(sole_disturbance, search, self.at, self.fit, named)
        left = search.attempts.attempt(what, alone)
        if left is None or not imitators:
            return left is not None
        return pays(search.under_disturbance(self.base), left, named, search.count_tested)

    def adopt_next(self) -> bool:
        """One round of the search; False where nothing was adopted."""
        if self.first and not self.adopted:
            if any(self._adopt([a]) for a in self._significant(self.first)):
                return True
        found = self._significant()
        for best in found:
            if self._adopt([best]) or self._adopt_in_its_place(best, found):
                return True
        return self._adopt_pair(found)

    def _adopt_in_its_place(self, refused: Adopted, found: Sequence[Adopted]) -> bool:
        """Adopt what seemed to imitate a refused law if it explains more than all others.

        An imitation of a law does not explain all that the law does. A change in time that predicts
        what was held out, and leaves noise alone, is none.
        """
        if is_imitator(refused.candidate):
            return False
        others = [a.candidate.merit for a in found[found.index(refused) + 1 :]]
        waiting = [a for a in self.imitations if a.candidate.merit > max(others, default=0.0)]
        self.imitations = [a for a in self.imitations if a not in waiting]
        return any(self._adopt([a], leaves_noise=True) for a in waiting)

    def _significant(self, first: Sequence[Candidate] = ()) -> list[Adopted]:
        """Candidates of one round that are significant, in the order in which they are tried.

        Parameters
        ----------
        first : the candidates that are refitted, from where they were found; default the shortlist.
        """
        search, at = self.search, self.at
        search.progress(f"test every effect (round {len(self.adopted) + 1})")
        named = [a.candidate for a in self.adopted]
        attempt = search.attempts.attempt
        table = attempt(f"round {len(named) + 1} of the search", lambda: search.table(at, named))
        if table is None:
            return []
        if search.first_table is None:
            search.first_table = table
        # A score is robust by what repeats: misfit in one short burst, which no score can see,
        # shows in the residual's kind.
        is_scored = search.has_alarm(at, table) or self._pays_beside(table)
        if not is_scored and not attempt(
            "the test of the residual", lambda: is_more_than_noise(at, search)
        ):
            return []
        refits = partial(search.round, at, table, named, first)
        found = attempt("the refits of the candidates", refits)
        if not found:
            return []
        if at.noise_absorbs_misfit and not search.weighing.takes_disturbances:
            lines = partial(
                with_lines_beside_disturbances, search, self.fit, found, len(table.tested)
            )
            found = attempt(LINES, lines) or found
        if not search.first_candidates:
            search.first_candidates = found
        if not search.leads(found, table):
            return []
        # The first alarm has the rate that the user set, and is named unless the errors speak
        # against it; a further cause has to lower them.
        is_alarm = is_scored and not (self.adopted or at.noise_absorbs_misfit)
        by_remainder = at.noise_absorbs_misfit
        p_values = {c.effect.key: p_value(table, c, by_remainder=by_remainder) for c in found}
        significant = [c for c in found if p_values[c.effect.key] < search.alpha]
        causes = found
        if search.gains_are_no_likelihoods(at):
            beside = search.weighing.takes_disturbances
            causes = without_imitations(found, significant, by_likelihood=beside)

        losses = Losses()

        def adoptable(best: Candidate) -> Adopted:
            others = [c for c in found if c is best or not _is_alone(at, c)]
            rivals, near = rivals_of(at, best, others, losses), near_ones(at, best, causes)
            return Adopted(best, p_values[best.effect.key], rivals, at, is_alarm, near=near)

        self.stores = [adoptable(c) for c in significant if c.effect.is_store and c.merit > 0]
        left = [c for c in significant if c not in causes and c.merit > 0]
        if not search.weighing.takes_disturbances:
            self.imitations = [adoptable(c) for c in _named_first(at, left)]
        return [
            adoptable(c)
            for c in _named_first(at, causes)
            if c in significant and (c.merit > 0 or is_alarm)
        ]

    def _pays_beside(self, table: ScoreTable) -> bool:
        """True if the search is one beside disturbances, and an effect pays for itself there."""
        search, what = self.search, "the gains of effects beside a random disturbance"
        if not search.weighing.takes_disturbances:
            return False
        return bool(search.attempts.attempt(what, lambda: pays_beside(search, self.at, table)))

    def _adopt(
        self, news: Sequence[Adopted], *, note: bool = True, leaves_noise: bool = False
    ) -> bool:
        """Extend the model, unless its errors speak against it, or the fit fails.

        Parameters
        ----------
        news : one effect, or two of which the last was found beside the first.
        leaves_noise : whether it has to leave noise alone.
        """
        best, attempts = news[-1].candidate, self.search.attempts
        what = f"the extension by {' and '.join(name_of(a.candidate.effect) for a in news)}"
        why = attempts.attempt(what, partial(self._extend, news, leaves_noise))
        if why is None:
            why = Refusal(attempts.failed.pop(what, "no time was left to extend the model by it"))
        if why and note:
            # The others may be dropped later: without them it might have been accepted.
            others = " and ".join(name_of(a.candidate.effect) for a in self.adopted)
            self.search.refused.append((best, why.beside(others)))
        return not why

    def _extend(self, news: Sequence[Adopted], leaves_noise: bool) -> Refusal:
        """Extend the model, unless it is refused."""
        best, weighing = news[-1].candidate, self.search.weighing
        whole = partial(
            whole_fit, best.model, self.split, self.settings, self.units, best.fit.values
        )
        is_disturbed = weighing.takes_disturbances
        fit = None if is_disturbed else whole()
        errors = simulation_errors(fit, self.split, self.units) if fit else self._errors(best)
        why = why_not_adopted(self.errors, errors, is_alarm=news[0].is_alarm)
        why = why or Refusal(why_worse(self.before.continued, errors.continued), "held-out")
        if why and is_disturbed and is_as_good_held_out(self.errors, errors):
            # Whether it predicts what was held out, the motion that is simulated may show.
            fit = whole()
            why = self._why_not_simulated(fit)
        if why:
            return why
        fit = fit or whole()
        doubt = why_undetermined(self.fit, fit, best)
        if doubt := doubt or why_no_limit(fit, best, self.search.alpha):
            return Refusal(doubt)
        fit, at = weighed_whole(weighing, fit, self.settings)
        leaves_noise = leaves_noise or is_soft_stop(self.at, best)
        if leaves_noise and not is_noise_alone(at, self.search):
            return LEAVES_MORE
        if is_disturbed:
            # Under the disturbance, unless the simulation alone then errs far more.
            if why_much_worse(self.fit, at.fit, self.split):
                if why := self._why_not_simulated(fit):
                    return why
            else:
                fit = at.fit
        self.errors, self.fit, self.at = errors, fit, at
        self.adopted += news
        return ACCEPTED

    def _why_not_simulated(self, fit: Fit) -> Refusal:
        """Why a fit is refused by the errors of its simulation alone, if it is."""
        old, new = (simulation_errors(f, self.split, self.units) for f in (self.fit, fit))
        return why_not_adopted(old, new)

    def _errors(self, c: Candidate) -> SimulationErrors:
        """The errors of a model fitted under the noise with disturbances."""
        weighing, noise = self.search.weighing, self.start.noise
        criterion = weighing.criterion(c.model, noise, c.fit.values, self.start.criterion)
        return simulation_errors(weighing.minimum(criterion), self.split, self.units, noise)

    def _adopt_pair(self, refused: Sequence[Adopted]) -> bool:
        """Adopt two effects at once where each alone makes the held-out error no better.

        Of two that act together, stiffness and damping of one swing say, the first alone shifts
        the errors from where it helps to where the second is missing. A further store alone makes
        up for a dead time by its own time constant, and with it predicts what is slow the worse.
        """
        left = self.search.max_causes - len(self.adopted)
        if left < 2 or not self.at.noise_absorbs_misfit:
            return False
        lasting = [a for a in refused if not is_imitator(a.candidate)]
        if lasting and not self._is_random():
            if any(map(self._adopt_beside, lasting[: ROUNDS.pairs])):
                return True
        return any(map(self._adopt_beside, self.stores))

    def _adopt_beside(self, first: Adopted) -> bool:
        """Adopt an effect, and one that is significant beside it, if they may act together."""
        search = self.search
        search.progress(f"look for a second cause beside {name_of(first.candidate.effect)}")
        what = f"the search beside {name_of(first.candidate.effect)}"
        beside = search.attempts.attempt(what, partial(self._with, first))
        for second in beside._significant() if beside is not None else ():
            is_pair = _may_act_together(first.candidate, second.candidate)
            if is_pair and self._adopt([first, second], note=False):
                keys = {a.candidate.effect.key for a in self.adopted}
                search.refused = [row for row in search.refused if row[0].effect.key not in keys]
                return True
        return False

    def _is_random(self) -> bool:
        """True if nothing but a random disturbance shows in what is left: no two effects then."""
        what = "the test of the remainder beside a random disturbance"
        return bool(self.search.attempts.attempt(what, lambda: is_random(self.search, self.fit)))

    def _with(self, first: Adopted) -> Selection:
        """The selection as it would be with one more effect, whatever the errors say."""
        best = first.candidate
        fit = whole_fit(best.model, self.split, self.settings, self.units, best.fit.values)
        at = self.search.weighing.weigh(best.model, fit, rounds=1)
        return replace(self, at=at, fit=fit, adopted=[*self.adopted, first])

    def exchange_last(self) -> None:
        """Take a rival of the last cause instead that is better under the noise left by the cause.

        Only where the noise model absorbed misfit before the cause was adopted, and no longer does.
        """
        search, taken = self.search, self.adopted[-1]
        is_open = taken.before is not None and taken.before.noise_absorbs_misfit
        if not is_open or not taken.rivals_and_near_ones or self.at.noise_absorbs_misfit:
            return
        search.progress(
            f"compare {name_of(taken.candidate.effect)} with its rivals beside what it leaves"
        )
        what = f"the comparison of {name_of(taken.candidate.effect)} with its rivals"
        better = partial(better_rivals, search, self.adopted, self.start, self.at)
        for other in search.attempts.attempt(what, better) or ():
            what = f"the extension by {name_of(other.effect)}"
            if search.attempts.attempt(what, partial(self._exchange, taken, other)):
                return

    def refine(self, refine: Refinement) -> None:
        """Refine what was adopted by now, before a further cause makes up for what is inexact."""
        is_disturbed = self.search.weighing.takes_disturbances
        steps: dict[str, Callable[[Adoption], Adoption]] = {
            BESIDE: partial(with_last_change_placed, refine),
            EVENT: partial(with_last_event_renamed, refine),
            SHARPNESS: partial(with_sharp_friction, refine, most=FRICTION.samples),
            MOTION: refine.with_initial_motion,
            CONTACT: partial(with_first_contact, refine),
            POWERS: partial(with_better_powers, refine),
            PREDICTION: refine.with_better_rivals,
        }
        if self.adopted[-1].candidate.effect.kind != "coulomb_friction":
            del steps[SHARPNESS]
        if is_disturbed:
            steps = {CONTACT: steps[CONTACT]}
        for what, step in steps.items():
            found = self.search.attempts.attempt(what, partial(step, self.found))
            if found is not None and found.fit is not None and found.fit is not self.fit:
                self.adopted, self.at, self.fit = list(found.adopted), found.at, found.fit
                self.errors = (
                    self._errors(self.adopted[-1].candidate)
                    if is_disturbed
                    else simulation_errors(self.fit, self.split, self.units)
                )

    def _exchange(self, taken: Adopted, other: Candidate) -> bool:
        """Take another candidate in the place of the last one, if it leaves noise alone."""
        fit = whole_fit(other.model, self.split, self.settings, self.units, other.fit.values)
        instead = self.search.weighing.weigh(other.model, fit, rounds=1)
        errors = simulation_errors(fit, self.split, self.units)
        old, new = on_common_samples(self.errors, errors)
        is_worse = new.held_out_square > old.held_out_square
        if is_worse or instead.noise_absorbs_misfit:
            return False
        if is_more_than_noise(instead, self.search) and not is_more_than_noise(
            self.at, self.search
        ):
            return False
        self.adopted[-1] = exchanged(taken, other)
        self.errors, self.fit, self.at = errors, fit, instead
        return True


def _is_alone(at: Weighted, c: Candidate) -> bool:
    """True of what is no rival of others, which its freedom, or its corner, imitates."""
    return c.effect.shape == HYSTERESIS_SHAPE or is_soft_stop(at, c)


def _may_act_together(first: Candidate, second: Candidate) -> bool:
    """True of two laws, and of a further store with a delay or a lag: both act on what is fast."""
    effects = (first.effect, second.effect)
    if any(e.is_store for e in effects):
        return any(e.kind in LATE for e in effects)
    return not (is_imitator(first) or is_imitator(second))


def why_undetermined(before: Fit, after: Fit, c: Candidate) -> str:
    """Why the size of an effect is unknown beside the parameters of the model, or an empty text.

    A model that determined all it had then got away from a minimum of its own by another scale.
    """
    ranks = [rank_of(f.criterion.variables, f.solution.hessian, f.x) for f in (before, after)]
    if not ranks[0].is_full or all(c.names[0] not in direction for direction in ranks[1].null):
        return ""
    return f"the records do not determine {c.names[0]} beside the parameters of the model"


def _named_first(at: Weighted, found: list[Candidate]) -> list[Candidate]:
    """By merit; of those that are the same thing in this model, the one named by convention.

    A neighbour without a name goes behind the best named one that the record cannot reject against
    it: catalogued effects have higher prior plausibility.
    """
    # What is the same to all digits that count stands where the model has it.
    m = at.model
    places = {name: i for i, name in enumerate((*m.balances, *m.inputs, *m.outputs))}
    best = max((abs(c.merit) for c in found), default=0.0)
    digits = COMPARISON.same * max(best, 1.0)
    order = sorted(
        found, key=lambda c: (-round(c.merit / digits), places.get(c.effect.where, len(places)))
    )
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
    order = laws_before_memory(order)
    if order and order[0].effect.is_unnamed:
        open_ = {id(r.candidate) for r in rivals_of(at, order[0], order)}
        lasting = [c for c in order if not is_imitator(c)]
        catalogued = [c for c in lasting if not c.effect.is_unnamed]
        named = [c for c in catalogued if id(c) in open_]
        order = [*named[:1], *[c for c in order if c not in named[:1]]]
    return order
