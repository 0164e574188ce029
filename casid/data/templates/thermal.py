"""The template of one heat capacity that loses heat to its surroundings."""

from __future__ import annotations

import numpy as np

from casid.data.templates.draft import Draft, in_unit
from casid.data.templates.roles import Role
from casid.data.templates.template import Body, Template
from casid.data.templates.weak_form import weak_form

COLDEST, HOTTEST = 173.15, 2273.15
"""Surroundings [K] of what is warmer than -100 degC: a winter, and a furnace of 2000 degC."""

OUTSIDE = "out aussen amb umgeb ext ta surround weather"
ROLES = (
    Role("temperature", "output", ("K",), "room raum in innen zone temp t body wall", OUTSIDE),
    Role("ambient", "input", ("K",), OUTSIDE, "room raum innen zone", by_name=True),
    Role("power", "input", ("W",), "heat heiz power leistung p q el"),
    Role(
        "duty",
        "input",
        ("1",),
        "duty pwm heat heiz valve ventil power u on",
        "fan luefter pump cool kuehl",
        by_name=True,
        instead_of="power",
    ),
)


def write(d: Draft) -> Body:
    """One capacity, one loss, and a heater where there is one."""
    d.require_one_of("temperature")
    unit = d.unit("temperature")
    has_ambient, has_power = d.has("ambient"), d.has("power")
    has_duty = d.has("duty") and not has_power
    start = _starts(d)
    heat = "P" if has_power else "P_max * u" if has_duty else ""
    what = "heat capacity"
    return Body(
        equations=[
            f"C dT/dt = {heat + ' + ' if heat else ''}H (T_a - T)",
        ],
        inputs=[
            d.input("power", "P", "of the heater") if has_power else "",
            d.input("duty", "u", "of the heater, 0 to 1") if has_duty else "",
            d.input("ambient", "T_a", "of the surroundings") if has_ambient else "",
        ],
        states=[
            f'T = m.state("T", "{unit}", start={d.first("temperature"):.4g})',
        ],
        parameters=[
            # Temperatures alone determine H/C: one of the three has to be known.
            d.unknown("C", "J/K", start["C"], what, default=1e4)
            if has_power or has_duty
            else d.known("C", "J/K", 1e4, what),
            d.unknown("H", "W/K", start["H"], "loss to the surroundings", default=10.0),
            d.known("P_max", "W", 1000.0, "power of the heater at u = 1") if has_duty else "",
            ""
            if has_ambient
            else d.unknown(
                "T_a",
                unit,
                None if start["T_a"] is None else in_unit(start["T_a"], unit),
                "temperature of the surroundings",
                default=round(in_unit(float(np.min(d["temperature"])), unit)),
                sign="any",
                within=_surroundings(d),
            ),
        ],
        relations=[
            'm.balance(T, "heat", inertia=C, '
            f'terms=[{heat + ", " if heat else ""}H * (T_a - T)], unit="W")',
        ],
        outputs=[d.output("temperature", "T")],
    )


def _surroundings(d: Draft) -> tuple[float, float]:
    """The coldest and the hottest that surroundings may be, in the unit of the temperature.

    Where a record shows no loss, a fit would take surroundings ever further off with ever less of
    it.
    """
    T, unit = d["temperature"], d.unit("temperature")
    coldest = COLDEST if T.min() > COLDEST else 0.0
    hottest = max(HOTTEST, 2 * float(T.max()))
    return round(in_unit(coldest, unit)), round(in_unit(hottest, unit))


def _starts(d: Draft) -> dict[str, float | None]:
    """C, H and T_a [K] of heat = C dT/dt + H (T - T_a)."""
    T, Ts = d["temperature"], d.file.Ts
    zero = float(T.mean())  # absolute temperatures would hide what moves
    C = d.value("C", 1e4)
    if d.has("ambient"):
        losses = [(T - d["ambient"], 0)]
    else:
        losses = [(T - zero, 0), (np.ones_like(T), 0)]
    heats = False
    if d.has("power") or d.has("duty"):
        heat = d["power"] if d.has("power") else d.value("P_max", 1000.0) * d["duty"]
        heats = bool(heat.min() >= 0)
        found = weak_form((heat, 0), [(T, 1), *losses], Ts)
        if found is None:
            return {"C": None, "H": None, "T_a": None}
        C, loss = float(found[0]), found[1:]
    else:
        found = weak_form((-C * (T - zero), 1), losses, Ts)
        if found is None:
            return {"C": C, "H": None, "T_a": None}
        loss = found
    ambient = None
    if not d.has("ambient") and loss[0] > 0:
        resting, span = zero - float(loss[1] / loss[0]), float(np.ptp(T))
        # What is heated alone is never colder than its surroundings all along.
        highest = float(T.max()) + (0.0 if heats else span)
        ambient = resting if T.min() - span <= resting <= highest else None
    return {"C": C, "H": float(loss[0]), "T_a": ambient}


THERMAL = Template("thermal", "one heat capacity", lambda file: ROLES, write)
