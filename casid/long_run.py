"""The long-run covariance of products of signals, and how long signals remember.

The mean of zeta_t eps_t over N samples has covariance S/N with

    S = sum_l E[zeta_t eps_t eps_{t-l} zeta_{t-l}'].                                         (1)

Instruments that are independent of the error leave S = sum_l r_eps(l) R_zeta(l), which is

    S = integral of Phi_eps(f) Phi_zeta(f) over one period of f,                             (2)

the product of two spectra. (2) is what is computed: the equation error A(q) e of a resonant system
behind a low-pass has its power where slow instruments have none, so that the sum over lags is the
small difference of large numbers and any window of lags spoils it, while tapered segments (Welch
1967) keep the decades of the two spectra apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casid.columns import Column

Array = NDArray[Any]

LONGEST_SEGMENT = 8192
"""Samples of a segment where the record is long enough for at least 15 overlapping ones."""


def cross_covariances(a: Array, b: Array, lags: int) -> Array:
    """r(l) = sum_t a_t b_{t-l} / N for l = -lags .. lags, (2 lags + 1,); both (N,), zero mean."""
    n = len(a)
    if len(b) != n:
        raise ValueError(f"signals of {n} and {len(b)} samples; cut them to one length")
    lags = min(lags, n - 1)
    out = np.empty(2 * lags + 1)
    for k in range(lags + 1):
        out[lags + k] = np.dot(a[k:], b[: n - k])
        if k:
            out[lags - k] = out[lags + k] if a is b else np.dot(a[: n - k], b[k:])
    return out / n


def memory(signal: Array, *, largest: int | None = None) -> int:
    """The lag after which the autocorrelation of (N,) samples stays within its noise.

    The smallest m such that |rho(m + k)| < 2 sqrt(log10(N)/N) for k = 1 .. K,
    K = max(5, sqrt(log10 N)); Politis (2003, section 2). Lags are computed as far as they are
    needed, `largest` (default sqrt(N), at least 20) at most.
    """
    n = len(signal)
    if n < 3:
        return 0
    largest = min(n - 2, max(20, int(np.sqrt(n)))) if largest is None else largest
    zero = float(np.dot(signal, signal))
    if zero == 0.0:
        return 0
    bound = 2 * np.sqrt(np.log10(n) / n)
    run, needed = 0, max(5, int(np.ceil(np.sqrt(np.log10(n)))))
    for lag in range(1, largest + 1):
        rho = float(np.dot(signal[lag:], signal[: n - lag])) / zero
        run = run + 1 if abs(rho) < bound else 0
        if run == needed:
            return lag - needed
    return largest


def positive_part(matrix: Array) -> Array:
    """The nearest positive semidefinite matrix: a flat top does not guarantee one."""
    symmetric = 0.5 * (matrix + matrix.T)
    values, vectors = np.linalg.eigh(symmetric)
    if values[0] >= 0:
        return np.asarray(symmetric)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def segments(N: int) -> int:
    """Samples of one segment for a record of N: a power of two, 15 half overlapping or more."""
    return int(min(LONGEST_SEGMENT, max(16, 2 ** int(np.log2(max(N / 8, 16))))))


def segment_transforms(signal: Array, length: int) -> Array:
    """Fourier transforms of half overlapping Hann segments of (N,) samples, (segments, length/2+1).

    Normalised so that the mean over all frequencies of |F|^2 is the mean square of the signal.
    """
    from scipy.fft import rfft

    window = np.hanning(length + 1)[:-1]
    window /= np.linalg.norm(window)
    if len(signal) < length:
        padded = np.zeros(length)
        padded[: len(signal)] = signal
        signal = padded
    pieces = np.lib.stride_tricks.sliding_window_view(signal, length)[:: length // 2]
    return np.asarray(rfft(pieces * window, axis=1))


def independent_covariances(
    errors: Sequence[Array],
    columns: Sequence[Sequence[Column]],
    signals: Sequence[Mapping[str, Array]],
) -> Array:
    """S of (2) for the stacked products of several parts of one record, (sum nz, sum nz).

    Parameters
    ----------
    errors : (N,) of each part; columns : its instruments; signals : what these are made of.
    """
    length = segments(len(errors[0]))
    n_frequencies = length // 2 + 1
    angle = -2j * np.pi * np.arange(n_frequencies) / length
    # Of a real signal one half of the spectrum is enough; its inner part counts twice.
    weight = np.full(n_frequencies, 2.0 / length)
    weight[[0, -1]] = 1.0 / length
    done: dict[int, tuple[Mapping[str, Array], dict[str, Array]]] = {}
    transformed, errors_transformed, shapes = [], [], []
    for e, cols, found in zip(errors, columns, signals, strict=True):
        used = sorted({c for col in cols for c, _, _ in col.taps})
        if id(found) not in done:
            done[id(found)] = (found, {})
        cached = done[id(found)][1]
        for c in used:
            if c not in cached:
                cached[c] = segment_transforms(found[c], length)
        transformed.append({c: cached[c] for c in used})
        errors_transformed.append(segment_transforms(e, length))
        shape = np.zeros((len(cols), len(used), n_frequencies), dtype=complex)
        for i, col in enumerate(cols):
            for c, lag, w in col.taps:
                shape[i, used.index(c)] += w * np.exp(angle * lag)
        shapes.append((used, shape))
    rows = []
    for a in range(len(errors)):
        row = []
        for b in range(len(errors)):
            error = np.mean(errors_transformed[a] * errors_transformed[b].conj(), axis=0)
            used_a, shape_a = shapes[a]
            used_b, shape_b = shapes[b]
            middle = np.array(
                [
                    [np.mean(transformed[a][i] * transformed[b][j].conj(), axis=0) for j in used_b]
                    for i in used_a
                ]
            )
            zeta = np.einsum("ikf,klf,jlf->fij", shape_a, middle, shape_b.conj())
            row.append(np.einsum("f,fij->ij", weight * error, zeta).real)
        rows.append(row)
    return np.block(rows)
