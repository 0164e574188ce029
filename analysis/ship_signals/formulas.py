"""How the ship's signals depend on one another: (8.22)-(8.38), as functions of s.

    y = phi' = G (a_s + F_r r + F_d delta + tau'),   a_s = F_y y - v' - U r            (8.22)-(8.30)

with tau' = -tau/(K_vdot + S): the torque on the scale of the accelerometer. Every function works
on numbers and on sympy symbols alike, so that an identity and its check are one text. What the
thesis prints wrongly is here too, named `printed_...`, to be shown wrong.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from analysis.ship_signals.model import NEGLECTED, UNITS, symbolic_matrices
from casid.errors import ModelError
from casid.linear.laplace import solve

Expr = Any  # a complex number or a sympy expression


@dataclass(frozen=True, slots=True)
class Roll:
    """The roll subsystem at one s (8.22)-(8.24), and the accelerometer's F_y."""

    G: Expr
    F_r: Expr
    F_d: Expr
    F_y: Expr
    U: Expr

    @property
    def G0(self) -> Expr:
        """G/(1 - F_y G) (8.27)."""
        return self.G / (1 - self.F_y * self.G)


@dataclass(frozen=True, slots=True)
class Hull:
    """The polynomials of the sway and the yaw row at one s (8.33)-(8.35); `Gy` is the thesis' G'.

    A v' = C y + D r + E delta,   B r = F y + Gy v' + H delta.
    """

    A: Expr
    B: Expr
    C: Expr
    D: Expr
    E: Expr
    F: Expr
    Gy: Expr
    H: Expr

    @property
    def determinant(self) -> Expr:
        """A B - D G'."""
        return self.A * self.B - self.D * self.Gy

    @property
    def vdot_y(self) -> Expr:
        """From roll rate to sway acceleration (8.33)-(8.35)."""
        return (self.C * self.B + self.D * self.F) / self.determinant

    @property
    def vdot_delta(self) -> Expr:
        """From rudder to sway acceleration, the roll held."""
        return (self.D * self.H + self.E * self.B) / self.determinant

    @property
    def r_y(self) -> Expr:
        """From roll rate to yaw rate (8.33)-(8.35)."""
        return (self.F * self.A + self.Gy * self.C) / self.determinant

    @property
    def r_delta(self) -> Expr:
        """From rudder to yaw rate, the roll held."""
        return (self.Gy * self.E + self.H * self.A) / self.determinant


def coefficients(q: Mapping[str, Expr]) -> dict[str, Expr]:
    """A_2 (8.18) and alpha1, alpha2, beta1, kappa1, gamma1 (8.22)-(8.24)."""
    for name in NEGLECTED:
        if q.get(name, 0) != 0:
            raise ModelError(
                f"roll balance: {name} = {q[name]} is left out of (8.8)-(8.38). Set it to 0, or "
                "use the five states, frequency_response()."
            )
    A_2 = q["A_x"] - q["z_s"] * (q["K_vdot"] + q["S"])
    spring = q["hull"] - q["K_phiuu"] * q["U"] ** 2  # k + S g
    return {
        "A_2": A_2,
        "alpha1": q["d"] / A_2,
        "alpha2": (spring - (q["S"] + q["K_vdot"]) * q["g"]) / A_2,
        "beta1": -(q["K_vdot"] + q["S"]) / A_2,
        "kappa1": (q["K_ur"] - q["K_vdot"]) * q["U"] / A_2,
        "gamma1": -q["z_r"] * q["C2"] / A_2,
    }


def roll_at(q: Mapping[str, Expr], s: Expr) -> Roll:
    """The roll subsystem from the symbols' values."""
    c = coefficients(q)
    return Roll(
        G=c["beta1"] * s / (s**2 + c["alpha1"] * s + c["alpha2"]),
        F_r=c["kappa1"] / c["beta1"],
        F_d=c["gamma1"] / c["beta1"],
        F_y=(q["z_s"] * s**2 + q["g"]) / s,
        U=q["U"],
    )


def hull_at(q: Mapping[str, Expr], s: Expr) -> Hull:
    """A to H of the sway and the yaw row (8.33)-(8.35)."""
    U = q["U"]
    return Hull(
        A=(q["M_t"] - q["Y_vdot"]) * s - q["Y_uv"] * U,
        B=s * (q["A_z"] * s - q["N_ur"] * U),
        C=(q["S"] + q["Y_pdot"]) * s**2 + q["Y_phiuu"] * U**2,
        D=s * (q["Y_rdot"] * s + (q["Y_ur"] - q["M_t"]) * U),
        E=s * q["C2"],
        F=q["N_pdot"] * s**2 + q["N_p"] * s + q["N_phiuu"] * U**2,
        Gy=q["N_vdot"] * s + q["N_uv"] * U,
        H=s * q["x_r"] * q["C2"],
    )


# -- rudder and torque to the three signals ------------------------------------------------------


def y_of_delta(k: Roll, G_dr: Expr, G_dv: Expr) -> Expr:
    """G_dy = G0 [(F_r - U) G_dr - G_dv + F_d] (8.28)-(8.30)."""
    return k.G0 * ((k.F_r - k.U) * G_dr - G_dv + k.F_d)


def a_s_of_delta(k: Roll, G_dr: Expr, G_dv: Expr) -> Expr:
    """G_das = [F_y G (F_d + F_r G_dr) - (G_dv + U G_dr)]/(1 - F_y G) (8.31), sign corrected."""
    own = k.F_y * k.G * (k.F_d + k.F_r * G_dr)
    return (own - (G_dv + k.U * G_dr)) / (1 - k.F_y * k.G)


def printed_8_31(k: Roll, G_dr: Expr, G_dv: Expr) -> Expr:
    """(8.31) as printed: - (G_dv - U G_dr)."""
    own = k.F_y * k.G * (k.F_d + k.F_r * G_dr)
    return (own - (G_dv - k.U * G_dr)) / (1 - k.F_y * k.G)


def a_s_without_sway(k: Roll, G_dr: Expr) -> Expr:
    """(8.86) corrected: simulates a_s for instruments, with G_dv not known and set to 0."""
    return a_s_of_delta(k, G_dr, 0)


def printed_8_86(k: Roll, G_dr: Expr) -> Expr:
    """(8.86) as printed: G0 [..] without F_y, and + U G_dr."""
    return k.G0 * (k.F_d + k.F_r * G_dr) + k.U * G_dr / (1 - k.F_y * k.G)


def responses(k: Roll, h: Hull, torque: Expr) -> dict[str, Expr]:
    """All eight "signal/input" of the closed loop, from (8.22)-(8.35); torque = 1/-(K_vdot + S).

    Sway and yaw depend on the roll rate as on the rudder, so that the loop round G is closed by
    Fbar_y and by F_r r together.
    """
    loop = 1 - k.G * (loop_a_s(k, h) + k.F_r * h.r_y)
    outside = {
        "delta": k.F_d + (k.F_r - k.U) * h.r_delta - h.vdot_delta,
        "tau": torque,
    }
    made: dict[str, Expr] = {}
    for u, drive in outside.items():
        y = k.G * drive / loop
        r = h.r_y * y + (h.r_delta if u == "delta" else 0)
        vdot = h.vdot_y * y + (h.vdot_delta if u == "delta" else 0)
        made |= {
            f"gyro/{u}": y,
            f"yaw/{u}": r,
            f"vdot/{u}": vdot,
            f"accel/{u}": k.F_y * y - vdot - k.U * r,
        }
    return made


# -- the loops and their direct terms ------------------------------------------------------------


def loop_a_s(k: Roll, h: Hull) -> Expr:
    """Fbar_y: roll rate to accelerometer, through sway and yaw (8.36)-(8.38)."""
    return k.F_y - h.vdot_y - k.U * h.r_y


def direct_term_a_s(q: Mapping[str, Expr]) -> Expr:
    """lim G Fbar_y as s grows: what the torque finds of itself in a_s without delay (8.36)-(8.38).

    beta1 {z_s - [(S + Y_pdot) A_z + Y_rdot N_pdot]/[(M_t - Y_vdot) A_z - Y_rdot N_vdot]}
    """
    top = (q["S"] + q["Y_pdot"]) * q["A_z"] + q["Y_rdot"] * q["N_pdot"]
    return coefficients(q)["beta1"] * (q["z_s"] - top / _added(q))


def yaw_limit(q: Mapping[str, Expr]) -> Expr:
    """lim r/y as s grows, corrected: [N_pdot (M_t - Y_vdot) + N_vdot (S + Y_pdot)]/[..].

    Finite, so the r-loop G F_r r/y, which has one more integration, has no direct term.
    """
    top = q["N_pdot"] * (q["M_t"] - q["Y_vdot"]) + q["N_vdot"] * (q["S"] + q["Y_pdot"])
    return top / _added(q)


def printed_yaw_limit(q: Mapping[str, Expr]) -> Expr:
    """The same with the coefficient of (8.37)-(8.38) as printed, N_vdot left out."""
    top = q["N_pdot"] * (q["M_t"] - q["Y_vdot"]) + (q["S"] + q["Y_pdot"])
    return top / _added(q)


def _added(q: Mapping[str, Expr]) -> Expr:
    return (q["M_t"] - q["Y_vdot"]) * q["A_z"] - q["Y_rdot"] * q["N_vdot"]


# -- symbolic -----------------------------------------------------------------------------------


def symbols() -> dict[str, Expr]:
    """A sympy symbol for each symbol of the model; those (8.8) leaves out are 0."""
    import sympy

    return {n: sympy.Integer(0) if n in NEGLECTED else sympy.Symbol(n) for n in UNITS}


def symbolic_rows() -> Expr:
    """The model's rows of sway, yaw and roll in v', r, y and delta, tau: (3, 5), times s.

    The Laplace transform of (8.3) with phi = y/s and v = v'/s, out of the casid model.
    """
    import sympy

    s = sympy.Symbol("s")
    E, F, B = (m.subs(dict.fromkeys(NEGLECTED, 0)) for m in symbolic_matrices())
    left = (s * E - F) * sympy.Matrix([[0, 0, 1], [0, 0, 0], [1, 0, 0], [0, 0, s], [0, s, 0]])
    rows = left.row_join(-s * B).extract([2, 4, 3], [0, 1, 2, 3, 4])
    return rows.applyfunc(sympy.expand)


def hull_residue() -> Expr:
    """The model's sway and yaw rows minus (8.33)-(8.35), (2, 5): identically zero."""
    import sympy

    h = hull_at(symbols(), sympy.Symbol("s"))
    printed = sympy.Matrix([[h.A, -h.D, -h.C, -h.E, 0], [-h.Gy, h.B, -h.F, -h.H, 0]])
    return (symbolic_rows()[:2, :] - printed).applyfunc(sympy.expand)


def roll_residue() -> Expr:
    """The model's roll row minus (8.22), y - G (F_y y - v' + (F_r - U) r + F_d delta + tau'): 0."""
    import sympy

    q, s = symbols(), sympy.Symbol("s")
    k, row = roll_at(q, s), symbolic_rows().row(2)
    torque = -1 / (q["K_vdot"] + q["S"])
    wanted = [k.G, k.G * (k.U - k.F_r), 1 - k.G * k.F_y, -k.G * k.F_d, -k.G * torque]
    scale = row[0] / k.G
    return sympy.Matrix([[sympy.cancel(a - scale * b) for a, b in zip(row, wanted, strict=True)]])


def loop_residue() -> dict[str, Expr]:
    """`responses` put back into (8.22) and the two hull rows; (8.30), (8.31) minus them: zeros.

    G, F_y, F_r, F_d and A to H are symbols here, so these are identities whatever those are.
    `roll_residue` and `hull_residue` say what they are.
    """
    import sympy

    k, torque = Roll(*sympy.symbols("G F_r F_d F_y U")), sympy.Symbol("torque")
    h = Hull(*sympy.symbols("A B C D E F Gy H"))
    found = responses(k, h, torque)
    residue: dict[str, Expr] = {}
    for u, rudder, drive in (("delta", 1, k.F_d), ("tau", 0, torque)):
        y, r, v, a = (found[f"{name}/{u}"] for name in ("gyro", "yaw", "vdot", "accel"))
        residue |= {
            f"sway row, {u}": h.A * v - h.C * y - h.D * r - h.E * rudder,
            f"yaw row, {u}": h.B * r - h.F * y - h.Gy * v - h.H * rudder,
            f"roll row, {u}": y - k.G * (a + k.F_r * r + drive),
            f"accelerometer, {u}": a - (k.F_y * y - v - k.U * r),
        }
    G_dr, G_dv = sympy.symbols("G_dr G_dv")
    y, a = y_of_delta(k, G_dr, G_dv), a_s_of_delta(k, G_dr, G_dv)
    residue |= {
        "(8.30)": y - k.G * (a + k.F_r * G_dr + k.F_d),
        "(8.31)": a - (k.F_y * y - G_dv - k.U * G_dr),
    }
    return {name: sympy.cancel(left) for name, left in residue.items()}


def symbolic_direct_terms() -> dict[str, Expr]:
    """What a unit torque does at once, by the model's mass matrix: a_s, and p', r' beside it."""
    import sympy

    E, _, B = (m.subs(dict.fromkeys(NEGLECTED, 0)) for m in symbolic_matrices())
    vdot, pdot, rdot = solve(E[2:, 2:], B[2:, 1])
    z_s = sympy.Symbol("z_s")
    return {"a_s": sympy.cancel(z_s * pdot - vdot), "p'": pdot, "r'": rdot}
