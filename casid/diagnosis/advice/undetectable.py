"""Causes that are undetectable in a set-up or a record, and why.

An effect whose signature lies in the baseline's tangent space is absorbed: parameters and initial
states change a little, and the simulation is what it was. That has one of two reasons. Either no
record of these channels can show the effect, whatever moves: the parameter that it adds is not
identifiable in the extended model, which is tested exactly (Sedoglavic 2002; Linder 2017, section
2.7). Or another record could show it, and this one does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from casid.data.experiment import Experiment
from casid.data.files import plain_fields
from casid.deprecation import renamed
from casid.diagnosis.evidence.scores.score_tests import ScoreTable
from casid.diagnosis.thresholds import PLANNING, SCORES
from casid.errors import CasidError
from casid.identifiability.combinations.closed_form import families, joint_invariants
from casid.identifiability.combinations.fixing_sets import confounded_groups, fixing_sets
from casid.identifiability.equations.model_system import translated
from casid.identifiability.rank.observability import observability
from casid.identifiability.rank.rank_result import Observability
from casid.identifiability.requirement import word
from casid.model.effects.effect import Effect
from casid.model.effects.names import effect_words, law_of, place_words
from casid.model.model import Model
from casid.model.quantities import listed
from casid.time_limit import wall_clock

Reason = Literal["structural", "practical", "practical (structure not checked)"]


@dataclass(frozen=True, slots=True)
class Undetectable:
    """One undetectable cause.

    Attributes
    ----------
    reason : "structural", where no record of these channels shows it; "practical", where another
        record could; the latter not tested structurally, where the effect has no exact algebra
        (delays, clipping, generated signals) or the rank was not found in time.
    visible : share of the signature outside the baseline's tangent space, of this record.
    absorbed_by : parameters, and initial states as ``phi(0)``, that absorb the effect (structural
        ones alone).
    identifiable : identifiable combinations of them, where a closed form was found in time.
    remedy : how to make the cause detectable.
    law : that it is called by (`law_of`).
    """

    kind: str
    where: str
    reason: Reason
    visible: float
    absorbed_by: tuple[str, ...] = ()
    identifiable: tuple[str, ...] = ()
    why: str = ""
    remedy: str = ""
    law: str = ""

    told = renamed("told", "identifiable")
    mend = renamed("mend", "remedy")

    @property
    def is_structural(self) -> bool:
        """True if no record of these channels shows the cause."""
        return self.reason == "structural"

    @property
    def words(self) -> str:
        """The cause as an engineer says it, with what it would pass for where that is known."""
        words = effect_words(self.kind, self.where, description=self.law)
        if not self.absorbed_by:
            return words
        one = len(self.absorbed_by) == 1
        return (
            f"{words} (would look like {'another' if one else 'other values of'} "
            f"{listed(self.absorbed_by)})"
        )

    def to_json(self) -> dict[str, Any]:
        """Part of `diagnosis.json`."""
        return plain_fields(self, identifiable="told", remedy="mend")

    def __str__(self) -> str:
        words = effect_words(self.kind, self.where, description=self.law)
        return f"{words}: {self.reason}. {self.why} {self.remedy}"


def undetectable_effects(
    table: ScoreTable,
    model: Model,
    experiments: Sequence[Experiment],
    *,
    threshold: float = SCORES.undetectable,
) -> tuple[Undetectable, ...]:
    """Causes of the table that are absorbed in every variant, structural ones first.

    Parameters
    ----------
    table : of `score_test`.
    model : the baseline that the table's effects extend, without unknown inputs.
    experiments : those of the table; their load cases say what is known.
    threshold : share of a signature below which it counts as absorbed.
    """
    absorbed = absorbed_effects(table, model, threshold=threshold)
    if not absorbed:
        return ()
    tested = _RankTests(model, experiments)
    found = [tested.about(effect, visible) for visible, effect in absorbed]
    return tuple(sorted(found, key=lambda i: (not i.is_structural, i.kind, i.where)))


def absorbed_effects(
    table: ScoreTable, model: Model, *, threshold: float = SCORES.undetectable
) -> list[tuple[float, Effect]]:
    """Causes of the table that are absorbed in every variant, with the visible share of each.

    A gain that errs from the sensor's zero is another cause than one that errs about the mean,
    which is a bias to first order: where both are tested, the former counts.
    """
    kind = "sensor_scale"
    from_zero = {s.effect.key for s in table.scores if "about" not in s.effect.constants}
    largest: dict[tuple[str, str], tuple[float, Effect]] = {}
    for s in table.scores:
        key, constants = s.effect.key, s.effect.constants
        if s.effect.kind == kind and "about" in constants and key in from_zero:
            continue
        if key not in largest or s.visible > largest[key][0]:
            largest[key] = s.visible, s.effect
    # The gain of a known input is what the user says that it is, unless a record denies it.
    exact = {(kind, n) for n, u in model.inputs.items() if u.kind == "known"}
    return [(v, e) for v, e in largest.values() if v <= threshold and e.key not in exact]


class _RankTests:
    """Ranks of extended models, with the baseline's own computed once."""

    def __init__(self, model: Model, experiments: Sequence[Experiment]) -> None:
        self.model = model
        self.experiments = [replace(e, name=word(e.name)) for e in experiments]
        self.formulas = PLANNING.formula_limit
        base = self._rank(model)
        self.unobservable = set() if base is None else _unobservable(base)

    def about(self, effect: Effect, visible: float) -> Undetectable:
        new, names = effect.extended(self.model)
        found = self._rank(new) if self._has_exact_algebra(effect, new) else None
        share = f"{100 * (1 - visible):.4g} % of its effect on the outputs"
        if found is None or found.identifiable.get(names[0], True):
            reason: Reason = "practical" if found else "practical (structure not checked)"
            return Undetectable(
                effect.kind,
                effect.key[1],
                reason,
                visible,
                why=f"In this record the model's own parameters and initial state reproduce {share}"
                + ("; a more informative record would show it." if found else "."),
                remedy=practical_remedy(effect, self.model, self.experiments),
                law=law_of(effect.kind, effect.description),
            )
        point = found.points[0]
        groups = confounded_groups(point.information, found.parameters, point.prime)
        with_it = next((g for g in groups if names[0] in g), names[:1])
        parameters = tuple(n for n in with_it if n not in names)
        states = tuple(sorted(_unobservable(found) - self.unobservable))
        combinations = self._combinations(new, found, with_it) if parameters else ()
        return Undetectable(
            effect.kind,
            effect.key[1],
            "structural",
            visible,
            absorbed_by=(*parameters, *states),
            identifiable=combinations,
            why=_structural_why(parameters, states, combinations),
            remedy=_structural_remedy(effect, self.model, parameters, states),
            law=law_of(effect.kind, effect.description),
        )

    def _has_exact_algebra(self, effect: Effect, new: Model) -> bool:
        """False where the effect acts through a stage or a generated signal of a shape of its own.

        A system takes every input for any signal at all, and a step is not.
        """
        generated = [n for n, u in new.inputs.items() if u.kind == "generated"]
        return (
            effect.test == "score"
            and new.stages == self.model.stages
            and all(n in self.model.inputs for n in generated)
        )

    def _rank(self, model: Model) -> Observability | None:
        """The observability rank; None if not found in time, or if equations cannot be read."""
        try:
            systems = translated(model, self.experiments, use_samples=False).systems
            found = observability(systems, time_limit=PLANNING.rank_limit, error_bound=1e-9)
        except CasidError:
            return None
        return None if found.is_partial else found

    def _combinations(
        self, model: Model, found: Observability, group: Sequence[str]
    ) -> tuple[str, ...]:
        """Identifiable combinations of the group, as formulas, while there is time for them."""
        if self.formulas <= 0:
            return ()
        started = wall_clock()
        try:
            point = found.points[0]
            fixing = fixing_sets(point.information, found.parameters, point.prime, limit=20)
            systems = translated(model, self.experiments, generic=True, use_samples=False).systems
            curves = families(systems, fixing, time_limit=self.formulas)[0]
            invariants = joint_invariants([f for f in curves if f.free in group])[0]
        except CasidError:
            invariants = ()
        self.formulas -= wall_clock() - started
        return tuple(str(t) for t in invariants)


def _unobservable(found: Observability) -> set[str]:
    """Initial states that are unobservable from the outputs, of any experiment."""
    several = len(found.systems) > 1
    return {
        f"{x}(0)@{s.name}" if several else f"{x}(0)"
        for s, seen in zip(found.systems, found.observable, strict=True)
        for x, is_seen in seen.items()
        if not is_seen
    }


def _structural_why(
    parameters: Sequence[str], states: Sequence[str], combinations: Sequence[str]
) -> str:
    both = [*parameters, *states]
    if not both:
        return "It does not affect any output, whatever is recorded."
    text = (
        f"Whatever is recorded, a change of {listed(both)} gives the same outputs"
        if len(both) == 1
        else f"Whatever is recorded, changes of {listed(both)} together give the same outputs"
    )
    if combinations:
        text += f"; identifiable all the same: {', '.join(combinations)}"
    return text + "."


def _measured(effect: Effect, model: Model) -> str:
    """The quantity that a sensor of the effect itself would measure."""
    if effect.where in model.balances:
        return f"what acts in the {effect.where} balance"
    return f"the {place_words(effect.where).removeprefix('the ')}"


def _structural_remedy(
    effect: Effect, model: Model, parameters: Sequence[str], states: Sequence[str]
) -> str:
    own = (
        f"calibrate {effect.where} independently of these records"
        if effect.kind.startswith("sensor") or effect.kind == "cross_axis"
        else f"measure {_measured(effect, model)} itself"
    )
    if parameters:
        one = parameters[0] if len(parameters) == 1 else f"one of {', '.join(parameters)}"
        return f"Give {one} a known value, or {own}."
    if states:
        first = states[0].partition("(")[0]
        return f"Add a sensor of {first}, make its initial value known, or {own}."
    return f"Add a sensor that responds to it, or {own}."


def practical_remedy(effect: Effect, model: Model, experiments: Sequence[Experiment]) -> str:
    """How to make an effect detectable that these records do not show, or an empty text."""
    channel = effect.where.rpartition("~")[2]
    resting = [
        e.name
        for e in experiments
        if channel in e.record.channels and float(e.record[channel].std()) == 0.0
    ]
    if resting:
        return f"Record {channel} while it moves: it is constant in {', '.join(resting)}."
    if effect.kind == "rectified":
        return f"Record {channel} while it passes through zero, where it can."
    how = "excite the system over a wider band, or add a sensor" if model.inputs else "add a sensor"
    return f"{how[0].upper()}{how[1:]}."
