"""`assess_identifiability`: from a model, a problem or an equation file to the assessment."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from casid.argument_types import names_wrong_types
from casid.data.problem import Problem
from casid.errors import CasidError, DataError, IdentifiabilityError
from casid.identifiability.answers import answer_of, by_class, by_excitation
from casid.identifiability.assessment import (
    Assessment,
    ClosedForms,
    InputClasses,
    Provenance,
    Structure,
)
from casid.identifiability.combinations.closed_form import families
from casid.identifiability.combinations.fixing_sets import (
    confounded_groups,
    count_not_identifiable,
    fixing_sets,
    joined,
)
from casid.identifiability.equations.equation_file import EquationFile
from casid.identifiability.equations.system import System
from casid.identifiability.inputs.elimination import eliminate_unknown_inputs
from casid.identifiability.inputs.input_derivatives import observability_by_counting
from casid.identifiability.question import (
    Assumptions,
    Question,
    eliminated,
    prepared,
    question_about,
)
from casid.identifiability.rank.observability import observability
from casid.identifiability.rank.rank_result import Observability, PointRank
from casid.model.model import Model
from casid.model.quantities import count_text
from casid.versions import versions

if TYPE_CHECKING:
    from casid.data.experiment import Experiment
    from casid.data.record import Record
    from casid.identifiability.inputs.input_classes import Exosystem
    from casid.identifiability.remedies.candidates import Candidate

Progress = Callable[[str], None]

MAX_EXCLUDED = 12
"""Up to so many parameters, every subset is examined (`Assessment.exclusions`)."""


@names_wrong_types()
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
    """Which parameters are identifiable from these experiments, which combinations, and remedies.

    Parameters
    ----------
    subject : a problem or its file, a model, an equation file (JSON, TOML), or systems, one for
        each experiment, which share parameters by name.
    experiments : records with their load cases, of a problem or model; default the problem's own
        example. They determine which values are known in each, and which inputs are zero or
        constant; their samples matter to the practical part alone.
    assuming : replicas, shared inputs, and what is known in addition to what the subject says.
    candidates : sensors, experiments or known parameters to choose the cheapest remedy from.
    degrees : of the polynomials that unknown inputs are also assumed to be.
    exosystems : name -> another source of the unknown inputs, such as a sea of known spectrum:
        a row of its own in the table of classes.
    symbolic : look for the families of equivalent parameters in closed form.
    practical : expected errors for these records (only with a problem or model that has some).
    profiles : parameters whose profile likelihood is computed; takes a fit for each point.
    limit : of the fixing sets listed.
    error_bound : of the structural answer; full rank is a proof.
    time_limit : seconds for the structural answer; the proven part is returned.
    seed : of random points.
    progress : called with a line of text at every step.

    Raises
    ------
    ModelError, DataError
        If the equations, candidates or records cannot be used, with the reason and the remedy.

    Source: A. Sedoglavic (2002) for the rank; Linder (2017), sections 2.7, 4.3, 7.2, 8.3.

    Example
    -------
    >>> import casid
    >>> push = {"states": ["v"], "params": ["F", "m"], "equations": {"v": "F/m"},
    ...         "outputs": {"a": "F/m"}}
    >>> answer = casid.assess_identifiability(casid.parse_system(push))
    >>> answer
    <Assessment of equations: rank 1 of 3>
    >>> answer.confounded_groups
    (('F', 'm'),)
    """
    report = progress or (lambda _: None)
    assuming = assuming or Assumptions()
    question = question_about(subject, experiments, assuming)
    assuming = question.in_si(assuming)
    systems = prepared(question.systems, assuming)
    _check_request(question, systems, candidates, profiles)

    report(f"rank of {count_text(len(systems), 'experiment')}")
    started = time.perf_counter()
    options: Any = {"seed": seed, "error_bound": error_bound, "time_limit": time_limit}
    rank = _rank(systems, options)
    structure = _structure(rank.result, systems, limit)
    seconds = time.perf_counter() - started
    assessment = _assessment(question, systems, assuming, rank, structure, seconds)
    if rank.result.is_partial:
        return assessment

    report("other classes of inputs")
    classes = by_class(systems, structure.answer, degrees, exosystems or {}, **options)
    excitations = by_excitation(question, systems, assuming, **options)
    inputs = replace(assessment.inputs, by_class=classes, by_excitation=excitations)
    assessment = replace(assessment, inputs=inputs)
    if rank.result.deficiency and rank.reduced:
        assessment = _with_exclusions(assessment, rank.result.points[0])
        if symbolic:
            report("families of equivalent parameters")
            named = question.with_symbols(assuming)
            assessment = _with_families(assessment, rank.reduced, named, seed)
    if rank.result.deficiency and (candidates or len(systems) == 1):
        report("remedies")
        assessment = _with_remedies(assessment, systems, candidates, seed)
    elif candidates:
        note = "all parameters are identifiable, so the candidates were not compared"
        assessment = _noted(assessment, note)
    if not practical or question.problem is None or not question.experiments:
        return assessment
    known = _with_known(question.problem, assuming.known)
    return _with_records(assessment, replace(question, problem=known), profiles, report)


def _check_request(
    question: Question,
    systems: Sequence[System],
    candidates: Sequence[Candidate],
    profiles: Sequence[str],
) -> None:
    """Refuse candidates that fit no system, and profiles without records."""
    if candidates:
        from casid.identifiability.remedies.candidates import check

        check(candidates, systems)
    if profiles and not question.experiments:
        raise DataError(
            f"a profile of {', '.join(profiles)} is fitted to records, and {question.name} comes "
            "without any; give experiments, or leave it out"
        )


# -- the structural answer ------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Rank:
    """The rank with arbitrary unknown inputs eliminated.

    Attributes
    ----------
    reduced : systems without unknown inputs; empty where these grew too large and the derivatives
        of the unknown inputs were counted as unknowns.
    eliminated : how, a sentence each.
    """

    result: Observability
    reduced: tuple[System, ...]
    eliminated: tuple[str, ...]


def _rank(systems: Sequence[System], options: Any) -> _Rank:
    try:
        reduced, how = eliminated(systems)
        return _Rank(observability(reduced, **options), reduced, how)
    except IdentifiabilityError as too_large:
        note = f"not eliminated, derivatives of them are unknowns: {too_large}"
        return _Rank(observability_by_counting(systems, **options), (), (note,))


def _structure(result: Observability, systems: Sequence[System], limit: int) -> Structure:
    point, names = result.points[0], result.parameters
    found = Structure(
        answer_of("arbitrary", result, systems),
        orders=result.orders,
        points=len(result.points),
        is_certified=result.is_certified,
    )
    if result.is_partial:
        return found
    return replace(
        found,
        confounded_groups=confounded_groups(point.information, names, point.prime),
        fixing=fixing_sets(point.information, names, point.prime, limit=limit),
    )


def _assessment(
    question: Question,
    systems: Sequence[System],
    assuming: Assumptions,
    rank: _Rank,
    structure: Structure,
    seconds: float,
) -> Assessment:
    """The structural answer alone, to which the other parts are added."""
    return Assessment(
        name=question.name,
        experiments=tuple(s.name for s in question.systems for _ in range(assuming.replicas)),
        structure=structure,
        inputs=InputClasses(
            unknown_inputs=tuple(dict.fromkeys(w for s in systems for w in s.unknown_inputs)),
            shared_inputs=tuple(assuming.shared_inputs),
            eliminated=rank.eliminated,
        ),
        units={k: u for s in systems for k, u in s.units.items()},
        notes=(*question.notes, *_notes(rank.result, systems, assuming)),
        provenance=Provenance(seconds=seconds, versions=versions()),
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
            "abs and sign are analysed on each side of their kinks, and both sides are assumed "
            "to occur in the record"
        )
    unknown = any(s.unknown_inputs for s in systems)
    if unknown and len(systems) > 1:
        notes.append("each experiment has its own unknown inputs")
    if assuming.shared_inputs:
        notes.append(f"all experiments share {', '.join(assuming.shared_inputs)}")
    special = [*(assuming.at or {}), *(x for s in systems for x in s.initial_values)]
    if special:
        notes.append(f"evaluated at special values of {', '.join(dict.fromkeys(special))}")
    return tuple(notes)


def _noted(assessment: Assessment, *notes: str) -> Assessment:
    return replace(assessment, notes=(*assessment.notes, *(n for n in notes if n)))


# -- what is added to it --------------------------------------------------------------------------


def _with_exclusions(assessment: Assessment, point: PointRank) -> Assessment:
    """Rank per column exclusion, set size by set size."""
    names, p = point.parameters, point.prime
    if len(names) > MAX_EXCLUDED:
        return assessment
    rows, states = joined(point.full, [len(x) for x in point.states], p)
    sizes = range(1, len(names) + 1)
    found = tuple(count_not_identifiable(rows, states, names, k, p) for k in sizes)
    return replace(assessment, structure=replace(assessment.structure, exclusions=found))


def _with_families(
    assessment: Assessment, systems: Sequence[System], symbols: Sequence[System], seed: int
) -> Assessment:
    """Families in the names of the known constants, if numbers in their place change nothing."""
    assert assessment.fixing is not None
    chosen = systems
    if symbols is not systems:
        generic = observability(symbols, seed=seed)
        point = generic.points[0]
        groups = confounded_groups(point.information, generic.parameters, point.prime)
        if groups == assessment.confounded_groups:
            chosen = symbols
    found, directions, note = families(chosen, assessment.fixing, seed=seed)
    return _noted(replace(assessment, closed_forms=ClosedForms(found, directions)), note)


def _with_remedies(
    assessment: Assessment, systems: Sequence[System], candidates: Sequence[Candidate], seed: int
) -> Assessment:
    """The cheapest candidates, and for one experiment how often to repeat it."""
    from casid.identifiability.remedies.cheapest_remedies import cheapest_remedies
    from casid.identifiability.remedies.replicas import replicas_needed

    def prepare(system: System) -> System:
        return eliminate_unknown_inputs(system).system if system.unknown_inputs else system

    found, note = assessment.remedy_analysis, ""
    if candidates:
        remedies = cheapest_remedies(systems, candidates, prepare=prepare, seed=seed)
        found = replace(found, remedies=remedies)
    if len(systems) == 1:
        try:
            needed = replicas_needed([prepare(s) for s in systems], seed=seed)
            found = replace(found, replicas=needed)
        except CasidError as error:
            note = f"replicas: {error}"
    return _noted(replace(assessment, remedy_analysis=found), note)


def _with_known(problem: Problem, known: Sequence[str]) -> Problem:
    """The problem with the parameters that are assumed to be known, at their start values."""
    parameters = problem.model.parameters
    values = {n: parameters[n].start for n in known if n in parameters}
    return problem.with_si_values({n: v for n, v in values.items() if not parameters[n].is_known})


def _with_records(
    assessment: Assessment, question: Question, profiles: Sequence[str], report: Progress
) -> Assessment:
    """Excitation, expected errors and profiles for the records given."""
    from casid.identifiability.records.practical import practical_identifiability
    from casid.identifiability.records.profile_likelihood import profile_likelihood
    from casid.identifiability.records.reference_excitation import record_excitation

    problem, experiments = question.problem, question.experiments
    assert problem is not None
    found, notes = assessment.records, []
    report("expected errors of these records")
    try:
        found = replace(found, excitations=record_excitation(problem, experiments))
    except CasidError as error:
        notes.append(f"excitation: {error}")
    try:
        found = replace(found, practical=practical_identifiability(problem, experiments))
    except CasidError as error:
        notes.append(f"practical identifiability: {error}")
    if profiles:
        report(f"profile likelihood of {', '.join(profiles)}")
        likelihood = profile_likelihood(problem, experiments, list(profiles))
        found = replace(found, profiles=likelihood)
    return _noted(replace(assessment, records=found), *notes)
