"""Estimating equations of the simulation error whose mean is zero though measured inputs are noisy.

With y = yhat(theta, u) + e, and the recorded input u + w in the place of u, the residual at the
truth is r = e - G w, and the sensitivities are T + dG w: they are correlated, and T' r has another
mean than zero. Everything whitened by the spectrum S of r, all outputs together,

    s(theta) = Re [ T^H r + sum_w (K r)^H r ],    K = E[dG w (G w)^H],                        (1)

has mean zero at the truth. For a linear model (1) is the gradient of the likelihood of r under
S(theta), the maximum likelihood of errors in variables where the true input is not modelled
(Pintelon and Schoukens, System Identification, 2nd ed. 2012, section 9.9). What is simulated for K
is noise of constant periodogram and random phases, a share of its size, added to the recorded input
and subtracted from it: K is found without sampling error, and for nonlinear models as for linear
ones.

The slope of the mean of (1) is -A, with A = T'T less what noise gives to it. The part of dG w that
is a multiple of r(w) leaves (1), so that its variance is

    B = T'T - sum_w |K|^2 + D V D'                                                            (2)

with the derivatives D by the variances of the noise and their covariance V.

Where outputs miss samples, r and T are those of the samples that there are: with W the whitening of
a complete record and P the projection on what missing samples could have given (`missing_samples`),
r = (1 - P) W (e - G w). K stays that of complete records, since r K r and the trace of K (1 - P)
have the same mean, and what it does is projected wherever (2) or the mean of T'r is formed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.fft import irfft, rfft
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from casid.arrays import TINY, Array, BoolArray
from casid.estimation.noise.filled_noise import noise_spectrum
from casid.estimation.noise.noise_response import may_vary
from casid.estimation.noise.thresholds import REMOVAL
from casid.estimation.simulation.records.signals import Signals
from casid.estimation.simulation.simulation_error import SimulationError

ComplexArray = NDArray[np.complex128]


class Whitening(Protocol):
    """W and P of the records."""

    def whiten(self, columns: Array, experiment: int, used: BoolArray | None = None) -> Array:
        """Columns (N, ny, m) whitened; as of a record with these `used` (N, ny) samples."""

    def seen(self, white: Array, experiment: int) -> Array:
        """(1 - P) times columns (N, ny, m) that are whitened as of a complete record."""


@dataclass(frozen=True, slots=True, eq=False)
class NoiseColumns:
    """What the noise of one input adds to outputs and sensitivities of one record, weighted.

    As of complete records, whatever samples are missing.
    """

    name: str
    sd: float  # that it is simulated with
    moved: Array  # (N, ny)
    turned: Array  # (N, ny, n)


@dataclass(frozen=True, slots=True, eq=False)
class RecordColumns:
    """Weighted residual and sensitivities of one record, and what noise adds to them."""

    residual: Array  # (N, ny)
    tangent: Array  # (N, ny, n)
    noise: Sequence[NoiseColumns]
    lines: int = 1  # over how many frequencies K is a mean


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """(1) at one point, with its matrices."""

    score: Array  # (n,)
    matrix: Array  # (n, n) T'T as it is recorded
    noise: Array  # (n, n) what noise on inputs gives to it
    variance: Array  # (n, n) of the score, for known variances of the noise
    bias: Array  # (n,) mean of T'r

    @property
    def slope(self) -> Array:
        """A (n, n)."""
        return self.matrix - self.noise


def flat_noise(n: int, rng: np.random.Generator) -> Array:
    """(n,) of unit variance, constant periodogram and random phases."""
    phase = np.exp(2j * np.pi * rng.random(n // 2 + 1))
    phase[0] = 1.0 if phase[0].real >= 0 else -1.0
    if n % 2 == 0:
        phase[-1] = 1.0 if phase[-1].real >= 0 else -1.0
    return np.asarray(irfft(np.sqrt(n) * phase, n))


def gaussian_noise(n: int, rng: np.random.Generator) -> Array:
    """(n,) of unit variance, whose power at a resonance differs from draw to draw.

    Of a stream of its own: a simulated record may hold the numbers of the same seed.
    """
    return rng.spawn(1)[0].standard_normal(n)


def columns_of(
    criterion: SimulationError,
    x: Array,
    input_sd: Mapping[str, float],
    seed: int = 0,
    *,
    drawn: Callable[[int, np.random.Generator], Array] = flat_noise,
) -> list[RecordColumns]:
    """The columns of every record at `x` (n,), for inputs with noise of `input_sd`.

    `drawn` is noise of unit variance; by default one whose power is the same in every draw.
    """
    inputs = list(criterion.model.inputs)
    weights, share = criterion.weights, REMOVAL.drawn_share
    lines = REMOVAL.lines if may_vary(criterion) else 1
    out = []
    for e, d in enumerate(criterion.data):
        at = criterion.simulated(x, e)
        noise = []
        for j, name in enumerate(sorted(n for n in inputs if input_sd.get(n, 0.0) > 0)):
            w = np.zeros(d.u.shape)
            rng = np.random.default_rng((seed, e, j))
            own, column = drawn(d.N, rng), inputs.index(name)
            named = name, criterion.model.inputs[name].hold
            omega = np.linspace(0.0, 2 * np.pi * (d.N // 2) / d.N, d.N // 2 + 1)
            root = np.sqrt(noise_spectrum(criterion.data, e, column, named, omega))
            own = own if np.all(root == 1.0) else irfft(root * rfft(own), d.N)
            w[:, column] = share * input_sd[name] * own
            whole = replace(d, used=np.ones_like(d.used))
            up, down = (_simulated(criterion, x, e, replace(whole, u=d.u + s * w)) for s in (1, -1))
            moved, turned = ((a - b) / (2 * share) for a, b in zip(up, down, strict=True))
            moved *= weights
            turned *= weights[:, None]
            noise.append(NoiseColumns(name, input_sd[name], moved, turned))
        tangent = at.jacobian * weights[:, None]
        out.append(RecordColumns(at.residual * weights, tangent, noise, lines))
    return out


def _simulated(
    criterion: SimulationError, x: Array, e: int, signals: Signals
) -> tuple[Array, Array]:
    """Outputs and sensitivities under other inputs."""
    at = criterion.simulated(x, e, signals=signals)
    return at.y, at.jacobian


def equations(
    columns: Sequence[RecordColumns], whitening: Whitening, input_sd: Mapping[str, float]
) -> Equations:
    """(1) and (2), without its last term, under one whitening and with inputs that noisy."""
    n = columns[0].tangent.shape[2]
    score, bias = np.zeros(n), np.zeros(n)
    matrix, added, variance = (np.zeros((n, n)) for _ in range(3))
    for e, part in enumerate(columns):
        stack = np.concatenate([part.residual[:, :, None], part.tangent], axis=2)
        white = whitening.whiten(stack, e)
        r, t = white[:, :, 0], white[:, :, 1:]
        flat = t.reshape(-1, n)
        matrix += flat.T @ flat
        score += flat.T @ r.ravel()
        if not part.noise:
            continue
        passed, turned = [], []
        for source in part.noise:
            stack = np.concatenate([source.moved[:, :, None], source.turned], axis=2)
            scale = input_sd[source.name] / source.sd
            whole = whitening.whiten(scale * stack, e, np.ones(r.shape, dtype=bool))
            spectrum = rfft(whole, axis=0) / np.sqrt(len(r))
            passed.append(spectrum[:, :, 0])
            turned.append(spectrum[:, :, 1:])
            seen = whitening.seen(whole, e)
            d = seen[:, :, 1:].reshape(-1, n)
            added += d.T @ d
            bias -= d.T @ seen[:, :, 0].ravel()
        K = _K(turned, passed, part.lines)
        score += _carried(K, r).reshape(-1, n).T @ r.ravel()
        variance -= _shared(K, whitening, (e, *r.shape))
    return Equations(score, matrix, added, matrix + variance, bias)


def _K(turned: Sequence[ComplexArray], passed: Sequence[ComplexArray], lines: int) -> ComplexArray:
    """K (F, ny, n, ny), of dG w to each unknown from G w.

    Parameters
    ----------
    turned, passed : spectra (F, ny, n) and (F, ny) of dG w and G w, one an input.
    """
    parts = [
        d[:, :, :, None] * m.conj()[:, None, None, :] for d, m in zip(turned, passed, strict=True)
    ]
    K = np.sum(parts, axis=0)
    if lines > 1:
        K = uniform_filter1d(K, min(lines, len(K)), axis=0, mode="mirror")
    return np.asarray(K)


def _carried(K: ComplexArray, r: Array) -> Array:
    """sum_w K r (N, ny, n) of whitened columns r (N, ny)."""
    spectrum = rfft(r, axis=0)
    return np.asarray(irfft(np.einsum("fink,fk->fin", K, spectrum), len(r), axis=0))


def _shared(K: ComplexArray, whitening: Whitening, of: tuple[int, int, int]) -> Array:
    """sum_w |K|^2 (n, n) among the samples that there are, of an experiment of (N, ny).

    The trace of K'K from columns of noise of constant periodogram, one an output: without sampling
    error where no sample is missing.
    """
    experiment, N, ny = of
    n = K.shape[2]
    out = np.zeros((n, n))
    for a in range(ny):
        e = np.zeros((N, ny, 1))
        e[:, a, 0] = flat_noise(N, np.random.default_rng((experiment, a)))
        e = whitening.seen(e, experiment)
        rows = whitening.seen(_carried(K, e[:, :, 0]), experiment).reshape(-1, n)
        out += rows.T @ rows
    return out


def both_halves(n: int) -> Array:
    """(n // 2 + 1,) how often each frequency of a real transform is on the circle."""
    out = np.full(n // 2 + 1, 2.0)
    out[0] = 1.0
    if n % 2 == 0:
        out[-1] = 1.0
    return out


def step(at: Equations, free: Array, least: float) -> tuple[Array, float, float]:
    """Gauss-Newton step (n,) of the `free` unknowns towards the root of (1).

    Its length in standard errors, and the least share of information that noise leaves to any
    combination of them, stand behind it. With less than `least` the step is held short.
    """
    index = np.flatnonzero(free)
    matrix, noise = (m[np.ix_(index, index)] for m in (at.matrix, at.noise))
    size = np.sqrt(np.maximum(np.diag(matrix), TINY))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    seen = values > 1e-12 * values[-1]
    root = vectors[:, seen] / np.sqrt(values[seen]) / size[:, None]  # root' (T'T) root = 1
    share, axes = np.linalg.eigh(np.eye(int(seen.sum())) - root.T @ noise @ root)
    scaled = axes @ ((axes.T @ (root.T @ at.score[index])) / np.maximum(share, least))
    out = np.zeros(len(free))
    out[index] = root @ scaled
    return out, float(np.linalg.norm(scaled)), float(share.min())
