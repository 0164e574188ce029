"""The equations of one experiment, in CasADi expressions.

    dx/dt = f(x, theta, c, u, w),   y = h(x, theta, c, u, w)                                    (1)

with unknown constants theta (the parameters), known constants c, known inputs u and unknown inputs
w. Unlike in a `Model`, start values, bounds and units have no meaning here, and a known constant
may be a number or "some number" (generic).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from types import MappingProxyType
from typing import Any

import casadi as ca

from casid.errors import ModelError, nearest

Expr = Any  # a CasADi SX expression


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """One experiment's equations (1), as SX expressions of scalar symbols.

    Attributes
    ----------
    states, parameters, constants, inputs, unknown_inputs, outputs : names. `parameters` are
        unknown; `constants` are known numbers whose value does not matter (drawn at random).
    symbols : name -> (1, 1) SX symbol of every state, parameter, constant, input and unknown input,
        and of every name in `input_derivatives`.
    f : (nx, 1) right-hand sides in the order of `states`.
    h : (ny, 1) outputs in the order of `outputs`.
    input_derivatives : name of a symbol -> (input, order): that symbol is the order-th time
        derivative of the input.
    known_initial : states whose initial value is known, some generic number.
    initial_values : states whose initial value is known and is this number, which may be special.
    at : parameters (and constants) with this value: the verdict holds at that point and not at
        almost every point.
    """

    name: str
    states: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    symbols: Mapping[str, Any]
    f: Expr
    h: Expr
    constants: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    unknown_inputs: tuple[str, ...] = ()
    input_derivatives: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    known_initial: tuple[str, ...] = ()
    initial_values: Mapping[str, Fraction] = field(default_factory=dict)
    at: Mapping[str, Fraction] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("f", "h"):
            column = ca.densify(ca.SX(getattr(self, name)))
            object.__setattr__(self, name, column if column.numel() else ca.SX(0, 1))
        for name in ("symbols", "input_derivatives", "initial_values", "at", "units"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        if self.f.shape != (len(self.states), 1) or self.h.shape != (len(self.outputs), 1):
            raise ModelError(
                f"{self.name}: {len(self.states)} states and {len(self.outputs)} outputs, but "
                f"right-hand sides {self.f.shape} and outputs {self.h.shape}"
            )
        declared = self.declared
        twice = [n for n in declared if declared.count(n) > 1]
        if twice:
            raise ModelError(f"{self.name}: {twice[0]!r} is declared twice; rename one of them")
        for kind, names, known in (
            ("known initial value of", self.known_initial, self.states),
            ("initial value of", self.initial_values, self.states),
            ("point of", self.at, (*self.parameters, *self.constants)),
        ):
            for n in names:
                if n not in known:
                    raise ModelError(f"{self.name}: {kind} {n!r}: no such name{nearest(n, known)}")
        inside = {s.name() for s in ca.symvar(ca.vertcat(self.f, self.h))}
        stray = sorted(inside - set(declared))
        if stray:
            raise ModelError(
                f"{self.name}: {stray[0]!r} occurs in the equations but is neither state, "
                f"parameter, constant nor input{nearest(stray[0], declared)}"
            )

    @property
    def declared(self) -> list[str]:
        """Names of all symbols, in the order of the program's arguments."""
        return [
            *self.states,
            *self.parameters,
            *self.constants,
            *self.inputs,
            *self.input_derivatives,
            *self.unknown_inputs,
        ]

    @property
    def is_generic(self) -> bool:
        """True if no initial value or parameter has a special value.

        The value of a known constant belongs to the equations: it restricts no unknown.
        """
        return not self.initial_values and not any(p in self.at for p in self.parameters)

    def where(self, **changes: Any) -> System:
        """A copy with some attributes replaced."""
        return replace(self, **changes)

    def substituted(self, values: Mapping[str, Expr | float | Fraction]) -> System:
        """A copy in which names are replaced by expressions or numbers, and no longer declared."""
        for n in values:
            if n not in self.symbols:
                raise ModelError(f"{self.name} has no {n!r}{nearest(n, self.symbols)}")
        old = [self.symbols[n] for n in values]
        new = [ca.SX(float(v)) if isinstance(v, Fraction) else ca.SX(v) for v in values.values()]
        f, h = ca.substitute([self.f, self.h], old, new) if old else (self.f, self.h)

        def kept(names: Sequence[str]) -> tuple[str, ...]:
            return tuple(n for n in names if n not in values)

        return replace(
            self,
            f=f,
            h=h,
            parameters=kept(self.parameters),
            constants=kept(self.constants),
            inputs=kept(self.inputs),
            unknown_inputs=kept(self.unknown_inputs),
            input_derivatives={k: v for k, v in self.input_derivatives.items() if k not in values},
            at={k: v for k, v in self.at.items() if k not in values},
            symbols={k: v for k, v in self.symbols.items() if k not in values},
        )

    def renamed(self, names: Mapping[str, str]) -> System:
        """A copy in which parameters or constants have other names, and other symbols with them."""
        names = {old: new for old, new in names.items() if old in self.symbols}

        def new(n: str) -> str:
            return names.get(n, n)

        symbols = {new(n): ca.SX.sym(new(n)) if n in names else s for n, s in self.symbols.items()}
        old = [self.symbols[n] for n in names]
        put = [symbols[new(n)] for n in names]
        f, h = ca.substitute([self.f, self.h], old, put) if old else (self.f, self.h)
        return replace(
            self,
            f=f,
            h=h,
            symbols=symbols,
            parameters=tuple(map(new, self.parameters)),
            constants=tuple(map(new, self.constants)),
            at={new(n): v for n, v in self.at.items()},
            units={new(n): u for n, u in self.units.items()},
        )

    def with_known(self, *names: str) -> System:
        """A copy in which the named parameters are known constants."""
        for n in names:
            if n not in self.parameters:
                raise ModelError(f"{self.name} has no parameter {n!r}{nearest(n, self.parameters)}")
        return replace(
            self,
            parameters=tuple(p for p in self.parameters if p not in names),
            constants=(*self.constants, *names),
        )

    def __repr__(self) -> str:
        return (
            f"<System {self.name}: {len(self.states)} states, {len(self.parameters)} parameters, "
            f"{len(self.outputs)} outputs, {len(self.inputs)} known and "
            f"{len(self.unknown_inputs)} unknown inputs>"
        )
