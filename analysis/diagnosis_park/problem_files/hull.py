"""Roll of a hull under fins, in waves that nobody measures."""

import casid

m = casid.Model("hull")
fin = m.input("fin", "rad", hold="zoh", known=True)
phi, w = m.state("phi", "rad"), m.state("w", "rad/s")
B = m.parameter("B", "1/s", start=0.05, lower=0.0, upper=2.0)
C = m.parameter("C", "1/s^2", start=0.8, lower=0.05, upper=10.0)
K_f = m.parameter("K_f", "1/s^2", start=0.2, lower=0.0, upper=10.0)
m.derivative(phi, w)
m.balance(w, "moment", inertia=1, terms=[-B * w, -C * phi, K_f * fin], unit="rad/s^2")
m.output("roll", phi, "rad")
m.output("rate", w, "rad/s")

problem = casid.Problem("hull", m, recorded={"speed": "m/s"})
