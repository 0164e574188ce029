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

import functools
from collections.abc import Mapping, Sequence

import numpy as np

from casid.arrays import Array
from casid.linear.sampled.lagged_columns import Column

LONGEST_SEGMENT = 8192
"""Samples of a segment where the record is long enough for at least 7 overlapping ones."""


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


def memory(signal: Array) -> int:
    """The lag after which the autocorrelation of (N,) samples stays within its noise.

    The smallest m such that |rho(m + k)| < 2 sqrt(log10(N)/N) for k = 1 .. K,
    K = max(5, sqrt(log10 N)); Politis (2003, section 2). Lags are computed as far as they are
    needed, to sqrt(N) or 20 at most.
    """
    n = len(signal)
    if n < 3:
        return 0
    largest = min(n - 2, max(20, int(np.sqrt(n))))
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
    """Samples of one segment for a record of N: 7 half overlapping ones, or more.

    Few and long: (2) sums over all frequencies, so few segments cost hardly any variance, while
    short ones smear the notch of an error A(q) e over the peak that its instruments have there, and
    S comes out too large. Two or three times a power of two.
    """
    most = min(LONGEST_SEGMENT, max(N / 4, 16))
    power = 2 ** int(np.log2(most))
    return int(3 * power // 2 if 3 * power // 2 <= most else power)


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
    # Each signal once, however many parts use it.
    place: dict[tuple[int, str], int] = {}
    distinct = list(errors)
    channels: list[list[str]] = []
    for cols, found in zip(columns, signals, strict=True):
        channels.append(sorted({c for col in cols for c, _, _ in col.taps}))
        for c in channels[-1]:
            if (id(found), c) not in place:
                place[id(found), c] = len(distinct)
                distinct.append(found[c])
    parts = range(len(errors))
    where = [[place[id(signals[a]), c] for c in channels[a]] for a in parts]
    pairs = {(a, b) for a in parts for b in parts if a <= b}
    pairs |= {(i, j) for a in parts for b in parts if a <= b for i in where[a] for j in where[b]}
    spectra = _cross_spectra(distinct, length, sorted(pairs))
    rows: list[list[Array]] = [[np.empty(0)] * len(errors) for _ in parts]
    for a in parts:
        for b in range(a, len(errors)):
            left, right = (_taps(columns[k], channels[k]) for k in (a, b))
            lags_a, lags_b = left.shape[2], right.shape[2]
            block: Array = np.zeros((len(left), len(right)))
            for i, p in enumerate(where[a]):
                for j, q in enumerate(where[b]):
                    shared = spectra[a, b] * spectra[p, q]
                    r = _covariances(shared, length, max(lags_a, lags_b) - 1)
                    lag = np.arange(lags_a)[:, None] - np.arange(lags_b)
                    block += left[:, i] @ r[lag + len(r) // 2] @ right[:, j].T
            rows[a][b], rows[b][a] = block, block.T
    return np.block(rows)


def _taps(columns: Sequence[Column], channels: Sequence[str]) -> Array:
    """Weight of each column on each channel and lag, (nz, channels, largest lag + 1)."""
    table = np.zeros((len(columns), len(channels), max(c.order for c in columns) + 1))
    for row, column in zip(table, columns, strict=True):
        for channel, lag, weight in column.taps:
            row[channels.index(channel), lag] += weight
    return table


def _cross_spectra(
    signals: Sequence[Array], length: int, pairs: Sequence[tuple[int, int]]
) -> dict[tuple[int, int], Array]:
    """Mean over the segments of F_i conj(F_j), (length/2 + 1,), real where i is j.

    A few segments at a time: they stay in the cache, and nothing of the signals' length is kept.
    """
    from scipy.fft import rfft

    window = _hann(length)
    n = len(signals[0])
    if n < length:
        signals = [np.concatenate([s, np.zeros(length - n)]) for s in signals]
    pieces = [np.lib.stride_tricks.sliding_window_view(s, length)[:: length // 2] for s in signals]
    count = len(pieces[0])
    at_once = max(1, 32_768 // length)
    buffer = np.empty((at_once, length))
    total: dict[tuple[int, int], Array] = {}
    for first in range(0, count, at_once):
        last = min(first + at_once, count)
        transforms = [
            rfft(np.multiply(p[first:last], window, out=buffer[: last - first]), axis=1)
            for p in pieces
        ]
        for i, j in pairs:
            if i == j:  # real and imaginary parts in turn, as they lie: squared here, added below
                f = transforms[i].view(np.float64)
                new = np.einsum("sf,sf->f", f, f)
            else:
                new = np.einsum("sf,sf->f", transforms[i], transforms[j].conj())
            total[i, j] = total[i, j] + new if (i, j) in total else new
    return {
        (i, j): (sums.reshape(-1, 2).sum(axis=1) if i == j else sums) / count
        for (i, j), sums in total.items()
    }


@functools.lru_cache(maxsize=8)
def _hann(length: int) -> Array:
    """Hann's window with a mean square of one over `length` (so that spectra have no other)."""
    window = np.hanning(length + 1)[:-1]
    return np.asarray(window / np.linalg.norm(window))


def _covariances(spectrum: Array, length: int, lags: int) -> Array:
    """sum_l of a cross spectrum (length/2 + 1,) at lags -lags .. lags, (2 lags + 1,).

    Entry d is the sum over frequencies of Re S(f) exp(-2 pi i f d).
    """
    cosine, sine = _waves(length, lags)
    even = cosine @ spectrum.real
    odd = sine @ spectrum.imag if np.iscomplexobj(spectrum) else np.zeros(lags + 1)
    return np.concatenate([(even - odd)[:0:-1], even + odd])


@functools.lru_cache(maxsize=8)
def _waves(length: int, lags: int) -> tuple[Array, Array]:
    """Cosines and sines of 2 pi f d, d = 0 .. lags, weighted to be summed, (lags + 1, nf) each."""
    n = length // 2 + 1
    # Of a real signal one half of the spectrum is enough; its inner part counts twice.
    weight = np.full(n, 2.0 / length)
    weight[[0, -1]] = 1.0 / length
    # The phase is reduced before it is rounded.
    angle = 2 * np.pi / length * (np.outer(np.arange(lags + 1), np.arange(n)) % length)
    return weight * np.cos(angle), weight * np.sin(angle)
