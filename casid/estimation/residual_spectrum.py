"""The spectrum of a residual by autoregressions, and the covariance of least squares under it.

Least squares with sensitivities T and a residual of covariance Gamma have the covariance

    (T'T)^-1 T' Gamma T (T'T)^-1.                                                             (1)

Gamma is that of an autoregression of each output's residual, with the correlation of their
innovations between outputs. Sharp resonances, and noise with a zero in its spectrum, are out of
reach of a window of lags. Order by Schwarz's criterion after Burg's recursion; coefficients by the
restricted likelihood (Patterson and Thompson, Biometrika 58 (1971) 545-554),

    log |Gamma| + log |T' Gamma^-1 T| + r' Gamma^-1 (r - T (T' Gamma^-1 T)^-1 T' Gamma^-1 r),   (2)

which knows what the unknowns take out of a residual: where noise has the frequency and damping of a
decay, that is most of its peak.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.optimize import minimize
from scipy.signal import lfilter

from casid.arrays import TINY, Array
from casid.estimation.simulation.minimization import Fit

LARGEST = 40
"""Order of an autoregression, at most; no more than a twentieth of the samples (a heuristic)."""
RESTRICTED = 12
"""Orders of all outputs together up to which (2) is minimised: more have sharper peaks than few
unknowns take away."""
CONVERGED = 1e-2
"""Slope of (2) at which its search ends."""


@dataclass(frozen=True, slots=True, eq=False)
class Autoregression:
    """a(q) r = e with e white, by its reflection coefficients.

    Attributes
    ----------
    reflections : (p,) within -1..1.
    variance : of e.
    """

    reflections: Array
    variance: float

    @property
    def order(self) -> int:
        """p."""
        return len(self.reflections)

    @property
    def coefficients(self) -> Array:
        """(p,) behind the leading 1 of a."""
        a = np.zeros(0)
        for k in self.reflections:
            a = _longer(a, k)
        return a

    def whiten(self, columns: Array) -> Array:
        """e (N, m) of unit variance of columns (N, m); the first samples from those before them."""
        a, p = np.zeros(0), min(self.order, len(columns))
        shrinks = np.cumprod(1 - self.reflections[::-1] ** 2)[::-1]  # of orders k..p
        first = np.empty((p, columns.shape[1]))
        for k in range(p):
            first[k] = (columns[k] + a @ columns[:k][::-1]) * np.sqrt(shrinks[k])
            a = _longer(a, self.reflections[k])
        out = lfilter(np.concatenate([[1.0], self.coefficients]), [1.0], columns, axis=0)
        out[:p] = first
        return np.asarray(out / np.sqrt(self.variance))

    def log_determinant(self, samples: int) -> float:
        """log det of the covariance of so many samples."""
        shrinks = np.log(np.maximum(1 - self.reflections**2, TINY))
        return float(samples * np.log(self.variance) - np.arange(1, self.order + 1) @ shrinks)

    def root_spectrum(self, size: int) -> Array:
        """(size // 2 + 1,) complex: sd / a(e^iw) on the grid of a real transform."""
        filtered = rfft(np.concatenate([[1.0], self.coefficients]), size)
        return np.asarray(np.sqrt(self.variance) / filtered)


def _longer(a: Array, k: float) -> Array:
    """Coefficients of one order more, by Levinson's recursion."""
    return np.concatenate([a + k * a[::-1], [k]])


def longest_memory(samples: int) -> float:
    """The largest reflection coefficient that so many samples can tell from 1: 1 - 1/N.

    The error of a root next to the unit circle is of order 1/N (Dickey and Fuller, JASA 74 (1979)
    427-431). A smaller distance is chance, and gives the residual a mean of any size.
    """
    return 1 - 1 / max(samples, 2)


def autoregression(residuals: Sequence[Array]) -> Autoregression:
    """The autoregression of one output over all records, (N,) each.

    Burg (1975): reflection coefficients that minimise the errors of prediction forwards and
    backwards, without the taper that blunts sharp resonances.
    """
    count = sum(len(r) for r in residuals)
    forward, backward = [r[1:] for r in residuals], [r[:-1] for r in residuals]
    reflections: list[float] = []
    variance = float(sum(r @ r for r in residuals)) / max(count, 1)
    edge = longest_memory(count)
    best, least = Autoregression(np.zeros(0), variance), count * np.log(max(variance, TINY))
    for p in range(1, min(LARGEST, count // 20) + 1):
        pairs = list(zip(forward, backward, strict=True))
        power = sum(float(f @ f + b @ b) for f, b in pairs)
        k = -2 * sum(float(f @ b) for f, b in pairs) / max(power, TINY)
        k = min(max(k, -edge), edge)
        reflections.append(k)
        variance *= 1 - k**2
        value = count * np.log(max(variance, TINY)) + p * np.log(max(count, 2))
        if value < least:
            best, least = Autoregression(np.array(reflections), variance), value
        forward = [(f + k * b)[1:] for f, b in pairs]
        backward = [(b + k * f)[:-1] for f, b in pairs]
    return best


Weighted = Sequence[tuple[Array, Array]]
"""Of one record: an output's residual (M,) and sensitivities (M, n), at the samples it has."""


def restricted(
    models: Sequence[Autoregression], records: Sequence[Weighted]
) -> list[Autoregression]:
    """Autoregressions of the same orders at the minimum of (2); of high ones, their variances.

    Parameters
    ----------
    models : one an output, where the search starts.
    records : residual and sensitivities of each output.
    """
    count = sum(r.size for record in records for r, _ in record)
    share = count / max(count - records[0][0][1].shape[1], 1)
    models = [replace(m, variance=m.variance * share) for m in models]
    orders = [m.order for m in models]
    if not 0 < sum(orders) <= RESTRICTED:
        return models
    cuts = np.cumsum(orders)[:-1]
    edge, inside = longest_memory(count), 1 - 1e-9
    scales = np.log([max(m.variance, TINY) for m in models])

    def at(z: Array) -> list[Autoregression]:
        reflections = np.split(np.tanh(z[len(models) :]), cuts)
        sizes = np.exp(scales + z[: len(models)]).tolist()
        return [Autoregression(edge * k, v) for k, v in zip(reflections, sizes, strict=True)]

    def value(z: Array) -> float:
        return _restricted_likelihood(at(z), records)

    start = [np.arctanh(np.clip(m.reflections / edge, -inside, inside)) for m in models]
    first = np.concatenate([np.zeros(len(models)), *start])
    found = minimize(value, first, method="BFGS", options={"gtol": CONVERGED, "maxiter": 50})
    return at(found.x) if found.fun < value(first) else models


def _restricted_likelihood(models: Sequence[Autoregression], records: Sequence[Weighted]) -> float:
    """Half of (2)."""
    value, parts = 0.0, []
    for record in records:
        for m, (r, t) in zip(models, record, strict=True):
            value += 0.5 * m.log_determinant(len(r))
            parts.append(m.whiten(np.column_stack([r, t])))
    whole = np.concatenate(parts)
    e, tangent = whole[:, 0], whole[:, 1:]
    size = np.sqrt(np.sum(tangent**2, axis=0))
    seen = size > 0
    q, triangle = np.linalg.qr(tangent[:, seen] / size[seen])
    left = e - q @ (q.T @ e)
    logs = np.log(np.maximum(np.abs(np.diag(triangle)), TINY)) + np.log(size[seen])
    return value + float(np.sum(logs)) + 0.5 * float(left @ left)


def residual_autoregressions(fit: Fit, free: Array) -> tuple[list[Autoregression], Array]:
    """Of the weighted residual of each output of a fit, and the correlation of their innovations.

    Missing samples of an output are passed over, as if the others followed one another. Outputs
    that do not have the same samples are taken for independent.

    Parameters
    ----------
    free : (n,) bool, False at active bounds.
    """
    return _autoregressions(fit, _weighted(fit), free)


def has_same_samples(fit: Fit) -> bool:
    """Whether all outputs of a fit have the same samples."""
    return all(bool((d.used == d.used[:, :1]).all()) for d in fit.criterion.data)


def _weighted(fit: Fit) -> list[Weighted]:
    """Weighted residuals and sensitivities of the samples that there are of each record."""
    out: list[Weighted] = []
    for e, d in enumerate(fit.criterion.data):
        r, t = fit.criterion.columns(fit.x, e)
        there = [d.used[:, i] for i in range(r.shape[1])]
        out.append([(r[k, i], t[k, i]) for i, k in enumerate(there)])
    return out


def _autoregressions(
    fit: Fit, weighted: Sequence[Weighted], free: Array
) -> tuple[list[Autoregression], Array]:
    models = [
        autoregression([record[i][0] for record in weighted]) for i in range(len(weighted[0]))
    ]
    models = restricted(models, [[(r, t[:, free]) for r, t in record] for record in weighted])
    if not has_same_samples(fit):
        return models, np.eye(len(models))
    together = [np.column_stack([r for r, _ in record]) for record in weighted]
    return models, _innovations(together, models)


def coloured_covariance(fit: Fit, free: Array) -> tuple[Array, tuple[int, ...]] | None:
    """(1) of a fit and the orders of its autoregressions; None where every residual is white.

    Missing samples are passed over as in `residual_autoregressions`.

    Parameters
    ----------
    free : (n,) bool, False at active bounds: those rows and columns are zero.
    """
    weighted = _weighted(fit)
    models, together = _autoregressions(fit, weighted, free)
    if not any(m.order for m in models):
        return None
    n, index = len(fit.x), np.flatnonzero(free)
    matrix = sum(t[:, index].T @ t[:, index] for record in weighted for _, t in record)
    d = 1 / np.sqrt(np.maximum(np.diag(matrix), TINY))
    inverse = np.outer(d, d) * np.linalg.pinv(matrix * np.outer(d, d), rcond=1e-13)
    out = np.zeros((n, n))
    # Gamma stands between the columns of T (T'T)^-1: formed from T' Gamma T, what a slow residual
    # adds to one unknown would drown the variances of the others in rounding.
    for record in weighted:
        gains = [(r, t[:, index] @ inverse) for r, t in record]
        out[np.ix_(index, index)] += _coloured_products(gains, models, together)
    return out, tuple(m.order for m in models)


def _coloured_products(
    record: Weighted, models: Sequence[Autoregression], together: Array
) -> Array:
    """(n, n) T' Gamma T of columns T of one record."""
    n = record[0][1].shape[1]
    size = next_fast_len(2 * max(len(t) for _, t in record), real=True)
    both = np.full(size // 2 + 1, 2.0)
    both[0] = 1.0
    if size % 2 == 0:
        both[-1] = 1.0
    roots = [
        m.root_spectrum(size)[:, None].conj() * rfft(t, size, axis=0)
        for m, (_, t) in zip(models, record, strict=True)
    ]
    out = np.zeros((n, n))
    for i, j in zip(*np.nonzero(together), strict=True):
        out += together[i, j] * (roots[i].conj().T @ (both[:, None] * roots[j])).real / size
    return out


def _innovations(residuals: Sequence[Array], models: Sequence[Autoregression]) -> Array:
    """(ny, ny) correlation of the outputs' innovations."""
    parts = []
    for r in residuals:
        columns = [
            np.convolve(r[:, i], np.concatenate([[1.0], m.coefficients]))[: len(r)]
            for i, m in enumerate(models)
        ]
        parts.append(np.column_stack(columns))
    e = np.concatenate(parts)
    product = e.T @ e
    size = np.sqrt(np.maximum(np.diag(product), TINY))
    return np.asarray(product / np.outer(size, size))
