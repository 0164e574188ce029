"""Excitation by an eliminated unknown input, as distinct from that of the sensor replacing it.

An indirect model has a measured output a_s in the place of an unknown input a_y (Linder 2017,
(7.24)). The a_s of a free decay is as rich as the motion and has no information: with a_y = 0 it is
a function of the states, and the rank falls from 5 to 4 (sections 7.1 and 7.3.1). Along the
simulated solution the direct model splits the sensor's signal,

    a_s = h(x, 0) + c,    c = h(x, a_y) - h(x, 0)                                            (1)

and the excitation order of c counts, the contribution of the unknown input.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.data.arguments import problem_of
from casid.data.files import plain_fields
from casid.data.problem import Problem
from casid.errors import DataError, nearest
from casid.estimation.estimate import Estimate
from casid.identifiability.records.excitation_order import (
    ROUNDING,
    Excitation,
    Order,
    decorrelation,
    excitation_orders,
    lag_matrix,
    longest_window,
    order_text,
    rank_above,
    signal,
    singular_values,
)
from casid.identifiability.records.planned_experiment import Experiments, Planned, plan
from casid.model.model import Model

SOURCES = (
    "J. Linder, Indirect System Identification for Unknown Input Problems, Linkoping 2017, "
    "sections 4.3.3, 7.1 and 7.3.1",
)
_MARGIN = 1.25


@dataclass(frozen=True, slots=True)
class Reference:
    """The contribution of an eliminated input to the channel that replaces it.

    Attributes
    ----------
    unknown, channel : the eliminated input and the measured channel in its place.
    channel_order : excitation order of the channel as recorded.
    order : excitation order of the unknown input's part c of (1), above the effect of noise,
        estimation errors and interpolation between samples; `limit` the largest order examined.
    share : mean square of c over that of the channel about its mean; it may exceed 1 where c and
        the states' part cancel.
    rms : of the unknown input reconstructed along the simulated solution, SI `unit`.
    """

    unknown: str
    channel: str
    unit: str
    channel_order: int
    order: int
    limit: int
    share: float
    rms: float

    @property
    def is_exciting(self) -> bool:
        """True if the unknown input itself moves, and not the sensor alone."""
        return self.order > 0

    def __str__(self) -> str:
        moves = f"{self.channel} has {order_text(self.channel_order, self.limit)}"
        if self.is_exciting:
            return (
                f"{moves}, {self.unknown} itself {order_text(self.order, self.limit)} "
                f"({100 * self.share:.3g} % of the variance of {self.channel})"
            )
        return (
            f"{moves}, but it is a function of the states: {self.unknown} has order 0 and carries "
            "no information. Record an experiment in which it acts"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return plain_fields(self, "is_exciting")


@dataclass(frozen=True, slots=True, repr=False)
class RecordExcitation:
    """One record: the orders of its signals, and those of the unknown inputs behind them.

    Attributes
    ----------
    signals : orders of the model's inputs and of channels recorded beside them (references).
    references : one an eliminated input; empty for a model without any.
    recorded : names in `signals` that were recorded beside the model's, a reference among them.
    note : what the reconstruction depends on, where no values were given for it.
    """

    record: str
    signals: Excitation
    references: tuple[Reference, ...]
    recorded: tuple[str, ...] = ()
    note: str = ""
    sources: tuple[str, ...] = SOURCES

    def __repr__(self) -> str:
        return f"<RecordExcitation {self.record}: {'; '.join(map(str, self.references))}>"

    def __str__(self) -> str:
        more = [*map(str, self.references), *([self.note] if self.note else [])]
        return "\n".join([str(self.signals), *(f"  {line}" for line in more)])

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "schema": "casid.record_excitation/1",
            "record": self.record,
            "signals": self.signals.to_json(),
            "references": [r.to_json() for r in self.references],
            "recorded": list(self.recorded),
            "note": self.note,
            "sources": [*self.signals.sources, *self.sources],
        }


def record_excitation(
    problem: Problem | Model,
    experiments: Experiments = None,
    *,
    at: Mapping[str, float] | Estimate | None = None,
    noise: Mapping[str, float] | None = None,
    max_order: int = 20,
    spacing: int | None = None,
    draws: int = 20,
    seed: int = 0,
) -> tuple[RecordExcitation, ...]:
    """Excitation of every record: of its inputs, of recorded references, of eliminated inputs.

    Parameters
    ----------
    at : values along which the unknown input is reconstructed. Errors in them look like an input:
        give an estimate, whose covariance is then allowed for.
    noise : channel -> standard deviation of its white noise, in its unit, over the problem's.
    max_order, spacing : most lags examined, and the samples between them; by default the lag at
        which the autocorrelation of the measured channel falls below one half.
    draws : simulated errors (noise, estimation) that the unknown input has to exceed, each of them.
    seed : of those.

    Raises
    ------
    ModelError
        The model has no direct model any more (see `Model.direct`), or no such name in `at`.
    DataError, SolveError
        See `excitation_orders` and `plan`.
    """
    problem = problem_of(problem)
    sd = problem.noise_in_si({**problem.noise, **(noise or {})})
    p = plan(problem, experiments, at=at)
    _require_channels(p.criterion.model, problem, sd)
    split = _Split(p) if p.criterion.model.eliminated_units else None
    note = ""
    if split is not None and at is None and p.criterion.names:
        note = (
            f"{' and '.join(split.unknown)} was reconstructed with the start values, whose "
            "errors appear in it as an input: pass an estimate, at=casid.identify(...)"
        )
    out = []
    for e, experiment in enumerate(p.criterion.experiments):
        record = experiment.record
        inputs = [n for n in p.criterion.model.inputs if n in record.channels]
        recorded = [n for n in problem.recorded if n in record.channels and n not in inputs]
        chosen = inputs + recorded or list(record.names)
        known = {n: s for n, s in sd.items() if n in chosen}
        apart = spacing or min(
            decorrelation(signal(record, n)[0]) for n in (split.channels if split else chosen)
        )
        signals = excitation_orders(
            record,
            chosen,
            max_order=max_order,
            noise=known,
            spacing=apart,
            together=inputs or chosen,
        )
        signals = replace(signals, channels=tuple(_declared(c, problem) for c in signals))
        references: tuple[Reference, ...] = ()
        if split is not None:
            rng = np.random.default_rng((seed, e))
            references = split.references(e, signals, known, at, max_order, draws, rng)
        out.append(RecordExcitation(record.name, signals, references, tuple(recorded), note))
    return tuple(out)


def _require_channels(model: Model, problem: Problem, sd: Mapping[str, float]) -> None:
    """Refuse noise of what is no channel."""
    there = [*model.inputs, *model.outputs, *problem.recorded]
    for name in sd:
        if name not in there:
            raise DataError(
                f"noise of {name!r}: {problem.name} has no such channel; it has "
                f"{', '.join(there)}{nearest(name, there, is_listed=True)}"
            )


def _declared(order: Order, problem: Problem) -> Order:
    """The order with the unit that the problem declares for its channel."""
    unit = problem.recorded.get(order.name) or problem.model.unit_of(order.name)
    return replace(order, declared=unit)


class _Split:
    """The channels of an indirect model, split along its solution by (1)."""

    def __init__(self, planned: Planned) -> None:
        self.planned, self.criterion = planned, planned.criterion
        model = self.criterion.model
        indirect, direct = model.explicit(), model.direct()
        e = direct.explicit()
        self.unknown = list(model.eliminated_units)
        self.channels = [n for n in direct.outputs if n not in model.outputs]
        rows = ca.vertcat(*[e.h[e.outputs.index(c)] for c in self.channels])
        symbols = ca.vertcat(*[direct.symbol(w) for w in self.unknown])
        self.acts_on = np.array(ca.DM(ca.jacobian(rows, symbols).sparsity(), 1)) > 0
        w = ca.SX.sym("w", len(self.unknown))
        rows = ca.substitute(rows, symbols, w)
        arguments = [indirect.x, indirect.u, indirect.p]
        values = ca.vertcat(*[indirect.eliminated[n] for n in self.unknown])
        self._unknown = ca.Function("w", arguments, [values])
        self._channels = ca.Function("h", [*arguments, w], [rows])

    def parts(self, x: Array, e: int, u: Array, u_motion: Array | None = None) -> tuple[Any, Array]:
        """The unknown inputs (N, nw), and what each adds to each channel (N, nc, nw).

        The states move under `u_motion`, where that differs from what the sensors show.
        """
        d = self.criterion.data[e]
        moved = replace(d, u=u if u_motion is None else u_motion)
        _, states, _ = self.criterion.simulate(x, e, signals=moved)
        p, _ = self.criterion.parameter_vector(x, e)
        n = len(u)
        arguments = [states.T, u.T, np.tile(p[:, None], n)]
        w = np.array(self._unknown.map(n)(*arguments))
        channels = self._channels.map(n)
        full = np.array(channels(*arguments, w))
        adds = np.zeros((n, len(self.channels), len(self.unknown)))
        for j in range(len(self.unknown)):
            without = w.copy()
            without[j] = 0.0
            adds[:, :, j] = (full - np.array(channels(*arguments, without))).T
        return w.T, adds

    def references(
        self,
        e: int,
        signals: Excitation,
        sd: Mapping[str, float],
        at: Mapping[str, float] | Estimate | None,
        max_order: int,
        draws: int,
        rng: np.random.Generator,
    ) -> tuple[Reference, ...]:
        """One for every pair of an unknown input and a channel it acts on."""
        d, x = self.criterion.data[e], self.planned.x
        w, adds = self.parts(x, e, d.u)
        # With half the samples: several times the error of straight lines between samples.
        errors = [self._between_samples(x, e)]
        errors += [
            self.parts(self._drawn(at, rng), e, self._noisy(e, sd, rng))[1] - adds
            for _ in range(draws if sd or isinstance(at, Estimate) else 0)
        ]
        used, apart = np.ones(d.N, dtype=bool), signals.spacing
        limit = longest_window([used], 1, max_order, apart)
        out = []
        for i, j in np.argwhere(self.acts_on).tolist():
            measured = d.u[:, list(self.criterion.model.inputs).index(self.channels[i])]
            sizes = [_size(error[:, i, j], used, limit, apart) for error in errors]
            edge = _MARGIN * (sizes[0] + max(sizes[1:], default=0.0))
            edge = max(edge, ROUNDING * _size(measured, used, limit, apart))
            spread = float(np.mean((measured - measured.mean()) ** 2))
            unknown = self.unknown[j]
            out.append(
                Reference(
                    unknown,
                    self.channels[i],
                    self.criterion.model.eliminated_units[unknown],
                    signals[self.channels[i]].order,
                    rank_above(lag_matrix(adds[:, i, j], used, limit, apart), edge) if limit else 0,
                    limit,
                    float(np.mean(adds[:, i, j] ** 2)) / spread if spread else 0.0,
                    float(np.sqrt(np.mean(w[:, j] ** 2))),
                )
            )
        return tuple(out)

    def _between_samples(self, x: Array, e: int) -> Array:
        """Change of the parts if every second sample of the inputs were a mean of its neighbours.

        The states follow the difference, the sensors' own samples are unchanged.
        """
        d = self.criterion.data[e]
        held = d.u.copy()
        held[1:-1:2] = (d.u[:-2:2] + d.u[2::2]) / 2
        return np.asarray(self.parts(x, e, d.u, held)[1] - self.parts(x, e, d.u)[1])

    def _noisy(self, e: int, sd: Mapping[str, float], rng: np.random.Generator) -> Array:
        d = self.criterion.data[e]
        u = d.u.copy()
        for i, name in enumerate(self.criterion.model.inputs):
            u[:, i] += sd.get(name, 0.0) * rng.standard_normal(d.N)
        return u

    def _drawn(self, at: Mapping[str, float] | Estimate | None, rng: np.random.Generator) -> Array:
        """The variables, within the errors of the estimate they come from."""
        x = self.planned.x.copy()
        if isinstance(at, Estimate):
            at = at.in_si()
            names = list(at.covariance_names)
            move = rng.multivariate_normal(np.zeros(len(names)), at.covariance, method="eigh")
            for i, name in enumerate(self.criterion.names):
                if name in names:
                    x[i] += move[names.index(name)]
        return x


def _size(error: Array, used: Array, limit: int, spacing: int) -> float:
    """Largest singular value of the lags of an error."""
    if limit == 0:
        return 0.0
    return float(singular_values(lag_matrix(error, used, limit, spacing)).max(initial=0.0))
