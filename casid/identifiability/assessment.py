"""The assessment: which parameters are identifiable, which combinations, and the remedies."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from casid.arrays import finite_or_none
from casid.deprecation import renamed
from casid.grouping import Grouped
from casid.model.quantities import are, listed, shortened
from casid.presentation import Presented, present, write
from casid.saving.saved import Saved

if TYPE_CHECKING:
    from casid.identifiability.combinations.closed_form import IdentifiableCombinations
    from casid.identifiability.combinations.family import Family
    from casid.identifiability.combinations.fixing_sets import Exclusion, FixingSets
    from casid.identifiability.combinations.null_direction import NullDirection
    from casid.identifiability.records.practical import Practical
    from casid.identifiability.records.profile_likelihood import Profiles
    from casid.identifiability.records.reference_excitation import RecordExcitation
    from casid.identifiability.remedies.cheapest_remedies import Remedies
    from casid.identifiability.remedies.replicas import ReplicasNeeded

SCHEMA = "casid.identifiability/1"

ELIMINATED_ZERO = "zero: the sensor that replaces it then depends on the states alone"
"""Label in `Assessment.by_excitation` of eliminated unknown inputs that are zero."""

Verdict = Literal["identifiable", "not_identifiable", "unknown"]
StateVerdict = Literal["observable", "not_observable", "unknown"]

SOURCES = (
    "A. Sedoglavic, J. Symb. Comput. 33 (2002) 735-755: rank by power series over a prime field",
    "J. Linder, Indirect System Identification for Unknown Input Problems, Linkoping 2017, "
    "section 2.7 and chapters 4, 7, 8: extended observability matrix, indirect models",
    "R. M. Hirschorn, SIAM J. Control Optim. 17 (1979) 289-297: inversion of nonlinear systems",
    "J. G. Oxley, Matroid Theory, 2nd ed., Oxford 2011: fixing sets as bases",
    "J. T. Schwartz, J. ACM 27 (1980) 701-717: the error bound",
)


@dataclass(frozen=True, slots=True)
class Answer:
    """Rank and verdicts under one assumption on the inputs.

    Attributes
    ----------
    rank, unknowns : parameters and initial states (and coefficients of assumed inputs).
    error_bound : 0 is a proof, nan where `is_partial`.
    deficiency : dimension of the unidentifiable directions of the parameters.
    note : what was assumed, or why there is no answer (then rank is None).
    """

    label: str
    rank: int | None
    unknowns: int | None
    parameters: Mapping[str, Verdict]
    states: Mapping[str, StateVerdict]
    deficiency: int | None = None
    error_bound: float = 0.0
    is_partial: bool = False
    note: str = ""

    @property
    def not_identifiable(self) -> tuple[str, ...]:
        """Parameters that are not."""
        return tuple(p for p, v in self.parameters.items() if v == "not_identifiable")

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "rank": self.rank,
            "unknowns": self.unknowns,
            "deficiency": self.deficiency,
            "parameters": dict(self.parameters),
            "states": dict(self.states),
            "non_identifiable": list(self.not_identifiable),
            "unobservable_states": [x for x, v in self.states.items() if v == "not_observable"],
            "error_bound": finite_or_none(self.error_bound),
            "partial": self.is_partial,
            **({"note": self.note} if self.note else {}),
        }


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """What follows from the equations alone, for almost every value of the parameters.

    Attributes
    ----------
    answer : for arbitrary unknown inputs, and known inputs as rich as they can be.
    confounded_groups : parameters that can be traded for each other; a single name is a parameter
        that can have any value.
    fixing : minimal fixing sets; their complements are the maximal identifiable subsets.
    exclusions : by size, how many sets of parameters are not identifiable although all others are
        known (Linder 2017, Tables 7.1 and 8.1); for few parameters only.
    orders : by experiment, the highest derivative of the outputs that raised the rank.
    points : random points at which the rank was computed.
    is_certified : False where later derivatives might raise the rank (special values).
    """

    answer: Answer
    confounded_groups: tuple[tuple[str, ...], ...] = ()
    fixing: FixingSets | None = None
    exclusions: tuple[Exclusion, ...] = ()
    orders: tuple[int, ...] = ()
    points: int = 1
    is_certified: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class ClosedForms:
    """How parameters that are not identifiable move together without a change of any output.

    Attributes
    ----------
    directions : their rates as functions of the physical symbols, one a direction.
    families : the same integrated, with the invariants, where a closed form was found.
    """

    families: tuple[Family, ...] = ()
    directions: tuple[NullDirection, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class InputClasses:
    """Unknown inputs, and the answers for other classes of inputs.

    Attributes
    ----------
    unknown_inputs, shared_inputs : names.
    eliminated : how arbitrary unknown inputs were eliminated, a sentence each.
    by_class : class of the unknown inputs -> answer.
    by_excitation : poorer known inputs (zero, constant) -> answer.
    """

    unknown_inputs: tuple[str, ...] = ()
    shared_inputs: tuple[str, ...] = ()
    eliminated: tuple[str, ...] = ()
    by_class: Mapping[str, Answer] = field(default_factory=dict)
    by_excitation: Mapping[str, Answer] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class RemedyAnalysis:
    """What would make all parameters identifiable: additions, and repetitions."""

    remedies: Remedies | None = None
    replicas: ReplicasNeeded | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RecordAnalysis:
    """What the records given determine under their noise: errors, profiles, excitation."""

    practical: Practical | None = None
    profiles: Profiles | None = None
    excitations: tuple[RecordExcitation, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Provenance:
    """How an answer came about; `seconds` of the structural part alone."""

    seconds: float = 0.0
    versions: Mapping[str, str] = field(default_factory=dict)
    sources: tuple[str, ...] = SOURCES


@dataclass(frozen=True, slots=True, eq=False)
class Assessment(Presented, Saved):
    """Identifiability of a model's parameters from the experiments given.

    Fields are grouped by question; the attributes of all groups can be read here as well.

    Attributes
    ----------
    name : of the problem or equation file.
    experiments : names; parameters are shared, initial states are each experiment's own.
    structure : rank, verdicts, confounded groups and fixing sets (`Structure`).
    closed_forms : families of equivalent parameters (`ClosedForms`).
    inputs : answers for other classes of inputs (`InputClasses`).
    remedy_analysis : what would make all parameters identifiable (`RemedyAnalysis`).
    records : expected errors, profiles and excitation of the records (`RecordAnalysis`).
    units : name -> unit.
    notes : what was assumed or left out.
    """

    name: str
    experiments: tuple[str, ...]
    structure: Structure
    closed_forms: ClosedForms = ClosedForms()
    inputs: InputClasses = InputClasses()
    remedy_analysis: RemedyAnalysis = RemedyAnalysis()
    records: RecordAnalysis = RecordAnalysis()
    units: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    provenance: Provenance = Provenance()

    answer: ClassVar[Grouped[Answer]] = Grouped("structure")
    confounded_groups: ClassVar[Grouped[tuple[tuple[str, ...], ...]]] = Grouped("structure")
    fixing: ClassVar[Grouped[FixingSets | None]] = Grouped("structure")
    exclusions: ClassVar[Grouped[tuple[Exclusion, ...]]] = Grouped("structure")
    orders: ClassVar[Grouped[tuple[int, ...]]] = Grouped("structure")
    points: ClassVar[Grouped[int]] = Grouped("structure")
    is_certified: ClassVar[Grouped[bool]] = Grouped("structure")
    families: ClassVar[Grouped[tuple[Family, ...]]] = Grouped("closed_forms")
    directions: ClassVar[Grouped[tuple[NullDirection, ...]]] = Grouped("closed_forms")
    unknown_inputs: ClassVar[Grouped[tuple[str, ...]]] = Grouped("inputs")
    shared_inputs: ClassVar[Grouped[tuple[str, ...]]] = Grouped("inputs")
    eliminated: ClassVar[Grouped[tuple[str, ...]]] = Grouped("inputs")
    by_class: ClassVar[Grouped[Mapping[str, Answer]]] = Grouped("inputs")
    by_excitation: ClassVar[Grouped[Mapping[str, Answer]]] = Grouped("inputs")
    remedies: ClassVar[Grouped[Remedies | None]] = Grouped("remedy_analysis")
    replicas: ClassVar[Grouped[ReplicasNeeded | None]] = Grouped("remedy_analysis")
    practical: ClassVar[Grouped[Practical | None]] = Grouped("records")
    profiles: ClassVar[Grouped[Profiles | None]] = Grouped("records")
    excitations: ClassVar[Grouped[tuple[RecordExcitation, ...]]] = Grouped("records")
    seconds: ClassVar[Grouped[float]] = Grouped("provenance")
    versions: ClassVar[Grouped[Mapping[str, str]]] = Grouped("provenance")
    sources: ClassVar[Grouped[tuple[str, ...]]] = Grouped("provenance")

    mends = renamed("mends", "remedies")
    mend = renamed("mend", "remedy")
    told_instead = renamed("told_instead", "identifiable_combinations")

    # -- the verdict --------------------------------------------------------------------------

    @property
    def rank(self) -> int | None:
        """Rank of the extended observability matrix of all experiments."""
        return self.answer.rank

    @property
    def unknowns(self) -> int | None:
        """Parameters and initial states."""
        return self.answer.unknowns

    @property
    def parameters(self) -> Mapping[str, Verdict]:
        """Parameter -> verdict."""
        return self.answer.parameters

    @property
    def states(self) -> Mapping[str, StateVerdict]:
        """State -> verdict; ``state@experiment`` where there are several."""
        return self.answer.states

    @property
    def is_identifiable(self) -> bool:
        """True if every parameter is identifiable."""
        return all(v == "identifiable" for v in self.parameters.values())

    @property
    def unexcited(self) -> tuple[str, ...]:
        """Parameters identifiable only where an eliminated input acts, if it acts in no record.

        The channel that it was eliminated with may move all the same, as a function of the states
        (Linder 2017, section 7.3.1).
        """
        references = [r for e in self.excitations for r in e.references]
        if not references or any(r.is_exciting for r in references):
            return ()
        without = [v for k, v in self.by_excitation.items() if k.endswith(ELIMINATED_ZERO)]
        return tuple(dict.fromkeys(p for v in without for p in v.not_identifiable))

    @property
    def sentence(self) -> str:
        """The answer in a sentence."""
        lost = self.answer.not_identifiable
        unsure = [p for p, v in self.parameters.items() if v == "unknown"]
        if not self.parameters:
            return "The model has no unknown parameters."
        if unsure:
            proven = len(self.parameters) - len(unsure)
            return (
                f"Time ran out: {proven} of {len(self.parameters)} parameters "
                f"{are(proven)} proven identifiable, {shortened(unsure)} {are(len(unsure))} "
                "undecided."
            )
        if not lost:
            if len(self.parameters) == 1:
                return f"{next(iter(self.parameters))} is identifiable."
            every = f"All {len(self.parameters)}" if len(self.parameters) > 2 else "Both"
            return f"{every} parameters are identifiable."
        kept = len(self.parameters) - len(lost)
        return (
            f"{kept} of {len(self.parameters)} parameters {are(kept)} identifiable; "
            f"{shortened(lost)} {are(len(lost))} structurally unidentifiable."
        )

    @property
    def identifiable_combinations(self) -> tuple[IdentifiableCombinations, ...]:
        """By confounded group, its identifiable combinations, where a closed form was found."""
        if not self.families or self.fixing is None:
            return ()
        from casid.identifiability.combinations.closed_form import identifiable_combinations

        return identifiable_combinations(self.families, self.fixing)

    @property
    def combinations(self) -> tuple[str, ...]:
        """The families of equivalent parameters as text, one each."""
        return tuple(str(f) for f in self.families)

    @property
    def certainty(self) -> str:
        """How certain the answer is, and why."""
        a = self.answer
        if a.is_partial:
            return "Partial: time ran out. What is called identifiable is proven, the rest not."
        if a.error_bound == 0.0:
            return "Proven: full rank at one point modulo one prime."
        sure = (
            f"Exact rank at {self.points} random points modulo primes of their own; the "
            f"probability of an error is below {a.error_bound:.1e}."
        )
        if not self.is_certified:
            sure += (
                " At the special values given, derivatives beyond order "
                f"{max(self.orders, default=0)} were not computed and might raise the rank."
            )
        return sure

    def remedy(self) -> str:
        """What would make all parameters identifiable, in a sentence; empty where they are."""
        if self.is_identifiable or self.fixing is None:
            return ""
        parts = []
        alone: list[str] = []
        for group, size in zip(self.fixing.groups, self.fixing.group_sizes, strict=True):
            if len(group) == size:
                alone += group
            else:
                count = "any one" if size == 1 else f"{size}"
                exact = math.comb(len(group), size) == _ways(self.fixing, group)
                suffix = "" if exact else " (not every choice; see the fixing sets)"
                parts.append(f"give {count} of {', '.join(group)} a known value{suffix}")
        if alone:
            parts.append(f"give {listed(alone)} a known value, or measure what {_acts(alone)}")
        return "; ".join(parts)

    # -- showing ------------------------------------------------------------------------------

    def __repr__(self) -> str:
        return f"<Assessment of {self.name}: rank {self.rank} of {self.unknowns}>"

    def plot(self) -> Any:
        """Plotly figures by name: errors, correlations, profiles, as far as they were computed."""
        return present(self, "figures")

    def to_json(self) -> dict[str, Any]:
        """The fields as ``casid identifiability --json`` prints them."""
        a, f = self.answer, self.fixing
        classes = {k: v.to_json() for k, v in self.by_class.items()}
        return {
            "schema": SCHEMA,
            "problem": self.name,
            "experiments": list(self.experiments),
            "rank": a.rank,
            "unknowns": a.unknowns,
            "error_bound": finite_or_none(a.error_bound),
            "partial": a.is_partial,
            "certified": self.is_certified,
            "parameters": dict(a.parameters),
            "states": dict(a.states),
            "deficiency": a.deficiency,
            "confounded_groups": [list(g) for g in self.confounded_groups],
            "minimal_fixing_sets": [list(s) for s in f.sets] if f is not None and f.size else [],
            "minimal_fixing_sets_count": f.count if f is not None and f.size else 0,
            "minimal_fixing_sets_cut": self.fixing.is_cut if self.fixing else False,
            "exclusions": [
                {"size": e.size, "total": e.total, "not_identifiable": e.count}
                for e in self.exclusions
            ],
            "families": [_family(m) for m in self.families],
            "told_instead": [t.to_json() for t in self.identifiable_combinations],
            "directions": [_direction(d) for d in self.directions],
            "unknown_inputs": {
                "class": "arbitrary" if self.unknown_inputs else "none",
                "names": list(self.unknown_inputs),
                "shared": list(self.shared_inputs),
                "eliminated": list(self.eliminated),
                "verdict_by_class": classes,
            },
            "verdict_by_excitation": {k: v.to_json() for k, v in self.by_excitation.items()},
            "excitation": [e.to_json() for e in self.excitations],
            "orders": list(self.orders),
            "points": self.points,
            "mends": self.remedies.to_json() if self.remedies else None,
            "replicas": self.replicas.to_json() if self.replicas else None,
            "practical": self.practical.to_json() if self.practical else None,
            "profiles": self.profiles.to_json() if self.profiles else None,
            "advice": self.remedy(),
            "notes": list(self.notes),
            "seconds": self.seconds,
            "versions": dict(self.versions),
            "sources": list(self.sources),
        }

    def write(self, folder: str | Path) -> Path:
        """Write `identifiability.json` and `report.html`; returns the report's path."""
        return write(self, folder)


def _family(family: Family) -> dict[str, Any]:
    return {
        "free": family.free,
        "formulas": {n: str(v) for n, v in family.formulas.items()},
        "invariants": [str(v) for v in family.invariants],
        "unchanged": list(family.unchanged),
        "unsolved": list(family.unsolved),
        "unchanged_where": {n: [str(v) for v in f] for n, f in family.unchanged_where.items()},
    }


def _direction(direction: NullDirection) -> dict[str, Any]:
    return {
        "free": direction.free,
        "moves": {
            n: None if v is None else str(v)
            for n, v in direction.entries.items()
            if v is None or v != 0
        },
    }


def _acts(names: Sequence[str]) -> str:
    return "it acts on" if len(names) == 1 else "they act on"


def _ways(fixing: FixingSets, group: tuple[str, ...]) -> int:
    return fixing.group_counts[fixing.groups.index(group)]
