"""A stirred tank with a heated jacket; a thermostat holds the contents at their temperature."""

import casid

m = casid.Model("stirred tank")
duty = m.input("duty", "1", hold="zoh", known=True)
T_j, T_t = m.state("T_j", "K", start=318.0), m.state("T_t", "K", start=308.0)
P, h = m.constant("P", 9000.0, "W"), m.constant("h", 5.0, "W/K")
T_a, T_in = m.constant("T_a", 293.0, "K"), m.constant("T_in", 288.0, "K")
a = m.parameter("a", "W/K", start=280.0, lower=10.0, upper=3000.0)
C_j = m.parameter("C_j", "J/K", start=2e4, lower=1e3, upper=1e6)
C_t = m.parameter("C_t", "J/K", start=1e5, lower=1e4, upper=1e7)
q = m.parameter("q", "W/K", start=140.0, lower=1.0, upper=3000.0)
through = a * (T_j - T_t)
m.balance(T_j, "jacket_heat", inertia=C_j, terms=[P * duty, -through, -h * (T_j - T_a)], unit="W")
m.balance(T_t, "tank_heat", inertia=C_t, terms=[through, -q * (T_t - T_in)], unit="W")
m.output("jacket", T_j, "K")
m.output("tank", T_t, "K")

problem = casid.Problem("stirred_tank", m, recorded={"stirrer": "rad/s"})
