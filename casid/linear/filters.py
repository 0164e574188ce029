"""Filters from one signal to another, as rational functions of q^-1.

A filter may be written as a number, as a pair (b, a) of polynomials in ascending powers of q^-1
(one input, one output), as a `casid.algebra.rational.Rational` in q, or as a discrete
python-control system.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.errors import ModelError
from casid.linear.stability import LAST_STABLE, largest_root, modulus_text


@dataclass(frozen=True, slots=True, eq=False)
class Filter:
    """b(q^-1) / a(q^-1), coefficients in ascending powers, a[0] not zero.

    Attributes
    ----------
    b, a : (nb,), (na,) real; index = lag in samples.
    Ts : sample time [s], None where none was given.
    lead : samples of the future that it uses: z^lead times b/a.
    """

    b: Array
    a: Array
    Ts: float | None = None
    lead: int = 0

    def __call__(self, z: Array) -> Array:
        """Values of the filter at the points z (M,), complex (M,)."""
        back = 1 / z
        above = np.polynomial.polynomial.polyval(back, self.b)
        if self.lead:
            above = above * z**self.lead
        if len(self.a) == 1:  # no poles, and none of their rounding
            return np.asarray(above / self.a[0])
        return np.asarray(above / np.polynomial.polynomial.polyval(back, self.a))

    @property
    def poles(self) -> Array:
        """Roots in z of a; those at the origin are left out."""
        return np.asarray(np.roots(self.a))

    @property
    def reach(self) -> int:
        """Samples that its polynomials reach back, and ahead."""
        return max(len(self.a), len(self.b)) - 1 + self.lead

    @property
    def radius(self) -> float:
        """Largest modulus of a pole, 0 without one."""
        return largest_root(self.a)


def lag(samples: int) -> Filter:
    """A delay of so many samples."""
    return Filter(np.concatenate([np.zeros(samples), [1.0]]), np.ones(1))


def as_filter(value: Any, where: str, *, noncausal: bool = False) -> Filter:
    """A filter as written: a number, a pair (b, a), a `Filter` or a python-control system.

    Parameters
    ----------
    value : see the module.
    where : names the filter in messages, such as "y: filter of u".
    noncausal : whether it may be improper, that is use the future.

    Raises
    ------
    ModelError
        If it is none of these, is not proper or not finite, or is of continuous time.
    """
    if isinstance(value, Filter):
        return value
    if hasattr(value, "isdtime") and hasattr(value, "dt"):
        return _from_control(value, where, noncausal)
    if isinstance(getattr(value, "variable", None), str):
        return _from_rational(value, where, noncausal)
    try:
        if isinstance(value, tuple) and len(value) == 2:
            b, a = (np.atleast_1d(np.asarray(v, dtype=float)) for v in value)
        else:
            b, a = np.asarray([float(value)]), np.ones(1)
    except (TypeError, ValueError):
        raise ModelError(
            f"{where} is {value!r}; give a number, a pair ([b0, b1, ..], [1, a1, ..]) of "
            "polynomials in q^-1, a Rational in q, or a discrete python-control system"
        ) from None
    if b.ndim != 1 or a.ndim != 1 or not len(b) or not len(a):
        raise ModelError(
            f"{where} has polynomials of shapes {b.shape} and {a.shape}; give two lists of numbers"
        )
    if not (np.all(np.isfinite(b)) and np.all(np.isfinite(a))):
        raise ModelError(f"{where} has coefficients that are not finite; give finite numbers")
    lead = int(np.argmax(a != 0)) if np.any(a) else len(a)
    if lead and (not noncausal or lead == len(a)):
        raise ModelError(
            f"{where} has a denominator in q^-1 that begins with 0, so the filter needs the "
            "future; take the common delay out of both polynomials"
        )
    return Filter(b, a[lead:], None, lead)


def _from_control(system: Any, where: str, noncausal: bool) -> Filter:
    """A discrete single-input single-output python-control system in powers of q^-1.

    In floats: read exactly (`casid.algebra.rational_reader`), sixty coefficients take seconds.
    """
    import control

    if not system.isdtime(strict=True):
        raise ModelError(
            f"{where} is of continuous time; sample it first, control.sample_system(G, Ts)"
        )
    if system.ninputs != 1 or system.noutputs != 1:
        raise ModelError(
            f"{where} has {system.ninputs} inputs and {system.noutputs} outputs; give one filter "
            "for each source, as G[0, 1]"
        )
    transfer = control.tf(system)
    num, den = (
        np.trim_zeros(np.asarray(p[0][0], float), "f") for p in (transfer.num, transfer.den)
    )
    return _descending(num, den, None if system.dt is True else float(system.dt), where, noncausal)


def _from_rational(value: Any, where: str, noncausal: bool) -> Filter:
    """A rational function in q with numbers."""
    if value.parameters:
        raise ModelError(
            f"{where} has the symbols {', '.join(value.parameters)}; put numbers in their place, "
            "G.substitute({..})"
        )
    if value.variable == "s":
        raise ModelError(f"{where} is of continuous time; give its discrete form in q")
    num, den = (np.array([float(c) for c in p]) for p in (value.numerator, value.denominator))
    return _descending(num, den, value.Ts, where, noncausal)


def _descending(num: Array, den: Array, Ts: float | None, where: str, noncausal: bool) -> Filter:
    """A filter from polynomials in descending powers of q, which begin with no zero."""
    lead = len(num) - len(den)
    if lead > 0 and not noncausal:
        raise ModelError(
            f"{where} is improper (degree {len(num) - 1} over {len(den) - 1}): it needs the "
            "future; delay it by multiplying with z^-k, or, for a signal that is made of a record "
            "afterwards, allow it: system.with_signals({..}, noncausal=True)"
        )
    delayed = np.concatenate([np.zeros(max(-lead, 0)), num])
    return Filter(delayed if len(num) else np.zeros(1), den, Ts, max(lead, 0))


def require_stable(filter: Filter, where: str) -> None:
    """Refuse a filter whose response to noise is not stationary.

    Raises
    ------
    ModelError
        If a pole lies on or outside the unit circle; the message names it.
    """
    poles = filter.poles
    if filter.radius < LAST_STABLE:
        return
    worst = poles[np.argmax(np.abs(poles))]
    shown = f"{worst.real:.4g}" + (f" +- {abs(worst.imag):.4g}i" if worst.imag else "")
    raise ModelError(
        f"{where} has a pole at z = {shown}, {modulus_text(abs(worst))}: the signal is not "
        "stationary and an estimate has no limit. Give the stable closed loop's filters from the "
        "externals, or difference the signal"
    )
