"""Linear models of a ship about a straight course, (8.3)-(8.7)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from casid.errors import ModelError

from .equations import dynamics
from .hull import LOAD_CASES, Load, Ship
from .stability import require_way

Array = NDArray[np.float64]


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

        The heading, an integrator that nothing else depends on, is left out unless requested.
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
    require_way(ship, U, "requested")
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
    require_way(ship, U, "requested")
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
