"""A body levitated by a magnet under a PD controller, whose reference is recorded."""

import casid

m = casid.Model("magnetic levitation")
reference = m.input("reference", "m", hold="zoh", known=True)
y, v = m.state("y", "m"), m.state("v", "m/s")
mass = m.constant("mass", 0.1, "kg")
K_p, K_d = m.constant("K_p", 60.0, "A/m"), m.constant("K_d", 0.6, "A s/m")
k_y = m.parameter("k_y", "N/m", start=380.0, lower=50.0, upper=1000.0)
k_i = m.parameter("k_i", "N/A", start=19.0, lower=2.0, upper=100.0)
d = m.parameter("d", "N s/m", start=0.3, lower=0.0, upper=10.0)
current = -K_p * (y - reference) - K_d * v
m.derivative(y, v)
m.balance(v, "force", inertia=mass, terms=[k_y * y, k_i * current, -d * v])
m.output("gap", y, "m")
m.output("current", current, "A")

problem = casid.Problem("levitation", m)
