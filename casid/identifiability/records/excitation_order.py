"""Excitation orders: how many coefficients a recorded signal can distinguish.

A signal is persistently exciting of order n if the covariance of n of its lags

    R_n = mean over t of phi phi',   phi(t) = (u(t), u(t-1), ..., u(t-n+1))                  (1)

is nonsingular (Ljung 1999, definition 13.1): a constant has order 1, a sinusoid 2, k sinusoids 2 k,
white noise every order. In a record the order is the rank of M lags, M the largest order requested;
directions in which noise of the stated size is as large do not count.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.data.files import plain_fields
from casid.data.record import Record
from casid.errors import DataError, UnknownNameError
from casid.estimation.covariance import autocorrelation
from casid.model.units import difference_from_si, parse_unit

SOURCES = ("L. Ljung, System Identification, 2nd ed., Prentice Hall 1999, section 13.2",)
ROUNDING = 1e-9
"""Singular values below this share of the largest are rounding."""


@dataclass(frozen=True, slots=True)
class Order:
    """Excitation order of one signal.

    Attributes
    ----------
    order : number of independent lags; at `limit` the true order may be higher.
    limit : most lags that were examined.
    rms : root mean square of the signal, its unit.
    noise : standard deviation of the white noise allowed for, 0 for none.
    declared : the unit that text shows both in; `unit` by default, and where that has no zero.
    """

    name: str
    unit: str
    order: int
    limit: int
    rms: float
    noise: float = 0.0
    declared: str = ""

    def __str__(self) -> str:
        return order_text(self.order, self.limit)

    @property
    def shown_unit(self) -> str:
        """The unit of `shown`."""
        has_zero = self.declared and not parse_unit(self.declared).offset
        return self.declared if has_zero else self.unit

    def shown(self, size: float) -> float:
        """An rms or a noise as text shows it."""
        return float(difference_from_si(size, self.shown_unit))

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "name": self.name,
            "unit": self.unit,
            "order": self.order,
            "limit": self.limit,
            "at_least": self.order >= self.limit,
            "rms": self.rms,
            "noise": self.noise,
        }


@dataclass(frozen=True, slots=True, repr=False)
class Excitation:
    """Excitation orders of the channels of one record.

    Attributes
    ----------
    joint : largest n for which n lags of every channel in `together` are independent of each
        other, out of `joint_limit`; 0 where one channel is a multiple of others.
    spacing : samples from one lag to the next.
    note : what limited the orders, if it was the record.
    """

    record: str
    samples: int
    channels: tuple[Order, ...]
    joint: int
    joint_limit: int
    spacing: int = 1
    note: str = ""
    sources: tuple[str, ...] = SOURCES
    together: tuple[str, ...] = ()

    def __getitem__(self, channel: str) -> Order:
        """The order of one channel."""
        for c in self.channels:
            if c.name == channel:
                return c
        raise UnknownNameError(
            f"no channel {channel!r}; there are {', '.join(c.name for c in self)}"
        )

    def __iter__(self) -> Iterator[Order]:
        return iter(self.channels)

    def __repr__(self) -> str:
        return f"<Excitation {self.record}: {', '.join(f'{c.name} {c}' for c in self)}>"

    def __str__(self) -> str:
        apart = f", lags {self.spacing} apart" if self.spacing > 1 else ""
        lines = [f"Excitation orders in {self.record} ({self.samples} samples{apart})"]
        lines += [
            f"  {c.name}  {c}  (rms {c.shown(c.rms):.3g} {c.shown_unit}"
            + (f", noise {c.shown(c.noise):.3g})" if c.noise else ")")
            for c in self.channels
        ]
        if len(self.together) > 1:
            of = "" if len(self.together) == len(self.channels) else f" {', '.join(self.together)}"
            lines.append(f"  jointly{of}  {order_text(self.joint, self.joint_limit)}")
        if self.note:
            lines.append(f"  {self.note}")
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"schema": "casid.excitation/1"} | plain_fields(self, leave_out=("together",))


def excitation_orders(
    record: Record,
    channels: Sequence[str] | None = None,
    *,
    max_order: int = 20,
    noise: Mapping[str, float] | None = None,
    spacing: int = 1,
    together: Sequence[str] | None = None,
) -> Excitation:
    """Excitation order of each channel, and of several together.

    Parameters
    ----------
    channels : names; default all of the record. Samples marked missing are left out.
    max_order : lags M that are examined.
    spacing : samples from one lag to the next. Lags of an oversampled noisy signal look alike
        unless M spacing Ts is of the order of its periods; see `decorrelation`.
    noise : channel -> standard deviation of its white noise [SI]. Without one every recorded
        signal with noise in it has every order: the noise excites too.
    together : channels whose lags are to be independent of each other; default all.

    Raises
    ------
    DataError
        A channel that is not there, no lag requested, or a negative noise.
    """
    names = list(channels) if channels is not None else list(record.names)
    sd = dict(noise or {})
    if max_order < 1 or spacing < 1 or not names:
        raise DataError(
            f"{record.name}: excitation of {len(names)} channels up to order {max_order}, lags "
            f"{spacing} apart; name at least one channel, an order and a spacing of at least 1"
        )
    _require_noise(record, sd)
    signals = {name: signal(record, name) for name in names}
    orders, shortest = [], max_order
    for name, (values, used) in signals.items():
        limit = longest_window([used], 1, max_order, spacing)
        shortest = min(shortest, limit)
        order = _order([values], [used], [sd.get(name, 0.0)], limit, spacing)
        rms = float(np.sqrt(np.mean(values[used] ** 2))) if used.any() else 0.0
        orders.append(Order(name, record.units[name], order, limit, rms, float(sd.get(name, 0.0))))
    both = names if together is None else list(together)
    joint, joint_limit = _joint(
        [signals[n][0] for n in both],
        [signals[n][1] for n in both],
        [sd.get(n, 0.0) for n in both],
        max_order,
        spacing,
    )
    note = ""
    if shortest < max_order:
        note = (
            f"the record has samples for {shortest} lags only, not {max_order}; a longer one may "
            "show higher orders"
        )
    return Excitation(
        record.name,
        record.N,
        tuple(orders),
        joint,
        joint_limit,
        spacing,
        note,
        together=tuple(both),
    )


def _require_noise(record: Record, sd: Mapping[str, float]) -> None:
    """Refuse noise that is no standard deviation."""
    for name, value in sd.items():
        if not (math.isfinite(value) and value >= 0):
            raise DataError(
                f"{record.name}: noise of {name} = {value}; give a standard deviation, or leave it "
                "out"
            )


def order_text(order: int, limit: int) -> str:
    """An order as text: ">= n" at the limit of what was examined."""
    return f"order >= {order}" if order >= limit else f"order {order}"


def signal(record: Record, name: str) -> tuple[Array, Array]:
    """(N,) samples of a channel, zero where missing, and (N,) bool where it is used."""
    values = np.asarray(record[name], dtype=float)
    used = ~record.missing[name] if name in record.missing else np.ones(record.N, dtype=bool)
    return np.where(used, values, 0.0), used


def decorrelation(values: Array) -> int:
    """First lag at which the autocorrelation of a signal (N,) is below one half, 1 to N / 4."""
    limit = max(len(values) // 4, 1)
    if limit < 2 or not np.ptp(values):
        return 1
    below = np.flatnonzero(autocorrelation(values, limit) < 0.5)
    return int(below[0]) + 1 if below.size else limit


def longest_window(used: Sequence[Array], channels: int, max_order: int, spacing: int) -> int:
    """Most lags for which the record has at least as many complete rows as columns."""
    everywhere = np.all(used, axis=0)
    for n in range(max_order, 0, -1):
        if len(lag_matrix(everywhere, everywhere, n, spacing)) >= channels * n:
            return n
    return 0


def lag_matrix(values: Array, used: Array, n: int, spacing: int) -> Array:
    """(m, n) lags of a signal, one row a time at which all of them are used."""
    width = (n - 1) * spacing + 1
    if width > len(values):
        return np.zeros((0, n))
    windows = np.lib.stride_tricks.sliding_window_view(values, width)[:, ::spacing]
    complete = np.lib.stride_tricks.sliding_window_view(used, width)[:, ::spacing].all(axis=1)
    return np.asarray(windows[complete])


def noise_edge(rows: int, n: int) -> float:
    """Largest singular value of `n` lags of white noise of unit size, with a margin.

    sqrt(rows) for a long record; the excess follows the largest of n periodogram ordinates, a
    heuristic of the form of Meckes (2007, Electron. Commun. Probab. 12, 315): sqrt(n log n).
    """
    return math.sqrt(rows) + math.sqrt(2 * n * math.log(2 * n))


def singular_values(matrix: Array) -> Array:
    """Singular values of a tall matrix, by way of its triangular factor."""
    return np.asarray(np.linalg.svd(np.linalg.qr(matrix, mode="r"), compute_uv=False))


def rank_above(matrix: Array, edge: float) -> int:
    """Number of singular values above `edge` and above rounding."""
    s = singular_values(matrix)
    largest = float(s.max(initial=0.0))
    return int(np.sum(s > max(edge, ROUNDING * largest))) if largest > 0 else 0


def _order(
    values: Sequence[Array], used: Sequence[Array], sd: Sequence[float], n: int, spacing: int
) -> int:
    """Rank of `n` lags of all signals together, each in units of its noise, else of its size."""
    if n == 0:
        return 0
    everywhere = np.all(used, axis=0)
    blocks, edge = [], 0.0
    noisy = all(s > 0 for s in sd)
    for v, s in zip(values, sd, strict=True):
        block = lag_matrix(v, everywhere, n, spacing)
        size = s if noisy else float(np.sqrt(np.mean(block**2)))
        blocks.append(block / size if size > 0 else block)
        if noisy:
            edge = noise_edge(len(block), n * len(values))
    return rank_above(np.hstack(blocks), edge)


def _joint(
    values: Sequence[Array],
    used: Sequence[Array],
    sd: Sequence[float],
    max_order: int,
    spacing: int,
) -> tuple[int, int]:
    """Largest n whose n lags of every signal are independent, and the largest n examined."""
    k = len(values)
    limit = longest_window(used, k, max_order, spacing)
    if k == 1:
        return _order(values, used, sd, limit, spacing), limit
    low, high = 0, limit  # a singular R_n makes every longer one singular
    while low < high:
        middle = (low + high + 1) // 2
        if _order(values, used, sd, middle, spacing) == k * middle:
            low = middle
        else:
            high = middle - 1
    return low, limit
