"""The residuals of an estimate, and their cross-correlation with an input, with its bound.

If the model of G is right, eps(t) and u(t - k) are uncorrelated, and their correlation over N
samples is asymptotically normal with variance P / N,

    P = sum_l rho_eps(l) rho_u(l)                                                            (1)

(Ljung 1999, section 16.6). The sum is taken with Bartlett weights, which keep it above zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.estimation.covariance import autocorrelation

LAGS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """The residuals of an estimate.

    Attributes
    ----------
    noise_variance : sum eps^2 / (N - n), output unit squared.
    loss : V_N of Linder 2017, (2.36), sum eps^2 / (2 N).
    fit : NRMSE fit of the one-step prediction [%], 100 (1 - |eps| / |y - mean y|).
    N : residuals that count, over all records.
    residuals : (N_r,) for each record, from the first sample on.
    discarded : for each record, how many first residuals do not count.
    input_correlation : input -> (lags + 1,) of `residual_input_correlation`: above 1 in size where
        the residual and the input k samples before are correlated beyond 95 % bounds.
    """

    noise_variance: float
    loss: float
    fit: float
    N: int
    residuals: tuple[Array, ...]
    discarded: tuple[int, ...]
    input_correlation: Mapping[str, Array]


def residual_input_correlation(
    residuals: Sequence[Array], inputs: Sequence[Array], lags: int = LAGS
) -> Array:
    """Correlation of eps(t) with u(t - k), k = 0..lags, each over its 95 % bound.

    Parameters
    ----------
    residuals, inputs : (N_r,) of each record.

    Returns
    -------
    (lags + 1,), above 1 in size where the bound is exceeded; fewer where all records are shorter,
    and zeros where the input or the residual is constant.

    Notes
    -----
    In closed loop without a delay, u(t) holds eps(t): lag 0 then says nothing. Lags that the model
    itself fits are nearer to zero than the bound has it.
    """
    lags = min(lags, max(len(r) for r in residuals) - 1)
    N = sum(len(r) for r in residuals)
    memory = max(min(int(np.sqrt(N)) + LAGS, N // 4), 1)
    weights = 1 - np.arange(1, memory + 1) / (memory + 1)
    covariance, of_r, of_u, spread = np.zeros(lags + 1), 0.0, 0.0, 0.0
    for r, u in zip(residuals, inputs, strict=True):
        e, v = r - r.mean(), u - u.mean()
        few = min(lags + 1, len(r))
        covariance[:few] += [e[k:] @ v[: len(v) - k] for k in range(few)]
        of_r, of_u = of_r + float(e @ e), of_u + float(v @ v)
        both = autocorrelation(r, memory) * autocorrelation(u, memory)
        spread += len(r) / N * (1 + 2 * float(weights @ both))
    if of_r <= 0.0 or of_u <= 1e-24 * sum(float(u @ u) for u in inputs):
        return np.zeros(lags + 1)
    bound = 1.96 * np.sqrt(max(spread, 1e-12) / N)
    return np.asarray(covariance / np.sqrt(of_r * of_u) / bound)
