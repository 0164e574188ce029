"""Identifiability requirement of an estimator: why an estimate is refused before it is computed.

The rank is exact and holds for almost every value of the parameters, so a refusal here does not
depend on start values, scaling or tolerances. Whether *these* records excite the parameters enough,
and a parameter gets a standard error, is decided after the fit from the sensitivities
(`casid.estimation.local_rank`).
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from casid.errors import CasidError, IdentifiabilityError
from casid.identifiability.combinations.closed_form import families, joint_invariants
from casid.identifiability.combinations.family import Family
from casid.identifiability.combinations.fixing_sets import (
    FixingSets,
    confounded_groups,
    fixing_sets,
)
from casid.identifiability.equations.model_system import translated
from casid.identifiability.equations.system import System
from casid.identifiability.inputs.input_classes import as_zero
from casid.identifiability.rank.observability import observability
from casid.identifiability.rank.rank_result import Observability, PointRank
from casid.model.model import Model

if TYPE_CHECKING:
    from casid.data.experiment import Experiment
    from casid.data.problem import Problem

TIME_LIMIT = 20.0
"""Seconds for the rank."""

FAMILIES_LIMIT = 20.0
"""Seconds of computing that a refusal may spend on the identifiable combinations: three times
what the ship's nine parameters of three experiments take on a slow machine."""

STATES_TRIED = 4
"""Initial values that a refusal tries, each of which takes the rank once more."""


def require_identifiable(
    model: Model,
    experiments: Sequence[Experiment],
    *,
    free: Sequence[str] | None = None,
    own: Sequence[str] = (),
    zero_unknown_inputs: bool = False,
    problem: Problem | None = None,
    progress: Callable[[str], None] | None = None,
) -> str:
    """Refuse parameters that are not identifiable from any data of these experiments.

    Parameters
    ----------
    model : without unknown inputs, unless `zero_unknown_inputs`.
    experiments : each with its load case; their samples are not used.
    free : the parameters that are estimated, all others known; default the model's unknown ones.
    own : parameters of which every experiment has its own value.
    zero_unknown_inputs : unknown inputs are replaced by zero, the mean of the noise they are.
    problem : of the model; a refusal explains load cases that no experiment was named after.
    progress : called with a line of text before what may take seconds.

    Returns
    -------
    str
        The rank, or why it was not decided, as evidence of the estimate.

    Raises
    ------
    IdentifiabilityError
        With the parameters, their identifiable combinations, and the remedy.
    """
    say = progress or (lambda _: None)

    def ranked(of: Model) -> Observability:
        systems = _systems(of, experiments, free, own, zero_unknown_inputs)
        return observability(systems, time_limit=TIME_LIMIT)

    try:
        result = ranked(model)
    except CasidError as error:
        return f"not decided: {error}"
    if result.is_partial:
        return f"not decided within {TIME_LIMIT:g} s"
    if result.deficiency == 0:
        proof = "a proof" if result.is_full else f"error below {result.error_bound:.0e}"
        return f"all parameters (rank {result.rank} of {result.unknowns}, {proof})"
    say(
        f"rank {result.rank} of {result.unknowns}: look for identifiable combinations, "
        f"{FAMILIES_LIMIT:g} s of computing at the most"
    )
    symbols = _systems(model, experiments, free, own, zero_unknown_inputs, generic=True)
    text = _refusal(model, experiments, symbols, result)
    text += _by_initial_values(model, result, ranked)
    raise IdentifiabilityError(text + (unnamed_cases(problem, experiments) if problem else ""))


def unnamed_cases(problem: Problem, experiments: Sequence[Experiment]) -> str:
    """How to name a load case, where the problem has some and no experiment is named after one."""
    cases = problem.load_cases
    loads = {p for known in cases.values() for p in known}
    if not cases or any(
        loads & set(e.known) or e.name.partition(":")[0] in cases for e in experiments
    ):
        return ""
    file = "PROBLEM.py" if problem.source is None else problem.source.name
    given = " ".join(
        shlex.quote(f"{case}={letter}.csv") for case, letter in zip(cases, "abcdefgh", strict=False)
    )
    return (
        f" The problem has load cases ({', '.join(cases)}), which define what is known in each, "
        "and no record was named after one: put its case in front of each file, as in casid "
        f"diagnose {file} {given}; in Python problem.read(path, case={next(iter(cases))!r}). "
        "Signs of channels are tested as soon as the parameters are identifiable."
    )


def unidentifiable_families(model: Model, experiments: Sequence[Experiment]) -> tuple[Family, ...]:
    """Families of unknown parameters that are equivalent for all data of these experiments.

    Returns
    -------
    one for each parameter that would have to be known; empty where all are identifiable.

    Raises
    ------
    IdentifiabilityError
        If the rank or a closed form is not found in time.
    """
    result = observability(_systems(model, experiments, None, (), False), time_limit=TIME_LIMIT)
    if result.is_partial:
        raise IdentifiabilityError(
            f"{model.name}: the rank was not decided within {TIME_LIMIT:g} s; give some of the "
            "parameters known values"
        )
    if result.deficiency == 0:
        return ()
    point = result.points[0]
    fixing = fixing_sets(point.information, result.parameters, point.prime, limit=100)
    symbols = _systems(model, experiments, None, (), False, generic=True)
    found, _, note = families(symbols, fixing, time_limit=10 * TIME_LIMIT)
    if len(found) != fixing.size:
        raise IdentifiabilityError(
            f"{model.name}: {note or 'not every family was found'}; give one of each of these a "
            f"known value: {'; '.join(', '.join(g) for g in fixing.groups)}"
        )
    return found


def _systems(
    model: Model,
    experiments: Sequence[Experiment],
    free: Sequence[str] | None,
    own: Sequence[str],
    zero_unknown_inputs: bool,
    *,
    generic: bool = False,
) -> tuple[System, ...]:
    chosen = model.copy()
    for p in free or ():
        chosen.parameters[p] = replace(model.parameter_named(p), value=None)
    named = [replace(e, name=word(e.name)) for e in experiments]
    read = translated(chosen, named, generic=generic, use_samples=False)
    systems = []
    for found, e in zip(read.systems, experiments, strict=True):
        s = as_zero(found) if zero_unknown_inputs and found.unknown_inputs else found
        given = [p for p in s.parameters if free is not None and p not in free]
        systems.append(s.with_known(*given).renamed({p: f"{p} of {e.name}" for p in own}))
    return tuple(systems)


def word(name: str) -> str:
    """An experiment's name as a part of the name of a constant."""
    return re.sub(r"\W+", "_", name).strip("_") or "record"


def _refusal(
    model: Model,
    experiments: Sequence[Experiment],
    symbols: Sequence[System],
    result: Observability,
) -> str:
    point = result.points[0]
    groups = confounded_groups(point.information, result.parameters, point.prime)
    fixing = fixing_sets(point.information, result.parameters, point.prime, limit=100)
    found: Sequence[Family] = ()
    try:
        found = families(symbols, fixing, time_limit=FAMILIES_LIMIT)[0]
    except CasidError:
        found = ()
    where = ", ".join(e.name for e in experiments)
    return (
        f"{model.name}: rank {result.rank} of {result.unknowns} parameters and initial states, "
        f"whatever is recorded in {where}. "
        + " ".join(_sentence(g, fixing, found, point) for g in groups)
    )


def _by_initial_values(
    model: Model, result: Observability, ranked: Callable[[Model], Observability]
) -> str:
    """Which initial values make all parameters identifiable, each by itself, once it is known.

    The charge of a battery, say, whose voltage is a polynomial of it.
    """
    enough = []
    unknown = dict.fromkeys(n for n in result.points[0].unobservable() if n in model.states)
    for name in list(unknown)[:STATES_TRIED]:
        fixed, state = model.copy(), model.states[name]
        fixed.states[name] = replace(state, initial=state.start or 1.0)  # zero may be special
        try:
            found = ranked(fixed)
        except CasidError:
            continue
        if not found.is_partial and found.deficiency == 0:
            enough.append(name)
    if not enough:
        return ""
    return (
        f" Or give the initial value of {' or '.join(enough)}, which no output determines either: "
        f"m.state({enough[0]!r}, ..., initial=...); all parameters are identifiable then."
    )


def _sentence(
    group: tuple[str, ...], fixing: FixingSets, found: Sequence[Family], point: PointRank
) -> str:
    """A confounded group, its identifiable combinations, and the remedy."""
    size = fixing.group_sizes[fixing.groups.index(group)]
    if len(group) == 1 and point.moves(group[0]):
        states = dict.fromkeys(point.unobservable())
        first = "initial value" if len(states) == 1 else "initial values"
        return (
            f"{group[0]} and the {first} of {' and '.join(states)}, which every record has of its "
            f"own, are not separately identifiable: give {group[0]} a known value, or add a sensor."
        )
    if len(group) == 1:
        return (
            f"{group[0]} does not move any output in these experiments: give it a known value, or "
            "record an experiment in which it acts."
        )
    inside = [f for f in found if f.free in group]
    kept, is_all = joint_invariants(inside) if len(inside) == size else ((), False)
    more = "" if is_all else " and more"
    verb = "is" if len(kept) == 1 and is_all else "are"
    instead = f", but {', '.join(map(str, kept))}{more} {verb}" if kept else ""
    named = f"{', '.join(group[:-1])} and {group[-1]}"
    many = "one of them" if size == 1 else f"{size} of them"
    example = [n for n in fixing.sets[0] if n in group] if size > 1 and fixing.sets else []
    such = f" (such as {', '.join(example[:-1])} and {example[-1]})" if len(example) > 1 else ""
    return (
        f"{named} are not separately identifiable{instead}: give {many} a known value{such}, or "
        "let casid.assess_identifiability find a sensor or experiment that remedies it; "
        "casid.invariants reports what is identifiable nevertheless."
    )
