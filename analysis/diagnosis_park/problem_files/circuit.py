"""A coil and a capacitor with a diode across it, driven by a measured voltage."""

import casadi as ca

import casid

m = casid.Model("circuit")
source = m.input("source", "V")
v, i = m.state("v", "V"), m.state("i", "A")
I_s, V_t = m.constant("I_s", 1e-6, "A"), m.constant("V_t", 0.12, "V")
C = m.parameter("C", "A s/V", start=1.9e-6, lower=1e-7, upper=1e-4)
R_p = m.parameter("R_p", "Ohm", start=400.0, lower=10.0, upper=1e5)
R = m.parameter("R", "Ohm", start=12.0, lower=0.1, upper=1e3)
L = m.parameter("L", "H", start=5e-3, lower=1e-4, upper=1.0)
diode = I_s * (ca.exp(v / V_t) - 1)
m.balance(v, "charge", inertia=C, terms=[i, -v / R_p, -diode], unit="A")
m.balance(i, "coil", inertia=L, terms=[source, -R * i, -v], unit="V")
m.output("capacitor", v, "V")
m.output("current", i, "A")

problem = casid.Problem("circuit", m)
