"""A criterion that is no expression: one pass over the data for value, gradient and Hessian."""

from __future__ import annotations

from typing import Any, Protocol

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import OutOfTimeError
from casid.estimation.nlp.solution import Evaluation
from casid.time_limit import no_time_limit


class Criterion(Protocol):
    """What is minimised when the data are too many for a symbolic objective."""

    @property
    def n_constraints(self) -> int:
        """Number of equality constraints of the criterion itself."""
        ...

    def evaluate(self, x: Array) -> Evaluation:
        """Value, gradient, Gauss-Newton matrix and own constraints at `x` (n,), physical units."""
        ...


class Callback(ca.Callback):
    """A NumPy function as a CasADi function."""

    def __init__(self, name: str, function: Any, n_in: list[int], out: list[Any], jac: Any = None):
        ca.Callback.__init__(self)
        self._function, self._n_in, self._out, self._jac = function, n_in, out, jac
        self.construct(name, {})

    def get_n_in(self) -> int:
        """Number of arguments."""
        return len(self._n_in)

    def get_n_out(self) -> int:
        """Number of results."""
        return len(self._out)

    def get_sparsity_in(self, i: int) -> Any:
        """Argument `i` is a dense column."""
        return ca.Sparsity.dense(self._n_in[i], 1)

    def get_sparsity_out(self, i: int) -> Any:
        """Result `i` as it was declared."""
        return self._out[i]

    def eval(self, arguments: Any) -> Any:
        """The NumPy function at these arguments."""
        return self._function(*[np.array(a, dtype=float).ravel() for a in arguments])

    def has_jacobian(self) -> bool:
        """Whether derivatives were given."""
        return self._jac is not None

    def get_jacobian(self, *_: Any) -> Any:
        """The derivatives that were given."""
        return self._jac


# The criterion and its variables come in their natural units: Ipopt need not scale again, and a
# gradient of 1e-8 means that a step would lower the criterion by 1e-16 of its first value.
SCALED_IPOPT: dict[str, Any] = {
    "ipopt.nlp_scaling_method": "none",
    "ipopt.tol": 1e-8,
    "ipopt.acceptable_tol": 1e-6,
    "ipopt.acceptable_iter": 5,
}


def scales_at_start(first: Evaluation, scale: Array) -> tuple[Array, float]:
    """The step that changes the criterion by about itself, for each variable, and that value.

    Kept within a factor of 1000 of the declared scale, where a sensitivity vanishes at the start.
    """
    if not np.isfinite(first.value) or first.value <= 0:
        return scale, 1.0
    curvature = np.diag(first.hessian)
    with np.errstate(all="ignore"):
        natural = np.sqrt(first.value / np.where(curvature > 0, curvature, np.nan))
    natural = np.where(np.isfinite(natural), natural, scale)
    return np.clip(natural, 1e-3 * scale, 1e3 * scale), float(first.value)


class OnePass:
    """A criterion that remembers its last point: value, gradient and Hessian share one pass.

    After `budget` passes, or the time limit, it answers NaN without one, so that a line search
    that finds no descent (a kink) ends at once.
    """

    def __init__(self, criterion: Criterion, budget: int) -> None:
        self.criterion = criterion
        self.budget = budget
        self._key: bytes | None = None
        self._at: Evaluation | None = None

    def __call__(self, point: Array) -> Evaluation:
        key = point.tobytes()
        if self._at is None or key != self._key:
            self.budget -= 1
            if self.budget < 0:
                return self._nothing(len(point))
            try:
                self._key, self._at = key, self.criterion.evaluate(point)
            except OutOfTimeError:
                self._key, self._at = None, None
                return self._nothing(len(point))
        return self._at

    def _nothing(self, n: int) -> Evaluation:
        m, nan = self.criterion.n_constraints, np.full((n, n), np.nan)
        return Evaluation(np.nan, nan[0], nan, np.full(m, np.nan), np.full((m, n), np.nan))

    def judged(self, point: Array) -> Evaluation:
        """The criterion at `point`, whatever was spent."""
        self.budget = max(self.budget, 1)
        with no_time_limit():
            return self(point)
