"""Moments of a stream, window by window: what a monitor keeps of the samples that pass.

Cross moments are sums over samples, so a stream can be cut into windows whose sums are added,
dropped or faded as time goes on. The windows made here share no term and lose none: the sums over
neighbouring windows, added, are the sums over their union,

    M(union) = sum_c M_c,    sliding: sum of the last n,    forgetting: M <- lambda M + M_c.

Instruments that are a reference filtered are made on the way, with the filters' states carried
from one piece of the stream to the next.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from casid.arrays import Array
from casid.errors import DataError
from casid.estimation.cross_moments.gram import Moments, checked_channels, checked_lags
from casid.estimation.cross_moments.moments import moments
from casid.linear.sampled.lagged_columns import Column
from casid.linear.stability import largest_root


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """A channel made of another one: b(q^-1)/a(q^-1) applied to it, at rest before the stream.

    Attributes
    ----------
    channel : the recorded channel that drives it, an external reference.
    b, a : ascending powers of q^-1; a is monic and stable.
    """

    channel: str
    b: Array
    a: Array

    def __post_init__(self) -> None:
        b, a = (np.atleast_1d(np.array(x, dtype=np.float64)) for x in (self.b, self.a))
        _require_stable(a, f"filter from {self.channel}")
        object.__setattr__(self, "b", b)
        object.__setattr__(self, "a", a)


class WindowedMoments:
    """Cross moments of consecutive windows of a stream that arrives in any pieces.

    Parameters
    ----------
    channels : recorded channels to be kept.
    lags : the largest lag, >= 0.
    size : samples of a window, more than `lags`.
    simulated : name -> a channel to be made from a recorded one.
    prefilter : (numerator, denominator), ascending powers of q^-1, applied to every channel alike,
        simulated ones included; this leaves a linear relation between them as it is.
    settle : samples left out at the start of the stream, while filters settle.

    Raises
    ------
    DataError
        If the window is too short, or a filter is not stable.
    """

    def __init__(
        self,
        channels: Sequence[str],
        lags: int,
        size: int,
        *,
        simulated: Mapping[str, Simulated] | None = None,
        prefilter: tuple[ArrayLike, ArrayLike] | None = None,
        settle: int = 0,
    ) -> None:
        self._recorded = checked_channels(channels)
        self._simulated = dict(simulated or {})
        self.channels = checked_channels((*self._recorded, *self._simulated))
        self.lags = checked_lags(lags)
        self.size = checked_lags(size, "size")
        if self.size <= self.lags:
            raise DataError(
                f"windows of {size} samples for {lags} lags hold no term. Take longer windows, of "
                "several of the slowest time constants."
            )
        b, a = ([1.0], [1.0]) if prefilter is None else prefilter
        self._b, self._a = (np.atleast_1d(np.array(x, dtype=np.float64)) for x in (b, a))
        _require_stable(self._a, "prefilter")
        self._skip = checked_lags(settle, "settle")
        self._held: Array = np.empty((len(self.channels), 0))
        self._first = True  # the stream's first window loses its first `lags` terms
        order = max(len(self._b), len(self._a)) - 1
        self._state: Array = np.zeros((len(self.channels), order))
        self._drive = {n: np.zeros(max(len(s.b), len(s.a)) - 1) for n, s in self._simulated.items()}

    def add(self, piece: Mapping[str, ArrayLike]) -> list[Moments]:
        """Take the next samples, and return the moments of every window that they complete.

        Parameters
        ----------
        piece : mapping of channel to (n,) array, SI units; the recorded channels and those that
            drive simulated ones.

        Raises
        ------
        DataError
            If a channel is absent, lengths differ, or a sample is not finite.
        """
        from scipy.signal import lfilter

        rows = self._checked(piece)
        made = [rows[n] for n in self._recorded]
        for name, s in self._simulated.items():
            y, self._drive[name] = lfilter(s.b, s.a, rows[s.channel], zi=self._drive[name])
            made.append(y)
        new, self._state = lfilter(self._b, self._a, np.stack(made), axis=1, zi=self._state)
        cut = min(self._skip, new.shape[1])
        self._skip -= cut
        self._held = np.concatenate([self._held, new[:, cut:]], axis=1)
        found: list[Moments] = []
        while True:
            reach = self.size + (0 if self._first else self.lags)
            if self._held.shape[1] < reach:
                return found
            window = dict(zip(self.channels, self._held[:, :reach], strict=True))
            found.append(moments(window, self.lags))
            # The next window begins with the last `lags` samples: its terms reach back to them.
            self._held, self._first = self._held[:, reach - self.lags :].copy(), False

    def _checked(self, piece: Mapping[str, ArrayLike]) -> dict[str, Array]:
        needed = dict.fromkeys((*self._recorded, *(s.channel for s in self._simulated.values())))
        absent = [n for n in needed if n not in piece]
        if absent:
            raise DataError(
                f"the piece holds no channel {absent[0]!r}; it holds {', '.join(piece)}. Rename "
                "its channels, or leave this one out of the monitor."
            )
        rows = {n: np.asarray(piece[n], dtype=np.float64) for n in needed}
        shapes = sorted({r.shape for r in rows.values()})
        if len(shapes) > 1 or len(shapes[0]) != 1:
            raise DataError(f"channels of shapes {shapes}. Give (n,) arrays of one length.")
        for name, row in rows.items():
            bad = np.flatnonzero(~np.isfinite(row))
            if bad.size:
                raise DataError(
                    f"channel {name} is not finite at {bad.size} samples of the piece, the first "
                    f"k = {bad[0]}. Fill the gap, or start a new stream after it."
                )
        return rows


class SlidingSums:
    """The sums over the last `length` windows.

    Parameters
    ----------
    length : windows, >= 1.
    """

    def __init__(self, length: int) -> None:
        if length < 1:
            raise DataError(f"sliding sums over {length} windows. Give 1 or more.")
        self._kept: deque[Moments] = deque(maxlen=length)

    def add(self, window: Moments) -> None:
        """Take the next window; the oldest is dropped."""
        self._kept.append(window)

    def keep_last(self, length: int) -> None:
        """Drop all but the last `length` windows."""
        while len(self._kept) > length:
            self._kept.popleft()

    @property
    def weights(self) -> Array:
        """(n,) weight of each window in the sums, the oldest first."""
        return np.ones(len(self._kept))

    @property
    def windows(self) -> tuple[Moments, ...]:
        """The windows that are kept, the oldest first."""
        return tuple(self._kept)

    @property
    def total(self) -> Moments:
        """Their sum."""
        return sum(self._kept)  # type: ignore[return-value]


def faded(window: Moments, factor: float) -> Moments:
    """The moments times a weight, as forgetting makes them."""
    return Moments(
        window.channels, window.lags, factor * window.total, factor * window.rest, window.constant
    )


class FadingSums(SlidingSums):
    """Sums with exponential forgetting: the window of i windows ago weighs `factor`**i.

    Parameters
    ----------
    factor : per window, in (0, 1); the memory is 1/(1 - factor) windows. What weighs less than
        1e-6 is dropped.
    """

    def __init__(self, factor: float) -> None:
        if not 0.0 < factor < 1.0:
            raise DataError(
                f"forgetting by {factor!r} a window. Give a number between 0 and 1, as "
                "1 - 1/memory, or use SlidingSums."
            )
        self.factor = float(factor)
        super().__init__(max(1, int(np.ceil(np.log(1e-6) / np.log(factor)))))

    @property
    def weights(self) -> Array:
        """(n,) weight of each window in the sums, the oldest first."""
        return np.asarray(self.factor ** np.arange(len(self._kept))[::-1], dtype=np.float64)

    @property
    def total(self) -> Moments:
        """The weighted sum; its N is the sum of the weights times the windows' N, rounded."""
        pairs = zip(self._kept, self.weights.tolist(), strict=True)
        return sum(faded(m, w) for m, w in pairs)  # type: ignore[return-value]


def on_simulated(columns: Sequence[Column], simulated: Mapping[str, str]) -> tuple[Column, ...]:
    """Regressors with their channels replaced: noise-free regressors, the best instruments.

    Parameters
    ----------
    columns : of a difference equation.
    simulated : channel -> the channel that replaces it; others stay, as the reference itself.
    """
    return tuple(
        Column(c.name, tuple((simulated.get(name, name), lag, w) for name, lag, w in c.taps))
        for c in columns
    )


def _require_stable(a: Array, what: str) -> None:
    if not a.size or a[0] != 1.0 or not np.isfinite(a).all():
        raise DataError(f"{what}: denominator {a.tolist()} is not monic. Divide by its first.")
    radius = largest_root(a)
    if radius >= 1.0:
        raise DataError(
            f"{what}: a pole at |z| = {radius:.4f}; the stream would grow without "
            "end. Reflect it into the unit circle."
        )
