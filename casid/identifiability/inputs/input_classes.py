"""Classes of inputs: arbitrary, polynomial, harmonic, of an exosystem, zero.

The class of an unknown input decides what is identifiable, so it is always stated. A class of
smooth signals is a system of its own whose output is the input (an exosystem): it is appended to
the states, with unknown initial values for an unknown input, and with known ones for a known input
of that kind. Arbitrary signals: `elimination`.

    polynomial of degree k      w_0' = w_1, ..., w_k' = 0,                 w = w_0
    harmonic                    w_0' = w_1, w_1' = -w_omega^2 w_0,         w = w_0
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from types import MappingProxyType
from typing import Any

import casadi as ca

from casid.errors import ModelError, nearest
from casid.identifiability.equations.system import System
from casid.identifiability.equations.zeros import with_zeros
from casid.identifiability.inputs.signals import differentiated, free_name
from casid.model.expressions import parse

Expr = Any  # a CasADi SX expression

InputClass = str | tuple[str, int] | float
"""``"generic"``, ``"zero"``, ``"constant"``, ``"ramp"``, ``("polynomial", k)``, ``"harmonic"``, or
a number that the input always has."""

MAX_DEGREE = 50


@dataclass(frozen=True, slots=True, eq=False)
class Exosystem:
    """A source of inputs: dz/dt = s(z, ...), inputs = q(z, ...).

    Attributes
    ----------
    equations : exosystem's state -> its time derivative; may be empty, for an input that is a
        function of the system's states (a controller without memory).
    inputs : input -> formula of what it is.
    known_initial : exosystem's states whose initial value is known (generic).
    symbols : name -> SX symbol of the exosystem's states, if formulas are SX and not text.

    Formulas may hold the exosystem's states and all that the system declares, but not the inputs
    that are replaced. Text is read by `casid.model.expressions.parse`.

    Example
    -------
    >>> import casid
    >>> sea = casid.Exosystem({"a": "b", "b": "-r*a"}, {"w": "a"})   # r: a parameter of the system
    """

    equations: Mapping[str, Any]
    inputs: Mapping[str, Any]
    known_initial: tuple[str, ...] = ()
    symbols: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("equations", "inputs", "symbols"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        for z in self.known_initial:
            if z not in self.equations:
                raise ModelError(
                    f"exosystem: known initial value of {z!r}: no such state"
                    f"{nearest(z, self.equations)}"
                )


def as_exosystem(system: System, exosystem: Exosystem) -> System:
    """The system with the exosystem's states appended, driven by them.

    Inputs may be unknown or known ones; derivatives of a known input that occur in the equations
    become the derivatives of its formula.

    Raises
    ------
    ModelError
        If an input or a name in a formula is not there, or a state's name is taken.
    """
    for w in exosystem.inputs:
        known = (*system.unknown_inputs, *system.inputs)
        if w not in known:
            raise ModelError(f"{system.name} has no input {w!r}{nearest(w, known)}")
    for z in exosystem.equations:
        if z in system.declared:
            raise ModelError(
                f"{system.name}: the exosystem's state {z!r} is declared already; rename it"
            )
    new = {z: exosystem.symbols.get(z, ca.SX.sym(z)) for z in exosystem.equations}
    replaced = _with_derivatives(system, exosystem.inputs)
    symbols = {n: s for n, s in system.symbols.items() if n not in replaced} | new

    def read(formula: Any, name: str) -> Expr:
        if isinstance(formula, str):
            return ca.SX(parse(formula, symbols, where=f"{system.name}, exosystem, {name}"))
        return ca.SX(formula)

    rates = [read(e, z) for z, e in exosystem.equations.items()]
    values = {w: read(e, w) for w, e in exosystem.inputs.items()}
    larger = system.where(
        states=(*system.states, *new),
        f=ca.vertcat(system.f, *rates),
        symbols={**system.symbols, **new},
        known_initial=(*system.known_initial, *exosystem.known_initial),
    )
    larger, slopes = _derivatives(larger, values)
    return larger.substituted({**values, **slopes})


def _with_derivatives(system: System, inputs: Mapping[str, Any]) -> dict[str, tuple[str, int]]:
    """Symbols of these inputs and of their derivatives -> (input, order)."""
    derived = {n: d for n, d in system.input_derivatives.items() if d[0] in inputs}
    return {w: (w, 0) for w in inputs} | derived


def _derivatives(system: System, values: Mapping[str, Expr]) -> tuple[System, dict[str, Expr]]:
    """Expressions for the derivatives of the replaced inputs that occur in the equations."""
    replaced = _with_derivatives(system, values)
    slopes: dict[str, Expr] = {}
    for name, (source, order) in replaced.items():
        value = values[source]
        for _ in range(order):
            system, value = differentiated(system, value)
        stray = {s.name() for s in ca.symvar(value)} & set(_with_derivatives(system, values))
        if stray:
            raise ModelError(
                f"{system.name}: {source} or its derivative is a formula of {sorted(stray)[0]}, an "
                "input that is itself replaced: an algebraic loop; solve it for the inputs first"
            )
        if order:
            slopes[name] = value
    return system, slopes


def as_polynomial(system: System, degree: int, inputs: Sequence[str] | None = None) -> System:
    """Unknown inputs are polynomials of this degree in time, degree + 1 unknown numbers each.

    Parameters
    ----------
    inputs : names; by default all unknown inputs.
    """
    for w in _named(system, inputs):
        system = as_exosystem(system, _polynomial(system, w, degree, known=False))
    return system


def as_harmonic(
    system: System, inputs: Sequence[str] | None = None, *, is_frequency_known: bool = False
) -> System:
    """Unknown inputs are sinusoids of unknown amplitude and phase, each with its own frequency.

    The frequency is the state ``<input>_omega`` with the derivative zero, so it counts among the
    unknowns but not among the parameters.
    """
    for w in _named(system, inputs):
        known = (2,) if is_frequency_known else ()
        system = as_exosystem(system, _harmonic(system, w, known=known))
    return system


def as_zero(system: System, inputs: Sequence[str] | None = None) -> System:
    """Unknown inputs are zero."""
    return with_zeros(system, _named(system, inputs))


def with_input_class(system: System, classes: Mapping[str, InputClass]) -> System:
    """Known inputs of a class: a constant, a ramp, a sinusoid, zero.

    Parameters
    ----------
    classes : known input -> its class (`InputClass`). ``"generic"`` leaves it unchanged: a
        signal with as many independent derivatives as are needed. Numbers in a class (level, slope,
        amplitude, frequency) are generic, and each experiment has its own.

    Raises
    ------
    ModelError
        If a name is no known input, or a class is not known.
    """
    for u, kind in classes.items():
        if u not in system.inputs:
            hint = (
                "; it is an unknown input, use as_polynomial, as_harmonic, as_exosystem or as_zero"
                if u in system.unknown_inputs
                else nearest(u, system.inputs)
            )
            raise ModelError(f"{system.name} has no known input {u!r}{hint}")
        system = _of_class(system, u, kind)
    return system


def _of_class(system: System, u: str, kind: Any) -> System:
    if kind == "generic":
        return system
    if kind == "zero" or isinstance(kind, Real):
        level = 0.0 if isinstance(kind, str) else float(kind)
        zeros = [n for n in _with_derivatives(system, {u: None}) if n != u or level == 0.0]
        return with_zeros(system.substituted({} if u in zeros else {u: level}), zeros)
    if kind == "harmonic":
        return as_exosystem(system, _harmonic(system, u, known=(0, 1, 2)))
    degree = {"constant": 0, "ramp": 1}.get(kind) if isinstance(kind, str) else None
    if isinstance(kind, (tuple, list)) and len(kind) == 2 and kind[0] == "polynomial":
        degree = kind[1]
    if degree is None:
        raise ModelError(
            f"{system.name}: input {u}: class {kind!r} is not known; use 'generic', 'zero', "
            "'constant', 'ramp', ('polynomial', degree), 'harmonic' or a number"
        )
    return as_exosystem(system, _polynomial(system, u, degree, known=True))


def _polynomial(system: System, w: str, degree: Any, *, known: bool) -> Exosystem:
    if isinstance(degree, bool) or not isinstance(degree, int) or not 0 <= degree <= MAX_DEGREE:
        raise ModelError(
            f"{system.name}: input {w}: degree {degree!r} of a polynomial; it is a whole number "
            f"from 0 (a constant) to {MAX_DEGREE}"
        )
    z = _free_names(system, [f"{w}_{i}" for i in range(degree + 1)])
    rates = dict(zip(z, [*z[1:], "0"], strict=True))
    return Exosystem(rates, {w: z[0]}, known_initial=tuple(z) if known else ())


def _harmonic(system: System, w: str, *, known: Sequence[int]) -> Exosystem:
    """`known` : which of displacement, slope and frequency are known at the start."""
    z, slope, omega = names = _free_names(system, [f"{w}_0", f"{w}_1", f"{w}_omega"])
    rates = {z: slope, slope: f"-{omega}^2*{z}", omega: "0"}
    return Exosystem(rates, {w: z}, known_initial=tuple(names[i] for i in known))


def _free_names(system: System, wanted: Sequence[str]) -> list[str]:
    names: list[str] = []
    for n in wanted:
        names.append(free_name(system, n, *names, *wanted[len(names) + 1 :]))
    return names


def _named(system: System, inputs: Sequence[str] | None) -> tuple[str, ...]:
    if inputs is None:
        return system.unknown_inputs
    for w in inputs:
        if w not in system.unknown_inputs:
            hint = (
                "; it is a known input, use with_input_class"
                if w in system.inputs
                else nearest(w, system.unknown_inputs)
            )
            raise ModelError(f"{system.name} has no unknown input {w!r}{hint}")
    return tuple(inputs)
