"""Functions that are not rational, as primitives of rational ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Protocol

import casadi as ca

from casid.identifiability.rank.program import UNIT, Terms, added, scaled


class Reader(Protocol):
    """Operations on linear combinations of nodes, of which the functions below are made."""

    def exp(self, a: Terms) -> Terms:
        """exp(a)."""

    def log(self, a: Terms) -> Terms:
        """log(a)."""

    def sqrt(self, a: Terms) -> Terms:
        """sqrt(a)."""

    def sine(self, a: Terms) -> tuple[Terms, Terms]:
        """sin(a) and cos(a)."""

    def sign(self, a: Terms) -> Terms:
        """+1 or -1."""

    def one_over(self, a: Terms) -> Terms:
        """1/a."""

    def times(self, a: Terms, b: Terms) -> Terms:
        """a b."""

    def integral(self, name: str, a: Terms, slope: Terms) -> Terms:
        """A function of `a` with that derivative."""


def _tan(r: Reader, a: Terms) -> Terms:
    sine, cosine = r.sine(a)
    return r.times(sine, r.one_over(cosine))


def _sinh(r: Reader, a: Terms) -> Terms:
    e = r.exp(a)
    return scaled(added(e, r.one_over(e), -1), Fraction(1, 2))


def _cosh(r: Reader, a: Terms) -> Terms:
    e = r.exp(a)
    return scaled(added(e, r.one_over(e)), Fraction(1, 2))


def _tanh(r: Reader, a: Terms) -> Terms:
    e = r.exp(a)
    e = r.times(e, e)
    return r.times(added(e, UNIT, -1), r.one_over(added(e, UNIT)))


def _square(r: Reader, a: Terms) -> Terms:
    return r.times(a, a)


def _asin(r: Reader, a: Terms) -> Terms:
    return r.integral("asin", a, r.one_over(r.sqrt(added(UNIT, _square(r, a), -1))))


def _acos(r: Reader, a: Terms) -> Terms:
    slope = r.one_over(r.sqrt(added(UNIT, _square(r, a), -1)))
    return r.integral("acos", a, scaled(slope, -1))


def _atan(r: Reader, a: Terms) -> Terms:
    return r.integral("atan", a, r.one_over(added(UNIT, _square(r, a))))


def _asinh(r: Reader, a: Terms) -> Terms:
    return r.integral("asinh", a, r.one_over(r.sqrt(added(_square(r, a), UNIT))))


def _acosh(r: Reader, a: Terms) -> Terms:
    return r.integral("acosh", a, r.one_over(r.sqrt(added(_square(r, a), UNIT, -1))))


def _atanh(r: Reader, a: Terms) -> Terms:
    return r.integral("atanh", a, r.one_over(added(UNIT, _square(r, a), -1)))


def _atan2(r: Reader, a: Terms, b: Terms) -> Terms:
    return _atan(r, r.times(a, r.one_over(b)))


def _erf(r: Reader, a: Terms) -> Terms:
    # The factor 2/sqrt(pi) changes no rank.
    return r.integral("erf", a, r.exp(scaled(_square(r, a), -1)))


SPECIAL: Mapping[int, Callable[..., Terms]] = {
    ca.OP_SQRT: lambda r, a: r.sqrt(a),
    ca.OP_EXP: lambda r, a: r.exp(a),
    ca.OP_LOG: lambda r, a: r.log(a),
    ca.OP_LOG1P: lambda r, a: r.log(added(a, UNIT)),
    ca.OP_EXPM1: lambda r, a: added(r.exp(a), UNIT, -1),
    ca.OP_SIN: lambda r, a: r.sine(a)[0],
    ca.OP_COS: lambda r, a: r.sine(a)[1],
    ca.OP_TAN: _tan,
    ca.OP_SINH: _sinh,
    ca.OP_COSH: _cosh,
    ca.OP_TANH: _tanh,
    ca.OP_ASIN: _asin,
    ca.OP_ACOS: _acos,
    ca.OP_ATAN: _atan,
    ca.OP_ATAN2: _atan2,
    ca.OP_ASINH: _asinh,
    ca.OP_ACOSH: _acosh,
    ca.OP_ATANH: _atanh,
    ca.OP_ERF: _erf,
    ca.OP_HYPOT: lambda r, a, b: r.sqrt(added(_square(r, a), _square(r, b))),
    ca.OP_SIGN: lambda r, a: r.sign(a),
    ca.OP_FABS: lambda r, a: r.times(r.sign(a), a),
}
"""CasADi operation -> its immersion, given a reader and the arguments."""
