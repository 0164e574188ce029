"""The next step, and the causes that the records cannot separate or detect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from casid.data.problem import Problem
from casid.diagnosis.advice.isolability import Isolability, isolability
from casid.diagnosis.advice.next_experiment import Advice, Proposal, Suspect, next_experiment
from casid.diagnosis.advice.undetectable import (
    Undetectable,
    absorbed_effects,
    undetectable_effects,
)
from casid.diagnosis.evidence.disturbances import Disturbance
from casid.diagnosis.evidence.scores.score_tests import ScoreTable
from casid.diagnosis.search.candidates import name_of
from casid.diagnosis.search.findings import Findings
from casid.diagnosis.thresholds import PLANNING
from casid.diagnosis.verdict.cause import NO_DOUBTS, Alternative, Cause, Doubts, Verdict
from casid.diagnosis.verdict.gain import changes, decisive, improves
from casid.diagnosis.verdict.judgement import Judgement
from casid.diagnosis.verdict.sentences import declares, separates
from casid.errors import shell_option
from casid.estimation.estimate import Estimate
from casid.estimation.fit_statistics import POOR
from casid.model.effects.effect import OF_SAMPLES
from casid.model.effects.names import either_words
from casid.model.model import Model
from casid.model.quantities import listed


@dataclass(frozen=True, slots=True, eq=False)
class Recommendation:
    """Advice in a sentence, with the experiments and limits behind it."""

    sentence: str
    isolability: Isolability | None
    undetectable: tuple[Undetectable, ...]
    proposals: tuple[Proposal, ...]
    notes: tuple[str, ...] = ()  # on causes that the model without the others could not show


def recommend(
    problem: Problem, found: Findings, judged: Judgement, *, plan: bool
) -> Recommendation:
    """Advise on what to record or change next.

    Parameters
    ----------
    plan : whether experiments are planned, and undetectable causes explained; it takes seconds.
    """
    table, base = found.search.first_table, found.baseline
    attempt = found.search.attempts.attempt
    named = possible_causes(judged.causes)
    absorbed = [e for _, e in absorbed_effects(table, problem.model)] if table else []
    planned = None
    if plan:
        what = "the plan of an experiment that separates tied causes"
        planned = attempt(what, lambda: _planned(problem, found, judged.causes))
    of_samples, verdict = _without_samples(judged)
    if base.negated is not None:
        text = base.negated.remedy
    elif judged.doubts.bounds and verdict == "undecided":
        text = of_samples + bound_advice(problem, judged.doubts.bounds)
    elif verdict == "undecided" and base.is_fitted and _is_poor(judged.baseline):
        text = of_samples + _CHECK_CHANNELS
    elif planned is not None:
        text = planned.sentence
    elif verdict == "adequate" and any(d.is_dominant for d in judged.disturbances):
        text = of_samples + _apart(judged.doubts) + _check_poor(judged.doubts)
        text += disturbance_advice(problem.model, judged.disturbances[0])
    else:
        decides = decisive(judged.fitted, judged.held_out)
        is_same = bool(decides.get("extended_rmse")) and not (
            changes(decides) or changes(judged.fitted)
        )
        hidden = [name_of(e) for e in absorbed if e.key not in named]
        text = advice(
            judged.verdict,
            judged.causes,
            hidden,
            judged.why_undecided,
            is_better=improves(decides),
            is_same=is_same,
            doubts=judged.doubts,
        )
    if table is None:
        return Recommendation(text, None, (), planned.proposals if planned is not None else ())
    undetectable = _undetectable(problem, found, table) if plan else ()
    return Recommendation(
        sentence=text,
        isolability=isolability(table, n_samples=found.base_fit.criterion.n_samples),
        undetectable=tuple(u for u in undetectable if (u.kind, u.where) not in named),
        proposals=planned.proposals if planned is not None else (),
        notes=by_others(undetectable, judged.causes),
    )


def _without_samples(judged: Judgement) -> tuple[str, Verdict]:
    """What to do about samples that are wrong, and the verdict without them.

    A faulty sample says nothing of the model: what to do about that is the same as without it.
    """
    if not judged.causes or any(c.kind not in OF_SAMPLES for c in judged.causes):
        return "", judged.verdict
    return f"{_CORRECT} ", "undecided" if judged.why_undecided else "adequate"


def _undetectable(problem: Problem, found: Findings, table: ScoreTable) -> tuple[Undetectable, ...]:
    """Causes that the model as it is absorbs, with the reasons; none where they are not found."""
    explained = found.search.attempts.attempt(
        "why some causes are undetectable",
        lambda: undetectable_effects(table, problem.model, found.baseline.split.fitted),
    )
    return explained or ()


def by_others(undetectable: Sequence[Undetectable], causes: Sequence[Cause]) -> tuple[str, ...]:
    """A note on every cause that is identifiable by the form of another one alone.

    A sensor's bias is another resting level to a linear model. Beside a term that bends about zero
    it moves where the term bends: the estimate is no better than that form.
    """
    absorbed = {(u.kind, u.where): u.absorbed_by for u in undetectable if u.is_structural}
    notes = []
    for cause in causes:
        like = absorbed.get((cause.kind, cause.where))
        others = [c for c in causes if c is not cause and c.kind not in OF_SAMPLES]
        is_step = any(p.name == "time" for p in cause.parameters)  # the constant one is absorbed
        if like and others and not is_step:
            it, other = ("it", "cause") if len(others) == 1 else ("them", "causes")
            value = "another value" if len(like) == 1 else "other values"
            notes.append(
                f"{cause.words} is determined by the form of the other {other} alone: without {it} "
                f"it would look like {value} of {listed(like)}; check it independently"
            )
    return tuple(notes)


def possible_causes(causes: Sequence[Cause]) -> set[tuple[str, str]]:
    """Kinds and places of what may be a cause: seen, if not in the model without the others."""
    rivals = {(a.kind, a.where) for c in causes for a in c.alternatives}
    return rivals | {(c.kind, c.where) for c in causes}


def _planned(problem: Problem, found: Findings, causes: Sequence[Cause]) -> Advice | None:
    """Experiments that separate the first cause whose rivals the record cannot reject."""
    say = found.search.progress
    for a in found.adopted:
        named = any(
            (c.kind, c.where) == (a.candidate.effect.kind, a.candidate.effect.where)
            and c.alternatives
            for c in causes
        )
        # What is the same term no experiment separates.
        rivals = [r.candidate for r in a.rivals if not a.is_same_term(r.candidate.effect)]
        if not named or not rivals or a.before is None:
            continue
        suspects = [
            Suspect(c.effect, c.fit.values[c.names[0]])
            for c in (a.candidate, *rivals[: PLANNING.suspects])
        ]
        say("plan an experiment that separates the tied causes")
        return next_experiment(problem, a.before, suspects, progress=say)
    return None


_CHECK_CHANNELS = (
    "Check signs, units and the mapping of the channels, then diagnose again: the model explains "
    "next to nothing of this record."
)


def _check_poor(doubts: Doubts) -> str:
    """What to check first where a disturbance explains what the model does not."""
    return f"{_CHECK_CHANNELS} " if doubts.poor else ""


def _is_poor(baseline: Estimate) -> bool:
    """True if the model explains next to nothing of some output."""
    fits = [fit for by_output in baseline.fit.nrmse.values() for fit in by_output.values()]
    return any(fit <= POOR for fit in fits)


_REMEDIES = (": check ", ": fit ", ": diagnose ")
"""The continuation of a reason that names its own remedy (`refusals`, `gain`)."""


def advice(
    verdict: Verdict,
    causes: Sequence[Cause],
    undetectable: Sequence[str],
    why_undecided: str,
    *,
    is_better: bool = True,
    is_same: bool = False,
    doubts: Doubts = NO_DOUBTS,
) -> str:
    """What to do next, in a sentence.

    Parameters
    ----------
    undetectable : names of what the records cannot show (`absorbed_effects`).
    is_better : whether including the causes lowers the error of what was held out.
    is_same : including the causes changes no error.
    doubts : what contradicts the model although no cause was found for it.
    """
    if verdict == "undecided":
        if any(remedy in why_undecided for remedy in _REMEDIES):
            return "Correct what the reason above names, then diagnose again."
        return "Record longer, or excite the system more strongly over a wider band."
    if verdict == "adequate":
        return _of_an_adequate_model(undetectable, doubts)
    for c in causes:
        rivals = [a for a in c.alternatives if (a.kind, a.where) != (c.kind, c.where)]
        others = [a.words for a in rivals if not a.is_same_term]
        if others:
            from_others = f"from {either_words(others)}"
            return f"{_apart(doubts)}To separate {c.words} {from_others}: {_next_record(c)}."
    inseparable = next((c for c in causes if c.is_inseparable), None)
    if inseparable is not None:
        return _apart(doubts) + _of_one_term(inseparable)
    if all(c.kind in OF_SAMPLES for c in causes):
        return _of_samples(why_undecided, doubts)
    return _apart(doubts) + _of_a_deficient_model(causes, is_better, is_same)


def _of_one_term(c: Cause) -> str:
    """Advice where a cause and all that it may be are the same term of the equations."""
    every: list[Cause | Alternative] = [c, *c.alternatives]
    sensors = dict.fromkeys(a.where for a in every if a.kind.startswith("sensor"))
    how = [f"calibrate {where} independently of these records" for where in sensors]
    how.append("measure one of them by itself")
    return (
        f"No record of these channels can separate {c.words} from "
        f"{either_words(a.words for a in c.alternatives)}: they are the same term of the "
        f"equations. Only a reference instrument can: {either_words(how)}."
    )


def _of_an_adequate_model(undetectable: Sequence[str], doubts: Doubts) -> str:
    """Advice for an adequate model: how far it may be used."""
    if doubts.disagreements:
        return _apart(doubts).rstrip()
    if doubts.is_more_than_noise:
        text = (
            "Use the model with care, and not its error bars: look for what the residual follows, "
            "and add that to the model or record it."
        )
    else:
        text = "The model may be used for motions like those recorded."
    if undetectable:
        names = ", ".join(sorted(set(undetectable)))
        text = text if doubts.said else "The model may be used."
        return f"{text} Undetectable in this set-up: {names}."
    return text


_APART = "Diagnose each record by itself, and look for what differs between them"


def _apart(doubts: Doubts) -> str:
    """Advice to begin with where records disagree on the model, or on what was named with it."""
    return f"{_APART}: {doubts.said}. " if doubts.disagreements else ""


def _of_a_deficient_model(causes: Sequence[Cause], is_better: bool, is_same: bool) -> str:
    """Advice for a deficient model whose causes the record separates from others."""
    has_samples = any(c.kind in OF_SAMPLES for c in causes)
    of_model = [c for c in causes if c.kind not in OF_SAMPLES]
    if all(c.kind == "unknown" and not c.parameters for c in of_model):
        return f"{_CORRECT} " * has_samples + (
            "No term was found to add: look for what the residual follows, add that to the model "
            f"or record it, and diagnose again, best with {separates('unknown')}."
        )
    if is_same:
        return (
            "Keep the present model: the extended one has the same errors. Diagnose a further "
            f"record, best with {_next_record(of_model[0])}."
        )
    if not is_better:
        return (
            "Keep the present model for now: the extended one fits better, but raises the error of "
            "what was held out. Diagnose a further record, best with "
            f"{_next_record(causes[0])}."
        )
    declared = declares(causes)
    if declared and all(c.kind == "hold" for c in causes):
        return f"{declared} Then diagnose again."
    first = next((c for c in causes if c.kind != "hold"), causes[0])
    return f"{declared} " * bool(declared) + (
        "Use the extended model; confirm it on another record (--hold-out FILE), best "
        f"with {_next_record(first)}."
    )


def _next_record(c: Cause) -> str:
    """The experiment that separates a cause from others."""
    return separates(c.kind, c.where, c.description)


_CORRECT = "Correct the sensor or the logger, or mark these samples as missing."


def _of_samples(why_undecided: str, doubts: Doubts) -> str:
    """Advice where only samples of a sensor are wrong, or only they are known to be."""
    if why_undecided:
        return (
            f"{_CORRECT} Whether the model is adequate without them is not known: {why_undecided}."
        )
    if doubts.said:
        todo = _APART if doubts.disagreements else "Look for what the residual follows"
        return f"{_CORRECT} They do not explain all: {doubts.said}. {todo}."
    return (
        f"{_CORRECT[:-1]}; without them, as they are left out here, nothing in this record "
        "contradicts the model."
    )


def disturbance_advice(model: Model, d: Disturbance) -> str:
    """What to do about a disturbance that makes most of the residual."""
    text = (
        f"Find what acts on {d.place} and record it, then diagnose again: it makes "
        f"{100 * d.share:.0f} % of the residual, and parameters fitted without it are biased where "
        "it is not random or goes with a recorded input."
    )
    if d.also or d.where not in model.balances:
        return text
    how = f"casid identify {shell_option('--disturbance', f'{d.where}:{d.spectral_form}')}"
    return f"{text} What is truly random is estimated with them by {how}."


def bound_advice(problem: Problem, bounds: Mapping[str, str]) -> str:
    """What to do about parameters that the fit holds at their bounds."""
    names = list(dict.fromkeys(name.partition("@")[0] for name in bounds))
    ranges = []
    for name in names:
        p = problem.model.parameters[name]
        lower, upper = (problem.model.shown(name, end) for end in (p.lower, p.upper))
        ranges.append(f"lower={lower:g}, upper={upper:g} of {name}")
    given = " and ".join(f"--set {name}=VALUE" for name in names)
    return (
        "A wrong sign or unit of a channel drives a parameter to its bound: check signs, units and "
        "the mapping of the channels (casid.identification.signs_from_moments.sign_flips tests "
        "each sign). "
        f"Where they are right and the bound is not physical, widen it ({'; '.join(ranges)} in the "
        f"problem file); where it is, give {' or '.join(names)} that value ({given}) and diagnose "
        "again."
    )
