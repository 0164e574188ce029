"""Likelihoods of linear candidates with the noise estimated again under each of them.

What a model lacks passes for a disturbance of its own balance: whitened by it, its cause explains
little. Under the cause the disturbance falls to nothing. So the spectrum of the residual is
estimated again under every candidate: in bands b of whitened periodograms with n_b lines, with

    P_b = |e_b - T_b t - psi_b a|^2 / n_b,   2 log L = -2 sum_b n_b (log S_b + P_b / S_b)        (1)

S_b = P_b, but no less than what the noise of sensors and measured inputs gives. Parameters and
spectrum are found in turn. Everything needed is in the cross-spectral products of residual e,
tangent T and signatures psi in each band: no sample is visited again.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.fft import rfft

from casid.arrays import TINY, Array
from casid.diagnosis.thresholds import BANDED

BandedColumns = tuple[Array, Array, Array]
"""Whitened residual (M,), tangent (M, t) and signatures (M, K); samples by outputs are stacked."""


class BandedLikelihood:
    """Cross-spectral products of all records in bands, output by output."""

    def __init__(self, outputs: int) -> None:
        self.outputs = outputs
        self._products: list[Array] = []  # (C, C) a band: residual, tangent, signatures
        self._lines: list[float] = []
        self._least: list[float] = []
        self._own: list[float] = []  # the noise of inputs in the residual's own product

    def add(
        self, columns: BandedColumns, of_inputs: BandedColumns | None, least: Array | None
    ) -> None:
        """Another record.

        Parameters
        ----------
        of_inputs : what one draw of the noise of the measured inputs adds to the columns.
        least : (F, ny) smallest spectrum of the whitened residual on a grid 0..pi, default 1.
        """
        mine = self._spectra(columns)
        noise = None if of_inputs is None else self._spectra(of_inputs)
        n = mine.shape[0]
        grid = np.linspace(0.0, 1.0, n)
        first = min(BANDED.per_unknown * (1 + columns[1].shape[1]), n)
        cuts = np.unique(np.geomspace(first, n, BANDED.bands).astype(int))
        for i in range(self.outputs):
            smallest = np.ones(n)
            if least is not None:
                smallest = np.interp(grid, np.linspace(0.0, 1.0, len(least)), least[:, i])
            for a, b in pairwise([0, *cuts.tolist()]):
                part = mine[a:b, i]
                product = (part.conj().T @ part).real
                own = 0.0
                if noise is not None:
                    drawn = noise[a:b, i]
                    both = (drawn.conj().T @ drawn).real
                    product, own = product - both, float(both[0, 0])
                self._products.append(product)
                self._lines.append(float(b - a))
                self._least.append(float(smallest[a:b].mean()))
                self._own.append(own)

    def _spectra(self, columns: BandedColumns) -> Array:
        """(F, ny, C) of residual, tangent and signatures."""
        e, tangent, psi = columns
        both = np.concatenate([e[:, None], tangent, psi], axis=1)
        samples = both.reshape(-1, self.outputs, both.shape[1])
        return np.asarray(rfft(samples, axis=0) / np.sqrt(len(samples)))

    def gains(self, tangent: int) -> tuple[Array, Array]:
        """Twice what each signature adds to the log-likelihood (K,), and its parameter there (K,).

        Parameters
        ----------
        tangent : columns of the model's own unknowns. One that overflows takes no part; nor does a
            signature, which gains nothing then.
        """
        products = np.array(self._products)
        lines, least, own = (np.array(v) for v in (self._lines, self._least, self._own))
        least = np.maximum(least, BANDED.least_share)
        size = np.einsum("bcc->c", np.abs(products))
        seen = np.isfinite(size)
        products = np.where(seen[:, None] & seen, products, 0.0)
        scale = np.sqrt(np.where(seen, np.maximum(size, TINY), 1.0))
        scale[0] = 1.0
        products = products / np.outer(scale, scale)
        before, _ = _likelihood(products[:, : 1 + tangent, : 1 + tangent], lines, least, own)
        gains, best = [], []
        for j in range(1 + tangent, products.shape[1]):
            chosen = [*range(1 + tangent), j]
            value, at = _likelihood(products[:, chosen][:, :, chosen], lines, least, own)
            gains.append(max(value - before, 0.0))
            best.append(at[-1] / scale[j])
        return np.array(gains), np.array(best)


def _likelihood(products: Array, lines: Array, least: Array, own: Array) -> tuple[float, Array]:
    """(1) and the parameters there, the larger one of two starts.

    From the spectrum as it is, and from the least: what else there is, the candidate may explain.
    """
    a, r, e = products[:, 1:, 1:], products[:, 1:, 0], products[:, 0, 0] + own
    found = []
    for start in (np.maximum(e / lines, least), least):
        s, value, x = start, -np.inf, np.zeros(r.shape[1])
        for _ in range(BANDED.rounds):
            weight = 1 / s
            x = np.linalg.lstsq(np.tensordot(weight, a, 1), weight @ r, rcond=1e-12)[0]
            power = np.maximum(e - 2 * r @ x + (a @ x) @ x, 0.0) / lines
            s = np.maximum(power, least)
            last, value = value, -2.0 * float(lines @ (np.log(s) + power / s))
            if value - last < BANDED.change:
                break
        found.append((value, x))
    return max(found, key=lambda f: f[0])
