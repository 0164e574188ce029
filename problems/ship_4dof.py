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
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING or __package__:
    from problems.ship_arm import PolynomialArm, TabulatedArm
    from problems.ship_equations import dynamics, hydrodynamics, rotation, sample_step
    from problems.ship_hull import LOAD_CASES, Actuator, Coefficients, Load, Ship
    from problems.ship_linear import Linear, linearised, tangent
    from problems.ship_motion import STATES, Motion, Start, simulate
    from problems.ship_rudder import random_steps, stuck_rudder, zigzag
    from problems.ship_stability import Stability, require_stable, stability
else:  # loaded by its path
    from ship_arm import PolynomialArm, TabulatedArm
    from ship_equations import dynamics, hydrodynamics, rotation, sample_step
    from ship_hull import LOAD_CASES, Actuator, Coefficients, Load, Ship
    from ship_linear import Linear, linearised, tangent
    from ship_motion import STATES, Motion, Start, simulate
    from ship_rudder import random_steps, stuck_rudder, zigzag
    from ship_stability import Stability, require_stable, stability

__all__ = [
    "Actuator",
    "Coefficients",
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
