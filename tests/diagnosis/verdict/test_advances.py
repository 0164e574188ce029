"""What is late in the plant looks like records that are ahead of time, which is said in words."""

from __future__ import annotations

import casid
from casid.diagnosis.verdict.reported_causes import as_an_advance


def cylinder() -> casid.Model:
    """A valve moves a piston; the opening is a command, the pressure is measured."""
    m = casid.Model("cylinder")
    v = m.state("v", "m/s")
    u, p = m.input("u", "1", known=True), m.input("p", "Pa")
    m.balance(
        v,
        "force",
        inertia=m.constant("M", 120.0, "kg"),
        terms=[m.constant("A", 1e-3, "m^2") * u * p],
    )
    m.output("speed", v, "m/s")
    return m


def test_a_plant_that_is_late_has_a_dead_time_and_a_sensor_that_is_late_a_delay():
    m = cylinder()
    for name in ("u", "p"):
        said = as_an_advance("u, p", casid.dead_time(m, name, longest=0.1))
        assert said == f"an advance of u, p in the record looks the same as a dead time of {name}"
    said = as_an_advance("p", casid.time_delay(m, "speed", longest=0.1))
    assert said == "an advance of p in the record looks the same as a delay of speed"
