"""Covariance of an estimate whose residuals are neither white nor of known variance.

The sandwich  P = H^-1 (sum_{|l| <= L} w_l Gamma_l) H^-1  of the scores s_k = J_k' r_k, with
Gamma_l = sum_k s_k s_{k-l}' and Bartlett weights w_l = 1 - |l|/(L+1), is consistent for
autocorrelated and heteroscedastic residuals (Newey and West 1987); the number of lags L follows
Andrews (1991, (6.2) and (6.4)) from first-order autoregressions of the scores.

The residuals r of a fit are (I - J H^-1 J') e of the errors e: where few samples determine an
unknown, the fit takes most of the error out of just these, and the sum of their scores is nearly
zero. Under white errors of variance s^2 the sum above lacks on average

    s^2 sum_{|l| <= L} w_l sum_k A_k H^-1 A_{k-l},    A_k = J_k' J_k,                           (1)

which `taken_by_fit` gives back: with no lags that is the bias which MacKinnon and White (1985)
remove sample by sample.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import TINY, Array, require_finite, scaled_inverse


def bartlett_lags(scores: Array, *, largest: int | None = None) -> int:
    """Number of lags for a Bartlett kernel from the scores' own memory (Andrews 1991).

    Parameters
    ----------
    scores : (N, K) array, one column a score.
    largest : upper limit, default N / 4.
    """
    n = len(scores)
    if n < 8:
        return 0
    centred = scores - scores.mean(axis=0)
    variance = np.einsum("ij,ij->j", centred, centred)
    keep = variance > 1e-14 * max(float(variance.max(initial=0.0)), TINY)
    if not keep.any():
        return 0
    rho = np.einsum("ij,ij->j", centred[1:], centred[:-1])[keep] / variance[keep]
    rho = np.clip(rho, -0.995, 0.995)
    # All columns weigh the same once standardised: sigma_j^2 = (1 - rho_j^2).
    innovation = 1 - rho**2
    top = np.sum(4 * rho**2 * innovation**2 / ((1 - rho) ** 6 * (1 + rho) ** 2))
    bottom = np.sum(innovation**2 / (1 - rho) ** 4)
    lags = int(np.ceil(1.1447 * (top / bottom * n) ** (1 / 3)))
    return int(np.clip(lags, 0, largest if largest is not None else n // 4))


def long_run_covariance(scores: Array, lags: int) -> Array:
    """Bartlett estimate of the covariance of the sum of the scores, (K, K).

    Parameters
    ----------
    scores : (N, K) array, centred here.
    lags : lags with weight above zero.
    """
    n, columns = scores.shape
    if lags == 0:
        centred = scores - scores.mean(axis=0)
        return np.asarray(centred.T @ centred)
    # sum_l w_l Gamma_l = sum of outer products of moving sums over lags + 1 samples, / (lags + 1).
    cumulative = np.zeros((n + 1, columns))
    np.subtract(scores, scores.mean(axis=0), out=cumulative[1:])
    np.cumsum(cumulative[1:], axis=0, out=cumulative[1:])
    total = np.zeros((columns, columns))
    # Some windows at a time: all of them together are as large as the scores.
    for first in range(0, n + lags, 1 << 13):
        last = np.arange(first, min(first + (1 << 13), n + lags)) + 1
        window = cumulative[np.minimum(last, n)] - cumulative[np.maximum(last - 1 - lags, 0)]
        total += window.T @ window
    return np.asarray(total / (lags + 1))


def sandwich(
    hessian: Array, scores: Array, free: Array, constraint_jacobian: Array | None = None
) -> tuple[Array, int]:
    """Covariance of an estimate, (n, n), and the lags used.

    Parameters
    ----------
    hessian : (n, n) Gauss-Newton matrix J'J.
    scores : (N, n) per-sample scores J_k' r_k.
    free : (n,) bool, False at active bounds: those rows and columns are zero.
    constraint_jacobian : (m, n) of the equality constraints: the estimate moves in its null space.

    Raises
    ------
    SolveError
        If either is not finite.

    Notes
    -----
    Assumes residuals of zero mean and memory short against the record; see the module docstring.
    """
    require_finite("the derivatives of the criterion", hessian, scores)
    inverse, fitted = _inverse(hessian, free, constraint_jacobian)
    lags = _lags(scores, free)
    covariance = inverse @ long_run_covariance(scores, lags) @ inverse
    # Fitted residuals are smaller than the errors: the usual degrees-of-freedom factor.
    count = len(scores)
    return covariance * (count / max(count - fitted, 1)), lags


def _lags(scores: Array, free: Array) -> int:
    """Lags of the Bartlett kernel by the scores (N, n) of what is free."""
    return bartlett_lags(scores[:, np.flatnonzero(free)]) if np.any(free) else 0


def _inverse(
    hessian: Array, free: Array, constraint_jacobian: Array | None = None
) -> tuple[Array, int]:
    """H^-1 in the directions that are free and keep the constraints, (n, n), and their number."""
    index = np.flatnonzero(free)
    basis = np.eye(len(hessian))[:, index]
    if constraint_jacobian is not None and constraint_jacobian.size:
        _, s, vt = np.linalg.svd(constraint_jacobian[:, index])
        rank = int(np.sum(s > 1e-10 * s.max(initial=0.0)))
        basis = basis @ vt[rank:].T
    return basis @ scaled_inverse(basis.T @ hessian @ basis) @ basis.T, basis.shape[1]


def robust_covariance(
    residuals: Sequence[Array],
    jacobians: Sequence[Array],
    hessian: Array,
    free: Array,
    constraint_jacobian: Array | None = None,
) -> tuple[Array, int]:
    """Covariance of a least-squares estimate, (n, n), with (1), and the lags used.

    Parameters
    ----------
    residuals, jacobians : (N, ny) and (N, ny, n) of each record, of unit weight; zero where no
        sample is.
    hessian, free, constraint_jacobian : as of `sandwich`.

    Raises
    ------
    SolveError
        If one of the derivatives is not finite.
    """
    parts = [np.einsum("ki,kin->kn", r, j) for r, j in zip(residuals, jacobians, strict=True)]
    scores = np.concatenate(parts)
    require_finite("the derivatives of the criterion", hessian, scores)
    inverse, fitted = _inverse(hessian, free, constraint_jacobian)
    lags = _lags(scores, free)
    samples = sum(int(np.count_nonzero(np.any(j, axis=2))) for j in jacobians)
    variance = sum(float(np.sum(r**2)) for r in residuals) / max(samples - fitted, 1)
    taken = sum(taken_by_fit(j, inverse, lags) for j in jacobians)
    meat = long_run_covariance(scores, lags) + variance * taken
    return np.asarray(inverse @ meat @ inverse), lags


def taken_by_fit(jacobian: Array, inverse: Array, lags: int) -> Array:
    """What (1) gives back for errors of unit variance, (n, n).

    Parameters
    ----------
    jacobian : (N, ny, n) of one record.
    inverse : (n, n) H^-1.
    """
    samples, _, n = jacobian.shape
    total = np.zeros((n, n))
    # As in `long_run_covariance`: a sum of products of moving sums, some windows at a time.
    length = min(lags, samples - 1) + 1
    for first in range(0, samples + length - 1, 1 << 11):
        last = np.arange(first, min(first + (1 << 11), samples + length - 1)) + 1
        start = max(first + 1 - length, 0)
        part = jacobian[start : last[-1]]
        information = np.einsum("kin,kim->knm", part, part)
        sums = np.concatenate([np.zeros((1, n, n)), np.cumsum(information, axis=0)])
        ends = np.minimum(last, samples) - start
        begins = np.maximum(last - length, start) - start
        window = sums[ends] - sums[begins]
        total += np.einsum("wij,jk,wkl->il", window, inverse, window, optimize=True)
    return np.asarray(total / length)


def autocorrelation(residual: Array, lags: int) -> Array:
    """Autocorrelation of a residual (N,) at lags 1..lags."""
    centred = residual - residual.mean()
    size = 1 << (len(centred) + lags).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    gamma = np.fft.irfft(spectrum, size)[: lags + 1]
    return np.asarray(gamma[1:] / max(float(gamma[0]), TINY))


FEWEST_FOR_WHITENESS = 40
"""Samples below which nothing is called white: of 16, four unknowns alone take a quarter."""


LAGS_OUTSIDE = 6
"""Of 20 autocorrelations outside the 95 % band: of white noise one residual in 30 000 has more."""


def whiteness(residual: Array, lags: int = 20) -> int:
    """How many of the first `lags` autocorrelations lie outside the 95 % band of white noise."""
    lags = min(lags, len(residual) - 2)
    bound = 1.96 / np.sqrt(len(residual))
    return int(np.sum(np.abs(autocorrelation(residual, lags)) > bound))


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """Draws of N(theta, P) pushed through a nonlinear map (as Linder 2017, Figure 7.15)."""

    values: Array  # (draws that are valid, n_out)
    share_invalid: float

    @property
    def mean(self) -> Array:
        """Mean of the valid draws."""
        return np.asarray(self.values.mean(axis=0))

    @property
    def std(self) -> Array:
        """Standard deviation of the valid draws."""
        return np.asarray(self.values.std(axis=0, ddof=1))

    def interval(self, level: float = 0.95) -> Array:
        """Central interval of the valid draws, (2, n_out)."""
        tail = (1 - level) / 2
        return np.asarray(np.quantile(self.values, [tail, 1 - tail], axis=0))

    def __repr__(self) -> str:
        return f"<Sampled {len(self.values)} draws, {100 * self.share_invalid:.2g} % invalid>"


def sample_through(
    function: Callable[[Array], Array],
    theta: Array,
    covariance: Array,
    *,
    draws: int = 10_000,
    seed: int = 0,
    valid: Callable[[Array], bool] | None = None,
) -> Sampled:
    """Sample N(theta, P) and push every draw through `function`.

    Draws whose result is not finite, or fails `valid`, are left out and their share is reported:
    where it is more than a few per cent the normal approximation itself is in doubt.
    """
    rng = np.random.default_rng(seed)
    points = rng.multivariate_normal(theta, covariance, size=draws, method="eigh")
    kept: list[Array] = []
    with np.errstate(all="ignore"):
        for point in points:
            value = np.atleast_1d(np.asarray(function(point), dtype=float))
            if np.all(np.isfinite(value)) and (valid is None or valid(value)):
                kept.append(value)
    values = np.array(kept) if kept else np.zeros((0, 1))
    return Sampled(values, 1 - len(kept) / draws)
