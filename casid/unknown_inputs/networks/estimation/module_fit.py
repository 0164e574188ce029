"""What every method returns: coefficients of A w_j = sum (B_k/F_k) u_k + .. with a covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from casid.arrays import Array
from casid.estimation.prediction_error.polynomial.orders import Layout, Orders


@dataclass(frozen=True, slots=True, eq=False)
class ModuleFit:
    """Coefficients, in the order of `layout.names`.

    Attributes
    ----------
    layout : of the coefficients; those of C and D are there for methods with a noise model.
    theta : (n,), covariance : (n, n).
    assumes : what the covariance assumes.
    notes : what spoils a number. evidence : label -> a line of a report.
    """

    layout: Layout
    theta: Array
    covariance: Array
    assumes: str
    notes: tuple[str, ...] = ()
    evidence: Mapping[str, str] = field(default_factory=dict)


def without_noise(orders: Orders) -> Orders:
    """The orders of A, B and F alone."""
    return replace(orders, nc=0, nd=0)
