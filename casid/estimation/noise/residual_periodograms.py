"""Periodograms of residuals in bands, and what each source of noise adds to them, gaps and all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, rfft

from casid.arrays import TINY, Array
from casid.estimation.noise.noise_response import Response

TAKEN = 0.01
"""Of the median of the next lines, below which a fit took the line at zero away (white: 7 %)."""
DEPENDENT = 1e-8
"""Eigenvalue of columns of unit size below which they depend on the others."""


@dataclass(frozen=True, slots=True, eq=False)
class Spectra:
    """Periodograms of all residuals in bands, and what a unit variance of each source adds."""

    design: Array  # (B, ny + ns) |G|^2
    power: Array  # (B,)
    count: Array  # (B,) frequencies of each band; a mean that the fit took away is none
    omega: Array  # (B,) rad/sample, their mean
    output: Array  # (B,) index of the output, and after those of each source `with_floors`
    tangent: Array | None = None  # (B, n, n) what `restricted` counts; None: nothing

    @property
    def least(self) -> Array:
        """A variance too small to tell from none, for each output in its own unit squared."""
        total = np.bincount(self.output, weights=self.count * self.power)
        count = np.bincount(self.output, weights=self.count)
        return np.asarray(1e-8 * np.maximum(total / count, TINY))

    @property
    def floor(self) -> Array:
        """The least variance for each band."""
        return np.asarray(self.least[self.output])


def spectra_of(
    residuals: Sequence[Array],
    responses: Sequence[Response],
    sources: Sequence[str],
    ny: int,
    windows: Sequence[Array],
    envelopes: Sequence[Array] | None = None,
    absorbed: Sequence[Array] | None = None,
) -> Spectra:
    """Periodograms of residuals (N, ny) in bands, and the responses to `sources` there.

    Parameters
    ----------
    windows : (N, ny) that each residual is multiplied by; zero where samples are missing. With
        such the responses are those of the periodogram's mean, whatever the gaps (Guillaumin,
        Sykulski, Olhede and Simons, J. R. Stat. Soc. B 84 (2022) 1526-1557).
    envelopes : the windows as they were without missing samples; ones by default.
    absorbed : (N // 2 + 1, ny, ny + ns) that a fit adds to the mean periodogram of each output, per
        variance of the outputs and of all sources of the responses; nothing by default.
    """
    envelopes = envelopes or [np.ones_like(w, dtype=float) for w in windows]
    rows, powers, counts, centres, outputs = [], [], [], [], []
    for e, (r, response, window, whole) in enumerate(
        zip(residuals, responses, windows, envelopes, strict=True)
    ):
        places = [response.sources.index(source) for source in sources]
        for i, (power, gain2, count, omega) in enumerate(_bins(r, response, window, whole)):
            own = np.zeros((len(power), ny))
            own[:, i] = np.mean(np.asarray(window[:, i], dtype=float) ** 2)
            row = np.hstack([own, gain2[:, places]])
            if absorbed is not None:
                of = [*range(ny), *(ny + place for place in places)]
                edges = band_edges(len(r))
                lines = np.diff(edges)[:, None]
                row += np.add.reduceat(absorbed[e][:, i, of], edges[:-1]) / lines
            rows.append(np.maximum(row, 0.0))
            powers.append(power)
            counts.append(count)
            centres.append(omega)
            outputs.append(np.full(len(power), i))
    joined = (np.concatenate(each) for each in (powers, counts, centres, outputs))
    return Spectra(np.vstack(rows), *joined)


def with_floors(
    spectra: Spectra, floors: Mapping[str, tuple[float, float]], sources: Sequence[str]
) -> Spectra:
    """The spectra with variances of sources that are known from elsewhere, as lines of their own.

    As the mean of a periodogram is, such a variance is Gamma distributed.

    Parameters
    ----------
    floors : source -> variance and its standard error. It counts once for every output.
    sources : of the columns of the design after those of the outputs.
    """
    if not floors:
        return spectra
    assert spectra.tangent is None
    ny, k = spectra.design.shape[1] - len(sources), len(floors)
    value, error = np.array(list(floors.values())).T
    design = np.zeros((k, spectra.design.shape[1]))
    design[range(k), [ny + sources.index(name) for name in floors]] = 1.0
    return Spectra(
        np.vstack([spectra.design, design]),
        np.concatenate([spectra.power, value]),
        np.concatenate([spectra.count, ny * (value / error) ** 2]),
        np.concatenate([spectra.omega, np.full(k, np.pi)]),
        np.concatenate([spectra.output, np.arange(ny, ny + k)]),
    )


def restricted(spectra: Spectra, s: Array) -> Array:
    """(...,) what the restricted likelihood adds to minus that of residuals of spectra s (..., B).

    A fit takes from a residual what its tangent T reaches, most of it slow where parameters are. By
    half of log det T^H S^-1 T (Patterson and Thompson, Biometrika 58 (1971) 545-554) what is not
    there speaks for no spectrum without power at those frequencies.
    """
    if spectra.tangent is None or not spectra.tangent.shape[1]:
        return np.zeros(s.shape[:-1])
    information = np.einsum("...b,bij->...ij", 1.0 / s, spectra.tangent)
    return np.asarray(0.5 * np.linalg.slogdet(information)[1])


def with_tangent(spectra: Spectra, columns: Sequence[Array]) -> Spectra:
    """The spectra of residuals with what a fit took out of these.

    Parameters
    ----------
    columns : (N, ny, n) an experiment, sensitivities of the residual under the same window.
    """
    parts = []
    # Near parameters at which a model is unstable, sensitivities grow until their squares overflow.
    largest = np.max([np.abs(each).max(axis=(0, 1), initial=0.0) for each in columns], axis=0)
    largest[largest <= TINY] = 1.0
    for each in columns:
        lines = np.fft.rfft(each / largest, axis=0) / np.sqrt(len(each))
        starts = band_edges(len(each))[:-1]
        for i in range(each.shape[1]):
            of = lines[:, i]
            power = np.real(of.conj()[:, :, None] * of[:, None, :])
            parts.append(np.add.reduceat(power, starts, axis=0))
    tangent = np.concatenate(parts)
    # In a basis in which white noise of the residual's size says as much of every column.
    size = np.sqrt(np.einsum("bii->i", tangent))
    kept = size > TINY
    tangent = tangent[:, kept][:, :, kept] / np.outer(size[kept], size[kept])
    values, basis = np.linalg.eigh(tangent.sum(axis=0))
    basis = basis[:, values > DEPENDENT] / np.sqrt(values[values > DEPENDENT])
    return replace(spectra, tangent=np.einsum("ik,bij,jl->bkl", basis, tangent, basis))


def band_edges(samples: int) -> Array:
    """Lines of a periodogram at which bands of growing width begin, and its end."""
    lines = samples // 2 + 1
    return np.unique(np.round(np.geomspace(1, lines + 1, 160)).astype(int)) - 1


def _bins(
    residual: Array, response: Response, window: Array, whole: Array
) -> list[tuple[Array, Array, Array, Array]]:
    """Periodogram and |G|^2 in bands of growing width: (power, gain2, count, omega) an output.

    The line at zero does not count where a fit took it away, as initial states and what acts like
    them do: an integrator would promise most of its power there.
    """
    n = len(residual)
    omega = 2 * np.pi * np.arange(n // 2 + 1) / n
    edges = band_edges(n)
    lines = np.diff(edges)
    centre = np.add.reduceat(omega, edges[:-1]) / lines
    out = []
    for i in range(residual.shape[1]):
        spectrum = np.abs(rfft(residual[:, i])) ** 2 / n
        count = lines.astype(float)
        count[0] -= spectrum[0] < TAKEN * float(np.median(spectrum[1:9]))
        power = np.add.reduceat(spectrum, edges[:-1]) / lines
        columns = []
        for j in range(response.gain2.shape[2]):
            g = np.interp(omega, response.omega, response.gain2[:, i, j])
            if not window[:, i].all():
                moved = _moved(window[:, i], whole[:, i], response.omega, response.gain2[:, i, j])
                g = np.maximum(g + moved, 0.0)
            columns.append(np.add.reduceat(g, edges[:-1]) / lines)
        gain2 = np.column_stack(columns) if columns else np.zeros((len(power), 0))
        out.append((power, gain2, count, centre))
    return out


def _moved(window: Array, whole: Array, omega: Array, spectrum: Array) -> Array:
    """Change of a mean periodogram (N // 2 + 1,) by missing samples; `whole` is without them.

    What the record's finite length does is the same in both, and the residual, whose initial state
    is fitted, has less of it than a stationary process.
    """
    return _seen_through(window, omega, spectrum) - _seen_through(whole, omega, spectrum)


def _seen_through(window: Array, omega: Array, spectrum: Array) -> Array:
    """The mean periodogram (N // 2 + 1,) of a process of this spectrum, times a window (N,).

    Its autocovariance at every lag times that of the window.
    """
    n = len(window)
    size = 2 * n
    grid = np.linspace(0.0, np.pi, n + 1)
    covariance = irfft(np.interp(grid, omega, spectrum), size)
    pairs = irfft(np.abs(rfft(np.asarray(window, dtype=float), size)) ** 2, size) / n
    return np.asarray(np.maximum(rfft(covariance * pairs).real[::2], 0.0))
