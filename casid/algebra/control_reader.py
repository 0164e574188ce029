"""python-control objects read as rational functions; state-space models by Leverrier, exactly."""

from __future__ import annotations

from typing import Any

import numpy as np

from casid.algebra import polynomial as poly
from casid.algebra.coefficients import coefficient
from casid.algebra.leverrier import fractions, transfer_polynomials
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
    above, below = transfer_polynomials(
        *(
            fractions([coefficient(float(x)) for x in np.ravel(M)]).reshape(np.shape(M))
            for M in (system.A, system.B, system.C, system.D)
        )
    )
    return [[(numerator, below, variable, Ts) for numerator in row] for row in above]
