"""How a polynomial model is estimated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from casid.errors import DataError, ModelError
from casid.estimation.nlp.solver import Solver
from casid.estimation.prediction_error.polynomial.model import PolynomialModel
from casid.estimation.prediction_error.polynomial.orders import is_number

Errors = Literal["white", "robust"]


ASSUMES = {
    "white": "white innovations, i.e. a true system in the model set: Linder 2017, (2.54)-(2.56) "
    "with Q = lambda V''",
    "robust": "residuals of short memory, in the model set or not: Linder 2017, (2.54)-(2.56), Q "
    "by a Bartlett sum",
}


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialSettings:
    """How a polynomial model is estimated.

    Attributes
    ----------
    Ts : sample time [s], for spectra and `to_control`.
    discard : first residuals of each record that do not count, at most N - 1
        The filters start from rest, which is wrong for a record cut out of a longer one; so by
        default the longest lag and the time in which 1/(C F) settles to 1 % at the start values
        (at most a fifth of the record) do not count. 0 takes signals as zero before the record
        and counts every residual (conditional least squares).
    errors : "white" for the classical covariance, "robust" for the sandwich
    solver : or its name; default ``Solver("ipopt")``, closed-form least squares for C = D = F = 1.
    start : a model of the same orders to start from; its own start values otherwise.
    throw : raise if no optimum is reached; else return it with `is_converged` False.
    """

    Ts: float = 1.0
    discard: int | None = None
    errors: Errors = "white"
    solver: Solver | str | None = None
    start: PolynomialModel | None = None
    throw: bool = True

    def __post_init__(self) -> None:
        if self.errors not in ASSUMES:
            raise ModelError(f"errors = {self.errors!r}; choose 'white' or 'robust'")
        if not is_number(self.Ts) or self.Ts <= 0:
            raise DataError(f"sample time Ts = {self.Ts!r}; give a number of seconds above 0")
