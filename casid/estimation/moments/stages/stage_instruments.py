"""Instruments of a stage, simulated again only where references or parameters have changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from casid.arrays import Array
from casid.estimation.moments.equations.parts import Part
from casid.estimation.moments.instruments.instruments import (
    Instruments,
    Loop,
    Simulated,
    UnstableLoop,
    from_channels,
    from_reference,
    reference_signals,
)
from casid.model.model import Model


class StageInstruments:
    """The references of a stage's records, and the loop simulated from them.

    Parameters
    ----------
    loops : by sample time; those missing are added.
    """

    def __init__(
        self,
        model: Model,
        parts: Sequence[Part],
        instruments: Instruments,
        loops: dict[float, Loop],
        method: str,
    ) -> None:
        self.instruments, self._loops = instruments, loops
        for p in parts:
            if p.Ts not in loops:
                loops[p.Ts] = Loop(model, p.Ts, method)
        # Of each record, with the reference they come from: the drives, the first instruments.
        self._driven: dict[str, tuple[tuple[Array, ...], dict[str, Array]]] = {}
        self._first: dict[str, tuple[Any, Simulated]] = {}

    @property
    def starts_from_model(self) -> bool:
        """Whether the loop is simulated with the start values before the first estimate."""
        return self.instruments.initial == "model"

    def first(self, parts: Sequence[Part]) -> list[Simulated | None]:
        """Instruments before anything is known of the model: lags of references or of channels."""
        if self.instruments.initial == "channels":
            lags = self.instruments.first
            return [from_channels(p.channels, lags, p.record) for p in parts]
        raw = [
            {k: p.channels[k] for k in dict.fromkeys(c for c, _ in self._drives(p).values())}
            for p in parts
        ]
        return [from_reference(r, self.instruments.n_delta0) for r in raw]

    def references(self, part: Part) -> dict[str, Array]:
        """The filtered references of a part, made again only for another reference."""
        direct = self._loops[part.Ts].direct
        channels = [c for c, _ in self.instruments.drives(direct).values()]
        raw = tuple(part.channels[c] for c in channels if c in part.channels)
        old, drives = self._driven.get(part.record, ((), {}))
        if drives and len(old) == len(raw) and all(a is b for a, b in zip(old, raw, strict=True)):
            return drives
        drives = reference_signals(self.instruments, direct, part.channels, part.Ts, part.record)
        if all(_is_constant(a) for a in raw):
            self._driven[part.record] = raw, drives
        return drives

    def simulate(
        self,
        parts: Sequence[Part],
        references: Sequence[Mapping[str, Array]],
        values: Sequence[Mapping[str, float]],
        old: Sequence[Simulated | None],
        remarks: list[str],
        j: int,
    ) -> list[Simulated | None]:
        """Instruments simulated with `values`; those of before where a loop is unstable.

        Parameters
        ----------
        values : every parameter of each part.
        j : the iteration, -1 for the start values; as remarks name it.
        """
        out: list[Simulated | None] = []
        done: dict[str, Simulated] = {}
        for p, drives, v, before in zip(parts, references, values, old, strict=True):
            try:
                if p.record not in done:
                    outputs = [q.equation.output for q in parts if q.record == p.record]
                    kept, first = self._first.get(p.record, (None, None))
                    key = (drives, tuple(outputs), dict(v))
                    is_kept = self._driven.get(p.record, ((), None))[1] is drives and j < 0
                    if is_kept and kept is not None and first is not None:
                        if kept[0] is drives and kept[1:] == key[1:]:
                            done[p.record] = first
                            out.append(first)
                            continue
                    done[p.record] = self._loops[p.Ts].instruments(
                        drives, v, self.instruments, outputs
                    )
                    if is_kept:
                        self._first[p.record] = key, done[p.record]
                out.append(done[p.record])
            except UnstableLoop as unstable:
                what = "start values" if j < 0 else f"estimate of iteration {j + 1}"
                remarks.append(
                    f"{p.record}: the loop simulated with the {what} is unstable ({unstable}); "
                    + (
                        "lags of the reference are used"
                        if j < 0
                        else "the instruments of before are kept"
                    )
                )
                out.append(before)
        return out

    def _drives(self, part: Part) -> dict[str, tuple[str, Any]]:
        return self.instruments.drives(self._loops[part.Ts].direct)


def _is_constant(array: Array) -> bool:
    """True for samples that nobody can write over."""
    return array.flags.owndata and not array.flags.writeable
