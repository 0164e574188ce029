"""The offset between the clocks of two loggers, from a signal that both recorded."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from casid.argument_types import names_wrong_types
from casid.arrays import TINY, FloatArray
from casid.data.fir_filter import anti_alias
from casid.data.record import Record
from casid.errors import DataError


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The offset between the clocks of two loggers.

    Attributes
    ----------
    offset : float
        Seconds to add to the other logger's clock: t = t_other + offset.
    std_error : float
        Standard error of the offset [s]. It assumes noise independent between the loggers, of
        any colour, and clocks that run at the same rate.
    peak_correlation, second_correlation : float
        Agreement 2 g sum(a b)/sum(a^2 + g^2 b^2) at the offset, and at the best offset elsewhere.
    overlap : float
        Length of the common stretch [s].
    reference, other, using, other_using : str
        Names of the records and of the channels compared.
    """

    offset: float
    std_error: float
    peak_correlation: float
    second_correlation: float
    overlap: float
    reference: str
    other: str
    using: str
    other_using: str

    def __repr__(self) -> str:
        return (
            f"<Alignment {self.other} on {self.reference}: offset {self.offset:.6g} s, "
            f"std. error {self.std_error:.2g} s, peak {self.peak_correlation:.3f}>"
        )

    def __str__(self) -> str:
        return "\n".join(
            [
                f"Alignment of {self.other} ({self.other_using}) on {self.reference} "
                f"({self.using})",
                f"  offset        {self.offset:.6g} s to add to the clock of {self.other}",
                f"  std. error    {self.std_error:.2g} s, noise independent between the loggers",
                f"  correlation   {self.peak_correlation:.4f}; next peak "
                f"{self.second_correlation:.4f}",
                f"  common        {self.overlap:.6g} s",
            ]
        )

    def apply(self, reference: Record, other: Record, *, suffix: str = "_other") -> Record:
        """Return one record on the reference's clock with the channels of both.

        The other's channels are interpolated (cubic spline) at the reference's samples, behind
        an anti-alias filter where the other logger is faster; only the common stretch is kept.
        Channels of the other whose name is taken get `suffix`.

        Raises
        ------
        DataError
            If the records share no stretch, or a name is taken even with the suffix.
        """
        from scipy.interpolate import CubicSpline

        factor = round(reference.Ts / other.Ts)
        smooth = anti_alias(factor, other.Ts).apply(other, edges="reflect") if factor > 1 else other
        t_other = reference.t - self.offset
        low, high = smooth.t[0] - 1e-9, smooth.t[-1] + 1e-9
        rows = np.flatnonzero((t_other >= low) & (t_other <= high))
        if rows.size < 2:
            raise DataError(
                f"{reference.name} and {other.name} share no stretch at an offset of "
                f"{self.offset:g} s. Check that the offset was found from these two records."
            )
        at = np.clip(t_other[rows], smooth.t[0], smooth.t[-1])
        channels = {n: v[rows] for n, v in reference.channels.items()}
        units = dict(reference.units)
        missing = {n: m[rows] for n, m in reference.missing.items()}
        for name in smooth.names:
            new = name if name not in reference else name + suffix
            if new in channels:
                raise DataError(
                    f"channel {new} of {other.name} has the name of another. "
                    f"Rename it first: other.rename({{{name!r}: 'new name'}})."
                )
            channels[new] = CubicSpline(smooth.t, smooth.filled(name))(at)
            units[new] = smooth.units[name]
            position = (at - smooth.t0) / smooth.Ts
            before = np.clip(np.floor(position).astype(int), 0, smooth.N - 1)
            mask = smooth.is_missing(name)
            missing[new] = mask[before] | mask[np.minimum(before + 1, smooth.N - 1)]
        step = (
            f"{other.name} merged at an offset of {self.offset:.9g} s (std. error "
            f"{self.std_error:.2g} s, from {self.using} and {self.other_using}), by cubic spline"
        )
        history = tuple(f"{other.name}: {line}" for line in smooth.provenance)
        return replace(
            reference,
            channels=channels,
            units=units,
            t0=float(reference.t[rows[0]]),
            name=f"{reference.name}+{other.name}",
            missing=missing,
            late={n: s[rows] for n, s in reference.late.items()},
            provenance=(*reference.provenance, *history, step),
        )


@names_wrong_types()
def align(
    record: Record,
    other: Record,
    *,
    using: str,
    other_using: str | None = None,
    max_offset: float | None = None,
) -> Alignment:
    """Find the offset between two loggers' clocks from a signal or event that both recorded.

    The integer lag maximises the agreement over the common stretch. The fraction of a sample
    maximises the cross-correlation of both signals, each weighted at every frequency by their
    coherence (Knapp & Carter 1976, IEEE Trans. ASSP 24, 320-327); it is exact for signals below
    the Nyquist frequency.

    Parameters
    ----------
    record, other : Record
        Sample times may differ; the coarser signal is interpolated to the finer clock.
    using, other_using : str
        Channel of `record` and of `other`; the same name where only one is given. The scale may
        differ, the sign not.
    max_offset : float, optional
        Largest offset considered [s]; without it, all that leave a fifth of the shorter record in
        common.

    Returns
    -------
    Alignment

    Raises
    ------
    DataError
        If a channel is constant, or the peak is not unique: another offset agrees nearly as well
        (a pure sine agrees at every period).

    Notes
    -----
    Standard error: the estimate is the zero of sum(a b' - b a'), in which the common signal
    cancels and only noise is left; its variance comes from the sums over blocks of the record,
    divided by (2 sum a' b')^2. Noise may have any colour, but must be independent between the
    loggers and forget within a block; a single short event gives a rough figure. A difference in
    clock rate is not estimated. The bar for the second peak (three standard deviations of the
    difference under white noise, and at least 0.05) is a heuristic.

    Example
    -------
    >>> import casid
    >>> import numpy as np
    >>> t, rng = 0.05 * np.arange(1200), np.random.default_rng(1)
    >>> def knocked(at, name):
    ...     a = np.exp(-(((t - at) / 0.3) ** 2)) + 0.01 * rng.standard_normal(t.size)
    ...     return casid.Record({"a": a}, {"a": "m/s^2"}, Ts=0.05, name=name)
    >>> casid.align(knocked(20.0, "imu"), knocked(17.3, "gps"), using="a")
    <Alignment gps on imu: offset 2.7...>
    """
    second_name = using if other_using is None else other_using
    a, b, Ts = _common_clock(record, other, using, second_name)
    shift = record.t0 - other.t0
    lags, c, overlap = _agreement(a, b)
    allowed = overlap >= max(16, 0.2 * min(a.size, b.size))
    if max_offset is not None:
        allowed &= np.abs(lags * Ts + shift) <= max_offset
    label = f"{using} of {record.name} and {second_name} of {other.name}"
    if not allowed.any():
        raise DataError(
            f"{label}: no offset up to {max_offset} s leaves enough in common. Raise max_offset; "
            f"the clocks start at {record.t0:g} and {other.t0:g} s."
        )
    c = np.where(allowed, c, -np.inf)
    best = int(np.argmax(c))
    c1, n = min(float(c[best]), 1.0), int(overlap[best])  # rounding puts it beyond
    c2, lag2 = _second_peak(c, lags, best)
    noise = np.sqrt((4 * (1 - c1) * max(c1 - c2, 0.0) + 2 * (1 - c1) ** 2) / n)
    if c1 - c2 <= max(3 * noise, 0.05) or c1 < 0.1:
        worst = -float(np.min(np.where(allowed, c, np.inf)))
        flip = " The strongest agreement is negative: flip one sign." if worst > c1 + 0.05 else ""
        raise DataError(
            f"{label}: the offset is not unique: agreement {c1:.3f} at "
            f"{lags[best] * Ts + shift:.6g} s and {c2:.3f} at {lag2 * Ts + shift:.6g} s.{flip} "
            "Choose a stretch with one event or a signal that does not repeat (a knock), or bound "
            "it with max_offset."
        )

    lag = int(lags[best])
    k0, k1 = max(0, lag), min(a.size, b.size + lag)
    fraction, error = _fraction_of_a_sample(a[k0:k1], b[k0 - lag : k1 - lag])
    return Alignment(
        offset=(lag + fraction) * Ts + shift,
        std_error=error * Ts,
        peak_correlation=c1,
        second_correlation=c2,
        overlap=n * Ts,
        reference=record.name,
        other=other.name,
        using=using,
        other_using=second_name,
    )


def _common_clock(
    record: Record, other: Record, using: str, other_using: str
) -> tuple[FloatArray, FloatArray, float]:
    """Return both signals, mean removed, at the finer of the two sample times."""
    from scipy.interpolate import CubicSpline

    Ts = min(record.Ts, other.Ts)
    signals = []
    for source, channel in ((record, using), (other, other_using)):
        values = source.filled(channel)
        if np.ptp(values) == 0:
            raise DataError(
                f"{source.name}: {channel} is constant, so it holds no event to align by. "
                "Choose a channel that both loggers recorded."
            )
        if abs(source.Ts / Ts - 1) > 1e-9:
            t = source.Ts * np.arange(source.N)
            grid = Ts * np.arange(int(t[-1] / Ts * (1 + 1e-12)) + 1)
            values = np.asarray(CubicSpline(t, values)(np.minimum(grid, t[-1])))
        signals.append(values - values.mean())
    return signals[0], signals[1], Ts


def _agreement(a: FloatArray, b: FloatArray) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Return lags l, agreement of a[k] with g b[k - l] over the overlap, and the overlap."""
    from scipy.signal import correlate

    lags = np.arange(-(b.size - 1), a.size)
    products = correlate(a, b, mode="full", method="fft")
    k0, k1 = np.maximum(lags, 0), np.minimum(a.size, b.size + lags)
    energy_a = np.concatenate(([0.0], np.cumsum(a**2)))
    energy_b = np.concatenate(([0.0], np.cumsum(b**2)))
    in_a = energy_a[k1] - energy_a[k0]
    in_b = energy_b[k1 - lags] - energy_b[k0 - lags]
    overlap = (k1 - k0).astype(np.float64)
    # One gain for all lags, from the root mean squares: a decay shifted by a period keeps its
    # shape but not its size, which separates it.
    g = np.sqrt(np.mean(a**2) / np.mean(b**2))
    total = in_a + g**2 * in_b
    # A tenth of all the energy at least: two quiet stretches agree on nothing.
    floor = 0.1 * (energy_a[-1] + g**2 * energy_b[-1])
    return lags, np.asarray(2 * g * products / np.maximum(total, floor)), overlap


def _second_peak(c: FloatArray, lags: NDArray[np.intp], best: int) -> tuple[float, int]:
    """Return height and lag of the best agreement off the main lobe.

    The main lobe ends where the agreement falls below half its peak; ripples of noise on it are
    no second peaks.
    """
    low = np.flatnonzero(c < 0.5 * c[best])
    before, after = low[low < best], low[low > best]
    left = int(before[-1]) + 1 if before.size else 0
    right = int(after[0]) - 1 if after.size else c.size - 1
    outside = c.copy()
    outside[left : right + 1] = -np.inf
    second = int(np.argmax(outside))
    value = float(outside[second])
    return (value, int(lags[second])) if np.isfinite(value) else (-1.0, int(lags[best]))


def _fraction_of_a_sample(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    """Return tau and its standard error, in samples: a(k) resembles g b(k - tau), tau small."""
    n = a.size
    taper = np.minimum(1.0, np.minimum(np.arange(n) + 0.5, n - 0.5 - np.arange(n)) / (0.05 * n))
    A, B = np.fft.rfft((a - a.mean()) * taper), np.fft.rfft((b - b.mean()) * taper)
    omega = 2 * np.pi * np.fft.rfftfreq(n)
    width = max(9, int(0.5 * np.sqrt(n)) | 1)
    cross = _smoothed(A * B.conj(), width)
    coherence = np.abs(cross) ** 2 / np.maximum(
        _smoothed(np.abs(A) ** 2, width).real * _smoothed(np.abs(B) ** 2, width).real, TINY
    )
    weight = np.where(coherence > 1 - 0.05 ** (1 / (width - 1)), coherence, 0.0)
    weight[0] = 0.0
    if n % 2 == 0:
        weight[-1] = 0.0  # the Nyquist line has no derivative
    if not weight.any():
        weight[1:-1] = 1.0
    A, B = A * weight, B * weight
    product = A * B.conj()

    # Climb from the integer peak; beyond the next turning point lies another lobe.
    grid = np.arange(-200, 201) / 10
    heights = np.array([float(np.sum((product * np.exp(1j * omega * u)).real)) for u in grid])
    top = grid.size // 2
    while 0 < top < grid.size - 1:
        higher = top + int(np.argmax(heights[top - 1 : top + 2])) - 1
        if higher == top:
            break
        top = higher
    tau = float(grid[top])
    for _ in range(20):
        turned = product * np.exp(1j * omega * tau)
        slope = float(np.sum((1j * omega * turned).real))
        bend = float(np.sum((omega**2 * turned).real))
        if bend <= 0:
            break
        change = float(np.clip(slope / bend, -0.1, 0.1))
        tau += change
        if abs(change) < 1e-10:
            break

    shifted = B * np.exp(-1j * omega * tau)
    u, v = np.fft.irfft(A, n), np.fft.irfft(shifted, n)
    du, dv = np.fft.irfft(1j * omega * A, n), np.fft.irfft(1j * omega * shifted, n)
    score = u * dv - v * du
    lines = float(weight.sum()) ** 2 / float((weight**2).sum())
    blocks = int(np.clip(lines / 4, 8, 100))
    sums = np.add.reduceat(score, np.linspace(0, n, blocks, endpoint=False).astype(int))
    information = 2 * float(np.sum(du * dv))
    return tau, float(np.sqrt(np.sum(sums**2))) / abs(information)


def _smoothed(spectrum: NDArray[np.complex128] | FloatArray, width: int) -> NDArray[np.complex128]:
    """Average a spectrum over `width` neighbouring lines (Daniell)."""
    ones = np.ones(width)
    count = np.convolve(np.ones(spectrum.size), ones, mode="same")
    return np.asarray(np.convolve(spectrum, ones, mode="same") / count, dtype=np.complex128)
