"""A load on a rope below a trolley, whose acceleration is measured."""

import casadi as ca

import casid

m = casid.Model("crane")
trolley = m.input("trolley", "m/s^2")
phi, w = m.state("phi", "rad"), m.state("w", "rad/s")
g = m.constant("g", 9.81, "m/s^2")
L = m.parameter("L", "m", start=1.4, lower=0.5, upper=5.0)
d = m.parameter("d", "1/s", start=0.05, lower=0.0, upper=2.0)
swing = -g / L * ca.sin(phi) - trolley / L * ca.cos(phi)
m.derivative(phi, w)
m.balance(w, "swing", inertia=1, terms=[swing, -d * w], unit="1/s^2")
m.output("angle", phi, "rad")

problem = casid.Problem("crane", m, recorded={"wind": "m/s"})
