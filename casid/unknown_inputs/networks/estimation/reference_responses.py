"""First stage: the part of signals that the references cause, by long impulse responses.

    x_t = sum_r sum_{l < lags} h_rl delta_r,t-l + r_t                                          (1)

by least squares. The references are independent of r, so that this is consistent whatever the
colour of r (Linder 2017, section 3.5, Example 3.8).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.errors import DataError
from casid.estimation.covariance import autocorrelation
from casid.estimation.prediction_error.polynomial.excitation import require_excitation


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceResponses:
    """Regression (1) of several signals on the same references.

    Attributes
    ----------
    references : names; lags : of each.
    Z : (N - lags + 1, refs * lags) the regressors, reference by reference, from t = lags - 1 on.
    gram : Z'Z.
    h : signal -> (refs, lags) impulse responses.
    residuals : signal -> (N - lags + 1,).
    """

    references: tuple[str, ...]
    lags: int
    Z: Array
    gram: Array
    h: Mapping[str, Array]
    residuals: Mapping[str, Array]

    def made_of(self, signal: str) -> Array:
        """What the references make of the signal, (N - lags + 1,)."""
        return np.asarray(self.Z @ self.h[signal].ravel())

    def influence(self, weights: Array) -> Array:
        """(N - lags + 1, p) = Z gram^-1 weights', the regressors that p combinations weigh."""
        return np.asarray(self.Z @ np.linalg.solve(self.gram, weights.T))

    def unsettled(self) -> tuple[str, ...]:
        """Signals whose response has not died out: the last fifth stands out of its errors."""
        inverse = np.diag(np.linalg.inv(self.gram)).reshape(len(self.references), self.lags)
        last = max(self.lags // 5, 1)
        found = []
        for name, h in self.h.items():
            variance = float(np.mean(self.residuals[name] ** 2))
            ratio = h[:, -last:] ** 2 / (variance * inverse[:, -last:])
            # Errors of neighbours are correlated as the residual is: fewer independent ones.
            rho = autocorrelation(self.residuals[name], last)
            own = last / (1 + 2 * float(np.sum(rho**2)))
            if np.any(ratio.mean(axis=1) > 1 + 4 * np.sqrt(2 / own)):
                found.append(name)
        return tuple(found)


def default_lags(N: int, references: int) -> int:
    """The most lags: a tenth of the record for all references together, 150 each; a heuristic."""
    return int(np.clip(N // (10 * max(references, 1)), 5, 150))


def settled_responses(
    signals: Mapping[str, Array], references: Mapping[str, Array], lags: int | None, name: str
) -> ReferenceResponses:
    """(1) with lags as given, or one and a half times as many as the responses need.

    Lags are doubled from 20 on until the last fifth of every response is within its errors, up to
    `default_lags`. Every lag takes up noise, which is left in what is used as free of it: 1/N of
    the noise's power each.
    """
    if lags is not None:
        return reference_responses(signals, references, lags, name)
    most = default_lags(len(next(iter(signals.values()))), len(references))
    tried = min(20, most)
    while True:
        found = reference_responses(signals, references, tried, name)
        if tried == most:
            return found
        if not found.unsettled():
            return reference_responses(signals, references, min(3 * tried // 2, most), name)
        tried = min(2 * tried, most)


def reference_responses(
    signals: Mapping[str, Array], references: Mapping[str, Array], lags: int, name: str
) -> ReferenceResponses:
    """Estimate (1).

    Parameters
    ----------
    signals, references : name -> (N,), of mean zero.
    name : of the record, for messages.

    Raises
    ------
    DataError
        If the record is too short for the lags.
    IdentifiabilityError
        If the references do not excite that many lags.
    """
    N = len(next(iter(signals.values())))
    count = lags * len(references)
    if N - lags + 1 <= 2 * count:
        raise DataError(
            f"{name}: {N} samples are too few for impulse responses of {lags} lags from "
            f"{len(references)} references; lower lags=, or give a longer record"
        )
    require_excitation(
        [(next(iter(signals.values())), references)],
        {r: (0, lags) for r in references},
        "the impulse responses need",
    )
    blocks = [
        np.lib.stride_tricks.sliding_window_view(delta, lags)[:, ::-1]
        for delta in references.values()
    ]
    Z = np.concatenate(blocks, axis=1)
    gram = Z.T @ Z
    h: dict[str, Array] = {}
    residuals: dict[str, Array] = {}
    for signal, x in signals.items():
        cut = x[lags - 1 :]
        solved = np.asarray(np.linalg.solve(gram, Z.T @ cut), dtype=np.float64)
        h[signal] = np.reshape(solved, (len(references), lags)).astype(np.float64)
        residuals[signal] = cut - Z @ solved
    return ReferenceResponses(tuple(references), lags, Z, gram, h, residuals)
