"""The initial state of what was held out is found in a few passes, also where friction reverses.

And where an unstable model is simulated over one window as long as all that was held out.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid
from casid.estimation.nlp.solver import Solver
from casid.estimation.simulation.initial_state import fit_initial_state
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError

TS, N = 0.01, 1500


def slide(speed: float) -> casid.Model:
    """A mass on a spring, whose dry friction reverses within a speed."""
    m = casid.Model("slide")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", known=True)
    m.derivative(x, v)
    friction = m.constant("F_c", 0.6, "N") * ca.tanh(v / m.constant("speed", speed, "m/s"))
    m.balance(v, "forces", inertia=1.0, terms=[F, -0.4 * v, -20.0 * x, -friction], unit="N")
    m.output("position", x, "m")
    return m


def experiment(model: casid.Model) -> casid.Experiment:
    """A record of the slide, with a force that the model does not know."""
    t = TS * np.arange(N)
    F = 2.0 * np.sin(3.1 * t) + np.sin(7.7 * t)
    channels, units = {"F": F, "position": np.zeros(N)}, {"F": "N", "position": "m"}
    blank = casid.Experiment(casid.Record(channels, units, Ts=TS), {}, "r")
    criterion = SimulationError(model, [blank], start={"x(0)": 0.05, "v(0)": -0.3})
    y = criterion.simulate(criterion.start, 0)[0][:, 0]
    late = 0.02 * np.sin(0.9 * t) + 1e-3 * np.random.default_rng(1).standard_normal(N)
    return casid.Experiment(casid.Record({**channels, "position": y + late}, units, Ts=TS), {}, "r")


@pytest.mark.parametrize("speed", [1e-3, 1.0])
def test_a_state_is_found_in_a_few_passes_where_a_long_search_finds_it(
    speed: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To a hundred-thousandth of the squared error, of which a hundredth decides.

    Within 1 mm/s no step ends where friction reverses: a search to the end took 158 passes.
    """
    passes = [0]
    simulate = SimulationError.simulate

    def counted(self, *args, **settings):
        passes[0] += 1
        return simulate(self, *args, **settings)

    monkeypatch.setattr(SimulationError, "simulate", counted)
    model = slide(speed)
    held = experiment(model)
    passes[0] = 0
    criterion, found = fit_initial_state(model, held, substeps=4)
    few, passes[0] = passes[0], 0
    long = minimize_simulation_error(criterion, solver=Solver(), starts=5, check_rank=False)
    assert few <= 60
    assert criterion.evaluate(found).value <= (1 + 1e-5) * long.solution.value


def upright(N: int, Ts: float = 0.02) -> casid.Record:
    """A pendulum that a controller holds near its upper position, moved to and fro."""
    rng = np.random.default_rng(1)
    state, rows = np.array([0.3, 0.8]), []
    for goal in np.repeat(rng.uniform(-0.8, 0.8, N // 40 + 1), 40)[:N]:
        push = -9.0 * np.sin(state[0]) - 6.0 * (state[0] - goal) - 3.0 * state[1]
        rows.append((push, state[0] + 3e-4 * rng.standard_normal()))
        step = solve_ivp(
            lambda _, x, u: [x[1], 9.0 * np.sin(x[0]) + u], (0, Ts), state, rtol=1e-9, args=(push,)
        )
        state = step.y[:, -1]
    push, angle = np.array(rows).T
    return casid.Record({"push": push, "angle": angle}, {"push": "rad/s^2", "angle": "rad"}, Ts)


@pytest.mark.parametrize("N", [150, 250])
def test_a_state_is_found_where_one_window_is_all_of_an_unstable_record(N: int) -> None:
    """An error of the rate, which nobody measures, grows by e^9 to e^15 over the record.

    The simulation turns over from most states: the search begins over a short part of the window.
    """
    m = casid.Model("upright pendulum")
    angle, rate = m.state("angle", "rad"), m.state("rate", "rad/s")
    push = m.input("push", "rad/s^2", hold="zoh", known=True)
    weight = m.constant("weight", 9.0, "1/s^2")
    m.derivative(angle, rate)
    m.balance(rate, "moment", inertia=1, terms=[weight * ca.sin(angle), push], unit="rad/s^2")
    m.output("angle", angle, "rad")
    held = casid.Experiment(upright(N), {}, "r", window=2 * N // 3)
    criterion, found = fit_initial_state(m, held, substeps=4)
    assert criterion.parts(0) == 1
    error = criterion.data[0].errors(criterion.simulate(found, 0)[0])
    assert np.sqrt(np.mean(error**2)) < 1.2 * 3e-4
