"""The search for causes, round by round: score every effect, then refit the best of them.

Each round tests every effect against the present model (`score_tests`), refits the most promising
ones jointly with all parameters under one whitening (`joint_refit`), places jumps in time
(`jump_times`) and ranks what was found (`alternatives`); `selection` decides what is adopted.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.stats import norm

from casid.diagnosis.attempts import Attempts, reason_of
from casid.diagnosis.evidence.records.loop_references import loop_references
from casid.diagnosis.evidence.records.signal_sizes import sizes_of
from casid.diagnosis.evidence.residual.cogging_periods import CoggingCandidate, cogging_candidates
from casid.diagnosis.evidence.residual.residual_tests import ResidualTests
from casid.diagnosis.evidence.residual.spectral_peaks import (
    Peak,
    PeriodicCandidate,
    peaks_of,
    periodic_candidates,
)
from casid.diagnosis.evidence.scores.score_tests import (
    Score,
    ScoreTable,
    has_finite_tangent,
    score_test,
)
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate, name_of
from casid.diagnosis.search.comparison.alternatives import (
    on_common_samples,
    ranked_by_remainder,
    rejudge,
)
from casid.diagnosis.search.comparison.imitations import (
    drives_one_way,
    is_at_resonance,
    is_further_friction,
)
from casid.diagnosis.search.instants.joint_forces import joint_forces
from casid.diagnosis.search.instants.jump_times import events_of, is_known_event, placed
from casid.diagnosis.search.instants.same_instants import changes_at_the_same_instants
from casid.diagnosis.search.instants.temporary_changes import placed_changes
from casid.diagnosis.search.refits.dead_times import with_far_dead_times
from casid.diagnosis.search.refits.friction_speeds import sharpened
from casid.diagnosis.search.refits.joint_refit import Refitting, moved_parameter
from casid.diagnosis.search.refits.lags_of_channels import delays_of_best, lags_beside
from casid.diagnosis.search.refits.preselection import Start, preselected
from casid.diagnosis.search.refits.soft_stops import without_soft_stops
from casid.diagnosis.search.refits.swinging_parts import beside_lines
from casid.diagnosis.search.refusals import Refusal
from casid.diagnosis.settings import Progress
from casid.diagnosis.thresholds import BUDGET, COMPARISON, RESTARTS, SHORTLIST
from casid.errors import CasidError, ModelError, OutOfTimeError, SolveError
from casid.estimation.noise.variances import error_over_noise
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.balances.missing_parts import mode_frequencies, modes_at
from casid.model.effects.catalogue import catalogue
from casid.model.effects.effect import Effect, Sizes, extend_all
from casid.model.effects.user_effects import UserEffect, user_effects
from casid.model.explicit_form import Explicit
from casid.model.model import Model


@dataclass(slots=True)
class Memory:
    """Results kept, shared by the searches with and without disturbances in the noise.

    Attributes
    ----------
    tested : the last model whose residual was tested.
    shown : fit -> the same with the disturbances that its residual shows.
    disturbed : fit -> the model fitted under them.
    tables : of a model and the causes that are in it -> the scores of all effects.
    refits : of a model without causes -> its shortlist as refitted, as large as the records each.
    references : recorded channels that are references of a control loop; None until sought.
    held_out : of a model under a disturbance -> how what was held out contradicts it, or empty.
    """

    tested: tuple[Weighted, ResidualTests] | None = None
    shown: dict[Fit, Weighted] = field(default_factory=dict)
    disturbed: dict[Fit, Weighted] = field(default_factory=dict)
    tables: dict[tuple[Weighted, tuple[Candidate, ...]], ScoreTable] = field(default_factory=dict)
    refits: dict[Weighted, list[Candidate]] = field(default_factory=dict)
    references: tuple[str, ...] | None = None
    held_out: dict[Weighted, str] = field(default_factory=dict)


_OVERFLOWS = "its sensitivities overflow in the simulation of the model"


@dataclass(slots=True)
class Search:
    """State of the search, round by round."""

    weighing: Weighing
    recorded: Mapping[str, str]
    alpha: float = 0.05
    max_causes: int = 4
    progress: Progress = lambda _: None
    effects: Sequence[UserEffect] = ()  # the user's own
    without: Collection[str] = ()  # kinds left out
    spikes: Sequence[float] = ()  # instants [s] of few samples that were left out as outliers
    first_table: ScoreTable | None = None
    first_candidates: list[Candidate] = field(default_factory=list)
    refused: list[tuple[Candidate, Refusal]] = field(default_factory=list)
    attempts: Attempts = field(default_factory=Attempts)
    memory: Memory = field(default_factory=Memory)
    refitting: Refitting = field(init=False)

    def __post_init__(self) -> None:
        self.refitting = Refitting(self.weighing, attempts=self.attempts)

    @property
    def count_tested(self) -> int:
        """Effects that the first round tested; at least one."""
        return max(len(self.first_table.tested), 1) if self.first_table is not None else 1

    @property
    def distance_when_chosen(self) -> float:
        """Standard errors from its null that make one of all effects tested significant.

        At the rate of false alarms, by Bonferroni's inequality.
        """
        return float(norm.isf(self.alpha / (2 * self.count_tested)))

    def with_disturbances(self) -> Search:
        """The search in which disturbances with spectra of their own count as noise."""
        weighing = self.weighing.with_disturbances()
        return replace(self, weighing=weighing, refused=[])

    def under_disturbance(self, fit: Fit) -> Weighted:
        """The model of a fit under the disturbances that its residual shows; sought once a fit."""
        disturbed = self.memory.disturbed
        if fit not in disturbed:
            weighing, shown = self.weighing.with_disturbances(), self.memory.shown.get(fit)
            disturbed[fit] = weighing.weigh(fit.criterion.model, fit, rounds=1, shown=shown)
        return disturbed[fit]

    def table(self, at: Weighted, adopted: Sequence[Candidate]) -> ScoreTable:
        """The scores of every effect not adopted yet; computed once a model."""
        of, tables = (at, tuple(adopted)), self.memory.tables
        if of not in tables:
            tables[of] = self._table(at, adopted)
        return tables[of]

    def _table(self, at: Weighted, adopted: Sequence[Candidate]) -> ScoreTable:
        recorded = self._free_channels(at.model)
        sizes = sizes_of(at, recorded)
        sizes = replace(sizes, events=(*sizes.events, *self.spikes))
        taken = {c.effect.key for c in adopted}
        judged = at.unbiased or at.fit
        peaks = peaks_of(judged)
        effects = self._effects_beside(at, adopted, sizes, recorded)
        if "missing_mode" not in self.without:
            effects += [e for e in _modes_at_peaks(at.model, peaks, sizes) if e.key not in taken]
        table = self._scores(judged, effects, at.input_sd)
        found: list[PeriodicCandidate | CoggingCandidate] = []
        if "periodic_disturbance" not in self.without:
            lines = periodic_candidates(judged, peaks, sizes.window)
            found += [c for c in lines if not (adopted and is_at_resonance(at, c.peak.frequency))]
        if "cogging" not in self.without:
            found += [c for c in cogging_candidates(at, sizes) if c.effect.key not in taken]
        table = with_far_dead_times(at, self.weighing.experiments, table, self.attempts)
        return table.with_peaks([_peak_score(c) for c in found])

    def _effects_beside(
        self,
        at: Weighted,
        adopted: Sequence[Candidate],
        sizes: Sizes,
        recorded: Mapping[str, str],
    ) -> list[Effect]:
        """The effects of the catalogue, and of the user, that may act beside those adopted."""
        taken = {c.effect.key for c in adopted}
        own = {n for c in adopted for n in c.names}
        known = events_of(adopted)

        def may_act(e: Effect) -> bool:
            if e.key in taken or is_further_friction(e, adopted) or drives_one_way(e, at):
                return False
            if e.sets_in and (e.where in own or is_known_event(at, e, known)):
                return False
            # A slope of a cause's own size would be a second effect in the place of a first one.
            return not smooths_a_switch(at, e) and moved_parameter(e) not in own

        extra = user_effects(at.model, self.effects)
        every = catalogue(at.model, sizes, recorded, extra=extra, without=self.without)
        return [e for e in every if may_act(e)]

    def _scores(
        self, fit: Fit, effects: Sequence[Effect], input_sd: Mapping[str, float]
    ) -> ScoreTable:
        """The scores of all effects but of those that break the model or its simulation."""
        score = partial(score_test, fit, input_sd=input_sd, seed=self.weighing.seed)
        solution = partial(_solution, fit.criterion.model)
        try:
            table = score(effects)
        except OutOfTimeError:
            raise
        except ModelError:
            table = score(self._working(effects, solution))
        except SolveError:
            if not has_finite_tangent(fit):
                raise
            table = score(self._working(effects, partial(score, draws=0)))
        self.attempts.failed |= {name_of(e): _OVERFLOWS for e in table.overflowing}
        return table

    def _working(
        self, effects: Sequence[Effect], function: Callable[[Sequence[Effect]], object]
    ) -> list[Effect]:
        """The effects that `function` takes together; of each other one, a note says why not.

        What fails is halved until one effect beside those that work is left of it.
        """
        working: list[Effect] = []
        waiting = [list(effects)]
        while waiting:
            part = waiting.pop()
            try:
                function([*working, *part])
                working += part
            except OutOfTimeError:
                raise
            except CasidError as error:
                if len(part) == 1:
                    self.attempts.failed[name_of(part[0])] = reason_of(error)
                else:
                    half = len(part) // 2
                    waiting += [part[half:], part[:half]]
        return working

    def _free_channels(self, model: Model) -> dict[str, str]:
        """The recorded channels that may act by themselves: references of a loop do not."""
        memory = self.memory
        if memory.references is None:
            memory.references = loop_references(self.weighing.experiments, model, self.recorded)
        return {c: unit for c, unit in self.recorded.items() if c not in memory.references}

    def gains_are_no_likelihoods(self, at: Weighted) -> bool:
        """True if gains under the noise of `at` are no likelihoods by which a law is rejected."""
        return at.noise_absorbs_misfit or self.weighing.takes_disturbances

    def has_alarm(self, at: Weighted, table: ScoreTable) -> bool:
        """True if something is wrong: much is unexplained, or a test is significant."""
        best = table.smallest
        return at.noise_absorbs_misfit or (best is not None and best.adjusted < self.alpha)

    def round(
        self,
        at: Weighted,
        table: ScoreTable,
        adopted: Sequence[Candidate],
        first: Sequence[Candidate] = (),
    ) -> list[Candidate]:
        """Refit the shortlist of what was not adopted yet, or `first` and its likes; best first."""
        refitting, attempt = self.refitting, self.attempts.attempt
        with self.attempts.within(BUDGET.refits):
            if first:
                found = [c for c in (refitting.again(at, f) for f in first) if c is not None]
                found += self.refits_of(at, _alike_to_best(table, found))
            else:
                found = self.refits(at, table, adopted)
            if not found:
                return found
            found = sharpened(refitting, at, found, self.progress)
            found = beside_lines(refitting, at, found, self.progress)
        found = _best_of_each(on_common_samples(found))
        found = without_soft_stops(refitting, at, found, self.progress)
        ranked = ranked_by_remainder if at.noise_absorbs_misfit else rejudge
        what = "the comparison of the candidates"
        return attempt(what, lambda: ranked(refitting, at, found)) or found

    def refits(
        self, at: Weighted, table: ScoreTable, adopted: Sequence[Candidate]
    ) -> list[Candidate]:
        """The shortlist, refitted one after the other as far as there is time, placed in time.

        Those of a model without causes are kept, unless there was no time for all.
        """
        kept = self.memory.refits
        if at in kept and not adopted:
            return list(kept[at])
        short = scores_to_refit(at, table)
        found = self.refits_of(at, short)
        found += self.refits_of(at, delays_of_best(table, found, short))
        found = self.refitting.from_where_best_led(at, found)
        known = events_of(adopted)
        found = placed(self.refitting, at, found, known, self.progress)
        more = changes_at_the_same_instants(self.refitting, at, table, found)
        found += placed(self.refitting, at, more, known, self.progress)
        if "offset" not in self.without:
            found += joint_forces(self.refitting, at, found, self.progress)
        if not adopted and not self.attempts.not_done:
            kept[at] = found
        return list(found)

    def refits_of(self, at: Weighted, scores: Sequence[Score]) -> list[Candidate]:
        """The effects of these scores, refitted one after the other as far as there is time."""
        found: list[Candidate] = []
        refitting = self.refitting
        short = self.attempts.attempt(
            "the choice of candidates on a part of the records",
            lambda: preselected(refitting, at, scores, self.progress),
        ) or [Start(s) for s in scores]
        best = 0.0
        for i, start in enumerate(short):
            s = start.score
            self.progress(f"refit {i + 1}/{len(short)}: {name_of(s.effect)}")
            below = at.fit.solution.value - 0.5 * COMPARISON.relative_gain * best
            candidate = (
                refitting.refit(at, s.effect, s.step, starts=s.starts, below=below)
                if start.found is None
                else refitting.again(at, start.found)
            )
            if candidate is not None:
                found.append(replace(candidate, score=s))
                best = max(best, candidate.gain)
        return found

    def leads(self, found: Sequence[Candidate], table: ScoreTable) -> bool:
        """False where no time was left to refit an effect that promises more than all others."""
        waiting = self.attempts.not_done.keys() - {name_of(c.effect) for c in found}
        promises = (s.unrobust for s in table.tested if name_of(s.effect) in waiting)
        promised = max(promises, default=0.0)
        return max(c.gain for c in found) >= promised


def _best_of_each(found: Sequence[Candidate]) -> list[Candidate]:
    """The best candidate of each effect, best first: it may have several variants."""
    best: dict[tuple[str, str], Candidate] = {}
    for c in sorted(found, key=lambda c: -c.merit):
        best.setdefault(c.effect.key, c)
    return list(best.values())


def scores_to_refit(at: Weighted, table: ScoreTable) -> list[Score]:
    """The shortlist, the changes that are over before the record is, and lags of all channels."""
    short = shortlist(at, table)
    return [*short, *placed_changes(at, table), *lags_beside(at, table, short)]


def _alike_to_best(table: ScoreTable, found: Sequence[Candidate]) -> list[Score]:
    """Lasting named effects that act in this record as the best candidate does.

    Beside a disturbance the score of one of them may hide: dry friction of what turns one way is a
    constant term, but for the moment in which it starts.
    """
    best = max(found, key=lambda c: c.merit, default=None)
    keys = [s.effect.key for s in table.scores]
    if best is None or best.effect.key not in keys:
        return []
    here = keys.index(best.effect.key)
    known = {c.effect.key for c in found}
    alike = [
        s
        for s, cosine in zip(table.scores, table.cosines[here], strict=True)
        if s.is_visible and s.effect.key not in known and abs(cosine) > SHORTLIST.alike
    ]
    lasting = [s for s in alike if not s.effect.is_on_the_clock and s.effect.kind != "unknown"]
    return list(strongest_of_each(lasting).values())[: SHORTLIST.few]


def shortlist(at: Weighted, table: ScoreTable) -> list[Score]:
    """The best six kinds by robust p and the best six by unrobust score, one variant each.

    Neighbours without a name come beside them, four of each order, and what happens at an instant,
    which every parameter may: they crowd out nobody. Where the model errs by far more than the
    noise its scores predict little of what refits gain, and twice as many are refitted.
    """
    is_far = error_over_noise(at.fit, at.noise) > RESTARTS.far
    most = SHORTLIST.kinds * (2 if is_far else 1)
    visible = [s for s in table.tested if s.unrobust > 0.0]
    if not at.noise_absorbs_misfit:
        # Under the right noise the score predicts what a refit of a small effect gains. A line is
        # an estimate at its best frequency already, which a score at a guessed one is far from.
        scored = [s.unrobust for s in visible if s.effect.test != "peak"]
        least = COMPARISON.relative_gain * max(scored, default=0.0) - COMPARISON.by_chance
        visible = [s for s in visible if s.unrobust > least]
    strongest = strongest_of_each(visible)
    chosen: dict[tuple[str, str], Score] = {}
    for order in (
        sorted(visible, key=lambda s: (s.p_value, -s.unrobust)),
        sorted(visible, key=lambda s: -s.unrobust),
    ):
        keys = list(dict.fromkeys(s.effect.key for s in order))
        gains = [key for key in keys if strongest[key].effect.is_new_gain]
        on_the_clock = [key for key in keys if strongest[key].effect.is_on_the_clock]
        timed = [key for key in on_the_clock if key not in gains]
        unnamed = [key for key in keys if key[0] == "unknown"]
        lasting = [key for key in keys if key not in (*timed, *gains, *unnamed)]
        changes = (*timed[: SHORTLIST.timed], *gains[: SHORTLIST.gains])
        for key in (*lasting[:most], *changes, *unnamed[: SHORTLIST.unnamed]):
            chosen.setdefault(key, strongest[key])
    return [*chosen.values(), *_other_falls(visible, chosen)] if is_far else list(chosen.values())


def strongest_of_each(scores: Sequence[Score]) -> dict[tuple[str, str], Score]:
    """The variant that scores highest of every kind and place, the strongest first."""
    found: dict[tuple[str, str], Score] = {}
    for s in sorted(scores, key=lambda s: -s.unrobust):
        found.setdefault(s.effect.key, s)
    return found


def _other_falls(
    visible: Sequence[Score], chosen: Mapping[tuple[str, str], Score]
) -> Iterator[Score]:
    """Changes of chosen parameters with another power of a state, which only refits compare."""
    for s in visible:
        first = chosen.get(s.effect.key)
        if s.effect.kind == "scheduled_parameter" and first is not None:
            if s.effect.variant != first.effect.variant:
                yield s


def _solution(model: Model, effects: Sequence[Effect]) -> Explicit:
    """The equations of a model with effects, solved for its derivatives."""
    return extend_all(model, [e for e in effects if e.test == "score"])[0].explicit()


def _modes_at_peaks(model: Model, peaks: Sequence[Peak], sizes: Sizes) -> list[Effect]:
    """Narrow modes at peaks of the residual's spectrum, which no frequency of the catalogue shows.

    A step of the simulation does not resolve what is faster than all of these frequencies.
    """
    fastest = mode_frequencies(sizes)[-1]
    pitches = [2 * np.pi * peak.frequency for peak in peaks]
    return modes_at(model, [w for w in pitches if w <= fastest])


def smooths_a_switch(at: Weighted, effect: Effect) -> bool:
    """True of an effect that has an input of two or three levels vary smoothly between samples."""
    if effect.kind != "hold" or effect.shape != "bandlimited":
        return False
    inputs = list(at.model.inputs)
    columns = [inputs.index(n) for n in effect.where.split(", ")]
    return any(
        np.unique(np.concatenate([d.u[:, i] for d in at.criterion.data])).size <= SHORTLIST.switch
        for i in columns
    )


def _peak_score(found: PeriodicCandidate | CoggingCandidate) -> Score:
    """A line of the residual's spectrum, or a period in a position, among the others."""
    first = found.effect.parameters[0].name
    return Score(
        effect=found.effect,
        z=float(np.sqrt(found.statistic)),
        p_value=found.p_value,
        adjusted=found.p_value,
        energy=0.0,
        step=found.starts[first],
        unrobust=found.statistic,
        visible=1.0,
        starts=found.starts,
    )
