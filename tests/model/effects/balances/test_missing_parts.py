"""A part that a model omits moves along, and acts back as two bodies or two stores do."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid
from casid.estimation.simulation.integration.simulator import Simulator
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.dimensions import check_units
from casid.model.effects.balances.missing_parts import (
    missing_mode,
    missing_parts_of,
    missing_store,
    mode_frequencies,
    relaxing_spring,
    time_constants,
)
from casid.model.effects.effect import Effect, Sizes, extend_all
from casid.model.effects.places.places import places_of
from casid.model.effects.search_ranges import MISSING_MODES, MISSING_STORES
from problems import pendulum
from tests.support.driven_oscillator import (
    COMMAND,
    SIZES,
    TS,
    D,
    K,
    M,
    N,
    T,
    at,
    criterion_of,
    oscillator,
    positions,
)


def parts_of(model: casid.Model, sizes: Sizes) -> list[Effect]:
    """What is sought in a model."""
    return missing_parts_of(model, places_of(model), sizes)


# -- modes ----------------------------------------------------------------------------------------

OMEGA, ZETA, J = 7.0, 0.04, 0.3


def with_an_appendage() -> np.ndarray:
    """Body and appendage as two masses in absolute coordinates, by scipy."""

    def rate(t, z):
        x, v, s, r = z
        pull = J * (OMEGA**2 * (s - x) + 2 * ZETA * OMEGA * (r - v))
        return [v, (-K * x - D * v + pull + np.interp(t, T, COMMAND)) / M, r, -pull / J]

    solved = solve_ivp(rate, (0, T[-1]), np.zeros(4), t_eval=T, max_step=TS, rtol=1e-8, atol=1e-11)
    return solved.y[0]


def test_a_part_that_swings_along_moves_the_body_as_two_masses_do():
    m = oscillator()
    model = missing_mode(m, "force balance", OMEGA).extend(m, starts={"J_m": J, "zeta_m": ZETA})
    exact = with_an_appendage()
    y = positions(model)
    assert np.abs(y - exact).max() < 3e-4 * np.abs(exact).max()
    assert np.abs(positions(m) - exact).max() > 0.1 * np.abs(exact).max()


def test_a_refit_from_a_neighbouring_frequency_finds_the_mode():
    m = oscillator()
    sd = 2e-4
    y = with_an_appendage() + sd * np.random.default_rng(2).standard_normal(N)
    model = missing_mode(m, "force balance", 6.0).extend(m, starts={"J_m": 0.1})
    fit = minimize_simulation_error(criterion_of(model, y=y))
    errors = sd * np.sqrt(np.diag(np.linalg.inv(fit.solution.hessian)))
    for name, true in (("J_m", J), ("omega_m", OMEGA), ("zeta_m", ZETA)):
        i = fit.criterion.names.index(name)
        assert abs(fit.x[i] - true) < 3 * errors[i]
        assert true > 5 * errors[i]


def test_without_inertia_the_mode_is_not_there_and_its_other_parameters_are_known():
    m = oscillator()
    effect = missing_mode(m, "force balance", OMEGA)
    model, names = effect.extended(m)
    assert positions(model) == pytest.approx(positions(m), abs=1e-15)
    assert [model.parameters[n].is_known for n in names] == [False, True, True]
    fitted, names = effect.extended(m, starts={"J_m": 0.1})
    assert [fitted.parameters[n].is_known for n in names] == [False, False, False]


def test_pinned_at_zero_a_mode_costs_no_sensitivities_and_its_own_stays_exact():
    m = oscillator()
    effect = missing_mode(m, "force balance", OMEGA)
    free, (name, *_) = effect.extended(m)
    pinned, _ = effect.extended(m, upper=0.0)
    jacs = []
    for model in (free, pinned):
        criterion = criterion_of(model)
        jacs.append(criterion.simulate(at(criterion), 0, tangent=True)[2])
    assert jacs[1] == pytest.approx(jacs[0], abs=1e-12 * np.abs(jacs[0]).max())
    s = 1e-5
    slope = (positions(free, **{name: s}) - positions(free)) / s
    i = criterion_of(free).names.index(name)
    assert jacs[0][:, 0, i] == pytest.approx(slope, abs=1e-3 * np.abs(slope).max())
    simulator = Simulator(pinned, TS, ["k", name], pinned={name: 0.0})
    full = Simulator(pinned, TS, ["k", name])
    p = np.array([q.start if q.value is None else q.value for q in pinned.parameters.values()])
    u = COMMAND[:, None]
    a, b = (s.sensitivities(u, p, np.zeros(4)) for s in (simulator, full))
    assert a.dy == pytest.approx(b.dy, abs=1e-12)
    assert a.dx_end is not None
    assert a.dx_end.shape == (4, 6)


def test_modes_are_sought_in_balances_of_inertia_from_slow_to_fast():
    every = parts_of(oscillator(), SIZES)
    found = [e for e in every if not e.is_store]
    assert len(found) == MISSING_MODES.frequencies
    assert len(every) == len(found) + MISSING_STORES.time_constants  # springs that relax
    assert len({e.key for e in found}) == 1
    assert found[0].parameters[0].unit == "N s^2/m"
    frequencies = mode_frequencies(SIZES)
    assert frequencies[0] == pytest.approx(2 * np.pi * 4 / (N * TS))
    assert frequencies[-1] == pytest.approx(np.pi / TS / 3)


def test_a_mode_of_an_indirect_model_stays_in_its_direct_one():
    m = pendulum.problem.model
    model = missing_mode(m, "torque", 9.0).extend(m, starts={"J_m": 0.01})
    direct = model.direct()
    assert {"q_m", "v_m"} < set(direct.states)
    assert "a_y" in direct.inputs
    direct.explicit()


# -- springs that relax ---------------------------------------------------------------------------

RUBBER, RELAXING = 20.0, 0.4  # N/m, s


def on_rubber() -> np.ndarray:
    """The body on a spring beside which a spring and a damper stand in series, by scipy.

    The force F of both in series gives dF/dt / k + F / c = v, with c = k tau.
    """
    c = RUBBER * RELAXING

    def rate(t, z):
        x, v, F = z
        return [v, (-K * x - D * v - F + np.interp(t, T, COMMAND)) / M, RUBBER * (v - F / c)]

    solved = solve_ivp(rate, (0, T[-1]), np.zeros(3), t_eval=T, max_step=TS, rtol=1e-8, atol=1e-11)
    return solved.y[0]


def test_a_spring_that_relaxes_is_one_in_series_with_a_damper():
    m = oscillator()
    model, names = relaxing_spring(m, "force balance", RELAXING).extended(m)
    assert [model.parameters[n].unit for n in names] == ["N/m", "s"]
    assert positions(model) == pytest.approx(positions(m), abs=1e-15)
    starts = {"k_m": RUBBER, "tau_m": RELAXING}
    y = positions(relaxing_spring(m, "force balance", RELAXING).extend(m, starts=starts))
    exact = on_rubber()
    assert np.abs(y - exact).max() < 3e-4 * np.abs(exact).max()
    assert np.abs(positions(m) - exact).max() > 0.1 * np.abs(exact).max()


def two_bodies() -> casid.Model:
    m = casid.Model("two bodies")
    x, v, w = m.state("x", "m"), m.state("v", "m/s"), m.state("w", "m/s")
    k, d = m.parameter("k", "N/m", start=K), m.constant("d", D, "N s/m")
    mass = m.constant("M", M, "kg")
    m.derivative(x, v - w)
    m.balance(v, "front", inertia=mass, terms=[-k * x, -d * v, m.input("pull", "N")])
    m.balance(w, "rear", inertia=mass, terms=[k * x, -d * w])
    m.output("reach", x, "m")
    return m


def test_a_spring_between_two_bodies_relaxes_in_any_model_with_these_bodies():
    sizes = Sizes({"x": 0.1, "v": 1.0, "w": 1.0}, {}, (0.0, N * TS), 0.1, TS)
    every = parts_of(two_bodies(), sizes)
    springs = {e.where: e for e in every if e.is_store}
    assert set(springs) == {"front", "rear", "v-w"}
    extended, _ = extend_all(two_bodies(), list(springs.values()))
    check_units(extended)
    e = extended.explicit()
    assert ca.Function("rates", [e.x, e.u, e.p], [e.f]).size1_out(0) == 3 + len(springs)


@pytest.mark.slow
def test_rubber_is_named_with_its_stiffness_and_its_time():
    noise = 2e-4 * np.random.default_rng(8).standard_normal(N)
    record = casid.Record(
        {"force": COMMAND, "position": on_rubber() + noise}, {"force": "N", "position": "m"}, Ts=TS
    )
    m = casid.Model("body")
    x, v = m.state("x", "m", initial=0.0), m.state("v", "m/s", initial=0.0)
    force = m.input("force", "N", hold="foh", known=True)
    k, d = m.parameter("k", "N/m", start=K), m.parameter("d", "N s/m", start=D)
    m.derivative(x, v)
    m.balance(v, "force balance", inertia=m.constant("M", M, "kg"), terms=[-k * x, -d * v, force])
    m.output("position", x, "m")
    found = casid.diagnose(casid.Problem("rubber", m), record)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("missing_mode", "force balance")
    assert "relaxes with a time constant, as that of rubber" in str(found)
    for name, true in (("k_m", RUBBER), ("tau_m", RELAXING)):
        size = next(p for p in cause.parameters if p.name == name)
        assert abs(size.value - true) < 3 * size.std_error
        assert true > 5 * size.std_error


# -- stores ---------------------------------------------------------------------------------------

HEAT = np.where((np.arange(N) // 50) % 2, 300.0, 0.0)
C1, C2, G, H = 40.0, 90.0, 8.0, 15.0  # J/K, J/K, W/K to the outside, W/K between both


def oven(unit: str = "J/K") -> casid.Model:
    m = casid.Model("oven")
    T = m.state("T", "K")
    P = m.input("P", "W", hold="zoh", known=True)
    C = m.parameter("C", unit, start=C1 if unit == "J/K" else C1 / 1000)
    m.balance(T, "heat", inertia=C, terms=[-m.parameter("G", "W/K", start=G) * T, P])
    m.output("temperature", T, "K")
    return m


def heated(behind: float = 0.0) -> np.ndarray:
    """Two masses that exchange heat, the second one `behind` [K] cooler at first, by scipy."""

    def rate(_t, z, P):
        T, S = z
        return [(P - G * T - H * (T - S)) / C1, H * (T - S) / C2]

    z, out = np.array([0.0, -behind]), np.empty(N)
    for i, P in enumerate(HEAT):
        out[i] = z[0]
        z = solve_ivp(rate, (0, TS_HEAT), z, args=(P,), rtol=1e-10, atol=1e-10).y[:, -1]
    return out


TS_HEAT = 0.1
HEATED = Sizes({"T": 10.0}, {}, (0.0, N * TS_HEAT), 0.1, TS_HEAT)


def oven_criterion(model, y) -> SimulationError:
    record = casid.Record({"P": HEAT, "temperature": y}, {"P": "W", "temperature": "K"}, Ts=TS_HEAT)
    return SimulationError(model, [casid.Experiment(record, {}, "r")], weights=np.ones(1))


def test_a_store_behind_another_moves_it_as_two_masses_that_exchange_heat_do():
    m = oven()
    model = missing_store(m, "heat", 3.0).extend(m, starts={"C_m": C2, "tau_m": C2 / H})
    found = oven_criterion(model, np.zeros(N))
    y = found.simulate(at(found), 0)[0][:, 0]
    exact = heated()
    assert np.abs(y - exact).max() < 1e-6 * np.abs(exact).max()
    alone = oven_criterion(m, np.zeros(N))
    assert np.abs(alone.simulate(at(alone), 0)[0][:, 0] - exact).max() > 0.1 * exact.max()


@pytest.mark.parametrize("behind", [0.0, 6.0])
def test_a_refit_finds_capacity_and_time_constant_of_a_store_wherever_it_began(behind: float):
    sd = 0.02
    y = heated(behind) + sd * np.random.default_rng(3).standard_normal(N)
    m = oven()
    model = missing_store(m, "heat", 3.0).extend(m, starts={"C_m": 30.0})
    fit = minimize_simulation_error(oven_criterion(model, y))
    errors = sd * np.sqrt(np.diag(np.linalg.inv(fit.solution.hessian)))
    truth = {"C": C1, "G": G, "C_m": C2, "tau_m": C2 / H, "r_m(0)": behind}
    for name, true in truth.items():
        i = fit.criterion.names.index(name)
        assert abs(fit.x[i] - true) < 3 * errors[i], name


def test_without_capacity_a_store_is_not_there_and_starts_level():
    m = oven()
    model, names = missing_store(m, "heat", 3.0).extended(m)
    assert [model.parameters[n].is_known for n in names] == [False, True]
    assert model.states["r_m"].initial == 0.0
    there = missing_store(m, "heat", 3.0).extend(m, starts={"C_m": 1.0})
    assert there.states["r_m"].initial is None
    both = [oven_criterion(x, np.zeros(N)) for x in (m, model)]
    y, y_null = (c.simulate(at(c), 0)[0] for c in both)
    assert y_null == pytest.approx(y, abs=1e-12)


def test_a_store_is_shown_in_the_unit_of_the_one_that_it_follows():
    m = oven("kJ/K")
    model, (name, _) = missing_store(m, "heat", 3.0).extended(m)
    assert model.declared_units[name] == "kJ/K"
    assert missing_store(oven(), "heat", 3.0).parameters[0].unit == m.parameters["C"].unit


def test_stores_are_sought_in_balances_without_a_position_from_samples_to_a_share_of_the_record():
    m = oven()
    found = parts_of(m, HEATED)
    assert len(found) == MISSING_STORES.time_constants
    assert {e.key for e in found} == {("missing_mode", "heat")}
    times = time_constants(HEATED)
    assert times[0] == pytest.approx(4 * TS_HEAT)
    assert times[-1] == pytest.approx(0.25 * N * TS_HEAT)
    assert time_constants(Sizes({}, {}, (0.0, 1.0), 0.1, 0.1)) == []


def test_between_two_bodies_a_part_swings_and_acts_on_both():
    """By scipy: what it gives to the one body it takes from the other."""
    m, J1, J2, k, c = casid.Model("drive"), 0.5, 0.8, 30.0, 0.2
    torque = m.input("torque", "N m", hold="foh", known=True)
    w1, w2 = (m.state(n, "rad/s", initial=0.0) for n in ("w1", "w2"))
    e = m.state("e", "rad", initial=0.0)
    first = m.parameter("J1", "kg m^2", start=J1, lower=0.0)
    stiffness = m.parameter("k", "N m/rad", start=k)
    shaft = stiffness * e + c * (w1 - w2)
    m.derivative(e, w1 - w2)
    m.balance(w1, "motor", inertia=first, terms=[torque, -shaft])
    m.balance(w2, "load", inertia=J2, terms=[shaft])
    m.output("speed", w1, "rad/s")
    effect = missing_mode(m, "w1-w2", OMEGA)
    assert effect.description == "acts on e between motor and load"
    assert {e.where for e in parts_of(m, SIZES)} == {"motor", "load", "w1-w2"}
    model = effect.extend(m, starts={"J_m": J, "zeta_m": ZETA})

    def rate(t, z):
        w1, w2, e, q, v = z
        spring = OMEGA**2 * q + 2 * ZETA * OMEGA * v
        shaft = k * e + c * (w1 - w2) - J * spring
        d1, d2 = (np.interp(t, T, COMMAND) - shaft) / J1, shaft / J2
        return [d1, d2, w1 - w2, v, -spring - (d1 - d2)]

    solved = solve_ivp(rate, (0, T[-1]), np.zeros(5), t_eval=T, max_step=TS, rtol=1e-8, atol=1e-11)
    record = casid.Record(
        {"torque": COMMAND, "speed": np.zeros(N)}, {"torque": "N m", "speed": "rad/s"}, Ts=TS
    )
    criterion = SimulationError(model, [casid.Experiment(record, {}, "r")], weights=np.ones(1))
    found = criterion.simulate(at(criterion), 0)[0][:, 0]
    assert found == pytest.approx(solved.y[0], abs=3e-4 * np.abs(solved.y[0]).max())


def test_a_body_without_a_position_may_have_a_part_that_swings_along():
    """A motor of which the speed alone is modelled, with an elastic load behind it."""
    shaft = casid.Model("shaft")
    w = shaft.state("w", "rad/s")
    shaft.balance(w, "torque", inertia=1.0, terms=[-shaft.parameter("d", "N m s/rad") * w])
    shaft.output("speed", w, "rad/s")
    found = parts_of(shaft, Sizes({"w": 1.0}, {}, (0.0, 60.0), 0.1, 0.1))
    assert {e.where for e in found} == {"torque"}


def test_modes_of_coupled_balances_are_solved_for_beside_effects_in_their_inertias():
    """Two joints of an arm, each with the other's acceleration in its balance."""
    m = casid.Model("arm")
    q, v, w = m.state("q", "rad"), m.state("v", "rad/s"), m.state("w", "rad/s")
    J, K = m.parameter("J", "kg m^2", lower=0.0), m.parameter("K", "kg m^2", lower=0.0)
    m.derivative(q, v)
    coupling = 0.5 * J * ca.cos(q)
    m.balance(v, "shoulder", inertia=J, terms=[-coupling * m.der(w)], unit="N m")
    m.balance(w, "elbow", inertia=K, terms=[-coupling * m.der(v)], unit="N m")
    m.output("angle", q, "deg")
    modes = [missing_mode(m, b, omega) for omega in (1.0, 2.0, 4.0) for b in m.balances]
    extended, _ = extend_all(m, modes)
    explicit = extended.explicit()
    assert len(explicit.states) == 3 + 2 * len(modes)
    assert extended.name == "arm + missing_mode + missing_mode + missing_mode + 3 more"
