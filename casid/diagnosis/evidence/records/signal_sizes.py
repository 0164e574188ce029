"""How large the signals of a fitted model are: what the catalogue scales its effects by."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.data.held_signals import is_held, is_switched
from casid.diagnosis.evidence.records.command_rates import command_rates
from casid.diagnosis.evidence.residual.bursts import burst_of
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.thresholds import PREWHITENING
from casid.estimation.noise.input_noise_floor import input_noise_floor
from casid.estimation.noise.variances import with_rounding
from casid.estimation.simulation.minimization import Fit
from casid.model.declarations import Hold
from casid.model.effects.effect import Motion, Sizes, Spread


def sizes_of(at: Weighted, recorded: Collection[str]) -> Sizes:
    """Sizes of states and outputs, and of the channels recorded beside the model's."""
    sims = [at.criterion.simulated(at.fit.x, e) for e in range(len(at.criterion.experiments))]
    x = np.concatenate([s.x for s in sims])
    readings = _readings(at)
    noise = _noise_of_inputs(at)
    rates = command_rates(at.model, at.criterion.data, noise)
    rms = np.sqrt(np.mean(x**2, axis=0))
    return Sizes(
        rates={n: float(r) for n, r in zip(at.model.states, rms, strict=True)},
        largest={
            n: max(float(np.max(np.abs(s.y[:, i]), initial=0.0)) for s in at.criterion.data)
            for i, n in enumerate(at.criterion.outputs)
        },
        window=window_of(at),
        longest_delay=_longest_delay(at, x),
        Ts=min(s.Ts for s in at.criterion.data),
        channels={c: _spread(at, c) for c in recorded},
        ranges={
            n: (float(low), float(most))
            for n, low, most in zip(at.model.states, x.min(axis=0), x.max(axis=0), strict=True)
        },
        readings={n: (m.low, m.high) for n, m in readings.items()},
        levels={n: m.operating_point for n, m in readings.items() if m.operating_point},
        noise=noise,
        events=burst_of(at)[:1],
        rates_felt={n: r.felt for n, r in rates.items()},
        largest_rates={n: r.largest for n, r in rates.items()},
        course=lambda expression: _course(at, [s.x for s in sims], expression),
    )


def _noise_of_inputs(at: Weighted) -> dict[str, float]:
    """A bound on the white noise of each input: of a known one that of its rounding.

    A known command acts as it was recorded. What is white in it, such as the noise of a sensor that
    a controller feeds back, acts too.
    """
    data, inputs = at.criterion.data, at.model.inputs
    measured = [name for name, entry in inputs.items() if entry.kind != "known"]
    floor, rounded = input_noise_floor(data, list(inputs)), with_rounding(data, {})
    return {name: floor[name] if name in measured else rounded.get(name, 0.0) for name in inputs}


def _longest_delay(at: Weighted, states: Array) -> float:
    """Longest delay that is sought [s]: some samples, or a time constant of the model.

    Transport and dead volume scale with the process. Time constants are those of the model
    linearised at its mean; those beyond the record's length are integrations.
    """
    d = at.criterion.data[0]
    e = at.model.explicit()
    slopes = ca.Function("A", [e.x, e.u, e.p], [ca.densify(ca.jacobian(e.f, e.x))])
    p, _ = at.criterion.parameter_vector(at.fit.x, 0)
    A = slopes(states.mean(axis=0), d.u.mean(axis=0), p).full()
    length = d.N * d.Ts
    slowest = 0.0
    if np.all(np.isfinite(A)):
        rates = np.abs(np.linalg.eigvals(A)) if A.size else np.zeros(0)
        slowest = max((1.0 / r for r in rates if r * length > 1.0), default=0.0)
    longest = max(PREWHITENING.delay_samples * d.Ts, slowest)
    return float(min(longest, PREWHITENING.delay_share * length))


def _readings(at: Weighted) -> dict[str, Motion]:
    """RMS, range and mean of every output and recorded input."""
    signals = at.criterion.data
    columns = {
        n: np.concatenate([s.y[s.used[:, i] > 0, i] for s in signals])
        for i, n in enumerate(at.criterion.outputs)
    }
    columns |= {
        n: np.concatenate([s.u[:, i] for s in signals])
        for i, (n, entry) in enumerate(at.model.inputs.items())
        if entry.kind in ("measured", "known")
    }
    return {
        n: Motion(float(np.sqrt(np.mean(c**2))), float(c.min()), float(c.max()), float(c.mean()))
        for n, c in columns.items()
        if c.size
    }


def window_of(at: Weighted | Fit) -> tuple[float, float]:
    """The earliest and the latest time of the fitted records [s], by their clocks."""
    data = at.criterion.data
    return min(float(d.t[0]) for d in data), max(float(d.t[-1]) for d in data)


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
    """Mean and range of a channel over the fitted records; it is held if it moves in steps."""
    c = np.concatenate([e.record[channel] for e in at.criterion.experiments])
    hold: Hold = "zoh" if is_switched(c) or is_held(c) else "foh"
    return Spread(float(c.mean()), float(c.min()), float(c.max()), hold)
