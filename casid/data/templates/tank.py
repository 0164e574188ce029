"""The template of a tank with a free outlet."""

from __future__ import annotations

import numpy as np

from casid.data.templates.draft import Draft
from casid.data.templates.roles import Role
from casid.data.templates.template import Body, Template
from casid.data.templates.weak_form import Term, weak_form

ROLES = (
    Role("level", "output", ("m", "1"), "level fuellst pegel niveau h tank height hoehe"),
    Role("inflow", "input", ("m^3/s",), "in inflow zufluss zulauf flow q durchfluss", "out ab aus"),
    Role("pump", "input", ("1", "V"), "pump valve ventil u duty stell", by_name=True),
)


def write(d: Draft) -> Body:
    """Torricelli's outlet; without a flow in units of flow the area is taken as known."""
    d.require_one_of("level")
    flows, pumped = d.has("inflow"), d.has("pump") and not d.has("inflow")
    share = d.unit("level") in ("1", "%")
    start = _starts(d, d.value("H", 1.0) if share else 1.0)
    area = "area of the tank"
    volume = "q" if flows else "k_p * u" if pumped else ""
    pump_unit = si_flow_per(d.unit("pump")) if pumped else ""
    first = d.value("H", 1.0) * float(d["level"][0]) if share else d.first("level")
    return Body(
        equations=[f"A dh/dt = {volume.replace(' * ', ' ')}{' ' if volume else ''}- c sqrt(h)"],
        inputs=[
            d.input("inflow", "q", "into the tank") if flows else "",
            d.input("pump", "u", "of the pump or valve") if pumped else "",
        ],
        states=[f'h = m.state("h", "{"m" if share else d.unit("level")}", start={first:.4g})'],
        parameters=[
            d.unknown("A", "m^2", start["A"], area) if flows else d.known("A", "m^2", 1.0, area),
            d.unknown("c", "m^2.5/s", start["c"], "of the outlet: area times sqrt(2 g)"),
            d.unknown("k_p", pump_unit, start["k_p"], "flow of the pump per unit of its signal")
            if pumped
            else "",
            d.known("H", "m", 1.0, "height of the tank, the level at 100 %") if share else "",
        ],
        relations=[
            f'm.balance(h, "volume", inertia=A, terms=[{f"{volume}, " if volume else ""}'
            '-c * ca.sqrt(ca.fmax(h, 1e-6))], unit="m^3/s")',
        ],
        outputs=[d.output("level", "h / H" if share else "h")],
    )


def si_flow_per(unit: str) -> str:
    """The SI unit of a flow per unit of the pump's signal."""
    return "m^3/s" if unit in ("1", "%") else "m^3/(s V)"


def _starts(d: Draft, height: float) -> dict[str, float | None]:
    """A, c and k_p of inflow = A dh/dt + c sqrt(h)."""
    h = np.maximum(d["level"] * height, 0.0)
    A, Ts = d.value("A", 1.0), d.file.Ts
    outlet: Term = (np.sqrt(h), 0)
    if d.has("inflow"):
        found = weak_form((d["inflow"], 0), [(h, 1), outlet], Ts)
        if found is not None:
            return {"A": float(found[0]), "c": float(found[1]), "k_p": None}
    elif d.has("pump"):
        found = weak_form((A * h, 1), [outlet, (d["pump"], 0)], Ts)
        if found is not None:
            return {"A": A, "c": -float(found[0]), "k_p": float(found[1])}
    else:
        found = weak_form((-A * h, 1), [outlet], Ts)
        if found is not None:
            return {"A": A, "c": float(found[0]), "k_p": None}
    return {"A": None, "c": None, "k_p": None}


TANK = Template("tank", "tank with a free outlet", lambda file: ROLES, write, needs_casadi=True)
