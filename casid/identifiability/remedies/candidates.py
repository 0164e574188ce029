"""Candidates to be added to experiments: a sensor, another experiment, a known value."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca

from casid.errors import IdentifiabilityError, ModelError, nearest
from casid.identifiability.equations.system import System
from casid.model.expressions import names as names_in
from casid.model.expressions import parse

Expr = Any  # a CasADi SX expression
Kind = Literal["sensor", "experiment", "known parameter", "known initial state"]


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One possible addition and its cost; made by the functions of this module.

    Attributes
    ----------
    label : name of the output, experiment, parameter or state.
    cost : in any unit, the same for all candidates.
    formula : of a sensor, as text or as an SX expression of symbols named as the system's.
    systems : of an experiment, the equations of each of its records; empty for a replica.
    experiments : names of those that get the sensor or the known initial state, or are repeated;
        none means all.
    """

    kind: Kind
    label: str
    cost: float = 1.0
    formula: Expr | str = ""
    systems: tuple[System, ...] = ()
    experiments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not (math.isfinite(self.cost) and self.cost >= 0):
            raise IdentifiabilityError(f"{self} costs {self.cost!r}; give a number >= 0")

    def __repr__(self) -> str:
        return f"<Candidate {self.kind} {self.label}: cost {self.cost:g}>"

    def __str__(self) -> str:
        return f"{self.kind} {self.label}"

    def concerns(self, system: System) -> bool:
        """True if this candidate applies to that experiment."""
        return not self.experiments or system.name in self.experiments


def sensor(
    name: str, formula: str | Expr, cost: float = 1.0, *, experiments: Sequence[str] = ()
) -> Candidate:
    """One more output, in every experiment that has the symbols of its formula (or in those named).

    Parameters
    ----------
    name : of the output.
    formula : such as ``"z_s*phidd + g*sin(phi)"``, read by `casid.model.expressions.parse` with the
        system's symbols, or an SX expression of symbols of the same names.
    cost : as in `replica`.
    experiments : those that have it; default all with its symbols.
    """
    return Candidate("sensor", name, cost, formula=formula, experiments=tuple(experiments))


def experiment(label: str, *systems: System, cost: float = 1.0) -> Candidate:
    """One more experiment: another load case with the same parameters by name."""
    if not systems:
        raise IdentifiabilityError(f"experiment {label!r} has no equations; give its System")
    return Candidate("experiment", label, cost, systems=systems)


def replica(*experiments: str, cost: float = 1.0) -> Candidate:
    """A repetition of the named experiments (all), with own initial states and known inputs.

    `cost` is in any unit that all candidates share; remedies are sought by their sum.
    """
    label = "replica" + (f" of {', '.join(experiments)}" if experiments else "")
    return Candidate("experiment", label, cost, experiments=experiments)


def known_parameter(name: str, cost: float = 1.0) -> Candidate:
    """The parameter `name` is measured otherwise: a known constant in all experiments.

    `cost` as in `replica`.
    """
    return Candidate("known parameter", name, cost)


def known_initial_state(
    state: str, cost: float = 1.0, *, experiments: Sequence[str] = ()
) -> Candidate:
    """The state's initial value is known, in every experiment that has it (or in those named).

    `cost` as in `replica`.

    Parameters
    ----------
    experiments : those in which it is known; default all that have it.
    """
    return Candidate("known initial state", state, cost, experiments=tuple(experiments))


def check(candidates: Sequence[Candidate], systems: Sequence[System]) -> None:
    """Refuse candidates that fit none of the systems, or that are given twice.

    Raises
    ------
    IdentifiabilityError, ModelError
        With the name that is not there and the nearest one that is.
    """
    labels = [str(c) for c in candidates]
    for c in candidates:
        if labels.count(str(c)) > 1:
            raise IdentifiabilityError(f"{c} is given twice; give each candidate its own label")
        known = [s.name for s in systems]
        for n in c.experiments:
            if n not in known:
                raise IdentifiabilityError(f"{c}: there is no experiment {n!r}{nearest(n, known)}")
        own = [s for s in systems if c.concerns(s)]
        if c.kind == "sensor":
            # Where it fits none, the first says which symbol is not there.
            for s in [s for s in own if can_mount(c, s)] or own[:1]:
                with_sensor(s, c)
        fields = {"known parameter": "parameters", "known initial state": "states"}
        if c.kind in fields:
            there = dict.fromkeys(n for s in own for n in getattr(s, fields[c.kind]))
            if c.label not in there:
                raise IdentifiabilityError(f"{c}: there is no such name{nearest(c.label, there)}")


def can_mount(candidate: Candidate, system: System) -> bool:
    """True if the sensor belongs to this experiment, which has all symbols of its formula."""
    formula = candidate.formula
    if isinstance(formula, str):
        needed = names_in(formula, where=str(candidate))
    else:
        needed = tuple(s.name() for s in ca.symvar(ca.SX(formula)))
    return candidate.concerns(system) and all(n in system.symbols for n in needed)


def with_sensor(system: System, candidate: Candidate) -> System:
    """The system with one more output.

    Raises
    ------
    ModelError
        If the formula cannot be read or needs what the system has not, or the output is there.
    """
    if candidate.label in system.outputs:
        raise ModelError(f"{system.name} has an output {candidate.label!r}; rename the sensor")
    return system.where(
        outputs=(*system.outputs, candidate.label),
        h=ca.vertcat(system.h, _expression(system, candidate)),
    )


def _expression(system: System, candidate: Candidate) -> Expr:
    """The sensor's formula in the system's own symbols."""
    where = f"{system.name}, {candidate}"
    if isinstance(candidate.formula, str):
        return parse(candidate.formula, system.symbols, where=where)
    formula = ca.SX(candidate.formula)
    if formula.shape != (1, 1):
        raise ModelError(f"{where}: a formula of shape {formula.shape}; give one sensor for each")
    foreign = ca.symvar(formula)
    for s in foreign:
        if s.name() not in system.symbols:
            raise ModelError(
                f"{where}: {s.name()!r} is not declared{nearest(s.name(), system.symbols)}"
            )
    own = [system.symbols[s.name()] for s in foreign]
    return ca.substitute([formula], foreign, own)[0] if foreign else formula
