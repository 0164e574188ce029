"""Two tanks, one above the other, with free outlets."""

import casadi as ca

import casid

m = casid.Model("two tanks")
inflow = m.input("inflow", "m^3/s", hold="zoh", known=True)
h1, h2 = m.state("h1", "m", start=0.4), m.state("h2", "m", start=0.4)
A1 = m.parameter("A1", "m^2", start=0.1, lower=0.01, upper=1.0)
A2 = m.parameter("A2", "m^2", start=0.1, lower=0.01, upper=1.0)
c1 = m.parameter("c1", "m^2.5/s", start=1.2e-3, lower=1e-4, upper=1e-2)
c2 = m.parameter("c2", "m^2.5/s", start=1.2e-3, lower=1e-4, upper=1e-2)
first, second = c1 * ca.sqrt(ca.fmax(h1, 1e-6)), c2 * ca.sqrt(ca.fmax(h2, 1e-6))
m.balance(h1, "upper_volume", inertia=A1, terms=[inflow, -first], unit="m^3/s")
m.balance(h2, "lower_volume", inertia=A2, terms=[first, -second], unit="m^3/s")
m.output("upper", h1, "m")
m.output("lower", h2, "m")

problem = casid.Problem("two_tanks", m, recorded={"water_temperature": "K"})
