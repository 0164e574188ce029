"""Five block diagrams of the ship's signals, after the equations that belong to Figures 8.4-8.8.

Each shows one step of section 8.2: the roll subsystem alone, the accelerometer that feeds it, the
rudder's three ways into it, what sway and yaw make of the roll, and the loops of the torque. They
follow the equations; the layout is our own. Blocks have the names of `gains`, so that a diagram
can be solved at any s and compared with the formulas.
"""

from __future__ import annotations

from collections.abc import Mapping

from analysis.ship_signals.blocks import Diagram, Kind, Node, Point, wires
from analysis.ship_signals.formulas import Hull, Roll, responses

NOTES = {
    "G": "beta1 s/(s^2 + alpha1 s + alpha2)",
    "F_r": "kappa1/beta1 = -K_r/(K_vdot + S)",
    "F_d": "gamma1/beta1 = -K_delta/(K_vdot + S)",
    "F_y": "(z_s s^2 + g)/s",
    "U": "speed",
    "G_dr": "rudder to yaw rate",
    "G_dv": "rudder to sway acceleration",
    "1/A": "1/((M_t - Y_vdot) s - Y_|u|v U)",
    "1/B": "1/(s (A_z s - N_|u|r U))",
    "C": "(S + Y_pdot) s^2 + Y_phiuu U^2",
    "D": "s (Y_rdot s + (Y_ur - M_t) U)",
    "E": "s C2",
    "F": "N_pdot s^2 + N_p s + N_phiuu U^2",
    "G'": "N_vdot s + N_|u|v U",
    "H": "s x_r C2",
    "V_y": "(C B + D F)/(A B - D G')",
    "R_y": "(F A + G' C)/(A B - D G')",
}
TEXT = {
    "F_r": "F<sub>r</sub>", "F_d": "F<sub>\u03b4</sub>", "F_y": "F<sub>y</sub>",
    "G_dr": "G<sub>\u03b4r</sub>", "G_dv": "G<sub>\u03b4v</sub>", "a_s": "a<sub>s</sub>",
    "delta": "\u03b4", "tau": "\u03c4", "y": "y<sub>O</sub>", "vdot": "v\u0307",
    "V_y": "V<sub>y</sub>", "R_y": "R<sub>y</sub>",
}  # fmt: skip


def gains(k: Roll, h: Hull, rudder: Mapping[str, complex] | None = None) -> dict[str, complex]:
    """Gain of every block at one s; `rudder` has the responses "yaw/delta" and "vdot/delta"."""
    made: dict[str, complex] = {
        "G": k.G, "F_r": k.F_r, "F_d": k.F_d, "F_y": k.F_y, "U": k.U,
        "1/A": 1 / h.A, "1/B": 1 / h.B, "C": h.C, "D": h.D, "E": h.E, "F": h.F, "G'": h.Gy,
        "H": h.H, "V_y": h.vdot_y, "R_y": h.r_y,
    }  # fmt: skip
    if rudder is not None:
        made |= {"G_dr": rudder["yaw/delta"], "G_dv": rudder["vdot/delta"]}
    return made


def _node(name: str, kind: Kind, at: Point) -> Node:
    """A node with its symbol and note; what follows a dot distinguishes equal symbols."""
    base = name.split(".")[0]
    return Node(name, kind, at, TEXT.get(base, base), NOTES.get(base, ""))


def _nodes(**kinds: Mapping[str, Point]) -> tuple[Node, ...]:
    made: list[Node] = []
    for kind in ("block", "sum", "tap", "source", "sink"):
        made += [_node(name, kind, at) for name, at in kinds.get(kind, {}).items()]
    return tuple(made)


def roll_subsystem() -> Diagram:
    """(8.22)-(8.24): what the roll rate is made of."""
    return Diagram(
        "The roll rate y<sub>O</sub> is made of accelerometer, yaw rate, rudder and torque: "
        "(8.22)-(8.24), as Figure 8.4",
        _nodes(
            source={"a_s": (0, 0), "r": (0, 1), "delta": (0, 2), "tau": (3.2, -1)},
            block={"F_r": (1.3, 1), "F_d": (1.3, 2), "G": (4.4, 0)},
            sum={"+1": (2.4, 0), "+2": (3.2, 0)},
            sink={"y": (5.8, 0)},
        ),
        wires(
            ("a_s", "+1", "+2", "G", "y"),
            ("r", "F_r", (2.4, 1), "+1"),
            ("delta", "F_d", (3.2, 2), "+2"),
            ("tau", "+2"),
        ),
    )


def accelerometer_loop() -> Diagram:
    """(8.22)-(8.27): the accelerometer is itself made of the roll rate."""
    return Diagram(
        "The accelerometer closes a loop round G by F<sub>y</sub>; v\u0307 and r come from "
        "outside the roll: (8.22)-(8.27), as Figure 8.5",
        _nodes(
            source={"vdot": (2.8, -1), "r": (0, 1), "delta": (0, 2), "tau": (5.8, -0.8)},
            block={
                "U": (1.7, 0), "F_r": (3.6, 1), "F_d": (3.6, 2), "G": (7, 0), "F_y": (6.8, -1.6),
            },
            sum={"+0": (2.8, 0), "+1": (3.6, 0), "+2": (5, 0), "+3": (5.8, 0)},
            tap={".r": (0.8, 1), ".a": (4.3, 0), ".y": (8, 0)},
            sink={"a_s": (4.3, -0.8), "y": (8.8, 0)},
        ),
        wires(
            ("r", ".r", (0.8, 0), "U", -1, "+0", "+1", ".a", "+2", "+3", "G", ".y", "y"),
            ("vdot", -1, "+0"),
            (".a", "a_s"),
            (".r", "F_r", (5, 1), "+2"),
            ("delta", "F_d", (5.8, 2), "+3"),
            ("tau", "+3"),
            (".y", (8, -1.6), "F_y", (3.6, -1.6), "+1"),
        ),
    )  # fmt: skip


def rudder_paths() -> Diagram:
    """(8.28)-(8.31): three ways from the rudder, all known to be external."""
    return Diagram(
        "The rudder acts directly, by the turn and by the sway: (8.28)-(8.31), as Figure 8.6",
        _nodes(
            source={"delta": (0, 2)},
            block={
                "G_dr": (1.8, 1), "G_dv": (1.8, -1), "U": (3.6, 0), "F_r": (4.6, 1),
                "F_d": (4.6, 2), "G": (8.4, 0), "F_y": (8, -1.6),
            },
            sum={"+0": (4.7, 0), "+1": (5.4, 0), "+2": (6.7, 0), "+3": (7.4, 0)},
            tap={
                ".d1": (0.8, 2), ".d2": (0.8, 1), ".r": (2.8, 1), ".a": (6, 0), ".y": (9.3, 0),
            },
            sink={"a_s": (6, -0.8), "y": (10.1, 0)},
        ),
        wires(
            ("delta", ".d1", "F_d", (7.4, 2), "+3"),
            (".d1", ".d2", "G_dr", ".r", (2.8, 0), "U", -1, "+0", "+1", ".a", "+2", "+3"),
            ("+3", "G", ".y", "y"),
            (".d2", (0.8, -1), "G_dv", (4.7, -1), -1, "+0"),
            (".r", "F_r", (6.7, 1), "+2"),
            (".a", "a_s"),
            (".y", (9.3, -1.6), "F_y", (5.4, -1.6), "+1"),
        ),
    )  # fmt: skip


def sway_and_yaw() -> Diagram:
    """(8.33)-(8.35): the rows of sway and yaw, driven by the roll rate and the rudder."""
    return Diagram(
        "Sway and yaw answer the roll rate as they answer the rudder: (8.33)-(8.35), "
        "as Figure 8.7",
        _nodes(
            source={"y": (-0.4, 1.5), "delta": (-0.4, -1.5)},
            block={
                "C": (2, 1.5), "E": (2, 0.6), "F": (2, -0.6), "H": (2, -1.5), "1/A": (5.2, 1.5),
                "D": (5.2, 0.5), "G'": (5.2, -0.5), "1/B": (5.2, -1.5),
            },
            sum={"+v1": (3.2, 1.5), "+v2": (4, 1.5), "+r1": (3.2, -1.5), "+r2": (4, -1.5)},
            tap={".d": (0.4, -1.5), ".y": (0.9, 1.5), ".v": (6.8, 1.5), ".r": (6.3, -1.5)},
            sink={"vdot": (7.6, 1.5), "r": (7.6, -1.5)},
        ),
        wires(
            ("y", ".y", "C", "+v1", "+v2", "1/A", ".v", "vdot"),
            ("delta", ".d", "H", "+r1", "+r2", "1/B", ".r", "r"),
            (".y", (0.9, -0.6), "F", (3.2, -0.6), "+r1"),
            (".d", (0.4, 0.6), "E", (3.2, 0.6), "+v1"),
            (".r", (6.3, 0.5), "D", (4, 0.5), "+v2"),
            (".v", (6.8, -0.5), "G'", (4, -0.5), "+r2"),
        ),
    )  # fmt: skip


def torque_loops() -> Diagram:
    """(8.36)-(8.38): the torque's two loops, by a_s with a direct term and by r without one."""
    return Diagram(
        "The torque comes back by a<sub>s</sub>, part of it at once, and by r, never at once: "
        "(8.36)-(8.38), as Figure 8.8",
        _nodes(
            source={"tau": (4.4, 0.9)},
            block={
                "G": (5.6, 0), "F_y": (5.4, -1.6), "V_y": (5.4, -2.5), "R_y": (5.4, -3.4),
                "U": (2.2, -3.4), "F_r": (3.4, -0.8),
            },
            sum={"+A": (1, -2.5), "+B": (1, -1.6), "+2": (3.4, 0), "+3": (4.4, 0)},
            tap={
                ".y": (6.8, 0), ".y1": (6.8, -1.6), ".y2": (6.8, -2.5), ".r": (3.4, -3.4),
                ".a": (1.8, 0),
            },
            sink={"y": (7.6, 0), "a_s": (1.8, 0.8), "r": (3.4, -4.1)},
        ),
        wires(
            ("tau", "+3", "G", ".y", "y"),
            (".y", ".y1", ".y2", "V_y", -1, "+A", "+B", (1, 0), ".a", "+2", "+3"),
            (".y1", "F_y", "+B"),
            (".y2", (6.8, -3.4), "R_y", ".r", "U", (1, -3.4), -1, "+A"),
            (".r", "F_r", "+2"),
            (".r", "r"),
            (".a", "a_s"),
        ),
    )  # fmt: skip


def diagrams() -> dict[str, Diagram]:
    """Name of the file -> diagram."""
    return {
        "figure_8_4_roll_subsystem": roll_subsystem(),
        "figure_8_5_accelerometer_loop": accelerometer_loop(),
        "figure_8_6_rudder_paths": rudder_paths(),
        "figure_8_7_sway_and_yaw": sway_and_yaw(),
        "figure_8_8_torque_loops": torque_loops(),
    }


def worst_departure(k: Roll, h: Hull, *, torque: complex) -> dict[str, float]:
    """Largest relative distance of each diagram's signals from the formulas, at one s.

    Parameters
    ----------
    torque : what a unit torque is on the accelerometer's scale, -1/(K_vdot + S).
    """
    full = responses(k, h, torque)
    g = gains(k, h, full)
    found: dict[str, float] = {}

    def compare(name: str, got: Mapping[str, complex], wanted: Mapping[str, complex]) -> None:
        apart = max(abs(got[n] - x) / abs(x) for n, x in wanted.items())
        found[name] = max(found.get(name, 0.0), apart)

    names = list(diagrams())
    for u in ("delta", "tau"):
        y, a, r, v = (full[f"{n}/{u}"] for n in ("gyro", "accel", "yaw", "vdot"))
        on = {"delta": 1.0} if u == "delta" else {"tau": torque}
        roll, loop, rudder, hull, torques = diagrams().values()
        compare(names[0], roll.respond(g, on | {"a_s": a, "r": r}), {"y": y})
        compare(names[1], loop.respond(g, on | {"vdot": v, "r": r}), {"y": y, "a_s": a})
        sway = {"y": y, "delta": on.get("delta", 0.0)}
        compare(names[3], hull.respond(g, sway), {"vdot": v, "r": r})
        if u == "delta":
            compare(names[2], rudder.respond(g, on), {"y": y, "a_s": a})
        else:
            compare(names[4], torques.respond(g, on), {"y": y, "a_s": a, "r": r})
    return found
