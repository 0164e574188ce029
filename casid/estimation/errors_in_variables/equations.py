"""Estimating equations of the simulation error whose mean is zero though measured inputs are noisy.

With y = yhat(theta, u) + e, and the recorded input u + w in the place of u, the residual at the
truth is r = e - G w, and the sensitivities are T + dG w: they are correlated, and T' r has another
mean than zero. Everything whitened by the spectrum S of r, all outputs together,

    s(theta) = Re [ T^H r + sum_w (K r)^H r ],    K = E[dG w (G w)^H],                        (1)

has mean zero at the truth. For a linear model (1) is the gradient of the likelihood of r under
S(theta), the maximum likelihood of errors in variables where the true input is not modelled
(Pintelon and Schoukens, System Identification, 2nd ed. 2012, section 9.9). What is simulated for K
is noise of constant periodogram and random phases, added to the recorded input and subtracted from
it: K is found without sampling error, and for nonlinear models as for linear ones.

The slope of the mean of (1) is -A, with A = T'T less what noise gives to it. The part of dG w that
is a multiple of r(w) leaves (1), so that its variance is

    B = T'T - sum_w |K|^2 + D V D'                                                            (2)

with the derivatives D by the variances of the noise and their covariance V.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.fft import irfft, rfft
from numpy.typing import NDArray

from casid.arrays import TINY, Array
from casid.estimation.simulation.signals import Signals
from casid.estimation.simulation.simulation_error import SimulationError, Whitener

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, eq=False)
class NoiseColumns:
    """What the noise of one input adds to outputs and sensitivities of one record, weighted."""

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


def columns_of(
    criterion: SimulationError, x: Array, input_sd: Mapping[str, float], seed: int = 0
) -> list[RecordColumns]:
    """The columns of every record at `x` (n,), for inputs with noise of `input_sd`."""
    inputs = list(criterion.model.inputs)
    weights = criterion.weights
    out = []
    for e, d in enumerate(criterion.data):
        at = criterion.simulated(x, e)
        noise = []
        for j, name in enumerate(sorted(n for n in inputs if input_sd.get(n, 0.0) > 0)):
            w = np.zeros(d.u.shape)
            rng = np.random.default_rng((seed, e, j))
            w[:, inputs.index(name)] = input_sd[name] * flat_noise(d.N, rng)
            up, down = (_simulated(criterion, x, e, replace(d, u=d.u + s * w)) for s in (1, -1))
            moved, turned = (0.5 * (a - b) for a, b in zip(up, down, strict=True))
            moved *= weights
            turned *= weights[:, None]
            noise.append(NoiseColumns(name, input_sd[name], moved, turned))
        tangent = at.jacobian * weights[:, None]
        out.append(RecordColumns(at.residual * weights, tangent, noise))
    return out


def _simulated(
    criterion: SimulationError, x: Array, e: int, signals: Signals
) -> tuple[Array, Array]:
    """Outputs and sensitivities of used samples under other inputs."""
    at = criterion.simulated(x, e, signals=signals)
    return at.y * signals.used, at.jacobian


def flat_noise(n: int, rng: np.random.Generator) -> Array:
    """(n,) of unit variance, constant periodogram and random phases."""
    phase = np.exp(2j * np.pi * rng.random(n // 2 + 1))
    phase[0] = 1.0 if phase[0].real >= 0 else -1.0
    if n % 2 == 0:
        phase[-1] = 1.0 if phase[-1].real >= 0 else -1.0
    return np.asarray(irfft(np.sqrt(n) * phase, n))


def equations(
    columns: Sequence[RecordColumns], whiten: Whitener, input_sd: Mapping[str, float]
) -> Equations:
    """(1) and (2), without its last term, under one whitening and with inputs that noisy."""
    n = columns[0].tangent.shape[2]
    score, bias = np.zeros(n), np.zeros(n)
    matrix, added, variance = (np.zeros((n, n)) for _ in range(3))
    for e, part in enumerate(columns):
        stack = np.concatenate([part.residual[:, :, None], part.tangent], axis=2)
        white = whiten(stack, e)
        r, t = white[:, :, 0], white[:, :, 1:]
        flat = t.reshape(-1, n)
        matrix += flat.T @ flat
        score += flat.T @ r.ravel()
        if not part.noise:
            continue
        both = both_halves(len(r))
        passed, turned = [], []
        for source in part.noise:
            stack = np.concatenate([source.moved[:, :, None], source.turned], axis=2)
            scale = input_sd[source.name] / source.sd
            spectrum = rfft(whiten(scale * stack, e), axis=0) / np.sqrt(len(r))
            passed.append(spectrum[:, :, 0])
            turned.append(spectrum[:, :, 1:])
            added += _product(turned[-1], both)
        spectrum = rfft(r, axis=0) / np.sqrt(len(r))
        for d, m in zip(turned, passed, strict=True):
            alike = np.einsum("fan,fa->fn", d.conj(), spectrum)
            score += (both * np.einsum("fa,fa->f", m, spectrum.conj()) @ alike).real
            bias -= np.einsum("fan,fa,f->n", d.conj(), m, both).real
            for d2, m2 in zip(turned, passed, strict=True):
                shared = both * np.einsum("fa,fa->f", m, m2.conj())
                variance -= np.einsum("fan,fam->nm", shared[:, None, None] * d.conj(), d2).real
    return Equations(score, matrix, added, matrix + variance, bias)


def both_halves(n: int) -> Array:
    """(n // 2 + 1,) how often each frequency of a real transform is on the circle."""
    out = np.full(n // 2 + 1, 2.0)
    out[0] = 1.0
    if n % 2 == 0:
        out[-1] = 1.0
    return out


def _product(spectrum: ComplexArray, both: Array) -> Array:
    """Sum of c c^H (n, n) over frequencies and outputs."""
    rows = (np.sqrt(both)[:, None, None] * spectrum).reshape(-1, spectrum.shape[2])
    return np.asarray((rows.conj().T @ rows).real)


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
