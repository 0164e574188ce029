"""How large the signals of a fitted model are: what the catalogue scales its effects by."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.diagnosis.evidence.prewhitening import Weighted
from casid.diagnosis.thresholds import PREWHITENING
from casid.model.effects.effect import Sizes, Spread


def sizes_of(at: Weighted, recorded: Collection[str]) -> Sizes:
    """Sizes of states and outputs, and of the channels recorded beside the model's."""
    sims = [at.criterion.simulated(at.fit.x, e) for e in range(len(at.criterion.experiments))]
    x = np.concatenate([s.x for s in sims])
    d = at.criterion.data[0]
    rms = np.sqrt(np.mean(x**2, axis=0))
    return Sizes(
        rates={n: float(r) for n, r in zip(at.model.states, rms, strict=True)},
        largest={
            n: max(float(np.max(np.abs(s.y[:, i]), initial=0.0)) for s in at.criterion.data)
            for i, n in enumerate(at.criterion.outputs)
        },
        window=(float(d.t[0]), float(d.t[-1])),
        longest_delay=float(min(PREWHITENING.longest_delay, PREWHITENING.delay_share * d.N * d.Ts)),
        Ts=min(s.Ts for s in at.criterion.data),
        channels={c: _spread(at, c) for c in recorded},
        ranges={
            n: (float(low), float(most))
            for n, low, most in zip(at.model.states, x.min(axis=0), x.max(axis=0), strict=True)
        },
        course=lambda expression: _course(at, [s.x for s in sims], expression),
    )


def _course(at: Weighted, states: Sequence[Array], expression: Any) -> Array:
    """An expression of states, inputs and parameters along the simulations."""
    e = at.model.explicit()
    function = ca.Function("course", [e.x, e.u, e.p], [ca.densify(expression)])
    parts = []
    for k, (x, d) in enumerate(zip(states, at.criterion.data, strict=True)):
        p, _ = at.criterion.parameter_vector(at.fit.x, k)
        n = min(len(x), d.N)
        values = function.map(n)(x[:n].T, d.u[:n].T, np.tile(np.asarray(p)[:, None], (1, n)))
        parts.append(values.full().ravel())
    return np.concatenate(parts)


def _spread(at: Weighted, channel: str) -> Spread:
    """Mean and range of a channel over the fitted records."""
    c = np.concatenate([e.record[channel] for e in at.criterion.experiments])
    return Spread(float(c.mean()), float(c.min()), float(c.max()))
