"""The relative motions that the terms of a model act on.

A term is found by the parameter that multiplies it, or as an addend of the balances as written. Two
are the same element where they are in constant proportion. Proportions are judged at random
points, and are exact for terms that are polynomials.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.model.declared_units import common_unit
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.places.place import Expr, Place, is_mechanical, is_zero
from casid.model.formula_text import formula_text
from casid.model.model import Model
from casid.model.rate_laws import addends


def elements_of(model: Model) -> list[Place]:
    """The relative motions on which a term of the model acts, in the order of its balances."""
    return _Elements(model).places()


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A part of a row's right-hand side that may be the term of an element."""

    row: str
    shape: Expr  # proportional to the term
    term: Expr  # the term itself


class _Elements:
    """The search for elements of one model."""

    def __init__(self, model: Model, scales: Sequence[str] = ()) -> None:
        self.model = model
        self.scales = scales  # inputs that scale a motion, as parameters do
        self.names = [n for n in (*model.states, *model.inputs) if n not in scales]
        self.z = ca.vertcat(*[model.symbol(n) for n in self.names])
        fixed = [model.symbol(n) for n in (*model.parameters, *scales)]
        self.p = ca.vertcat(ca.SX(0, 1), *fixed)
        rows = {n: b.total for n, b in model.balances.items()}
        rates = {n: r for n, r in model._rates.items() if not model.states[n].is_added}
        self.rows: dict[str, Expr] = rows | rates
        self.own = {n: b.rate for n, b in model.balances.items()} | {n: n for n in model._rates}
        rng = np.random.default_rng(13)
        shape = self.z.numel(), 6  # random points at which expressions are compared
        self.z_at = rng.uniform(0.3, 1.7, shape) * rng.choice([-1.0, 1.0], shape)
        self.p_at = rng.uniform(0.3, 1.7, self.p.numel())
        self.p_other = rng.uniform(0.3, 1.7, (self.p.numel(), 3))

    def places(self) -> list[Place]:
        """All of them; those that share coordinate and equations are one."""
        found: dict[tuple[Any, ...], Place] = {}
        for group in self._groups():
            place = self._place(group)
            if place is None:
                continue
            key = self._key(place)
            if key in found:
                old = found[key]
                found[key] = replace(
                    old,
                    stiffness=_sum(old.stiffness, place.stiffness),
                    damping=_sum(old.damping, place.damping),
                )
            else:
                found[key] = place
        order = list(self.rows)
        named: dict[str, Place] = {}
        for place in sorted(found.values(), key=lambda p: order.index(p.shares[0][0])):
            where, n = place.where, 2
            while where in named or where in self.model.balances:
                where, n = f"{place.where} ({n})", n + 1
            named[where] = replace(place, where=where)
        return list(named.values())

    def _groups(self) -> Iterator[list[_Part]]:
        """Terms of several rows in constant proportion, and single ones of a relative motion."""
        rows = list(self.rows)
        parameters = list(self.model.parameters)
        for name in parameters:
            symbol = self.model.symbol(name)
            parts = []
            for row in rows:
                shape = ca.jacobian(ca.SX(self.rows[row]), symbol)
                is_factor = shape.nnz() and not any(ca.which_depends(shape, symbol))
                if is_factor and self._varies(shape):
                    parts.append(_Part(row, shape, symbol * shape))
            yield from self._proportional(parts)
        parts = [
            _Part(row, addend, addend)
            for row, side in self.rows.items()
            for addend in addends(ca.SX(side))
            if self._varies(addend) and not any(ca.which_depends(addend, self.p))
        ]
        yield from self._proportional(parts)

    def _varies(self, expression: Expr) -> bool:
        """True if an expression is made of states, inputs and parameters, a state among them."""
        n = len(self.model.states)
        known = {s.name() for s in ca.symvar(ca.vertcat(self.z, self.p))}
        symbols = {s.name() for s in ca.symvar(expression)}
        return symbols <= known and any(ca.which_depends(expression, self.z[:n]))

    def _proportional(self, parts: Sequence[_Part]) -> Iterator[list[_Part]]:
        left = list(parts)
        while left:
            first = left.pop(0)
            values = self._values(first.shape)
            group = [first]
            for other in list(left):
                if other.row not in [r.row for r in group] and _ratio(
                    values, self._values(other.shape)
                ):
                    group.append(other)
                    left.remove(other)
            if any(r.row in self.model.balances for r in group):
                yield group

    def _values(self, expression: Expr) -> Array:
        function = ca.Function("v", [self.z, self.p], [ca.densify(expression)])
        with np.errstate(all="ignore"):
            return np.array([float(function(z, self.p_at)) for z in self.z_at.T])

    def _place(self, group: Sequence[_Part]) -> Place | None:
        """The place of a group of terms, None where they have no coordinate of their own."""
        scales = self._scales_of(group[0].shape)
        if scales:
            place = _Elements(self.model, scales)._place(group)
            # What a flow carries is no law of a difference, nor what a valve's opening lets pass.
            is_slip = place is not None and place.is_mechanical and place.velocity_unit == "1"
            return place if is_slip else None
        coordinate = self._coordinate(group[0].shape)
        known = self.model.states
        if coordinate is None or any(n in known and known[n].is_added for n in coordinate):
            return None
        group = sorted(group, key=lambda r: self._rank_of(r.row, coordinate))
        owners = {self.own[r.row] for r in group} | {b.rate for b in self.model.balances.values()}
        states = [n for n in coordinate if n in self.model.states]
        if not states:
            return None
        velocity: dict[str, Expr] | None
        position: dict[str, Expr] | None
        if set(states) <= owners:
            velocity, position = coordinate, self._position_of(coordinate)
        elif not set(states) & owners:
            velocity, position = self._velocity_of(coordinate), coordinate
        else:
            return None
        if not self._is_relative(group, velocity, position):
            return None
        return self._built(group, coordinate, velocity, position)

    def _scales_of(self, shape: Expr) -> list[str]:
        """Inputs on which the slope of a term in the states depends: the speed over a road."""
        states = self.z[: len(self.model.states)]
        slope = ca.jacobian(shape, states)
        inputs = [n for n in self.model.inputs if n not in self.scales]
        found = [n for n in inputs if any(ca.which_depends(slope, self.model.symbol(n), 1))]
        return [] if any(ca.which_depends(slope, states)) else found

    def _rank_of(self, row: str, coordinate: Mapping[str, Expr]) -> int:
        """Balances come first whose own motion is in the coordinate: a force resists it there."""
        own = self.own[row]
        moves = own in coordinate or any(self._rate_is_of(n, {own}) for n in coordinate)
        return 2 * (row not in self.model.balances) + (not moves)

    def _is_relative(
        self,
        group: Sequence[_Part],
        velocity: Mapping[str, Expr] | None,
        position: Mapping[str, Expr] | None,
    ) -> bool:
        """True for a motion of several things, one of which is an equation's own.

        In a single equation the others are inputs: what comes in from another store, and leaves
        with the state, is no flow between the two. What is estimated scales no motion: c w - T is
        a torque and friction, not a motion relative to T / c.
        """
        moving = velocity if velocity is not None else position
        assert moving is not None
        own = {self.own[r.row] for r in group}
        own |= {q for q in self.model.states if self._rate_is_of(q, own)}
        others = [n for n in moving if n not in own]
        if len(group) > 1 and len(moving) == 1:
            # A relative coordinate already, or a wheel's speed, whose friction turns its carrier.
            return position is not None or self._is_mechanical(group)
        if len(group) == 1 and any(n in self.model.states for n in others):
            return False
        if any(self._is_estimated(moving[n]) for n in others):
            return False
        return len(moving) > 1 and len(others) < len(moving)

    def _is_mechanical(self, group: Sequence[_Part]) -> bool:
        """True if every row is a balance of forces or torques."""
        balances = self.model.balances
        return all(r.row in balances and is_mechanical(balances[r.row].unit) for r in group)

    def _is_estimated(self, coefficient: Expr) -> bool:
        """True if a coefficient depends on a parameter that is not known."""
        known = self.model.parameters
        names = [s.name() for s in ca.symvar(ca.SX(coefficient))]
        return any(not known[n].is_known for n in names if n in known)

    def _rate_is_of(self, position: str, rates: set[str]) -> bool:
        expression = self.model._rates.get(position)
        return expression is not None and any(
            s.name() in rates for s in ca.symvar(ca.SX(expression))
        )

    def _built(
        self,
        group: Sequence[_Part],
        coordinate: Mapping[str, Expr],
        velocity: dict[str, Expr] | None,
        position: dict[str, Expr] | None,
    ) -> Place | None:
        """The place, its coordinate with the sign and the scale of the first equation's motion."""
        first = group[0]
        own = self.own[first.row]
        moving = velocity if velocity is not None else position
        assert moving is not None
        reference = own if own in moving else None
        if reference is None:
            mine = [q for q in moving if self._rate_is_of(q, {own})]
            reference = mine[0] if mine else next(iter(moving))
        sign = float(np.sign(self._number(moving[reference])))
        size: Expr | None = None
        if velocity is not None and position is not None and len(position) > 1:
            scale = moving[reference]  # both sums have the same coefficients
            velocity = {n: self._simple(c / scale) for n, c in velocity.items()}
            position = {n: self._simple(c / scale) for n, c in position.items()}
        elif velocity is not None:
            scale = velocity[reference]
            velocity = {n: self._simple(c / scale) for n, c in velocity.items()}
            size = self._size_as_written(first.shape, reference) if position is None else None
            if position is not None:
                position = {n: self._simple(sign * c) for n, c in position.items()}
        else:
            assert position is not None
            scale = position[reference]
            position = {n: self._simple(c / scale) for n, c in position.items()}
        shares = [(first.row, ca.SX(1.0))]
        for other in group[1:]:
            ratio = self._ratio_of(other.shape, first.shape)
            if ratio is None:
                return None
            shares.append((other.row, ratio))
        is_spring = velocity is None or (position is not None and set(coordinate) == set(position))
        units = self.model.symbol_units
        moving = velocity if velocity is not None else position
        assert moving is not None
        row, name = first.row, _text(moving)
        unit = "1" if velocity is None else units[reference]
        if size is not None:
            name = f"({name}){_factor_text(size)}"
            unit = common_unit([size * self.model.symbol(reference)], units, is_rotation=False)
            velocity = {n: c * size for n, c in moving.items()}
        return Place(
            where=name,
            unit=self.model.balances[row].unit,
            velocity=None if velocity is None else self._expression(velocity),
            velocity_unit=unit,
            position=None if position is None else self._expression(position),
            position_unit="1" if position is None else units[next(iter(position))],
            shares=tuple(shares),
            velocity_name="" if velocity is None else _text(velocity) if size is None else name,
            position_name="" if position is None else _text(position),
            stiffness=self._slope(first.term, position) if is_spring else None,
            damping=None if is_spring else self._slope(first.term, velocity),
        )

    def _size_as_written(self, shape: Expr, reference: str) -> Expr | None:
        """The factor of a motion that differs between load cases or is recorded, or None.

        A law of the angle at which a tyre slips is one law at all speeds, where a law of the
        velocity across it is another at each.
        """
        known = self.model.parameters
        slope = ca.jacobian(shape, self.model.symbol(reference))
        size = self._simple(slope)
        symbols = [known[s.name()] for s in ca.symvar(size) if s.name() in known]
        is_fixed = not self.scales and all(p.is_constant for p in symbols)
        if any(not p.is_known for p in symbols) or is_fixed:
            return None
        return size if self._number(size) > 0 else self._simple(-size)

    def _slope(self, term: Expr, coordinate: Mapping[str, Expr] | None) -> Expr | None:
        """-d(term)/d(coordinate) where the coordinate is zero."""
        if coordinate is None:
            return None
        name, c = next(iter(coordinate.items()))
        slope = -ca.jacobian(term, self.model.symbol(name)) / c
        zero = ca.DM.zeros(self.z.numel())
        return ca.substitute(slope, self.z, zero)

    def _coordinate(self, shape: Expr) -> dict[str, Expr] | None:
        """Coefficients of c'z if the expression is a function of such a sum alone."""
        gradient = ca.densify(ca.jacobian(shape, self.z))
        function = ca.Function("g", [self.z, self.p], [gradient])
        values = np.array([function(z, self.p_at).full().ravel() for z in self.z_at.T])
        if not np.all(np.isfinite(values)):
            return None
        largest = np.max(np.abs(values), axis=0)
        used = np.flatnonzero(largest > 1e-9 * max(largest.max(initial=0.0), 1e-300))
        if not used.size or np.any(np.abs(values[:, used]) <= 0.0):
            return None
        ratios = values[:, used] / values[:, used[:1]]
        if not np.allclose(ratios, ratios[:1], rtol=1e-7, atol=0.0):
            return None
        out = {}
        for i in used:
            c = self._at_a_point(gradient[int(i)] / gradient[int(used[0])])
            if c is None:
                return None
            out[self.names[i]] = c
        return out

    def _position_of(self, velocity: Mapping[str, Expr]) -> dict[str, Expr] | None:
        """The sum of positions that moves with a sum of rates, or a state that is it already."""
        states = [n for n in velocity if n in self.model.states]
        if len(states) == len(velocity):
            positions = [self.model.position_of(n) for n in states]
            if all(q is not None for q in positions):
                return {str(q): velocity[n] for q, n in zip(positions, states, strict=True)}
        values = self._values(self._expression(velocity))
        for name, expression in self.model._rates.items():
            if self._varies(ca.SX(expression)) and name not in velocity:
                ratio = _ratio(values, self._values(ca.SX(expression)))
                if ratio:
                    return {name: ca.SX(float(np.sign(ratio)))}
        return None

    def _velocity_of(self, position: Mapping[str, Expr]) -> dict[str, Expr] | None:
        """The derivative of a sum of positions, None where that of an input is needed."""
        if any(n not in self.model._rates for n in position):
            return None
        rate = ca.SX(sum(c * self.model._rates[n] for n, c in position.items()))
        known = {s.name() for s in ca.symvar(ca.vertcat(self.z, self.p))}
        if not {s.name() for s in ca.symvar(rate)} <= known:
            return None
        gradient = ca.densify(ca.jacobian(rate, self.z))
        if any(ca.which_depends(gradient, self.z)):
            return None
        found = {n: gradient[i] for i, n in enumerate(self.names) if not is_zero(gradient[i])}
        return found or None

    def _ratio_of(self, expression: Expr, to: Expr) -> Expr | None:
        """The constant factor between two proportional expressions."""
        return self._at_a_point(expression / to)

    def _at_a_point(self, ratio: Expr) -> Expr | None:
        """A ratio that depends on no state, as a number or a product of powers of parameters.

        The powers are its elasticities, p/r dr/dp: whole numbers, where it is such a product.
        """
        at = ca.substitute(ca.SX(ratio), self.z, ca.DM(self.z_at[:, 0]))
        powers = ca.densify(ca.gradient(at, self.p)) * self.p / at
        function = ca.Function("r", [self.p], [ca.densify(at), powers])
        found = [function(p) for p in self.p_other.T]
        values = np.array([float(value) for value, _ in found])
        if not np.all(np.isfinite(values)):
            return None
        exponents = np.array([e.full().ravel() for _, e in found])
        whole = np.round(exponents[0])
        if not np.allclose(exponents, whole, rtol=0.0, atol=1e-9):
            return at
        size = float(values[0] / np.prod(self.p_other[:, 0] ** whole))
        above = (self.p[i] ** int(n) for i, n in enumerate(whole) if n > 0)
        below = (self.p[i] ** int(-n) for i, n in enumerate(whole) if n < 0)
        one = ca.SX(1.0)
        return _literal(size) * math.prod(above, start=one) * (1 / math.prod(below, start=one))

    def _simple(self, coefficient: Expr) -> Expr:
        c = ca.SX(coefficient)
        found = self._at_a_point(c)
        return c if found is None else found

    def _number(self, expression: Expr) -> float:
        function = ca.Function("n", [self.p], [ca.densify(ca.SX(expression))])
        return float(function(self.p_at))

    def _expression(self, coefficients: Mapping[str, Expr]) -> Expr:
        return sum(c * self.model.symbol(n) for n, c in coefficients.items())

    def _key(self, place: Place) -> tuple[Any, ...]:
        """Equal for places with the same coordinate in the same equations."""
        moving = place.velocity if place.velocity is not None else place.position
        values = self._values(ca.SX(moving))
        factors = [round(self._number(f), 9) for _, f in place.shares]
        rows = tuple(row for row, _ in place.shares)
        return (*rows, *factors, place.velocity is None, *np.round(values, 9))


def are_joined(elements: Sequence[Place], one: str, other: str) -> bool:
    """True of two balances that an element acts in."""
    return any({one, other} <= {row for row, _ in e.shares} for e in elements)


def _sum(one: Expr | None, other: Expr | None) -> Expr | None:
    if one is None or other is None:
        return one if other is None else other
    return one + other


def _ratio(values: Array, others: Array) -> float:
    """The factor between two rows of values, 0 where it is not one."""
    with np.errstate(all="ignore"):
        ratio = others / values
    good = np.isfinite(ratio)
    if not good.all() or abs(ratio[0]) == 0.0:
        return 0.0
    return float(ratio[0]) if np.allclose(ratio, ratio[0], rtol=1e-8, atol=0.0) else 0.0


def _literal(value: float) -> Expr:
    """A number in a model: plain where it is one, else carrying the unit of its place."""
    nearest_simple = round(value * 12) / 12
    if abs(value - nearest_simple) < 1e-9 * max(1.0, abs(value)):
        value = nearest_simple
    return ca.SX(value if abs(value) == 1.0 else carrying_unit(value))


def _text(coefficients: Mapping[str, Expr]) -> str:
    """A sum in symbols without spaces: "w1-w2", "w-20*w_load", "w_1-w_2/ratio"."""
    out = ""
    for name, c in sorted(coefficients.items(), key=lambda item: str(item[1]) != "1"):
        if ca.SX(c).is_constant():
            value = float(c)
            size = "" if abs(value) == 1.0 else f"{abs(value):.4g}*"
            term = "-" * (value < 0) + size + name
        else:
            term = formula_text(c * ca.SX.sym(name)).replace(" ", "")
        out += "+" * (bool(out) and not term.startswith("-")) + term
    return out


def _factor_text(size: Expr) -> str:
    """A factor behind a sum in brackets: "/V", "*V"."""
    head, slash, rest = formula_text(size).replace(" ", "").partition("/")
    return f"/{rest}" if slash and head == "1" else f"*{head}{slash}{rest}"
