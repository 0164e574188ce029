"""The structure algorithm: unknown inputs eliminated one by one with derivatives of outputs.

Rows are outputs. One without an unknown input in it is differentiated; one with an unknown input
whose coefficient does not vanish eliminates it. Where two rows depend on the same combination of
unknown inputs, the first eliminates it, the second is free of it then and is differentiated
further: derivatives of the first appear in it. `elimination` has the reason why that changes no
verdict.

Sources: R. M. Hirschorn, IEEE Trans. Automatic Control 24 (1979) 855-865; S. N. Singh, ibid. 26
(1981) 595-598.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import casadi as ca

from casid.algebra.vanishing import vanishing
from casid.errors import IdentifiabilityError, ModelError
from casid.identifiability.equations.system import System
from casid.identifiability.inputs.signals import (
    derivative_name,
    differentiated,
    free_name,
    reached_by_unknown_inputs,
)

Expr = Any  # a CasADi SX expression

MAX_NODES = 20_000
"""Derivatives larger than this are refused: the rank would take minutes (`input_derivatives`)."""


def written(output: str, order: int) -> str:
    """The derivative of an output as text: ``y1``, ``d y1/dt``, ``d^2 y1/dt^2``."""
    if order == 0:
        return output
    return f"d {output}/dt" if order == 1 else f"d^{order} {output}/dt^{order}"


@dataclass(slots=True)
class Row:
    """The first derivative of an output that contains an unknown input, or the last computed.

    `contains` : unknown input -> its coefficient, for those whose coefficient does not vanish;
    None until it is known.
    """

    output: str
    order: int
    expression: Expr
    contains: dict[str, Any] | None = None


class StructureAlgorithm:
    """The elimination in progress: the system so far, and the outputs not used up."""

    def __init__(self, system: System, using: dict[str, str]) -> None:
        self.original = self.system = system
        self.using = using
        self.rows = [Row(y, 0, system.h[i]) for i, y in enumerate(system.outputs)]
        self.names = {w: w for w in system.unknown_inputs}  # symbol now -> name in the beginning
        self.used: dict[str, tuple[str, int]] = {}
        self.solutions: dict[str, Any] = {}
        self.known_as: dict[str, tuple[str, int]] = {}  # input now -> derivative of which output
        self.replaced: list[str] = []  # outputs that are inputs now
        self.prolonged: list[str] = []
        self.notes: list[str] = []

    @property
    def remaining(self) -> tuple[str, ...]:
        """Unknown inputs that are not eliminated yet."""
        return self.system.unknown_inputs

    def run(self) -> tuple[str, ...]:
        """Eliminate all that act on outputs; returns the unknown inputs that act on none."""
        self.prolong()
        while self.remaining and self.rows:
            self.drop_rows_out_of_reach()
            pivot = self.pivot()
            if pivot is not None:
                self.eliminate(*pivot)
            elif not self.differentiate():
                break
        return self.finish()

    def prolong(self) -> None:
        """Make a state of an unknown input until all others enter linearly."""
        while (w := _most_nonlinear(self.system)) is not None:
            self.system, rate = _prolonged(self.system, w)
            self.names[rate] = self.names.pop(w)
            self.prolonged.append(w)
            self.notes.append(
                f"{w} enters nonlinearly: it is a state with unknown initial value, and its "
                f"derivative {rate} is the arbitrary signal"
            )

    def drop_rows_out_of_reach(self) -> None:
        """Drop outputs that no chain of equations connects with a remaining unknown input."""
        reached = reached_by_unknown_inputs(self.system)
        self.rows = [r for r in self.rows if reached & {s.name() for s in ca.symvar(r.expression)}]

    def pivot(self) -> tuple[Row, str] | None:
        """The simplest derivative with an unknown input in it, and which: lowest order first."""
        candidates = []
        for place, row in enumerate(self.rows):
            self._find_inputs(row)
            for w, b in (row.contains or {}).items():
                if self._is_allowed(row.output, w):
                    simple = 0 if b.is_constant() else ca.n_nodes(b)
                    candidates.append((row.order, simple, place, row, w))
        if not candidates:
            return None
        candidates.sort(key=lambda c: c[:3])
        for *_, row, w in candidates:
            assert row.contains is not None
            if self._is_regular(row.contains[w]):
                return row, w
        *_, row, w = candidates[0]
        values = ", ".join(f"{k}(0) = {v}" for k, v in self.system.initial_values.items())
        raise IdentifiabilityError(
            f"{self.system.name}: {self.names[w]} is eliminated with "
            f"{written(row.output, row.order)}, where its coefficient is zero at {values}; leave "
            "that initial value unknown (or generic, in known_initial), or give the unknown input "
            "a class, as_polynomial(system, degree)"
        )

    def _find_inputs(self, row: Row) -> None:
        """Find the unknown inputs in a row; strike out those whose coefficient vanishes."""
        if row.contains is not None:
            return
        inside = {s.name() for s in ca.symvar(row.expression)}
        there = [w for w in self.remaining if w in inside]
        coefficients = [ca.jacobian(row.expression, self.system.symbols[w]) for w in there]
        zero = vanishing(coefficients, at=self.system.at)
        row.contains = {}
        for w, b, is_zero in zip(there, coefficients, zero, strict=True):
            if is_zero:
                row.expression = ca.substitute(row.expression, self.system.symbols[w], 0)
            else:
                row.contains[w] = ca.SX(b)

    def _is_allowed(self, output: str, w: str) -> bool:
        name = self.names[w]
        if name in self.using:
            return self.using[name] == output
        return output not in self.using.values()

    def _is_regular(self, coefficient: Expr) -> bool:
        """True if the coefficient is not zero at the initial values that were given."""
        if not self.system.initial_values:
            return True
        try:
            held: dict[str, Fraction] = {**self.system.at, **self.system.initial_values}
            return not vanishing([coefficient], at=held)[0]
        except ModelError:
            return False

    def differentiate(self) -> bool:
        """One more derivative of the least differentiated outputs; False if no output can gain.

        An output whose derivatives of order 0 ... n contain no unknown input, with n states, is
        affected by none. Its coefficient in the derivative k + 1 is the gradient of the derivative
        k times the column with which the input enters, and the gradients 0 ... n - 1 span all later
        ones: once one of them depends on those before, over the functions of states, parameters and
        known signals, so do all that follow.
        """
        n = len(self.system.states)
        free = [r for r in self.rows if not r.contains and r.order < n]
        if not free:
            return False
        lowest = min(r.order for r in free)
        for row in (r for r in free if r.order == lowest):
            self.system, row.expression = differentiated(
                self.system, row.expression, known_as=self.known_as
            )
            row.order, row.contains = row.order + 1, None
            self._check_size(row)
        return True

    def _check_size(self, row: Row) -> None:
        if ca.n_nodes(row.expression) > MAX_NODES:
            raise IdentifiabilityError(
                f"{self.system.name}: {written(row.output, row.order)} has more than {MAX_NODES} "
                f"operations and {', '.join(self.names.values())} are not eliminated yet; use "
                "observability_by_counting, which writes no derivatives down, or add an output "
                "that the unknown input affects in a lower derivative"
            )

    def eliminate(self, row: Row, w: str) -> None:
        """Solve the row for w, with the row's value a new known input, and put it everywhere."""
        assert row.contains is not None
        symbol, old = self.system.symbols[w], self.system
        name = free_name(old, derivative_name(row.output, row.order))
        v = ca.SX.sym(name)
        self.known_as[name] = row.output, row.order
        rest = ca.substitute(row.expression, symbol, 0)
        solution = (v - rest) / row.contains[w]
        f, h = _put(old.f, symbol, solution, v), _put(old.h, symbol, solution, v)
        units = {name: old.units[row.output]} if row.order == 0 and row.output in old.units else {}
        self.system = old.where(
            f=f,
            h=h,
            symbols={**{k: s for k, s in old.symbols.items() if k != w}, name: v},
            inputs=(*old.inputs, name),
            unknown_inputs=tuple(k for k in old.unknown_inputs if k != w),
            units={**old.units, **units},
        )
        self.solutions = {
            k: ca.substitute(s, symbol, solution) for k, s in self.solutions.items()
        } | {w: solution}
        self.rows = [r for r in self.rows if r is not row]
        for other in self.rows:
            if w in (other.contains or {}):
                other.expression = ca.cse(ca.substitute(other.expression, symbol, solution))
                other.contains = None
        if row.order == 0:
            self.replaced.append(row.output)
        self.used[self.names[w]] = (row.output, row.order)
        called = "" if name == row.output else f", {name}"
        self.notes.append(
            f"{w} eliminated with {written(row.output, row.order)}, now a known input{called}"
        )

    def finish(self) -> tuple[str, ...]:
        """Set the unknown inputs that reach no output to zero; returns their names.

        Refuses where the user's choice of outputs is the reason.
        """
        self._refuse_deadlock()
        unreached = self.remaining
        for w in unreached:
            beyond = " beyond what eliminates the others" if self.used else ""
            self.notes.append(
                f"{w} reaches no output{beyond}: it is set to zero, and not identifiable"
            )
        if unreached:
            symbols = ca.vertcat(*[self.system.symbols[w] for w in unreached])
            zeros = ca.SX.zeros(len(unreached))
            self.solutions = {
                w: ca.substitute(s, symbols, zeros) for w, s in self.solutions.items()
            }
            self.system = self.system.substituted(dict.fromkeys(unreached, 0.0))
        self.system = _without_outputs(self.system, self.replaced)
        return tuple(self.names[w] for w in unreached)

    def _refuse_deadlock(self) -> None:
        for w in self.remaining:
            name = self.names[w]
            if name in self.using:
                raise IdentifiabilityError(
                    f"{self.system.name}: {name} cannot be eliminated with {self.using[name]}, "
                    "which it does not affect, or another unknown input does first; name another "
                    "output, or leave the choice open"
                )


def _put(vector: Expr, symbol: Expr, solution: Expr, v: Expr) -> Expr:
    """`solution` for `symbol`; entries that are then v itself are written so."""
    touched = [i for i in range(vector.numel()) if ca.depends_on(vector[i], symbol)]
    new = ca.substitute(vector, symbol, solution)
    is_v = vanishing([new[i] - v for i in touched])
    for i, is_same in zip(touched, is_v, strict=True):
        if is_same:
            new[i] = v
    return ca.cse(new)


def _most_nonlinear(system: System) -> str | None:
    """The unknown input that most coefficients of unknown inputs depend on, or None."""
    if not system.unknown_inputs:
        return None
    w = ca.vertcat(*[system.symbols[n] for n in system.unknown_inputs])
    slopes = ca.jacobian(ca.vertcat(system.f, system.h), w)
    counts = {}
    for n in system.unknown_inputs:
        curvature = ca.jacobian(ca.vec(slopes), system.symbols[n])
        entries = [ca.SX(e) for e in curvature.nonzeros()]
        counts[n] = sum(not zero for zero in vanishing(entries, at=system.at))
    worst = max(counts, key=lambda n: counts[n])
    return worst if counts[worst] else None


def _prolonged(system: System, w: str) -> tuple[System, str]:
    """The unknown input w as a state, and its derivative, the unknown input instead."""
    rate = free_name(system, derivative_name(w, 1))
    symbol = ca.SX.sym(rate)
    return system.where(
        states=(*system.states, w),
        f=ca.vertcat(system.f, symbol),
        symbols={**system.symbols, rate: symbol},
        unknown_inputs=tuple(rate if n == w else n for n in system.unknown_inputs),
    ), rate


def _without_outputs(system: System, names: list[str]) -> System:
    """The system without outputs that are inputs now, but with one output at least."""
    kept = [i for i, y in enumerate(system.outputs) if y not in names] or [0]
    return system.where(
        outputs=tuple(system.outputs[i] for i in kept),
        h=ca.vertcat(*[system.h[i] for i in kept]),
    )
