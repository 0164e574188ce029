"""What a ship is: hydrodynamic coefficients, masses, loads, reference points, limits.

Axes, signs and what goes beyond the thesis are described in `ship_4dof`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from casid.errors import DataError

from .arm import PolynomialArm, TabulatedArm

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Coefficients:
    """Hydrodynamic derivatives of (A.35) and (A.36), rudder and propeller of (A.38); SI units.

    A name is the thesis' index without its bars: Y_uv multiplies |u|v, Y_vr v|r|, Y_rv r|v|,
    K_phiuv phi|uv|, N_phiur phi u|r|, N_phiuu phi u|u|. Two are not what their names say: Y_ur
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

    def __post_init__(self) -> None:
        if not all(math.isfinite(a) for a in (self.m, self.zbar_m, self.y_m)):
            raise DataError(
                f"load: m = {self.m!r} kg, zbar_m = {self.zbar_m!r} m, y_m = {self.y_m!r} m. "
                "Give finite numbers."
            )
        if self.m < 0.0:
            raise DataError(
                f"load: m = {self.m:g} kg. Give a mass of zero or more; what is taken off the ship "
                "changes the ship's own M."
            )


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
                for row in coriolis_rows(self.moments(load), np.asarray(nu, dtype=np.float64))
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


def coriolis_rows(moments: tuple[float, float, float, float], nu: Any) -> list[list[Any]]:
    """C_RB of (A.32), of numbers or expressions."""
    mass, S_x, S_y, S_z = moments
    p, r = nu[2], nu[3]
    return [
        [0.0, -mass * r, S_z * r, -S_x * r],
        [mass * r, 0.0, -S_y * p, -S_y * r],
        [-S_z * r, S_y * p, 0.0, 0.0],
        [S_x * r, S_y * r, 0.0, 0.0],
    ]
