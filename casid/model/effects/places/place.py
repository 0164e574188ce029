"""A place where a force may act: a coordinate, and the equations that the force enters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.model.declarations import Balance
from casid.model.effects.names import A_CONSTANT
from casid.model.formula_text import formula_text
from casid.model.model import Model
from casid.model.quantity_names import quantity_of
from casid.model.units import same_dimension, unit_quotient

Expr = Any  # a CasADi SX expression


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A coordinate and the equations that a force along it enters.

    Attributes
    ----------
    where : name of the balance, or the relative motion in symbols ("w1-w2").
    unit : of the force, that of the first balance.
    velocity, position : expressions in states and inputs; None where the model has none.
    shares : (balance or state with a derivative, factor): what a force of one gives to it.
    stiffness, damping : K and C of the model's own force -K q - C v in the first equation, None
        where it has none.
    velocity_name, position_name : the coordinates in symbols.
    is_vector : the velocity is the size of a vector, and the factors are its direction.
    """

    where: str
    unit: str
    velocity: Expr
    velocity_unit: str
    position: Expr
    position_unit: str
    shares: tuple[tuple[str, Expr], ...]
    velocity_name: str
    position_name: str
    stiffness: Expr | None = None
    damping: Expr | None = None
    is_vector: bool = False

    @property
    def is_mechanical(self) -> bool:
        """True for forces and torques, which may be dry friction, play or stops."""
        return is_mechanical(self.unit)

    def a_quantity(self, otherwise: str = "term") -> str:
        """What acts here is called, with its article: a force, a heat flow."""
        return a_quantity(self.unit, otherwise, rate_unit=self.velocity_unit)

    @property
    def is_relative(self) -> bool:
        """True for a relative motion, which is no balance by its name."""
        return self.where != self.shares[0][0]

    @property
    def has_own_force(self) -> bool:
        """True where a force of any course is another one than in a single balance.

        On a motion relative to an input a force acts in one balance, as it does without the input.
        """
        return not self.is_relative or len(self.shares) > 1

    @property
    def words(self) -> str:
        """The equations that a force on a relative motion enters; "" for a balance.

        Between two bodies a force is positive where it acts on the first.
        """
        if not self.is_relative:
            return ""
        if self.is_vector:
            rows = " and ".join(row for row, _ in self.shares)
            return f"acts along {self.velocity_name}, in {rows}"
        factors = [(row, formula_text(f)) for row, f in self.shares]
        on = self.position_name or self.where
        if [f for _, f in factors] == ["1", "-1"]:
            return f"acts on {on} between {factors[0][0]} and {factors[1][0]}"
        each = [row if f == "1" else f"{row} times {f}" for row, f in factors]
        return f"acts on {on} in {' and in '.join(each)}"

    def add(self, model: Model, force: Expr) -> None:
        """Add a force to every equation that it enters (used by effects on their own copy)."""
        for row, factor in self.shares:
            given = in_symbols_of(model, factor * force)
            if row in model.balances:
                model.add_term(row, given)
            else:
                model.add_rate(row, given)

    def velocity_power(self, power: int, position_power: int = 0) -> str:
        """Unit of a coefficient that turns powers of velocity and position into a force."""
        unit = unit_quotient(self.unit, self.velocity_unit, power)
        return unit_quotient(unit, self.position_unit, position_power) if position_power else unit


def is_mechanical(unit: str) -> bool:
    """True for the unit of a force or a torque, or of one over a mass or an inertia."""
    return any(same_dimension(unit, known) for known in ("N", "N m", "m/s^2", "rad/s^2"))


def is_electrical(unit: str) -> bool:
    """True for the unit of a voltage or a current."""
    return any(same_dimension(unit, known) for known in ("V", "A"))


def a_quantity(unit: str, otherwise: str = "term", *, rate_unit: str = "K") -> str:
    """What a quantity in `unit` is called, with its article: a force, an amount flow."""
    word = quantity_of(unit, rate_unit)
    word = otherwise if word == "term" else word
    return f"{'an' if word[0] in 'aeiou' else 'a'} {word}"


def a_constant(unit: str, rate_unit: str) -> str:
    """What a constant in a balance in `unit` is called: a constant torque, else a constant term."""
    return f"{A_CONSTANT}{quantity_of(unit, rate_unit)}"


def is_amount(unit: str) -> bool:
    """True for the unit of an amount of matter or a mass, or of its concentration."""
    return any(same_dimension(unit, known) for known in ("mol", "kg", "mol/m^3", "kg/m^3"))


def balance_place(model: Model, balance: str) -> Place:
    """One balance: its rate, and the position that the rate moves."""
    b = model.balances[balance]
    v = model.symbol(b.rate)
    position = model.position_of(b.rate) or _moved_by(model, b.rate) or _swept_by(model, b)
    return Place(
        where=balance,
        unit=b.unit,
        velocity=v,
        velocity_unit=model.states[b.rate].unit,
        position=None if position is None else model.symbol(position),
        position_unit="1" if position is None else model.states[position].unit,
        shares=((balance, 1.0),),
        velocity_name=b.rate,
        position_name=position or "",
    )


def in_symbols_of(model: Model, expression: Expr) -> Expr:
    """An expression in the symbols that a model has for the same names."""
    symbols = ca.symvar(ca.SX(expression))
    own = [model.symbol(s.name()) for s in symbols]
    if all(ca.is_equal(a, b, 0) for a, b in zip(symbols, own, strict=True)):
        return expression
    return ca.substitute(ca.SX(expression), ca.vertcat(*symbols), ca.vertcat(*own))


def _moved_by(model: Model, rate: str) -> str | None:
    """A state whose derivative is the rate times a factor: an angle behind a gearbox."""
    v = model.symbol(rate)
    variables = ca.vertcat(*[model.symbol(n) for n in (*model.states, *model.inputs)])
    for name, expression in model._rates.items():
        slope = ca.jacobian(expression, v)
        if slope.nnz() and not any(ca.which_depends(slope, variables)):
            if is_zero(expression - slope * v):
                return name
    return None


def _swept_by(model: Model, balance: Balance) -> str | None:
    """A state that the rate moves among others, and that drives the balance in its turn.

    The angle of attack beside the pitch rate, alpha' = q + Z_a alpha: a moment in proportion to it
    is the stiffness of the pitching motion. The twist of a shaft is none, where it drives both of
    the bodies that move it: its spring is between them.
    """
    v, states = model.symbol(balance.rate), ca.vertcat(*[model.symbol(n) for n in model.states])
    sides = dict(model._rates)
    sides |= {b.rate: b.total / b.inertia for b in model.balances.values() if b is not balance}
    for name, side in sides.items():
        stiffness = ca.jacobian(ca.SX(balance.total), model.symbol(name))
        if not stiffness.nnz() or any(ca.which_depends(stiffness, states)):
            continue
        slope = ca.jacobian(ca.SX(side), v)
        is_moved = slope.nnz() and (is_zero(slope - 1) or is_zero(slope + 1))
        if is_moved and not _drives_another(model, name, side, balance):
            return name
    return None


def _drives_another(model: Model, state: str, side: Expr, balance: Balance) -> bool:
    """True if a second body moves a state, at the rate `side`, and is driven by it in its turn."""
    moved_by = {s.name() for s in ca.symvar(ca.SX(side))}
    return any(
        ca.which_depends(ca.SX(b.total), model.symbol(state))[0]
        for b in model.balances.values()
        if b.rate in moved_by - {state, balance.rate}
    )


def recorded_inputs(model: Model) -> list[str]:
    """Inputs that a record holds, measured or known."""
    return [n for n, u in model.inputs.items() if u.kind in ("measured", "known")]


def is_zero(expression: Expr) -> bool:
    """True if an expression vanishes at random points."""
    symbols = ca.symvar(expression)
    function = ca.Function("z", [ca.vertcat(ca.SX(0, 1), *symbols)], [ca.densify(expression)])
    rng = np.random.default_rng(3)
    points = [rng.uniform(0.2, 1.7, len(symbols)) for _ in range(3)]
    return all(abs(float(function(p))) < 1e-9 for p in points)
