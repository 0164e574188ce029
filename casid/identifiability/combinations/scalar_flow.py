"""One equation d theta / dz = v(z, theta), v rational, solved in closed form where that is simple.

Equations that are linear in theta, or become so in a power of it (Bernoulli), with a coefficient
whose poles in z are rational:

    u = theta^s,  du/dz = a(z) u + b(z),  u = mu (C + F),  mu = exp(int a),  F = int b / mu      (1)

The constant of integration C is invariant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

from casid.algebra.factoring import factored

Expr: TypeAlias = Any  # a sympy expression


@dataclass(frozen=True, slots=True)
class ScalarFlow:
    """Solution (1), with F = G / mu + sum of coefficient * log(base).

    Attributes
    ----------
    power : s, with u = theta^s.
    bases : (base, exponent) of mu, bases linear in z.
    exponential : mu carries the factor exp(exponential), a function of z without a pole's log.
    particular : G, a rational function of z that solves (1) but for the logarithms.
    logs : (base, coefficient); only where all exponents of mu are integers.
    """

    theta: Expr
    z: Expr
    power: Expr
    bases: tuple[tuple[Expr, Expr], ...]
    exponential: Expr
    particular: Expr
    logs: tuple[tuple[Expr, Expr], ...]

    @property
    def constant(self) -> Expr:
        """C as a function of z and theta."""
        import sympy

        u = (self.theta**self.power - self.particular) / self._mu
        return u - sympy.Add(*(c * sympy.log(base) for base, c in self.logs))

    def from_constant(self, constant: Expr) -> Expr:
        """The moved theta as a function of z, given C."""
        import sympy

        logs = sympy.Add(*(c * sympy.log(base) for base, c in self.logs))
        u = self._mu * (constant + logs) + self.particular
        return u ** (1 / self.power)

    def moved_to(self, z_new: Expr) -> Expr:
        """The value of theta at z_new, as a function of z, theta and z_new.

        Bases enter as quotients (new over old), which are positive as long as none passes a zero.
        """
        import sympy

        def new(e: Expr) -> Expr:
            return e.xreplace({self.z: z_new})

        ratio = sympy.Mul(*((new(base) / base) ** e for base, e in self.bases))
        ratio *= sympy.exp(new(self.exponential) - self.exponential)
        logs = sympy.Add(*(c * sympy.log(new(base) / base) for base, c in self.logs))
        u = self.theta**self.power
        moved = ratio * (u - self.particular) + new(self.particular) + new(self._mu) * logs
        if self.power == 1:
            return moved
        return self.theta * factored(moved / u) ** (1 / self.power)

    @property
    def _mu(self) -> Expr:
        import sympy

        return sympy.Mul(*(base**e for base, e in self.bases)) * sympy.exp(self.exponential)


def integrate_scalar(v: Expr, theta: Expr, z: Expr) -> ScalarFlow | None:
    """The solution of d theta / dz = v, or None where it is not of the form (1).

    Parameters
    ----------
    v : sympy expression in theta, z and constant symbols.
    theta, z : the unknown and the independent symbol.
    """
    import sympy

    terms = _powers_of(v, theta, z)
    if terms is None:
        return None
    others = [n for n in terms if n != 1]
    if len(others) > 1:
        return None
    n = others[0] if others else sympy.Integer(0)
    s = 1 - n
    a, b = s * terms.get(sympy.Integer(1), 0), s * terms.get(n, 0)
    factor = rational_integral(sympy.sympify(a), z)
    if factor is None:
        return None
    exponential, bases = factor
    solved = _particular(sympy.sympify(b), z, bases, exponential)
    if solved is None:
        return None
    return ScalarFlow(theta, z, s, bases, exponential, *solved)


def rational_integral(
    expression: Expr, z: Expr
) -> tuple[Expr, tuple[tuple[Expr, Expr], ...]] | None:
    """Antiderivative of a rational function: (rational part, ((base, coefficient of log), ...)).

    None where the expression is not rational in z or its denominator does not split into factors
    that are linear in z.
    """
    import sympy

    if not expression.is_rational_function(z):
        return None
    top, bottom = sympy.fraction(factored(sympy.together(expression)))
    unit, factors = sympy.factor_list(bottom, z)
    poles: list[tuple[Expr, Expr, Expr, int]] = []
    for base, multiplicity in factors:
        slope, *offset = sympy.Poly(base, z).all_coeffs()
        if len(offset) != 1:
            return None
        poles.append((base, slope, -offset[0] / slope, int(multiplicity)))
    quotient, remainder = sympy.div(sympy.Poly(top, z), sympy.Poly(bottom, z))
    whole = sympy.integrate(quotient.as_expr(), z)
    logs: list[tuple[Expr, Expr]] = []
    for base, slope, where, multiplicity in poles:
        others = sympy.Mul(*(f**k for f, k in factors if f != base)) * unit
        g = sympy.cancel(remainder.as_expr() / others)
        for k in range(multiplicity):  # term base^(k - multiplicity)
            c = factored(sympy.diff(g, z, k).subs(z, where) / sympy.factorial(k) / slope**k)
            order = multiplicity - k
            if c == 0:
                continue
            if order == 1:
                logs.append((base, factored(c / slope)))
            else:
                whole += c / (slope * (1 - order) * base ** (order - 1))
    return factored(whole), tuple(logs)


def _powers_of(v: Expr, theta: Expr, z: Expr) -> dict[Expr, Expr] | None:
    """v as a sum of powers of theta, exponent -> coefficient without theta; None if it is not."""
    import sympy

    if not v.is_rational_function(theta, z):
        return None
    top, bottom = sympy.fraction(factored(sympy.together(v)))
    below = sympy.Poly(bottom, theta)
    if len(below.terms()) > 1:
        return None
    shift, scale = below.terms()[0][0][0], below.terms()[0][1]
    return {
        sympy.Integer(power - shift): factored(c / scale)
        for (power,), c in sympy.Poly(top, theta).terms()
        if c != 0
    }


def _particular(
    b: Expr, z: Expr, bases: tuple[tuple[Expr, Expr], ...], exponential: Expr
) -> tuple[Expr, tuple[tuple[Expr, Expr], ...]] | None:
    """(G, logs) of the solution (1)."""
    import sympy

    if b == 0:
        return sympy.Integer(0), ()
    if exponential == 0 and all(e.is_integer for _, e in bases):
        mu = sympy.Mul(*(base**e for base, e in bases))
        found = rational_integral(b / mu, z)
        return None if found is None else (factored(found[0] * mu), found[1])
    if exponential == 0 and len(bases) == 1:
        return _power_rule(b, z, *bases[0])
    slope = sympy.diff(exponential, z)
    if not bases and not slope.has(z) and b.is_polynomial(z):
        terms, left, k = [], b, 1
        while left != 0:
            terms.append(left / slope**k)
            left, k = sympy.diff(left, z), k + 1
        return factored(-sympy.Add(*terms)), ()
    return None


def _power_rule(
    b: Expr, z: Expr, base: Expr, exponent: Expr
) -> tuple[Expr, tuple[tuple[Expr, Expr], ...]] | None:
    """G for mu = base^exponent, exponent no integer, and b a sum of integer powers of the base."""
    import sympy

    w = sympy.Dummy("w")
    slope, offset = sympy.Poly(base, z).all_coeffs()
    powers = _powers_of(b.subs(z, (w - offset) / slope), w, w)
    if powers is None:
        return None
    total = sympy.Integer(0)
    for k, c in powers.items():
        divisor = factored(slope * (k - exponent + 1))
        if divisor == 0:
            return None
        total += c * base ** (k + 1) / divisor
    return factored(total), ()
