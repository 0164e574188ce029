"""What to record next, to distinguish tied causes.

Each feasible experiment is predicted from the fitted model (`planned_records`); in it the tied
causes have other signatures, whitened by the noise that is known and projected off the baseline's
tangent as ever. Their cosine gives the energy needed to distinguish them (3) of `isolability`, and
the energy that one unit of each gives, with the size estimated from the record at hand, how long
the new record has to be. Linear in the causes' sizes, about the fitted model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import Any

import numpy as np

from casid.data.files import plain_fields
from casid.data.problem import Problem
from casid.diagnosis.advice.fitted_motion import FittedMotion
from casid.diagnosis.advice.isolability import (
    Key,
    likeness,
    separation_energy,
)
from casid.diagnosis.advice.planned_records import Planned, Planner, with_start
from casid.diagnosis.evidence.scores.score_tests import ScoreTable, score_test
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import name_of
from casid.diagnosis.thresholds import PLANNING, SCORES
from casid.errors import CasidError, DataError, OutOfTimeError
from casid.estimation.noise.joined_sources import joined
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.noise_response import noise_response
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.effect import Effect
from casid.model.effects.names import either_words
from casid.presentation import Presented


@dataclass(frozen=True, slots=True, eq=False)
class Suspect:
    """One of the tied causes, with the size that the record at hand gives it.

    Attributes
    ----------
    size : of the effect's first parameter, its own unit; not used where the effect is a clipping.
    """

    effect: Effect
    size: float


@dataclass(frozen=True, slots=True)
class Proposal:
    """A next experiment, and what it determines of the pair that is hardest to distinguish.

    Attributes
    ----------
    pair : that pair.
    cosine : of its signatures, 0 where one would need an impossible sign to imitate the other.
    energy_needed : of the misfit, (3) of `isolability`; inf where it does not separate them.
    record_length : seconds of it (of all records analysed together) after which every pair is
        separated at the sizes estimated, whichever is the cause.
    gain_factor : the energy needed in the present record over that needed here.
    seconds : length of what was predicted.
    bands : frequencies (from, to) that it excites [Hz], where it is an excitation of its own.
    words : the pair as an engineer says it.
    limit : seconds, the longest record that is advised (`PLANNING.longest`).
    """

    name: str
    description: str
    pair: tuple[Key, Key]
    cosine: float
    energy_needed: float
    record_length: float
    gain_factor: float
    seconds: float
    bands: tuple[tuple[float, float], ...] = ()
    words: tuple[str, str] = ("", "")
    limit: float = inf

    @property
    def is_feasible(self) -> bool:
        """True if a record that somebody would make separates the causes."""
        return isfinite(self.record_length) and self.record_length <= self.limit

    @property
    def is_realistic(self) -> bool:
        """False of a length that nobody would record, and that is not worth stating."""
        return self.record_length <= self.longest_stated

    @property
    def longest_stated(self) -> float:
        """Seconds: the longest record whose length is stated (`PLANNING.realistic`)."""
        return max(self.limit, min(PLANNING.realistic * self.limit, PLANNING.lasting))

    def is_clearer(self, now: Proposal) -> bool:
        """True if it halves the energy needed, at least, and needs no longer record.

        Signatures that are nearly the same are separated by small differences, which a model with
        other errors gets wrong first; so this goes before a short record.
        """
        return self.gain_factor >= PLANNING.clearer and self.record_length <= now.record_length

    def to_json(self) -> dict[str, Any]:
        """Part of `diagnosis.json`; None where no length or energy separates the causes."""
        return plain_fields(self, leave_out=["seconds"])


@dataclass(frozen=True, slots=True, eq=False)
class Advice(Presented):
    """Proposals beside the present record, the best first.

    Those that are clearer go before (`Proposal.is_clearer`), by what they gain in energy times what
    they gain in length; the others follow by length.

    Attributes
    ----------
    now : the same experiment again.
    sentence : the best of them in words.
    words : the tied causes as an engineer says them.
    """

    tied: tuple[Key, ...]
    now: Proposal
    proposals: tuple[Proposal, ...]
    sentence: str
    words: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Part of `diagnosis.json`."""
        return plain_fields(self)

    def __repr__(self) -> str:
        return f"<Advice: {len(self.proposals)} experiments for {len(self.tied)} tied causes>"


def next_experiment(
    problem: Problem,
    at: Weighted,
    suspects: Sequence[Suspect],
    *,
    progress: Callable[[str], None] | None = None,
) -> Advice:
    """Compare feasible next experiments by how soon they separate tied causes.

    Parameters
    ----------
    problem : its load cases and recorded channels are what an experimenter may use.
    at : the model without the suspects, fitted under its noise (`Weighing.weigh`).
    suspects : two or more causes that the record cannot separate, with their sizes.

    Returns
    -------
    Advice
        Free decays, wider and slower bands, twice the amplitude, a longer record, other loads and
        further sensors, as far as the model allows each; those that diverge are left out. All but
        the second load are analysed alone, without the present record.

    Raises
    ------
    DataError
        If fewer than two causes are given, or a cause is given twice.

    Notes
    -----
    The noise of sensors, inputs and disturbances is taken to be that of the present record, and
    independent from channel to channel.
    """
    keys = tuple(s.effect.key for s in suspects)
    if len(set(keys)) < max(len(keys), 2):
        raise DataError(
            f"{len(set(keys))} different causes among {len(keys)} given; next_experiment needs at "
            "least two, each once: one variant of each kind and place"
        )
    say = progress or (lambda _: None)
    planner = Planner(FittedMotion(problem, at))
    rule = _Rule(at, tuple(suspects), planner.motion.period())
    now = rule.judged(planner.again(), None)
    proposals = []
    for planned in planner.all():
        say(f"predict: {planned.name}")
        try:
            proposals.append(rule.judged(planned, now))
        except OutOfTimeError:
            break  # the best of those that there was time for
        except CasidError:
            continue  # cannot be simulated with sensitivities: no prediction
    # Both gains count among those that are clearer; of the others, the shortest goes first.
    proposals.sort(
        key=lambda p: (
            not p.is_clearer(now),
            p.record_length / (p.gain_factor if p.is_clearer(now) else 1.0),
            p.energy_needed,
        )
    )
    words = [name_of(s.effect) for s in suspects]
    sentence = advice_sentence(words, now, proposals)
    return Advice(keys, now, tuple(proposals), sentence, tuple(words))


def predicted_table(planned: Planned, at: Weighted, effects: Sequence[Effect]) -> ScoreTable:
    """Signatures of effects in a planned experiment: energies and cosines as in the search.

    The scores themselves mean nothing here: the residual is drawn noise.
    """
    base = at.criterion
    weights = np.concatenate([base.weights, 1 / np.array(planned.further_sd or [])])
    if not planned.further_sd:
        weights = base.weights
    criterion = SimulationError(
        planned.model,
        planned.experiments,
        own=[n for n in base.own if n in planned.model.parameters],
        weights=weights,
        substeps=base.substeps,
        start=with_start(planned, at.fit.values, base.own),
    )
    x = criterion.start
    records, spectra = range(len(criterion.data)), at.noise.spectra
    responses = [joined(noise_response(criterion, x, e), spectra) for e in records]
    noise = NoiseModel(
        output_sd=np.concatenate([at.noise.output_sd, planned.further_sd]),
        source_sd={s: at.noise.source_sd.get(s, 0.0) for s in responses[0].sources},
        responses=responses,
        weights=weights,
    )
    criterion.whiten = noise.whiten
    fit = Fit(criterion, replace(at.fit.solution, x=x))
    return score_test(fit, effects, input_sd={}, draws=SCORES.few_draws)


@dataclass(frozen=True, slots=True, eq=False)
class _Rule:
    """How a planned experiment is judged."""

    at: Weighted
    suspects: tuple[Suspect, ...]
    least: float = 0.0  # seconds: less than a period of what moves shows no motion

    def judged(self, planned: Planned, now: Proposal | None) -> Proposal:
        """The proposal that a planned experiment makes."""
        # A line in a spectrum is sought, not scored; in a record that is planned it is a force.
        effects = [
            s.effect if s.effect.test in ("score", "clip") else replace(s.effect, test="score")
            for s in self.suspects
        ]
        table = predicted_table(planned, self.at, effects)
        place = {s.effect.key: i for i, s in enumerate(table.scores)}
        worst: tuple[float, float, tuple[Effect, Effect]] | None = None
        longest = 0.0
        for i, a in enumerate(self.suspects):
            for b in self.suspects[:i]:
                j, k = place[a.effect.key], place[b.effect.key]
                cosine = likeness(a.effect, b.effect, float(table.cosines[j, k]))
                energy = separation_energy(cosine)
                given = [self._given(s, table, place) for s in (a, b)]
                if min(given) <= 0.0:
                    energy = inf  # one of them is undetectable
                if worst is None or energy > worst[0]:
                    worst = energy, abs(cosine), (b.effect, a.effect)
                long_enough = planned.seconds * energy / min(given) if isfinite(energy) else inf
                # Much shorter records than that predicted have other tangents: nothing is promised.
                least = max(self.least, PLANNING.shortest * planned.seconds)
                longest = max(longest, long_enough, least)
        assert worst is not None
        energy, cosine, (first, second) = worst
        before = energy if now is None else now.energy_needed
        gain = 1.0 if now is None else 0.0 if not isfinite(energy) else before / energy
        return Proposal(
            planned.name,
            planned.description,
            (first.key, second.key),
            float(cosine),
            energy,
            longest,
            gain,
            planned.seconds,
            planned.bands,
            (name_of(first), name_of(second)),
            max(PLANNING.longest * (now or planned).seconds, PLANNING.easily),
        )

    @staticmethod
    def _given(s: Suspect, table: ScoreTable, place: dict[Key, int]) -> float:
        """Energy of the misfit that the planned record has if `s` is the cause."""
        score = table.scores[place[s.effect.key]]
        if score.visible <= SCORES.undetectable:
            return 0.0
        return score.energy * (1.0 if s.effect.test == "clip" else s.size**2)


def advice_sentence(tied: Sequence[str], now: Proposal, proposals: Sequence[Proposal]) -> str:
    """The best proposal in words, or that none of those compared separates the tied causes."""
    who = f"{tied[0]} from {either_words(tied[1:])}"
    able = [p for p in proposals if isfinite(p.record_length)]
    if not able and not now.is_feasible:
        return f"No experiment considered separates {who}{_why_none(tied, proposals)}"
    feasible = [p for p in able if p.is_feasible]
    if not feasible and not now.is_feasible:
        return _too_long(who, min((now, *able), key=lambda p: p.record_length), now)
    best = feasible[0] if feasible else now
    shorter = best.is_clearer(now) or best.record_length <= PLANNING.shorter * now.record_length
    should = now.record_length <= now.seconds  # the present record, which does not
    if now.is_feasible and not shorter:
        if should:
            return (
                f"To separate {who}, repeat the experiment and diagnose both records together: by "
                "prediction the present one is long enough and by chance, or by other errors of "
                "the model, it does not separate them."
            )
        return (
            f"To separate {who}, repeat the same experiment for "
            f"{record_length_text(now.record_length)}: no other experiment considered is clearly "
            "shorter."
        )
    text = f"To separate {who}: {best.description}"
    if not should:
        text += f". About {record_length_text(best.record_length)} would suffice"
        text += _beside_the_same(best, now)
    if best.gain_factor > PLANNING.notable:
        times = f"{best.gain_factor:.2g} times as large a" if isfinite(best.gain_factor) else "a"
        text += f"; {times} share of their effects tells them apart there"
    return text + "."


def _beside_the_same(best: Proposal, now: Proposal) -> str:
    """Length that a repeated experiment would need, or that it is of no use; else an empty text."""
    if best.record_length > PLANNING.shorter * now.record_length:
        return ", as of the same experiment"
    if now.is_feasible:
        return f", where the same experiment would need {record_length_text(now.record_length)}"
    if isfinite(now.record_length):
        return f", where the same experiment would not do in {record_length_text(now.limit)}"
    return ""


def _too_long(who: str, best: Proposal, now: Proposal) -> str:
    """That every experiment considered takes longer than anybody would measure."""
    remedy = (
        "Determine one of them independently of these records, or record under conditions in which "
        "they are larger."
    )
    if not best.is_realistic:
        longest = record_length_text(best.longest_stated)
        return (
            f"No realistic record length separates {who}: every experiment considered would take "
            f"more than {longest}. {remedy}"
        )
    what = "the same experiment again" if best is now else best.description
    is_by_record = now.limit > PLANNING.easily
    of_record = f", {PLANNING.longest:g} times the present records" if is_by_record else ""
    return (
        f"No experiment of a reasonable length (here up to {record_length_text(now.limit)}"
        f"{of_record}) separates {who}: the shortest of those considered, {what}, would take about "
        f"{record_length_text(best.record_length)}. {remedy}"
    )


def _why_none(tied: Sequence[str], proposals: Sequence[Proposal]) -> str:
    """Why no experiment separates the tied causes: what was compared, and the outcome."""
    remedy = "determine one of them independently of these records"
    if not proposals:
        return f": none could be predicted from the fitted model. To name the cause, {remedy}."
    of_each = (
        f"each of the {len(proposals)} that were" if len(proposals) > 1 else "the one that was"
    )
    pair = "two of them" if len(tied) > 2 else "the two"
    is_alike = all(
        isfinite(p.energy_needed) or not isfinite(separation_energy(p.cosine)) for p in proposals
    )
    how = "alike" if is_alike else "alike, or not at all,"
    return (
        f": in {of_each} predicted from the fitted model, small effects of {pair} change the "
        f"outputs {how} once its parameters are fitted again. Larger effects or another experiment "
        f"may separate them; else {remedy}."
    )


def record_length_text(value: float) -> str:
    """A length of time with two digits, in seconds to years."""
    if value < 120:
        return f"{float(f'{value:.2g}'):g} s"
    longer = ((60.0, "min"), (3600.0, "h"), (86400.0, "days"), (31557600.0, "years"))
    scale, name = next((x for x in reversed(longer) if value >= 2 * x[0]), longer[0])
    return f"{float(f'{value / scale:.2g}'):g} {name}"
