"""The missing force over time, whatever it depends on: smoothed out of the simulation error.

The force is a first-order Gauss-Markov process, added to a balance (or to an output),

    f[k+1] = a f[k] + w[k],   var w = (1 - a^2) v,   a = exp(-Ts / tau)                        (1)

whose variance v and memory tau maximise Whittle's likelihood of the residual under sensors' and
inputs' noise. Given them, the recursions of Kalman and of Rauch, Tung and Striebel (AIAA J. 3
(1965) 1445-1450) on the linearised simulation give the force and its standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft

from casid.arrays import TINY, Array
from casid.diagnosis.evidence.residual.linearised_path import Linearised
from casid.diagnosis.thresholds import SMOOTHING
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.simulation.simulation_error import SimulationError
from casid.linear.filtering.extended_smoother import backward_pass


@dataclass(frozen=True, slots=True, eq=False)
class ForceSeries:
    """The missing force of one record."""

    name: str
    t: Array  # (N,) s
    force: Array  # (N,) unit of the place
    sd: Array  # (N,) of its error, given variance and memory


@dataclass(frozen=True, slots=True, eq=False)
class ForceSpectrum:
    """Power density of the missing force: what the residual has beyond the noise, over |G|^2."""

    frequency: Array  # (F,) Hz
    density: Array  # (F,) unit^2/Hz, may be negative by chance
    floor: Array  # (F,) unit^2/Hz that the noise alone would give: where it is high nothing is seen
    sd: Array  # (F,) of density
    line: float | None  # Hz, of a narrow peak
    line_p: float  # that noise and (1) alone give a peak as high


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedForce:
    """The missing force over time, its spectrum, and whether it is better known than its noise."""

    series: tuple[ForceSeries, ...]
    spectrum: ForceSpectrum
    variance: float  # v of (1)
    memory: float  # tau of (1) [s]
    evidence: float  # log-likelihood gained by (1)
    share_seen: float  # of v that the smoother finds: 1 - mean(sd^2) / v

    @property
    def is_seen(self) -> bool:
        """True where there is a force at all, and its error is smaller than the force itself.

        Eight units of log-likelihood are beyond what two parameters gain by chance in 1 of 1000.
        """
        return self.evidence > SMOOTHING.evidence and self.share_seen > SMOOTHING.share


def smoothed_force(
    criterion: SimulationError,
    x: Array,
    noise: NoiseModel,
    place: str,
    input_sd: Mapping[str, float],
    linearised: Linearised | None = None,
) -> SmoothedForce:
    """Estimate what is missing in a balance, or in an output, from the residual at `x`.

    Parameters
    ----------
    noise : of sensors and measured inputs alone, see `NoiseModel.quiet`.
    place : a balance or an output.
    """
    linearised = linearised or Linearised(criterion, x)
    ordinates = [_ordinates(criterion, x, noise, place, e) for e in range(len(criterion.data))]
    Ts = criterion.data[0].Ts
    process, evidence = _levels(ordinates, Ts)
    variance, memory = process.variance, process.memory
    spectrum = _spectrum(ordinates, process, Ts)
    series, seen = [], []
    for e in range(len(criterion.data)):
        one = _smooth(linearised, noise, input_sd, place, process, e)
        series.append(one)
        seen.append(float(np.mean(one.sd**2)))
    share = 1.0 - float(np.mean(seen)) / variance if variance > 0 else 0.0
    return SmoothedForce(tuple(series), spectrum, variance, memory, evidence, max(share, 0.0))


# -- levels ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Process:
    """The first-order Gauss-Markov process (1)."""

    variance: float
    memory: float  # s


@dataclass(frozen=True, slots=True, eq=False)
class _Ordinates:
    """Periodogram, noise and |G|^2 at the Fourier frequencies of one output of one record."""

    omega: Array  # rad/sample
    power: Array
    noise: Array
    gain2: Array


def _ordinates(
    criterion: SimulationError, x: Array, noise: NoiseModel, place: str, e: int
) -> list[_Ordinates]:
    residual = criterion.simulated(x, e).residual
    n, response, s = len(residual), noise.responses[e], noise.spectrum(e)
    omega = 2 * np.pi * np.arange(1, n // 2) / n
    out = []
    for i, name in enumerate(criterion.outputs):
        if place in criterion.model.balances:
            g = response.gain2[:, i, response.sources.index(place)]
        else:
            g = np.full(len(response.omega), float(name == place))
        r = residual[:, i] - residual[:, i].mean()
        out.append(
            _Ordinates(
                omega,
                np.abs(rfft(r))[1 : n // 2] ** 2 / n,
                np.interp(omega, response.omega, s[:, i]),
                np.interp(omega, response.omega, g),
            )
        )
    return out


def _process(omega: Array, memory: float, Ts: float) -> Array:
    """Power per sample of (1) with unit variance."""
    a = float(np.exp(-Ts / memory))
    return np.asarray((1 - a**2) / (1 - 2 * a * np.cos(omega) + a**2))


def _levels(ordinates: list[list[_Ordinates]], Ts: float) -> tuple[_Process, float]:
    """The likeliest process and the log-likelihood it gains, on a grid that is then refined."""
    flat = [o for one in ordinates for o in one if np.any(o.gain2 > 0)]
    if not flat:
        return _Process(0.0, Ts), 0.0
    # In bands: the mean of exponentials is all that their common mean needs.
    rows = []
    for o in flat:
        edges = (
            np.unique(np.geomspace(1, len(o.omega) + 1, SMOOTHING.likelihood_bands).astype(int)) - 1
        )
        count = np.diff(edges)
        rows.append(
            [np.add.reduceat(v, edges[:-1]) / count for v in (o.omega, o.power, o.noise, o.gain2)]
            + [count.astype(float)]
        )
    omega, power, s, gain2, count = (np.concatenate([r[i] for r in rows]) for i in range(5))

    def loss(v: Array, memory: float) -> Array:
        total = s + np.multiply.outer(v, gain2 * _process(omega, memory, Ts))
        return np.asarray((count * (np.log(total) + power / total)).sum(axis=-1))

    none = float(loss(np.zeros(1), Ts)[0])
    scale = float(np.sum(count * power) / max(float(np.sum(count * gain2)), TINY))
    best = (0.0, 0.0, Ts)
    longest = 2 * np.pi / float(omega.min()) * Ts
    for memory in np.geomspace(0.5 * Ts, SMOOTHING.longest_memory * longest, SMOOTHING.memories):
        grid = scale * np.geomspace(1e-5, 1e4, 37)
        for _ in range(2):
            found = none - loss(grid, float(memory))
            top = float(grid[int(np.argmax(found))])
            grid = top * np.geomspace(0.6, 1.7, 9)
        if found.max() > best[0]:
            best = (float(found.max()), top, float(memory))
    return _Process(best[1], best[2]), best[0]


def _spectrum(ordinates: list[list[_Ordinates]], process: _Process, Ts: float) -> ForceSpectrum:
    """Weighted over outputs and records by information: |G|^4 / S^2, S with the force in it."""
    low = min(o.omega[0] for one in ordinates for o in one)
    edges = np.geomspace(low * 0.999, np.pi, SMOOTHING.bands + 1)
    top, bottom, floor = (np.zeros(SMOOTHING.bands) for _ in range(3))
    largest, where, count = 0.0, 0.0, 0
    for one in ordinates:
        for o in one:
            total = o.noise + process.variance * o.gain2 * _process(o.omega, process.memory, Ts)
            weight = o.gain2**2 / total**2
            band = np.clip(np.searchsorted(edges, o.omega) - 1, 0, SMOOTHING.bands - 1)
            with np.errstate(divide="ignore", invalid="ignore"):
                apart = np.where(o.gain2 > 0, (o.power - o.noise) / o.gain2, 0.0)
            top += np.bincount(band, weight * apart, SMOOTHING.bands)
            bottom += np.bincount(band, weight, SMOOTHING.bands)
            floor += np.bincount(band, o.gain2**2 / o.noise**2, SMOOTHING.bands)
            # The ratio to a smooth spectrum, by the median beside it: a line stands out alone.
            if len(o.power) > 2 * SMOOTHING.line_window and np.any(o.gain2 > 0):
                ratio = o.power / total
                width = SMOOTHING.line_window
                padded = np.pad(ratio, width, mode="reflect")
                windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * width + 1)
                # The median of exponentials is ln 2 of their mean.
                local = np.maximum(np.median(windows, axis=1) / np.log(2), 1.0)
                j = int(np.argmax(ratio / local))
                count += len(ratio)
                if ratio[j] / local[j] > largest:
                    largest, where = float(ratio[j] / local[j]), float(o.omega[j])
    known = bottom > 0
    to_density = 2 * Ts  # of a per-sample power to one-sided density
    centre = np.sqrt(edges[:-1] * edges[1:]) / (2 * np.pi * Ts)
    p = float(-np.expm1(count * np.log1p(-np.exp(-min(largest, 700.0))))) if count else 1.0
    return ForceSpectrum(
        frequency=centre[known],
        density=to_density * top[known] / bottom[known],
        floor=to_density / np.sqrt(np.maximum(floor[known], TINY)),
        sd=to_density / np.sqrt(bottom[known]),
        line=where / (2 * np.pi * Ts) if p < SMOOTHING.line_p else None,
        line_p=p,
    )


# -- smoothing ------------------------------------------------------------------------------------


def _smooth(
    linearised: Linearised,
    noise: NoiseModel,
    input_sd: Mapping[str, float],
    place: str,
    process: _Process,
    e: int,
) -> ForceSeries:
    """The force in one record, and the standard deviation of its error."""
    criterion, variance = linearised.criterion, process.variance
    d, model = criterion.data[e], criterion.model
    at = criterion.simulated(linearised.x, e)
    path = linearised.path(e, at.x[: d.N], d)
    n, nx, ny = d.N, path.A.shape[1], len(criterion.outputs)
    if place in model.balances:
        j = list(model.balances).index(place)
        b0, b1, direct = path.B0[:, :, j], path.B1[:, :, j], path.D[:, :, j]
    else:
        b0 = b1 = np.zeros((n, nx))
        direct = np.zeros((n, ny))
        direct[:, criterion.outputs.index(place)] = 1.0
    if variance <= 0:
        return ForceSeries(d.name, d.t, np.zeros(n), np.zeros(n))
    a = float(np.exp(-d.Ts / process.memory))
    F = np.zeros((n, nx + 1, nx + 1))
    F[:, :nx, :nx], F[:, :nx, nx], F[:, nx, nx] = path.A, b0 + a * b1, a
    push = np.concatenate([b1, np.ones((n, 1))], axis=1)
    Q = (1 - a**2) * variance * push[:, :, None] * push[:, None, :]
    sd = np.array([input_sd.get(name, 0.0) for name in model.inputs])
    moved = path.inputs * sd
    Q[:, :nx, :nx] += moved @ moved.transpose(0, 2, 1)
    H = np.concatenate([path.C, direct[:, :, None]], axis=2)
    R = noise.output_sd**2 + np.sum((path.feedthrough * sd) ** 2, axis=2)  # (N, ny)
    spread = np.mean(at.x[: d.N] ** 2, axis=0)
    P0 = np.diag(np.append(np.maximum(spread, 1e-12), variance))
    Q[path.anew - 1, :nx, :nx] = P0[:nx, :nx]
    z, P = _rauch_tung_striebel(F, Q, H, R, at.residual, d.used, P0)
    return ForceSeries(d.name, d.t, z, np.sqrt(np.maximum(P, 0.0)))


def _rauch_tung_striebel(
    F: Array, Q: Array, H: Array, R: Array, r: Array, used: Array, P0: Array
) -> tuple[Array, Array]:
    """Smoothed last state (N,) and its variance (N,); outputs are taken in one by one."""
    n, nz = len(F), F.shape[1]
    ahead, P_ahead = np.zeros((n, nz)), np.zeros((n, nz, nz))
    x, P = np.zeros((n, nz)), np.zeros((n, nz, nz))
    m, C = np.zeros(nz), P0
    for k in range(n):
        ahead[k], P_ahead[k] = m, C
        for i in range(H.shape[1]):
            if not used[k, i]:
                continue
            h = H[k, i]
            gain = C @ h
            scale = 1.0 / (h @ gain + R[k, i])
            m = m + gain * (scale * (r[k, i] - h @ m))
            C = C - np.multiply.outer(gain, gain * scale)
        x[k], P[k] = m, C
        m = F[k] @ m
        C = F[k] @ C @ F[k].T + Q[k]
    x, P = backward_pass(F[:-1], x, P, ahead[1:], P_ahead[1:], ridge=1e-12)
    return x[:, -1], P[:, -1, -1]
