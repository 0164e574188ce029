"""What stands in for an inverse that is improper or unstable, and how wrong it is.

With f G = I, an approximation f_a = B f has f_a G = B I, B a scalar filter. Whatever G is, its
error at a frequency is |B - 1|.

- delayed: B = q^-d, d the samples that f looks ahead; B = 1/(s/w + 1)^d in continuous time. A delay
  alone does no harm where every other signal can be delayed as well
- mirrored: for a pole p of f that is unstable, B has the all-pass factor (q - p)/(1 - p q), made 1
  at frequency 0: the amplitude is right, the phase is not
- leaky: for a pole p on the edge of stability, the factor (q - p)/(q - r p), r just below one:
  right away from the frequency of p, where G passes nothing on and nothing can be known
- noncausal: B = 1, run over a whole record, unstable poles backward in time; wrong near its ends
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from casid.algebra.rational import Rational
from casid.algebra.roots import Root
from casid.algebra.transfer_matrix import RationalMatrix
from casid.arrays import Array
from casid.errors import ModelError
from casid.unknown_inputs.indirect.blocks import (
    excess,
    frequency_grid,
    is_stable,
    lies_outside,
    unstable_poles,
)


@dataclass(frozen=True, slots=True, eq=False)
class ApproximateInverse:
    """A filter f_a instead of a left inverse: f_a G = B I.

    Attributes
    ----------
    kind : "delayed", "mirrored", "leaky", several of these, or "noncausal".
    f : (n, m) the filter to run forward in time; of "noncausal" the inverse itself, for
        `run_noncausally`.
    B : the scalar filter left.
    band : (low, high) [rad/s] of `error`, [rad/sample] where Ts is not known.
    error : the largest |B - 1| over the band.
    """

    kind: str
    f: RationalMatrix
    B: Rational
    band: tuple[float, float]
    error: float

    def error_at(self, omega: Array) -> Array:
        """(F,) |B - 1| at frequencies [rad/s]."""
        return np.asarray(np.abs(self.B.frequency_response(omega) - 1))

    def good_band(self, tolerance: float = 0.1) -> tuple[float, float] | None:
        """(low, high) [rad/s] up to the band's end, the widest where the error is below tolerance.

        None where it is nowhere.
        """
        w = np.linspace(0.0, self.band[1], 2001)
        edges = np.diff(np.concatenate([[0], self.error_at(w) <= tolerance, [0]]).astype(int))
        first, last = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
        if not len(first):
            return None
        k = int(np.argmax(last - first))
        return float(w[first[k]]), float(w[last[k]])

    def __str__(self) -> str:
        low, high = self.band
        if self.kind == "noncausal":
            return "noncausal, over a whole record: exact but near its ends"
        good = self.good_band()
        where = "nowhere below 10 %" if good is None else f"below 10 % {_span(*good)}"
        return (
            f"{self.kind}: error up to {100 * self.error:.3g} % from {low:.3g} to {high:.3g} rad/s,"
            f" {where}"
        )


def approximations(
    f: RationalMatrix, G: RationalMatrix, band: tuple[float, float] | None = None
) -> tuple[ApproximateInverse, ...]:
    """Filters to use instead of an inverse that is improper or unstable; none if it is neither.

    Parameters
    ----------
    f, G : the inverse, and what it inverts.
    band : (low, high) [rad/s] over which errors are taken; by default up to a tenth of the
        sampling frequency, or the geometric middle of G's poles and zeros; from a twentieth of that
        on where an inverse would integrate.

    Raises
    ------
    ModelError
        If parameters have no value, or the band is empty.
    """
    if f.parameters:
        raise ModelError(
            f"an approximation needs numbers: no value is given for {', '.join(f.parameters)}; "
            "give them with substitute({name: value})"
        )
    if f.is_proper and is_stable(f):
        return ()
    variable, Ts = f.time
    bad = _multiplicities(f)
    edge = [r for r in bad if _is_marginal(r)]
    low, high = band if band is not None else _band(G, f.time, bool(edge))
    if not 0 <= low < high:
        raise ModelError(f"band = {band}; give (low, high) in rad/s with 0 <= low < high")
    mirrored, leaky = Rational.shift() ** 0, Rational.shift() ** 0
    for r in bad:
        if r.value.imag < -1e-12:
            continue  # its conjugate has both
        if r in edge:
            leaky = leaky * _leak(r, max(low, high / 20) / 10)
        else:
            mirrored = mirrored * _all_pass(r)
    at_rest = Fraction(mirrored.at(Fraction(0 if variable == "s" else 1)))
    B = _delay(excess(f), variable, Ts, high) * mirrored * leaky * (1 / at_rest)
    kinds = (
        ("delayed", not f.is_proper),
        ("mirrored", len(edge) < len(bad)),
        ("leaky", bool(edge)),
    )
    name = " and ".join(word for word, is_so in kinds if is_so)
    found = [_approximation(name, _scaled(f, B, bad), B, (low, high))]
    if not edge:
        found.append(_approximation("noncausal", f, Rational.shift() ** 0, (low, high)))
    return tuple(found)


def _span(low: float, high: float) -> str:
    return f"up to {high:.3g} rad/s" if low == 0 else f"from {low:.3g} to {high:.3g} rad/s"


def run_noncausally(f: RationalMatrix, signals: Any) -> tuple[Array, Array]:
    """The output of a filter that may be improper or unstable, over a whole record.

    Parameters
    ----------
    f : (n, m) in q, without poles on the unit circle.
    signals : (N, m) samples.

    Returns
    -------
    (N, n) output, exact but for the ends, and (N,) bool: False there (transients above 1e-3 of what
    they begin with).

    Raises
    ------
    ModelError
        If f is in s, a pole lies on the unit circle (which), or the shapes do not fit.
    """
    from casid.algebra.realisation import matrices
    from casid.linear.filtering.split_dynamics import split_dynamics

    v = np.asarray(signals, dtype=float)
    v = v[:, None] if v.ndim == 1 else v
    variable, Ts = f.time
    if variable == "s":
        raise ModelError("a filter in s cannot run on samples; sample it first (control.c2d)")
    if v.ndim != 2 or v.shape[1] != f.shape[1]:
        raise ModelError(
            f"signals are {v.shape}; give (N, {f.shape[1]}), a column for each of "
            f"{', '.join(f.inputs)}"
        )
    edge = [r for r in unstable_poles(f) if _is_marginal(r)]
    if edge:
        raise ModelError(
            f"the pole {edge[0]} lies on the unit circle, so the filter would drift both ways; "
            "take that frequency out of the model (difference the signals), or measure another"
        )
    ahead = excess(f)
    late = RationalMatrix(
        tuple(tuple(g * Rational.shift(Ts) ** -ahead for g in row) for row in f.rows)
    )
    A, B, C, D = matrices(late)
    split = split_dynamics(A)
    start, end = split.settling()
    y = split.run(v @ B.T) @ C.T + v @ D.T
    N = len(v)
    out = np.zeros((N, f.shape[0]))
    out[: N - ahead] = y[ahead:]
    valid = np.zeros(N, dtype=bool)
    valid[max(start - ahead, 0) : max(N - ahead - end, 0)] = True
    return out, valid


def _approximation(
    kind: str, f: RationalMatrix, B: Rational, band: tuple[float, float]
) -> ApproximateInverse:
    w = np.linspace(*band, 500)
    error = float(np.max(np.abs(B.frequency_response(w) - 1)))
    return ApproximateInverse(kind, f, B, band, error)


def _band(
    G: RationalMatrix, time: tuple[str, float | None], integrates: bool
) -> tuple[float, float]:
    variable, Ts = time
    if variable != "s":
        high = 0.2 * np.pi / (Ts or 1.0)
    else:
        w = frequency_grid([G])
        high = float(np.sqrt(w[0] * w[-1]))
    return (high / 20 if integrates else 0.0), high


def _delay(excess: int, variable: str, Ts: float | None, high: float) -> Rational:
    if excess == 0:
        return Rational.shift() ** 0
    if variable == "s":
        corner = Fraction(f"{10 * high:.3g}")  # a decade above the band
        return (corner / (Rational.derivative() + corner)) ** excess
    return Rational.shift(Ts) ** -excess


def _is_marginal(r: Root) -> bool:
    return abs(r.value.real) < 1e-7 if r.variable == "s" else abs(abs(r.value) - 1) < 1e-7


def _all_pass(r: Root) -> Rational:
    """(q - p)/(1 - p q), for a complex p with its conjugate; (s - p)/(s + p) in continuous time."""
    x = Rational.derivative() if r.variable == "s" else Rational.shift(r.Ts)
    p = r.value
    if abs(p.imag) < 1e-12:
        real = Fraction(repr(p.real))
        return (x - real) / (x + real) if r.variable == "s" else (x - real) / (1 - real * x)
    two, square = Fraction(repr(2 * p.real)), Fraction(repr(abs(p) ** 2))
    if r.variable == "s":
        return (x * x - two * x + square) / (x * x + two * x + square)
    return (x * x - two * x + square) / (square * x * x - two * x + 1)


def _leak(r: Root, corner: float) -> Rational:
    """(q - p)/(q - r p), 1 far away; (s - p)/(s - p + w); for a complex p with its conjugate."""
    if r.variable == "s":
        x, p = Rational.derivative(), complex(0.0, r.value.imag)
        moved = complex(-corner, p.imag)
    else:
        x, p = Rational.shift(r.Ts), r.value / abs(r.value)
        moved = p * max(1 - corner * (r.Ts or 1.0), 0.0)

    def factor(at: complex) -> Rational:
        if abs(p.imag) < 1e-9:
            return x - Fraction(repr(at.real))
        return x * x - Fraction(repr(2 * at.real)) * x + Fraction(repr(abs(at) ** 2))

    gain = Fraction(1)
    if r.variable != "s":  # one at the frequency opposite to p
        gain = Fraction(repr((1 + abs(moved)) / 2)) ** (1 if abs(p.imag) < 1e-9 else 2)
    return factor(p) / factor(moved) * gain


def _scaled(f: RationalMatrix, B: Rational, bad: Sequence[Root]) -> RationalMatrix:
    """B f where B takes the unstable poles `bad` of f out: left out of the denominators.

    Their product would cancel in algebra, but roots in floats leave a remainder.
    """
    rows = tuple(tuple(_mirrored(g, B, bad) for g in row) for row in f.rows)
    return RationalMatrix(rows, f.outputs, f.inputs)


def _mirrored(g: Rational, B: Rational, bad: Sequence[Root]) -> Rational:
    if g.is_zero:
        return g
    kept, others = [], list(bad)  # poles that stay; zeros of B that g has no pole for
    for r in g.poles():
        if not lies_outside(r):
            kept.append(r.value)
        else:
            others.remove(min(others, key=lambda o: abs(o.value - r.value)))
    above = np.polymul([float(c) for c in g.numerator], np.real(np.poly([o.value for o in others])))
    below = np.atleast_1d(np.real(np.poly(kept)))
    start = Rational(_exact(above), _exact(below), g.variable, g.Ts)
    # B without the factors that were taken out: its numerator over the product of all of them.
    out = np.real(np.atleast_1d(np.poly([r.value for r in bad])))
    rest = np.polydiv([float(c) for c in B.numerator], out)[0]
    return start * Rational(_exact(rest), B.denominator, B.variable or g.variable, B.Ts)


def _exact(p: Any) -> tuple[Fraction, ...]:
    return tuple(Fraction(repr(float(c))) for c in np.atleast_1d(p))


def _multiplicities(f: RationalMatrix) -> tuple[Root, ...]:
    """Unstable poles of f, each as often as the entry that has it most often."""
    found: list[Root] = []
    for row in f.rows:
        for g in row:
            spare = list(found)
            for r in g.poles():
                if not lies_outside(r):
                    continue
                near = [k for k in spare if abs(k.value - r.value) < 1e-5 * max(abs(r.value), 1.0)]
                if near:
                    spare.remove(near[0])
                else:
                    found.append(r)
    return tuple(found)
