"""Instruments from an external reference: simulated signals that no disturbance can reach.

Instruments zeta_t of (2.42) have to be correlated with the regressors and uncorrelated with the
equation error. Whatever is computed from the external reference delta alone satisfies the second;
for the first the loop is simulated from delta, (5.4)-(5.5) and (7.53)-(7.55) of Linder (2017):

    a_hat = F_delta(q) delta,    [y; u_I]_hat = G(q, theta_hat) a_hat,                         (1)

where G is the direct model, the one before its unknown input was eliminated. Its transfer functions
are the closed loop of the indirect model and F_y, formed algebraically: F_y alone is improper, and
the loop has a direct term. A wrong F_delta costs variance, not consistency.

All signals of (1) share one denominator, so lags of the single signal w = a_hat / denominator span
them all: one pass over the reference an iteration, whatever the number of instruments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import casadi as ca
import numpy as np

from casid.arrays import TINY, Array
from casid.errors import DataError, ModelError
from casid.estimation.moments.instruments.reference_filter import Filter, ReferenceFilter
from casid.linear.linear_model import linearise
from casid.linear.sampled.discretisation import discretise
from casid.linear.sampled.lagged_columns import Column, lagged
from casid.model.model import Model


@dataclass(frozen=True, slots=True)
class Instruments:
    """Which instruments are built, and from which external reference.

    Attributes
    ----------
    reference : recorded channel that drives the unknown input; or a mapping of the direct model's
        inputs to channels where several have to be driven.
    F_delta : filter from the reference to the unknown input, or a mapping; a guess will do, or
        `casid.estimation.moments.instruments.reference_filter_estimate.estimate_reference_filter`.
    initial : where the first instruments come from: ``"model"``, the loop simulated with the start
        values (its own lags reach much further than those of the reference), or ``"reference"``,
        lags of the reference as in Algorithm 2.1; these also where the start's loop is unstable;
        or ``"channels"``, lags of what `first` names.
    n_delta0 : lags of the reference then.
    first : channel -> lags of the first instruments for ``initial="channels"``: signals made of the
        reference alone, such as `black_box_reference` simulates (Algorithm 8.1).
    n_delta, n_y, n_u : lags of a_hat, of each simulated output and of each simulated input, from
        lag 0 on (the direct term of the loop needs it); 0 leaves the block out.
    reduce : replace the columns by independent ones of the same span, see `independent`. Weightings
        that depend on the span alone do not notice; ``"identity"`` does, and wants them as given.
    """

    reference: str | Mapping[str, str]
    F_delta: Filter | Mapping[str, Filter] = field(default_factory=ReferenceFilter)
    initial: Literal["model", "reference", "channels"] = "model"
    n_delta0: int = 8
    n_delta: int = 4
    n_y: int = 4
    n_u: int = 4
    reduce: bool = True
    first: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("n_delta0", "n_delta", "n_y", "n_u"):
            value = getattr(self, name)
            if isinstance(value, bool) or int(value) != value or value < 0:
                raise ModelError(f"instruments: {name} = {value!r}; give a whole number, 0 or more")
        if self.n_delta0 == 0:
            raise ModelError("instruments: n_delta0 = 0 leaves nothing to start from; give 4 or so")
        if self.n_delta + self.n_y + self.n_u == 0:
            raise ModelError("instruments: n_delta, n_y and n_u are all 0; give one of them lags")
        if (self.initial == "channels") != any(n > 0 for n in self.first.values()):
            raise ModelError(
                f"instruments: initial={self.initial!r} with first={dict(self.first)!r}; to start "
                'from channels give both initial="channels" and the lags of each in first='
            )

    def drives(self, direct: Model) -> dict[str, tuple[str, Filter]]:
        """Input of the direct model -> (channel, filter).

        Raises
        ------
        ModelError
            If an input of the direct model has no reference.
        """
        unknown = [n for n, e in direct.inputs.items() if e.kind == "unknown"]
        if isinstance(self.reference, str):
            driven = unknown or _alone(direct, self.reference)
            if len(driven) != 1:
                named = ", ".join(driven) or "none"
                raise ModelError(
                    f"{direct.name}: one reference {self.reference!r}, and {len(driven)} inputs "
                    f"that it may drive ({named}); give a mapping of inputs to channels, as in "
                    f"Instruments({{{(driven or ['u'])[0]!r}: {self.reference!r}}})"
                )
            chosen = {driven[0]: self.reference}
        else:
            chosen = dict(self.reference)
        for name, entry in direct.inputs.items():
            if entry.kind == "known" and name not in chosen:
                chosen[name] = name  # exactly known: external by itself
        lacking = [n for n in direct.inputs if n not in chosen]
        if lacking:
            raise ModelError(
                f"{direct.name}: nothing external is named that drives {', '.join(lacking)}; "
                "declare it known=True if no disturbance reaches it, or map it to a reference: "
                f"Instruments(reference={{{lacking[0]!r}: 'channel'}})"
            )
        plain: Filter = ReferenceFilter()
        filters: Mapping[str, Filter] = self.F_delta if isinstance(self.F_delta, Mapping) else {}
        default = plain if isinstance(self.F_delta, Mapping) else self.F_delta
        return {
            name: (chosen[name], filters.get(name, default if name in unknown else plain))
            for name in direct.inputs
        }


def _alone(direct: Model, reference: str) -> list[str]:
    """Inputs that a reference may drive where none is unknown: measured ones, else known ones."""
    kinds = {n: e.kind for n, e in direct.inputs.items() if n != reference}
    measured = [n for n, kind in kinds.items() if kind == "measured"]
    return measured or [n for n, kind in kinds.items() if kind == "known"]


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """Instruments of one record: columns on signals, and how long their transient lasts."""

    signals: Mapping[str, Array]
    columns: tuple[Column, ...]
    transient: int  # samples to leave out at the start
    centred_from: int = -1  # the signals have no mean from this sample on
    kept: dict[Any, Any] = field(default_factory=dict, init=False, repr=False)  # their own moments


class UnstableLoop(Exception):
    """The loop simulated with the current estimate has a pole outside the unit circle."""

    def __init__(self, pole: complex) -> None:
        super().__init__(f"pole at |z| = {abs(pole):.4f}")
        self.pole = pole


class Loop:
    """The direct model discretised once, simulated from references at any parameter values.

    Parameters
    ----------
    model : indirect model; its eliminated inputs are put back.
    Ts : sample time [s].
    method : discretisation; the bilinear transform keeps the algebraic loop of the indirect model.
    """

    def __init__(self, model: Model, Ts: float, method: str = "bilinear") -> None:
        self.direct = model.direct()
        linear = linearise(self.direct)
        discrete = discretise(linear, Ts, method)
        self.Ts = Ts
        self.inputs, self.channels = linear.inputs, linear.outputs
        self.parameters = linear.parameters
        flat = ca.horzcat(*[b for row in discrete.numerators for b in row])
        self._coefficients = ca.Function(
            "loop", [linear.p], [ca.densify(discrete.denominator), ca.densify(flat)]
        )

    def coefficients(
        self, values: Mapping[str, float]
    ) -> tuple[Array, dict[str, dict[str, Array]]]:
        """Denominator and numerators[channel][input], ascending powers of 1/q, at `values`.

        Raises
        ------
        UnstableLoop
            If a pole lies on or outside the unit circle.
        """
        return self._at(values)[:2]

    def _at(self, values: Mapping[str, float]) -> tuple[Array, dict[str, dict[str, Array]], Array]:
        """The coefficients, and the poles (n,) of the loop."""
        p = [values[n] for n in self.parameters]
        den, num = self._coefficients(p)
        denominator = np.asarray(den, dtype=float).ravel()
        if not np.all(np.isfinite(denominator)):
            raise UnstableLoop(complex(np.inf))
        table = np.asarray(num, dtype=float)
        poles = np.roots(denominator)
        if poles.size and np.max(np.abs(poles)) >= 1.0:
            raise UnstableLoop(complex(poles[int(np.argmax(np.abs(poles)))]))
        ni = len(self.inputs)
        return (
            denominator,
            {
                c: {u: table[:, i * ni + j] for j, u in enumerate(self.inputs)}
                for i, c in enumerate(self.channels)
            },
            poles,
        )

    def driven(self, drives: Mapping[str, Array], values: Mapping[str, float]) -> dict[str, Array]:
        """Every output of the direct model simulated from the inputs (N,), at rest before."""
        from scipy.signal import lfilter

        denominator, numerators = self.coefficients(values)
        return {
            c: np.asarray(
                sum(lfilter(numerators[c][u], denominator, drives[u]) for u in self.inputs)
            )
            for c in self.channels
        }

    def instruments(
        self,
        drives: Mapping[str, Array],
        values: Mapping[str, float],
        settings: Instruments,
        outputs: Sequence[str],
    ) -> Simulated:
        """Lags of a_hat, and of the simulated outputs and inputs of the indirect model.

        `outputs` are those of the indirect model; the direct model's other outputs became inputs.
        """
        from scipy.signal import lfilter

        denominator, numerators, poles = self._at(values)
        signals: dict[str, Array] = {}
        columns: list[Column] = []
        driven = [u for u in self.inputs if np.any(drives[u])]  # others: F_delta = 0
        for u in driven:
            w = f"w[{u}]"
            signals[w] = np.asarray(lfilter([1.0], denominator, drives[u]))
            for i in range(settings.n_delta):
                taps = tuple((w, i + j, float(c)) for j, c in enumerate(denominator) if c != 0.0)
                columns.append(Column(f"{u}^[t-{i}]", taps))
        for c in self.channels:
            for i in range(settings.n_y if c in outputs else settings.n_u):
                taps = tuple(
                    (f"w[{u}]", i + j, float(b))
                    for u in driven
                    for j, b in enumerate(numerators[c][u])
                    if b != 0.0
                )
                if taps:
                    columns.append(Column(f"{c}^[t-{i}]", taps))
        chosen = independent(columns) if settings.reduce else tuple(columns)
        # Rounded up, so that sums from there on can be kept while the estimate settles.
        start = 64 * (transient(poles) // 64 + 1)
        if any(len(signal) <= 4 * start for signal in signals.values()):
            return Simulated(signals, chosen, start)
        for signal in signals.values():
            signal -= signal[start:].mean()
        return Simulated(signals, chosen, start, start)


def from_reference(drives: Mapping[str, Array], lags: int) -> Simulated:
    """The first instruments of Algorithm 2.1: lags 0 .. lags - 1 of the references themselves."""
    signals = {f"delta[{name}]": signal for name, signal in drives.items()}
    columns = [c for name in signals for c in lagged(name, range(lags))]
    return Simulated(signals, tuple(columns), 0)


def from_channels(channels: Mapping[str, Array], lags: Mapping[str, int], record: str) -> Simulated:
    """The first instruments of Algorithm 8.1: lags of signals that the reference alone has made.

    Raises
    ------
    DataError
        If the record has no such channel.
    """
    lacking = [c for c in lags if c not in channels]
    if lacking:
        raise DataError(
            f"{record}: no channel {lacking[0]!r} for the first instruments; it has "
            f"{', '.join(channels)}. Simulate it from the reference "
            "(casid.estimation.moments.instruments.black_box_reference), or take it out of "
            "Instruments(first=...)"
        )
    used = {name: n for name, n in lags.items() if n > 0}
    columns = [c for name, n in used.items() for c in lagged(f"first[{name}]", range(n))]
    return Simulated({f"first[{n}]": np.asarray(channels[n]) for n in used}, tuple(columns), 0)


def transient(poles: Array, share: float = 1e-3) -> int:
    """Samples until the slowest of the poles' modes has fallen to `share`."""
    order = len(poles) + 1
    slowest = float(np.max(np.abs(poles), initial=0.0))
    if slowest <= 1e-6:
        return order
    return int(np.ceil(np.log(share) / np.log(slowest))) + order


def independent(columns: Sequence[Column]) -> tuple[Column, ...]:
    """Columns that span what `columns` span: the plain lags where every one of them is reached.

    Signs and combinations of instruments do not matter, their span does; and lags of the signals of
    one loop repeat one another. The span is found from the taps alone, exactly, before any data.
    """
    taps = sorted({(channel, lag) for c in columns for channel, lag, _ in c.taps})
    table = np.zeros((len(columns), len(taps)))
    where = {tap: k for k, tap in enumerate(taps)}
    for i, c in enumerate(columns):
        for channel, lag, weight in c.taps:
            table[i, where[channel, lag]] += weight
    table /= np.maximum(np.linalg.norm(table, axis=1, keepdims=True), TINY)
    _, s, vt = np.linalg.svd(table, full_matrices=False)
    rank = int(np.sum(s > 1e-10 * s[0]))
    if rank == len(taps):
        return tuple(Column(f"{c}[t-{i}]", ((c, i, 1.0),)) for c, i in taps)
    if rank == len(columns):
        return tuple(columns)
    return tuple(
        Column(
            f"combination {k + 1}",
            tuple((c, i, float(v)) for (c, i), v in zip(taps, vt[k], strict=True) if v != 0.0),
        )
        for k in range(rank)
    )


def reference_signals(
    settings: Instruments, direct: Model, channels: Mapping[str, Array], Ts: float, record: str
) -> dict[str, Array]:
    """Input of the direct model -> filtered reference (N,), from a record's channels.

    Raises
    ------
    DataError
        If the record has no such channel, or it never moves.
    """
    out: dict[str, Array] = {}
    for name, (channel, chosen) in settings.drives(direct).items():
        if channel not in channels:
            raise DataError(
                f"{record}: no channel {channel!r} for the reference of {name}; it has "
                f"{', '.join(channels)}. Name one of them: Instruments(reference=...)"
            )
        signal = channels[channel]
        if np.ptp(signal) == 0.0:
            raise DataError(
                f"{record}: the reference {channel} never moves, so nothing simulated from it is "
                "correlated with the regressors; use a record in which it is excited"
            )
        out[name] = chosen.apply(signal, Ts)
    return out
