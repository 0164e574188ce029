"""Preparation of records: every step acts on all channels alike.

One and the same linear filter on all signals of a regression preserves the regression; a filter on
the outputs alone, or on the inputs alone, changes the plant that is estimated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import FloatArray
from casid.data.fir_filter import Edges, anti_alias, equiripple
from casid.data.record import Record
from casid.errors import DataError
from casid.model.quantities import count_text


@names_wrong_types()
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

    Parameters
    ----------
    record : sampled at Ts.
    cutoff_hz : end of the pass band [Hz].
    stop_hz : start of the stop band [Hz]; by default as near as the order allows.
    order : even; the number of taps less one.
    edges : "trim" leaves out what has no samples on both sides, "reflect" continues the record.

    Returns
    -------
    Record
        Shorter by `order` samples; its t0 moved by order/2 samples (edges "trim").
    """
    return equiripple(cutoff_hz, record.Ts, stop_hz=stop_hz, order=order).apply(record, edges=edges)


@names_wrong_types()
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

    Example
    -------
    >>> import casid
    >>> import numpy as np
    >>> record = casid.Record({"v": np.ones(400)}, {"v": "m/s"}, Ts=0.1, name="run")
    >>> casid.decimate(record, 2)
    <Record run: N = 163, 1 channel (v), Ts = 0.2 s, 32.6 s long>
    """
    if factor == 1:
        return record
    smooth = anti_alias(factor, record.Ts).apply(record, edges=edges)
    step = f"decimated: 1 in {factor} kept, Ts = {smooth.Ts * factor:g} s"
    return replace(
        smooth,
        channels={n: v[::factor] for n, v in smooth.channels.items()},
        Ts=smooth.Ts * factor,
        missing={n: m[::factor] for n, m in smooth.missing.items()},
        provenance=(*smooth.provenance, step),
    )


@names_wrong_types()
def detrend(record: Record, order: int = 0) -> Record:
    """Subtract the mean (order 0) or the least-squares straight line (order 1) of every channel.

    Missing samples take no part in the fit.

    Parameters
    ----------
    record : of which every channel is detrended.
    order : 0 or 1.

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
                f"{record.name}: {name} has {count_text(int(kept.sum()), 'sample')} left. "
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
    return replace(record, channels=channels, provenance=(*record.provenance, step))
