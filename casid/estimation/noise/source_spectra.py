"""Spectra and cross-spectra of residuals, over the variances and shapes of their sources.

    S(w; phi) = diag(sigma_i^2) + sum_j sigma_j^2 s_j(w) g_j(w) g_j(w)^H                       (1)

with g_j the responses of all outputs to a source, and s_j its shape. Of a force that acts in
several balances, g_j is the sum of their responses, each times its ratio.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.fft import rfft

from casid.arrays import TINY, Array
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum, Part, parts_of
from casid.estimation.noise.noise_response import Response
from casid.estimation.noise.residual_periodograms import band_edges

LOG_SHAPE_STEP = 1e-4
"""Change of the logarithm of a shape over which a spectrum is differentiated."""


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """The transform of what is tapered by Hann's window, in bands of lines.

    Attributes
    ----------
    values : (L, ny, m) at every line.
    edges, count, omega : (F,) first line, number of lines and mean frequency [rad/sample] of each
        band.
    """

    values: Array
    edges: Array
    count: Array
    omega: Array


def lines_of(columns: Array) -> Lines:
    """Transforms of columns (N, ny, m) in bands, without the line at zero."""
    N = len(columns)
    window = np.hanning(N + 2)[1:-1]
    window = window / np.sqrt(np.sum(window**2))
    lines = rfft(columns * window[:, None, None], axis=0)[1 : (N + 1) // 2]
    edges = np.maximum(band_edges(N)[:-1] - 1, 0)
    edges = np.unique(edges[edges < len(lines)])
    count = np.diff([*edges, len(lines)]).astype(float)
    omega = 2 * np.pi * np.add.reduceat(np.arange(1, len(lines) + 1), edges) / (count * N)
    return Lines(lines, edges, count, omega)


@dataclass(frozen=True, slots=True)
class _Entry:
    """Meaning of one place of phi: a property of an output or a source by its name."""

    kind: Literal["output", "source", "frequency", "damping", "ratio"]
    of: str
    part: int = 0  # of a ratio: its place among the parts
    size: float = 1.0  # of a ratio: its unit


class SourceSpectra:
    """(1) over phi: log variances, log shapes, and ratios in units of their sizes.

    Parameters
    ----------
    outputs, output_sd : their names and white noise.
    source_sd : of every source that there is.
    spectra : of those that are not white.
    given : outputs and sources whose noise is known.
    sizes : (source, place) -> unit of a ratio; default its value.
    """

    def __init__(
        self,
        outputs: Sequence[str],
        output_sd: Array,
        source_sd: Mapping[str, float],
        spectra: Mapping[str, DisturbanceSpectrum],
        given: tuple[Mapping[str, float], Mapping[str, float]],
        sizes: Mapping[tuple[str, str], float] | None = None,
    ) -> None:
        self.outputs, self._output_sd = list(outputs), np.asarray(output_sd, dtype=float)
        self._source_sd = {n: sd for n, sd in source_sd.items() if sd > 0.0}
        free = [n for n in self._source_sd if n not in given[1]]
        self._spectra = {n: spectra[n] for n in self._source_sd if n in spectra}
        entries, start = [], []
        for i, name in enumerate(self.outputs):
            if name not in given[0]:
                entries.append(_Entry("output", name))
                start.append(2 * np.log(max(float(self._output_sd[i]), TINY)))
        for name in free:
            entries.append(_Entry("source", name))
            start.append(2 * np.log(self._source_sd[name]))
        for name in (n for n in free if n in self._spectra):
            shape = self._spectra[name]
            entries.append(_Entry("frequency", name))
            start.append(np.log(shape.frequency))
            if shape.damping is not None:
                entries.append(_Entry("damping", name))
                start.append(np.log(shape.damping))
            for k, part in enumerate(shape.parts[1:], start=1):
                size = (sizes or {}).get((name, part.place), abs(part.ratio) or 1.0)
                entries.append(_Entry("ratio", name, k, size))
                start.append(part.ratio / size)
        self.entries, self.start = entries, np.array(start)

    def read(
        self, phi: Array, information: Array | None = None
    ) -> tuple[Array, dict[str, float], dict[str, DisturbanceSpectrum]]:
        """(ny,) variances of the outputs, those of the sources, and their spectra.

        Parameters
        ----------
        information : about phi; ratios have standard errors by it, else those they began with.
        """
        white, scales = self._output_sd**2, {n: sd**2 for n, sd in self._source_sd.items()}
        spectra = dict(self._spectra)
        errors = None
        if information is not None:
            size = np.sqrt(np.maximum(np.diag(information), TINY))
            inverse = np.linalg.pinv(information / np.outer(size, size), hermitian=True)
            errors = np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size
        for k, (value, entry) in enumerate(zip(phi.tolist(), self.entries, strict=True)):
            name = entry.of
            if entry.kind == "output":
                white[self.outputs.index(name)] = np.exp(value)
            elif entry.kind == "source":
                scales[name] = float(np.exp(value))
            elif entry.kind == "ratio":
                parts = list(spectra[name].parts)
                place, error = parts[entry.part].place, parts[entry.part].error
                if errors is not None:
                    error = float(errors[k]) * entry.size
                parts[entry.part] = Part(place, value * entry.size, error)
                spectra[name] = replace(spectra[name], parts=tuple(parts))
            else:
                spectra[name] = _with(spectra[name], entry.kind, float(np.exp(value)))
        return white, scales, spectra

    def at(self, phi: Array, r: Response, Ts: float) -> tuple[Array, dict[int, Array]]:
        """S (F, ny, ny), and its derivative for each place of phi."""
        white, scales, spectra = self.read(phi)
        columns = self._columns(r, spectra)
        full = _spectra_of(scales, spectra, r.omega, Ts)
        parts = {n: full[n][:, None, None] * _outer(columns[n]) for n in scales}
        ny = len(self.outputs)
        S = np.zeros((len(r.omega), ny, ny), complex) + np.diag(white) + sum(parts.values())
        slopes: dict[int, Array] = {}
        for k, entry in enumerate(self.entries):
            name = entry.of
            if entry.kind == "output":
                one = np.zeros((ny, ny))
                one[self.outputs.index(name), self.outputs.index(name)] = 1.0
                slopes[k] = np.broadcast_to(one * white[self.outputs.index(name)], S.shape)
            elif entry.kind == "source":
                slopes[k] = parts[name]
            elif entry.kind == "ratio":
                place = spectra[name].parts[entry.part].place
                both = columns[name][:, :, None] * self._gain(r, place)[:, None, :].conj()
                both = both + both.conj().swapaxes(1, 2)
                slopes[k] = entry.size * full[name][:, None, None] * both
            else:
                moved = getattr(spectra[name], entry.kind) * np.exp(LOG_SHAPE_STEP)
                after = _with(spectra[name], entry.kind, float(moved)).of(r.omega, Ts)
                slope = (scales[name] * after - full[name]) / LOG_SHAPE_STEP
                slopes[k] = slope[:, None, None] * _outer(columns[name])
        return S, slopes

    def spectra_at(self, phi: Array, r: Response, Ts: float) -> tuple[Array, dict[str, Array]]:
        """(F, ny) the spectra of all outputs, and what each source adds to them."""
        white, scales, spectra = self.read(phi)
        full, columns = _spectra_of(scales, spectra, r.omega, Ts), self._columns(r, spectra)
        own = {name: full[name][:, None] * np.abs(column) ** 2 for name, column in columns.items()}
        return white + sum(own.values()), own

    def change(self, phi: Array, r: Response, moved: Response, Ts: float) -> Array:
        """(F, ny, ny) by which S changes where the responses move."""
        _, scales, spectra = self.read(phi)
        before, after = self._columns(r, spectra), self._columns(moved, spectra)
        S = np.zeros((len(r.omega), len(self.outputs), len(self.outputs)), complex)
        for name, own in _spectra_of(scales, spectra, r.omega, Ts).items():
            S += own[:, None, None] * (_outer(after[name]) - _outer(before[name]))
        return S

    def _columns(self, r: Response, spectra: Mapping[str, DisturbanceSpectrum]) -> dict[str, Array]:
        """(F, ny) responses to each source."""
        out = {}
        for name in self._source_sd:
            out[name] = sum(p.ratio * self._gain(r, p.place) for p in parts_of(name, spectra))
        return {n: np.asarray(g) for n, g in out.items()}

    @staticmethod
    def _gain(r: Response, place: str) -> Array:
        assert r.gain is not None
        return r.gain[:, :, r.sources.index(place)]


def _spectra_of(
    scales: Mapping[str, float],
    spectra: Mapping[str, DisturbanceSpectrum],
    omega: Array,
    Ts: float,
) -> dict[str, Array]:
    """(F,) of each source by itself; of one without a shape its variance."""
    white = np.ones(len(omega))
    return {n: v * (spectra[n].of(omega, Ts) if n in spectra else white) for n, v in scales.items()}


def _with(spectrum: DisturbanceSpectrum, kind: str, value: float) -> DisturbanceSpectrum:
    """The spectrum with another frequency or damping."""
    if kind == "frequency":
        return replace(spectrum, frequency=value)
    return replace(spectrum, damping=value)


def _outer(g: Array) -> Array:
    """(F, ny, ny) g g^H of responses g (F, ny)."""
    return np.asarray(g[:, :, None] * g[:, None, :].conj())
