"""Effects that imitate the small misfit left by others, and are no causes beside them.

An error in stiffness or damping leaves a line in the spectrum of the residual at a resonance of the
model, where it shifts and stretches the motion; a third law of friction in one place corrects the
shape of two others.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.thresholds import FRICTION, PEAKS, ROUNDS
from casid.model.effects.effect import Effect
from casid.model.effects.places.places import place_named

FRICTIONS = (
    "coulomb_friction",
    "asymmetric_friction",
    "stribeck_friction",
    "quadratic_damping",
    "cubic_damping",
)
"""Kinds that are laws of friction or damping."""


def is_further_friction(effect: Effect, adopted: Sequence[Candidate]) -> bool:
    """True of a law of friction in a place where `ROUNDS.frictions` of them were adopted."""
    if effect.kind not in FRICTIONS:
        return False
    there = [c for c in adopted if c.effect.kind in FRICTIONS and c.effect.where == effect.where]
    return len(there) >= ROUNDS.frictions


def drives_one_way(effect: Effect, at: Weighted) -> bool:
    """True of dry friction that differs with direction, in a place that has no dry friction.

    F_c + F_a the one way and F_c - F_a the other resist both ways where |F_a| is below F_c. Alone
    it would drive the motion one way, like a constant term, from which it differs at rest alone.
    """
    if effect.kind != "asymmetric_friction" or not effect.constants:
        return False
    place = place_named(at.model, effect.where)
    row = place.shares[0][0]
    rate = at.model.balances[row].rate if row in at.model.balances else row
    e, v = at.model.explicit(), ca.SX(place.velocity)
    slope, wanted = ca.jacobian(v, e.x), ca.SX.sym("wanted")
    moved = e.x + slope.T * (wanted - v) / ca.sumsqr(slope)
    pushed = ca.substitute(e.f[e.states.index(rate)], e.x, moved)
    push = ca.Function("push", [wanted, e.x, e.u, e.p], [pushed])
    speed = ca.Function("v", [e.x, e.u, e.p], [v])
    d = at.criterion.data[0]
    x = at.criterion.simulated(at.fit.x, 0).x[: d.N].T
    u = d.u[: x.shape[1]].T
    p, _ = at.criterion.parameter_vector(at.fit.x, 0)
    rms = float(np.sqrt(np.mean(speed(x, u, p).full() ** 2)))

    def resistance(share: float) -> float:
        sides = [push(sign * share * rms, x, u, p).full() for sign in (1.0, -1.0)]
        return float(np.mean(sides[1] - sides[0]))

    near, far = (resistance(share) for share in FRICTION.speeds)
    # The resistance extrapolated to rest: zero if it is proportional to speed.
    return not 2.0 * near - far > FRICTION.share * abs(near)


def is_at_resonance(at: Weighted, frequency: float) -> bool:
    """True if a force of this frequency [Hz] acts near a resonance of the linearised model.

    Near: its gain to some output is at least `PEAKS.resonance` of the largest, in squares.
    """
    for d, r in zip(at.criterion.data, at.full.responses, strict=True):
        omega = 2 * np.pi * frequency * d.Ts
        for balance in at.model.balances:
            for gain2 in r.gain2[:, :, r.sources.index(balance)].T:
                top = int(np.argmax(gain2))
                # One that is largest at the lowest frequencies has no resonance, but a cut-off.
                is_peak = PEAKS.resonance * gain2[top] > gain2[0]
                near = float(np.interp(omega, r.omega, gain2)) >= PEAKS.resonance * gain2[top]
                if is_peak and near:
                    return True
    return False
