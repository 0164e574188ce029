"""A change of a parameter of which the fit without it has left nothing is fitted from its start.

The truth has two compartments, by its exact solution between samples; the clearance halves at 30 h.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import expm

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.parameter_effects import parameter_jump

HOUR, N, JUMP = 3600.0, 110, 30.0
V1, V2, CL, Q = 12.0, 30.0, 4.0, 6.0
DOSES = (
    (0.5, 90.0),
    (4.0, 20.0),
    (16.0, 0.0),
    (24.0, 120.0),
    (27.0, 30.0),
    (40.0, 0.0),
    (44.0, 60.0),
)


def concentrations(rate: np.ndarray) -> np.ndarray:
    """[mg/L] every half hour, (N,), for rates held [mg/h]."""
    out, c = np.empty(N), np.zeros(3)
    for k in range(N):
        out[k] = c[0]
        clearance = CL if k < 2 * JUMP else CL / 2
        A = [[-(clearance + Q) / V1, Q / V1, 1 / V1], [Q / V2, -Q / V2, 0.0], [0.0, 0.0, 0.0]]
        c[2] = rate[k]
        c = expm(0.5 * np.array(A)) @ c
    return out


def test_a_jump_of_a_lost_parameter_is_found_from_its_declared_start():
    m = casid.Model("two compartments")
    c1, c2 = m.state("C1", "mg/L"), m.state("C2", "mg/L")
    u = m.input("rate", "mg/h", hold="zoh", known=True)
    v1 = m.parameter("V1", "L", start=10, lower=1, upper=100)
    v2 = m.parameter("V2", "L", start=20, lower=1, upper=300)
    cl = m.parameter("CL", "L/h", start=3, lower=0.01, upper=50)
    q = m.parameter("Q", "L/h", start=4, lower=0.01, upper=50)
    m.balance(c1, "plasma", inertia=v1, terms=[u, -cl * c1, -q * (c1 - c2)])
    m.balance(c2, "tissue", inertia=v2, terms=[q * (c1 - c2)])
    m.output("C", c1, "mg/L")
    t = 0.5 * np.arange(N)
    rate = np.select([t >= since for since, _ in DOSES[::-1]], [r for _, r in DOSES[::-1]], 0.0)
    level = concentrations(rate) + 0.12 * np.random.default_rng(1).standard_normal(N)
    channels = {"rate": rate * 1e-6 / HOUR, "C": level * 1e-3}
    units = {"rate": "kg/s", "C": "kg/m^3"}
    data = [casid.Experiment(casid.Record(channels, units, Ts=0.5 * HOUR, name="r"), {}, "r")]
    weighing = Weighing(data)
    at = weighing.weigh(m, minimize_simulation_error(SimulationError(m, data)))
    # A fit that went astray: the drug stays in a tissue much too large, and none is cleared.
    astray = {"V1": 17.1e-3, "V2": 0.14, "CL": 0.01e-3 / HOUR, "Q": 7.3e-3 / HOUR}
    x = np.array([astray.get(v.source, 0.0) for v in at.criterion.variables])
    solution = replace(at.fit.solution, x=x, value=at.criterion.evaluate(x).value)
    stuck = replace(at, fit=replace(at.fit, solution=solution))
    found = Refitting(weighing).refit(stuck, parameter_jump(m, "CL", JUMP * HOUR), 1e-7)
    assert found is not None
    values = found.fit.values
    assert abs(values["CL"] * 1e3 * HOUR - CL) < 0.2
    assert abs(values[found.names[0]] * 1e3 * HOUR + CL / 2) < 0.2
