"""python-control objects read as rational functions; state-space models by Leverrier, exactly."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from casid.algebra import polynomial as poly
from casid.algebra.coefficients import coefficient
from casid.algebra.leverrier import faddeev_leverrier
from casid.algebra.polynomial import Polynomial
from casid.errors import ModelError

Entry = tuple[Polynomial, Polynomial, str, float | None]


def control_entries(system: Any) -> list[list[Entry]]:
    """The entries of a `control.TransferFunction` or `control.StateSpace`, row by row.

    Numerator, denominator, variable and sample time of each. Floats are read as their shortest
    decimals and the characteristic polynomial is computed exactly, so that modes that are not
    controllable or not observable cancel.

    Raises
    ------
    ModelError
        If the object is of another kind.
    """
    variable, Ts = ("s", 0.0) if system.dt == 0 else ("q", _sample_time(system.dt))
    if hasattr(system, "num"):
        return [
            [
                (_exact(above), _exact(below), variable, Ts)
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


def _exact(coefficients: Any) -> Polynomial:
    return poly.trimmed(coefficient(float(c)) for c in coefficients)


def _state_space(system: Any, variable: str, Ts: float | None) -> list[list[Entry]]:
    A, B, C, D = (
        np.array([coefficient(float(x)) for x in np.ravel(M)], dtype=object).reshape(np.shape(M))
        for M in (system.A, system.B, system.C, system.D)
    )
    eye = np.array([[Fraction(int(i == k)) for k in range(len(A))] for i in range(len(A))])
    below, adjugate = faddeev_leverrier(A, eye.reshape(A.shape), Fraction(1), np.trace)
    above = [C @ M @ B for M in adjugate]
    return [
        [
            (
                poly.add(poly.trimmed(M[i, k] for M in above), poly.scale(tuple(below), D[i, k])),
                tuple(below),
                variable,
                Ts,
            )
            for k in range(D.shape[1])
        ]
        for i in range(len(D))
    ]
