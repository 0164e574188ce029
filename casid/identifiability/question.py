"""The question of an assessment: systems from whatever names them, and the assumptions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from casid.algebra.symbolic import exact
from casid.data.arguments import experiments_of
from casid.data.problem import Problem, load_problem
from casid.errors import CasidError, ModelError, nearest
from casid.identifiability.equations.equation_file import EquationFile, read_equations
from casid.identifiability.equations.model_system import system_of, translated
from casid.identifiability.equations.system import System
from casid.identifiability.inputs.elimination import eliminate_unknown_inputs
from casid.identifiability.inputs.experiments import merge, replicas
from casid.model.model import Model

if TYPE_CHECKING:
    from casid.data.experiment import Experiment


@dataclass(frozen=True, slots=True)
class Assumptions:
    """What an assessment assumes.

    Attributes
    ----------
    replicas : every experiment is repeated so many times, from other initial states.
    shared_inputs : unknown inputs that are one signal in all experiments that have them; all other
        unknown inputs are each experiment's own.
    known_initial : states whose initial value is known; name -> number where that may be special
        (None: some number).
    known : parameters that are known in addition to those of the model.
    at : parameters with these values, which may be special (0, equal to another); else the answer
        holds for almost every value.
    generic : known parameters of a model are some known numbers, and not the values they have.
    """

    replicas: int = 1
    shared_inputs: Sequence[str] = ()
    known_initial: Sequence[str] | Mapping[str, float | None] = ()
    known: Sequence[str] = ()
    at: Mapping[str, float] | None = None
    generic: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """Systems, and the problem and records they come from."""

    name: str
    systems: tuple[System, ...]
    notes: tuple[str, ...] = ()
    problem: Problem | None = None
    model: Model | None = None
    experiments: tuple[Experiment, ...] = ()

    def translated(self, *, generic: bool, direct: bool = False) -> tuple[System, ...]:
        """The systems of the model with other options (`system_of`)."""
        if self.model is None:
            return self.systems
        if self.experiments:
            chosen = translated(self.model, self.experiments, generic=generic, direct=direct)
            return chosen.systems
        return (system_of(self.model, generic=generic, direct=direct),)

    def in_si(self, assuming: Assumptions) -> Assumptions:
        """The assumptions with values in SI, given in the units that the model declares."""
        model = self.model or (None if self.problem is None else self.problem.model)
        if model is None or not model.declared_units:
            return assuming
        starts = assuming.known_initial
        if isinstance(starts, Mapping):
            numbers = model.in_si({n: v for n, v in starts.items() if v is not None})
            starts = {**starts, **numbers}
        at = None if assuming.at is None else model.in_si(assuming.at)
        return replace(assuming, at=at, known_initial=starts)

    def with_symbols(self, assuming: Assumptions) -> tuple[System, ...]:
        """The systems with known constants as symbols, for formulas that can be read."""
        try:
            return eliminated(prepared(self.translated(generic=True), assuming))[0]
        except CasidError:
            return eliminated(prepared(self.systems, assuming))[0]


def question_about(subject: Any, experiments: Any, assuming: Assumptions) -> Question:
    """Systems from a path, a problem, a model, an equation file or systems themselves.

    Raises
    ------
    ModelError, DataError
        If it is none of these, or cannot be read.
    """
    if isinstance(subject, (str, Path)):
        path = Path(subject)
        subject = load_problem(path) if path.suffix == ".py" else read_equations(path)
    if isinstance(subject, EquationFile):
        return Question(subject.name, subject.systems)
    if isinstance(subject, System):
        return Question(subject.name, (subject,))
    if isinstance(subject, (Problem, Model)):
        return _of_problem(subject, experiments, assuming)
    systems = tuple(subject) if isinstance(subject, Sequence) else ()
    if not systems or not all(isinstance(s, System) for s in systems):
        raise ModelError(
            f"{subject!r} has no equations to assess the identifiability of; give a problem, a "
            "model, the path of a problem or equation file, or systems"
        )
    return Question(systems[0].name, systems)


def _of_problem(subject: Problem | Model, experiments: Any, assuming: Assumptions) -> Question:
    problem = subject if isinstance(subject, Problem) else None
    model = subject if isinstance(subject, Model) else subject.model
    if experiments is None and (problem is None or problem.example is None):
        cases = dict(problem.load_cases) if problem is not None else {}
        if not cases:
            return Question(
                model.name, (system_of(model, generic=assuming.generic),), (), problem, model
            )
        systems = tuple(
            system_of(model, known=known, generic=assuming.generic).where(name=case)
            for case, known in cases.items()
        )
        assert problem is not None
        return Question(problem.name, systems, (), problem, None)
    if problem is None:
        problem = Problem(model.name, model)
    chosen = tuple(experiments_of(problem, experiments))
    read = translated(model, chosen, generic=assuming.generic)
    return Question(problem.name, read.systems, read.notes, problem, model, chosen)


_REPLICAS = 20  # allowed in any case: one signal that all of them share is determined by them too

# -- under the assumptions ------------------------------------------------------------------------


def prepared(systems: Sequence[System], assuming: Assumptions) -> tuple[System, ...]:
    """The systems as assumed: known values, points, replicas, shared inputs."""
    _refuse_idle_replicas(systems, assuming)
    named = dict(assuming.at or {})
    starts = assuming.known_initial
    given = dict(starts) if isinstance(starts, Mapping) else dict.fromkeys(starts)
    numbers = {x: v for x, v in given.items() if v is not None}
    generic = [x for x, v in given.items() if v is None]
    _check_names(systems, assuming, (*numbers, *generic), named)
    out = []
    for s in systems:
        s = s.with_known(*[p for p in assuming.known if p in s.parameters])
        out.append(
            s.where(
                known_initial=_union(s.known_initial, [x for x in generic if x in s.states]),
                initial_values={
                    **s.initial_values,
                    **{x: exact(v) for x, v in numbers.items() if x in s.states},
                },
                at={**s.at, **{p: exact(v) for p, v in named.items() if p in s.parameters}},
            )
        )
    made = [c for s in out for c in replicas(s, assuming.replicas)]
    if assuming.shared_inputs:
        made = [merge(made, shared=tuple(assuming.shared_inputs), name=systems[0].name)]
    return tuple(made)


def _refuse_idle_replicas(systems: Sequence[System], assuming: Assumptions) -> None:
    """A replica that adds no rank is the last that could: each adds one, or none ever will."""
    unknown = len({p for s in systems for p in s.parameters})
    most = max(unknown, _REPLICAS)
    if assuming.replicas > most:
        raise ModelError(
            f"{assuming.replicas} replicas: there are {unknown} unknown parameters, and each "
            f"replica determines one more at least or none does; ask for at most {most}"
        )


def _check_names(
    systems: Sequence[System],
    assuming: Assumptions,
    initial: Sequence[str],
    at: Mapping[str, float],
) -> None:
    for what, names, attribute in (
        ("known initial value", initial, "states"),
        ("known parameter", assuming.known, "parameters"),
        ("point", at, "parameters"),
        ("shared input", assuming.shared_inputs, "unknown_inputs"),
    ):
        known = list(dict.fromkeys(n for s in systems for n in getattr(s, attribute)))
        for n in names:
            if n not in known:
                raise ModelError(f"{what} {n!r}: no such name{nearest(n, known)}")


def _union(a: Sequence[str], b: Sequence[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys([*a, *b]))


def eliminated(systems: Sequence[System]) -> tuple[tuple[System, ...], tuple[str, ...]]:
    """Systems with known inputs alone, and how the unknown ones were eliminated."""
    once: dict[int, Any] = {}
    notes: list[str] = []
    out = []
    for s in systems:
        if not s.unknown_inputs:
            out.append(s)
            continue
        if id(s) not in once:
            once[id(s)] = eliminate_unknown_inputs(s)
            prefix = f"{s.name}: " if len({id(t) for t in systems}) > 1 else ""
            notes += [prefix + note for note in once[id(s)].notes]
        out.append(once[id(s)].system)
    return tuple(out), tuple(notes)
