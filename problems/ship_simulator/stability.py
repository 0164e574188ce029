"""Whether a ship stays upright with a load, and has way: conditions of a simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from casid.errors import SolveError

from .hull import LOAD_CASES, Load, Ship

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Stability:
    """Of the ship at rest.

    Attributes
    ----------
    GM : metacentric height, the slope of GZ at zero heel [m].
    rests : stable heels [rad]; one near zero, or two of loll, or none.
    vanishing : heels to port and to starboard beyond which the ship capsizes [rad]; the arm's
        reach where GZ does not vanish before. (nan, nan) if it rests nowhere.
    """

    GM: float
    rests: tuple[float, ...]
    vanishing: tuple[float, float]


@lru_cache(maxsize=64)
def stability(ship: Ship, load: Load = LOAD_CASES["nominal"]) -> Stability:
    """Where the ship rests with a load, and how far it may heel."""
    reach, (mass, _, _, S_z) = ship.arm.reach, ship.moments(load)
    GM = (ship.M * ship.arm.slope + S_z) / mass
    heel = np.linspace(-reach, reach, 4000)  # even: zero heel is between two points
    torque = np.asarray(ship.restoring(heel, load), dtype=np.float64)

    def root(i: int) -> float:
        a, b = float(heel[i]), float(heel[i + 1])
        for _ in range(60):
            middle = 0.5 * (a + b)
            same = (float(ship.restoring(middle, load)) > 0.0) == (torque[i] > 0.0)
            a, b = (middle, b) if same else (a, middle)
        return 0.5 * (a + b)

    positive = torque > 0.0
    upward = [root(int(i)) for i in np.flatnonzero(~positive[:-1] & positive[1:])]
    downward = [root(int(i)) for i in np.flatnonzero(positive[:-1] & ~positive[1:])]
    if not upward:
        return Stability(GM, (), (math.nan, math.nan))
    port = max((a for a in downward if a < min(upward)), default=-reach)
    starboard = min((a for a in downward if a > max(upward)), default=reach)
    return Stability(GM, tuple(upward), (port, starboard))


def require_stable(ship: Ship, load: Load) -> Stability:
    """Stability of a ship that stands upright.

    Raises
    ------
    SolveError
        If the load capsizes it or makes it loll; the message gives the angle.
    """
    found = stability(ship, load)
    if found.GM > 0.0 and found.rests:
        return found
    z_m, own = ship.z_m(load), ship.M * (ship.arm.slope + ship.z_g)
    most = -own / z_m if z_m < 0.0 and load.y_m == 0.0 and own > 0.0 else None
    angles = ", ".join(f"{math.degrees(a):.1f}" for a in found.rests)
    none = f"no heel up to {math.degrees(ship.arm.reach):.0f} deg is one of rest"
    fate = f"it lolls to {angles} deg" if found.rests else f"it capsizes: {none}"
    raise SolveError(
        f"ship: with {load.m:g} kg at zbar_m = {load.zbar_m:g} m, y_m = {load.y_m:g} m "
        f"GM = {1e3 * found.GM:.1f} mm and {fate}. Carry it lower or nearer the centre line"
        + (f", or carry less than {most:.2f} kg there." if most is not None else ", or carry less.")
    )


def require_way(ship: Ship, u: float, when: str) -> None:
    """Refuse a surge speed u [m/s] below the slowest that the model holds for; SolveError."""
    if not abs(u) < math.inf or u < ship.slowest:
        raise SolveError(
            f"ship: surge speed {u:.3f} m/s {when}, below {ship.slowest:g} m/s: the series (A.36) "
            "is one for headway, and rudder, damping and K_r vanish with the speed. "
            "Start faster, turn the propeller faster, or use less rudder or drift force."
        )


def require_upright(phi: Array, steady: Stability, load: Load, Ts: float) -> None:
    """Refuse heel angles phi (N,) [rad] beyond the range of stability; SolveError."""
    port, starboard = steady.vanishing
    over = np.flatnonzero(~((phi > port) & (phi < starboard)))
    if over.size:
        k = int(over[0])
        angle = math.degrees(phi[k]) if np.isfinite(phi[k]) else math.inf
        raise SolveError(
            f"ship: capsizes at t = {k * Ts:.2f} s, heel {angle:.1f} deg; with "
            f"{load.m:g} kg at zbar_m = {load.zbar_m:g} m its righting arm vanishes, "
            f"or its table ends, at "
            f"{math.degrees(port):.1f} and {math.degrees(starboard):.1f} deg "
            f"(GM = {1e3 * steady.GM:.1f} mm). Carry less weight or carry it lower, "
            "or use less rudder and smaller waves."
        )
