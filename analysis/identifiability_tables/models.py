"""The pendulum and the ship of Linder (2017) as systems for the tests of identifiability.

Made of the models in `problems` that are fitted: the same expressions. Masses, inertias, heights,
springs and dampers are parameters; the sensor's height, gravity and speed are known, some generic
numbers. A record without the weight has m = 0; a calibration's weight and height are known.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import combinations
from typing import Any

import casadi as ca

from casid.identifiability.combinations.fixing_sets import Exclusion, count_not_identifiable, joined
from casid.identifiability.equations.model_system import system_of
from casid.identifiability.equations.system import System
from casid.identifiability.rank.observability import observability
from casid.identifiability.rank.rank_result import Observability
from problems import pendulum, ship
from problems.ship import FreeTurn

PENDULUM = ("M", "z_g", "k", "I_x", "d", "I_xm", "m", "z_m")
"""Parameters of (7.17)."""

PENDULUM_MASSES = ("I_x", "M", "z_g", "I_xm", "m", "z_m")
"""Of any three of these at most two are identifiable."""

SHIP_MASSES = ("A_x", "M", "zbar_g", "m", "zbar_m", "z_f")
"""The set Sx of Table 8.1."""

GYRO = ("gyro",)
BOTH = ("gyro", "accel")


# -- chapter 7 -------------------------------------------------------------------------------------


def pendulum_system(
    *, is_indirect: bool = False, outputs: Sequence[str] = GYRO, is_moved: bool = True
) -> System:
    """One record of the linear pendulum, all eight parameters of (7.17) unknown.

    Parameters
    ----------
    is_indirect : (7.24) with a_s as its known input, else (7.10) with the cart's acceleration a_y.
    outputs : of gyro and accel; the indirect model has the gyro alone.
    is_moved : a_y is not zero. With a_y = 0 the input a_s of the indirect model still moves, but is
        a function of the states, z_s phi'' + g phi with phi'' of (7.10).
    """
    model = pendulum.linear_model().with_unknown("M", "z_g", "I_xm", "m", "z_m")
    direct = _with_measured(system_of(model, generic=True), "a_y")
    if not is_indirect:
        kept = _with_outputs(direct, outputs)
        return kept if is_moved else kept.substituted({"a_y": 0.0})
    indirect = system_of(model.eliminate("a_y", using="accel"), generic=True)
    if is_moved:
        return indirect
    still = direct.substituted({"a_y": 0.0})
    return indirect.substituted({"accel": still.h[still.outputs.index("accel")]})


# -- chapter 8 -------------------------------------------------------------------------------------


def ship_system(
    *,
    is_indirect: bool = False,
    tied: bool = True,
    turn: FreeTurn = "K_r",
    outputs: Sequence[str] = GYRO,
) -> System:
    """One record of the ship with an unknown weight, all eleven parameters of (8.43) unknown.

    Parameters
    ----------
    is_indirect : (8.20) with a_s as a known input, else (8.10) with the sway acceleration v' known.
    tied, turn : as in `problems.ship.roll_model`.
    outputs : of gyro and accel; the indirect model has the gyro alone.
    """
    model = ship.roll_model(turn=turn, tied=tied).with_unknown("M", "zbar_g")
    if is_indirect:
        return system_of(model.eliminate("vdot", using="accel"), generic=True)
    return _with_outputs(_with_measured(system_of(model, generic=True), "vdot"), outputs)


def nominal(system: System) -> System:
    """The record without the weight; its height stands in no equation any more."""
    return system.substituted({"m": 0.0}).where(name="nominal")


def calibration(system: System, mass: str = "m_c", height: str = "zbar_c") -> System:
    """The ship's record with a known weight; calibrations of one name have one value."""
    known = system.with_known("m", "zbar_m").renamed({"m": mass, "zbar_m": height})
    return known.where(name=f"calibration {mass} {height}")


def ship_records(system: System) -> dict[str, tuple[System, ...]]:
    """The four sets of records of the rank table, by name."""
    first, second = calibration(system), calibration(system, height="zbar_c2")
    return {
        "single": (system,),
        "nominal + loaded": (nominal(system), system),
        "with calibration": (nominal(system), first, system),
        "with two heights": (nominal(system), first, second, system),
    }


def with_sought(system: System) -> System:
    """The ship with M and zbar_g known: the nine parameters of (8.62) are left."""
    return system.with_known("M", "zbar_g")


def ship_family(values: Mapping[str, Any], z_f: Any) -> dict[str, Any]:
    """The parameters with the axis of roll at `z_f` that have the same data in three records.

    The indirect model with z_s tied to z_f, nominal, calibrated and loaded; derived by asking that
    all five coefficients (8.24) of the three records stay. Exact for fractions and for symbols.

    Parameters
    ----------
    values : M, zbar_g, zbar_s, g, zbar_c (height of the calibration) and the nine of (8.62).
    z_f : another height of the axis [m].
    """
    v = values
    M, g, zbar_g, zbar_s = (v[n] for n in ("M", "g", "zbar_g", "zbar_s"))
    z_g, z_s = zbar_g + v["z_f"], zbar_s + v["z_f"]
    scale = (v["zbar_c"] + z_f) / (v["zbar_c"] + v["z_f"])
    K_vdot = scale * (v["K_vdot"] + M * z_g) - M * (zbar_g + z_f)
    inertia = scale * (v["A_x"] + M * z_g * (zbar_g - zbar_s) - v["K_vdot"] * z_s)
    moved = {n: scale * v[n] for n in ("d", "K_r", "K_delta")}
    return moved | {
        "k": scale * (v["k"] - v["K_vdot"] * g) + K_vdot * g,
        "A_x": inertia - M * (zbar_g + z_f) * (zbar_g - zbar_s) + K_vdot * (zbar_s + z_f),
        "K_vdot": K_vdot,
        "z_f": z_f,
        "m": scale * v["m"] * (v["zbar_m"] + v["z_f"]) / (v["zbar_m"] + z_f),
        "zbar_m": v["zbar_m"],
    }


def ship_slopes() -> dict[str, Fraction]:
    """d/dz_f along `ship_family` at the values of Tables 8.2 and 8.3."""
    import sympy

    symbol = sympy.Symbol("z_f")
    true = {n: sympy.Rational(str(v)) for n, v in true_ship().items()}
    rates = {n: sympy.diff(e, symbol) for n, e in ship_family(true, symbol).items()}
    at = {n: sympy.Rational(e.subs(symbol, true["z_f"])) for n, e in rates.items()}
    return {n: Fraction(int(r.p), int(r.q)) for n, r in at.items()}


def true_ship() -> dict[str, Fraction]:
    """The values of Tables 8.2 and 8.3 and of the calibration weight, exactly as printed."""
    weight = ship.LOAD_CASES["calibration"]
    printed = {**ship.TABLE_8_2, "m_c": weight["m"], "zbar_c": weight["zbar_m"]}
    return {n: Fraction(str(v)) for n, v in printed.items()}


# -- subsets ---------------------------------------------------------------------------------------


def excluded(found: Observability, size: int) -> Exclusion:
    """Sets of `size` parameters that are not identifiable, all others known."""
    point = found.points[0]
    rows, n_states = joined(point.full, [len(s) for s in point.states], point.prime)
    return count_not_identifiable(rows, n_states, point.parameters, size, point.prime)


def exclusions(systems: Sequence[System], sizes: Iterable[int]) -> dict[int, Exclusion]:
    """`excluded` for several sizes."""
    found = observability(systems)
    return {size: excluded(found, size) for size in sizes}


def holding(names: Sequence[str], size: int, rules: Iterable[Iterable[str]]) -> set[frozenset[str]]:
    """All sets of `size` names that hold at least one of the sets that a rule names."""
    minimal = [frozenset(r) for r in rules]
    every = (frozenset(s) for s in combinations(names, size))
    return {s for s in every if any(r <= s for r in minimal)}


def as_sets(exclusion: Exclusion) -> set[frozenset[str]]:
    """The sets that are not identifiable, order forgotten."""
    return {frozenset(s) for s in exclusion.failing}


def pendulum_rule() -> list[frozenset[str]]:
    """Table 7.1: (a) I_x with I_xm, (b) any three of the masses, inertias and heights."""
    return [frozenset({"I_x", "I_xm"}), *map(frozenset, combinations(PENDULUM_MASSES, 3))]


def ship_rule(turn: FreeTurn) -> list[frozenset[str]]:
    """Table 8.1: (a) any three of Sx, (b) {k, K_ur, K_vdot} with any two of Sx.

    Where K_r is the parameter and not K_ur, {k, K_vdot} with two of Sx suffices.
    """
    turning = {"k", "K_vdot"} | ({"K_ur"} if turn == "K_ur" else set())
    return [
        *map(frozenset, combinations(SHIP_MASSES, 3)),
        *(frozenset(turning | {*pair}) for pair in combinations(SHIP_MASSES, 2)),
    ]


def three_record_rule(turn: FreeTurn) -> list[frozenset[str]]:
    """Of three records: {A_x, M, zbar_g}, or the turning set with two of them."""
    turning = {"k", "K_vdot"} | ({"K_ur"} if turn == "K_ur" else set())
    hull = ("A_x", "M", "zbar_g")
    return [
        frozenset(hull),
        *(frozenset(turning | {*pair}) for pair in combinations(hull, 2)),
    ]


# -- inside ----------------------------------------------------------------------------------------


def _with_measured(system: System, unknown: str) -> System:
    """A system whose unknown input is known after all."""
    assert system.unknown_inputs == (unknown,)
    return system.where(inputs=(*system.inputs, unknown), unknown_inputs=())


def _with_outputs(system: System, outputs: Sequence[str]) -> System:
    rows = [system.h[system.outputs.index(y)] for y in outputs]
    return system.where(outputs=tuple(outputs), h=ca.vertcat(*rows))
