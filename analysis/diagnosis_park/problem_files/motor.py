"""A DC motor on a held voltage, its inductance neglected; current and shaft angle are measured."""

import casid

m = casid.Model("DC motor")
voltage = m.input("voltage", "V", hold="zoh", known=True)
w, angle = m.state("w", "rad/s"), m.state("angle", "rad")
J = m.parameter("J", "kg m^2", start=1.8e-4, lower=1e-5, upper=1e-2)
R = m.parameter("R", "Ohm", start=1.0, lower=0.1, upper=10.0)
K = m.parameter("K", "N m/A", start=0.05, lower=0.005, upper=0.5)
b = m.parameter("b", "N m s/rad", start=1e-4, lower=0.0, upper=1e-2)
current = (voltage - K * w) / R
m.derivative(angle, w)
m.balance(w, "torque", inertia=J, terms=[K * current, -b * w])
m.output("current", current, "A")
m.output("angle", angle, "rad")

problem = casid.Problem("motor", m, recorded={"temperature": "K"})
