"""A ship's motion, simulated."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import casid
from casid.errors import DataError

from .equations import sample_step
from .hull import LOAD_CASES, Load, Ship
from .rudder import HeadingAutopilot, stuck_rudder
from .stability import require_stable, require_upright, require_way

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Start:
    """State at the first sample.

    u, v [m/s], p, r [rad/s], phi, psi, delta [rad], x, y [m], w_p [rad/s]; without w_p the
    propeller already turns as commanded.
    """

    u: float = 1.0
    v: float = 0.0
    p: float = 0.0
    r: float = 0.0
    phi: float = 0.0
    psi: float = 0.0
    delta: float = 0.0
    x: float = 0.0
    y: float = 0.0
    w_p: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A simulated motion; every array has N samples.

    Attributes
    ----------
    ship, load, Ts : what moved, and the sample time [s].
    states : (N, 10) x, y [m], phi, psi [rad], u, v [m/s], p, r [rad/s], delta [rad], w_p [rad/s].
    rates : (N, 8) time derivatives of the first eight.
    forces : (N, 4) external forces and torques in surge, sway, roll and yaw [N, N m].
    warnings : what should be known before the motion is used, such as a rudder at its limit.
    """

    ship: Ship
    load: Load
    Ts: float
    states: Array
    rates: Array
    forces: Array
    warnings: tuple[str, ...] = ()

    @property
    def t(self) -> Array:
        """(N,) time [s]."""
        return np.asarray(self.Ts * np.arange(self.states.shape[0]), dtype=np.float64)

    def __getitem__(self, name: str) -> Array:
        """(N,) a state by its name, or an acceleration: u_dot, v_dot, p_dot, r_dot."""
        if name in STATES:
            return np.asarray(self.states[:, STATES.index(name)])
        if name.endswith("_dot") and name[:-4] in STATES[:8]:
            return np.asarray(self.rates[:, STATES.index(name[:-4])])
        raise DataError(f"motion has no {name!r}. It has {', '.join(STATES)}, and x_dot to r_dot.")

    def __repr__(self) -> str:
        heel = math.degrees(float(np.max(np.abs(self["phi"]))))
        told = f"; {'; '.join(self.warnings)}" if self.warnings else ""
        return (
            f"<Motion of {len(self.states)} samples, {self.Ts * (len(self.states) - 1):g} s, "
            f"largest heel {heel:.3g} deg, surge {np.min(self['u']):.3g} to "
            f"{np.max(self['u']):.3g} m/s{told}>"
        )

    @property
    def end(self) -> Start:
        """The last sample's state, to go on from: the next stretch begins at this very sample."""
        return Start(**{n: float(a) for n, a in zip(STATES, self.states[-1], strict=True)})

    def energy(self) -> Array:
        """(N,) kinetic and potential energy [J]."""
        return self.ship.energy(self.states[:, 4:8], self.states[:, 2], self.load)

    def record(self, name: str = "ship") -> casid.Record:
        """The true states and accelerations, without a sensor between, as a record."""
        channels = {n: self[n] for n in STATES} | {f"{n}_dot": self[f"{n}_dot"] for n in "uvpr"}
        units = dict(zip(STATES, _UNITS, strict=True))
        units |= {"u_dot": "m/s^2", "v_dot": "m/s^2", "p_dot": "rad/s^2", "r_dot": "rad/s^2"}
        return casid.Record(
            channels,
            units,
            Ts=self.Ts,
            name=name,
            provenance=("true motion, simulated by problems/ship_4dof.py", *self.warnings),
        )


STATES = ("x", "y", "phi", "psi", "u", "v", "p", "r", "delta", "w_p")
_UNITS = ("m", "m", "rad", "rad", "m/s", "m/s", "rad/s", "rad/s", "rad", "rad/s")


def simulate(
    delta: ArrayLike,
    *,
    ship: Ship | None = None,
    load: Load = LOAD_CASES["nominal"],
    w_p: ArrayLike = 100.0,
    forces: ArrayLike | None = None,
    current: ArrayLike | None = None,
    start: Start | None = None,
    autopilot: HeadingAutopilot | None = None,
    course: ArrayLike = 0.0,
    Ts: float = 0.02,
    substeps: int = 10,
) -> Motion:
    """Simulate the ship.

    Parameters
    ----------
    delta : (N,) rudder command [rad]; with an autopilot, added to what that asks for.
    ship, load : the ship of Table 8.2 without load by default.
    w_p : (N,) or number, propeller command [rad/s].
    forces : (N, 4) waves, wind and other forces in surge, sway [N], roll and yaw [N m], about the
        CO, in the ship's axes; or (N, 4, terms) where they depend on the heading, by `by_heading`.
    current : (N, 2) velocity of the water, north and east [m/s].
    start : straight ahead at 1 m/s by default; `end` of a motion to go on with it, as long
        records are made of stretches.
    autopilot : holds the course, every Ts; none by default.
    course : (N,) or number, heading that the autopilot is to hold [rad].
    Ts : sample time [s].
    substeps : Runge-Kutta steps a sample.

    Raises
    ------
    DataError
        If an input has the wrong length or is not finite.
    SolveError
        If the load or the motion capsizes the ship, or if it loses its way: speed near zero.
    """
    ship, start = ship or Ship(), start or Start()
    command = _columns("delta", delta, None, 1)
    N = command.shape[0]
    speed = _columns("w_p", np.full(N, w_p) if np.ndim(w_p) == 0 else w_p, N, 1)
    heading = _columns("course", np.full(N, course) if np.ndim(course) == 0 else course, N, 1)
    if autopilot is None and heading.any():
        raise DataError("a course, and no autopilot to hold it. Give autopilot=HeadingAutopilot().")
    tau = np.zeros((N, 4)) if forces is None else _forces(forces, N)
    stream = np.zeros((N, 2)) if current is None else _columns("current", current, N, 2)
    if not (Ts > 0.0 and substeps >= 1):
        raise DataError(f"Ts = {Ts:g} s in {substeps} substeps. Give Ts > 0 and at least one.")
    require_way(ship, start.u, "at the start")
    steady = require_stable(ship, load)
    s, a = start, ship.propeller
    turning = float(np.clip(speed[0, 0], a.lowest, a.highest)) if s.w_p is None else s.w_p
    x0 = [s.x, s.y, s.phi, s.psi, s.u, s.v, s.p, s.r, s.delta, turning]
    outside = np.hstack([tau, stream])
    after = np.vstack([outside[1:], outside[-1:]])
    inputs = np.hstack([command, speed, heading, outside, after])
    terms = tau.shape[1] // 4
    made = _run((ship, load, float(Ts), int(substeps), autopilot, terms), x0, inputs)
    states, rates = made[:, :10], made[:, 10:]
    require_upright(states[:, 2], steady, load, Ts)
    slow = np.flatnonzero(states[:, 4] < ship.slowest)
    if slow.size:
        require_way(ship, float(states[slow[0], 4]), f"at t = {slow[0] * Ts:.2f} s")
    stuck = stuck_rudder(states[:, 8], (ship.rudder.lowest, ship.rudder.highest), Ts)
    acting = at_heading(tau.reshape(N, terms, 4).swapaxes(1, 2), states[:, 3])
    return Motion(ship, load, float(Ts), states, rates, acting, (stuck,) if stuck else ())


def by_heading(
    forces: Callable[[float], Array], *, course: float = 0.0, harmonics: int = 2
) -> Array:
    """Forces for every heading, as `simulate` takes them.

    Parameters
    ----------
    forces : gives (N, 4) forces in the ship's axes for a deviation from the course [rad], such as
        `lambda turn: sea.forces(t, turn=turn)`. They must be smooth in it, N samples of one sea.
    course : heading at which the deviation is zero [rad].
    harmonics : of the Fourier series. Two are exact for `ship_waves.WaveLoads`.

    Returns
    -------
    (N, 4, 2 harmonics + 1) mean, then cosine and sine part of each harmonic of the heading.
    """
    n = 2 * harmonics + 1
    psi = 2.0 * np.pi * np.arange(n) / n
    at = np.stack([np.asarray(forces(float(a - course)), dtype=np.float64) for a in psi], axis=2)
    basis = _harmonics(psi, n)
    return np.asarray(at @ (basis * np.where(np.arange(n) == 0, 1.0, 2.0) / n))


def at_heading(harmonics: Array, psi: Array) -> Array:
    """(N, 4) of (N, 4, terms) forces at the headings psi (N,) [rad]."""
    terms = harmonics.shape[2]
    return np.asarray(np.einsum("nit,nt->ni", harmonics, _harmonics(psi, terms)))


def _harmonics(psi: Array, terms: int) -> Array:
    """(N, terms) 1, cos psi, sin psi, cos 2 psi, ..."""
    columns = [np.ones_like(psi)]
    for h in range(1, (terms + 1) // 2):
        columns += [np.cos(h * psi), np.sin(h * psi)]
    return np.stack(columns, axis=1)


_Step = tuple[Ship, Load, float, int, HeadingAutopilot | None, int]  # of `sample_step`


@lru_cache(maxsize=32)
def _block(step: _Step, N: int) -> Any:
    return sample_step(*step).mapaccum(N)


def _run(step: _Step, x0: list[float], inputs: Array) -> Array:
    """(N, 18) states and rates at every sample; the columns of inputs are those of the step."""
    N, outside = inputs.shape[0], (inputs.shape[1] - 3) // 2
    size = min(N, 3000)  # long records in blocks of one function: it need not be built anew
    block, made, x = _block(step, size), np.empty((N, 18)), np.asarray(x0)
    for i in range(0, N, size):
        given = inputs[i : i + size]
        n = given.shape[0]
        given = np.vstack([given, np.repeat(given[-1:], size - n, axis=0)]).T
        later, rates = block(x, given[:3], given[3 : 3 + outside], given[3 + outside :])
        states = np.vstack([x, np.asarray(later).T])
        made[i : i + n, :10], made[i : i + n, 10:] = states[:n], np.asarray(rates).T[:n]
        x = states[n]
    return made


def _forces(values: ArrayLike, N: int) -> Array:
    """(N, 4 terms), term by term."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 3:
        return _columns("forces", values, N, 4)
    if array.shape[1] != 4 or array.shape[2] % 2 == 0:
        raise DataError(
            f"forces have shape {array.shape}. Give ({N}, 4), or what by_heading() makes of them."
        )
    flat = array.swapaxes(1, 2).reshape(array.shape[0], -1)
    return _columns("forces", flat, N, flat.shape[1])


def _columns(what: str, values: ArrayLike, N: int | None, width: int) -> Array:
    array = np.array(values, dtype=np.float64)
    if width == 1 and array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or array.shape[1] != width or (N is not None and array.shape[0] != N):
        wanted = f"({N if N is not None else 'N'}{'' if width == 1 else f', {width}'})"
        raise DataError(
            f"{what} has shape {np.shape(values)}. Give {wanted}: a row a sample of the rudder."
        )
    if array.shape[0] < 2:
        raise DataError(f"{what} has {array.shape[0]} samples. Give at least two.")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if bad.size:
        raise DataError(
            f"{what} is not finite in {bad.size} samples, the first k = {bad[0]}. "
            "Fill or cut them first."
        )
    return array
