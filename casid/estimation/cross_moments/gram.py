"""The Gram matrix of lagged channels: the data of a criterion that is linear in its parameters."""

from __future__ import annotations

import functools
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.errors import DataError
from casid.estimation.cross_moments.lag_products import fast_two_sum, two_sum
from casid.linear.sampled.lagged_columns import Column
from casid.whole_files import replacing

CONSTANT = "1"  # the channel that is 1 at every sample, for offsets


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """The Gram matrix of all lags of all channels; immutable, additive, small.

    With v_t = every channel at lags 0 .. `lags` (channel major), then 1 where `constant` is set,

        total + rest = sum over t of v_t v_t'.

    Each stretch of data adds its samples t = lags .. N_stretch - 1. Stretches, records, files and
    machines are joined by ``+`` or `sum`. Every entry is within gamma_n sum ``|v_i v_j|`` of the
    exact sum, gamma_n = n u / (1 - n u), u = 2^-53, n = BLOCK + 2 lags + 3, however many samples
    and pieces there are: Higham (2002), Accuracy and Stability of Numerical Algorithms, eq. (3.5),
    for the products in a block; blocks and pieces are added with compensation, section 4.3.

    Attributes
    ----------
    channels : names, in the order of the matrix
    lags : the largest lag
    total : (m + 1, m + 1) array, m = len(channels) (lags + 1); products of the channels' units; the
        last entry is N, and the rest of its row the sums of v_t, or zero without `constant`
    rest : (m + 1, m + 1) array, what rounding left out of `total`
    constant : whether the sums of the channels themselves were taken
    """

    channels: tuple[str, ...]
    lags: int
    total: Array
    rest: Array
    constant: bool = False

    def __post_init__(self) -> None:
        channels = checked_channels(self.channels)
        lags = checked_lags(self.lags)
        m = len(channels) * (lags + 1)
        total, rest = (np.array(x, dtype=np.float64) for x in (self.total, self.rest))
        if total.shape != (m + 1, m + 1) or rest.shape != total.shape:
            raise DataError(
                f"moments of {len(channels)} channels with {lags} lags are {m + 1} x {m + 1}, not "
                f"{total.shape} and {rest.shape}. Compute them with "
                "casid.estimation.cross_moments.moments.moments."
            )
        if not np.isfinite(total).all():
            raise DataError(
                f"the moments of {', '.join(channels)} are not finite. Leave out samples that are "
                "not, and scale the signals to their physical range."
            )
        total.flags.writeable = rest.flags.writeable = False
        for name, value in (
            ("channels", channels),
            ("lags", lags),
            ("total", total),
            ("rest", rest),
            ("constant", bool(self.constant)),
        ):
            object.__setattr__(self, name, value)

    def __reduce__(self) -> tuple[Any, ...]:  # through the constructor: arrays stay read-only
        return Moments, (self.channels, self.lags, self.total, self.rest, self.constant)

    def __repr__(self) -> str:
        names = (*self.channels, *([CONSTANT] if self.constant else []))
        return f"<Moments of {', '.join(names)}: lags 0 to {self.lags}, N = {self.N}>"

    # ------------------------------------------------------------------ reading them

    @property
    def N(self) -> int:
        """Number of terms in the sums."""
        return round(float(self.total[-1, -1]))

    @property
    def gram(self) -> Array:
        """(m, m) sum of v_t v_t', the constant left out; entry c (lags + 1) + i is lag i of c."""
        return self.total[:-1, :-1]

    @property
    def sums(self) -> Array:
        """(m,) sum of v_t, in the order of `gram`.

        Raises
        ------
        DataError
            If they were not taken.
        """
        self._place(CONSTANT)
        return self.total[:-1, -1]

    def between(self, left: Sequence[Column], right: Sequence[Column]) -> Array:
        """Return sum over t of left_t right_t', (len(left), len(right)).

        A tap on the channel "1" is a constant, where the moments were taken with `constant`. Where
        columns are differences of nearly equal samples, their moments lose the digits that cancel.

        Raises
        ------
        DataError
            If a column taps a channel that is not here, or a larger lag.
        """
        first, second = self._weights(left), self._weights(right)
        return np.asarray(first @ self.total @ second.T + first @ self.rest @ second.T)

    def correlation(self, a: Column, b: Column, lag: int = 0) -> float:
        """Return (1/N) sum over t of a_t b_{t - lag}; a negative lag shifts `a` instead.

        Raises
        ------
        DataError
            If the shifted column reaches beyond the lags kept, or there is no sample.
        """
        if self.N == 0:
            raise DataError(f"{self!r} holds no sample. Add a stretch longer than its lags.")
        return float(self.between([_shifted(a, -lag)], [_shifted(b, lag)])[0, 0]) / self.N

    def select(self, channels: Sequence[str] | None = None, lags: int | None = None) -> Moments:
        """Return the moments of some channels, in the order given, and of the first `lags` lags.

        The sums keep their N terms: fewer lags do not bring back the samples at the start.

        Raises
        ------
        DataError
            If a channel is not here, or more lags are requested than were kept.
        """
        names = self.channels if channels is None else checked_channels(channels)
        order = self.lags if lags is None else checked_lags(lags)
        if order > self.lags:
            raise DataError(
                f"{order} lags of moments that keep {self.lags}. Compute them with lags={order}."
            )
        kept = [self._place(name) + i for name in names for i in range(order + 1)]
        cut = np.ix_([*kept, -1], [*kept, -1])
        return Moments(names, order, self.total[cut], self.rest[cut], self.constant)

    def _place(self, channel: str) -> int:
        return _place(self.channels, self.lags, self.constant, channel)

    def _weights(self, columns: Sequence[Column]) -> Array:
        return _weights(self.channels, self.lags, self.constant, tuple(columns))

    # ------------------------------------------------------------------ adding them

    def __add__(self, other: Moments) -> Moments:
        if not isinstance(other, Moments):
            return NotImplemented
        kind, second = ((x.channels, x.lags, x.constant) for x in (self, other))
        if kind != second:
            raise DataError(
                f"{self!r} and {other!r} do not add: channels, lags or constant differ. Bring both "
                "to the same with moments.select(channels, lags), or compute them alike."
            )
        high, low = two_sum(self.total, other.total)
        return Moments(*kind[:2], *fast_two_sum(high, low + self.rest + other.rest), self.constant)

    def __radd__(self, other: int) -> Moments:
        """0 + moments, with which `sum` begins."""
        return self if other == 0 else NotImplemented

    # ------------------------------------------------------------------ keeping them

    def save(self, path: str | Path) -> Path:
        """Write them to an .npz file, whole or not at all; returns the path.

        Raises
        ------
        DataError
            If the file cannot be written.
        """
        path = Path(path)
        try:
            with replacing(path) as file:
                np.savez(
                    file,
                    channels=np.array(self.channels),
                    lags=np.array(self.lags),
                    total=self.total,
                    rest=self.rest,
                    constant=np.array(self.constant),
                )
        except OSError as error:
            raise DataError(
                f"cannot write {path}: {error.strerror}. Make room or name another place."
            ) from error
        return path

    @classmethod
    def load(cls, path: str | Path) -> Moments:
        """Read what `save` has written.

        Raises
        ------
        DataError
            If the file is absent or holds no moments.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                channels = tuple(str(name) for name in file["channels"])
                sums = (file["total"], file["rest"], bool(file["constant"]))
                return cls(channels, int(file["lags"]), *sums)
        except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
            raise DataError(
                f"{path}: it holds no moments ({error}). Give a file written by Moments.save."
            ) from error


def _place(channels: tuple[str, ...], lags: int, constant: bool, channel: str) -> int:
    if channel == CONSTANT and constant:
        return len(channels) * (lags + 1)
    if channel not in channels:
        remedy = "constant=True" if channel == CONSTANT else "it"
        raise DataError(
            f"no moments of channel {channel!r}; there are those of {', '.join(channels)}. Name "
            f"one of them, or compute the moments with {remedy}."
        )
    return channels.index(channel) * (lags + 1)


@functools.lru_cache(maxsize=256)  # campaigns use the same columns in every run
def _weights(
    channels: tuple[str, ...], lags: int, constant: bool, columns: tuple[Column, ...]
) -> Array:
    """(len(columns), m + 1): each column as a combination of the entries of v_t."""
    weights = np.zeros((len(columns), len(channels) * (lags + 1) + 1))
    order = max((column.order for column in columns), default=0)
    for row, column in zip(weights, columns, strict=True):
        for channel, lag, weight in column.taps:
            if not 0 <= lag <= lags:
                raise DataError(
                    f"column {column.name} reaches to lag {lag}, the moments keep lags 0 to "
                    f"{lags}. Compute them with lags={order}."
                )
            place = _place(channels, lags, constant, channel)
            row[place + (0 if channel == CONSTANT else lag)] += weight
    weights.flags.writeable = False
    return weights


def _shifted(column: Column, lag: int) -> Column:
    if lag <= 0:
        return column
    taps = tuple((c, i if c == CONSTANT else i + lag, w) for c, i, w in column.taps)
    return Column(f"{column.name}, {lag} earlier", taps)


def checked_channels(channels: Sequence[str]) -> tuple[str, ...]:
    """Refuse no names, names given twice, and the constant's."""
    names = (channels,) if isinstance(channels, str) else tuple(str(name) for name in channels)
    if isinstance(channels, str) or not names or len(set(names)) < len(names) or CONSTANT in names:
        raise DataError(
            f"channels {', '.join(map(repr, names)) or 'none'}. Give a list of at least one, "
            f"each name once; {CONSTANT!r} is the constant and always there."
        )
    return names


def checked_lags(lags: int, name: str = "lags") -> int:
    """Refuse what is not a number of samples, 0, 1, ..."""
    if isinstance(lags, bool) or int(lags) != lags or lags < 0:
        raise DataError(f"{name} = {lags!r}. Give a number of samples, an integer of at least 0.")
    return int(lags)
