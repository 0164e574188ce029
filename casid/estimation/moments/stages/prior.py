"""Known values of parameters with their uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.errors import ModelError
from casid.model.model import Model
from casid.model.units import difference_to_si


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Known values that are uncertain: a tilting test, a data sheet.

    Attributes
    ----------
    values : parameter -> value, in its unit.
    covariance : (n, n) in the order of `values`, in products of their units; or a mapping of
        parameter -> standard error, in its unit.
    """

    values: Mapping[str, float]
    covariance: Array | Mapping[str, float] | None = None

    def in_si(self, model: Model) -> Prior:
        """The prior with its numbers in SI, given in the units that `model` declares.

        Raises
        ------
        ModelError
            For a parameter that the model does not have, or as `matrix`.
        """
        if model.takes_si:
            return self
        scale = np.array(
            [float(difference_to_si(1.0, model.unit_of(name))) for name in self.values]
        )
        return Prior(model.in_si(self.values), self.matrix() * np.outer(scale, scale))

    def matrix(self) -> Array:
        """Covariance, (n, n).

        Raises
        ------
        ModelError
            If its shape does not fit, or it is no covariance.
        """
        n = len(self.values)
        if self.covariance is None:
            return np.zeros((n, n))
        if isinstance(self.covariance, Mapping):
            foreign = [k for k in self.covariance if k not in self.values]
            if foreign:
                raise ModelError(
                    f"prior: a standard error for {foreign[0]}, which has no value; give it one"
                )
            return np.diag([float(self.covariance.get(k, 0.0)) ** 2 for k in self.values])
        matrix = np.asarray(self.covariance, dtype=float)
        if matrix.shape != (n, n) or not np.allclose(matrix, matrix.T):
            raise ModelError(
                f"prior: covariance of shape {matrix.shape} for {n} values; give a symmetric "
                f"({n}, {n}) matrix in the order {', '.join(self.values)}"
            )
        if np.min(np.linalg.eigvalsh(matrix), initial=0.0) < -1e-9 * np.max(
            np.abs(matrix), initial=0.0
        ):
            raise ModelError("prior: the covariance has a negative eigenvalue; check its signs")
        return matrix

    def __repr__(self) -> str:
        values = ", ".join(f"{name} = {value:.5g}" for name, value in self.values.items())
        return f"<Prior {values}>"
