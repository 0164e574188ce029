"""The spectrum of a residual by autoregressions, and the covariance of least squares under it.

Least squares with sensitivities T and a residual of covariance Gamma have the covariance

    (T'T)^-1 T' Gamma T (T'T)^-1.                                                             (1)

Gamma is that of an autoregression of each output's residual, with the correlation of their
innovations between outputs. Sharp resonances, and noise with a zero in its spectrum, are out of
reach of a window of lags. Order by Schwarz's criterion after Burg's recursion; coefficients by the
restricted likelihood (Patterson and Thompson, Biometrika 58 (1971) 545-554),

    log |Gamma| + log |T' Gamma^-1 T| + r' Gamma^-1 (r - T (T' Gamma^-1 T)^-1 T' Gamma^-1 r),   (2)

which knows what the unknowns take out of a residual: where noise has the frequency and damping of a
decay, that is most of its peak. What a model lacks is no noise: where (2) calls the whole misfit an
excursion of noise in the few directions that the unknowns span, its autoregression would leave a
residual many times as large as the one that there is, and Burg's is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import toeplitz
from scipy.optimize import minimize
from scipy.signal import lfilter, lfiltic
from scipy.stats import chi2, norm
from scipy.stats import t as student

from casid.arrays import TINY, Array, scaled_inverse
from casid.estimation.simulation.minimization import Fit

LARGEST = 40
"""Order of an autoregression, at most; no more than a twentieth of the samples (a heuristic)."""
RESTRICTED = 12
"""Orders of all outputs together up to which (2) is minimised: more have sharper peaks than few
unknowns take away."""
CONVERGED = 1e-2
"""Slope of (2) at which its search ends."""
MOVED = 0.1
"""Standard errors over which (1) is differentiated by its spectrum."""
CONTRADICTED = 0.05
"""Probability of so small a residual below which (2) is not believed (a heuristic)."""
LEAST_FREEDOM, MANY = 3.0, 1e6
"""Degrees of freedom of a variance by (1): below the first t would be all tail, above the second
it is normal."""


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

    def autocovariances(self, samples: int) -> Array:
        """(samples,) E r(t) r(t - k), by Levinson's recursion and then that of the model."""
        g = [self.variance / float(np.prod(1 - self.reflections**2))]
        a = np.zeros(0)
        for k in self.reflections:
            # The reflection coefficient is what the lag's covariance leaves unpredicted.
            error = g[0] + float(a @ g[1:]) if len(a) else g[0]
            g.append(-k * error - float(a @ np.array(g[:0:-1])))
            a = _longer(a, k)
        out = np.zeros(max(samples, len(g)))
        out[: len(g)] = g
        if self.order and samples > len(g):
            state = lfiltic([1.0], np.concatenate([[1.0], a]), g[: -self.order - 1 : -1])
            rest = np.zeros(samples - len(g))
            out[len(g) :] = lfilter([1.0], np.concatenate([[1.0], a]), rest, zi=state)[0]
        return out[:samples]

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

    So too where the residual contradicts that minimum (`_chance_of_less`).

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
    if not found.fun < value(first):
        return models
    best = at(found.x)
    return models if _chance_of_less(best, records) < CONTRADICTED else best


def _chance_of_less(models: Sequence[Autoregression], records: Sequence[Weighted]) -> float:
    """The probability of a sum of squares below that of the residual, if it has these spectra.

    With an orthonormal basis U of the sensitivities the sum of squares has the mean tr(M Gamma)
    and the variance 2 tr((M Gamma)^2), M = 1 - U U': taken for a multiple of chi^2 of these two
    moments (Satterthwaite, Biometrics Bull. 2 (1946) 110-114).
    """
    parts = [part for record in records for part in record]
    basis, _ = np.linalg.qr(np.concatenate([t for _, t in parts]))
    total = mean = half = 0.0
    inner = np.zeros((basis.shape[1], basis.shape[1]))
    begin = 0
    for k, (r, _) in enumerate(parts):
        u = basis[begin : begin + len(r)]
        begin += len(r)
        g = models[k % len(models)].autocovariances(len(r))
        size = next_fast_len(2 * len(r), real=True)
        both_sides = np.concatenate([g, np.zeros(size - 2 * len(r) + 1), g[:0:-1]])
        coloured = irfft(rfft(both_sides)[:, None] * rfft(u, size, axis=0), size, axis=0)[: len(r)]
        pairs = np.arange(len(r), 0, -1) * g**2
        inner += u.T @ coloured
        total += float(r @ r)
        mean += len(r) * g[0]
        half += 2 * pairs.sum() - pairs[0] - 2 * float(np.sum(coloured**2))
    mean -= float(np.trace(inner))
    half += float(np.sum(inner**2))
    freedom = mean**2 / max(half, TINY)
    return float(chi2.cdf(freedom * total / max(mean, TINY), freedom))


def _restricted_likelihood(models: Sequence[Autoregression], records: Sequence[Weighted]) -> float:
    """Half of (2)."""
    value, parts = 0.0, []
    for record in records:
        for m, (r, t) in zip(models, record, strict=True):
            value += 0.5 * m.log_determinant(len(r))
            parts.append(m.whiten(np.column_stack([t, r])))
    whole = np.concatenate(parts)
    size = np.sqrt(np.sum(whole**2, axis=0))
    size[-1] = size[-1] or 1.0
    seen = size > 0
    # The last column of the triangle is the residual: what no sensitivity explains of it stands
    # below those.
    triangle = np.asarray(np.linalg.qr(whole[:, seen] / size[seen], mode="r"))
    logs = np.log(np.maximum(np.abs(np.diag(triangle)[:-1]), TINY)) + np.log(size[seen][:-1])
    left = float(triangle[-1, -1] * size[-1])
    return value + float(np.sum(logs)) + 0.5 * left**2


def residual_autoregressions(fit: Fit, free: Array) -> tuple[list[Autoregression], Array]:
    """Autoregressions of each output's weighted residual, and their innovations' correlation.

    Missing samples of an output are passed over, as if the others followed one another. Outputs
    that do not have the same samples are taken for independent.

    Parameters
    ----------
    free : (n,) bool, False at active bounds.
    """
    return _autoregressions(fit, _weighted(fit), free)


def orders_text(models: Sequence[Autoregression]) -> str:
    """Orders of the outputs' autoregressions in words."""
    return " and ".join(str(m.order) for m in models)


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


def coloured_covariance(fit: Fit, free: Array) -> tuple[Array, list[Autoregression]] | None:
    """(1) of a fit, and its autoregressions by output; None where every residual is white.

    Wider by `student_factors`: intervals of 1.96 standard errors hold what they say. Missing
    samples are passed over as in `residual_autoregressions`.

    Parameters
    ----------
    free : (n,) bool, False at active bounds: those rows and columns are zero.
    """
    weighted = _weighted(fit)
    models, together = _autoregressions(fit, weighted, free)
    if not any(m.order for m in models):
        return None
    n, index = len(fit.x), np.flatnonzero(free)
    own = [t[:, index] for record in weighted for _, t in record]
    inverse = scaled_inverse(np.asarray(sum(t.T @ t for t in own)))
    # Gamma stands between the columns of T (T'T)^-1: formed from T' Gamma T, what a slow residual
    # adds to one unknown would drown the variances of the others in rounding.
    gains = [_transformed([t[:, index] @ inverse for _, t in record]) for record in weighted]

    def under(models: Sequence[Autoregression]) -> Array:
        return np.asarray(sum(_coloured_products(*record, models, together) for record in gains))

    samples = [sum(len(record[i][0]) for record in weighted) for i in range(len(models))]
    wider = student_factors(under, models, samples)
    out = np.zeros((n, n))
    out[np.ix_(index, index)] = under(models) * np.outer(wider, wider)
    return out, models


def residual_products(fit: Fit, free: Array, columns: Sequence[Array]) -> Array:
    """(m, m) C' Gamma C: the covariance of what columns C gather of a fit's weighted residual.

    Parameters
    ----------
    free : (n,) bool, False at active bounds.
    columns : (N, ny, m) of each record; missing samples are passed over.
    """
    models, together = residual_autoregressions(fit, free)
    out = np.zeros((columns[0].shape[2],) * 2)
    for c, d in zip(columns, fit.criterion.data, strict=True):
        there = [c[d.used[:, i], i] for i in range(len(models))]
        out += _coloured_products(*_transformed(there), models, together)
    return out


def student_factors(
    under: Callable[[Sequence[Autoregression]], Array],
    models: Sequence[Autoregression],
    samples: Sequence[int],
) -> Array:
    """(n,) by which standard errors grow because the spectrum in (1) is an estimate.

    What a slow residual does to a constant is known from the few times that it wandered. A variance
    v in (1) that has itself the variance s^2 is as one of 2 v^2 / s^2 degrees of freedom
    (Satterthwaite, Biometrics Bull. 2 (1946) 110-114; Kenward and Roger, Biometrics 53 (1997)
    983-997), with s by the error of the autoregressions' coefficients and innovations. The 95 %
    interval is then that of Student's t; never below `LEAST_FREEDOM`.
    """
    base = np.maximum(np.diag(under(models)), TINY)
    relative = np.zeros(len(base))
    for i, m in enumerate(models):
        for moved in moved_by_errors(m, samples[i]):
            there = [moved if k == i else other for k, other in enumerate(models)]
            relative += (np.log(np.maximum(np.diag(under(there)), TINY) / base) / MOVED) ** 2
    relative = np.nan_to_num(relative, nan=np.inf)
    freedom = np.clip(2.0 / np.maximum(relative, TINY), LEAST_FREEDOM, MANY)
    return np.asarray(student.ppf(0.975, freedom) / norm.ppf(0.975))


def moved_by_errors(m: Autoregression, samples: int) -> Iterator[Autoregression]:
    """An autoregression moved by `MOVED` standard errors in independent directions.

    The covariance of its coefficients from so many samples is that of the inverse of its p
    autocovariances, in closed form (Gohberg and Semencul 1972; Kay, Modern Spectral Estimation,
    1988, section 6.5).
    """
    yield replace(m, variance=m.variance * float(np.exp(MOVED * np.sqrt(2.0 / samples))))
    a = m.coefficients
    if not m.order:
        return
    first, last = toeplitz(np.append(1.0, a[:-1])), toeplitz(a[::-1])
    upper, lower = np.tril(first), np.tril(last)
    values, axes = np.linalg.eigh((upper @ upper.T - lower @ lower.T) / samples)
    for step in (axes * np.sqrt(np.maximum(values, 0.0))).T:
        yield replace(m, reflections=_reflections(a + MOVED * step))


def _reflections(a: Array) -> Array:
    """The reflection coefficients of coefficients (p,), by Levinson's recursion turned round."""
    found = []
    while len(a):
        k = a[-1]
        found.append(k)
        a = (a[:-1] - k * a[:-1][::-1]) / (1 - k**2)
    return np.array(found[::-1])


def _transformed(columns: Sequence[Array]) -> tuple[int, list[Array]]:
    """The size of a transform and those of columns (N, n), one an output."""
    size = next_fast_len(2 * max(len(t) for t in columns), real=True)
    return size, [rfft(t, size, axis=0) for t in columns]


def _coloured_products(
    size: int, lines: Sequence[Array], models: Sequence[Autoregression], together: Array
) -> Array:
    """(n, n) T' Gamma T of the columns T of one record, by their transforms."""
    n = lines[0].shape[1]
    both = np.full(size // 2 + 1, 2.0)
    both[0] = 1.0
    if size % 2 == 0:
        both[-1] = 1.0
    roots = [m.root_spectrum(size)[:, None].conj() * t for m, t in zip(models, lines, strict=True)]
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
