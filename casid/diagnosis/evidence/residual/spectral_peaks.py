"""Narrow peaks in the spectrum of a whitened residual: what a periodic force leaves.

At frequency f the periodogram over its local level, z = I(f) / S(f), is exponential with mean one
where the residual is a stationary process whose spectrum is smooth over some tens of lines
(Priestley 1981, 6.2). S(f) is an autoregression's spectrum times the median of the n neighbouring
lines over a = sum_{i<r} 1/(n - i), its mean in units of S, so that other peaks do not lift it. That
it is estimated makes the tail of z heavier; for an exponential sample's r-th order statistic (Renyi
1953) exactly

    P(z > x) = prod_{i<r} (n - i) / (n - i + x / a).                                        (1)

The largest over all frequencies, on the grid and between, exceeds x with probability

    p = 1 - (1 - P) exp(-W sqrt(x) P),   W = sqrt(pi/3) B T,                                  (2)

B T lines being searched (Baluev 2008, Mon. Not. R. Astron. Soc. 385, 1279, (7) for a constant
sampling; Fisher 1929 tests the lines of the grid alone).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.optimize import minimize_scalar

from casid.arrays import TINY, Array
from casid.diagnosis.thresholds import PEAKS
from casid.estimation.simulation.minimization import Fit, widened
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.balances.periodic import periodic_disturbance
from casid.model.effects.effect import Effect
from casid.model.effects.places.places import places_of


@dataclass(frozen=True, slots=True)
class Peak:
    """One narrow peak of the residual."""

    frequency: float  # Hz
    amplitude: float  # of the sinusoid in the whitened residual
    p_value: float  # over all frequencies, outputs and records searched
    power: float  # over the local level
    record: int
    output: int


def find_peaks(
    residuals: Sequence[Array],
    Ts: Sequence[float],
    *,
    alpha: float = 0.05,
    most: int = PEAKS.most,
    neighbours: tuple[int, int] = PEAKS.neighbours,
) -> list[Peak]:
    """The peaks that chance would not bring, the most significant first.

    Parameters
    ----------
    residuals : (N, ny) whitened residual of each record, zero where a sample is not used.
    Ts : sample time of each record [s].
    alpha : peaks with p below are returned, at most `most` of them.
    neighbours : lines on either side that the level is taken of, at least and at most.

    Notes
    -----
    Records are searched apart: a clock of its own gives each another phase. A line at the same
    frequency in two of them comes once, where it is more significant. The lowest three lines are
    left to trends. Records of fewer than 64 samples are too short for a level and give no peak. An
    output that is sampled in one row of several is searched up to half its own rate.
    """
    tried = sum(r.shape[1] for r in residuals)
    found: list[Peak] = []
    for k, (r, step) in enumerate(zip(residuals, Ts, strict=True)):
        for i in range(r.shape[1]):
            for f, amplitude, power, p in _peaks_of(r[:, i], step, most, neighbours):
                adjusted = -np.expm1(tried * np.log1p(-min(p, 1.0 - 1e-12)))
                adjusted = min(1.0, tried * p) if p < 1e-9 else float(adjusted)
                found.append(Peak(f, amplitude, max(adjusted, TINY), power, k, i))
    found.sort(key=lambda peak: (peak.p_value, -peak.power))
    kept: list[Peak] = []
    for peak in found:
        width = PEAKS.guard / (len(residuals[peak.record]) * Ts[peak.record])
        apart = all(abs(peak.frequency - other.frequency) > width for other in kept)
        if peak.p_value < alpha and apart:
            kept.append(peak)
    return kept[:most]


def tail(x: float, n: int, r: int) -> float:
    """(1): probability that one line exceeds `x` times the level, of n neighbours the r-th."""
    i = np.arange(r)
    a = float(np.sum(1.0 / (n - i)))
    return float(np.exp(-np.sum(np.log1p(x / a / (n - i)))))


def _peaks_of(
    e: Array, Ts: float, most: int, neighbours: tuple[int, int]
) -> list[tuple[float, float, float, float]]:
    """(frequency, amplitude, power over level, p) of the largest peaks of one column (N,)."""
    N, every = len(e), _own_clock(e)
    if N < PEAKS.shortest * every or not np.any(e):
        return []
    lines = np.arange(PEAKS.first, N // (2 * every))
    shape = _smooth_shape(e)  # (PEAKS.finer N / 2 + 1,)
    raw = np.abs(np.fft.rfft(e)) ** 2 / N / shape[:: PEAKS.finer][: N // 2 + 1]
    level, n, r = _levels(raw, lines, neighbours)
    fine = np.arange(PEAKS.finer * lines[0], PEAKS.finer * lines[-1] + 1)
    nearest = np.clip(np.rint(fine / PEAKS.finer).astype(int) - lines[0], 0, len(lines) - 1)
    expected = level[nearest] * shape[fine]
    W = np.sqrt(np.pi / 3) * len(lines)
    out = []
    t = np.arange(N)
    for _ in range(most):
        ratio = np.abs(np.fft.rfft(e, PEAKS.finer * N)[fine]) ** 2 / N / expected
        at = int(np.argmax(ratio))
        f, height = _refined(e, t, fine[at] / (PEAKS.finer * N))
        x = height / float(expected[at])
        P = tail(x, n, r)
        p = -np.expm1(np.log1p(-min(P, 1 - 1e-12)) - W * np.sqrt(x) * P)
        out.append((f / Ts, 2.0 * float(np.sqrt(height / N)), x, float(p)))
        # Its side lobes would be the next peaks.
        wave = np.column_stack([np.cos(2 * np.pi * f * t), np.sin(2 * np.pi * f * t)])
        e = e - wave @ np.linalg.lstsq(wave, e, rcond=None)[0]
    return out


def _own_clock(e: Array) -> int:
    """Rows from one used sample to the next, as a rule: half that rate is the highest frequency.

    What lies beyond is the image of a lower one, as zeros stand between the samples.
    """
    used = np.flatnonzero(e)
    return int(np.median(np.diff(used))) if len(used) > 1 else 1


def _smooth_shape(e: Array) -> Array:
    """The spectrum of an autoregression of order four, on the fine grid: what a steep colour is.

    Too stiff to follow a line, it leaves the level to be nearly constant over the neighbours.
    """
    N = len(e)
    r = np.array([e[: N - k] @ e[k:] for k in range(PEAKS.order + 1)]) / N
    r[0] *= 1.0 + 1e-6
    a = np.concatenate([[1.0], -solve_toeplitz(r[:-1], r[1:])])
    return np.asarray(1.0 / np.abs(np.fft.rfft(a, PEAKS.finer * N)) ** 2)


def _levels(raw: Array, lines: Array, neighbours: tuple[int, int]) -> tuple[Array, int, int]:
    """Local level at each line, the number of neighbours n and the rank r of the median."""
    half = int(np.clip(int(PEAKS.share * len(lines)), *neighbours))
    n = 2 * half
    r = (n + 1) // 2
    a = float(np.sum(1.0 / (n - np.arange(r))))
    level = np.empty(len(lines))
    values = raw[lines]
    reach = half + PEAKS.guard
    # Where there are enough on both sides the neighbours lie alike: those of many lines at once.
    inside = np.arange(reach, len(lines) - reach)
    beside = np.concatenate([np.arange(half), np.arange(half + 2 * PEAKS.guard + 1, 2 * reach + 1)])
    for part in np.array_split(inside, len(inside) // PEAKS.rows + 1):
        near = values[part[:, None] - reach + beside]
        level[part] = np.partition(near, r - 1, axis=1)[:, r - 1] / a
    for j in [*range(min(reach, len(lines))), *range(max(len(lines) - reach, reach), len(lines))]:
        # At the ends the neighbours are those of the first line that has enough on both sides.
        first = int(np.clip(j - reach, 0, max(len(lines) - 2 * reach - 1, 0)))
        around = np.arange(first, min(first + 2 * reach + 1, len(lines)))
        near = around[np.argsort(np.abs(around - j), kind="stable")[2 * PEAKS.guard + 1 :]]
        near = near[:n]
        level[j] = np.partition(values[near], r - 1)[r - 1] / a
    return np.maximum(level, TINY), n, r


def _refined(e: Array, t: Array, f: float) -> tuple[float, float]:
    """Frequency (cycles a sample) and height of the periodogram's maximum near `f`."""

    def height(at: float) -> float:
        return -float(np.abs(np.exp(-2j * np.pi * at * t) @ e) ** 2 / len(e))

    step = 0.5 / (PEAKS.finer * len(e))
    best = minimize_scalar(
        height,
        bounds=(f - 2 * step, f + 2 * step),
        method="bounded",
        options={"xatol": 1e-3 * step},
    )
    return (float(best.x), -float(best.fun)) if -best.fun >= -height(f) else (f, -height(f))


@dataclass(frozen=True, slots=True, eq=False)
class PeriodicCandidate:
    """A periodic disturbance in one place, with the amplitudes that its score gives."""

    effect: Effect
    starts: dict[str, float]  # by the effect's own parameter names
    peak: Peak
    statistic: float  # Lagrange multiplier, chi^2(2) at a frequency given beforehand

    @property
    def p_value(self) -> float:
        """Over all frequencies searched."""
        return self.peak.p_value


def peaks_of(fit: Fit, *, alpha: float = 0.05) -> list[Peak]:
    """The significant peaks of a whitened simulation error, as `find_peaks` has them."""
    of = fit.criterion
    residuals = [of.columns(fit.x, k)[0] for k in range(len(of.data))]
    return find_peaks(residuals, [d.Ts for d in of.data], alpha=alpha, most=PEAKS.most_forces)


def periodic_candidates(
    fit: Fit, peaks: Sequence[Peak], window: tuple[float, float]
) -> list[PeriodicCandidate]:
    """Each peak as a force in each place, the largest statistic first.

    Parameters
    ----------
    fit : whitened simulation error of the model without the disturbance, near its minimum.
    peaks : of that error.
    window : first and last instant fitted [s of the record's clock].

    The amplitudes are one Gauss-Newton step from zero, the baseline's own unknowns free to move.
    """
    base = fit.criterion
    places = [p for p in places_of(base.model) if p.has_own_force] if peaks else []
    out = []
    for peak in peaks:
        for place in places:
            effect = periodic_disturbance(base.model, place, peak.frequency, window)
            model, names = effect.extended(base.model)
            wide = widened(fit, model.with_known(**{names[2]: peak.frequency}))
            e, psi, tangent = _split_columns(wide, names[:2])
            q, _ = np.linalg.qr(tangent / np.maximum(np.linalg.norm(tangent, axis=0), TINY))
            rest = psi - q @ (q.T @ psi)
            step, *_ = np.linalg.lstsq(rest, e - q @ (q.T @ e), rcond=1e-10)
            starts = {p.name: float(s) for p, s in zip(effect.parameters[:2], step, strict=True)}
            statistic = float(np.sum((rest @ step) ** 2))
            out.append(PeriodicCandidate(effect, starts, peak, statistic))
    return sorted(out, key=lambda c: -c.statistic)


def _split_columns(wide: SimulationError, own: Sequence[str]) -> tuple[Array, Array, Array]:
    """Residual (M,), the columns of `own` (M, 2) and all others', records stacked."""
    mine = [wide.names.index(name) for name in own]
    others = [i for i in range(len(wide.names)) if i not in mine]
    parts = [wide.columns(wide.start, k) for k in range(len(wide.data))]
    e = np.concatenate([r.ravel() for r, _ in parts])
    columns = np.concatenate([j.reshape(-1, j.shape[2]) for _, j in parts])
    return e, columns[:, mine], columns[:, others]
