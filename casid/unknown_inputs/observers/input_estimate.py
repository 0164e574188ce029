"""The estimate of an unknown input: values, standard deviations, and where they hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from casid.arrays import Array
from casid.data.record import Record
from casid.errors import DataError, nearest
from casid.model.quantities import count_text


@dataclass(frozen=True, slots=True, eq=False)
class InputEstimate:
    """Unknown inputs of a record, estimated.

    Attributes
    ----------
    inputs : names; units : name -> SI unit, as far as known.
    t : (N,) times [s]; values, std : (N, nu) estimates and standard deviations, infinite where
        nothing is known.
    x : (N, nx) the states that go with them.
    valid : (N,) bool, False near the ends of the record where transients have not died out.
    band : for each input (low, high) [rad/s], where its spectrum exceeds the noise's; None
        where that was not requested.
    levels : name -> standard deviation of what noise was assumed or found.
    assumed : what the standard deviations take for granted.
    """

    inputs: tuple[str, ...]
    units: Mapping[str, str]
    t: Array
    values: Array
    std: Array
    x: Array
    valid: Array
    method: str
    record: str
    band: tuple[tuple[float, float] | None, ...] = ()
    levels: Mapping[str, float] = field(default_factory=dict)
    assumed: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Array:
        """(N,) estimate of an input."""
        return np.asarray(self.values[:, self._index(name)])

    def std_error(self, name: str) -> Array:
        """(N,) pointwise standard deviation of an input's estimate."""
        return np.asarray(self.std[:, self._index(name)])

    def added_to(self, record: Record) -> Record:
        """The record with a channel for each input, marked missing where it is not valid.

        Raises
        ------
        DataError
            If the record has another number of samples, or a channel of that name.
        """
        if record.N != len(self.t):
            raise DataError(
                f"{record.name} has {record.N} samples, the estimate {len(self.t)}; give the "
                f"record it was made from, {self.record}"
            )
        for i, name in enumerate(self.inputs):
            if name in record:
                raise DataError(
                    f"{record.name} has a channel {name!r} already; take it out with "
                    f"record.without({name!r}), or rename it"
                )
            record = record.with_channel(name, self.values[:, i], self.units.get(name, "1"))
            if not self.valid.all():
                record = record.mark_missing(name, ~self.valid)
        return record

    def _index(self, name: str) -> int:
        if name not in self.inputs:
            raise DataError(f"no unknown input {name!r}{nearest(name, self.inputs)}")
        return self.inputs.index(name)

    def __repr__(self) -> str:
        return (
            f"<InputEstimate {', '.join(self.inputs)} of {self.record}: {self.method}, "
            f"N = {len(self.t)}, {int(self.valid.sum())} valid>"
        )

    def __str__(self) -> str:
        lines = [f"{', '.join(self.inputs)} of {self.record}, by {self.method}"]
        for i, name in enumerate(self.inputs):
            inside = self.std[self.valid, i]
            unit = self.units.get(name, "")
            if inside.size:
                spread = np.std(self.values[self.valid, i])
                lines.append(
                    f"  {name}: standard deviation {np.median(inside):.3g} {unit} (median), of a "
                    f"signal of {spread:.3g} {unit}"
                )
            if i < len(self.band) and self.band[i] is not None:
                low, high = self.band[i] or (0.0, 0.0)
                lines.append(f"    stands out of the noise from {low:.3g} to {high:.3g} rad/s")
        out = int((~self.valid).sum())
        if out:
            lines.append(f"  {count_text(out, 'sample')} near the ends not valid: transients there")
        lines += [f"  {n}: {v:.3g}" for n, v in self.levels.items()]
        return "\n".join(lines + [f"  assumes {a}" for a in self.assumed])


def noise_guess(y: Array) -> float:
    """White noise of a smooth signal from its second differences, NaN left out (a heuristic)."""
    kept = y[np.isfinite(y)]
    spread = float(np.std(kept)) if kept.size else 0.0
    rough = np.diff(y, 2)
    rough = rough[np.isfinite(rough)]
    level = float(np.std(rough)) / np.sqrt(6) if rough.size > 3 else 0.0
    return max(level, 1e-3 * spread) or 1e-6
