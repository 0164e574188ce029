"""Whitening of a record from which samples are missing: under the covariance of those there are.

With W the whitening of the whole record, W'W = Gamma^-1, and E the columns of the identity at the
missing samples, what is free in the residual r is taken for what makes it smallest,

    min_z |W (r + E z)|^2 = r_o' Gamma_oo^-1 r_o,                                             (1)

so that whitened residuals and sensitivities have the inner products of the samples that there are
(Brockwell and Davis, Time Series: Theory and Methods, 2nd ed. 1991, section 12.3). The minimiser
solves E' Gamma^-1 E z = -E' Gamma^-1 r, by conjugate gradients; the same system without what a
record's ends and far neighbours give to it is banded, and comes next to the solution at once.
Where few neighbours leave it positive definite these do: the steps that more of them save take
less time than their band. Of few missing samples an orthonormal basis of W E is kept: what they
could have given is the projection on it. Of few that there are their covariance is factored, and
the record that minimises is what they make expected of it,

    r = Gamma E_o Gamma_oo^-1 r_o.                                                            (2)
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.fft import irfft
from scipy.linalg import cho_solve, cho_solve_banded, cholesky, cholesky_banded

from casid.arrays import TINY, Array, BoolArray
from casid.estimation.noise.innovations import ComplexArray, Innovations, filtered, inverse_of
from casid.estimation.noise.varying_innovations import VaryingInnovations

FARTHEST = 200
"""Samples between neighbours in the banded system, at most."""
NEAREST = 20
"""The same in the one that is tried first. Of a cell's record that misses four of five samples the
band of 200 took five times as long as the rest of a step, and saved four steps of nine."""
NEGLIGIBLE = 1e-4
"""Of Gamma^-1, relative to its diagonal: neighbours with less are far."""
FEW = 1_000_000
"""Numbers in the basis of what missing samples could have given, at most: 8 MB."""
FEW_SEEN = 1500
"""Samples that there are, at most, whose covariance is factored: 18 MB, a tenth of a second. A
blood's 1100 samples on a clock of 7200 minutes are whitened twenty times faster than by steps."""
CONVERGED = 1e-4
"""Relative error, in the norm of (1), at which conjugate gradients end: its square is what inner
products err by."""
STEPS = 60
"""Of conjugate gradients, at most."""


class UnbrokenInnovations:
    """(1) for a record that misses samples at its ends alone, of all outputs: a shorter record.

    Parameters
    ----------
    inside : innovations of a record of as many samples as there are.
    rows : where they are.
    """

    def __init__(self, inside: Innovations | VaryingInnovations, rows: slice) -> None:
        self._inside, self._rows = inside, rows

    def whiten(self, columns: Array) -> Array:
        """e (N, n, m) of columns r (N, n, m); zero where samples are missing."""
        out = np.zeros(columns.shape)
        out[self._rows] = self._inside.whiten(columns[self._rows])
        return out

    def seen(self, white: Array) -> Array:
        """Columns (N, n, m), whitened as of a complete record, of the samples that there are."""
        out = np.zeros(white.shape)
        out[self._rows] = white[self._rows]
        return out

    def completed(self, white: Array, rng: np.random.Generator) -> Array:
        """Whitened columns (N, n, m) with white noise where samples are missing."""
        out = rng.standard_normal(white.shape)
        out[self._rows] = white[self._rows]
        return out

    def log_determinant(self, samples: int) -> float:
        """log det of the covariance of what there is of so many samples."""
        return self._inside.log_determinant(len(range(samples)[self._rows]))


FILLED_FROM = 0.5
"""Share of samples from which the missing ones are drawn, given the others and the noise found."""


def unbroken(used: BoolArray) -> slice | None:
    """The rows of `used` (N, n), where those that are there are complete and in one piece."""
    whole = used.all(axis=1)
    rows = np.flatnonzero(whole)
    if not len(rows) or rows[-1] - rows[0] + 1 > len(rows) or np.any(used[~whole]):
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1)


class PartialInnovations:
    """(1) for one record.

    Parameters
    ----------
    whole : innovations of the record, were it complete.
    used : (N, n) bool, the samples that there are.
    """

    def __init__(self, whole: Innovations, used: BoolArray) -> None:
        self.whole, self.used = whole, used
        self._places = np.flatnonzero(~used.ravel())
        self._there = np.flatnonzero(used.ravel())
        self._broken = np.flatnonzero(~used.all(axis=0))

    def whiten(self, columns: Array) -> Array:
        """e (N, n, m) of columns r (N, n, m); missing samples of these do not matter."""
        factor = self._factor_of_seen
        if factor is not None:
            return self.whole.whiten(self._expected(columns, factor))
        return self.seen(self.whole.whiten(columns * self.used[:, :, None]))

    def seen(self, white: Array) -> Array:
        """Columns (N, n, m), whitened as of a complete record, less what missing samples took."""
        return white - self._lost(white)

    def filled(self, residual: Array, rng: np.random.Generator) -> Array:
        """A residual (N, n) with a draw of its missing samples, given those that there are.

        A draw of the whole process, corrected by what minimises (1) of the difference (Hoffman and
        Ribak, Astrophys. J. 380 (1991) L5-L8).
        """
        drawn = self.whole.drawn(len(residual), rng)
        apart = np.where(self.used, residual - drawn, 0.0)
        e = self.whole.whiten(apart[:, :, None])
        z = self._solved(self._back(e))
        return np.asarray(np.where(self.used, residual, drawn - self._spread(z)[:, :, 0]))

    def completed(self, white: Array, rng: np.random.Generator) -> Array:
        """Whitened columns (N, n, m) with white noise in the directions that missing samples took.

        What was orthogonal to them stays so: no inner product with whitened sensitivities changes.
        Of whitened noise it makes white noise of unit size in every sample.
        """
        return white + self._lost(rng.standard_normal(white.shape))

    def log_determinant(self, samples: int) -> float:
        """log det of the covariance of the samples that there are (by steps: its banded part)."""
        if self._factor_of_seen is not None:
            return 2 * float(np.sum(np.log(np.diag(self._factor_of_seen))))
        own = 2 * float(np.sum(np.log(np.maximum(self._wide[0], TINY))))
        return self.whole.log_determinant(samples) + own

    def _expected(self, columns: Array, factor: Array) -> Array:
        """(2): columns (N, n, m) as the samples that there are make them expected."""
        given = columns.reshape(self.used.size, -1)[self._there]
        out = np.zeros((self.used.size, given.shape[1]))
        out[self._there] = cho_solve((factor, True), given, check_finite=False)
        return filtered(self._spectrum, out.reshape(columns.shape), self.whole.size)

    @cached_property
    def _factor_of_seen(self) -> Array | None:
        """Lower Cholesky factor of Gamma_oo; None where it is large, or has none."""
        if len(self._there) > min(FEW_SEEN, len(self._places)):
            return None
        C = irfft(self._spectrum, self.whole.size)
        t, a = np.divmod(self._there, self.used.shape[1])
        of = C[a[:, None], a[None, :], t[:, None] - t[None, :]]
        try:
            return np.asarray(cholesky(of, lower=True))
        except np.linalg.LinAlgError:
            return None

    @cached_property
    def _spectrum(self) -> ComplexArray:
        """(n, n, F) of the process."""
        H = inverse_of(self.whole.inverse)
        return np.asarray(np.einsum("ikf,jkf->ijf", H, H.conj()))

    def _lost(self, e: Array) -> Array:
        """The part of whitened columns that missing samples could have given, (N, n, m)."""
        basis = self._basis
        if basis is not None:
            flat = e.reshape(len(basis), -1)
            return np.asarray((basis @ (basis.T @ flat)).reshape(e.shape))
        return self.whole.whiten(self._spread(self._solved(self._back(e))))

    @cached_property
    def _basis(self) -> Array | None:
        """(N n, missing) orthonormal basis of W E; None where it would be large."""
        if self.used.size * len(self._places) > FEW:
            return None
        columns = self.whole.whiten(self._spread(np.eye(len(self._places))))
        return np.asarray(np.linalg.qr(columns.reshape(self.used.size, -1))[0])

    def _back(self, white: Array) -> Array:
        """E'W' times whitened columns (N, n, m): (missing, m)."""
        out = np.zeros(white.shape)
        out[:, self._broken] = self.whole.transposed(white, self._broken)
        return out.reshape(self.used.size, -1)[self._places]

    def _spread(self, z: Array) -> Array:
        """E times z (missing, m): (N, n, m)."""
        out = np.zeros((self.used.size, z.shape[1]))
        out[self._places] = z
        return out.reshape(*self.used.shape, -1)

    def _product(self, z: Array) -> Array:
        """E' Gamma^-1 E times z (missing, m)."""
        return self._back(self.whole.whiten(self._spread(z)))

    def _near(self, b: Array) -> Array:
        """The solution of the banded system; not finite where a simulation has all but diverged."""
        return np.asarray(cho_solve_banded((self._factor, True), b, check_finite=False))

    def _solved(self, b: Array) -> Array:
        """The solution of E' Gamma^-1 E z = b (missing, m), each column by itself."""
        z = self._near(b)
        size = np.maximum(np.sum(b * z, axis=0), TINY)
        left = b - self._product(z)
        near = self._near(left)
        along, product = near.copy(), np.sum(left * near, axis=0)
        for _ in range(STEPS):
            if np.all(product <= CONVERGED**2 * size):
                break
            moved = self._product(along)
            length = product / np.maximum(np.sum(along * moved, axis=0), TINY)
            z += length * along
            left -= length * moved
            near = self._near(left)
            before, product = product, np.sum(left * near, axis=0)
            along = near + product / np.maximum(before, TINY) * along
        return z

    @cached_property
    def _factor(self) -> Array:
        """The factor with the nearest neighbours, or else with far ones."""
        near = self._banded(NEAREST)
        return self._wide if near is None else near

    @cached_property
    def _wide(self) -> Array:
        """The factor with far neighbours, raised where without the farthest it is not positive."""
        C = self._between
        for ridge in (0.0, 1e-6, 1e-3, 1e-1):
            factor = self._banded(FARTHEST, ridge)
            if factor is not None:
                return factor  # what far neighbours gave was needed: the others count less
        a = self._places % len(C)
        return np.asarray(np.sqrt(C[a, a, :1].T))

    @cached_property
    def _between(self) -> Array:
        """(n, n, lags) what Gamma^-1 has between samples of two outputs, except at the ends."""
        inverse = self.whole.inverse
        spectrum = np.einsum("kif,kjf->ijf", inverse.conj(), inverse)
        return np.asarray(irfft(spectrum, self.whole.size))

    def _banded(self, farthest: int, ridge: float = 0.0) -> Array | None:
        """Lower Cholesky factor of E' Gamma^-1 E among near neighbours; None where it has none."""
        C, n = self._between, self.used.shape[1]
        far = min(farthest, self.used.shape[0] - 1, C.shape[2] // 2 - 1)
        sizes = np.max(np.abs(C[:, :, : far + 1]), axis=(0, 1))
        L = int(np.flatnonzero(sizes > NEGLIGIBLE * sizes[0]).max(initial=0))
        t, a = np.divmod(self._places, n)
        width = int(np.max(np.searchsorted(t, t + L, side="right") - np.arange(len(t))))
        band = np.zeros((width, len(t)))
        for d in range(width):
            lag = t[d:] - t[: len(t) - d]
            values = C[a[d:], a[: len(t) - d], np.minimum(lag, L)]
            band[d, : len(t) - d] = np.where(lag <= L, values, 0.0)
        band[0] += ridge * band[0].max()
        try:
            return np.asarray(cholesky_banded(band, lower=True))
        except np.linalg.LinAlgError:
            return None
