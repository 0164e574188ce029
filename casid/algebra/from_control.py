"""python-control objects as rows of `Rational`; state-space models by Leverrier, exactly."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from casid.algebra import polynomial as poly
from casid.algebra.rational import Rational
from casid.algebra.rational_reader import coefficient
from casid.errors import ModelError

Matrix = list[list[Fraction]]


def entries(system: Any) -> list[list[Rational]]:
    """The transfer functions of a `control.TransferFunction` or `control.StateSpace`, row by row.

    Floats are read as their shortest decimals and the characteristic polynomial is computed
    exactly, so that modes nobody excites or sees cancel.

    Raises
    ------
    ModelError
        If the object is of another kind.
    """
    variable, Ts = ("s", 0.0) if system.dt == 0 else ("q", _sample_time(system.dt))
    if hasattr(system, "num"):
        return [
            [
                Rational(_exact(above), _exact(below), variable, Ts)
                for above, below in zip(tops, bottoms, strict=True)
            ]
            for tops, bottoms in zip(system.num, system.den, strict=True)
        ]
    if hasattr(system, "A"):
        return _state_space(system, variable, Ts)
    raise ModelError(
        f"a control object of type {type(system).__name__} cannot be read; convert it with "
        "control.tf or control.ss"
    )


def _sample_time(dt: Any) -> float | None:
    return None if dt is None or dt is True else float(dt)


def _exact(coefficients: Any) -> poly.Polynomial:
    return poly.trimmed(coefficient(float(c)) for c in coefficients)


def _state_space(system: Any, variable: str, Ts: float | None) -> list[list[Rational]]:
    A, B, C, D = (
        [[coefficient(float(x)) for x in row] for row in M]
        for M in (system.A, system.B, system.C, system.D)
    )
    below, adjugate = _leverrier(A)
    above = [_product(_product(C, M), B) for M in adjugate]  # coefficients of C adj(xI - A) B
    return [
        [
            Rational(
                poly.add(poly.trimmed(M[i][k] for M in above), poly.scale(below, D[i][k])),
                below,
                variable,
                Ts,
            )
            for k in range(len(D[0]))
        ]
        for i in range(len(D))
    ]


def _leverrier(A: Matrix) -> tuple[poly.Polynomial, list[Matrix]]:
    """det(xI - A), and the coefficients of adj(xI - A), descending."""
    n = len(A)
    c, M, below, adjugate = Fraction(1), [[Fraction(0)] * n for _ in range(n)], [Fraction(1)], []
    for k in range(1, n + 1):
        M = _product(A, M)
        for i in range(n):
            M[i][i] += c
        adjugate.append([row[:] for row in M])
        AM = _product(A, M)
        c = -sum((AM[i][i] for i in range(n)), Fraction(0)) / k
        below.append(c)
    return tuple(below), adjugate


def _product(a: Matrix, b: Matrix) -> Matrix:
    return [
        [sum((x * b[k][j] for k, x in enumerate(row) if x), Fraction(0)) for j in range(len(b[0]))]
        for row in a
    ]
