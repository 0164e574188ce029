"""All parameter values that give the same outputs: the flow along a null direction, in closed form.

One parameter is moved freely, the others follow by d theta_i / d free = v_i(theta). Where these
equations are triangular and each is simple in its own unknown they are integrated. The constants of
integration are identifiable: an invariant parameterisation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from types import MappingProxyType
from typing import Any, TypeAlias

from casid.algebra.factoring import factored
from casid.algebra.readable import neat, tidy
from casid.errors import IdentifiabilityError
from casid.identifiability.combinations.null_direction import NullDirection
from casid.identifiability.combinations.scalar_flow import integrate_scalar
from casid.pickling import PickledByFields

Expr: TypeAlias = Any  # a sympy expression


@dataclass(frozen=True, slots=True, eq=False)
class Family(PickledByFields):
    """A curve of parameter values with the same outputs.

    Attributes
    ----------
    direction : the direction it follows, normalised to `free`.
    formulas : parameter that moves -> its new value, a sympy expression of the old values (symbols
        of the physical names) and the new value of the free parameter (its name with a prime).
    invariants : expressions that keep their value; with the unchanged parameters they are what can
        be identified in place of the parameters that move, where no other family moves them
        (`closed_form.joint_invariants`).
    unsolved : parameters that move, too, but for which no closed form was found; their speed is
        still in `direction`.
    unchanged_where : parameter -> expressions; where one of them is zero it does not move.
    """

    direction: NullDirection
    formulas: Mapping[str, Expr]
    invariants: tuple[Expr, ...]
    unsolved: tuple[str, ...] = ()
    unchanged_where: Mapping[str, tuple[Expr, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("formulas", "unchanged_where"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    @property
    def free(self) -> str:
        """The parameter that is moved."""
        return self.direction.free

    @property
    def moved(self) -> tuple[str, ...]:
        """Parameters that change along the family, the free one among them."""
        return self.direction.moved

    @property
    def unchanged(self) -> tuple[str, ...]:
        """Parameters that keep their value."""
        return self.direction.unchanged

    @property
    def is_closed(self) -> bool:
        """True if every parameter that moves has a formula."""
        return not self.unsolved

    @property
    def weights(self) -> Mapping[str, int] | None:
        """Exponents w of a scaling theta_i -> lam^w_i theta_i, or None if it is none."""
        return _weights(self.direction)

    def at(self, values: Mapping[str, Any], free_value: Any) -> dict[str, Any]:
        """Parameter values with the same outputs, the free parameter at a new value.

        Parameters
        ----------
        values : number of every parameter and known constant in the formulas; with integers and
            fractions, a rational formula is evaluated exactly.
        free_value : new value of the free parameter, on the same side of every pole.

        Returns
        -------
        every parameter's new value; Fractions where exact, else floats.

        Raises
        ------
        IdentifiabilityError
            If a parameter has no formula, a value is missing or the family ends before free_value.
        """
        import sympy

        if self.unsolved:
            raise IdentifiabilityError(
                f"the family along {self.free} has no closed form for {', '.join(self.unsolved)}; "
                "follow its direction instead, a differential equation"
            )
        new = sympy.Symbol(self.free + "'")
        needed = {s.name for f in self.formulas.values() for s in f.free_symbols if s != new}
        missing = sorted((needed | set(self.unchanged)) - set(values))
        if missing:
            raise IdentifiabilityError(
                f"the family along {self.free} needs a value of {', '.join(missing)}; add it"
            )
        numbers = {sympy.Symbol(n): _number(v) for n, v in values.items()}
        numbers[new] = _number(free_value)
        out = {n: values[n] for n in self.unchanged}
        for name, formula in self.formulas.items():
            out[name] = _plain(formula.xreplace(numbers))
            if out[name] is None:
                raise IdentifiabilityError(
                    f"{name} has no real value where {self.free} is {free_value}: the family ends "
                    f"before; stay closer to {self.free} = {values.get(self.free)}"
                )
        return {n: out[n] for n in self.direction.entries}

    def __repr__(self) -> str:
        end = f", no closed form for {', '.join(self.unsolved)}" if self.unsolved else ""
        return f"<Family along {self.free}: moves {', '.join(self.moved)}{end}>"

    def __str__(self) -> str:
        lines = _formula_lines(self)
        for n in self.unsolved:
            speed = self.direction.entries[n]
            how = "not found" if speed is None else f"d {n} / d {self.free} = {speed}"
            lines.append(f"{n} moves, too, without a closed form: {how}")
        if self.unchanged:
            few = len(self.unchanged) <= 8
            names = ", ".join(self.unchanged) if few else f"the other {len(self.unchanged)}"
            lines.append(f"unchanged: {names}")
        if self.invariants:
            lines.append(f"invariants: {', '.join(map(str, self.invariants))}")
        for n, factors in self.unchanged_where.items():
            lines.append(f"{n} is unchanged where {' or '.join(f'{f} = 0' for f in factors)}")
        return "\n".join(lines)


LARGEST = 500
"""Operations of a formula that is factored; sympy may take minutes for more, uninterrupted."""


def family(direction: NullDirection, is_over: Callable[[], bool] = lambda: False) -> Family:
    """The family a null direction belongs to, in closed form as far as it was found.

    The direction is followed along its own free parameter, or along another one it moves if only
    that gives closed forms for all. Every formula is checked: it starts at the old value, its
    derivative is the direction and no invariant changes along it, exactly where they are rational.

    Parameters
    ----------
    direction : entries as functions of parameters and of symbols that do not move; an entry with an
        unknown initial state in it is not integrated, since that state may move as well.
    is_over : checked before every step; what is not integrated by then has no closed form.
    """
    best: Family | None = None
    names = [n for n in direction.moved if n not in direction.not_found]
    for free in sorted(names, key=lambda n: n != direction.free):
        if best is not None and is_over():
            break
        along = direction if free == direction.free else direction.following(free)
        found = _integrated(along, is_over)
        if found.is_closed:
            return found
        if best is None or len(found.unsolved) < len(best.unsolved):
            best = found
    assert best is not None
    return best


def _integrated(direction: NullDirection, is_over: Callable[[], bool]) -> Family:
    """Integrate one equation at a time, those first whose other unknowns are solved."""
    import sympy

    z, new = sympy.Symbol(direction.free), sympy.Symbol(direction.free + "'")
    pending = {sympy.Symbol(n) for n in direction.moved} - {z}
    moving = pending | {sympy.Symbol(n) for n in direction.initial_states}
    along: dict[Expr, Expr] = {}  # solved parameter -> function of z and constants
    constants: dict[Expr, Expr] = {}  # constant -> function of z and parameters
    formulas: dict[str, Expr] = {direction.free: new}
    progress = True
    while progress:
        progress = False
        for theta in sorted(pending, key=lambda s: direction.moved.index(s.name)):
            speed = direction.entries[theta.name]
            if speed is None or speed.free_symbols & (moving - {theta} - set(along)) or is_over():
                continue
            flow = integrate_scalar(speed.xreplace(along), theta, z)
            if flow is None:
                continue
            constant = _resolved(flow.constant, constants)
            formula = _resolved(flow.moved_to(new), constants)
            if formula.count_ops() > LARGEST:
                continue
            formula = neat(formula, moving)
            if not _is_solution(direction, formulas | {theta.name: formula}, constant, theta):
                continue
            named = sympy.Dummy("C")
            along[theta], constants[named] = flow.from_constant(named), constant
            formulas[theta.name] = formula
            pending.discard(theta)
            progress = True
    return Family(
        direction,
        {n: formulas[n] for n in direction.moved if n in formulas},
        tuple(
            tidy(c, theta, moving | {z}) for theta, c in zip(along, constants.values(), strict=True)
        ),
        tuple(n for n in direction.moved if n not in formulas),
        _where_unchanged(direction, moving | {z}),
    )


def _resolved(expression: Expr, constants: Mapping[Expr, Expr]) -> Expr:
    """An expression with the constants of integration written as functions of the parameters."""
    return expression.xreplace(dict(constants))


def _is_solution(
    direction: NullDirection, formulas: Mapping[str, Expr], constant: Expr, theta: Expr
) -> bool:
    """At a random point: the formula has the direction's rate, and the constant is invariant."""
    import numpy as np
    import sympy

    z, new = sympy.Symbol(direction.free), sympy.Symbol(direction.free + "'")
    moved = {sympy.Symbol(n): f for n, f in formulas.items()}
    formula, speed = moved[theta], sympy.sympify(direction.entries[theta.name])
    rng = np.random.default_rng(7)
    symbols = sorted(
        (formula.free_symbols | constant.free_symbols | speed.free_symbols) - {new},
        key=lambda s: str(s.name),
    )
    at = {s: sympy.Rational(*(int(n) for n in rng.integers(90, 110, 2))) for s in symbols}
    at[new] = at.setdefault(z, sympy.Rational(101, 99)) + sympy.Rational(1, 997)
    there = {s: f.xreplace(at) for s, f in moved.items()}
    along = sum(
        sympy.diff(constant, sympy.Symbol(n)) * direction.entries[n]
        for n in formulas
        if constant.has(sympy.Symbol(n))
    )
    return all(
        _is_zero(e)
        for e in (
            formula.xreplace(at | {new: at[z]}) - at.get(theta, theta),
            sympy.diff(formula, new).xreplace(at) - speed.xreplace(at | there),
            sympy.sympify(along).xreplace(at),
        )
    )


def _is_zero(number: Expr) -> bool:
    if number.is_Rational:
        return bool(number == 0)
    value = number.evalf(30)
    return bool(value.is_number and abs(value) < 1e-15)


def _where_unchanged(direction: NullDirection, moving: set[Expr]) -> dict[str, tuple[Expr, ...]]:
    """Factors of the speeds that are sums of symbols that do not move."""
    import sympy

    out: dict[str, tuple[Expr, ...]] = {}
    for n in direction.moved:
        speed = direction.entries[n]
        if speed is None or n == direction.free:
            continue
        top, _ = sympy.fraction(factored(speed) if speed.is_Add else speed)
        factors = [f.as_base_exp()[0] for f in sympy.Mul.make_args(top)]
        special = [f for f in factors if f.is_Add and not f.free_symbols & moving]
        if special:
            out[n] = tuple(special)
    return out


def _weights(direction: NullDirection) -> dict[str, int] | None:
    import sympy

    z = sympy.Symbol(direction.free)
    exponents = {}
    for n in direction.moved:
        speed = direction.entries[n]
        w = None if speed is None else sympy.cancel(speed * z / sympy.Symbol(n))
        if w is None or not w.is_Rational:
            return None
        exponents[n] = w
    common = math.lcm(*(w.q for w in exponents.values()))
    return {n: int(w * common) for n, w in exponents.items()}


def _formula_lines(found: Family) -> list[str]:
    """The formulas, with lam (or another name not taken) for a factor that parameters share."""
    import sympy

    taken = {s.name for f in found.formulas.values() for s in f.free_symbols}
    taken |= set(found.direction.entries)
    name = next(n for n in ("lam", "scale", *(f"lam_{i}" for i in range(99))) if n not in taken)
    if found.weights is not None and len(found.moved) > 1:
        return [
            ", ".join(
                f"{n}' = {n}{'*' if w > 0 else '/'}{name}{'' if abs(w) == 1 else f'**{abs(w)}'}"
                for n, w in found.weights.items()
            )
        ]
    if found.moved == (found.free,):
        return [f"{found.free} is free: the outputs do not depend on it"]
    ratios: dict[str, Expr] = {}
    for n, f in found.formulas.items():
        ratio = sympy.cancel(f / sympy.Symbol(n))
        if n != found.free and not ratio.has(sympy.Symbol(n)):
            ratios[n] = factored(ratio)
    shared = [r for r in ratios.values() if list(ratios.values()).count(r) > 1]
    lam = shared[0] if shared else None
    lines = [f"{found.free}' is free" + (f", {name} = {lam}" if lam is not None else "")]
    for n, f in found.formulas.items():
        if n != found.free:
            together = lam is not None and ratios.get(n) == lam
            lines.append(f"{n}' = {f'{n}*{name}' if together else f}")
    return lines


def _number(value: Any) -> Expr:
    import sympy

    if isinstance(value, int | Fraction):
        value = Fraction(value)
        return sympy.Rational(value.numerator, value.denominator)
    return sympy.Float(float(value))


def _plain(number: Expr) -> Fraction | float | None:
    """A sympy number as a Fraction or float; None if it is not finite and real."""
    if number.is_Rational:
        return Fraction(int(number.p), int(number.q))
    value = number.evalf()
    return float(value) if value.is_number and value.is_real and value.is_finite else None
