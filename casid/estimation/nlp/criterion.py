"""A criterion that is no expression: one pass over the data for value, gradient and Hessian."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import casadi as ca
import numpy as np

from casid.arrays import TINY, Array
from casid.errors import OutOfTimeError
from casid.estimation.nlp.solution import Evaluation
from casid.estimation.nlp.solver import LEADS_TO_KNOWN
from casid.time_limit import no_time_limit


class Criterion(Protocol):
    """What is minimised when the data are too many for a symbolic objective.

    One that has a method `value_alone` gives its value at `x` (n,) by it, in less time than with
    its derivatives; it has no constraints then.
    """

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


PUSHED = 1e-2
"""Of a variable's scale: a start that is nearer to a bound is moved away from it by Ipopt, to so
much inside of it (its `bound_push`)."""


def scales_at_start(first: Evaluation, scale: Array, room: Array) -> tuple[Array, float]:
    """The step that changes the criterion by about itself, for each variable, and that value.

    Kept within a factor of 1000 of the declared scale, where a sensitivity vanishes at the start;
    and no larger than leaves the start where it is, as the declared scale may not. `room` (n,) is
    its distance from the nearer bound.
    """
    if not np.isfinite(first.value) or first.value <= 0:
        return scale, 1.0
    curvature = np.diag(first.hessian)
    with np.errstate(all="ignore"):
        natural = np.sqrt(first.value / np.where(curvature > 0, curvature, np.nan))
    natural = np.where(np.isfinite(natural), natural, scale)
    most = np.minimum(1e3 * scale, np.maximum(scale, room / PUSHED))
    return np.clip(natural, 1e-3 * scale, most), float(first.value)


PATIENCE = 60
"""Shortened steps within which a criterion has to fall: half of a half, a step is rounded off to
nothing after 53 of them."""

PATIENCE_NEAR = 21
"""The same where a barrier weighs no more than `FALL` from the start. The steps are then those of
Gauss and Newton, along which a sum of squares falls by less than a step's share of twice its value:
halved so often, by less than `FALL`."""

FALL = 1e-6
"""By this share of its value: over 1e5 samples a twentieth of a unit of the log-likelihood."""

STALLED = 5
"""Steps that together have to lower a criterion by more than is enough (`Solver.enough`)."""

LEADS = 0.2
"""Of the way to a known minimum that a step of Gauss and Newton may end beside it, both measured by
the curvature: at each of two steps in a row by no more, there is hardly a second minimum between.
Within a tenth of the way, a search for a part that swings or a dead time ends at the known one as
well (all refits of a diagnosis of `problems/emps.py`)."""


class OnePass:
    """A criterion that remembers its last point: value, gradient and Hessian share one pass.

    A solver that goes on to another point without having requested derivatives is shortening a
    step: from there to where it asks again it gets the `value_alone` of a criterion that has one.

    After `budget` passes, or the time limit, or `patience` shortened steps in which it did not
    fall, there are no values any more: at a kink a search would go on to steps that round to none.
    The same where `enough` (`Solver.enough`) is reached, where in `steps` steps `below` will not be
    (`Solver.below`), or where the steps lead to a `known` minimum (`Solver.known`).

    Attributes
    ----------
    ending : why there are no values any more, by the names of Ipopt's endings, or empty.
    lowest, best : the lowest value so far, and where it was.
    """

    def __init__(
        self,
        criterion: Criterion,
        budget: int,
        *,
        patience: float = np.inf,
        enough: float = 0.0,
        below: float = np.inf,
        known: Sequence[float] = (),
        steps: int = 0,
    ) -> None:
        self.criterion = criterion
        self.budget, self.patience, self.enough = budget, patience, enough
        self.below, self.steps = below, steps
        self.known, self._leading, self._led = np.array(known), 0, b""
        self._taken: list[float] = []  # values at the steps taken
        self.ending = ""
        self.lowest, self.best = np.inf, np.zeros(0)
        self._alone: Callable[[Array], float] | None = getattr(criterion, "value_alone", None)
        self._shortened, self._level = 0, np.inf  # steps since it fell, and to where
        self._key: bytes | None = None
        self._value = np.nan
        self._at: Evaluation | None = None
        self._is_met = True  # derivatives were requested at the last point

    def value(self, point: Array) -> float:
        """The criterion at a point; NaN once it has ended."""
        key = point.tobytes()
        if not self._is_met and key != self._key:
            self._shortened += 1
        if self._is_met or self._alone is None:
            value = self._passed(point).value
            self._is_met = False
            return value
        if key != self._key:
            if self._is_ended():
                return np.nan
            try:
                self._value, self._at, self._key = self._alone(point), None, key
            except OutOfTimeError:
                self.ending = "Maximum_WallTime_Exceeded"
                return np.nan
            self._count(self._value, point)
        return self._value

    def __call__(self, point: Array) -> Evaluation:
        """What the criterion is at a point; nothing finite once it has ended."""
        at = self._passed(point)
        if self.enough and not self._is_met:
            self._judge_step(at, point)
        self._is_met = True
        return at

    def _judge_step(self, at: Evaluation, point: Array) -> None:
        """End the search where the steps from here would lower the criterion by too little."""
        self._taken.append(at.value)
        least = self.enough * abs(at.value)
        step, fall = _step(at)
        if not self.ending and fall <= least:
            self.ending = "Solve_Succeeded"
        is_new, self._led = point.tobytes() != self._led, point.tobytes()
        if not self.ending and len(self.known) and is_new and np.isfinite(fall):
            beside, way = (
                float(d @ at.hessian @ d) for d in (point + step - self.known, point - self.known)
            )
            self._leading = self._leading + 1 if beside <= LEADS**2 * way else 0
            if self._leading == 2:
                self.ending = LEADS_TO_KNOWN
        before = self._taken[-1 - STALLED :]
        if self.ending or len(before) <= STALLED:
            return
        fall = before[0] - self.lowest
        to_come = fall / STALLED * max(self.steps - len(self._taken), 0)
        if fall <= least or self.lowest - to_come > self.below:
            self.ending = "Search_Direction_Becomes_Too_Small"

    def _passed(self, point: Array) -> Evaluation:
        key = point.tobytes()
        is_new = key != self._key
        if self._at is None or is_new:
            if self.ending or (is_new and self._is_ended()):
                return self._nothing(len(point))
            try:
                self._at, self._key = self.criterion.evaluate(point), key
            except OutOfTimeError:
                self._at, self.ending = None, "Maximum_WallTime_Exceeded"
                return self._nothing(len(point))
            self._value = self._at.value
            if is_new:
                self._count(self._value, point)
        return self._at

    def _is_ended(self) -> bool:
        """Count one pass more; True if it is one too many."""
        self.budget -= 1
        if self.budget < 0 or self._shortened > self.patience:
            self.ending = self.ending or "Search_Direction_Becomes_Too_Small"
        return bool(self.ending)

    def _count(self, value: float, point: Array) -> None:
        """Keep the lowest value, and note whether the criterion fell."""
        if self._level - value > FALL * abs(value):
            self._level, self._shortened = value, 0
        if value < self.lowest:
            self.lowest, self.best = value, point

    def _nothing(self, n: int) -> Evaluation:
        m, nan = self.criterion.n_constraints, np.full((n, n), np.nan)
        return Evaluation(np.nan, nan[0], nan, np.full(m, np.nan), np.full((m, n), np.nan))

    def judged(self, point: Array) -> Evaluation:
        """The criterion at `point`, whatever was spent."""
        self.budget, self._shortened, ending = max(self.budget, 1), 0, self.ending
        self.ending = ""
        with no_time_limit():
            at = self(point)
        self.ending = ending
        return at


def _step(at: Evaluation) -> tuple[Array, float]:
    """A step of Gauss and Newton, and what it would lower a sum of squares by.

    Infinite if it has none.
    """
    if not all(np.all(np.isfinite(v)) for v in (at.value, at.gradient, at.hessian)):
        return np.zeros_like(at.gradient), np.inf
    unit = np.sqrt(np.maximum(np.diag(at.hessian), TINY))
    curvature, slope = at.hessian / np.outer(unit, unit), at.gradient / unit
    step = np.linalg.lstsq(curvature, slope, rcond=None)[0]
    return -step / unit, float(0.5 * slope @ step)
