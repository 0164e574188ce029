"""Whitening of a stationary vector process by what its past does not predict of it.

A spectrum S (F, n, n) without zeros has one factor H of minimum phase,

    S = H H^H,    H(z) = sum_{k >= 0} h_k z^-k,    h_0 lower triangular,                      (1)

whose inverse makes innovations of the process. For one output it is the exponential of a cepstrum;
for several, a prediction from so many samples (P. Whittle, Biometrika 50 (1963) 129-134) and
Newton's method beside it (G. T. Wilson, SIAM J. Appl. Math. 23 (1972) 420-426). A record begins in
the middle of the process. Filtered as if nothing had been before, its samples have the covariance

    I + Q B Q',                                                                               (2)

of which the second term has the rank of the process's state: that much is not known of what was
before. Its inverse root makes the first samples white too. So the sum of squares is that under the
covariance of the whole record, and neither end is an edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import cho_factor, cho_solve, cholesky

from casid.arrays import TINY, Array, BoolArray

ComplexArray = NDArray[np.complex128]

GROUP = 8
"""Columns that are filtered at once: their transforms take eight times their own room."""
FORGOTTEN = 1e-12
"""Of a filter's norm, what is left of it where it ends: less is rounding."""
LENGTHS = 8
"""Lengths of a filter that one transform takes of a long record: the parts overlap by one."""
PART = 1024
"""Samples that one transform takes of a long record, at least: of fewer its call takes most of the
time. Sixteen, for a filter of two taps, took 20 times as long in all."""
COHERENT = 1e-3
"""Squared coherence below which outputs are whitened one by one."""
LONGEST = 400
"""Order of the prediction that Newton's method begins with, at most."""
PATIENCE = 20
"""Orders within which the prediction has to gain."""
GAINED = 1e-3
"""Of log det of the covariance of its errors, over `PATIENCE` orders: less is nothing."""
SINGULAR = 1e-9
"""Of the mean power of an output: what a spectrum whose rank is too low gets besides. Outputs that
one source moves, all without noise of their own, have no covariance that can be inverted."""
STEPS = 8
"""Of Newton's method, at most."""
CONVERGED = 1e-6
"""Relative error of (1) at which it ends."""
PROBES = (8, 16, 32, 48)
"""Random columns that (2) is sought with: more where its rank is not less."""
NEGLIGIBLE = 1e-2
"""Eigenvalue of the second term of (2): without it one sample of all counts by so much too much.
Where the process remembers the whole record, the grid of the transform leaves eigenvalues of either
sign that are as small, dozens of them."""


@dataclass(frozen=True, slots=True, eq=False)
class Innovations:
    """(1) and (2) for records of N samples.

    Attributes
    ----------
    inverse : (n, n, F) 1 / H on the grid of a transform of `size`.
    root : (n, n) h_0.
    start : (N n, k) Q.
    added : (k,) the diagonal of B.
    """

    inverse: ComplexArray
    size: int
    root: Array
    start: Array
    added: Array
    taps: Array | None = None  # (n, n, L) 1 / H, where it forgets early

    def whiten(self, columns: Array) -> Array:
        """e (N, n, m) of columns r (N, n, m), for the N that it is for."""
        if self.taps is not None and len(columns) > LENGTHS * self.taps.shape[2]:
            out = _in_parts(self.taps, columns)
        else:
            out = filtered(self.inverse, columns, self.size)
        flat = out.reshape(len(out) * out.shape[1], out.shape[2])
        if len(self.added):
            scale = 1 / np.sqrt(1 + self.added) - 1
            flat += self.start @ (scale[:, None] * (self.start.T @ flat))
        return flat.reshape(columns.shape)

    def transposed(self, columns: Array, outputs: NDArray[np.intp] | slice = slice(None)) -> Array:
        """The transpose of `whiten` times columns (N, n, m), of all outputs or of some."""
        flat = columns.reshape(len(columns) * columns.shape[1], columns.shape[2])
        if len(self.added):
            scale = 1 / np.sqrt(1 + self.added) - 1
            flat = flat + self.start @ (scale[:, None] * (self.start.T @ flat))
        return filtered(_adjoint(self.inverse)[outputs], flat.reshape(columns.shape), self.size)

    def drawn(self, samples: int, rng: np.random.Generator) -> Array:
        """(N, n) of the process, of so many samples."""
        white = rfft(rng.standard_normal((self.size, len(self.root))), axis=0)
        coloured = np.einsum("ijf,fj->fi", inverse_of(self.inverse), white)
        return np.asarray(irfft(coloured, self.size, axis=0)[:samples])

    def log_determinant(self, samples: int) -> float:
        """log det of the covariance of so many samples."""
        each = 2 * float(np.sum(np.log(np.diag(self.root))))
        return samples * each + float(np.sum(np.log1p(self.added)))


def innovations_of(omega: Array, spectrum: Array, samples: int) -> Innovations:
    """The innovations of records of so many samples.

    Parameters
    ----------
    omega : (F,) rad/sample, 0..pi.
    spectrum : (F, n, n) at these frequencies, lines between them.
    """
    size = next_fast_len(2 * max(samples, len(omega) - 1), real=True)
    grid = np.linspace(0, np.pi, size // 2 + 1)
    n = spectrum.shape[1]
    lines = [[np.interp(grid, omega, spectrum[:, i, j]) for j in range(n)] for i in range(n)]
    S = _of_full_rank(np.array(lines, dtype=complex))
    inverse = _together(S, size) if _coherence(S) > COHERENT else _one_by_one(S, size)
    root = np.linalg.inv(irfft(inverse, size)[:, :, 0])
    q, r = np.linalg.qr(root.T)  # root q = r', lower triangular
    q = q * np.where(np.diag(r) < 0, -1.0, 1.0)
    inverse = np.einsum("ji,jkf->ikf", q, inverse)
    start, added = _start(S, inverse, size, samples)
    return Innovations(inverse, size, root @ q, start, added, _taps(inverse, size))


def _taps(inverse: ComplexArray, size: int) -> Array | None:
    """(n, n, L) of a filter (n, n, F) that has forgotten its input after L samples, L << size."""
    taps = irfft(inverse, size)
    power = np.sum(taps**2, axis=(0, 1))
    left = np.sqrt(np.cumsum(power[::-1])[::-1])
    end = int(np.searchsorted(-left, -FORGOTTEN * left[0]))
    return taps[:, :, :end].copy() if 0 < LENGTHS * end < size else None


def _of_full_rank(S: ComplexArray) -> ComplexArray:
    """Spectra (n, n, F), with white noise of each output besides where one is singular."""
    power = np.maximum(np.mean(np.einsum("iif->if", S).real, axis=1), TINY)
    scale = np.sqrt(power)
    least = np.linalg.eigvalsh(np.moveaxis(S / np.outer(scale, scale)[:, :, None], 2, 0))[:, 0]
    lacking = SINGULAR - float(least.min())
    if len(S) == 1 or lacking <= 0:
        return S
    return S + lacking * np.diag(power)[:, :, None]


def _coherence(S: ComplexArray) -> float:
    """The largest squared coherence of two outputs at any frequency."""
    power = np.maximum(np.einsum("iif->if", S).real, TINY)
    squared = np.abs(S) ** 2 / (power[:, None] * power[None])
    return float(np.max(squared[~np.eye(len(S), dtype=bool)], initial=0.0))


def _one_by_one(S: ComplexArray, size: int) -> ComplexArray:
    """1 / H (n, n, F) of outputs that have nothing in common, by their cepstra."""
    out = np.zeros_like(S)
    for i in range(len(S)):
        cepstrum = irfft(-0.5 * np.log(np.maximum(S[i, i].real, TINY)), size)
        cepstrum[1 : (size + 1) // 2] *= 2.0
        cepstrum[size // 2 + 1 :] = 0.0
        out[i, i] = np.exp(rfft(cepstrum))
    return out


def _together(S: ComplexArray, size: int) -> ComplexArray:
    """1 / H (n, n, F) of outputs that what moves them has in common."""
    filters = _prediction(np.ascontiguousarray(np.moveaxis(irfft(S, size), 2, 0)))
    inverse = np.ascontiguousarray(np.moveaxis(rfft(filters, size, axis=0), 0, 2))
    unit, half = np.eye(len(S))[:, :, None], size // 2
    for _ in range(STEPS):
        G = _product(_product(inverse, S), _adjoint(inverse))
        if float(np.max(np.abs(G - unit))) < CONVERGED:
            break
        g = irfft(G + unit, size)
        g[:, :, 0] *= 0.5
        g[:, :, half] *= 0.5
        g[:, :, half + 1 :] = 0.0
        inverse = _product(inverse_of(rfft(g)), inverse)
    return inverse


def _prediction(G: Array) -> Array:
    """Filters (p + 1, n, n) to white noise, of autocovariances G_k = E r(t+k) r(t)' (T, n, n).

    By the recursion of Levinson for vectors: the predictors of every order from those before.
    """
    V = 0.5 * (G[0] + G[0].T)
    U, n = V.copy(), len(V)
    tiny = TINY + 1e-14 * float(np.trace(V)) / n
    A = B = np.zeros((0, n, n))
    logs = [float(np.linalg.slogdet(V)[1])]
    for k in range(min(LONGEST, len(G) // 2 - 1)):
        delta = G[k + 1] - np.einsum("iab,ibc->ac", A, G[k:0:-1])
        forward = cho_solve(cho_factor(U, lower=True), delta.T).T
        backward = cho_solve(cho_factor(V, lower=True), delta).T
        V_new, U_new = V - forward @ delta.T, U - backward @ delta
        V_new, U_new = 0.5 * (V_new + V_new.T), 0.5 * (U_new + U_new.T)
        if min(np.linalg.eigvalsh(V_new)[0], np.linalg.eigvalsh(U_new)[0]) <= tiny:
            break  # as far as rounding allows
        A, B = (
            np.concatenate([A - np.einsum("ab,ibc->iac", forward, B[::-1]), forward[None]]),
            np.concatenate([B - np.einsum("ab,ibc->iac", backward, A[::-1]), backward[None]]),
        )
        V, U = V_new, U_new
        logs.append(float(np.linalg.slogdet(V)[1]))
        if k >= PATIENCE and logs[-1 - PATIENCE] - logs[-1] < GAINED:
            break
    root = cholesky(V + tiny * np.eye(n), lower=True)
    return np.asarray(np.linalg.solve(root, np.concatenate([np.eye(n)[None], -A])))


def _product(a: ComplexArray, b: ComplexArray) -> ComplexArray:
    """Matrix products (n, n, F), frequency by frequency."""
    return np.asarray(np.sum(a[:, :, None] * b[None], axis=1))


def _adjoint(a: ComplexArray) -> ComplexArray:
    return np.asarray(a.conj().swapaxes(0, 1))


def inverse_of(a: ComplexArray) -> ComplexArray:
    """Inverses (n, n, F), frequency by frequency."""
    if len(a) == 2:  # a tenth of the time of the general one
        (p, q), (r, s) = a
        return np.asarray(np.array([[s, -q], [-r, p]]) / (p * s - q * r))
    return np.ascontiguousarray(np.moveaxis(np.linalg.inv(np.moveaxis(a, 2, 0)), 0, 2))


def _start(S: ComplexArray, inverse: ComplexArray, size: int, samples: int) -> tuple[Array, Array]:
    """Q (N n, k) and the diagonal of B (k,) of (2), from products with random columns."""
    n = len(S)
    back = _adjoint(inverse)

    def added(flat: Array) -> Array:
        """The second term of (2) times columns (N n, k)."""
        columns = flat.reshape(samples, n, flat.shape[1])
        for filters in (back, S, inverse):
            columns = filtered(filters, columns, size)
        return columns.reshape(flat.shape) - flat

    rng = np.random.default_rng(0)
    basis, seen = np.zeros((samples * n, 0)), np.zeros((samples * n, 0))
    for most in PROBES:
        probes = min(most, samples * n)
        more = rng.standard_normal((samples * n, probes - seen.shape[1]))
        seen = np.hstack([seen, added(more)])
        left, sizes, _ = np.linalg.svd(seen, full_matrices=False)
        basis = left[:, sizes > NEGLIGIBLE * np.sqrt(probes)]
        if basis.shape[1] < probes:
            break
    if not basis.shape[1]:
        return basis, np.zeros(0)
    B = basis.T @ added(basis)
    values, vectors = np.linalg.eigh(0.5 * (B + B.T))
    kept = values > NEGLIGIBLE
    return np.asarray(basis @ vectors[:, kept]), values[kept]


def filtered(filters: ComplexArray, columns: Array, size: int) -> Array:
    """Columns (N, n, m) through filters (l, n, F), nothing before or after them: (N, l, m)."""
    N, n, m = columns.shape
    out = np.zeros((N, len(filters), m))
    passes: BoolArray = np.any(filters, axis=2)
    for first in range(0, m, GROUP):
        group = slice(first, first + GROUP)
        moving = [j for j in range(n) if passes[:, j].any() and columns[:, j, group].any()]
        # Row by row: with a stride between its samples, a transform of a long record takes longer.
        rows = {j: np.ascontiguousarray(columns[:, j, group].T) for j in moving}
        spectra = {j: rfft(row, size) for j, row in rows.items()}
        for i, through in enumerate(passes):
            parts = [filters[i, j] * spectra[j] for j in moving if through[j]]
            if parts:
                out[:, i, group] = irfft(sum(parts), size, overwrite_x=True)[:, :N].T
    return out


def _in_parts(taps: Array, columns: Array) -> Array:
    """Filtering by (n, n, L) coefficients in time, in parts that begin L samples early.

    A transform of a part stays in the processor's cache (overlap-save).
    """
    N, before = len(columns), taps.shape[2] - 1
    least = min(PART, N + before)
    size = next_fast_len(max(LENGTHS * (before + 1), least), real=True)
    filters, step = rfft(taps, size), size - before
    padded = np.zeros((before + -(-N // step) * step, *columns.shape[1:]))
    padded[before : before + N] = columns
    out = np.empty(columns.shape)
    for first in range(0, N, step):
        part = filtered(filters, padded[first : first + size], size)
        out[first : first + step] = part[before : before + min(step, N - first)]
    return out
