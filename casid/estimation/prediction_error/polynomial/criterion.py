"""The prediction-error criterion of the polynomial family, its gradient and Gauss-Newton matrix.

    eps = (D/C) (A y - sum_i (B_i/F_i) u_i),      V = 1/2 sum_t eps_t^2                        (1)

The sensitivities are the same few filtered signals, shifted (Ljung 1999, section 10.3):

    d eps/d a_k = q^-k (D/C) y              d eps/d d_k = q^-k (1/C) (A y - sum (B_i/F_i) u_i)
    d eps/d b_k = -q^-k (D/(C F_i)) u_i     d eps/d c_k = -q^-k (1/C) eps
    d eps/d f_k = q^-k (D B_i/(C F_i^2)) u_i

Filters start from rest; the first residuals of a record, where that is wrong, do not count.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from casid.arrays import Array
from casid.estimation.nlp.solution import Evaluation
from casid.estimation.prediction_error.polynomial.orders import Layout, is_stable

Shifts = list[tuple[Array, int, int, float]]  # base signal, first lag, number of lags, sign
CHUNK = 16384  # samples at a time in the products: the buffer stays in the cache


class PredictionErrors:
    """Criterion (1) over records with shared coefficients; a `Criterion`.

    Parameters
    ----------
    layout : place of each coefficient in theta.
    data : (y (N_r,), {input: (N_r,)}) for each record.
    discard : for each record, the first residuals that do not count.
    """

    def __init__(
        self,
        layout: Layout,
        data: Sequence[tuple[Array, Mapping[str, Array]]],
        discard: Sequence[int],
    ) -> None:
        self.layout = layout
        self.discard = tuple(discard)
        lags = [k + b for k, b in zip(layout.nk, layout.nb, strict=True)]
        self._pad = max([layout.na, layout.nc, layout.nd, *layout.nf, *lags])
        # Zeros in front are what a shift brings in; a filter at rest leaves them zero.
        front = np.zeros(self._pad)
        self._data = [
            (np.concatenate([front, y]), [np.concatenate([front, u[i]]) for i in layout.inputs])
            for y, u in data
        ]

    @property
    def n_constraints(self) -> int:
        """Number of constraints of its own: none."""
        return 0

    @property
    def N(self) -> int:
        """Residuals that count."""
        lengths = [len(y) - self._pad for y, _ in self._data]
        return int(sum(n - d for n, d in zip(lengths, self.discard, strict=True)))

    @property
    def spread(self) -> float:
        """Sum of squares of y about its mean in each record, of the samples that count."""
        parts = [y[self._pad + d :] for (y, _), d in zip(self._data, self.discard, strict=True)]
        return float(sum(np.sum((part - part.mean()) ** 2) for part in parts)) or 1.0

    def _signals(self, theta: Array, record: int) -> tuple[Array, Shifts]:
        """Residual with `pad` zeros in front, and the shifted signals of its derivative."""
        from scipy.signal import lfilter

        p, layout = self.layout.split(theta), self.layout
        y, inputs = self._data[record]

        def fir(b: Array, x: Array) -> Array:
            return x if len(b) == 1 else np.asarray(lfilter(b, [1.0], x))

        def ar(a: Array, x: Array) -> Array:
            return x if len(a) == 1 else np.asarray(lfilter([1.0], a, x))

        y_c = ar(p.C, y)
        u_cf = [ar(np.convolve(p.C, f), u) for f, u in zip(p.F, inputs, strict=True)]
        v_c = fir(p.A, y_c)
        for b, u in zip(p.B, u_cf, strict=True):
            v_c = v_c - np.asarray(lfilter(b, [1.0], u))
        eps = fir(p.D, v_c)
        shifts: Shifts = []
        if layout.na:
            shifts.append((fir(p.D, y_c), 1, layout.na, 1.0))
        u_d = [fir(p.D, u) for u in u_cf]
        for u, nk, nb in zip(u_d, layout.nk, layout.nb, strict=True):
            shifts.append((u, nk, nb, -1.0))
        if layout.nc:
            shifts.append((ar(p.C, eps), 1, layout.nc, -1.0))
        if layout.nd:
            shifts.append((v_c, 1, layout.nd, 1.0))
        for u, b, f, nf in zip(u_d, p.B, p.F, layout.nf, strict=True):
            if nf:
                shifts.append((np.asarray(lfilter(b, f, u)), 1, nf, 1.0))
        return eps, shifts

    def is_inside(self, theta: Array) -> bool:
        """Whether theta has a stable predictor: roots of C and F_i inside the unit circle."""
        p = self.layout.split(theta)
        return bool(np.all(np.isfinite(theta))) and all(is_stable(q) for q in (p.C, *p.F))

    def evaluate(self, x: Array) -> Evaluation:
        """V, gradient and Gauss-Newton matrix at theta (n,); infinite where the predictor is not
        stable, so that a line search steps back."""
        n = self.layout.n
        if not self.is_inside(x):
            nan = np.full((n, n), np.nan)
            return Evaluation(np.inf, np.full(n, np.nan), nan)
        total = np.zeros((n + 1, n + 1))
        with np.errstate(all="ignore"):
            for record in range(len(self._data)):
                for block in self._blocks(x, record):
                    total += block @ block.T
        return Evaluation(0.5 * float(total[n, n]), total[:n, n].copy(), total[:n, :n].copy())

    def _blocks(self, theta: Array, record: int) -> Iterator[Array]:
        """d eps/d theta and, last, eps, of the samples that count, (n + 1, <= CHUNK) at a time.

        The array is the same every time.
        """
        eps, shifts = self._signals(theta, record)
        first = self._pad + self.discard[record]
        buffer = np.empty((self.layout.n + 1, min(CHUNK, max(len(eps) - first, 1))))
        for begin in range(first, len(eps), CHUNK):
            end = min(begin + CHUNK, len(eps))
            block = buffer[:, : end - begin]
            row = 0
            for base, lag, count, sign in shifts:
                for k in range(lag, lag + count):
                    np.multiply(base[begin - k : end - k], sign, out=block[row])
                    row += 1
            block[row] = eps[begin:end]
            yield block

    def residuals(self, theta: Array) -> tuple[Array, ...]:
        """eps (N_r,) of each record from its first sample on."""
        every = range(len(self._data))
        return tuple(self._signals(theta, r)[0][self._pad :].copy() for r in every)

    def jacobian(self, theta: Array) -> tuple[Array, Array]:
        """d eps/d theta (N, n) and eps (N,) of the samples that count, records stacked."""
        blocks = [b.T.copy() for r in range(len(self._data)) for b in self._blocks(theta, r)]
        both = np.concatenate(blocks)
        return both[:, :-1], both[:, -1]

    def scores(self, theta: Array) -> Array:
        """(N, n) gradients of eps_t^2 / 2."""
        jacobian, eps = self.jacobian(theta)
        return np.asarray(jacobian * eps[:, None])
