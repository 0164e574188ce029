"""Several experiments: replicas, experiments that share a signal, and the classes of their inputs.

A sequence of systems is a set of experiments: parameters and constants are shared by name, initial
states and inputs are each experiment's own. Two ships in two seas do not share a wave; two sensor
boxes on one ship do. Experiments that share a signal are merged into one system with one such
signal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca

from casid.errors import ModelError
from casid.identifiability.equations.system import System
from casid.identifiability.inputs.elimination import eliminate_unknown_inputs
from casid.identifiability.inputs.input_classes import as_harmonic, as_polynomial, as_zero
from casid.identifiability.inputs.signals import unused_name


def replicas(system: System, n: int) -> tuple[System, ...]:
    """The experiment n times: same parameters, own initial states, own inputs, known and unknown.

    Raises
    ------
    ModelError
        If n < 1.
    """
    if n < 1:
        raise ModelError(f"{system.name}: {n} replicas; an experiment is done once or more often")
    return (system,) * n  # one object: its equations are read once


def merge(systems: Sequence[System], *, shared: Sequence[str] = (), name: str = "") -> System:
    """Several experiments as one system, in which each named input occurs once.

    Parameters
    ----------
    systems : parameters and constants of one name are one, as in any set of experiments.
    shared : unknown or known inputs that are the same signal wherever the name occurs; all other
        inputs are each experiment's own.

    Returns
    -------
    System. The second experiment's states, own inputs and outputs have ``_2`` after their names,
    the third's ``_3``, and so on.

    Raises
    ------
    ModelError
        If a shared name is not an input of the same kind in two experiments at least; if a name is
        a parameter in one and a known constant in another, or has different points.
    """
    systems = tuple(systems)
    if not systems:
        raise ModelError("no experiment to merge; give at least one system")
    _check_shared(systems, shared)
    _check_kinds(systems)
    taken = {n for s in systems for n in (*s.declared, *s.outputs)}
    common: dict[str, Any] = {}
    parts: list[System] = []
    for i, s in enumerate(systems, start=1):
        names = _new_names(s, i, shared, taken, parts)
        new = _renamed(s, names, common)
        parts.append(new.where(outputs=_new_outputs(s, i, names, taken)))
    return System(
        name=name or " + ".join(dict.fromkeys(s.name for s in systems)),
        states=_all(p.states for p in parts),
        parameters=_all(p.parameters for p in parts),
        outputs=_all(p.outputs for p in parts),
        symbols=common,
        f=ca.vertcat(*[p.f for p in parts]),
        h=ca.vertcat(*[p.h for p in parts]),
        constants=_all(p.constants for p in parts),
        inputs=_all(p.inputs for p in parts),
        unknown_inputs=_all(p.unknown_inputs for p in parts),
        input_derivatives=_joined(p.input_derivatives for p in parts),
        known_initial=_all(p.known_initial for p in parts),
        initial_values=_joined(p.initial_values for p in parts),
        at=_joined(p.at for p in parts),
        units=_joined(p.units for p in parts),
    )


def systems_by_class(
    systems: System | Sequence[System],
    *,
    shared: Sequence[str] = (),
    degrees: Sequence[int] = (0, 1, 2),
) -> dict[str, tuple[System, ...]]:
    """The experiments for each class of unknown inputs, to compare their ranks.

    Parameters
    ----------
    shared : unknown inputs that are the same signal in all experiments; by default each experiment
        has its own.
    degrees : of the polynomials.

    Returns
    -------
    dict of class (``"arbitrary"``, ``"polynomial_0"``, ..., ``"harmonic"``, ``"zero"``) -> systems
    without unknown inputs.
    """
    given = (systems,) if isinstance(systems, System) else tuple(systems)
    if shared:
        given = (merge(given, shared=shared),)
    once = {id(s): s for s in given}  # replicas are one object, and stay one

    def each(made: Mapping[int, System]) -> tuple[System, ...]:
        return tuple(made[id(s)] for s in given)

    table = {"arbitrary": each({k: eliminate_unknown_inputs(s).system for k, s in once.items()})}
    for degree in degrees:
        made = {k: as_polynomial(s, degree) for k, s in once.items()}
        table[f"polynomial_{degree}"] = each(made)
    table["harmonic"] = each({k: as_harmonic(s) for k, s in once.items()})
    table["zero"] = each({k: as_zero(s) for k, s in once.items()})
    return table


def _check_shared(systems: Sequence[System], shared: Sequence[str]) -> None:
    for w in shared:
        unknown = [s.name for s in systems if w in s.unknown_inputs]
        known = [s.name for s in systems if w in s.inputs]
        if unknown and known:
            raise ModelError(
                f"{w!r} is to be shared, but is unknown in {unknown[0]} and known in {known[0]}; "
                "declare it alike in both"
            )
        if len(unknown) + len(known) < 2:
            inputs = _all((*s.unknown_inputs, *s.inputs) for s in systems)
            raise ModelError(
                f"{w!r} is to be shared, but fewer than two experiments have such an input; there "
                f"are {', '.join(inputs) or 'no inputs'}"
            )


def _check_kinds(systems: Sequence[System]) -> None:
    constants = {c: s.name for s in systems for c in s.constants}
    points: dict[str, Any] = {}
    for s in systems:
        for p in s.parameters:
            if p in constants:
                raise ModelError(
                    f"{p!r} is unknown in {s.name} and known in {constants[p]}, but parameters "
                    "are shared by name; use with_known in both, or rename one"
                )
        for p, value in s.at.items():
            if points.setdefault(p, value) != value:
                raise ModelError(
                    f"{p!r} has the point {points[p]} in one experiment and {value} in another; "
                    "give one value for all, or two names"
                )


def _new_names(
    system: System, number: int, shared: Sequence[str], taken: set[str], before: Sequence[System]
) -> dict[str, str]:
    """Old name -> new name of what is the experiment's own."""
    own = [*system.states, *system.inputs, *system.unknown_inputs]
    signals = {n: d for n, d in system.input_derivatives.items() if d[0] in shared}
    existing = {d: n for p in before for n, d in p.input_derivatives.items()}
    names = {n: existing[d] for n, d in signals.items() if d in existing}
    for n in [*own, *system.input_derivatives]:
        if n not in shared and n not in names:
            names[n] = n if number == 1 else _free(f"{n}_{number}", taken)
    return names


def _new_outputs(
    system: System, number: int, names: Mapping[str, str], taken: set[str]
) -> tuple[str, ...]:
    if number == 1:
        return system.outputs
    return tuple(names.get(y) or _free(f"{y}_{number}", taken) for y in system.outputs)


def _free(wanted: str, taken: set[str]) -> str:
    name = unused_name(wanted, taken)
    taken.add(name)
    return name


def _renamed(system: System, names: Mapping[str, str], common: dict[str, Any]) -> System:
    """The system under its new names, in the symbols of `common`, to which it adds its own."""

    def new(n: str) -> str:
        return names.get(n, n)

    old = list(system.declared)
    for n in old:
        common.setdefault(new(n), ca.SX.sym(new(n)))
    pairs = [system.symbols[n] for n in old], [common[new(n)] for n in old]
    f, h = ca.substitute([system.f, system.h], *pairs) if old else (system.f, system.h)
    return system.where(
        states=tuple(map(new, system.states)),
        symbols={new(n): common[new(n)] for n in old},
        f=f,
        h=h,
        inputs=tuple(map(new, system.inputs)),
        unknown_inputs=tuple(map(new, system.unknown_inputs)),
        input_derivatives={new(n): (new(u), k) for n, (u, k) in system.input_derivatives.items()},
        known_initial=tuple(map(new, system.known_initial)),
        initial_values={new(n): v for n, v in system.initial_values.items()},
        units={new(n): u for n, u in system.units.items()},
    )


def _all(groups: Any) -> tuple[str, ...]:
    return tuple(dict.fromkeys(n for group in groups for n in group))


def _joined(mappings: Any) -> dict[str, Any]:
    return {k: v for m in mappings for k, v in m.items()}
