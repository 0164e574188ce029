"""Mass and centre of mass of a ship before it sails: by tilting a model, by ballasting a ship.

What later stages take as known, M and zbar_g, is estimated here from readings with their errors,
and handed on with its covariance: `as_prior`.

Tilting test (Linder 2017, section 9.2). A model rests on supports at L1 and L2 of its own long
axis, first level, then tilted by alpha, the supports at the height L3; each support's load m1, m2
is weighed. A load m stands at (xbar_m, zbar_m). Forces and moments, with ca = cos(alpha) and
sa = sin(alpha):

    m1 + m2 = M + m = m1t + m2t
    0 = L1 m1 + L2 m2 - m xbar_m - M xbar_g                                                (9.1)
    0 = m1t (L1 ca - L3 sa) + m2t (L2 ca - L3 sa) + m (zbar_m sa - xbar_m ca)
        + M (zbar_g sa - xbar_g ca)                                                        (9.2)

Ballasting (appendix B). Two tanks are filled before and after; pressures at the keel on both sides
give draft and heel. Lengths are counted from a reference point on the centre line, y to port, z
up, phi positive to starboard; for each of the two equilibria

    Mbar + m1 + m2 = rho nabla                                                             (B.2)
    Mbar (z sin phi - y cos phi) - m2 h2 cos(phi + phi2) + m1 h1 cos(phi1 - phi)
        = rho nabla l sin(phi)                                                             (B.1)

with (y, z) = Hbar (-sin phi_d, cos phi_d) the centre of mass of the ship without ballast. As all
other terms are moments about the reference point, l is the height of the metacentre above this
point: I_T / nabla - BG of (B.4) with BG counted from there. GM_T of (8.9a) and (B.9) is counted
from the centre of mass, GM_T = l - z_g, so that k = rho g nabla GM_T + M g z_g = rho g nabla l:
the plus sign of (B.9), since z_g points up here. Both equilibria use (B.1), which at phi = 0 is
(B.3).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

import casid
from casid.estimation.reconciliation import Reconciled, Reconciliation

Read = tuple[float, float]
"""A reading and its standard deviation."""


# -- the tilting test -----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Weighing:
    """The loads on the supports with one load m aboard [kg]; None where the scale ends.

    `zbar_m` [m], the height of the load, means nothing without one. `xbar_g` and `zbar_g` [m] are
    what was calculated from the weighing at the time, for comparison alone.
    """

    m: float
    m1: float
    m2: float
    m1t: float | None = None
    m2t: float | None = None
    zbar_m: float = 0.0
    xbar_g: float | None = None
    zbar_g: float | None = None


TABLE_9_2 = (
    Weighing(0.0, 11.57, 11.115, 14.690, 7.995, 0.0, -0.00178, 0.00728),
    Weighing(0.2, 11.67, 11.215, 14.850, 7.835, -0.256, -0.00181, 0.00734),
    Weighing(0.4, 11.77, 11.315, 15.015, 7.670, -0.268, -0.00185, 0.00728),
    Weighing(0.6, 11.87, 11.415, None, None, -0.280),
)
"""The published weighings; m1t of the last is beyond the scale's 15 kg. They contradict."""

DISPLACEMENT = (22.04, 0.01)
"""Of Table 9.1 [kg], with the last digit as its standard deviation."""


@dataclass(frozen=True, slots=True)
class Supports:
    """Where the supports are, each with its standard deviation [m, rad].

    xbar_m is the place of the load; zbar_sd the standard deviation of its height.
    """

    L1: Read
    L2: Read
    L3: Read
    alpha: Read
    xbar_m: Read
    zbar_sd: float = 0.001


ANYWHERE = Supports((-0.3, 0.15), (0.3, 0.15), (0.0, 0.3), (0.2, 0.1), (0.0, 0.2))
"""For the model of Table 9.1, 0.8 m long, all that one can say of an unpublished geometry."""


def tilting_equations(
    weighings: Sequence[Weighing],
    supports: Supports | None = None,
    *,
    M: Read | None = None,
    scale_sd: float = 0.005,
    load_sd: float = 0.001,
) -> Reconciliation:
    """Mass and centre of mass of a model from a tilting test, (9.1)-(9.2).

    Parameters
    ----------
    weighings : with several loads; lengths count from the mark that xbar_g and zbar_g count from.
    supports : None: the forces alone, which give M and show contradictions, whatever the geometry.
    M : the mass as it is known from elsewhere [kg], a reading like the others.
    scale_sd, load_sd : standard deviations of the scale and of the loads [kg].

    Returns
    -------
    Reconciliation
        Of M [kg], and with supports xbar_g and zbar_g [m].
    """
    if not weighings:
        raise casid.DataError("tilting test: no weighing; give one at least")
    r = Reconciliation("tilting test" if supports else "tilting test, forces")
    first = weighings[0]
    mass = first.m1 + first.m2 - first.m
    own = r.unknown("M", mass, "kg") if M is None else r.reading("M", *M, "kg")
    at: dict[str, Any] = {}
    if supports is not None:
        for name in ("L1", "L2", "L3", "xbar_m"):
            value, sd = getattr(supports, name)
            at[name] = r.reading(name, value, sd, "m")
        at["alpha"] = r.reading("alpha", *supports.alpha, "rad")
        x_g, z_g = r.unknown("xbar_g", 0.0, "m"), r.unknown("zbar_g", 0.0, "m")
        sin_a, cos_a = ca.sin(at["alpha"]), ca.cos(at["alpha"])
    for i, w in enumerate(weighings):
        case = f"[{w.m:g} kg]" if [v.m for v in weighings].count(w.m) == 1 else f"[{i + 1}]"
        m = r.reading(f"m{case}", w.m, load_sd, "kg") if w.m else ca.SX(0.0)
        m1, m2 = (r.reading(f"{n}{case}", getattr(w, n), scale_sd, "kg") for n in ("m1", "m2"))
        r.equation(f"force, level {case}", m1 + m2 - own - m)
        z_m: Any = 0.0
        if supports is not None:
            if w.m:
                z_m = r.reading(f"zbar_m{case}", w.zbar_m, supports.zbar_sd, "m")
            level = at["L1"] * m1 + at["L2"] * m2 - m * at["xbar_m"] - own * x_g
            r.equation(f"moment, level {case}", level)
        if w.m1t is None or w.m2t is None:
            continue
        t1 = r.reading(f"m1t{case}", w.m1t, scale_sd, "kg")
        t2 = r.reading(f"m2t{case}", w.m2t, scale_sd, "kg")
        r.equation(f"force, tilted {case}", t1 + t2 - own - m)
        if supports is not None:
            arm1, arm2 = (at[n] * cos_a - at["L3"] * sin_a for n in ("L1", "L2"))
            load = m * (z_m * sin_a - at["xbar_m"] * cos_a)
            tilted = t1 * arm1 + t2 * arm2 + load + own * (z_g * sin_a - x_g * cos_a)
            r.equation(f"moment, tilted {case}", tilted)
    return r


def tilting_test(
    weighings: Sequence[Weighing],
    supports: Supports | None = None,
    *,
    M: Read | None = None,
    scale_sd: float = 0.005,
    load_sd: float = 0.001,
) -> Reconciled:
    """Mass and centre of mass of a model from a tilting test; arguments as `tilting_equations`.

    Returns
    -------
    Reconciled
        M [kg], and with supports xbar_g and zbar_g [m]; `blamed` names readings that contradict.

    Raises
    ------
    IdentifiabilityError
        If alpha is exactly zero or nothing was weighed tilted: zbar_g is not seen.
    """
    equations = tilting_equations(weighings, supports, M=M, scale_sd=scale_sd, load_sd=load_sd)
    return equations.solve()


def calculated_results(
    weighings: Sequence[Weighing], supports: Supports, *, M: Read, rounding: float = 5e-6
) -> Reconciled:
    """Can the tabulated centres of mass have been calculated from these weighings?

    The readings are taken as they are, and the geometry is what must account for the results, each
    written to +- `rounding` [m]. Of several corrections that reconcile the forces alike, the one
    that was in mind agrees here.
    """
    r = Reconciliation("tabulated results of a tilting test")
    at = {"L1": supports.L1, "L2": supports.L2, "L3": supports.L3, "xbar_m": supports.xbar_m}
    L1, L2, L3, x_m = (r.reading(name, value, sd, "m") for name, (value, sd) in at.items())
    alpha, own = r.reading("alpha", *supports.alpha, "rad"), r.reading("M", *M, "kg")
    for w in weighings:
        if w.xbar_g is None or w.zbar_g is None or w.m1t is None or w.m2t is None:
            continue
        x_g, z_g = (
            r.reading(f"{n}[{w.m:g} kg]", getattr(w, n), rounding / 3**0.5, "m")
            for n in ("xbar_g", "zbar_g")
        )
        r.equation(f"(9.1) [{w.m:g} kg]", L1 * w.m1 + L2 * w.m2 - w.m * x_m - own * x_g)
        vertical = L3 * (w.m1t + w.m2t) - w.m * w.zbar_m
        level = L1 * (w.m1 - w.m1t) + L2 * (w.m2 - w.m2t)
        # Divided by sin(alpha): without a tilt anything would satisfy the product.
        r.equation(f"(9.2) [{w.m:g} kg]", vertical + level / ca.tan(alpha) - own * z_g)
    return r.solve()


# -- ballasting -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Tank:
    """What a tank holds in one equilibrium [kg], and where: distance h [m] and angle phi [rad].

    Tank 1 lies to starboard, at (y, z) = (-h cos phi, h sin phi), tank 2 to port, at
    (h cos phi, h sin phi).
    """

    m: Read
    h: Read
    phi: Read


@dataclass(frozen=True, slots=True)
class Equilibrium:
    """Tanks 1 and 2, and gauge pressures [Pa] at the keel at both ends of the beam."""

    tank1: Tank
    tank2: Tank
    starboard: Read
    port: Read


@dataclass(frozen=True, slots=True)
class Box:
    """A box-shaped hull: length, beam, and height of the reference point over the keel [m]."""

    length: Read
    beam: Read
    height: Read


def ballasting_equations(
    before: Equilibrium,
    after: Equilibrium,
    hull: Box,
    *,
    rho: Read = (1025.0, 0.0),
    g: float = 9.81,
) -> Reconciliation:
    """Two equilibria of a ship with ballast in two tanks, (B.1)-(B.9).

    Parameters
    ----------
    rho, g : density of the water [kg/m^3] and acceleration of gravity [m/s^2].

    Returns
    -------
    Reconciliation
        Of Mbar, ybar_g, zbar_up of the ship without ballast; M, y_g, z_g (up), H, GM_T and k of the
        ship as it is `after`; `zbar_g` = -z_g, which points down as in `problems.ship`.

    Notes
    -----
    (B.1) takes the metacentre as fixed; a box at heel phi rights itself more by the part
    (I_T / nabla) tan^2(phi) / 2 of its lever, 0.1 % of I_T / nabla at 2.6 degrees.
    """
    r = Reconciliation("ballasting")
    L, B = r.reading("length", *hull.length, "m"), r.reading("beam", *hull.beam, "m")
    height = r.reading("height", *hull.height, "m")
    water = r.reading("rho", *rho, "kg/m^3")
    area = hull.length[0] * hull.beam[0]
    weight = rho[0] * area * (before.port[0] + before.starboard[0]) / (2 * rho[0] * g)
    own = r.unknown("Mbar", weight - before.tank1.m[0] - before.tank2.m[0], "kg")
    y = r.unknown("ybar_g", 0.0, "m", scale=hull.beam[0])
    z = r.unknown("zbar_up", 0.0, "m", scale=hull.beam[0])
    total, moment_y, moment_z, stiffness = own, own * y, own * z, ca.SX(0.0)
    start = 0.0
    for case, at in (("[before]", before), ("[after]", after)):
        tanks = {}
        for number, tank in ((1, at.tank1), (2, at.tank2)):
            m = r.reading(f"m{number}{case}", *tank.m, "kg")
            h = r.reading(f"h{number}{case}", *tank.h, "m")
            angle = r.reading(f"phi{number}{case}", *tank.phi, "rad")
            tanks[number] = (m, h, angle)
        depths = (at.starboard[0] / (rho[0] * g), at.port[0] / (rho[0] * g))
        heel = float(np.arcsin(np.clip((depths[0] - depths[1]) / hull.beam[0], -1, 1)))
        D = r.unknown(f"draft{case}", sum(depths) / 2 / np.cos(heel), "m")
        phi = r.unknown(f"phi{case}", heel, "rad", scale=0.1)
        for side, sign, p in (("starboard", 1, at.starboard), ("port", -1, at.port)):
            read = r.reading(f"p_{side}{case}", *p, "Pa")
            depth = D * ca.cos(phi) + sign * B / 2 * ca.sin(phi)
            r.equation(f"pressure, {side} {case}", read / (rho[0] * g) - water / rho[0] * depth)
        nabla = L * B * D
        (m1, h1, phi1), (m2, h2, phi2) = tanks[1], tanks[2]
        r.equation(f"force {case}", own + m1 + m2 - water * nabla)
        lever = B**3 * L / 12 / nabla - (height - D / 2)  # (B.4), from the reference point
        r.equation(
            f"moment {case}",
            own * (z * ca.sin(phi) - y * ca.cos(phi))
            - m2 * h2 * ca.cos(phi + phi2)
            + m1 * h1 * ca.cos(phi1 - phi)
            - water * nabla * lever * ca.sin(phi),
        )
        total = own + m1 + m2  # those of the last equilibrium remain
        moment_y = own * y - m1 * h1 * ca.cos(phi1) + m2 * h2 * ca.cos(phi2)
        moment_z = own * z + m1 * h1 * ca.sin(phi1) + m2 * h2 * ca.sin(phi2)
        stiffness = water * g * nabla * lever
        start = g * rho[0] * area * sum(depths) / 2
    M = r.derived("M", total, start / g, "kg")
    y_g = r.derived("y_g", moment_y / M, 0.0, "m")
    z_g = r.derived("z_g", moment_z / M, 0.0, "m")
    r.derived("zbar_g", -z_g, 0.0, "m")
    # H has no slope where the centre of mass is in the reference point: away from there it has.
    r.derived("H", ca.sqrt(y_g**2 + z_g**2 + 1e-30), hull.beam[0] / 10, "m")
    k = r.derived("k", stiffness, start * hull.beam[0] / 10, "N m/rad")
    r.derived("GM_T", k / (M * g) - z_g, hull.beam[0] / 10, "m")
    return r


def ballasting(
    before: Equilibrium,
    after: Equilibrium,
    hull: Box,
    *,
    rho: Read = (1025.0, 0.0),
    g: float = 9.81,
) -> Reconciled:
    """Mass, centre of mass and restoring coefficient of a ship; as `ballasting_equations`, solved.

    Raises
    ------
    IdentifiabilityError
        If both equilibria are upright: the height of the centre of mass is not seen.
    """
    return ballasting_equations(before, after, hull, rho=rho, g=g).solve()


# -- what later stages know -----------------------------------------------------------------------


def as_prior(found: Reconciled, names: Mapping[str, str] | Sequence[str]) -> casid.Prior:
    """Some of the quantities as known parameters of a later stage, with their covariance.

    Parameters
    ----------
    names : quantities whose names are those of the model's parameters, or a mapping of the model's
        parameter -> quantity.

    Raises
    ------
    DataError
        If the readings contradict one another: what is known is then not known.
    """
    if not found.is_consistent:
        blamed = "; ".join(str(b) for b in found.blamed)
        raise casid.DataError(
            f"{found.title}: the readings contradict one another (p = {found.p_value:.2g}); "
            f"settle first what is wrong with {blamed}"
        )
    pairs = dict(names) if isinstance(names, Mapping) else {n: n for n in names}
    values = {parameter: found[quantity] for parameter, quantity in pairs.items()}
    return casid.Prior(values, found.covariance_of(list(pairs.values())))
