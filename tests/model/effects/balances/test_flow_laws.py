"""Laws of flow: a power of a level in the place of the level, wherever it flows."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

import casid
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.balances.flow_laws import (
    coefficients_of_flows,
    is_never_negative,
    power_law,
    radiation,
    saturating_law,
    states_with_one_law,
)
from casid.model.effects.names import effect_words
from casid.model.effects.places.elements import elements_of
from casid.model.rate_laws import with_balances
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


def test_an_exponent_is_no_percentage_of_a_level_in_per_cent():
    m = casid.Model("tank whose level is a share")
    h = m.state("h", "%", start=50.0)
    m.balance(h, "h", inertia=1, terms=[-m.parameter("k", "1/s", start=0.1) * h], unit="%/s")
    m.output("level", h, "%")
    effect = power_law(m, "h", 0.5)
    assert effect is not None
    extended, (exponent,) = effect.extended(m)
    assert (extended.unit_of(exponent), extended.shown(exponent, 0.5)) == ("1", 0.5)


def test_springs_and_speeds_with_a_position_follow_no_power_law():
    model = pendulum.problem.model
    assert power_law(model, "phi", 0.1) is None
    assert power_law(model, "p", 0.1) is None


def test_a_shaft_and_what_it_couples_follow_no_law_of_flow():
    """Friction that levels off is dry, and a twist is no store: its rate is that of two bodies."""
    m = casid.Model("drive train")
    w, g, e = m.state("w", "rpm"), m.state("g", "rpm"), m.state("e", "deg")
    T = m.input("T", "N m", known=True)
    J = m.constant("J", 0.1, "kg m^2")
    k, b = m.parameter("k", "N m/rad", start=10.0), m.parameter("b", "N m s/rad", start=0.1)
    m.derivative(e, w - g)
    m.balance(w, "motor", inertia=J, terms=[T, -k * e])
    m.balance(g, "load", inertia=J, terms=[k * e, -b * g])
    m.output("w", w, "rpm")
    for state in ("w", "g", "e"):
        assert power_law(m, state, 1.0) is None
        assert saturating_law(m, state, 1.0) is None


def test_a_pressure_that_a_piston_changes_is_a_store():
    """Its rate depends on the speed, and on its own leak."""
    m = casid.Model("cylinder")
    v, p = m.state("v", "m/s"), m.state("p", "bar")
    c, A = m.parameter("c", "1/s", start=1.0), m.constant("A", 1e-3, "m^2")
    m.derivative(p, m.constant("s", 1e8, "Pa/m") * v - c * p)
    m.balance(v, "force", inertia=m.constant("M", 5.0, "kg"), terms=[-A * p])
    m.output("p", p, "bar")
    assert power_law(m, "p", 1.0) is not None


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


VOLUME, HALF, MOST = 0.002, 5.0, 0.8 / 60  # m^3, mmol/L, mmol/(L s)


def reactor() -> casid.Model:
    """A stirred reactor with a flow through it, whose substrate reacts in proportion to itself."""
    m = casid.Model("reactor")
    S, P = m.state("S", "mmol/L", start=6.0), m.state("P", "mmol/L", start=4.0)
    fed = m.input("fed", "mmol/L", hold="zoh", known=True)
    F = m.input("F", "m^3/s", hold="zoh", known=True)
    V = m.constant("V", VOLUME, "m^3")
    k = m.parameter("k", "1/s", start=1e-3, lower=0.0)
    m.balance(S, "substrate", inertia=V, terms=[F * (fed - S), -k * V * S])
    m.balance(P, "product", inertia=V, terms=[-F * P, k * V * S])
    m.output("S_m", S, "mmol/L")
    m.output("P_m", P, "mmol/L")
    return m


def saturated(S: float, P: float) -> float:
    """An enzyme's uptake [mmol/(L s)] by Michaelis and Menten."""
    return MOST * S / (HALF + S)


def reactor_record(
    uptake: Callable[[float, float], float] = saturated, N: int = 600, Ts: float = 30.0
) -> casid.Record:
    """The reactor with an uptake of substrate and product; sensors with noise of 0.05 mmol/L."""
    rng = np.random.default_rng(4)
    fed = np.repeat(rng.uniform(4.0, 24.0, N // 60 + 1), 60)[:N]
    F = np.repeat(rng.uniform(1e-6, 5e-6, N // 40 + 1), 40)[:N]
    x, seen = np.array([6.0, 4.0]), np.empty((N, 2))

    def rates(x: Array, i: int) -> Array:
        taken = uptake(x[0], x[1])
        return np.array([F[i] * (fed[i] - x[0]), -F[i] * x[1]]) / VOLUME + [-taken, taken]

    for i in range(N):
        seen[i] = x
        for _ in range(4):  # Heun's method, 7.5 s against the 400 s of the flow through the vessel
            first = rates(x, i)
            x = x + Ts / 8 * (first + rates(x + Ts / 4 * first, i))
    seen += 0.05 * rng.standard_normal(seen.shape)
    columns = {"fed": fed, "F": F, "S_m": seen[:, 0], "P_m": seen[:, 1]}
    units = {"fed": "mmol/L", "F": "m^3/s", "S_m": "mmol/L", "P_m": "mmol/L"}
    return casid.Record(columns, units, Ts)


def slopes_at(model: casid.Model, at: list[float], values: dict[str, float]) -> Array:
    """The right-hand sides of a model's states, with its inputs at 1 in their SI unit."""
    e = model.explicit()
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    return np.ravel(f(at, np.ones(e.u.numel()), [values[n] for n in e.parameters]))


def test_what_a_recorded_flow_carries_along_follows_no_law():
    """F (fed - S) stays what it is beside k V S^n; the product is carried only, and has no law."""
    model = reactor()
    assert power_law(model, "P", 4.0) is None
    assert saturating_law(model, "P", 4.0) is None
    effect = power_law(model, "S", 6.0)
    assert effect is not None
    extended, (n,) = effect.extended(model)
    S, P = 9.0, 2.0
    values = {"V": VOLUME, "k": 1e-3, n: 2.0}
    uptake = 1e-3 * S**2 / 6.0
    assert slopes_at(extended, [S, P], values) == pytest.approx(
        [(1.0 - S) / VOLUME - uptake, -P / VOLUME + uptake], rel=1e-9
    )


def test_a_flow_with_an_estimated_coefficient_is_a_law():
    """A valve that an input opens, beside what the flow F through the vessel carries."""
    m = casid.Model("vessel")
    h, F, opening = m.state("h", "m", start=1.0), m.input("F", "m^2/s"), m.input("opening", "1")
    k = m.parameter("k", "m^2/s", start=0.1)
    m.balance(h, "level", inertia=m.constant("A", 2.0, "m^2"), terms=[-(F + k * opening) * h])
    m.output("h_m", h, "m")
    effect = power_law(m, "h", 4.0)
    assert effect is not None
    extended, (n,) = effect.extended(m)
    found = slopes_at(extended, [9.0], {"A": 2.0, "k": 0.1, n: 0.5})
    assert found == pytest.approx([-(9.0 + 0.1 * 4.0 * 1.5) / 2.0], rel=1e-6)


def test_a_saturating_law_levels_off_in_every_balance_that_the_reaction_enters():
    """x (1 + r x_ref) / (1 + r x): what it was at x_ref, and at most (1 + r x_ref) / r."""
    model = reactor()
    effect = saturating_law(model, "S", 6.0)
    assert effect is not None
    assert effect.key == ("unknown", "substrate: S/(K+S)")
    extended, (r,) = effect.extended(model)
    for S in (6.0, 9.0, 1e5):
        uptake = 1e-3 * S * (1 + 0.2 * 6.0) / (1 + 0.2 * S)
        found = slopes_at(extended, [S, 2.0], {"V": VOLUME, "k": 1e-3, r: 0.2})
        assert found + [-(1 - S) / VOLUME, 2.0 / VOLUME] == pytest.approx(
            [-uptake, uptake], rel=1e-6, abs=1e-9 * S / VOLUME
        )


def test_growth_levels_off_with_what_the_cells_live_on():
    """k S X, of cells X and their sugar S, becomes Monod's law of S; a power law of it is none."""
    m = casid.Model("cells")
    X, S = m.state("X", "kg/m^3", start=1.0), m.state("S", "kg/m^3", start=10.0)
    k, y = m.parameter("k", "m^3/(kg s)", start=0.1), m.parameter("y", "1", start=2.0)
    m.derivative(X, k * S * X)
    m.derivative(S, -y * k * S * X)
    m.output("X_m", X, "kg/m^3")
    m = with_balances(m)
    assert power_law(m, "S", 10.0) is None
    effect = saturating_law(m, "S", 10.0)
    assert effect is not None
    extended, (r,) = effect.extended(m)
    growth = 0.1 * 3.0 * 4.0 * (1 + 0.5 * 10.0) / (1 + 0.5 * 4.0)
    assert slopes_at(extended, [3.0, 4.0], {"k": 0.1, "y": 2.0, r: 0.5}) == pytest.approx(
        [growth, -2.0 * growth], rel=1e-5
    )


def two_compartments() -> casid.Model:
    """Plasma that is cleared and exchanges with tissue."""
    m = casid.Model("two compartments")
    c, p = m.state("c", "mg/L", initial=0.0), m.state("p", "mg/L", initial=0.0)
    V, CL = m.parameter("V", "L", start=12.0), m.parameter("CL", "L/h", start=3.0)
    Q = m.parameter("Q", "L/h", start=6.0)
    m.balance(c, "plasma", inertia=V, terms=[-CL * c, -Q * (c - p)])
    m.balance(p, "tissue", inertia=m.constant("V_p", 25.0, "L"), terms=[Q * (c - p)])
    m.output("conc", c, "mg/L")
    return m


def test_of_several_flows_one_may_level_off_alone():
    """The clearance does, the exchange with the tissue goes on; it is not a flow of c alone."""
    m = two_compartments()
    assert coefficients_of_flows(m, "c") == ["CL"]
    assert coefficients_of_flows(m, "p") == []
    assert coefficients_of_flows(reactor(), "S") == []  # its one flow is that law itself
    effect = saturating_law(m, "c", 0.01, of="CL")
    assert effect is not None
    assert effect.key == ("unknown", "plasma: CL c/(K+c)")
    extended, (r,) = effect.extended(m)
    V, CL, Q = 12e-3, 3e-3 / 3600, 6e-3 / 3600
    c, p, K = 0.02, 0.005, 0.012
    out = CL * c * (1 + 0.01 / K) / (1 + c / K)
    values = {"V": V, "CL": CL, "Q": Q, "V_p": 25e-3, r: 1 / K}
    assert slopes_at(extended, [c, p], values) == pytest.approx(
        [-(out + Q * (c - p)) / V, Q * (c - p) / 25e-3], rel=1e-6
    )


def test_what_starts_at_zero_may_level_off_and_what_goes_below_may_not():
    assert is_never_negative((0.0, 5.0))
    assert is_never_negative((-1e-4, 5.0))
    assert not is_never_negative((-0.1, 5.0))
    assert not is_never_negative((0.0, np.inf))


def test_no_temperature_has_a_law_that_levels_off():
    m = casid.Model("body")
    T, G = m.state("T", "K", start=300.0), m.parameter("G", "W/K", start=1.0)
    m.balance(T, "heat", inertia=m.constant("C", 10.0, "J/K"), terms=[-G * T])
    m.output("T_m", T, "K")
    assert saturating_law(m, "T", 300.0) is None
    assert power_law(m, "T", 300.0) is not None


def test_michaelis_mentens_constant_is_recovered_and_no_power_does_as_well():
    """1/K within three standard errors of white output noise, from a model without saturation."""
    experiments = [casid.Experiment(reactor_record(), {}, "r")]
    left = {}
    for law in (saturating_law, power_law):
        effect = law(reactor(), "S", 6.0)
        assert effect is not None
        extended, (name,) = effect.extended(reactor())
        fit = fit_model(extended, experiments, FitSettings(starts=1, substeps=2))
        c = fit.criterion
        r, j = c.columns(fit.x, 0)
        left[law] = float(np.var(r))
        sd = np.linalg.inv(np.einsum("kin,kim->nm", j, j)) * np.var(r)
        if law is saturating_law:
            i = c.names.index(name)
            assert sd[i, i] ** 0.5 < 0.01 / HALF
            assert fit.x[i] == pytest.approx(1 / HALF, abs=3 * sd[i, i] ** 0.5)
    assert left[power_law] > 1.5 * left[saturating_law]


def plate(heat: str = "W") -> casid.Model:
    """A plate that loses heat to the air, in proportion to the difference."""
    m = casid.Model("plate")
    T = m.state("T", "K", start=350.0)
    P, air = m.input("P", heat, hold="zoh", known=True), m.input("air", "K", known=True)
    per_kelvin = {"W": ("kJ/K", "W/K"), "K/s": ("1", "1/s")}[heat]
    C = m.parameter("C", per_kelvin[0], start=2.0, lower=0.1)
    G = m.parameter("G", per_kelvin[1], start=5.0, lower=0.0)
    m.balance(T, "plate", inertia=C, terms=[P, -G * (T - air)])
    m.output("plate_T", T, "K")
    return m


def radiated(area: float, N: int = 600) -> casid.Record:
    """A plate of 2 kJ/K and 4 W/K that radiates from this area [m^2]; 0.1 K of noise, 10 s."""
    rng = np.random.default_rng(2)
    P, air = np.repeat(rng.uniform(0.0, 3000.0, N // 50), 50), np.full(N, 293.0)
    T, shown = 350.0, np.empty(N)
    for k in range(N):
        shown[k] = T
        for _ in range(20):
            loss = 4.0 * (T - air[k]) + 5.670374419e-8 * area * (T**4 - air[k] ** 4)
            T += 0.5 * (P[k] - loss) / 2000.0
    units = {"P": "W", "air": "K", "plate_T": "K"}
    shown += 0.1 * rng.standard_normal(N)
    return casid.Record({"P": P, "air": air, "plate_T": shown}, units, Ts=10.0)


def test_radiation_is_between_two_temperatures_that_exchange_heat():
    (place,) = elements_of(plate())
    effect = radiation(plate(), place)
    assert effect is not None
    (area,) = effect.parameters
    assert (area.unit, effect.shape) == ("m^2", "T^4")
    assert effect_words(*effect.key, description=effect.description) == "radiation in T-air"
    assert radiation(plate("K/s"), elements_of(plate("K/s"))[0]) is None
    assert radiation(plate(), "plate") is None


@pytest.mark.slow
def test_radiation_is_named_with_its_area():
    problem = casid.Problem("plate", plate(), starts=1)
    (cause,) = casid.diagnose(problem, radiated(0.1), advise=False).causes
    (area,) = cause.parameters
    assert cause.words == "radiation in T-air"
    assert abs(area.value - 0.1) < 4 * area.std_error < 0.02
