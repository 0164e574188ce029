"""Two rooms with a wall between them, a heater in the first, the weather outside."""

import casid

m = casid.Model("two rooms")
heater = m.input("heater", "W", hold="zoh", known=True)
outdoor = m.input("outdoor", "K")
T1, T2 = m.state("T1", "K", start=293.0), m.state("T2", "K", start=291.0)
C1 = m.parameter("C1", "J/K", start=4e6, lower=1e5, upper=1e8)
C2 = m.parameter("C2", "J/K", start=8e6, lower=1e5, upper=1e8)
G = m.parameter("G", "W/K", start=100.0, lower=1.0, upper=2000.0)
H1 = m.parameter("H1", "W/K", start=60.0, lower=1.0, upper=2000.0)
H2 = m.parameter("H2", "W/K", start=80.0, lower=1.0, upper=2000.0)
wall = G * (T1 - T2)
m.balance(T1, "room_heat", inertia=C1, terms=[heater, -wall, -H1 * (T1 - outdoor)], unit="W")
m.balance(T2, "hall_heat", inertia=C2, terms=[wall, -H2 * (T2 - outdoor)], unit="W")
m.output("room", T1, "K")
m.output("hall", T2, "K")

problem = casid.Problem("rooms", m, recorded={"sun": "W/m^2"})
