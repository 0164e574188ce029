"""Noise models D v = C e of a measured disturbance: autoregressive moving average.

`arma` fits one to a residual, as refined instrumental variables need in every round (Linder
2017, (2.51)); `Arma.whiten` is their prefilter L = D/C.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from casid.arrays import TINY, Array
from casid.errors import DataError, ModelError
from casid.estimation.cross_moments.moments import Moments, moments
from casid.estimation.prediction_error.polynomial.estimation import prediction_error
from casid.estimation.prediction_error.polynomial.model import PolynomialModel
from casid.estimation.prediction_error.polynomial.orders import Orders, is_stable, settling
from casid.estimation.prediction_error.polynomial.records import records_of
from casid.estimation.prediction_error.polynomial.start_values import long_model, long_order
from casid.linear.stability import largest_root


@dataclass(frozen=True, slots=True, eq=False)
class Arma:
    """v = (ma/ar) e, e white with `variance`; both monic, ascending powers of q^-1.

    Attributes
    ----------
    ar : (na + 1,), ma : (nc + 1,).
    variance : of e, unit of v squared.
    covariance : (na + nc, na + nc) of [ar[1:], ma[1:]].
    fit : the estimate with everything else; None where nothing was estimated.
    """

    ar: Array
    ma: Array
    variance: float
    covariance: Array
    fit: PolynomialModel | None = None

    @property
    def theta(self) -> Array:
        """[ar[1:], ma[1:]], the eta of Linder 2017, (2.51)."""
        return np.concatenate([self.ar[1:], self.ma[1:]])

    @property
    def std_errors(self) -> Array:
        """Standard errors of `theta`."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def is_invertible(self) -> bool:
        """Whether `whiten` is stable: roots of ma inside the unit circle."""
        return is_stable(self.ma)

    @property
    def is_stationary(self) -> bool:
        """Whether v has a finite variance: roots of ar inside the unit circle."""
        return is_stable(self.ar)

    @property
    def is_converged(self) -> bool:
        """Whether the estimate is an optimum."""
        return self.fit is None or self.fit.is_converged

    @property
    def notes(self) -> tuple[str, ...]:
        """Reflected roots, near cancellations."""
        return () if self.fit is None else self.fit.notes

    @property
    def memory(self) -> int:
        """Samples until the start-up transient of `whiten` has fallen to 1 %."""
        return len(self.ar) - 1 + settling(self.ma)

    def whiten(self, x: ArrayLike) -> Array:
        """L x = (ar/ma) x along the first axis, (N,) or (N, m), from rest."""
        from scipy.signal import lfilter

        self._refuse_noninvertible()
        return np.asarray(lfilter(self.ar, self.ma, np.asarray(x, dtype=np.float64), axis=0))

    def colour(self, e: ArrayLike) -> Array:
        """(ma/ar) e along the first axis, from rest: the inverse of `whiten`."""
        from scipy.signal import lfilter

        return np.asarray(lfilter(self.ma, self.ar, np.asarray(e, dtype=np.float64), axis=0))

    def spectrum(self, omega: ArrayLike, Ts: float = 1.0) -> Array:
        """variance |ma/ar|^2 at omega [rad/s]; its mean over 0 .. pi/Ts is the variance of v."""
        z = np.exp(-1j * np.asarray(omega, dtype=np.float64) * Ts)
        polyval = np.polynomial.polynomial.polyval
        return np.asarray(self.variance * np.abs(polyval(z, self.ma) / polyval(z, self.ar)) ** 2)

    def _refuse_noninvertible(self) -> None:
        if not self.is_invertible:
            raise ModelError(
                f"ma has a root of modulus {largest_root(self.ma):.6g}, so L = ar/ma is unstable; "
                "reflect it inside the unit circle (same spectrum), or lower nc"
            )

    def __repr__(self) -> str:
        return f"<Arma({len(self.ar) - 1}, {len(self.ma) - 1}): variance {self.variance:.4g}>"


def arma(
    residual: ArrayLike | Sequence[ArrayLike],
    na: int,
    nc: int,
    *,
    start: Arma | None = None,
    discard: int | None = None,
    throw: bool = True,
) -> Arma:
    """Fit ar v = ma e to a residual by prediction error.

    Parameters
    ----------
    residual : (N,) array of zero mean, or a list of them (records, gaps).
    na, nc : free coefficients of ar and ma; both 0 gives the variance alone.
    start : a previous estimate with the same orders, as inside an iteration.
    discard, throw : as `prediction_error`. Inside an iteration
        ``throw=False`` keeps a short or overfitted residual, whose moving average runs to the unit
        circle, from ending it: see `is_converged`.

    Raises
    ------
    DataError, ModelError, SolveError
        As `casid.estimation.prediction_error.polynomial.estimation.prediction_error`.
    """
    if na == 0 and nc == 0:
        both = np.concatenate([y for y, _ in records_of(residual, None)[0]])
        one = np.ones(1)
        return Arma(one, one.copy(), float(np.mean(both**2)), np.zeros((0, 0)))
    model = prediction_error(
        residual,
        None,
        Orders(na=na, nc=nc),
        start=None if start is None else start.fit,
        discard=discard,
        throw=throw,
    )
    return Arma(model.A, model.C, model.noise_variance, model.covariance, model)


def arma_order(
    residual: ArrayLike | Sequence[ArrayLike], *, largest_na: int = 4, largest_nc: int = 4
) -> Arma:
    """The ARMA model whose order has the smallest BIC up to the orders given.

    All orders are judged by the regressions of Hannan and Rissanen (1982) on the same samples;
    the three best are fitted and judged by their own BIC, again on the same samples.

    Raises
    ------
    DataError, ModelError, SolveError
        As `casid.estimation.prediction_error.polynomial.estimation.prediction_error`.
    """
    data, _ = records_of(residual, None)
    records = [[y] for y, _ in data]
    least = largest_na + largest_nc
    order = long_order([len(y) for y, _ in data], 1, least)
    _, innovations = long_model(records, order)
    lags = max(largest_na, largest_nc)
    parts = [(y[order:], e[order:]) for (y, _), e in zip(data, innovations, strict=True)]
    total = sum(moments({"v": v, "e": e}, lags) for v, e in parts if len(v) > lags)
    if not isinstance(total, Moments) or total.N <= least:
        raise DataError(
            f"{sum(len(y) for y, _ in data)} samples are too few to choose among ARMA orders up to "
            f"({largest_na}, {largest_nc}); give longer records or lower the largest orders"
        )
    count = total.N
    judged = []
    for na in range(largest_na + 1):
        for nc in range(largest_nc + 1):
            place = [*range(1, na + 1), *range(lags + 2, lags + 2 + nc)]
            gram, right = total.gram[np.ix_(place, place)], total.gram[place, 0]
            explained = float(right @ np.linalg.lstsq(gram, right, rcond=1e-12)[0])
            variance = max(float(total.gram[0, 0]) - explained, TINY) / count
            judged.append((count * np.log(variance) + (na + nc) * np.log(count), na, nc))
    finalists = [(na, nc) for _, na, nc in sorted(judged)[:3]]
    fits = [arma(residual, na, nc, throw=False) for na, nc in finalists]
    discard = max([0, *(max(f.fit.discarded) for f in fits if f.fit is not None)])

    def bic(fit: Arma) -> float:
        if fit.fit is None:
            return count_bic(np.concatenate([y[discard:] for y, _ in data]), 0)
        residuals = np.concatenate([r[discard:] for r in fit.fit.residuals])
        return count_bic(residuals, fit.fit.n) if fit.is_converged else np.inf

    def count_bic(e: Array, n: int) -> float:
        return float(len(e) * np.log(e @ e / len(e)) + n * np.log(len(e)))

    return min(fits, key=bic)
