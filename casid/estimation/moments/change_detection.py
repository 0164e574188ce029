"""When the mean of a sequence of estimates has changed, at a stated rate of false alarms.

A generalised likelihood ratio over the time of the change, with both means and the covariance
unknown: for each of a few widths w the last w vectors are compared with all that came before,

    D_w = mean(last w) - mean(before),
    T_w^2 = D_w' S^-1 D_w / (f(w) + f(n)),   f(n) = (1 + 2 sum_{k<n} (1 - k/n) rho^k)/n,      (1)

where S is the covariance of the n vectors before, with n - 1 degrees of freedom, and f(n) is the
variance of a mean of n terms of a sequence with correlation rho^k, relative to one term. For
Gaussian vectors without serial correlation T^2 is Hotelling's, exactly, for any n: the price of
learning mean and covariance on the way is in its tails. With correlation the degrees of freedom
are those of (n - 1)(1 - rho)/(1 + rho) independent vectors, a usual approximation.

An alarm is raised where the smallest p-value of the widths is below alpha/len(widths). The union
bound (Boole) makes the expected number of alarms at most alpha a step, without any independence
between widths or steps.

Hotelling (1931), Annals of Mathematical Statistics 2, 360-378; Basseville & Nikiforov (1993),
Detection of Abrupt Changes, chapters 2 and 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from casid.arrays import Array
from casid.errors import DataError

WIDTHS = (1, 2, 3, 4, 6, 9, 15)
"""How far back a change is looked for, in steps."""


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """The most significant comparison at one step.

    Attributes
    ----------
    step : number of the vector that was added last, from 0.
    width : vectors after the change.
    statistic : T^2 of (1).
    p_value : of the smallest, times the number of widths, at most 1.
    before, after : (p,) means; covariance : (p, p) of their difference.
    correlation : rho.
    """

    step: int
    width: int
    statistic: float
    p_value: float
    before: Array
    after: Array
    covariance: Array
    correlation: float


class ChangeDetector:
    """Watch the mean of a sequence of vectors.

    Parameters
    ----------
    rate : expected false alarms a step, at most; 1/1440 is one a day for one vector a minute.
    widths : steps that a change is looked for back in.
    training : vectors before the first comparison; a change among them is not detected.
    memory : vectors that are kept at most; None: all. It bounds the time a step takes.

    Raises
    ------
    DataError
        For a rate outside (0, 1), no widths, or too little training.
    """

    def __init__(
        self,
        rate: float,
        *,
        widths: Sequence[int] = WIDTHS,
        training: int = 30,
        memory: int | None = None,
    ) -> None:
        self.rate, self.widths, self.training = float(rate), tuple(sorted(widths)), int(training)
        if not 0.0 < self.rate < 1.0:
            raise DataError(f"{rate!r} false alarms a step. Give a number between 0 and 1.")
        if not self.widths or self.widths[0] < 1:
            raise DataError(f"widths {self.widths}. Give whole numbers of steps, 1 or more.")
        if self.training < 5:
            raise DataError(
                f"{training} vectors of training leave the covariance unknown. Give 20 or more."
            )
        self._memory = memory
        if memory is not None and memory < self.training + self.widths[-1]:
            raise DataError(
                f"memory of {memory} vectors for {training} of training and widths up to "
                f"{self.widths[-1]}. Keep at least {self.training + self.widths[-1]}."
            )
        self.step = -1
        self._vectors: list[Array] = []
        self._scales: list[float] = []

    def restart(self, kept: int = 0) -> None:
        """Learn anew, from the last `kept` vectors on: after an alarm, those after the change."""
        self._vectors = self._vectors[len(self._vectors) - kept :]
        self._scales = self._scales[len(self._scales) - kept :]

    def add(self, vector: ArrayLike, scale: float = 1.0) -> Change | None:
        """Add a vector and return the most significant comparison, or None in training.

        Parameters
        ----------
        vector : (p,) an estimate.
        scale : its variance relative to the others': their own covariances are taken as one matrix
            times this number, so that a rougher sea is no change of load.

        Raises
        ------
        DataError
            If it does not fit those before, or is not finite.
        """
        x = np.atleast_1d(np.asarray(vector, dtype=np.float64))
        if self._vectors and x.shape != self._vectors[0].shape:
            raise DataError(
                f"vector of shape {x.shape} after {self._vectors[0].shape}. Give alike."
            )
        if not np.isfinite(x).all() or not 0.0 < scale < np.inf:
            raise DataError(
                f"estimate {x.tolist()} with relative variance {scale!r}. Leave out windows that "
                "give no finite estimate."
            )
        self.step += 1
        self._vectors.append(x)
        self._scales.append(float(scale))
        if self._memory is not None and len(self._vectors) > self._memory:
            del self._vectors[0], self._scales[0]
        widths = np.array([w for w in self.widths if len(self._vectors) - w >= self.training])
        if not widths.size:
            return None
        found = self._compare(widths)
        return replace(found, p_value=min(1.0, len(self.widths) * found.p_value))

    def is_alarm(self, change: Change | None) -> bool:
        """Whether a comparison is below the level."""
        return change is not None and change.p_value < self.rate

    def _compare(self, widths: Array) -> Change:
        """The most significant width, all of them at once from sums over the vectors so far."""
        from scipy.special import fdtrc

        X, w = np.stack(self._vectors), 1.0 / np.array(self._scales)
        origin = X.mean(axis=0)
        X = X - origin
        N, p = X.shape
        n = N - widths
        total, first = _sums(w)[[*n, N]], _sums(w[:, None] * X)[[*n, N]]
        second = _sums(w[:, None, None] * X[:, :, None] * X[:, None, :])[n]
        weight_before, weight_after = total[:-1], total[-1] - total[:-1]
        before = first[:-1] / weight_before[:, None]
        after = (first[-1] - first[:-1]) / weight_after[:, None]
        outer = before[:, :, None] * before[:, None, :]
        S = (second - weight_before[:, None, None] * outer) / (n - 1)[:, None, None]
        inverse = np.linalg.pinv(S, hermitian=True)
        # Correlation after one step, in units of the covariance, averaged over the directions.
        v = np.sqrt(w[1:] * w[:-1])
        pairs = _sums(v[:, None, None] * X[1:, :, None] * X[:-1, None, :])[n - 1]
        later, earlier = _sums(v[:, None] * X[1:])[n - 1], _sums(v[:, None] * X[:-1])[n - 1]
        lagged = (
            pairs
            - later[:, :, None] * before[:, None, :]
            - before[:, :, None] * earlier[:, None, :]
            + _sums(v)[n - 1][:, None, None] * outer
        )
        share = np.einsum("wij,wji->w", inverse, lagged) / ((n - 1) * p)
        rho = np.clip(share, 0.0, 0.9)
        factor = _grown(widths, rho) / weight_after + _grown(n, rho) / weight_before
        D = after - before
        statistic = np.einsum("wi,wij,wj->w", D, inverse, D) / factor
        degrees = np.maximum((n - 1) * (1 - rho) / (1 + rho), p + 1.0)
        F = statistic * (degrees - p + 1) / (degrees * p)
        level = fdtrc(p, degrees - p + 1, F)
        best = int(np.argmin(level))
        return Change(
            self.step,
            int(widths[best]),
            float(statistic[best]),
            float(level[best]),
            before[best] + origin,
            after[best] + origin,
            factor[best] * S[best],
            float(rho[best]),
        )


def _sums(terms: Array) -> Array:
    """Sums of the first 0, 1, ... terms."""
    return np.concatenate([np.zeros((1, *terms.shape[1:])), np.cumsum(terms, axis=0)])


def _grown(n: Array, rho: Array) -> Array:
    """n f(n) of (1): 1 + 2 sum_{k<n} (1 - k/n) rho^k, in closed form."""
    rest = 1.0 - rho
    return np.asarray(1.0 + 2.0 * (rho / rest - rho * (1.0 - rho**n) / (n * rest**2)))
