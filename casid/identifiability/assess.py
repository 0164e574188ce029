"""`assess_identifiability`: one call from a model, a problem or an equation file to the answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from casid.data.problem import Problem
from casid.errors import CasidError, DataError, IdentifiabilityError
from casid.identifiability.answers import answer_of, by_class, by_excitation
from casid.identifiability.assessment import Assessment
from casid.identifiability.combinations.closed_form import families
from casid.identifiability.combinations.fixing_sets import (
    Exclusion,
    confounded_groups,
    count_not_identifiable,
    fixing_sets,
    joined,
)
from casid.identifiability.equations.equation_file import EquationFile
from casid.identifiability.inputs.elimination import eliminate_unknown_inputs
from casid.identifiability.inputs.unknown_jets import observability_by_jets
from casid.identifiability.question import Asked, Assumptions, asked_about, eliminated, prepared
from casid.identifiability.rank.observability import observability
from casid.identifiability.rank.rank_result import Observability, PointRank
from casid.identifiability.rank.system import System
from casid.model.model import Model

if TYPE_CHECKING:
    from casid.data.record import Experiment, Record
    from casid.identifiability.inputs.input_classes import Exosystem
    from casid.identifiability.remedies.candidates import Candidate

Progress = Callable[[str], None]

MAX_EXCLUDED = 12
"""Parameters of which every subset is looked at, one by one."""


def assess_identifiability(
    subject: str | Path | Problem | Model | EquationFile | System | Sequence[System],
    experiments: Sequence[Experiment | Record] | None = None,
    *,
    assuming: Assumptions | None = None,
    candidates: Sequence[Candidate] = (),
    degrees: Sequence[int] = (0, 1, 2, 4),
    exosystems: Mapping[str, Exosystem] | None = None,
    symbolic: bool = True,
    practical: bool = True,
    profiles: Sequence[str] = (),
    limit: int = 10_000,
    error_bound: float = 1e-12,
    time_limit: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Assessment:
    """Which parameters these experiments can tell, which combinations instead, what would mend it.

    Parameters
    ----------
    subject : a problem or its file, a model, an equation file (JSON, TOML), or systems, one for
        each experiment, which share parameters by name.
    experiments : records with their load cases, of a problem or model; default the problem's own
        example. They say which values are known in each, and which inputs are at rest; their
        samples matter to the practical part alone.
    candidates : sensors, experiments or known parameters to choose the cheapest mend from.
    degrees : of the polynomials that unknown inputs are also taken to be.
    exosystems : name -> what else may drive the unknown inputs, such as a sea of known spectrum:
        a row of its own in the table of classes.
    symbolic : look for the families of equivalent parameters in closed form.
    practical : expected errors for these records (only with a problem or model that has some).
    profiles : parameters whose profile likelihood is computed; takes a fit for each point.
    limit : of the fixing sets listed.
    error_bound : of the structural answer; full rank is a proof.
    time_limit : seconds for the structural answer; the proven part is returned.
    seed : of random points.

    Raises
    ------
    ModelError, DataError
        If the equations, candidates or records cannot be used; says which and how to mend it.

    Source: A. Sedoglavic (2002) for the rank; Linder (2017), sections 2.7, 4.3, 7.2, 8.3.
    """
    say = progress or (lambda _: None)
    assuming = assuming or Assumptions()
    asked = asked_about(subject, experiments, assuming)
    given = prepared(asked.systems, assuming)
    _refuse_what_has_no_use(asked, given, candidates, profiles)
    say(f"rank of {_count(len(given), 'experiment')}")
    started = time.perf_counter()
    options: Any = {"seed": seed, "error_bound": error_bound, "time_limit": time_limit}
    try:
        systems, how = eliminated(given)
        result = observability(systems, **options)
    except IdentifiabilityError as too_large:
        systems, how = (), (f"not eliminated, derivatives of them are unknowns: {too_large}",)
        result = observability_by_jets(given, **options)
    point = result.points[0]
    partial = result.is_partial
    names = result.parameters
    groups = () if partial else confounded_groups(point.information, names, point.prime)
    fixing = None if partial else fixing_sets(point.information, names, point.prime, limit=limit)
    answer = answer_of("arbitrary", result, given)
    seconds = time.perf_counter() - started
    assessment = Assessment(
        name=asked.name,
        experiments=tuple(s.name for s in asked.systems for _ in range(assuming.replicas)),
        answer=answer,
        confounded_groups=groups,
        fixing=fixing,
        unknown_inputs=tuple(dict.fromkeys(w for s in given for w in s.unknown_inputs)),
        shared_inputs=tuple(assuming.shared_inputs),
        eliminated=how,
        orders=result.orders,
        points=len(result.points),
        is_certified=result.is_certified,
        units={k: u for s in given for k, u in s.units.items()},
        notes=(*asked.notes, *_notes(result, given, assuming)),
        seconds=seconds,
        versions=_versions(),
    )
    if partial:
        return assessment
    say("other classes of inputs")
    assessment = replace(
        assessment,
        by_class=by_class(given, answer, degrees, exosystems or {}, **options),
        by_excitation=by_excitation(asked, given, assuming, **options),
    )
    if result.deficiency and systems:
        assessment = replace(assessment, exclusions=_exclusions(point))
    if result.deficiency and symbolic and systems:
        say("families of equivalent parameters")
        assessment = _with_families(assessment, systems, asked.with_symbols(assuming), seed)
    if candidates and not result.deficiency:
        note = "all parameters are identifiable, so the candidates were not weighed"
        assessment = replace(assessment, notes=(*assessment.notes, note))
    if result.deficiency and (candidates or len(given) == 1):
        say("mends")
        assessment = _mended(assessment, given, candidates, seed)
    if practical and asked.problem is not None and asked.experiments:
        assessment = _practical(assessment, asked, profiles, say)
    return assessment


def _refuse_what_has_no_use(
    asked: Asked,
    systems: Sequence[System],
    candidates: Sequence[Candidate],
    profiles: Sequence[str],
) -> None:
    if candidates:
        from casid.identifiability.remedies.candidates import check

        check(candidates, systems)
    if profiles and not asked.experiments:
        raise DataError(
            f"a profile of {', '.join(profiles)} is fitted to records, and {asked.name} comes "
            "without any; give experiments, or leave it out"
        )


def _notes(
    result: Observability, systems: Sequence[System], assuming: Assumptions
) -> tuple[str, ...]:
    notes = []
    if result.immersed:
        notes.append(
            f"the answer is for the rational immersion: {', '.join(result.immersed)} became states "
            "with differential equations of their own"
        )
    if result.has_kinks:
        notes.append(
            "abs and sign are analysed on each side of their kinks, and both sides are taken to "
            "occur in the record"
        )
    unknown = any(s.unknown_inputs for s in systems)
    if unknown and len(systems) > 1:
        notes.append("each experiment has its own unknown inputs")
    if assuming.shared_inputs:
        notes.append(f"all experiments share {', '.join(assuming.shared_inputs)}")
    special = [*(assuming.at or {}), *(x for s in systems for x in s.initial_values)]
    if special:
        notes.append(f"looked at special values of {', '.join(dict.fromkeys(special))}")
    return tuple(notes)


def _exclusions(point: PointRank) -> tuple[Exclusion, ...]:
    """Rank per column exclusion, set size by set size."""
    n = len(point.parameters)
    if n > MAX_EXCLUDED:
        return ()
    rows, states = joined(point.full, [len(x) for x in point.states], point.prime)
    names, p = point.parameters, point.prime
    return tuple(count_not_identifiable(rows, states, names, k, p) for k in range(1, n + 1))


def _with_families(
    assessment: Assessment, systems: Sequence[System], symbols: Sequence[System], seed: int
) -> Assessment:
    """Families in the names of the known constants, if numbers in their place change nothing."""
    assert assessment.fixing is not None
    chosen = systems
    if symbols is not systems:
        generic = observability(symbols, seed=seed)
        point = generic.points[0]
        there = confounded_groups(point.information, generic.parameters, point.prime)
        if there == assessment.confounded_groups:
            chosen = symbols
    found, directions, note = families(chosen, assessment.fixing, seed=seed)
    notes = (*assessment.notes, *([note] if note else []))
    return replace(assessment, families=found, directions=directions, notes=notes)


# -- what would help, and what these records give -------------------------------------------------


def _mended(
    assessment: Assessment,
    systems: Sequence[System],
    candidates: Sequence[Candidate],
    seed: int,
) -> Assessment:
    from casid.identifiability.remedies.cheapest_remedies import cheapest_mends
    from casid.identifiability.remedies.replicas import replicas_needed

    def prepare(system: System) -> System:
        return eliminate_unknown_inputs(system).system if system.unknown_inputs else system

    notes = list(assessment.notes)
    if candidates:
        mends = cheapest_mends(systems, candidates, prepare=prepare, seed=seed)
        assessment = replace(assessment, mends=mends)
    if len(systems) == 1:
        try:
            needed = replicas_needed([prepare(s) for s in systems], seed=seed)
            assessment = replace(assessment, replicas=needed)
        except CasidError as error:
            notes.append(f"replicas: {error}")
    return replace(assessment, notes=tuple(notes))


def _practical(
    assessment: Assessment, asked: Asked, profiles: Sequence[str], say: Progress
) -> Assessment:
    from casid.identifiability.records.practical import practical_identifiability
    from casid.identifiability.records.profile_likelihood import profile_likelihood
    from casid.identifiability.records.reference_excitation import record_excitation

    assert asked.problem is not None
    notes = list(assessment.notes)
    say("expected errors of these records")
    try:
        orders = record_excitation(asked.problem, asked.experiments)
        assessment = replace(assessment, excitations=orders)
    except CasidError as error:
        notes.append(f"excitation: {error}")
    try:
        expected = practical_identifiability(asked.problem, asked.experiments)
        assessment = replace(assessment, practical=expected)
    except CasidError as error:
        notes.append(f"practical identifiability: {error}")
    if profiles:
        say(f"profile likelihood of {', '.join(profiles)}")
        found = profile_likelihood(asked.problem, asked.experiments, list(profiles))
        assessment = replace(assessment, profiles=found)
    return replace(assessment, notes=tuple(notes))


def _versions() -> dict[str, str]:
    from casid.versions import versions

    return versions()


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"
