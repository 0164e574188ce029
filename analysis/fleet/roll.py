"""Roll of a ship under its rudder, divided by the inertia: what a monitor of a fleet fits.

    phi'' = -B phi' - C phi + K_delta delta + K_r r                                           (1)

The roll subsystem of Linder (2017), equation (8.10), with the sway left out and its parameters
lumped; roll angle and rate are measured, rudder and yaw rate are taken as known.
"""

import casid


def model() -> casid.Model:
    """(1)."""
    m = casid.Model("roll of a ship")
    phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    delta, r = m.input("delta", "rad"), m.input("r", "rad/s")
    C = m.parameter("C", "1/s^2", start=0.3, lower=0.01, upper=5.0)
    B = m.parameter("B", "1/s", start=0.05, lower=0.0, upper=1.0)
    K_delta = m.parameter("K_delta", "1/s^2", start=-0.03, lower=-1.0, upper=1.0)
    K_r = m.parameter("K_r", "1/s", start=-0.3, lower=-5.0, upper=5.0)
    m.derivative(phi, p)
    terms = [-B * p, -C * phi, K_delta * delta, K_r * r]
    m.balance(p, "torque", inertia=1, terms=terms, unit="rad/s^2")
    m.output("roll", phi, "rad")
    m.output("gyro", p, "rad/s")
    return m


problem = casid.Problem(
    name="roll of a fleet",
    model=model(),
    channels={"roll": "roll:rad", "gyro": "gyro:rad/s", "delta": "delta:rad", "r": "r:rad/s"},
    time="t",
    noise={"delta": 0.0, "r": 0.0},
    starts=1,
)
