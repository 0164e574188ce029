"""How sharply dry friction reverses: the smoothing speed of candidates, chosen by their gain.

A smoothing as wide as the slow motion turns dry friction into viscous friction there, biases its
size, and leaves a misfit that other terms seem to explain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np
from scipy.optimize import minimize_scalar

from casid.arrays import TINY
from casid.diagnosis.evidence.prewhitening import Weighted
from casid.diagnosis.search.candidates import Candidate, name_of
from casid.diagnosis.search.joint_refit import Refitting
from casid.diagnosis.thresholds import COMPARISON, FRICTION
from casid.model.effects.balance_effects import coulomb_friction
from casid.model.effects.places import place_named


def sharpened(
    refitting: Refitting,
    at: Weighted,
    found: Sequence[Candidate],
    progress: Callable[[str], None],
) -> list[Candidate]:
    """Promising dry friction refitted with sharper reversals, as long as that explains more."""
    top = max(c.gain for c in found)
    return [
        refitting.attempts.attempt(
            f"the sharpness of {name_of(c.effect)}", partial(sharper, refitting, at, c, progress)
        )
        or c
        if c.effect.kind == "coulomb_friction" and c.gain > FRICTION.promising * top
        else c
        for c in found
    ]


def sharper(
    refitting: Refitting, at: Weighted, found: Candidate, progress: Callable[[str], None]
) -> Candidate:
    """Ever sharper while the gain rises clearly, then the best speed between the neighbours."""
    where, best = found.effect.where, found

    def gain_at(log_speed: float) -> float:
        nonlocal best
        effect = coulomb_friction(at.model, where, float(np.exp(log_speed)))
        again = refitting.again(at, replace(best, effect=effect))
        if again is None or not np.isfinite(again.gain):
            return -np.inf
        if again.fit.criterion.substeps > finer * found.fit.criterion.substeps:
            return -np.inf  # finer steps make every fit to come as many times slower
        if again.gain > best.gain:
            best = replace(again, score=found.score)
        return again.gain

    start, step = float(np.log(found.effect.constants["speed"])), float(np.log(FRICTION.narrower))
    finer = _finer(found)
    floor = float(np.log(_sharpest(found) / finer))
    if floor > start + step / 2:
        return found
    progress(f"choose the sharpness of {name_of(found.effect)}")
    reached, gain = start, found.gain
    for _ in range(FRICTION.steps):
        now = gain_at(max(reached + step, floor))
        if now <= gain + COMPARISON.strong:
            break
        reached, gain = max(reached + step, floor), now
        if reached == floor:
            break
    if reached == start:
        return best
    minimize_scalar(
        lambda x: min(-gain_at(x), TINY**-0.5),
        bounds=(max(reached + step, floor), reached - step),
        method="bounded",
        options={"maxiter": FRICTION.refits, "xatol": FRICTION.exact},
    )
    return best


def _finer(found: Candidate) -> int:
    """How many times finer steps the record is short enough for."""
    criterion = found.fit.criterion
    steps = criterion.substeps * sum(d.N for d in criterion.data)
    return int(np.clip(FRICTION.samples // steps, 1, FRICTION.finer))


def _sharpest(found: Candidate) -> float:
    """The smallest smoothing speed that the fixed steps of the integration resolve.

    About rest the friction is F_c v / v_0, a pole at -F_c / (J v_0) with J the inertia: a step h
    is stable while h F_c / (J v_0) is below 2.78 (Runge-Kutta of order four, on the real axis).
    """
    criterion, e = found.fit.criterion, found.model.explicit()
    F_c = found.model.symbol(found.names[0])
    velocity = place_named(found.model, found.effect.where).velocity
    direction = ca.jacobian(velocity, e.x)
    slope = ca.jacobian(direction @ e.f, F_c)
    of = ca.Function("slope", [e.x, e.u, e.p], [ca.densify(slope)])
    fastest = 0.0
    for k, d in enumerate(criterion.data):
        p, start = criterion.parameter_vector(found.fit.x, k)
        moving = np.array(direction.sparsity().get_col())
        x = np.array(start, dtype=float)
        x[moving] = 0.0
        x[moving[0]] = 1e3 * found.effect.constants["speed"]
        deceleration = abs(float(of(x, d.u.mean(axis=0), p))) * found.fit.values[found.names[0]]
        fastest = max(fastest, deceleration * d.Ts / criterion.substeps)
    return max(fastest / FRICTION.stable, TINY)
