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

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

import casid
from casid.errors import DataError, ModelError, SolveError

Array = NDArray[np.float64]


# -- what the ship is ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Coefficients:
    """Hydrodynamic derivatives of (A.35) and (A.36), rudder and propeller of (A.38); SI units.

    A name is the thesis' index without its bars: Y_uv multiplies |u|v, Y_vr v|r|, Y_rv r|v|,
    K_phiuv phi|uv|, N_phiur phi u|r|, N_phiuu phi u|u|. Two are not what their letters say: Y_ur
    and K_ur multiply u r, N_ur multiplies |u|r.

    The values are those of a model of 22 kg, 0.8 m long. "8.2": Table 8.2, the signs of Y_|u|v
    and N_|u|r, lost in print, restored. All others are chosen here: the thesis gives none. N_|u|v
    and K_|u|v are zero because the poles published for Table 8.2 need that.
    """

    # added mass (A.35)
    X_udot: float = -1.1  # kg
    Y_vdot: float = -100.0  # kg, 8.2
    Y_pdot: float = 0.1  # kg m, 8.2
    Y_rdot: float = -1.0  # kg m, 8.2
    K_vdot: float = 0.1  # kg m, 8.2
    K_rdot: float = 0.0  # kg m^2, 8.2
    N_vdot: float = -1.0  # kg m, 8.2
    N_pdot: float = 0.0  # kg m^2, 8.2
    # surge
    X_uu: float = -1.6  # kg/m: 1.6 N at 1 m/s
    # sway
    Y_uv: float = -35.0  # kg/m, 8.2
    Y_ur: float = 0.0  # kg, 8.2
    Y_vv: float = -115.0  # kg/m: a drag coefficient of 2 of the lateral area
    Y_vr: float = -40.0  # kg
    Y_rv: float = -5.0  # kg
    Y_phiuv: float = 2.0  # kg/m
    Y_phiur: float = 1.0  # kg
    Y_phiuu: float = 0.0  # kg/m, 8.2
    # roll
    K_uv: float = 0.0  # kg
    K_ur: float = -0.4  # kg m, 8.2
    K_vv: float = -0.5  # kg
    K_vr: float = -0.1  # kg m
    K_rv: float = -0.1  # kg m
    K_phiuv: float = -0.1  # kg
    K_phiur: float = -0.05  # kg m
    K_phiuu: float = 0.0  # kg
    K_up: float = -0.1  # kg m; d = -K_p - K_|u|p U is that of 8.2 at 1 m/s
    K_pp: float = -0.02  # kg m^2
    K_p: float = -0.1067  # N m s/rad
    K_phiphiphi: float = 0.0  # N m/rad^3: the cross curve carries it
    # yaw
    N_uv: float = 0.0  # kg
    N_ur: float = -1.4  # kg m, 8.2
    N_rr: float = -2.0  # kg m^2
    N_rv: float = -4.0  # kg m
    N_phiuv: float = 0.2  # kg
    N_phiur: float = 0.1  # kg m
    N_p: float = 0.0  # N m s/rad, 8.2
    N_pp: float = -0.002  # kg m^2
    N_up: float = 0.0  # kg m, 8.2
    N_phiuu: float = 0.0  # kg, 8.2
    # rudder and propeller (A.38)
    C1: float = 0.2  # N/rad
    C2: float = 3.6  # N/rad
    z_r: float = 0.1125  # m; with C2, K_delta = -z_r C2 = -0.405 of Table 8.3
    x_r: float = -0.4  # m: at the stern
    C3: float = 0.016  # N s/rad: 1 m/s at 100 rad/s

    def without_damping(self) -> Coefficients:
        """The same added masses, and nothing else: neither fluid nor rudder does work."""
        kept = {name for name in _NAMES if name.endswith("dot")} | {"z_r", "x_r"}
        return replace(self, **{name: 0.0 for name in _NAMES if name not in kept})


_NAMES = tuple(f.name for f in fields(Coefficients))


@dataclass(frozen=True, slots=True)
class PolynomialArm:
    """Cross curve arm(phi) = c_1 phi + c_3 phi^3 + c_5 phi^5 + ... [m], odd."""

    odd: tuple[float, ...]

    def __call__(self, phi: Any) -> Any:
        """The arm [m] at heel phi [rad]: a number, an array or a CasADi expression."""
        square, total = phi * phi, 0.0
        for c in reversed(self.odd):
            total = total * square + c
        return total * phi

    def integral(self, phi: Array) -> Array:
        """The arm's integral from 0 to phi [m rad]."""
        powers = [c * phi ** (2 * i + 2) / (2 * i + 2) for i, c in enumerate(self.odd)]
        return np.asarray(sum(powers), dtype=np.float64)

    @property
    def slope(self) -> float:
        """Of the arm at zero heel [m/rad]."""
        return self.odd[0]

    @property
    def reach(self) -> float:
        """Heel up to which the arm means something [rad]."""
        return math.pi / 2


@dataclass(frozen=True, slots=True)
class TabulatedArm:
    """Cross curve through a table of heel [rad] and arm [m], odd, by the natural cubic spline.

    It has two continuous derivatives, zero heel included, so that Runge-Kutta 4 keeps its order.

    Parameters
    ----------
    phi : heels, increasing from 0.
    arm : arms, the first zero.

    Raises
    ------
    DataError
        If the table is too short, does not begin at (0, 0) or does not increase.
    """

    phi: tuple[float, ...]
    arm: tuple[float, ...]
    _jumps: tuple[float, ...] = field(init=False, repr=False, compare=False)
    _slope: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        x, y = np.asarray(self.phi, dtype=np.float64), np.asarray(self.arm, dtype=np.float64)
        if x.shape != y.shape or x.size < 3 or not np.all(np.isfinite(x) & np.isfinite(y)):
            raise DataError(
                f"restoring arm: {x.size} heels and {y.size} arms, finite or not. "
                "Give at least three heels [rad] and as many finite arms [m]."
            )
        if x[0] != 0.0 or y[0] != 0.0 or np.any(np.diff(x) <= 0.0):
            raise DataError(
                "restoring arm: the table must begin at (0, 0) and its heels must increase. "
                "Give the starboard half; the port half is its mirror image."
            )
        object.__setattr__(self, "phi", tuple(float(a) for a in x))
        object.__setattr__(self, "arm", tuple(float(a) for a in y))
        h, n = np.diff(x), x.size
        A, b = np.eye(n), np.zeros(n)  # second derivatives, zero at both ends
        for i in range(1, n - 1):
            A[i, i - 1 : i + 2] = h[i - 1], 2.0 * (h[i - 1] + h[i]), h[i]
            b[i] = 6.0 * ((y[i + 1] - y[i]) / h[i] - (y[i] - y[i - 1]) / h[i - 1])
        second = np.linalg.solve(A, b)
        slope = (y[1] - y[0]) / h[0] - h[0] * second[1] / 6.0
        third = np.append(np.diff(second) / h, 0.0)
        jumps = np.diff(third, prepend=0.0) / 6.0
        object.__setattr__(self, "_slope", float(slope))
        object.__setattr__(self, "_jumps", tuple(float(a) for a in jumps))

    def __call__(self, phi: Any) -> Any:
        """The arm [m] at heel phi [rad]: a number, an array or a CasADi expression."""
        symbolic = isinstance(phi, ca.SX | ca.MX)
        heel = ca.fabs(phi) if symbolic else np.abs(phi)
        total = self._slope * heel
        for knot, jump in zip(self.phi, self._jumps, strict=True):
            beyond = ca.fmax(heel - knot, 0.0) if symbolic else np.maximum(heel - knot, 0.0)
            total = total + jump * (beyond * beyond * beyond)
        return (ca.sign(phi) if symbolic else np.sign(phi)) * total

    def integral(self, phi: Array) -> Array:
        """The arm's integral from 0 to phi [m rad]."""
        heel = np.abs(phi)
        total = self._slope * heel**2 / 2
        for knot, jump in zip(self.phi, self._jumps, strict=True):
            total = total + jump * np.maximum(heel - knot, 0.0) ** 4 / 4
        return np.asarray(total, dtype=np.float64)

    @property
    def slope(self) -> float:
        """Of the arm at zero heel [m/rad]."""
        return self._slope

    @property
    def reach(self) -> float:
        """Heel up to which the arm means something [rad]: the table's last."""
        return self.phi[-1]


@dataclass(frozen=True, slots=True)
class Actuator:
    """Limits of a rudder [rad] or propeller [rad/s].

    Attributes
    ----------
    lowest, highest : of the position.
    rate : largest change of the position per second.
    """

    lowest: float
    highest: float
    rate: float


@dataclass(frozen=True, slots=True)
class Load:
    """A weight aboard, a point.

    Attributes
    ----------
    m : mass [kg].
    zbar_m : height, measured down from the mark on the hull [m].
    y_m : distance from the centre line, to starboard [m].
    """

    m: float = 0.0
    zbar_m: float = 0.0
    y_m: float = 0.0


LOAD_CASES = {
    "nominal": Load(),
    "calibration": Load(0.2, -0.172),
    "second calibration": Load(0.2, -0.072),  # not in the thesis: 0.1 m lower
    "loaded": Load(0.4, -0.182),
}
"""Table 8.2, and one more calibration."""

_WEIGHT = 22.04 * 9.82


@dataclass(frozen=True, slots=True)
class Ship:
    """A ship; the defaults are the model of Table 8.2 (see `Coefficients` for what is chosen).

    Attributes
    ----------
    M : mass without load [kg].
    zbar_g : height of its centre of gravity CG, down from the mark [m].
    x_g, y_g : of the CG, ahead and to starboard of the CO [m].
    z_f : height of the mark, down from the centre of rotation [m].
    A_x, A_z : I_x - K_pdot and I_z - N_rdot, moments of inertia about the CG's axes with added
        ones [kg m^2]. A_z = 3 A_x is Table 8.2's.
    arm : cross curve about the CO. The default's slope is k/(M g), k = 10.38 N m/rad of Table 8.2;
        its bend is chosen: GZ rises to 0.013 m at 40 deg and vanishes at 55 deg.
    rudder, propeller : limits, chosen: 35 deg at 23 deg/s (4.7 deg/s at full scale).
    g : [m/s^2].
    slowest : surge speed under which the model says nothing [m/s]; chosen.
    """

    M: float = 22.04
    zbar_g: float = 0.0
    x_g: float = 0.0
    y_g: float = 0.0
    z_f: float = -0.028
    A_x: float = 0.1385
    A_z: float = 3 * 0.1385
    coefficients: Coefficients = field(default_factory=Coefficients)
    arm: PolynomialArm | TabulatedArm = PolynomialArm(
        (10.38 / _WEIGHT, 0.3 * 10.38 / _WEIGHT, -0.9 * 10.38 / _WEIGHT)
    )
    rudder: Actuator = Actuator(-math.radians(35.0), math.radians(35.0), 0.4)
    propeller: Actuator = Actuator(0.0, 160.0, 100.0)
    g: float = 9.82
    slowest: float = 0.1

    @property
    def z_g(self) -> float:
        """Height of the CG, down from the CO [m]."""
        return self.zbar_g + self.z_f

    def z_m(self, load: Load) -> float:
        """Height of a load, down from the CO [m]."""
        return load.zbar_m + self.z_f

    def moments(self, load: Load = LOAD_CASES["nominal"]) -> tuple[float, float, float, float]:
        """Mass M + m [kg] and first moments S_x, S_y, S_z about the CO [kg m]."""
        return (
            self.M + load.m,
            self.M * self.x_g,
            self.M * self.y_g + load.m * load.y_m,
            self.M * self.z_g + load.m * self.z_m(load),
        )

    def mass_matrix(self, load: Load = LOAD_CASES["nominal"]) -> Array:
        """(4, 4) M of (A.40), added mass included."""
        c, (mass, S_x, S_y, S_z) = self.coefficients, self.moments(load)
        own, m, z_m = self.M, load.m, self.z_m(load)
        A_x = self.A_x + own * (self.y_g**2 + self.z_g**2) + m * (load.y_m**2 + z_m**2)
        A_z = self.A_z + own * (self.x_g**2 + self.y_g**2) + m * load.y_m**2
        return np.array(
            [
                [mass - c.X_udot, 0.0, 0.0, -S_y],
                [0.0, mass - c.Y_vdot, -S_z - c.Y_pdot, S_x - c.Y_rdot],
                [0.0, -S_z - c.K_vdot, A_x, -c.K_rdot],
                [-S_y, S_x - c.N_vdot, -c.N_pdot, A_z],
            ]
        )

    def coriolis(self, nu: ArrayLike, load: Load = LOAD_CASES["nominal"]) -> Array:
        """(4, 4) C_RB(nu) of (A.32)."""
        return np.array(
            [
                [float(a) for a in row]
                for row in _coriolis(self.moments(load), np.asarray(nu, dtype=np.float64))
            ]
        )

    def restoring(self, phi: Any, load: Load = LOAD_CASES["nominal"]) -> Any:
        """Righting torque at rest, M_t g GZ(phi) [N m]; phi [rad] a number, array or expression."""
        symbolic = isinstance(phi, ca.SX | ca.MX)
        sin, cos = (ca.sin(phi), ca.cos(phi)) if symbolic else (np.sin(phi), np.cos(phi))
        _, _, S_y, S_z = self.moments(load)
        weights = S_z * sin - S_y * cos if S_y else S_z * sin
        return self.g * (self.M * self.arm(phi) + weights)

    def GZ(self, phi: Array, load: Load = LOAD_CASES["nominal"]) -> Array:
        """Righting arm [m] at heel phi [rad]."""
        return np.asarray(self.restoring(phi, load) / (self.g * (self.M + load.m)))

    def energy(self, nu: Array, phi: Array, load: Load = LOAD_CASES["nominal"]) -> Array:
        """Kinetic energy, added mass included, and that of the restoring torque [J].

        Parameters
        ----------
        nu : (N, 4) u, v [m/s], p, r [rad/s].
        phi : (N,) heel [rad].
        """
        _, _, S_y, S_z = self.moments(load)
        kinetic = 0.5 * np.einsum("ni,ij,nj->n", nu, self.mass_matrix(load), nu)
        hull = self.M * self.arm.integral(phi)
        cubic = self.coefficients.K_phiphiphi * phi**4 / 4
        return np.asarray(kinetic + self.g * (hull - S_z * np.cos(phi) - S_y * np.sin(phi)) - cubic)

    def roll_coefficients(
        self, U: float = 1.0, load: Load = LOAD_CASES["nominal"]
    ) -> dict[str, float]:
        """The roll subsystem at speed U [m/s] (8.9)-(8.11), (8.19): names as in `ship.TABLE_8_2`.

        k, d and K_r depend on the speed, A_1 and S on the load.
        """
        c, (_, _, _, S) = self.coefficients, self.moments(load)
        return {
            "k": self.M * self.g * self.arm.slope - c.K_phiuu * U**2,
            "A_x": self.A_x,
            "d": -c.K_p - c.K_up * abs(U),
            "K_r": (c.K_ur - c.K_vdot) * U,
            "K_vdot": c.K_vdot,
            "K_delta": -c.z_r * c.C2,
            "S": S,
            "A_1": float(self.mass_matrix(load)[2, 2]),
        }


# -- its equations -------------------------------------------------------------------------------


def rotation(phi: float, theta: float, psi: float) -> Array:
    """(3, 3) R = Rz(psi) Ry(theta) Rx(phi), from the ship's axes to north, east, down (A.8).

    Entry (2, 3) is -cos(psi) sin(phi) + sin(theta) sin(psi) cos(phi); as printed, with
    sin(theta) first, the matrix is not orthogonal.
    """
    (cf, sf), (ct, st), (cp, sp) = ((math.cos(a), math.sin(a)) for a in (phi, theta, psi))
    return np.array(
        [
            [cp * ct, -sp * cf + cp * st * sf, sp * sf + cp * cf * st],
            [sp * ct, cp * cf + sf * st * sp, -cp * sf + st * sp * cf],
            [-st, ct * sf, ct * cf],
        ]
    )


def _coriolis(moments: tuple[float, float, float, float], nu: Any) -> list[list[Any]]:
    """C_RB of (A.32), of numbers or expressions."""
    mass, S_x, S_y, S_z = moments
    p, r = nu[2], nu[3]
    return [
        [0.0, -mass * r, S_z * r, -S_x * r],
        [mass * r, 0.0, -S_y * p, -S_y * r],
        [-S_z * r, S_y * p, 0.0, 0.0],
        [S_x * r, S_y * r, 0.0, 0.0],
    ]


def hydrodynamics(c: Coefficients, phi: Any, nu: Sequence[Any]) -> list[Any]:
    """The four rows of f (A.36) [N, N m]: numbers or CasADi expressions."""
    u, v, p, r = nu
    U, V, P, R = (ca.fabs(a) for a in nu)
    UV, ur = U * V, u * r
    UR = ca.fabs(ur)
    uu = u * u
    return [
        c.X_uu * U * u,
        (c.Y_uv * U + c.Y_vv * V + c.Y_vr * R) * v
        + (c.Y_ur * u + c.Y_rv * V) * r
        + (c.Y_phiuv * UV + c.Y_phiur * UR + c.Y_phiuu * uu) * phi,
        (c.K_uv * U + c.K_vv * V + c.K_vr * R) * v
        + (c.K_ur * u + c.K_rv * V) * r
        + (c.K_phiuv * UV + c.K_phiur * UR + c.K_phiuu * uu + c.K_phiphiphi * (phi * phi)) * phi
        + (c.K_up * U + c.K_pp * P + c.K_p) * p,
        (c.N_uv * U) * v
        + (c.N_ur * U + c.N_rr * R + c.N_rv * V) * r
        + (c.N_phiuv * UV + c.N_phiur * (u * R) + c.N_phiuu * (u * U)) * phi
        + (c.N_p + c.N_pp * P + c.N_up * U) * p,
    ]


def _product(matrix: Array, vector: list[Any]) -> list[Any]:
    """Matrix times vector, zeros left out, so that they cost nothing."""
    made: list[Any] = []
    for row in matrix:
        terms = [a * b for a, b in zip(row.tolist(), vector, strict=True) if a != 0.0]
        made.append(sum(terms[1:], terms[0]) if terms else 0.0)
    return made


@lru_cache(maxsize=64)
def dynamics(ship: Ship, load: Load) -> Any:
    """CasADi function of x = [x y phi psi u v p r], inputs [delta w_p], tau (4) and current (2).

    Its value is x' (8): velocities over ground, rates of the angles, accelerations.
    """
    c, moments = ship.coefficients, ship.moments(load)
    x, actuators = ca.SX.sym("x", 8), ca.SX.sym("actuators", 2)
    tau, current = ca.SX.sym("tau", 4), ca.SX.sym("current", 2)
    _, _, phi, psi, u, v, p, r = ca.vertsplit(x)
    nu, (delta, w_p) = [u, v, p, r], ca.vertsplit(actuators)
    cos_phi, cos_psi, sin_psi = ca.cos(phi), ca.cos(psi), ca.sin(psi)
    side = v * cos_phi
    steer = c.C2 * delta
    actuation = [c.C3 * w_p - c.C1 * ca.fabs(delta), steer, -c.z_r * steer, c.x_r * steer]
    restoring = [0.0, 0.0, ship.restoring(phi, load), 0.0]
    force = [
        f - sum(a * b for a, b in zip(row, nu, strict=True)) - g + actuation[i] + tau[i]
        for i, (f, row, g) in enumerate(
            zip(hydrodynamics(c, phi, nu), _coriolis(moments, nu), restoring, strict=True)
        )
    ]
    mass = ship.mass_matrix(load)
    inverse = np.asarray(np.linalg.inv(mass), dtype=np.float64)
    if mass[0, 3] == 0.0:  # surge stands alone: no rounding in place of zeros
        inverse[0, 1:] = inverse[1:, 0] = 0.0
    rates = [
        cos_psi * u - sin_psi * side + current[0],
        sin_psi * u + cos_psi * side + current[1],
        p,
        cos_phi * r,
        *_product(inverse, force),
    ]
    return ca.Function(
        "dynamics",
        [x, actuators, tau, current],
        [ca.vertcat(*rates)],
        ["x", "actuators", "tau", "current"],
        ["rates"],
    )


@lru_cache(maxsize=64)
def sample_step(ship: Ship, load: Load, Ts: float, substeps: int) -> Any:
    """CasADi function of one sample: Runge-Kutta 4 in `substeps` steps.

    Its inputs are the state (10: x of `dynamics`, then rudder and propeller), the commands (2), and
    forces and current, six numbers, at the sample and at the next. Its values are the next
    state and x' (8) at the sample.
    """
    f = dynamics(ship, load)
    state, command = ca.SX.sym("state", 10), ca.SX.sym("command", 2)
    here, there = ca.SX.sym("here", 6), ca.SX.sym("there", 6)
    x, actuators = state[:8], state[8:]
    limits = (ship.rudder, ship.propeller)
    moved = []
    for i, a in enumerate(limits):
        wanted = ca.fmin(ca.fmax(command[i], a.lowest), a.highest)
        reach = a.rate * Ts
        moved.append(ca.fmin(ca.fmax(wanted - actuators[i], -reach), reach))
    inputs = ca.vertcat(actuators, here)
    change = (ca.vertcat(ca.vertcat(*moved), there - here)) / (2 * substeps)
    h = Ts / substeps

    def rates(at: Any, z: Any) -> Any:
        return f(at, z[:2], z[2:6], z[6:])

    first: Any = None
    for i in range(substeps):
        left, middle, right = (inputs + k * change for k in (2 * i, 2 * i + 1, 2 * i + 2))
        k1 = rates(x, left)
        k2 = rates(x + h / 2 * k1, middle)
        k3 = rates(x + h / 2 * k2, middle)
        k4 = rates(x + h * k3, right)
        x = x + h / 6 * (k1 + 2 * (k2 + k3) + k4)
        first = k1 if first is None else first
    return ca.Function(
        "sample_step",
        [state, command, here, there],
        [ca.vertcat(x, actuators + ca.vertcat(*moved)), first],
        ["state", "command", "here", "there"],
        ["next", "rates"],
    )


@lru_cache(maxsize=32)
def _block(ship: Ship, load: Load, Ts: float, substeps: int, N: int) -> Any:
    return sample_step(ship, load, Ts, substeps).mapaccum(N)


def _run(step: tuple[Ship, Load, float, int], x0: list[float], inputs: Array) -> Array:
    """(N, 18) states and rates at every sample; inputs (N, 14) are those of `sample_step`."""
    N = inputs.shape[0]
    size = min(N, 3000)  # long records in blocks of one function: it need not be built anew
    block, made, x = _block(*step, size), np.empty((N, 18)), np.asarray(x0)
    for i in range(0, N, size):
        given = inputs[i : i + size]
        n = given.shape[0]
        given = np.vstack([given, np.repeat(given[-1:], size - n, axis=0)]).T
        later, rates = block(x, given[:2], given[2:8], given[8:])
        states = np.vstack([x, np.asarray(later).T])
        made[i : i + n, :10], made[i : i + n, 10:] = states[:n], np.asarray(rates).T[:n]
        x = states[n]
    return made


# -- stability -----------------------------------------------------------------------------------


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
        If the load capsizes it or makes it loll; the message tells the angle.
    """
    found = stability(ship, load)
    if found.GM > 0.0 and found.rests:
        return found
    z_m, own = ship.z_m(load), ship.M * (ship.arm.slope + ship.z_g)
    most = -own / z_m if z_m < 0.0 and load.y_m == 0.0 and own > 0.0 else None
    angles = ", ".join(f"{math.degrees(a):.1f}" for a in found.rests)
    fate = f"it lolls to {angles} deg" if found.rests else "it capsizes: no heel has a righting arm"
    raise SolveError(
        f"ship: with {load.m:g} kg at zbar_m = {load.zbar_m:g} m, y_m = {load.y_m:g} m "
        f"GM = {1e3 * found.GM:.1f} mm and {fate}. Carry it lower or nearer the centre line"
        + (f", or carry less than {most:.2f} kg there." if most is not None else ", or carry less.")
    )


# -- simulation ----------------------------------------------------------------------------------


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
    Ts: float = 0.02,
    substeps: int = 10,
) -> Motion:
    """Simulate the ship.

    Parameters
    ----------
    delta : (N,) rudder command [rad].
    ship, load : the ship of Table 8.2 without load by default.
    w_p : (N,) or number, propeller command [rad/s].
    forces : (N, 4) waves, wind and other forces in surge, sway [N], roll and yaw [N m], about the
        CO, in the ship's axes.
    current : (N, 2) velocity of the water, north and east [m/s].
    start : straight ahead at 1 m/s by default; `end` of a motion to go on with it, as long
        records are made of stretches.
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
    tau = np.zeros((N, 4)) if forces is None else _columns("forces", forces, N, 4)
    stream = np.zeros((N, 2)) if current is None else _columns("current", current, N, 2)
    if not (Ts > 0.0 and substeps >= 1):
        raise DataError(f"Ts = {Ts:g} s in {substeps} substeps. Give Ts > 0 and at least one.")
    _require_speed(ship, start.u, "at the start")
    steady = require_stable(ship, load)
    s, a = start, ship.propeller
    turning = float(np.clip(speed[0, 0], a.lowest, a.highest)) if s.w_p is None else s.w_p
    x0 = [s.x, s.y, s.phi, s.psi, s.u, s.v, s.p, s.r, s.delta, turning]
    outside = np.hstack([tau, stream])
    after = np.vstack([outside[1:], outside[-1:]])
    inputs = np.hstack([command, speed, outside, after])
    made = _run((ship, load, float(Ts), int(substeps)), x0, inputs)
    states, rates = made[:, :10], made[:, 10:]
    _require_upright(states[:, 2], steady, load, Ts)
    slow = np.flatnonzero(states[:, 4] < ship.slowest)
    if slow.size:
        _require_speed(ship, float(states[slow[0], 4]), f"at t = {slow[0] * Ts:.2f} s")
    stuck = stuck_rudder(states[:, 8], (ship.rudder.lowest, ship.rudder.highest), Ts)
    return Motion(ship, load, float(Ts), states, rates, tau, (stuck,) if stuck else ())


def stuck_rudder(delta: ArrayLike, limits: tuple[float, float], Ts: float) -> str | None:
    """Say so if a rudder lies at a limit for a tenth of its record in one stretch; else None.

    Parameters
    ----------
    delta : (N,) rudder angle [rad].
    limits : smallest and largest angle [rad].
    Ts : sample time [s].
    """
    angle = np.asarray(delta, dtype=np.float64)
    slack = 1e-3 * (limits[1] - limits[0])
    at_limit = (angle <= limits[0] + slack) | (angle >= limits[1] - slack)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at_limit.astype(int), [0]])))
    stretches = edges[1::2] - edges[::2]
    if not stretches.size or stretches.max() < 0.1 * angle.size:
        return None
    longest = int(np.argmax(stretches))
    first = int(edges[2 * longest])
    return (
        f"rudder at its limit of {math.degrees(angle[first]):.1f} deg for "
        f"{stretches[longest] * Ts:.1f} s from t = {first * Ts:.1f} s, and for "
        f"{100 * at_limit.mean():.0f} % of the record: it excites nothing there. "
        "Command less, or leave that stretch out."
    )


def zigzag(duration: float, *, angle: float, every: float, Ts: float = 0.02) -> Array:
    """(N,) rudder command [rad]: angle and its opposite in turn, first to port.

    Parameters
    ----------
    duration, every : of the record and of one side [s].
    angle : [rad].
    Ts : sample time [s].
    """
    t = Ts * np.arange(round(duration / Ts))
    return np.asarray(np.where(np.floor((t + 1e-9) / every) % 2 == 0, angle, -angle))


def random_steps(
    duration: float, *, angle: float, hold: float, seed: int, Ts: float = 0.02
) -> Array:
    """(N,) rudder command [rad]: levels uniform in +-angle, each held for `hold` s on average."""
    rng, N = np.random.default_rng(seed), round(duration / Ts)
    change = rng.random(N) < Ts / hold
    change[0] = True
    levels = rng.uniform(-angle, angle, N)
    return np.asarray(levels[np.maximum.accumulate(np.where(change, np.arange(N), 0))])


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


def _require_speed(ship: Ship, u: float, when: str) -> None:
    if not abs(u) < math.inf or u < ship.slowest:
        raise SolveError(
            f"ship: surge speed {u:.3f} m/s {when}, below {ship.slowest:g} m/s: the series (A.36) "
            "is one for headway, and rudder, damping and K_r vanish with the speed. "
            "Start faster, turn the propeller faster, or use less rudder or drift force."
        )


def _require_upright(phi: Array, steady: Stability, load: Load, Ts: float) -> None:
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


# -- linear models -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """E x' = F x + F_delta delta + T tau, x = [phi psi v p r] (8.3)-(8.7).

    Attributes
    ----------
    E : (5, 5) diag(I, Mat).
    F : (5, 5).
    F_delta : (5,) of the rudder [rad].
    T : (5, 3) of forces in sway [N], roll and yaw [N m].
    """

    E: Array
    F: Array
    F_delta: Array
    T: Array

    @property
    def A(self) -> Array:
        """(5, 5) x' = A x + ..."""
        return np.asarray(np.linalg.solve(self.E, self.F))

    @property
    def B(self) -> Array:
        """(5,) of the rudder."""
        return np.asarray(np.linalg.solve(self.E, self.F_delta))

    def poles(self) -> NDArray[np.complex128]:
        """(5,) eigenvalues [1/s]."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=np.complex128)

    def accelerometer(self, z_s: float, *, U: float, g: float) -> tuple[Array, float, Array]:
        """a_s = C x + D_delta delta + D_tau' tau of a unit at the height z_s (8.13)-(8.16).

        Parameters
        ----------
        z_s : of the unit, down from the CO [m].
        U : speed this was linearised at [m/s].
        g : [m/s^2].

        Returns
        -------
        C : (5,), D_delta : number, D_tau : (3,). The accelerometer answers at once to the rudder
        and to forces; yaw rate and roll rate, which have no such terms, only after integration.
        """
        A, B, T = self.A, self.B, np.linalg.solve(self.E, self.T)
        C = z_s * A[3] - A[2]
        C[0] += g
        C[4] -= U
        return C, float(z_s * B[3] - B[2]), np.asarray(z_s * T[3] - T[2])

    def transfer(self, output: int | ArrayLike = 0) -> tuple[Array, Array]:
        """Numerator and denominator, highest power first, from rudder to x[output] or output' x.

        The heading, an integrator that nothing else depends on, is left out unless it is asked for.
        """
        c = np.eye(5)[output] if isinstance(output, int) else np.asarray(output, dtype=np.float64)
        keep = [0, 1, 2, 3, 4] if c[1] else [0, 2, 3, 4]
        A, B, c = self.A[np.ix_(keep, keep)], self.B[keep], c[keep]
        # Markov parameters times the denominator: no difference of nearly equal polynomials
        den = np.asarray(np.poly(A), dtype=np.float64)
        markov, state = [0.0], B
        for _ in keep:
            markov.append(float(c @ state))
            state = A @ state
        num = np.array([np.dot(den[: i + 1][::-1], markov[: i + 1]) for i in range(len(den))])
        scale = np.abs(num).max()
        if scale == 0.0:
            return np.zeros(1), den
        first = int(np.flatnonzero(np.abs(num) > 1e-12 * scale)[0])
        return num[first:], den

    def zeros(self, output: int | ArrayLike = 0) -> NDArray[np.complex128]:
        """Zeros from rudder to x[output] [1/s]; in the right half-plane: non-minimum phase."""
        return np.asarray(np.roots(self.transfer(output)[0]), dtype=np.complex128)


def linearised(
    U: float = 1.0, *, ship: Ship | None = None, load: Load = LOAD_CASES["nominal"]
) -> Linear:
    """The linear model about a straight course at speed U [m/s], by the formulas (8.3)-(8.7).

    A distance x_g of the CG from the CO is allowed for, as (A.32) has it.

    Raises
    ------
    SolveError
        For a speed near zero.
    ModelError
        If the centre of gravity is off the centre line: the ship then heels on a straight course.
    """
    ship = ship or Ship()
    _require_speed(ship, U, "asked for")
    c, (mass, S_x, S_y, S) = ship.coefficients, ship.moments(load)
    if S_y != 0.0:
        raise ModelError(
            f"ship: centre of gravity {S_y / mass:g} m off the centre line; (8.3)-(8.7) are for "
            "an upright ship. Set y_g and y_m to 0, or use tangent() at the heel you mean."
        )
    E = np.eye(5)
    E[2:, 2:] = ship.mass_matrix(load)[1:, 1:]
    V, hull = abs(U), ship.M * ship.g * ship.arm.slope + S * ship.g  # rho g nabla GM_T
    F = np.array(
        [
            [0.0, 0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 1.0],
            [c.Y_phiuu * U**2, 0.0, c.Y_uv * V, 0.0, (c.Y_ur - mass) * U],
            [c.K_phiuu * U**2 - hull, 0.0, c.K_uv * V, c.K_p + c.K_up * V, (c.K_ur + S) * U],
            [c.N_phiuu * U * V, 0.0, c.N_uv * V, c.N_p + c.N_up * V, c.N_ur * V - S_x * U],
        ]
    )
    F_delta = np.array([0.0, 0.0, c.C2, -c.z_r * c.C2, c.x_r * c.C2])
    return Linear(E, F, F_delta, np.vstack([np.zeros((2, 3)), np.eye(3)]))


def tangent(
    U: float = 1.0,
    *,
    ship: Ship | None = None,
    load: Load = LOAD_CASES["nominal"],
    phi: float = 0.0,
) -> Linear:
    """The same by CasADi's Jacobian of the simulator, at heel phi [rad].

    Surge is held: where the ship heels, its speed would couple.

    Raises
    ------
    SolveError
        For a speed near zero.
    """
    ship = ship or Ship()
    _require_speed(ship, U, "asked for")
    f = dynamics(ship, load)
    J = f.factory("J", f.name_in(), ["jac:rates:x", "jac:rates:actuators", "jac:rates:tau"])
    at = [0.0, 0.0, phi, 0.0, U, 0.0, 0.0, 0.0]
    rows = [2, 3, 5, 6, 7]  # phi psi v p r
    A, B, T = (np.asarray(j) for j in J(at, [0.0, 0.0], np.zeros(4), np.zeros(2)))
    E = np.eye(5)
    E[2:, 2:] = ship.mass_matrix(load)[1:, 1:]
    return Linear(
        E,
        E @ A[np.ix_(rows, rows)],
        E @ B[rows, 0],
        E @ T[np.ix_(rows, [1, 2, 3])],
    )
