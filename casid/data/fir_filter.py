"""Symmetric FIR filters for records: low-pass and anti-alias, zero phase."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from casid.arrays import BoolArray, FloatArray
from casid.data.record import Record
from casid.errors import DataError
from casid.model.quantities import count_text
from casid.presentation import Presented, present

Edges = Literal["trim", "reflect"]


@dataclass(frozen=True, slots=True, eq=False)
class FirFilter(Presented):
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
        return str(present(self, "text", tuple(frequencies_hz)))

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
                f"casid.data.fir_filter.equiripple(cutoff_hz, Ts={record.Ts:g})."
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
            channels[name] = convolved(values, self.taps)
        cut = slice(M, record.N - M) if edges == "trim" else slice(None)
        step = f"{self.design}, {2 * M + 1} taps, zero phase, on all channels; " + (
            f"{count_text(M, 'sample')} trimmed at either end"
            if edges == "trim"
            else "ends reflected"
        )
        return replace(
            record,
            channels=channels,
            t0=record.t0 + (M * record.Ts if edges == "trim" else 0.0),
            missing={name: _dilated(mask, M)[cut] for name, mask in record.missing.items()},
            late={},  # each value is of many samples now
            provenance=(*record.provenance, step),
        )


def convolved(values: FloatArray, taps: FloatArray) -> FloatArray:
    """(N - 2 M,) values filtered by the (2 M + 1,) taps, where all taps have a sample."""
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
    taps = _equiripple_taps(cutoff_hz, stop_hz, Ts, order)
    raw = float(taps.sum())
    return FirFilter(
        np.asarray(taps / raw),
        Ts,
        f"equiripple low-pass {cutoff_hz:g} Hz, stop band from {stop_hz:.4g} Hz "
        f"(gain at DC set from {raw:.6g} to 1)",
    )


def _equiripple_taps(cutoff_hz: float, stop_hz: float, Ts: float, order: int) -> FloatArray:
    """Taps (order + 1,) of the design, refused where it does not converge."""
    from scipy.signal import remez

    try:
        taps = remez(order + 1, [0.0, cutoff_hz, stop_hz, 0.5 / Ts], [1.0, 0.0], fs=1 / Ts)
    except ValueError:
        taps = np.full(order + 1, np.nan)
    if not np.isfinite(taps).all() or abs(taps.sum() - 1) > 0.5:
        raise DataError(
            f"no equiripple filter of order {order} with cut-off {cutoff_hz:g} Hz and stop band "
            f"from {stop_hz:g} Hz was found. Widen the transition with stop_hz or change the order."
        )
    return np.asarray(taps)


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
