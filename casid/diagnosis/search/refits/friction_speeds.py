"""How sharply dry friction reverses: the smoothing speed of candidates, chosen by their gain.

A smoothing as wide as the slow motion turns dry friction into viscous friction there, biases its
size, and leaves a misfit that other terms seem to explain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import casadi as ca
import numpy as np
from scipy.optimize import minimize_scalar

from casid.arrays import TINY
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate, name_of
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.diagnosis.thresholds import COMPARISON, FRICTION
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.balances.balance_effects import coulomb_friction
from casid.model.effects.places.places import place_named


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
            f"how sharply {name_of(c.effect)} reverses",
            partial(sharper, refitting, at, c, progress),
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
        """The gain at a smoothing speed, whose refit is kept if it is the best so far."""
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
    progress(f"choose how sharply {name_of(found.effect)} reverses")
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
    """Factor by which integration steps can be finer in a record of this length."""
    criterion = found.fit.criterion
    steps = criterion.substeps * sum(d.N for d in criterion.data)
    return int(np.clip(FRICTION.samples // steps, 1, FRICTION.finer))


@dataclass(frozen=True, slots=True, eq=False)
class Likeliest:
    """The likeliest smoothing speed.

    Attributes
    ----------
    doublings : base-two logarithm of it, in units of the one before.
    rounding : variable -> what a standard deviation of the speed moves its estimate by.
    """

    doublings: float
    fit: Fit
    rounding: dict[str, float]


def likeliest_speed(doubled: Callable[[float, Fit], Fit | None], near: Fit) -> Likeliest | None:
    """Half the speed, or twice, and so on while the likelihood rises clearly; then between them.

    There it is sought by parabolas through three speeds, until one rises no more: the likelihood of
    a long record falls off so fast that one through halves and doubles misses its top.

    Parameters
    ----------
    doubled : the fit with the speed doubled so many times, from another fit; None where it would
        take too many steps.
    """
    first = doubled(0.0, near)
    if first is None:
        return None
    fits, k = {0.0: first}, 0.0
    for step in (-1.0, 1.0):
        while k + step not in fits and abs(k + step) <= FRICTION.doublings:
            tried = doubled(k + step, fits[k])
            if tried is None:
                break
            fits[k + step] = tried
            if _rise(fits[k], tried) < FRICTION.clearly:
                break
            k += step
    for _ in range(FRICTION.refits):
        vertex = _vertex(fits, k)
        if vertex is None or vertex in fits:
            break
        middle = doubled(vertex, fits[k])
        if middle is None or _rise(fits[k], middle) < -FRICTION.clearly:
            break
        fits[vertex] = middle
        is_top, k = _rise(fits[k], middle) < FRICTION.clearly, vertex
        if is_top:
            break
    return Likeliest(k, fits[k], _rounding_beside(fits, k))


def _rounding_beside(fits: Mapping[float, Fit], k: float) -> dict[str, float]:
    """(see `_of_rounding`) by the nearest fit, a sharper one if any, that is clearly less likely.

    A fit next to the best one tells nothing of how fast the likelihood falls. Where none is less
    likely, the sharpest one, or the bluntest.
    """
    sides = [
        sorted((j for j in fits if j < k), reverse=True),
        sorted(j for j in fits if j > k),
    ]
    for side in sides:
        for j in side:
            if _rise(fits[k], fits[j]) < -FRICTION.clearly:
                return _of_rounding(fits[k], fits[j], -_rise(fits[k], fits[j]))
    for side in sides:
        if side:
            other = fits[side[-1]]
            return _of_rounding(fits[k], other, -_rise(fits[k], other))
    return {}


def _beside(fits: Mapping[float, Fit], k: float) -> tuple[float | None, float | None]:
    """The next smaller speed that was fitted, and the next larger one, in doublings."""
    below, above = [j for j in fits if j < k], [j for j in fits if j > k]
    return max(below, default=None), min(above, default=None)


def _vertex(fits: Mapping[float, Fit], k: float) -> float | None:
    """Where the parabola through the likelihoods of a speed and of those beside it has its top.

    Between those two; None where one is missing, or the parabola has no top.
    """
    left, right = _beside(fits, k)
    if left is None or right is None:
        return None
    a, b = k - left, right - k
    falls = [-_rise(fits[k], fits[j]) for j in (left, right)]
    bend = falls[0] * b + falls[1] * a
    if bend <= 0.0:
        return None
    move = (falls[0] * b**2 - falls[1] * a**2) / (2 * bend)
    return k + float(np.clip(move, -a, b))


def _rise(old: Fit, new: Fit) -> float:
    """By how much the logarithm of the likelihood rises, for white noise of unknown size."""
    ratio = old.solution.value / max(new.solution.value, TINY)
    return 0.5 * new.criterion.n_samples * float(np.log(max(ratio, TINY)))


def _of_rounding(fit: Fit, other: Fit, fall: float) -> dict[str, float]:
    """Change of the estimates with one standard deviation of the smoothing speed.

    By how much half or twice the speed moves them: the estimates are linear in the speed. Where the
    likelihood falls, the logarithm of the speed is as uncertain as that says; where it does not,
    any speed between nothing and this one is as good (Pawitan 2001, section 3.4).
    """
    known_to = min(1 / max(2 * fall, TINY), 4 / 3)
    return {
        name: float(np.sqrt(known_to)) * (other.values[name] - value)
        for name, value in fit.values.items()
        if name in other.values
    }


def steps_needed(found: Candidate, speed: float) -> int:
    """Steps a sample that follow a reversal within a smoothing speed."""
    return math.ceil(found.fit.criterion.substeps * _sharpest(found) / speed)


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
