"""The ship's five linear states, symbolic: one casid model of (8.3)-(8.7) and its accelerometer.

Sway, roll and yaw at constant speed U about a straight course, with tau a torque in roll:

    diag(I, Mat) x' = F x + F_delta delta + T tau,    x = [phi psi v p r]                    (8.3)
    gyro = p,   accel = z_s p' + g phi - v' - U r,   yaw = r                        (8.13)-(8.16)

The symbols are sums where the sums are what enters: M_t = M + m, A_x and A_z about the
origin (A.40), hull = rho g nabla GM_T = k + K_phiuu U^2 + S g, d = -K_p - K_|u|p U.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

import casid
from casid.algebra.symbolic import to_sympy
from casid.arrays import Array
from problems.ship import TABLE_8_2
from problems.ship_4dof import LOAD_CASES, Coefficients, Load, Ship

Algebra = Any  # a sympy expression or matrix

UNITS = {
    "M_t": "kg", "S": "kg m", "A_x": "kg m^2", "A_z": "kg m^2", "hull": "N m/rad",
    "d": "N m s/rad", "U": "m/s", "g": "m/s^2", "z_s": "m",
    "Y_vdot": "kg", "Y_pdot": "kg m", "Y_rdot": "kg m", "K_vdot": "kg m", "K_rdot": "kg m^2",
    "N_vdot": "kg m", "N_pdot": "kg m^2", "Y_uv": "kg/m", "Y_ur": "kg", "Y_phiuu": "kg/m",
    "K_uv": "kg", "K_ur": "kg m", "K_phiuu": "kg", "N_uv": "kg", "N_ur": "kg m",
    "N_p": "N m s/rad", "N_phiuu": "kg", "C2": "N/rad", "x_r": "m", "z_r": "m",
}  # fmt: skip
"""The symbols of the model. N_p is N_p + N_|u|p U."""

NEGLECTED = ("K_rdot", "K_uv")
"""What (8.8)-(8.38) leave out of the roll balance."""


def values_of(
    ship: Ship | None = None, load: Load = LOAD_CASES["nominal"], U: float = 1.0
) -> dict[str, float]:
    """The symbols' values for a ship at speed U > 0 [m/s], SI units; the unit is at Table 8.2's."""
    ship = ship or Ship()
    c, mass, (M_t, _, _, S) = ship.coefficients, ship.mass_matrix(load), ship.moments(load)
    own = {n: getattr(c, n) for n in UNITS if n in Coefficients.__dataclass_fields__}
    return own | {
        "M_t": M_t,
        "S": S,
        "A_x": float(mass[2, 2]),
        "A_z": float(mass[3, 3]),
        "hull": ship.M * ship.g * ship.arm.slope + S * ship.g,
        "d": -c.K_p - c.K_up * U,
        "N_p": c.N_p + c.N_up * U,
        "U": U,
        "g": ship.g,
        "z_s": TABLE_8_2["zbar_s"] + ship.z_f,
    }


def drawn_values(rng: np.random.Generator) -> dict[str, float]:
    """Random values of the symbols, about as large as on the ship; those (8.8) neglects are 0."""
    size = values_of()
    drawn = {n: (size[n] or 0.3) * float(rng.uniform(0.4, 1.8)) for n in UNITS}
    return drawn | dict.fromkeys(NEGLECTED, 0.0)


def ship_model(values: Mapping[str, float]) -> casid.Model:
    """The five states with rudder, torque in roll, and three sensors; `values` for all symbols."""
    m = casid.Model("ship in sway, roll and yaw")
    phi, psi = m.state("phi", "rad"), m.state("psi", "rad")
    v, p, r = m.state("v", "m/s"), m.state("p", "rad/s"), m.state("r", "rad/s")
    delta, tau = m.input("delta", "rad"), m.input("tau", "N m")
    q = {n: m.constant(n, values[n], unit) for n, unit in UNITS.items()}
    vdot, pdot, rdot = m.der(v), m.der(p), m.der(r)
    U, force = q["U"], q["C2"] * delta
    m.derivative(phi, p)
    m.derivative(psi, r)
    m.balance(
        v,
        "sway",
        inertia=q["M_t"] - q["Y_vdot"],
        terms=[
            (q["S"] + q["Y_pdot"]) * pdot + q["Y_rdot"] * rdot,
            q["Y_phiuu"] * U**2 * phi + q["Y_uv"] * U * v + (q["Y_ur"] - q["M_t"]) * U * r,
            force,
        ],
    )
    m.balance(
        p,
        "roll",
        inertia=q["A_x"],
        terms=[
            (q["S"] + q["K_vdot"]) * vdot + q["K_rdot"] * rdot,
            (q["K_phiuu"] * U**2 - q["hull"]) * phi - q["d"] * p,
            q["K_uv"] * U * v + (q["K_ur"] + q["S"]) * U * r,
            -q["z_r"] * force,
            tau,
        ],
    )
    m.balance(
        r,
        "yaw",
        inertia=q["A_z"],
        terms=[
            q["N_vdot"] * vdot + q["N_pdot"] * pdot,
            q["N_phiuu"] * U**2 * phi + q["N_uv"] * U * v + q["N_p"] * p + q["N_ur"] * U * r,
            q["x_r"] * force,
        ],
    )
    m.output("gyro", p, "rad/s")
    m.output("accel", q["z_s"] * pdot + q["g"] * phi - vdot - U * r, "m/s^2")
    m.output("yaw", r, "rad/s")
    return m


@lru_cache(maxsize=1)
def symbolic_matrices() -> tuple[Algebra, Algebra, Algebra]:
    """E (5, 5), F (5, 5) and [F_delta, T] (5, 2) of (8.3) as symbolic sympy matrices.

    Read out of the casid model's own equations, so that what is proved is proved of that model.
    """
    m = ship_model(values_of())
    residuals = ca.vertcat(*[residual for _, residual, _ in m.equations()])
    rates = ca.vertcat(*[m.der(s) for s in m.states])
    states = ca.vertcat(*[m.symbol(s) for s in m.states])
    inputs = ca.vertcat(*[m.symbol(u) for u in m.inputs])

    def slope(symbols: Any) -> Algebra:
        return to_sympy(ca.jacobian(residuals, symbols), exact_numbers=True)

    return slope(rates), -slope(states), -slope(inputs)


@lru_cache(maxsize=1)
def _numbers() -> Any:
    import sympy

    matrices = [m.tolist() for m in symbolic_matrices()]
    return sympy.lambdify([sympy.Symbol(n) for n in UNITS], matrices, modules="math")


def matrices(values: Mapping[str, float]) -> tuple[Array, Array, Array]:
    """E (5, 5), F (5, 5) and [F_delta, T] (5, 2) in numbers."""
    E, F, B = (np.array(m, dtype=np.float64) for m in _numbers()(*[values[n] for n in UNITS]))
    return E, F, B


def accelerometer(values: Mapping[str, float]) -> tuple[Array, Array]:
    """a_s = C x + D [delta, tau]: C (5,), D (2,)."""
    E, F, B = matrices(values)
    A, D = np.linalg.solve(E, F), np.linalg.solve(E, B)
    C = values["z_s"] * A[3] - A[2]
    C[0] += values["g"]
    C[4] -= values["U"]
    return C, values["z_s"] * D[3] - D[2]


def frequency_response(values: Mapping[str, float], s: complex) -> dict[str, complex]:
    """Responses "signal/input" at one s [1/s], by the matrices (8.3) and by no formula.

    Signals gyro (phi'), accel (a_s), yaw (r) and vdot; inputs delta and tau.
    """
    E, F, B = matrices(values)
    x = np.linalg.solve(s * E - F, B)
    phi, _, v, p, r = x
    a_s = values["z_s"] * s * p + values["g"] * phi - s * v - values["U"] * r
    rows = {"gyro": p, "accel": a_s, "yaw": r, "vdot": s * v}
    return {
        f"{name}/{u}": complex(row[j])
        for name, row in rows.items()
        for j, u in enumerate(("delta", "tau"))
    }
