"""The ship's own hidden effects, diagnosed: nonlinear damping, surge speed, a missing rudder term.

The nonlinear simulator with every nonlinear coefficient of the hull at zero but the one in
question; the restoring arm is a straight line. What `casid.diagnose` names is compared with what
is there.

The accelerometer is an input of the model, and its noise of 0.002 m/s^2 makes a coloured error of
0.0012 rad/s, against 0.00008 rad/s that the linear model itself misses by: what is named has to be
distinguished from that noise, and a ship that hides nothing has to be called adequate.

A speed log is recorded beside the model, which takes the speed as constant. Of the coefficients of
roll, K_r = (K_ur - K_vdot) u and d = -K_p - K_up u depend on it; k does where K_phiuu is not zero,
and it is zero here. The accelerometer takes v' + u r out of the model whatever u is.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

import casid
from analysis.ship_algorithm.records import THREE, TS, load
from analysis.ship_bias.records import SHIP, Rudder
from casid.arrays import Array
from casid.diagnosis.diagnosis import Diagnosis
from casid.estimation.estimate import Estimated
from problems import ship
from problems.ship_4dof import LOG_NOISE, PolynomialArm, Ship, simulate
from problems.ship_simulator.sensors import Channel, InertialUnit, for_roll, measure

Hidden = Literal["nothing", "damping", "speed", "rudder"]

_NONLINEAR = (
    "Y_vv Y_vr Y_rv Y_phiuv Y_phiur K_vv K_vr K_rv K_phiuv K_phiur K_pp "
    "N_rr N_rv N_phiuv N_phiur N_pp C1"
).split()
_FREE = replace(SHIP.coefficients, **dict.fromkeys(_NONLINEAR, 0.0))
_PLAIN = replace(_FREE, X_uu=50 * _FREE.X_uu, C3=50 * _FREE.C3)  # holds its speed in turns
_STRAIGHT = PolynomialArm(SHIP.arm.odd[:1] if isinstance(SHIP.arm, PolynomialArm) else ())

SHIPS: dict[Hidden, Ship] = {
    "nothing": replace(SHIP, coefficients=_PLAIN, arm=_STRAIGHT),
    "damping": replace(SHIP, coefficients=replace(_PLAIN, K_pp=-0.15, K_p=-0.08), arm=_STRAIGHT),
    "speed": replace(SHIP, coefficients=_FREE, arm=_STRAIGHT),
    "rudder": replace(SHIP, coefficients=_PLAIN, arm=_STRAIGHT),
}
"""What each ship hides; "rudder": it is the model that lacks it."""


SLOPE = _FREE.K_ur - _FREE.K_vdot
"""True change of K_r with the speed [N s^2/rad] (8.19)."""


RMSE = ("baseline_rmse", "extended_rmse")


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """A diagnosis, or why there is none, and how the surge speed moved [m/s]."""

    hidden: Hidden
    diagnosis: Diagnosis | None
    refusal: str
    speeds: tuple[float, float]

    @property
    def named(self) -> tuple[tuple[str, str], ...]:
        """(kind, where) of every cause named."""
        return tuple((c.kind, c.where) for c in self.diagnosis.causes) if self.diagnosis else ()

    @property
    def reported(self) -> set[tuple[str, str]]:
        """Causes and what is indistinguishable from them."""
        if self.diagnosis is None:
            return set()
        alternatives = [(a.kind, a.where) for c in self.diagnosis.causes for a in c.alternatives]
        return {*self.named, *alternatives}

    def rmse(self, which: str) -> float:
        """rms error of the roll rate held out [rad/s]; nan where there is none."""
        table = self.diagnosis.held_out.get(which, {}) if self.diagnosis else {}
        return table.get("gyro", float("nan"))

    @property
    def slope(self) -> Estimated | None:
        """Of K_r with the speed, where that is named first."""
        first = self.diagnosis.causes[:1] if self.diagnosis else ()
        is_it = self.named[:1] == (("scheduled_parameter", "K_r~speed"),)
        return first[0].parameters[0] if is_it else None

    def __str__(self) -> str:
        if self.diagnosis is None:
            return f"{self.hidden}: {self.refusal}"
        names = ", ".join(f"{k} in {w}" for k, w in self.named) or "nothing"
        slope = self.slope
        beside = ", ".join(f"{k} in {w}" for k, w in sorted(self.reported - set(self.named)))
        return (
            f"{self.hidden}: {self.diagnosis.verdict}; named: {names}; indistinguishable: "
            f"{beside or 'nothing'}; held out {self.rmse('baseline_rmse'):.3g} -> "
            f"{self.rmse('extended_rmse'):.3g} rad/s, noise {self.rmse('noise_floor'):.3g}; "
            + (f"slope {slope.value:.3f} +- {slope.std_error:.3f}; " if slope else "")
            + f"surge {self.speeds[0]:.2f} to {self.speeds[1]:.2f} m/s; "
            f"m = {self.diagnosis.baseline['m']:.3f}"
            + (f" -> {self.diagnosis.extended['m']:.3f} kg" if self.diagnosis.extended else " kg")
        )


def problem_of(hidden: Hidden) -> casid.Problem:
    """The linear problem; for "rudder" without its direct term, the angle recorded beside it.

    K_vdot may be negative there. With the rudder's moment missing the best fit has K_vdot = -0.23
    kg m, at the end of a valley so flat that the sum of squares is 0.4 % larger at the bound of
    zero; Ipopt comes to rest before that bound, and `diagnose` refuses a fit without an optimum.
    """
    start = dict(ship.problem.truth)
    if hidden == "rudder":
        del start["K_delta"]
    model = ship.problem.model.with_unknown(**start)
    if hidden != "rudder":
        return dataclasses.replace(ship.problem, model=model, recorded={"speed": "m/s"})
    model = model.copy("roll without the rudder's moment")
    model.parameters["K_vdot"] = replace(model.parameters["K_vdot"], lower=-2.0, upper=2.0)
    model.substitute_symbol("delta", 0.0)
    del model.inputs["delta"]
    channels = {k: v for k, v in ship.problem.channels.items() if k != "delta"}
    return dataclasses.replace(
        ship.problem,
        name="ship without rudder term",
        noise={},
        model=model.with_known(K_delta=0.0),
        channels=channels,
        recorded={"rudder": "rad", "speed": "m/s"},
        truth={},
    )


def speed_log(u: Array, rng: np.random.Generator) -> Array:
    """(N,) surge speed, noise of 0.005 m/s a sample, averaged over one second about each.

    The log enters as a known signal, and noise on it makes slopes too small. Not averaged it moves
    the gyro, through the slope of K_r times r, as much as the speed's own change: that slope is
    then estimated at half its size.
    """
    noisy = u + LOG_NOISE * rng.standard_normal(len(u))
    reach = round(0.5 / TS)
    window = np.ones(2 * reach + 1) / (2 * reach + 1)
    return np.asarray(np.convolve(np.pad(noisy, reach, mode="edge"), window, mode="valid"))


def records(
    hidden: Hidden, *, seconds: float, seed: int, angle: float
) -> tuple[list[casid.Experiment], tuple[float, float]]:
    """Measured records of the three load cases, and the lowest and highest surge speed."""
    made, speeds = [], []
    unit = InertialUnit(
        gyro=Channel(noise=2e-4), accel=Channel(noise=2e-3), yaw_gyro=Channel(noise=2e-4)
    )
    for i, case in enumerate(THREE):
        rng, before = np.random.default_rng((seed, i)), 500
        command = Rudder(angle, 0.0, 1.5).draw(round(seconds / TS) + before, rng)
        motion = simulate(command, ship=SHIPS[hidden], load=load(case), substeps=5)
        record = for_roll(measure(motion, unit, seed=seed + i, name=case))
        log = speed_log(motion["u"], np.random.default_rng((seed, i, 1)))
        record = record.with_channel("speed", log, "m/s")
        record = record.between(before * TS, float(record.t[-1]))
        if hidden == "rudder":  # beside the model, under a name that it has not used
            record = record.with_channel("rudder", record["delta"], "rad").without("delta")
        speeds.append(motion["u"][before:])
        made.append(casid.Experiment(record, ship.LOAD_CASES[case], case))
    u = np.concatenate(speeds)
    return made, (float(u.min()), float(u.max()))


def diagnosed(hidden: Hidden, *, seconds: float = 40.0, seed: int = 0, angle: float = 0.2) -> Found:
    """Simulate, fit and diagnose."""
    made, speeds = records(hidden, seconds=seconds, seed=seed, angle=angle)
    try:
        found = casid.diagnose(problem_of(hidden), made, starts=1, max_causes=2)
    except casid.CasidError as error:
        return Found(hidden, None, f"{type(error).__name__}: {error}", speeds)
    return Found(hidden, found, "", speeds)
