"""Channels that nobody recorded: computed from others of the record, with the noise they get.

A model may want a lateral acceleration where the file has a speed. A problem declares how the one
is made of the other, so that every command computes it alike, the record's history says so, and the
noise of the sources is carried through whatever the computation does, without a formula.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from casid.argument_types import methods_name_wrong_types
from casid.arrays import BoolArray, FloatArray
from casid.data.record import Record
from casid.errors import DataError, ModelError
from casid.model.quantities import count_text
from casid.pickling import PickledByFields


@methods_name_wrong_types()
@dataclass(frozen=True, slots=True, eq=False)
class Derived(PickledByFields):
    """How a channel is computed from others of the same record.

    Attributes
    ----------
    unit : SI unit of the channel.
    sources : channel -> SI unit, of what it is computed from; recorded channels, not derived ones.
    values : takes the record, returns (N,) samples in `unit`. Of sample k the result may depend on
        samples within `margin` seconds of it.
    how : the computation in words, with the bandwidth of every filter, for reports.
    margin : s at either end of the record where the result is not to be trusted; it is cut off.

    Raises
    ------
    ModelError
        If it has no sources, or a margin that is negative or not finite.
    """

    unit: str
    sources: Mapping[str, str]
    values: Callable[[Record], FloatArray]
    how: str = ""
    margin: float = field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
        if not self.sources:
            raise ModelError(
                "a derived channel needs sources, name -> unit: "
                "Derived('m/s^2', {'speed': 'm/s'}, f); one that the file has is no derived channel"
            )
        if not (np.isfinite(self.margin) and self.margin >= 0):
            raise ModelError(
                f"margin = {self.margin!r} s of a derived channel; give the seconds that its "
                "filters spoil at either end, 0 without a filter"
            )
        object.__setattr__(self, "sources", MappingProxyType(dict(self.sources)))

    def compute(self, name: str, record: Record) -> FloatArray:
        """(N,) samples of the channel; those that a source misses are joined by straight lines.

        Raises
        ------
        DataError
            If a source is absent or misses all samples, or the result is not (N,) and finite.
        """
        for source in self.sources:
            if source not in record:
                raise DataError(
                    f"{record.name}: {name} is derived from {', '.join(self.sources)}, and there "
                    f"is no {source}; the record has {', '.join(record.names)}. Map a column to "
                    f"it, --map {source}=column, or map one to {name} itself"
                )
        whole = {source: record.filled(source) for source in self.sources}
        missing = {n: mask for n, mask in record.missing.items() if n not in whole}
        filled = replace(record, channels={**record.channels, **whole}, missing=missing)
        values = np.asarray(self.values(filled), dtype=np.float64)
        if values.shape != (record.N,) or not np.isfinite(values).all():
            raise DataError(
                f"{record.name}: what derives {name} returned shape {values.shape} with "
                f"{count_text(int(np.sum(~np.isfinite(values))), 'sample')} not finite, where "
                f"({record.N},) are needed; correct the function of casid.data.derived.Derived"
            )
        return values

    def unfounded(self, record: Record) -> BoolArray:
        """(N,) True within `margin` of a sample that a source misses."""
        gone = np.any([record.is_missing(source) for source in self.sources], axis=0)
        reach = _edge(self, record)
        near = np.convolve(gone, np.ones(2 * reach + 1))[reach : reach + record.N] > 0.5
        return np.asarray(near)

    def __repr__(self) -> str:
        return f"<Derived [{self.unit}] from {', '.join(self.sources)}>"


def propagated_noise(
    name: str,
    entry: Derived,
    record: Record,
    noise: Mapping[str, float],
    *,
    draws: int = 8,
    seed: int = 0,
) -> float:
    """Standard deviation that white noise of the sources gives a derived channel, its unit.

    Parameters
    ----------
    noise : source -> standard deviation of its white noise, SI; a source not named has none.

    Notes
    -----
    Half the difference of the channel computed with the noise added and taken away, rms over the
    record and the draws: exact to second order in the noise. The result is white only where
    `values` looks at one sample at a time. The draws' own error is below 1/sqrt(draws N / n)
    relative, n the samples over which the computation reaches.
    """
    if not any(noise.get(s, 0.0) > 0 for s in entry.sources):
        return 0.0
    rng = np.random.default_rng(seed)
    edge = _edge(entry, record)
    total = 0.0
    for _ in range(draws):
        moved = {s: noise.get(s, 0.0) * rng.standard_normal(record.N) for s in entry.sources}
        up, down = (
            entry.compute(name, _moved(record, moved, sign))[edge : record.N - edge]
            for sign in (1.0, -1.0)
        )
        total += float(np.mean((up - down) ** 2)) / 4
    return float(np.sqrt(total / draws))


def derive(
    record: Record, derived: Mapping[str, Derived], noise: Mapping[str, float] | None = None
) -> Record:
    """The record with the derived channels that it does not have yet.

    Parameters
    ----------
    derived : name -> how to compute it.
    noise : source -> standard deviation of its white noise, SI; what it gives the derived channels
        is noted in the provenance.

    Returns
    -------
    Record
        Shorter by the largest margin at either end; the clock is kept. A derived channel is missing
        within its margin of a sample that a source misses.

    Raises
    ------
    DataError
        As `Derived.compute`, or if the margins leave fewer than two samples of a channel.
    """
    wanted = {n: d for n, d in derived.items() if n not in record}
    if not wanted:
        return record
    channels, units, missing = dict(record.channels), dict(record.units), dict(record.missing)
    steps = []
    for name, entry in wanted.items():
        channels[name] = entry.compute(name, record)
        units[name] = entry.unit
        sd = propagated_noise(name, entry, record, noise or {})
        steps.append(
            f"{name} [{entry.unit}] derived from {', '.join(entry.sources)}"
            + (f": {entry.how}" if entry.how else "")
            + (f"; noise {sd:.3g} {entry.unit} (standard deviation)" if sd > 0 else "")
        )
        gone = entry.unfounded(record)
        if gone.any():
            missing[name] = gone
            steps.append(
                f"{name}: {count_text(int(gone.sum()), 'sample')} missing, at gaps of "
                f"{' or '.join(entry.sources)} and within {entry.margin:g} s of them"
            )
        if record.N - int(gone.sum()) < 2:
            raise DataError(
                f"{record.name}: {name} is derived from {', '.join(entry.sources)}, which miss so "
                f"many samples that none of {name} is {entry.margin:g} s away from a gap; give a "
                "part of the record without gaps (--window), or a shorter filter"
            )
    edge = max(_edge(entry, record) for entry in wanted.values())
    if record.N - 2 * edge < 2:
        raise DataError(
            f"{record.name}: {record.N} samples, of which {edge} at either end are affected by the "
            f"filters of {', '.join(wanted)}; widen the window"
        )
    if edge:
        steps.append(
            f"{count_text(edge, 'sample')} cut at either end, where derived channels are guesses"
        )
    cut = slice(edge, record.N - edge)
    return replace(
        record,
        channels={n: v[cut] for n, v in channels.items()},
        units=units,
        t0=record.t0 + edge * record.Ts,
        missing={n: m[cut] for n, m in missing.items()},
        late={n: s[cut] for n, s in record.late.items()},
        provenance=(*record.provenance, *steps),
    )


def _edge(entry: Derived, record: Record) -> int:
    return int(np.ceil(entry.margin / record.Ts - 1e-9))


def _moved(record: Record, by: Mapping[str, FloatArray], sign: float) -> Record:
    channels = {n: v + sign * by[n] if n in by else v for n, v in record.channels.items()}
    return replace(record, channels=channels, late={})
