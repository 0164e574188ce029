"""One rational transfer function as a value: exact coefficients, in q, in s, or a constant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from casid.algebra import polynomial as poly
from casid.algebra.coefficients import cancelled, coefficient
from casid.algebra.polynomial import Coefficient, Polynomial
from casid.algebra.rational_reader import read
from casid.algebra.rational_text import fraction_text
from casid.algebra.roots import Root, roots_of
from casid.arrays import Array
from casid.errors import ModelError


@dataclass(frozen=True, slots=True, eq=False)
class Rational:
    """numerator / denominator, common factors cancelled, the denominator monic where exact.

    Write ``q = Rational.shift()`` and compute: ``0.07 / (q - 0.11)``. Floats are read as the
    shortest decimal that gives them back, so 0.07 is 7/100 and arithmetic is exact.

    Attributes
    ----------
    numerator, denominator : coefficients in descending powers; fractions, or sympy expressions
        where parameters have no value. The zero function has an empty numerator.
    variable : "q" (discrete), "s" (continuous), or "" for a constant, which fits either.
    Ts : sample time [s]; None where it is not stated (it then fits any), 0 in continuous time.
    """

    numerator: Polynomial
    denominator: Polynomial = poly.ONE
    variable: str = ""
    Ts: float | None = None

    def __post_init__(self) -> None:
        above, below = poly.trimmed(self.numerator), poly.trimmed(self.denominator)
        if not below:
            raise ModelError("a transfer function has the denominator zero; look for a 1/0 in it")
        above, below = _reduced(above, below)
        variable = self.variable if len(above) > 1 or len(below) > 1 else ""
        if self.variable not in ("", "q", "s"):
            raise ModelError(
                f"a transfer function is in q (discrete) or in s (continuous), not in "
                f"{self.variable!r}"
            )
        object.__setattr__(self, "numerator", above)
        object.__setattr__(self, "denominator", below)
        object.__setattr__(self, "variable", variable)
        object.__setattr__(self, "Ts", 0.0 if variable == "s" else self.Ts if variable else None)

    @classmethod
    def shift(cls, Ts: float | None = None) -> Rational:
        """q, the forward shift; ``1 / q`` is a delay of one sample of `Ts` [s]."""
        return cls((Fraction(1), Fraction(0)), poly.ONE, "q", Ts)

    @classmethod
    def derivative(cls) -> Rational:
        """s (the thesis's p), differentiation with respect to time."""
        return cls((Fraction(1), Fraction(0)), poly.ONE, "s")

    # -- values ------------------------------------------------------------------------------

    def at(self, q: Any) -> Any:
        """The value at one point: exact for an int or a Fraction, symbolic for a sympy symbol.

        Raises
        ------
        ModelError
            If the point is a pole.
        """
        point = Fraction(q) if isinstance(q, int) else q
        below = poly.evaluate(self.denominator, point)
        if below == 0:
            raise ModelError(f"{self.variable} = {q} is a pole of {self}; choose another point")
        return poly.evaluate(self.numerator, point) / below

    def response(self, points: Any) -> Array:
        """The values at complex points of the plane of q (or s), an array of the same shape.

        Raises
        ------
        ModelError
            If parameters have no value.
        """
        above, below = (np.array(self._floats(p)) for p in (self.numerator, self.denominator))
        z = np.asarray(points, dtype=complex)
        return np.asarray(np.polyval(above, z) / np.polyval(below, z) + 0j * z)

    def frequency_response(self, omega: Any) -> Array:
        """The values on the frequencies `omega` [rad/s]; [rad/sample] where Ts is not stated."""
        w = np.asarray(omega, dtype=float)
        return self.response(1j * w if self.variable == "s" else np.exp(1j * w * (self.Ts or 1.0)))

    @property
    def direct(self) -> Coefficient:
        """lim of the function at infinity: its direct (algebraic) term.

        Raises
        ------
        ModelError
            If the function is improper.
        """
        if len(self.numerator) < len(self.denominator):
            return Fraction(0)
        if not self.is_proper:
            raise ModelError(
                f"{self} is improper (degree {poly.degree(self.numerator)} over "
                f"{poly.degree(self.denominator)}): it has no limit at infinity. Delay or filter it"
            )
        return self.numerator[0] / self.denominator[0]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the symbols without a value, sorted."""
        found = {
            str(x)
            for c in self.numerator + self.denominator
            if not isinstance(c, Fraction)
            for x in c.free_symbols
        }
        return tuple(sorted(found))

    def substitute(self, values: Mapping[str, Any]) -> Rational:
        """The function with parameters replaced by numbers; names it lacks are ignored."""
        if not self.parameters:
            return self
        given = {n: coefficient(v) for n, v in values.items()}
        above, below = (
            tuple(_replaced(c, given) for c in p) for p in (self.numerator, self.denominator)
        )
        return Rational(above, below, self.variable, self.Ts)

    # -- properties --------------------------------------------------------------------------

    @property
    def is_zero(self) -> bool:
        """Whether the function is identically zero."""
        return not self.numerator

    @property
    def is_proper(self) -> bool:
        """Whether it has a limit at infinity."""
        return len(self.numerator) <= len(self.denominator)

    @property
    def is_strictly_proper(self) -> bool:
        """Whether that limit is zero: no direct term."""
        return len(self.numerator) < len(self.denominator)

    @property
    def relative_degree(self) -> int:
        """Excess of poles over zeros: the delay in samples, negative where improper."""
        return len(self.denominator) - len(self.numerator)

    @property
    def is_stable(self) -> bool:
        """Whether every finite pole is stable; decided exactly (Jury's test).

        Raises
        ------
        ModelError
            If parameters have no value.
        """
        self._floats(self.denominator)
        if self.variable == "s":
            return poly.is_hurwitz(self.denominator)
        return poly.is_schur(self.denominator)

    def poles(self) -> tuple[Root, ...]:
        """The finite poles, largest first; each with its place and stability."""
        return self._roots(self.denominator)

    def zeros(self) -> tuple[Root, ...]:
        """The finite zeros, largest first; each with its place and frequency."""
        return self._roots(self.numerator)

    # -- other forms -------------------------------------------------------------------------

    def expression(self, symbol: Any = None) -> Any:
        """The function as a sympy expression in `symbol` (default: named as the variable)."""
        import sympy

        x = sympy.Symbol(self.variable or "q") if symbol is None else symbol
        above, below = (
            poly.evaluate([sympy.sympify(c) for c in p], x)
            for p in (self.numerator, self.denominator)
        )
        return sympy.sympify(above) / sympy.sympify(below)

    def to_control(self) -> Any:
        """The function as a `control.TransferFunction`; parameters need values."""
        import control

        dt: Any = {"s": 0, "": None}.get(self.variable, self.Ts or True)
        above = self._floats(self.numerator) or [0.0]
        return control.TransferFunction(above, self._floats(self.denominator), dt)

    def __str__(self) -> str:
        return fraction_text(self.numerator, self.denominator, self.variable or "q")

    def __repr__(self) -> str:
        return f"<Rational {self}>"

    # -- arithmetic --------------------------------------------------------------------------

    def __add__(self, other: Any) -> Rational:
        b = rational(other)
        cross = poly.add(
            poly.multiply(self.numerator, b.denominator),
            poly.multiply(b.numerator, self.denominator),
        )
        return Rational(
            cross, poly.multiply(self.denominator, b.denominator), *common_time(self, b)
        )

    def __mul__(self, other: Any) -> Rational:
        b = rational(other)
        return Rational(
            poly.multiply(self.numerator, b.numerator),
            poly.multiply(self.denominator, b.denominator),
            *common_time(self, b),
        )

    def inverse(self) -> Rational:
        """1 / G; it may be improper or unstable, see its properties.

        Raises
        ------
        ModelError
            If the function is zero.
        """
        if self.is_zero:
            raise ModelError("the zero transfer function has no inverse")
        return Rational(self.denominator, self.numerator, self.variable, self.Ts)

    def __neg__(self) -> Rational:
        return self * Fraction(-1)

    def __sub__(self, other: Any) -> Rational:
        return self + -rational(other)

    def __truediv__(self, other: Any) -> Rational:
        return self * rational(other).inverse()

    def __rsub__(self, other: Any) -> Rational:
        return (-self).__add__(other)

    def __rtruediv__(self, other: Any) -> Rational:
        return self.inverse().__mul__(other)

    def __radd__(self, other: Any) -> Rational:
        return self.__add__(other)

    def __rmul__(self, other: Any) -> Rational:
        return self.__mul__(other)

    def __pow__(self, n: int) -> Rational:
        out = Rational(poly.ONE)
        for _ in range(abs(n)):
            out = out * self
        return out.inverse() if n < 0 else out

    def equals(self, other: Any) -> bool:
        """Whether two functions are the same, decided exactly."""
        return (self - rational(other)).is_zero

    # -- inside ------------------------------------------------------------------------------

    def _floats(self, p: Polynomial) -> list[float]:
        if not poly.is_exact(p):
            names = ", ".join(self.parameters)
            raise ModelError(
                f"{self}: no value is given for {names}; give them with substitute({{name: value}})"
            )
        return [float(c) for c in p]

    def _roots(self, p: Polynomial) -> tuple[Root, ...]:
        return roots_of(self._floats(p), self.variable, self.Ts)


def rational(
    value: Any,
    *,
    Ts: float | None = None,
    values: Mapping[str, Any] | None = None,
    variable: str | None = None,
) -> Rational:
    """Read one transfer function.

    Parameters
    ----------
    value : a number; a `Rational`; a sympy expression in q (q**-1, z) or s; a SISO
        `control.TransferFunction` or `control.StateSpace`; a rational CasADi SX expression. Symbols
        other than the variable are parameters.
    Ts : sample time [s] of what does not carry its own.
    values : numbers for parameters; those without stay symbolic.
    variable : name of the symbol that is the shift or s, where its name does not show it.

    Raises
    ------
    ModelError
        If the expression is not rational, both q and s occur, or the object is not SISO.

    Example
    -------
    >>> import casid
    >>> import sympy
    >>> q = sympy.Symbol("q")
    >>> casid.rational(0.5 * q**-1 / (1 - 0.8 * q**-1))
    <Rational 0.5 / (q - 0.8)>
    """
    out = value if isinstance(value, Rational) else Rational(*read(value, variable))
    if values:
        out = out.substitute(values)
    if Ts is not None and out.variable == "q":
        if out.Ts is not None and abs(out.Ts - Ts) > 1e-12 * abs(Ts):
            raise ModelError(
                f"{out} has the sample time {out.Ts:g} s, not {Ts:g} s; resample it, or "
                "leave out Ts"
            )
        out = Rational(out.numerator, out.denominator, "q", Ts)
    return out


def common_time(a: Rational, b: Rational) -> tuple[str, float | None]:
    """Variable and sample time of what is made of both functions.

    Raises
    ------
    ModelError
        If they differ.
    """
    if a.variable and b.variable and a.variable != b.variable:
        raise ModelError(
            f"{a} is in {a.variable} and {b} in {b.variable}; bring both to discrete or both to "
            "continuous time first (control.sample_system)"
        )
    if a.variable == b.variable == "q" and None not in (a.Ts, b.Ts) and a.Ts != b.Ts:
        raise ModelError(
            f"sample times differ: {a} has Ts = {a.Ts:g} s, {b} has Ts = {b.Ts:g} s; resample one"
        )
    return a.variable or b.variable, a.Ts if a.Ts is not None else b.Ts


def _reduced(above: Polynomial, below: Polynomial) -> tuple[Polynomial, Polynomial]:
    if not above:
        return above, poly.ONE
    if poly.is_exact(above + below):
        if len(above) > 1 and len(below) > 1:
            shared = poly.common_divisor(above, below)
            above, below = poly.divide(above, shared)[0], poly.divide(below, shared)[0]
        return tuple(c / below[0] for c in above), poly.monic(below)
    return cancelled(above, below)


def _replaced(c: Coefficient, given: Mapping[str, Any]) -> Coefficient:
    if isinstance(c, Fraction):
        return c
    return coefficient(c.subs({x: given[str(x)] for x in c.free_symbols if str(x) in given}))
