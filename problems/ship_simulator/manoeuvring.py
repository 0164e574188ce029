"""The manoeuvring ship as a model to be identified: (A.31)-(A.40), written down once.

Nothing is taken over from the simulator, `ship_equations`, which makes the example's records: the
two are compared by a test. The heading is left out, as no force and no output depends on it.

Units are SI; names are those of `ship_hull.Coefficients` and `ship_hull.Ship`. The hull's part of
the restoring torque is k phi + k_3 phi^3 + k_5 phi^5, of which the weights take theirs.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import casadi as ca

import casid

COEFFICIENTS = {
    # added mass (A.35)
    **{"X_udot": "kg", "Y_vdot": "kg", "Y_pdot": "kg m", "Y_rdot": "kg m", "K_vdot": "kg m"},
    **{"K_rdot": "kg m^2", "N_vdot": "kg m", "N_pdot": "kg m^2"},
    # surge, sway, roll, yaw (A.36)
    **{"X_uu": "kg/m", "Y_uv": "kg/m", "Y_ur": "kg", "Y_vv": "kg/m", "Y_vr": "kg", "Y_rv": "kg"},
    **{"Y_phiuv": "kg/m", "Y_phiur": "kg", "Y_phiuu": "kg/m"},
    **{"K_uv": "kg", "K_ur": "kg m", "K_vv": "kg", "K_vr": "kg m", "K_rv": "kg m"},
    **{"K_phiuv": "kg", "K_phiur": "kg m", "K_phiuu": "kg", "K_phiphiphi": "N m/rad^3"},
    **{"K_up": "kg m", "K_pp": "kg m^2", "K_p": "N m s/rad"},
    **{"N_uv": "kg", "N_ur": "kg m", "N_rr": "kg m^2", "N_rv": "kg m"},
    **{"N_phiuv": "kg", "N_phiur": "kg m", "N_phiuu": "kg"},
    **{"N_p": "N m s/rad", "N_pp": "kg m^2", "N_up": "kg m"},
    # rudder and propeller (A.38)
    **{"C1": "N/rad", "C2": "N/rad", "z_r": "m", "x_r": "m", "C3": "N s/rad"},
}
"""Hydrodynamic derivatives, rudder and propeller, with their units."""

BODY = {
    **{"M": "kg", "zbar_g": "m", "x_g": "m", "y_g": "m", "z_f": "m", "g": "m/s^2"},
    **{"A_x": "kg m^2", "A_z": "kg m^2", "zbar_s": "m"},
    **{"k": "N m/rad", "k_3": "N m/rad^3", "k_5": "N m/rad^5"},
    **{"m": "kg", "zbar_m": "m", "y_m": "m"},
}
"""Masses, places, inertias, the hull's restoring torque, and the load."""


def manoeuvring_model(
    values: Mapping[str, float], sought: Mapping[str, tuple[float, float, float]]
) -> casid.Model:
    """The ship of (A.39) with an inertial unit in line with its axes and a log of its speed.

    Parameters
    ----------
    values : of every name of `COEFFICIENTS` and `BODY` that is known.
    sought : start, lower and upper bound of those to be estimated.

    Returns
    -------
    Model with inputs delta [rad] and w_p [rad/s], and outputs gyro (p) and yaw_gyro (-r) [rad/s],
    accel (to port) [m/s^2] and speed (u) [m/s].
    """
    m = casid.Model("ship in surge, sway, roll and yaw")
    u, v = m.state("u", "m/s", start=1.0), m.state("v", "m/s")
    p, r, phi = m.state("p", "rad/s"), m.state("r", "rad/s"), m.state("phi", "rad")
    delta, w_p = m.input("delta", "rad", known=True), m.input("w_p", "rad/s", known=True)
    c = _declared(m, values, sought)
    hull = _hull_forces(c, u, v, p, r, phi)
    z_g, z_m = c.zbar_g + c.z_f, c.zbar_m + c.z_f
    mass, S_x = c.M + c.m, c.M * c.x_g
    S_y, S_z = c.M * c.y_g + c.m * c.y_m, c.M * z_g + c.m * z_m
    A_x = c.A_x + c.M * (c.y_g**2 + z_g**2) + c.m * (c.y_m**2 + z_m**2)
    A_z = c.A_z + c.M * (c.x_g**2 + c.y_g**2) + c.m * c.y_m**2
    m.derivative(phi, p)
    m.balance(
        u,
        "surge",
        inertia=mass - c.X_udot,
        terms=[
            S_y * m.der(r),
            mass * v * r - S_z * p * r + S_x * r**2,
            *hull["surge"],
            c.C3 * w_p,
            -c.C1 * ca.fabs(delta),
        ],
    )
    m.balance(
        v,
        "sway",
        inertia=mass - c.Y_vdot,
        terms=[
            (S_z + c.Y_pdot) * m.der(p) + (c.Y_rdot - S_x) * m.der(r),
            -mass * u * r + S_y * (p**2 + r**2),
            *hull["sway"],
            c.C2 * delta,
        ],
    )
    m.balance(
        p,
        "roll",
        inertia=A_x,
        terms=[
            (S_z + c.K_vdot) * m.der(v) + c.K_rdot * m.der(r),
            S_z * u * r - S_y * v * p,
            -(c.k * phi + c.k_3 * phi**3 + c.k_5 * phi**5),
            -c.g * (S_z * ca.sin(phi) - S_y * ca.cos(phi)),
            *hull["roll"],
            -c.z_r * c.C2 * delta,
        ],
    )
    m.balance(
        r,
        "yaw",
        inertia=A_z,
        terms=[
            S_y * m.der(u) + (c.N_vdot - S_x) * m.der(v) + c.N_pdot * m.der(p),
            -(S_x * u + S_y * v) * r,
            *hull["yaw"],
            c.x_r * c.C2 * delta,
        ],
    )
    z_s = c.zbar_s + c.z_f
    m.output("gyro", p, "rad/s")
    m.output("accel", z_s * m.der(p) + c.g * ca.sin(phi) - m.der(v) - u * r, "m/s^2")
    m.output("yaw_gyro", -r, "rad/s")
    m.output("speed", u, "m/s")
    return m


def _hull_forces(c: SimpleNamespace, *state: Any) -> dict[str, list[Any]]:
    """Hydrodynamic forces and moments on the hull by balance, the terms of (A.36)."""
    u, v, p, r, phi = state
    U, V, P, R = (ca.fabs(a) for a in (u, v, p, r))
    return {
        "surge": [c.X_uu * U * u],
        "sway": [
            c.Y_uv * U * v,
            c.Y_ur * u * r,
            c.Y_vv * v * V,
            c.Y_vr * v * R,
            c.Y_rv * r * V,
            c.Y_phiuv * phi * ca.fabs(u * v),
            c.Y_phiur * phi * ca.fabs(u * r),
            c.Y_phiuu * phi * u**2,
        ],
        "roll": [
            c.K_uv * U * v,
            c.K_ur * u * r,
            c.K_vv * v * V,
            c.K_vr * v * R,
            c.K_rv * r * V,
            c.K_phiuv * phi * ca.fabs(u * v),
            c.K_phiur * phi * ca.fabs(u * r),
            c.K_phiuu * phi * u**2,
            c.K_phiphiphi * phi**3,
            c.K_p * p,
            c.K_up * U * p,
            c.K_pp * p * P,
        ],
        "yaw": [
            c.N_uv * U * v,
            c.N_ur * U * r,
            c.N_rr * r * R,
            c.N_rv * r * V,
            c.N_phiuv * phi * ca.fabs(u * v),
            c.N_phiur * phi * u * R,
            c.N_phiuu * phi * u * U,
            c.N_p * p,
            c.N_pp * p * P,
            c.N_up * U * p,
        ],
    }


def _declared(
    m: casid.Model, values: Mapping[str, float], sought: Mapping[str, tuple[float, float, float]]
) -> SimpleNamespace:
    """Every name's symbol: to be estimated, or constant. A load is known, but may shift."""
    made = SimpleNamespace()
    for name, unit in (COEFFICIENTS | BODY).items():
        if name in sought:
            start, lower, upper = sought[name]
            symbol = m.parameter(name, unit, start=start, lower=lower, upper=upper)
        elif name == "m":
            symbol = m.parameter(name, unit, value=values[name], lower=0.0)
        else:
            symbol = m.constant(name, values[name], unit)
        setattr(made, name, symbol)
    return made
