"""The template of a DC motor, with or without a gearbox behind it."""

from __future__ import annotations

from casid.data.templates.draft import Draft
from casid.data.templates.roles import Role
from casid.data.templates.template import Body, Template
from casid.data.templates.weak_form import weak_form

ROLES = (
    Role("voltage", "input", ("V",), "volt spannung u ua um motor mot arm", "batt supply"),
    Role("current", "output", ("A",), "current strom amp i ia im motor mot arm", "batt supply"),
    Role("speed", "output", ("rad/s",), "speed drehzahl omega n w rpm vel rate geschw", "set soll"),
    Role("angle", "output", ("rad",), "angle winkel pos theta phi encoder", "set soll ref"),
)


def write(d: Draft) -> Body:
    """Armature and rotor; what the file cannot determine is taken as known."""
    d.require_one_of("speed", "angle")
    d.require_one_of("voltage", "current")
    has_voltage, has_both = d.has("voltage"), d.has("voltage", "current")
    geared = d.has("angle") or not _is_of_rotor(d)
    start = _starts(d, d.value("N", 1.0))
    resistance, constant = "resistance of the armature", "torque constant (and of the back-EMF)"
    if has_both:
        R = d.unknown("R", "ohm", start["R"], resistance)
        K = d.unknown("K", "N m/A", start["K"], constant)
    else:  # the scale of the torque is not in the file
        R = d.known("R", "ohm", 1.0, resistance) if has_voltage else ""
        K = d.known("K", "N m/A", 0.05, constant)
    return Body(
        equations=[
            "R i = U - K w        armature; its inductance is neglected" if has_voltage else "",
            "J dw/dt = K i - b w  torque on the rotor",
            "dtheta/dt = w / N    shaft behind a gearbox; N = 1 without one" if geared else "",
        ],
        inputs=[
            d.input("voltage", "U", "across the armature")
            if has_voltage
            else d.input("current", "i", "through the armature")
        ],
        states=[
            'w = m.state("w", "rad/s")  # speed of the rotor',
            'theta = m.state("theta", "rad")  # angle of the shaft' if d.has("angle") else "",
        ],
        parameters=[
            R,
            K,
            d.unknown("J", "kg m^2", start["J"], "moment of inertia, seen by the rotor"),
            d.unknown("b", "N m s/rad", start["b"], "viscous friction", sign="zero", default=1e-4),
            d.known("N", "1", 1.0, "turns of the rotor for one of the shaft") if geared else "",
        ],
        relations=[
            "i = (U - K * w) / R" if has_voltage else "",
            "m.derivative(theta, w / N)" if d.has("angle") else "",
            'm.balance(w, "torque", inertia=J, terms=[K * i, -b * w], unit="N m")',
        ],
        outputs=[
            d.output("current", "i") if has_both else "",
            d.output("speed", "w" if _is_of_rotor(d) else "w / N") if d.has("speed") else "",
            d.output("angle", "theta") if d.has("angle") else "",
        ],
    )


def _is_of_rotor(d: Draft) -> bool:
    """True if the speed is said to be the rotor's own."""
    if not d.has("speed"):
        return False
    return any(p in word for word in d.columns["speed"].words for p in ("mot", "rotor"))


def _starts(d: Draft, N: float) -> dict[str, float | None]:
    """R, K, J and b, from a regression for each of the two equations."""
    Ts = d.file.Ts
    if d.has("speed"):
        w, order = d["speed"] * (1.0 if _is_of_rotor(d) else N), 0
    else:
        w, order = d["angle"] * N, 1
    R, K = d.value("R", 1.0), d.value("K", 0.05)
    if d.has("voltage", "current"):
        armature = weak_form((d["voltage"], 0), [(d["current"], 0), (w, order)], Ts)
        if armature is not None:
            R, K = (float(x) for x in armature)
    if d.has("current"):
        drive, feedback = K * d["current"], 0.0
    else:
        drive, feedback = K / R * d["voltage"], K**2 / R
    torque = weak_form((drive, 0), [(w, order + 1), (w, order)], Ts)
    J, b = (None, None) if torque is None else (float(torque[0]), float(torque[1]) - feedback)
    return {"R": R, "K": K, "J": J, "b": b}


DC_MOTOR = Template("dc-motor", "DC motor", lambda file: ROLES, write)
