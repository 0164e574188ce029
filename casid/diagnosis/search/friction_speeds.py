"""How sharply dry friction reverses: the smoothing speed of candidates, chosen by their gain.

A smoothing as wide as the slow motion turns dry friction into viscous friction there, biases its
size, and leaves a misfit that other terms seem to explain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from casid.arrays import TINY
from casid.diagnosis.evidence.prewhitening import Weighted
from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.search.joint_refit import Refitting
from casid.diagnosis.thresholds import COMPARISON, FRICTION
from casid.model.effects.balance_effects import coulomb_friction


def sharpened(
    refitting: Refitting,
    at: Weighted,
    found: Sequence[Candidate],
    progress: Callable[[str], None],
) -> list[Candidate]:
    """Promising dry friction refitted with sharper reversals, as long as that explains more."""
    top = max(c.gain for c in found)
    return [
        _sharpened(refitting, at, c, progress)
        if c.effect.kind == "coulomb_friction" and c.gain > FRICTION.promising * top
        else c
        for c in found
    ]


def _sharpened(
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
        if again.gain > best.gain:
            best = replace(again, score=found.score)
        return again.gain

    progress(f"choose how sharply the {found.effect.kind} in {where} reverses")
    start, step = float(np.log(found.effect.constants["speed"])), float(np.log(FRICTION.narrower))
    reached, gain = start, found.gain
    for _ in range(FRICTION.steps):
        now = gain_at(reached + step)
        if now <= gain + COMPARISON.strong:
            break
        reached, gain = reached + step, now
    if reached == start:
        return best
    minimize_scalar(
        lambda x: min(-gain_at(x), TINY**-0.5),
        bounds=(reached + step, reached - step),
        method="bounded",
        options={"maxiter": FRICTION.refits, "xatol": FRICTION.exact},
    )
    return best
