"""A module's frequency response at an estimator's limit, whatever its coefficients are called.

Estimators that write a module differently, B/F or B/A with a denominator common to all inputs, have
different coefficients but one transfer function. Its covariance follows from theirs by linearising.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.algebra.rational import Rational
from casid.arrays import Array
from casid.errors import ModelError
from casid.estimation.prediction_error.polynomial.orders import Layout
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.second_moments import delay_polynomial


@dataclass(frozen=True, slots=True)
class ResponsePoints:
    """Frequencies [rad/s] at which a module is compared, and the names of what is compared.

    Parameters
    ----------
    label : of the module, "G23".
    omega : frequencies; 0 is the static gain.
    Ts : sample time [s].
    """

    label: str
    omega: tuple[float, ...]
    Ts: float

    def __post_init__(self) -> None:
        for w in self.omega:
            if not 0 <= w * self.Ts <= np.pi * (1 + 1e-9):
                raise ModelError(
                    f"frequency {w:g} rad/s; give 0 .. {np.pi / self.Ts:.4g} rad/s, half the "
                    "sampling frequency"
                )

    @property
    def z(self) -> Array:
        """(F,) points on the unit circle."""
        return np.asarray(np.exp(1j * np.array(self.omega) * self.Ts))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the real parts and, off the real axis, of the imaginary parts."""
        made: list[str] = []
        for w in self.omega:
            if w == 0:
                made.append(f"static gain of {self.label}")
            else:
                made += [f"Re {self.label} at {w:.3g} rad/s", f"Im {self.label} at {w:.3g} rad/s"]
        return tuple(made)

    def reals(self, values: Array) -> Array:
        """Complex rows (F, ...) as the real rows that `names` name."""
        rows: list[Array] = []
        for w, value in zip(self.omega, values, strict=True):
            rows += [np.real(value)] if w == 0 else [np.real(value), np.imag(value)]
        return np.array(rows)

    def truth(self, module: Rational) -> dict[str, float]:
        """The response of the true module.

        Raises
        ------
        ModelError
            If it has a pole at one of the frequencies.
        """
        poles = np.array([r.value for r in module.poles()])
        for w, z in zip(self.omega, self.z, strict=True):
            if poles.size and np.min(np.abs(poles - z)) < 1e-9:
                raise ModelError(
                    f"{self.label} has a pole at {w:g} rad/s, where its response is infinite; give "
                    "frequencies=[..] without it"
                )
        values = self.reals(np.asarray(module.response(self.z)))
        return dict(zip(self.names, map(float, values), strict=True))


def with_response(
    found: Asymptotics,
    layout: Layout,
    source: str,
    points: ResponsePoints,
    truth: Mapping[str, Any],
    *,
    lead: int = 0,
) -> Asymptotics:
    """The result with the response of the module from `source`, B/(A F), before its coefficients.

    Parameters
    ----------
    layout : of the coefficients, the n that the result has.
    truth : name -> true response; coefficients have no truth beside it.
    lead : samples by which the output was delayed.
    """
    values, slopes = _response(layout, np.asarray(found.limit, dtype=float), source, points.z)
    ahead = points.z**lead
    values, slopes = values * ahead, slopes * ahead[:, None]
    J = np.vstack([points.reals(slopes), np.eye(layout.n)])
    return Asymptotics(
        found.method,
        (*points.names, *found.names),
        np.concatenate([points.reals(values), found.limit]),
        J @ found.covariance @ J.T,
        found.residual_variance,
        dict(truth),
        found.notes,
    )


def _response(layout: Layout, theta: Array, source: str, z: Array) -> tuple[Array, Array]:
    """G = B/(A F) at z, (F,), and its slopes (F, n)."""
    p, i = layout.split(theta), layout.inputs.index(source)
    A, B, F = (delay_polynomial(c, z) for c in (p.A, p.B[i], p.F[i]))
    G = B / (A * F)
    slopes = np.zeros((len(z), layout.n), dtype=complex)
    place: Sequence[str] = layout.names
    for k in range(1, layout.na + 1):
        slopes[:, place.index(f"a{k}")] = -G * z ** (-k) / A
    for k in range(layout.nk[i], layout.nk[i] + layout.nb[i]):
        slopes[:, place.index(f"b{k}[{source}]")] = z ** (-k) / (A * F)
    for k in range(1, layout.nf[i] + 1):
        slopes[:, place.index(f"f{k}[{source}]")] = -G * z ** (-k) / F
    return G, slopes
