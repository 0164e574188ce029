"""Laws of flow: a power of a level in the place of the level, wherever it flows."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.flow_laws import power_law, states_with_one_law
from problems import pendulum

Array = np.ndarray
AREA, LEVEL = 0.01, 0.2  # m^2, m


def tanks() -> casid.Model:
    """Two tanks, one above the other, with outflows in proportion to the levels."""
    m = casid.Model("cascaded tanks")
    h1, h2 = m.state("h1", "m", start=0.15, lower=0.0), m.state("h2", "m", start=0.15, lower=0.0)
    u = m.input("u", "m^3/s", hold="zoh", known=True)
    k1 = m.parameter("k1", "m^2/s", start=5e-4, lower=0.0)
    k2 = m.parameter("k2", "m^2/s", start=5e-4, lower=0.0)
    m.balance(h1, "upper", inertia=AREA, terms=[-k1 * h1, u], unit="m^3/s")
    m.balance(h2, "lower", inertia=AREA, terms=[k1 * h1, -k2 * h2], unit="m^3/s")
    m.output("level", h2, "m")
    return m


def tank_record(power: float, N: int = 700, seed: int = 0) -> casid.Record:
    """Outflows c |h / LEVEL|^power, Torricelli's law where it is a half; 1 mm of noise."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.5e-4, 2e-4, N // 50 + 1), 50)[:N]

    def rates(h: Array, inflow: float) -> Array:
        upper, lower = 1e-4 * (h / LEVEL) ** power * np.array([1.0, 1.1])
        return np.array([inflow - upper, upper - lower]) / AREA

    h, levels = np.array([0.15, 0.15]), np.empty(N)
    for i in range(N):
        levels[i] = h[1]
        for _ in range(2):  # Heun's method, its steps short against the 40 s of a tank
            first = rates(h, u[i])
            h = h + 0.25 * (first + rates(h + 0.5 * first, u[i]))
    levels += 1e-3 * rng.standard_normal(N)
    return casid.Record({"u": u, "level": levels}, {"u": "m^3/s", "level": "m"}, Ts=1.0)


def test_a_power_law_changes_the_flow_in_every_tank_that_it_enters():
    """x_ref (x / x_ref)^n: the same at x_ref, and n times as steep there."""
    model = tanks()
    effect = power_law(model, "h1", LEVEL)
    assert effect is not None
    assert effect.where == "upper"
    extended, names = effect.extended(model)
    assert extended.parameters[names[0]].start == 1.0
    e = extended.explicit()
    slope = ca.Function("s", [e.x, e.u, e.p], [ca.jacobian(e.f, e.x)])
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    value = {"k1": 5e-4, "k2": 3e-4, "A": AREA, names[0]: 0.5}
    p = [value[n] for n in e.parameters]
    at = [LEVEL, 0.3]
    assert np.ravel(f(at, [0.0], p)) == pytest.approx(
        np.array([-5e-4 * LEVEL, 5e-4 * LEVEL - 3e-4 * 0.3]) / AREA, rel=1e-9
    )
    # The rounding near zero is a millionth of the slope at x_ref.
    expected = np.array([[-0.5 * 5e-4, 0.0], [0.5 * 5e-4, -3e-4]]) / AREA
    assert np.array(slope(at, [0.0], p)) == pytest.approx(expected, rel=1e-5)


def alike() -> casid.Model:
    """Two tanks with one coefficient of outflow, and a third with another."""
    m = casid.Model("three tanks")
    h1, h2, h3 = (m.state(name, "m", start=0.2) for name in ("h1", "h2", "h3"))
    u = m.input("u", "m^3/s", known=True)
    k, k3 = (m.parameter(name, "m^2/s", start=5e-4, lower=0.0) for name in ("k", "k3"))
    m.balance(h1, "first", inertia=AREA, terms=[u, -k * h1], unit="m^3/s")
    m.balance(h2, "second", inertia=2 * AREA, terms=[k * h1, -k * h2], unit="m^3/s")
    m.balance(h3, "third", inertia=AREA, terms=[k * h2, -k3 * h3], unit="m^3/s")
    m.output("level", h3, "m")
    return m


def test_tanks_that_a_model_takes_as_alike_have_one_law_of_outflow():
    """Both outflows are halved in slope at n = 1/2, each at its own level; the third is not."""
    model = alike()
    assert states_with_one_law(model) == [("h1", "h2")]
    assert states_with_one_law(tanks()) == []
    effect = power_law(model, ("h1", "h2"), [0.2, 0.4])
    assert effect is not None
    assert effect.key == ("unknown", "first: |h1|^n and |h2|^n")
    extended, (exponent,) = effect.extended(model)
    e = extended.explicit()
    value = {"k": 5e-4, "k3": 3e-4, exponent: 0.5}
    slope = ca.Function("s", [e.x, e.u, e.p], [ca.jacobian(e.f, e.x)])
    found = np.array(slope([0.2, 0.4, 0.3], [0.0], [value[n] for n in e.parameters])) * AREA
    expected = np.array([[-2.5e-4, 0, 0], [1.25e-4, -1.25e-4, 0], [0, 2.5e-4, -3e-4]])
    assert found == pytest.approx(expected, rel=1e-5)


def test_springs_and_speeds_with_a_position_follow_no_power_law():
    model = pendulum.problem.model
    assert power_law(model, "phi", 0.1) is None
    assert power_law(model, "p", 0.1) is None


def test_the_sensitivity_to_an_exponent_is_its_derivative():
    model = tanks()
    effect = power_law(model, "h1", LEVEL)
    assert effect is not None
    extended, names = effect.extended(model)
    record = casid.Experiment(tank_record(0.5, N=200), {}, "r")
    c = SimulationError(extended, [record], start={names[0]: 0.8})
    i = c.names.index(names[0])
    jacobian = c.simulated(c.start, 0).jacobian[:, 0, i]
    up, down = c.start, c.start
    up[i] += 1e-5
    down[i] -= 1e-5
    slope = (c.simulate(up, 0)[0] - c.simulate(down, 0)[0])[:, 0] / 2e-5
    assert np.max(np.abs(jacobian - slope)) < 1e-6 * np.max(np.abs(slope))


def test_torricellis_law_is_recovered_as_a_power_of_one_half():
    """Both outflows free; the estimate within three standard errors of white output noise."""
    model = tanks()
    for state in ("h1", "h2"):
        effect = power_law(model, state, LEVEL)
        assert effect is not None
        model = model.extend(effect)
    fit = fit_model(
        model, [casid.Experiment(tank_record(0.5), {}, "r")], FitSettings(starts=1, substeps=1)
    )
    c = fit.criterion
    r, j = c.columns(fit.x, 0)
    covariance = np.linalg.inv(np.einsum("kin,kim->nm", j, j)) * np.var(r)
    for state in ("h1", "h2"):
        i = c.names.index(f"exponent_{state}")
        sd = float(np.sqrt(covariance[i, i]))
        assert sd < 0.05
        assert fit.x[i] == pytest.approx(0.5, abs=3 * sd)
