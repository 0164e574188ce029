"""Preparation of records: every step acts on all channels alike.

One and the same linear filter on all signals of a regression preserves the regression; a filter on
the outputs alone, or on the inputs alone, changes the plant that is estimated.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from casid.arrays import TINY
from casid.data.record import BoolArray, FloatArray, Record
from casid.errors import DataError

Edges = Literal["trim", "reflect"]


@dataclass(frozen=True, slots=True, eq=False)
class FirFilter:
    """A symmetric FIR filter, applied centred: zero phase at every frequency.

    Attributes
    ----------
    taps : (2 M + 1,) array, symmetric, summing to 1
    Ts : float
        Sample time for which it was designed [s].
    design : str
        How it was designed, for the provenance.
    """

    taps: FloatArray
    Ts: float
    design: str = "FIR"

    def __post_init__(self) -> None:
        taps = np.array(self.taps, dtype=np.float64)
        scale = float(np.abs(taps).max(initial=0.0))
        if taps.ndim != 1 or taps.size % 2 == 0 or np.abs(taps - taps[::-1]).max() > 1e-9 * scale:
            raise DataError(
                f"taps of shape {taps.shape} are not an odd number of symmetric taps, so the "
                "filter would shift the record. Choose an even order with symmetric taps."
            )
        taps = (taps + taps[::-1]) / 2
        taps.flags.writeable = False
        object.__setattr__(self, "taps", taps)

    @property
    def half(self) -> int:
        """M, the taps on either side of the centre."""
        return int(self.taps.size // 2)

    def gain(self, frequencies_hz: ArrayLike) -> FloatArray:
        """Return the real gain h_0 + 2 sum h_k cos(2 pi f k Ts) at the given frequencies.

        Parameters
        ----------
        frequencies_hz : array of any shape [Hz]

        Returns
        -------
        array of the same shape; negative where the filter turns the sign
        """
        f = np.asarray(frequencies_hz, dtype=np.float64)
        k = np.arange(1, self.half + 1)
        cosines = np.cos(2 * np.pi * self.Ts * f[..., np.newaxis] * k)
        return np.asarray(self.taps[self.half] + 2 * cosines @ self.taps[self.half + 1 :])

    def describe(self, frequencies_hz: Iterable[float] = ()) -> str:
        """Return the design and the gain at DC, at given frequencies, and where it halves."""
        lines = [f"{self.design}; {self.taps.size} taps, Ts = {self.Ts:g} s, zero phase"]
        grid = np.linspace(0.0, 0.5 / self.Ts, 4001)
        below = np.flatnonzero(self.gain(grid) < 0.5)
        lines.append(f"  gain at DC      {float(self.gain(0.0)):.9f}")
        for f in frequencies_hz:
            lines.append(f"  gain at {f:g} Hz".ljust(17) + f" {float(self.gain(f)):.4f}")
        if below.size:
            lines.append(f"  gain 0.5 at     {grid[below[0]]:.4g} Hz")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<FirFilter {self.design}: {self.taps.size} taps, Ts = {self.Ts:g} s>"

    def apply(self, record: Record, *, edges: Edges = "trim") -> Record:
        """Return the record with every channel filtered alike.

        Parameters
        ----------
        record : Record
            With the sample time of the design.
        edges : "trim" or "reflect"
            Drop the M samples at either end that the filter cannot reach (t0 moves by M Ts), or
            keep them by odd reflection of the samples, which guesses what was not measured.

        Returns
        -------
        Record
            Missing samples are bridged by straight lines before filtering; the marks grow by M
            samples on either side.

        Raises
        ------
        DataError
            If the sample times differ or the record is too short.
        """
        if abs(self.Ts / record.Ts - 1) > 1e-3:
            raise DataError(
                f"{record.name}: the filter is designed for Ts = {self.Ts:g} s, the record has "
                f"Ts = {record.Ts:g} s. Design it for the record: "
                f"casid.data.preparation.equiripple(cutoff_hz, Ts={record.Ts:g})."
            )
        if edges not in ("trim", "reflect"):
            raise DataError(f"edges = {edges!r}. Choose 'trim' or 'reflect'.")
        M = self.half
        if record.N < 2 * M + 2:
            raise DataError(
                f"{record.name}: {record.N} samples are too few for a filter of {2 * M + 1} taps. "
                f"Give a record of at least {2 * M + 2} samples, or lower the order."
            )
        channels: dict[str, FloatArray] = {}
        for name in record.names:
            values = record.filled(name)
            if edges == "reflect":
                values = np.pad(values, M, mode="reflect", reflect_type="odd")
            channels[name] = _convolve(values, self.taps)
        cut = slice(M, record.N - M) if edges == "trim" else slice(None)
        step = f"{self.design}, {2 * M + 1} taps, zero phase, on all channels; " + (
            f"{M} samples trimmed at either end" if edges == "trim" else "ends reflected"
        )
        return Record(
            channels,
            record.units,
            record.Ts,
            record.t0 + (M * record.Ts if edges == "trim" else 0.0),
            record.name,
            {name: _dilated(mask, M)[cut] for name, mask in record.missing.items()},
            (*record.provenance, step),
        )


def _convolve(values: FloatArray, taps: FloatArray) -> FloatArray:
    if taps.size <= 256:
        return np.asarray(np.convolve(values, taps, mode="valid"), dtype=np.float64)
    from scipy.signal import oaconvolve

    return np.asarray(oaconvolve(values, taps, mode="valid"), dtype=np.float64)


def _dilated(mask: BoolArray, M: int) -> BoolArray:
    """Grow the marks by M samples on either side."""
    edges = np.concatenate(([0], np.cumsum(mask)))
    k = np.arange(mask.size)
    high, low = np.minimum(k + M + 1, mask.size), np.maximum(k - M, 0)
    return np.asarray(edges[high] > edges[low])


def equiripple(
    cutoff_hz: float, Ts: float, *, stop_hz: float | None = None, order: int = 20
) -> FirFilter:
    """Design an equiripple (Parks-McClellan) low-pass with gain exactly 1 at DC.

    Parameters
    ----------
    cutoff_hz : float
        End of the pass band [Hz].
    Ts : float
        Sample time [s].
    stop_hz : float, optional
        Start of the stop band [Hz]. Where not given, as near as the order allows with ripples of
        1 %: cutoff + 27/(14.6 order Ts), Kaiser's estimate of the order turned round. It is a
        heuristic. A low order makes the filter soft: 21 taps at 100 Hz with a cut-off at 0.5 Hz
        have their stop band from 9.7 Hz on.
    order : int
        Even; the number of taps less one.

    Raises
    ------
    DataError
        If the frequencies are not 0 < cutoff < stop < 1/(2 Ts), the order is odd, or the design
        does not converge.

    Notes
    -----
    The design's own gain at DC differs from 1 by its ripple; the taps are divided by their sum.
    Parks & McClellan (1972), IEEE Trans. Circuit Theory 19, 189-194; Kaiser (1974) for the order.
    """
    from scipy.signal import remez

    nyquist = 0.5 / Ts
    if order < 2 or order % 2:
        raise DataError(
            f"filter order {order}. Choose an even order of at least 2: an odd number of taps "
            "has a centre, and only then is the phase zero."
        )
    if stop_hz is None:
        stop_hz = cutoff_hz + 27.0 / (14.6 * order * Ts)
        if stop_hz >= 0.98 * nyquist:
            stop_hz = 0.5 * (cutoff_hz + nyquist)
    if not 0 < cutoff_hz < stop_hz < nyquist:
        raise DataError(
            f"cut-off {cutoff_hz:g} Hz and stop band from {stop_hz:g} Hz do not fit a sample time "
            f"of {Ts:g} s. Choose 0 < cutoff_hz < stop_hz < {nyquist:g} Hz, half the sample rate."
        )
    try:
        taps = remez(order + 1, [0.0, cutoff_hz, stop_hz, nyquist], [1.0, 0.0], fs=1 / Ts)
    except ValueError:
        taps = np.full(order + 1, np.nan)
    if not np.isfinite(taps).all() or abs(taps.sum() - 1) > 0.5:
        raise DataError(
            f"no equiripple filter of order {order} with cut-off {cutoff_hz:g} Hz and stop band "
            f"from {stop_hz:g} Hz was found. Widen the transition with stop_hz or change the order."
        )
    raw = float(taps.sum())
    return FirFilter(
        np.asarray(taps / raw),
        Ts,
        f"equiripple low-pass {cutoff_hz:g} Hz, stop band from {stop_hz:.4g} Hz "
        f"(gain at DC set from {raw:.6g} to 1)",
    )


def lowpass(
    record: Record,
    cutoff_hz: float = 0.5,
    *,
    stop_hz: float | None = None,
    order: int = 20,
    edges: Edges = "trim",
) -> Record:
    """Low-pass every channel alike with a zero-phase equiripple FIR filter.

    Parameters and errors as `equiripple` and `FirFilter.apply`. The filter is not causal: it
    belongs before an estimation, on outputs, inputs and instruments alike, not into a loop.

    Returns
    -------
    Record
        Shorter by `order` samples; its t0 moved by order/2 samples (edges "trim").
    """
    return equiripple(cutoff_hz, record.Ts, stop_hz=stop_hz, order=order).apply(record, edges=edges)


def anti_alias(factor: int, Ts: float) -> FirFilter:
    """Design the filter that precedes keeping every `factor`-th sample.

    A Kaiser-windowed FIR: gain 1 within 0.1 % up to 80 % of the new Nyquist frequency, below 0.1 %
    (-60 dB) above it. Kaiser (1974); order (60 - 7.95)/(14.36 df) with df the transition in
    cycles per sample.

    Raises
    ------
    DataError
        If the factor is not an integer of at least 2.
    """
    from scipy.signal import firwin

    if isinstance(factor, bool) or int(factor) != factor or factor < 2:
        raise DataError(f"decimation factor {factor!r}. Choose an integer of at least 2.")
    transition = 0.1 / factor
    order = 2 * int(np.ceil((60 - 7.95) / (14.36 * transition) / 2))
    taps = firwin(order + 1, 0.9 / factor, window=("kaiser", 0.1102 * (60 - 8.7)))
    return FirFilter(np.asarray(taps / taps.sum()), Ts, f"anti-alias low-pass for 1 in {factor}")


def decimate(record: Record, factor: int, *, edges: Edges = "trim") -> Record:
    """Keep every `factor`-th sample behind a zero-phase anti-alias filter, on all channels.

    Returns
    -------
    Record
        With Ts times `factor`; about 18 samples of the new rate are lost at either end (edges
        "trim"), none with "reflect". A factor of 1 returns the record as it is.

    Raises
    ------
    DataError
        If the factor is not a positive integer, or the record too short.
    """
    if factor == 1:
        return record
    smooth = anti_alias(factor, record.Ts).apply(record, edges=edges)
    return Record(
        {n: v[::factor] for n, v in smooth.channels.items()},
        smooth.units,
        smooth.Ts * factor,
        smooth.t0,
        smooth.name,
        {n: m[::factor] for n, m in smooth.missing.items()},
        (*smooth.provenance, f"decimated: 1 in {factor} kept, Ts = {smooth.Ts * factor:g} s"),
    )


def detrend(record: Record, order: int = 0) -> Record:
    """Subtract the mean (order 0) or the least-squares straight line (order 1) of every channel.

    Missing samples take no part in the fit.

    Raises
    ------
    DataError
        If the order is neither 0 nor 1, or a channel has too few samples that are not missing.
    """
    if order not in (0, 1):
        raise DataError(f"detrend order {order!r}. Choose 0 (mean) or 1 (straight line).")
    x = np.linspace(-1.0, 1.0, record.N)
    channels: dict[str, FloatArray] = {}
    taken = []
    for name, values in record.channels.items():
        kept = ~record.is_missing(name)
        if kept.sum() <= order:
            raise DataError(
                f"{record.name}: {name} has {int(kept.sum())} samples that are not missing. "
                f"Leave it out with record.without({name!r})."
            )
        basis = np.vander(x, order + 1, increasing=True)
        c = np.linalg.lstsq(basis[kept], values[kept], rcond=None)[0]
        channels[name] = values - basis @ c
        slope = (
            f" and {2 * c[1] / max(record.duration - record.Ts, record.Ts):.6g}/s" if order else ""
        )
        taken.append(f"{name} {c[0]:.6g}{slope}")
    step = (
        f"{'straight line' if order else 'mean'} subtracted from all channels: {', '.join(taken)}"
    )
    return Record(
        channels,
        record.units,
        record.Ts,
        record.t0,
        record.name,
        record.missing,
        (*record.provenance, step),
    )


# ---------------------------------------------------------------------- two loggers


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
        return Record(
            channels,
            units,
            reference.Ts,
            float(reference.t[rows[0]]),
            f"{reference.name}+{other.name}",
            missing,
            (*reference.provenance, *history, step),
        )


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
    c1, n = float(c[best]), int(overlap[best])
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
    # shape but not its size, and is told apart by that.
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
