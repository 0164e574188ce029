"""A quarter of a car: travel and body acceleration are measured, the road is not."""

import casid

m = casid.Model("quarter car")
actuator = m.input("actuator", "N", hold="zoh", known=True)
z, v = m.state("z", "m"), m.state("v", "m/s")
mass = m.constant("mass", 320.0, "kg")
k = m.parameter("k", "N/m", start=1.9e4, lower=1e3, upper=1e5)
d = m.parameter("d", "N s/m", start=1400.0, lower=0.0, upper=1e4)
m.derivative(z, v)
m.balance(v, "body", inertia=mass, terms=[actuator, -k * z, -d * v])
m.output("travel", z, "m")
m.output("acceleration", m.der(v), "m/s^2")

problem = casid.Problem("quarter_car", m, recorded={"speed": "m/s"})
