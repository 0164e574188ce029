"""Play, periodic forces and drifts: their null values, derivatives, and recovery from records."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid.estimation.covariance import sandwich
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.dimensions import check_units
from casid.model.effects.balances.balance_effects import deadzone, effective_stiffness
from casid.model.effects.balances.periodic import periodic_disturbance
from casid.model.effects.effect import Effect
from casid.model.effects.parameter_effects import parameter_drift
from problems import pendulum
from tests.support import truth

Ts = 0.01
NOISE = 0.002
"""On both sensors (SI): a fifth of what the strengths below are usually seen against.

The noise of the accelerometer, an input of the indirect model, biases an unweighted fit in
proportion to its variance; here by less than the standard errors.
"""

MODEL = pendulum.problem.model.with_known(m=0.0)


def experiment(record: truth.TruthRecord) -> casid.Experiment:
    channels = {n: v for n, v in record.columns.items() if n != "t"}
    units = {n: u for n, u in record.units.items() if n != "t"}
    return casid.Experiment(casid.Record(channels, units, Ts=Ts, name=record.kind), {}, "record")


def fitted(model: casid.Model, record: truth.TruthRecord) -> Fit:
    start = {n: record.truth[n] for n in ("k", "d", "I_x")}
    return fit_model(
        model, [experiment(record)], FitSettings(starts=1), start=start, check_rank=False
    )


def std_error(fit: Fit, name: str) -> float:
    """Robust, as the residual is coloured by the accelerometer's noise."""
    free = np.ones(len(fit.x), dtype=bool)
    covariance, _ = sandwich(fit.solution.hessian, fit.criterion.scores(fit.x), free)
    i = fit.criterion.names.index(name)
    return float(np.sqrt(covariance[i, i]))


def criterion(model: casid.Model, at: dict[str, float] | None = None) -> SimulationError:
    t = np.arange(800) * Ts
    accel = np.sin(3.0 * t) + 0.5 * np.sin(7.3 * t)
    record = casid.Record(
        {"gyro": np.zeros_like(t), "accel": accel},
        {"gyro": "rad/s", "accel": "m/s^2"},
        Ts=Ts,
    )
    start = {"phi(0)": 0.02, "p(0)": 0.1, **(at or {})}
    return SimulationError(
        model, [casid.Experiment(record, {}, "r")], weights=np.ones(1), start=start
    )


def simulated(model: casid.Model, at: dict[str, float] | None = None) -> np.ndarray:
    c = criterion(model, at)
    return c.simulate(c.start, 0)[0][:, 0]


EFFECTS = [
    deadzone(MODEL, "torque", 1e-3, 0.2),
    periodic_disturbance(MODEL, "torque", 1.3, (0.0, 8.0)),
    parameter_drift(MODEL, "k", (0.0, 8.0)),
    parameter_drift(MODEL, "I_x", (0.0, 8.0)),
]


@pytest.mark.parametrize("effect", EFFECTS, ids=repr)
def test_at_its_null_value_the_extended_model_is_the_model(effect: Effect):
    extended = MODEL.extend(effect)
    check_units(extended)
    assert simulated(extended) == pytest.approx(simulated(MODEL), abs=1e-13)


@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("effect", EFFECTS, ids=repr)
def test_sensitivities_are_derivatives_at_the_null_value_and_far_from_it(effect: Effect, far: bool):
    """Central differences of step h err by h^2/6 of a third derivative."""
    extended, names = effect.extended(MODEL)
    size = {"deadzone": 0.02, "periodic_disturbance": 0.1, "parameter_drift": 0.06}[effect.kind]
    at = {names[0]: size if far else 0.0}
    if effect.kind == "deadzone" and not far:
        extended.parameters[names[0]] = casid.Parameter(names[0], "rad", 0.0)  # both sides of null
    c = criterion(extended, at)
    jacobian = c.simulated(c.start, 0).jacobian[:, 0]
    for name in names:
        i = c.names.index(name)
        h = 1e-5 * size if effect.kind != "periodic_disturbance" else 1e-5
        up, down = c.start, c.start
        up[i] += h
        down[i] -= h
        slope = (c.simulate(up, 0)[0] - c.simulate(down, 0)[0])[:, 0] / (2 * h)
        scale = max(np.max(np.abs(slope)), 1e-9)
        assert np.max(np.abs(jacobian[:, i] - slope)) < 1e-5 * scale


def test_the_stiffness_that_has_play_is_the_one_that_is_left_after_elimination():
    """(7.24): gravity's share S g of k + S g leaves with the cart's acceleration."""
    assert str(effective_stiffness(MODEL, "torque", "phi")) == "k"
    direct = pendulum.linear_model()
    K = effective_stiffness(direct, "torque", "phi")
    k, g = (direct.symbol(n) for n in ("k", "g"))
    S = direct.symbol("M") * direct.symbol("z_g") + direct.symbol("m") * direct.symbol("z_m")
    symbols = ca.symvar(ca.veccat(K, k, g, S))
    gap = ca.Function("gap", symbols, [K - (k + S * g)])
    assert float(gap(*np.linspace(0.3, 2.0, len(symbols)))) == pytest.approx(0.0, abs=1e-14)


def test_a_balance_that_no_spring_acts_in_has_no_play():
    m = casid.Model("free mass")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    m.derivative(x, v)
    m.balance(v, "force", inertia=1.0, terms=[-m.parameter("d", "N s/m") * v])
    m.output("position", x, "m")
    assert deadzone(m, "force", 1e-3) is None


def test_within_the_gap_nothing_restores_and_beyond_it_the_spring_is_shifted():
    """K s(q, gap) is clip(q, -gap, gap) but for corners of the order of width^2 / |q -+ gap|."""
    gap, width = 0.05, 1e-4
    extended, names = deadzone(MODEL, "torque", width).extended(MODEL)
    term = ca.substitute(extended.balances["torque"].terms[-1], extended.symbol("k"), 1.0)
    f = ca.Function("s", [extended.symbol("phi"), extended.symbol(names[0])], [term])
    for q in (-0.2, -0.06, -0.04, 0.0, 0.03, 0.1):
        corner = width**2 / abs(abs(q) - gap)
        assert float(f(q, gap)) == pytest.approx(np.clip(q, -gap, gap), abs=corner)


@pytest.mark.parametrize("seed", [3, 8])
def test_the_width_of_a_gap_is_recovered_from_a_record(seed: int):
    """Within three standard errors, and one per cent for the rounded corners of the gap."""
    record = truth.cart_pendulum("deadzone", 5.0, seed, duration=40.0, Ts=Ts, noise=NOISE)
    moves = float(np.std(record.clean["phi"]))
    effect = deadzone(MODEL, "torque", 0.01 * moves, 4 * moves)
    fit = fitted(MODEL.extend(effect), record)
    size = record.truth["size"]
    allowed = 3 * std_error(fit, "gap") + 0.01 * size
    assert fit.values["gap"] == pytest.approx(size, abs=allowed)
    assert allowed < 0.5 * size


@pytest.mark.parametrize(("name", "seed"), [("k", 3), ("d", 4)])
def test_the_drift_of_a_parameter_is_recovered_from_a_record(name: str, seed: int):
    """The truth goes from p to p (1 + size) over the record: a change of p size over its window."""
    record = truth.cart_pendulum(
        "parameter_drift", 5.0, seed, duration=40.0, Ts=Ts, noise=NOISE, where=name
    )
    effect = parameter_drift(MODEL, name, (0.0, 40.0))
    fit = fitted(MODEL.extend(effect), record)
    change = record.truth[name] * record.truth["size"]
    allowed = 3 * std_error(fit, f"drift_{name}")
    assert fit.values[f"drift_{name}"] == pytest.approx(change, abs=allowed)
    assert allowed < 0.5 * abs(change)
    middle = record.truth[name] + 0.5 * change
    assert fit.values[name] == pytest.approx(middle, abs=3 * std_error(fit, name))


def test_a_drift_goes_on_after_its_window():
    effect = parameter_drift(MODEL, "k", (10.0, 20.0))
    entry = next(u for u in MODEL.extend(effect).inputs.values() if u.kind == "generated")
    assert entry.signal is not None
    ramp = entry.signal(np.array([10.0, 15.0, 20.0, 30.0]))
    assert ramp == pytest.approx([-0.5, 0.0, 0.5, 1.5])


def test_a_periodic_force_is_nothing_in_a_record_of_another_clock():
    """There its generated inputs are zero: no cosine is left as a constant force."""
    effect = periodic_disturbance(MODEL, "torque", 1.3, (0.0, 8.0))
    extended, names = effect.extended(MODEL)
    term = extended.balances["torque"].terms[-1]
    inputs = [extended.symbol(n) for n, u in extended.inputs.items() if u.kind == "generated"]
    at_rest = ca.substitute(term, ca.vertcat(*inputs), ca.DM.zeros(len(inputs)))
    symbols = [extended.symbol(n) for n in names]
    assert float(ca.Function("f", symbols, [at_rest])(1.0, 1.0, 1.3)) == 0.0
