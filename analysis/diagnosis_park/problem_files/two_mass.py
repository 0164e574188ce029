"""Two inertias with an elastic shaft between them; speed of the motor and twist are measured."""

import casid

m = casid.Model("two-mass drive")
torque = m.input("torque", "N m", hold="zoh", known=True)
w1, w2, e = m.state("w1", "rad/s"), m.state("w2", "rad/s"), m.state("e", "rad")
J1 = m.parameter("J1", "kg m^2", start=0.01, lower=1e-3, upper=0.1)
J2 = m.parameter("J2", "kg m^2", start=0.02, lower=1e-3, upper=0.1)
k = m.parameter("k", "N m/rad", start=28.0, lower=1.0, upper=300.0)
c = m.parameter("c", "N m s/rad", start=0.02, lower=0.0, upper=1.0)
d1 = m.parameter("d1", "N m s/rad", start=0.02, lower=0.0, upper=1.0)
d2 = m.parameter("d2", "N m s/rad", start=0.02, lower=0.0, upper=1.0)
shaft = k * e + c * (w1 - w2)
m.derivative(e, w1 - w2)
m.balance(w1, "motor", inertia=J1, terms=[torque, -shaft, -d1 * w1])
m.balance(w2, "load", inertia=J2, terms=[shaft, -d2 * w2])
m.output("speed", w1, "rad/s")
m.output("twist", e, "rad")

problem = casid.Problem("two_mass", m, recorded={"bearing_temperature": "K"})
