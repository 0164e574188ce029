"""A vehicle along the road: drive, rolling resistance, air and slope."""

import casadi as ca

import casid

m = casid.Model("vehicle")
drive = m.input("drive", "N", hold="zoh", known=True)
slope = m.input("slope", "1")
v = m.state("v", "m/s", start=18.0)
g = m.constant("g", 9.81, "m/s^2")
mass = m.parameter("m", "kg", start=1400.0, lower=300.0, upper=5000.0)
c_w = m.parameter("c_w", "kg/m", start=0.5, lower=0.0, upper=5.0)
f_r = m.parameter("f_r", "1", start=0.01, lower=0.0, upper=0.1)
air = c_w * v * ca.fabs(v)
m.balance(v, "force", inertia=mass, terms=[drive, -f_r * mass * g, -air, -mass * g * slope])
m.output("speed", v, "m/s")

problem = casid.Problem("vehicle", m, recorded={"wind": "m/s"})
