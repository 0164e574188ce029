"""A ship in surge, sway, roll and yaw: nonlinear manoeuvring, simulated by a compiled function.

Linder (2017), Indirect System Identification for Unknown Input Problems, Appendix A.5. With
eta = [x y phi psi] and nu = [u v p r] (no pitch, no heave),

    eta' = J(eta) nu,    M nu' = -C_RB(nu) nu + f(phi, nu) - g(phi) + R(delta, w_p) + tau    (A.39)

Axes point to the bow, to starboard and down; the origin CO is where the axis of roll, the centre of
rotation CR, is. Heights with a bar are measured from a mark on the hull, whose own height over the
CR is z_f: z_g = zbar_g + z_f, z_m = zbar_m + z_f (8.21). Positive rudder turns the ship to port.

Conventions beyond the thesis:

- The hull's part of the restoring torque does not depend on the load (section 8.1): it is
  M g arm(phi), arm the cross curve about the CO, and the weights take M_t g times theirs from it:
  M_t g GZ(phi) = M g arm(phi) + S g sin(phi) - S_y g cos(phi), S = M z_g + m z_m,
  S_y = M y_g + m y_m, M_t = M + m.
- A load is a point: it adds m (y_m^2 + z_m^2) to the inertia in roll and m y_m^2 to that in yaw.
- u and v are velocities through the water. A current that is constant in space and changes slowly
  carries the whole motion along (Fossen 2011, Handbook of Marine Craft, property 8.1): it enters
  eta' alone.
- Rudder and propeller follow their commands at a limited rate; between samples they move along
  straight lines, and so do the forces and the current.

Printed terms that are repaired: the rudder's drag is C1 |delta|, N_phi|uv| stands once, and the
yaw damping is N_|u|r |u| r. Terms of f are added, so a coefficient that damps is negative.

The parts lie in `ship_simulator/`: the ship in `hull` and `arm`; her equations in `equations`;
whether she is stable upright in `stability`; the rudder in `rudder`; the simulation in `motion`;
linear models in `linear`. All their names are here too.

`problem` is the same ship to be identified, from three records of an inertial unit and a log: the
model, in `ship_simulator/manoeuvring`, is written by itself, and has every term of (A.36). Sixteen
of its coefficients are sought. The others are taken as known, since records of rudder steps
determine them badly or not at all: heels of 2 deg do not excite terms that are cubic in phi or
multiply phi, and the propeller is taken to be known from a bollard pull.

    casid identify problems/ship_4dof.py
    casid identifiability problems/ship_4dof.py
    casid diagnose problems/ship_4dof.py --set N_rr=0
"""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

import casid

if TYPE_CHECKING or __package__:
    from problems.ship_simulator.arm import PolynomialArm, TabulatedArm
    from problems.ship_simulator.equations import dynamics, hydrodynamics, rotation, sample_step
    from problems.ship_simulator.hull import LOAD_CASES, Actuator, Coefficients, Load, Ship
    from problems.ship_simulator.linear import Linear, linearised, tangent
    from problems.ship_simulator.manoeuvring import manoeuvring_model
    from problems.ship_simulator.motion import STATES, Motion, Start, by_heading, simulate
    from problems.ship_simulator.rudder import HeadingAutopilot, random_steps, stuck_rudder, zigzag
    from problems.ship_simulator.sensors import InertialUnit, measure
    from problems.ship_simulator.stability import Stability, require_stable, stability
else:  # loaded by its path
    from ship_simulator.arm import PolynomialArm, TabulatedArm
    from ship_simulator.equations import dynamics, hydrodynamics, rotation, sample_step
    from ship_simulator.hull import LOAD_CASES, Actuator, Coefficients, Load, Ship
    from ship_simulator.linear import Linear, linearised, tangent
    from ship_simulator.manoeuvring import manoeuvring_model
    from ship_simulator.motion import STATES, Motion, Start, by_heading, simulate
    from ship_simulator.rudder import HeadingAutopilot, random_steps, stuck_rudder, zigzag
    from ship_simulator.sensors import InertialUnit, measure
    from ship_simulator.stability import Stability, require_stable, stability

__all__ = [
    "Actuator",
    "Coefficients",
    "HeadingAutopilot",
    "LOAD_CASES",
    "Linear",
    "Load",
    "Motion",
    "PolynomialArm",
    "STATES",
    "Ship",
    "Stability",
    "Start",
    "TabulatedArm",
    "by_heading",
    "dynamics",
    "hydrodynamics",
    "linearised",
    "random_steps",
    "require_stable",
    "rotation",
    "sample_step",
    "simulate",
    "stability",
    "stuck_rudder",
    "tangent",
    "zigzag",
]


SOUGHT = {
    "X_uu": (-2.5, -6.0, -0.3),
    "C1": (0.4, 0.0, 3.0),
    "Y_vdot": (-60.0, -250.0, -20.0),
    "Y_uv": (-50.0, -150.0, -5.0),
    "Y_vv": (-70.0, -400.0, 0.0),
    "Y_vr": (-20.0, -150.0, 50.0),
    "C2": (2.5, 1.0, 10.0),
    "k": (8.0, 6.5, 30.0),
    "A_x": (0.18, 0.08, 0.5),
    "K_vdot": (0.3, -1.0, 1.0),
    "K_ur": (-0.2, -2.0, 2.0),
    "K_p": (-0.2, -1.0, 0.0),
    "A_z": (0.6, 0.2, 2.0),
    "N_ur": (-1.0, -5.0, -0.3),
    "N_rr": (-1.0, -8.0, 0.0),
    "N_rv": (-2.0, -16.0, 0.0),
}
"""What is sought: start, lower and upper bound, SI units."""

RUNS = (("nominal", 10.0, 70.0), ("nominal", 35.0, 150.0), ("calibration", 20.0, 100.0))
"""Load case, largest rudder angle [deg] and propeller [rad/s] of each record of the example."""

LOG_NOISE = 0.005
"""Standard deviation of the speed that is logged [m/s]."""


def true_values() -> dict[str, float]:
    """What the default ship has, by the names of the model, without load."""
    ship = Ship()
    names = ("M", "zbar_g", "x_g", "y_g", "z_f", "g", "A_x", "A_z")
    assert isinstance(ship.arm, PolynomialArm)
    arm = zip(("k", "k_3", "k_5"), ship.arm.odd, strict=True)
    torque = {name: ship.M * ship.g * c for name, c in arm}
    return (
        asdict(ship.coefficients)
        | {name: getattr(ship, name) for name in names}
        | torque
        | {"zbar_s": InertialUnit().zbar_s}
        | asdict(Load())
    )


def experiments(*, duration: float = 30.0, seed: int = 1) -> list[casid.Experiment]:
    """The records of `RUNS` at 20 Hz, from the simulator: rudder steps held for 1.5 s on average.

    Parameters
    ----------
    duration : of each record [s].
    seed : of the sensors' noise; the rudder does the same for every seed.
    """
    made: list[casid.Experiment] = []
    for i, (case, angle, w_p) in enumerate(RUNS):
        load, Ts = LOAD_CASES[case], 0.05
        rudder = random_steps(duration, angle=math.radians(angle), hold=1.5, seed=10 + i, Ts=Ts)
        # begun at the speed that thrust and resistance balance at
        motion = simulate(rudder, load=load, w_p=w_p, start=Start(u=w_p / 100.0), Ts=Ts)
        noise, log = np.random.SeedSequence((seed, i)).generate_state(2)
        record = measure(motion, seed=int(noise), name=f"{case} {w_p:g} rad_s")
        error = LOG_NOISE * np.random.default_rng(int(log)).standard_normal(record.N)
        record = record.with_channel("speed", motion["u"] + error, "m/s")
        record = record.with_channel("w_p", motion["w_p"], "rad/s")
        known = {"m": load.m} if load.m == 0.0 else {"m": load.m, "zbar_m": load.zbar_m}
        made.append(casid.Experiment(record, known, case))
    return made


def draw(seed: int) -> list[casid.Experiment]:
    """The same records, noise drawn from `seed`."""
    return experiments(seed=seed)


def problem_of(*names: str, **known: float) -> casid.Problem:
    """The problem with only these of `SOUGHT` unknown, and all others constants.

    `known` are values other than the true ones, such as a term that is left out: N_rr=0.
    """
    values = true_values()
    return casid.Problem(
        name="ship_4dof",
        model=manoeuvring_model(values | known, {name: SOUGHT[name] for name in names}),
        load_cases={
            case: {"m": load.m, "zbar_m": load.zbar_m} for case, load in LOAD_CASES.items()
        },
        noise={"gyro": 0.002, "accel": 0.02, "yaw_gyro": 0.002, "speed": LOG_NOISE},
        time="t",
        example=experiments,
        simulate=draw,
        truth={name: values[name] for name in names},
        description="Surge, sway, roll and yaw of a model ship, from an inertial unit and a log.",
        references=(
            "J. Linder, Indirect System Identification for Unknown Input Problems, 2017, app. A",
        ),
    )


problem = problem_of(*SOUGHT)
