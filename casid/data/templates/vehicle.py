"""The template of a vehicle along the road: rolling resistance, drag, slope."""

from __future__ import annotations

import numpy as np

from casid.data.templates.draft import Draft
from casid.data.templates.roles import Role
from casid.data.templates.template import Body, Template
from casid.data.templates.weak_form import Term, weak_form

_GRAVITY = 9.81  # m/s^2
ROLES = (
    Role("speed", "output", ("m/s",), "speed v vel geschw gps vehicle fahrzeug", "wind set soll"),
    Role("force", "input", ("N",), "force kraft zug drive antrieb traction f", "brake brems"),
    Role("torque", "input", ("N m",), "torque moment drive antrieb motor wheel rad", "brake brems"),
    Role("slope", "input", ("rad",), "slope grade steigung pitch neigung road", by_name=True),
)


def write(d: Draft) -> Body:
    """The equation of motion along the road; coasting determines forces per unit of mass alone."""
    d.require_one_of("speed")
    driven = d.has("force")
    turned = d.has("torque") and not driven
    sloped = d.has("slope")
    start = _starts(d)
    drive = "F" if driven else "T * g_w" if turned else ""
    words = "F - " if driven else "g_w T - " if turned else "-"
    unit = d.unit("speed")
    return Body(
        equations=[
            f"M dv/dt = {words}F_r - c v^2{' - M g sin(s)' if sloped else ''}",
        ],
        inputs=[
            d.input("force", "F", "of the drive") if driven else "",
            d.input("torque", "T", "of the drive") if turned else "",
            d.input("slope", "s", "of the road, uphill") if sloped else "",
        ],
        states=[f'v = m.state("v", "{unit}", start={d.first("speed"):.4g})'],
        parameters=[
            d.unknown("M", "kg", start["M"], "mass, with that of what turns", default=1500.0)
            if drive
            else d.known("M", "kg", 1500.0, "mass, with that of what turns"),
            d.unknown("F_r", "N", start["F_r"], "rolling resistance", sign="zero", default=100.0),
            d.unknown("c", "N s^2/m^2", start["c"], "drag: rho c_d A/2", sign="zero", default=0.4),
            d.known("g_w", "1/m", 3.0, "gear ratio over the radius of the wheel") if turned else "",
            f'g = m.constant("g", {_GRAVITY}, "m/s^2")' if sloped else "",
            'v_0 = m.constant("v_0", 0.1, "m/s")  # below it the rolling resistance fades out',
        ],
        relations=[
            "roll = F_r * ca.tanh(v / v_0)",
            f'm.balance(v, "force", inertia=M, terms=[{f"{drive}, " if drive else ""}-roll, '
            f'-c * v * ca.fabs(v){", -M * g * ca.sin(s)" if sloped else ""}], unit="N")',
        ],
        outputs=[d.output("speed", "v")],
    )


def _starts(d: Draft) -> dict[str, float | None]:
    """M, F_r and c of force = M (dv/dt + g sin(slope)) + F_r + c v^2."""
    v, Ts = d["speed"], d.file.Ts
    resistance: list[Term] = [(np.tanh(v / 0.1), 0), (v * np.abs(v), 0)]
    # dv/dt + g sin(slope) as one derivative: that of the speed on a level road
    level = v
    if d.has("slope"):
        level = v + _GRAVITY * np.cumsum(np.sin(d["slope"])) * Ts
    M = d.value("M", 1500.0)
    if d.has("force") or d.has("torque"):
        drive = d["force"] if d.has("force") else d.value("g_w", 3.0) * d["torque"]
        found = weak_form((drive, 0), [(level, 1), *resistance], Ts)
        if found is not None:
            return dict(zip(("M", "F_r", "c"), map(float, found), strict=True))
    else:
        found = weak_form((-M * level, 1), resistance, Ts)
        if found is not None:
            return {"M": M, "F_r": float(found[0]), "c": float(found[1])}
    return {"M": None, "F_r": None, "c": None}


VEHICLE = Template(
    "vehicle", "vehicle along the road", lambda file: ROLES, write, needs_casadi=True
)
