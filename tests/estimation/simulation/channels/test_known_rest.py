"""A model whose states all start at known values tells what was before, where it rests there."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.estimation.simulation.channels.known_rest import known_rest
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.channels.delays import dead_time


def infusion() -> casid.Model:
    m = casid.Model("one compartment")
    C = m.state("C", "mg/L", initial=0.0)
    rate = m.input("rate", "mg/h", hold="zoh", known=True)
    V, CL = m.parameter("V", "L", start=12.0), m.parameter("CL", "L/h", start=3.0)
    m.balance(C, "drug", inertia=V, terms=[rate, -CL * C])
    m.output("conc", C, "mg/L")
    return m


def cell(**initial: float) -> casid.Model:
    """A cell in a room: charge, overvoltage and temperature."""
    m = casid.Model("cell")
    q, v, T = (
        m.state(n, unit, initial=initial.get(n))
        for n, unit in (("q", "Ah"), ("v", "mV"), ("T", "degC"))
    )
    current, room = m.input("current", "A"), m.input("room", "degC")
    R, C = m.parameter("R", "mohm", start=20.0), m.parameter("C", "farad", start=2e3)
    c, hA = m.parameter("c", "J/K", start=50.0), m.parameter("hA", "W/K", start=0.2)
    m.balance(q, "charge", inertia=1, terms=[-current])
    m.balance(v, "pair", inertia=C, terms=[current, -v / R])
    m.balance(T, "heat", inertia=c, terms=[v**2 / R, -hA * (T - room)])
    m.output("V", 3.7 - v - R * current, "V")
    m.output("T_cell", T, "degC")
    return m


def test_inputs_at_rest_are_those_that_move_nothing():
    """No current flowed, and the room had the cell's temperature; the voltage shows a current."""
    rest = known_rest(cell(q=2.2, v=0.0, T=24.0))
    assert rest.inputs == pytest.approx({"current": 0.0, "room": 297.15})
    assert rest.outputs == {"T_cell"}
    assert known_rest(infusion()).inputs == {"rate": 0.0}


def test_no_rest_is_known_of_what_is_not_known_moves_or_rests_as_parameters_say():
    assert not known_rest(cell(v=0.0, T=24.0)).inputs  # the charge is not known
    assert not known_rest(cell(q=2.2, v=5.0, T=24.0)).inputs  # 5 mV decay
    tank = casid.Model("tank")
    h, inflow = tank.state("h", "m", initial=0.5), tank.input("inflow", "m^3/s")
    k = tank.parameter("k", "m^2/s", start=0.1)
    tank.balance(h, "volume", inertia=1.0, terms=[inflow, -k * h], unit="m^3/s")
    tank.output("level", h, "m")
    assert not known_rest(tank).inputs  # it may have emptied: 0.5 k would hold it


def test_of_inputs_that_balance_each_other_none_is_known():
    m = infusion()
    m.add_term("drug", m.input("bolus", "mg/h", hold="zoh"))
    rest = known_rest(m)
    assert rest.inputs == {}
    assert rest.outputs == {"conc"}


def test_an_infusion_that_is_on_at_the_first_sample_began_there():
    """Late by 2.3 samples, from the exact solution: its dead time, and the clearance beside it."""
    V, CL, Ts, late, N, sd = 14.0, 4.2, 0.25, 0.575, 160, 0.02
    t = Ts * np.arange(N)
    rate = np.where((t < 4.0) | ((t >= 20.0) & (t < 24.0)), 400.0, 0.0)

    def risen(since: np.ndarray) -> np.ndarray:
        return 400.0 / CL * (1 - np.exp(-CL / V * np.maximum(since, 0.0)))

    switches = ((0.0, 1), (4.0, -1), (20.0, 1), (24.0, -1))
    conc = sum(sign * risen(t - at - late) for at, sign in switches)
    conc = conc + sd * np.random.default_rng(2).standard_normal(N)
    columns = {"rate": rate / 3.6e9, "conc": conc / 1e3}
    record = casid.Record(columns, {"rate": "kg/s", "conc": "kg/m^3"}, Ts=3600 * Ts)
    model = dead_time(infusion(), "rate", 7200.0).extend(infusion())
    e = casid.Experiment(record, {}, "r")
    criterion = SimulationError(model, [e], weights=np.array([1e3 / sd]))
    fit = minimize_simulation_error(criterion)
    assert criterion.data[0].used.all()
    errors = np.sqrt(np.diag(np.linalg.inv(fit.solution.hessian)))
    true = {"V": V / 1e3, "CL": CL / 3.6e6, "dead_time_rate": 3600 * late}
    for name, value, error in zip(criterion.names, fit.x, errors, strict=True):
        assert abs(value - true[name]) < 3 * error
        assert error < 0.01 * true[name]
