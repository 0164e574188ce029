"""A random force that nobody recorded is reported with its place, size and share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

import casid
from casid.diagnosis.evidence.disturbances import Disturbance, disturbances_of, p_value_of
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.rate_laws import with_balances

SD, Ts = 0.4, 0.05


def oscillator() -> casid.Model:
    """v' = -c v - k x + F + torque, x measured."""
    m = casid.Model("oscillator")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold="zoh")
    mass = m.parameter("mass", "kg", value=1.0)
    k = m.parameter("k", "N/m", start=20.0, lower=1.0, upper=100.0)
    c = m.parameter("c", "N s/m", start=2.0, lower=0.1, upper=20.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[-k * x, -c * v, F], unit="N")
    m.output("y", x, "m")
    return m


def record(sd: float, seed: int, N: int = 2400) -> casid.Record:
    """The oscillator held between samples, exactly discretised, with a white force of `sd`."""
    k, c = 25.0, 1.5
    rng = np.random.default_rng(seed)
    h = Ts / 50
    A = np.array([[0.0, 1.0], [-k, -c]])
    step = np.eye(2) + h * A + (h * A) @ (h * A) / 2
    Ad, B, power = np.eye(2), np.zeros(2), np.eye(2)
    for _ in range(50):
        B = B + power @ np.array([0.0, h])
        power = step @ power
    Ad = power
    F = np.convolve(rng.standard_normal(N), np.ones(6) / 2, mode="same")
    w = sd * rng.standard_normal(N)
    x, y = np.zeros(2), np.empty(N)
    for i in range(N):
        y[i] = x[0]
        x = Ad @ x + B * (F[i] + w[i])
    y += 0.002 * rng.standard_normal(N)
    return casid.Record({"y": y, "F": F}, {"y": "m", "F": "N"}, Ts=Ts, name="shaken")


@pytest.mark.slow
def test_a_random_force_is_a_disturbance_of_its_size_and_no_deficiency():
    """The model is the truth; the force is white from sample to sample (independent simulator)."""
    problem = casid.Problem("oscillator", oscillator(), channels={"y": "y:m", "F": "F:N"})
    data = casid.Experiment(record(SD, seed=4), {}, "shaken")
    d = casid.diagnose(problem, data, advise=False, starts=1)
    assert d.verdict == "adequate"
    (found,) = d.disturbances
    assert (found.where, found.unit) == ("force", "N")
    assert found.std == pytest.approx(SD, rel=0.15)  # 2400 samples: 1.5 % to 5 % by chance
    assert found.share > 0.9  # of an error of some cm beside 2 mm of sensor noise
    assert d.to_json()["disturbances"][0]["std"] == found.std
    assert "an unrecorded random disturbance acts on force" in str(d)
    assert "Find what acts on force and record it" in d.advice  # not: the model may be used
    assert "--disturbance force:white" in d.advice
    assert d.noise["force"].startswith("random disturbance, standard deviation")


def test_a_disturbance_that_nobody_would_see_is_not_listed():
    """Without any random force, its estimated variance ends at next to nothing."""
    problem = casid.Problem("oscillator", oscillator(), channels={"y": "y:m", "F": "F:N"})
    data = casid.Experiment(record(0.0, seed=4), {}, "quiet")
    d = casid.diagnose(problem, data, advise=False, starts=1)
    assert d.verdict == "adequate"
    assert d.disturbances == ()
    assert "force" not in d.noise
    assert "random disturbance" not in str(d)


def fitted(sd: float, seed: int) -> Weighted:
    """The model fitted to 500 samples, with the noise found there."""
    data = [casid.Experiment(record(sd, seed, N=500), {}, "r")]
    model = oscillator().with_known(mass=1.0)
    fit = minimize_simulation_error(SimulationError(model, data, weights=np.ones(1)))
    return Weighing(data).estimated(fit)


@pytest.mark.slow
def test_noise_of_a_sensor_seems_to_be_a_force_as_often_as_the_level_says():
    """Half of the ratios are zero, p = 1; what the others have is chi-square of one degree."""
    draws, level = 60, 0.1
    p = [p_value_of(fitted(0.0, 100 + i), ["force"]) for i in range(draws)]
    assert sum(x < level for x in p) <= binom.ppf(0.999, draws, level)
    assert sum(x > 0.4 for x in p) > binom.ppf(0.001, draws, 0.5)


def test_a_force_that_its_inputs_noise_cannot_be_is_found_and_chance_is_not():
    """A floor of the recorded input bounds what its own noise could explain of the residual."""
    at = fitted(0.4, seed=5)
    assert p_value_of(at, ["F", "force"]) < 1e-6
    (found,) = disturbances_of(at, 0.01)
    assert found.where in ("F", "force")  # both act alike, but for the hold of the input
    assert disturbances_of(at, 1e-300) == ()


def test_a_disturbance_has_the_unit_that_is_requested_and_a_spectrum_in_words():
    narrow = Disturbance("force", 0.4, "N", 0.5, peak=1.4, bandwidth=0.2)
    assert narrow.in_units({"force": "kN"}).std == pytest.approx(4e-4)
    assert "a band 0.2 Hz wide around 1.4 Hz" in narrow.sentence
    assert "most of its power below 1.7 Hz" in replace(narrow, bandwidth=2.0, peak=0.7).sentence
    assert "flat spectrum" in replace(narrow, bandwidth=None, peak=None).sentence
    assert narrow.spectral_form == "peak"
    assert replace(narrow, bandwidth=2.0, peak=0.7).spectral_form == "first"
    assert replace(narrow, bandwidth=None, peak=None).spectral_form == "white"


def test_a_slow_disturbance_is_told_by_its_period_and_a_daily_one_as_such():
    sun = Disturbance("wall", 200.0, "W", 0.9, peak=1.3e-5, bandwidth=5e-6)
    assert "(a period of 21.4 h; once a day" in sun.sentence
    tide = replace(sun, peak=2.2e-5)
    assert "(a period of 12.6 h)" in tide.sentence
    assert "period" not in replace(sun, peak=0.1, bandwidth=0.01).sentence


def test_a_disturbance_has_the_unit_of_its_balance_though_an_output_has_its_name():
    """A balance and a sensor of CO2 may have one name: its flow is in L/h, not in ppm or m^3/s."""
    m = casid.Model("room")
    C, q = m.state("C", "ppm"), m.parameter("q", "m^3/h", start=100.0, lower=90.0, upper=110.0)
    V = m.constant("V", 50.0, "m^3")
    m.balance(C, "CO2", inertia=V, terms=[-q * C], unit="L/h")
    m.output("CO2", C, "ppm")
    rng = np.random.default_rng(2)
    level, flow = np.zeros(800), 1e-6 * rng.normal(size=800)  # m^3/s, that is 3.6 L/h
    for k in range(799):
        keep = np.exp(-100 / 3600 * 60 / 50)
        level[k + 1] = keep * level[k] + (1 - keep) * flow[k] * 36
    shown = level + 1e-6 * rng.normal(size=800)
    data = [casid.Experiment(casid.Record({"CO2": shown}, {"CO2": "1"}, Ts=60.0), {}, "r")]
    fit = minimize_simulation_error(SimulationError(m, data, weights=np.ones(1)))
    (found,) = disturbances_of(Weighing(data).estimated(fit), 0.01)
    assert (found.where, found.unit) == ("CO2", "L/h")
    assert found.std == pytest.approx(3.6, rel=0.2)


def test_the_law_of_a_state_does_not_have_the_states_unit():
    """dw/dt = ... is called by its state, in rpm; a force in it is in rad/s^2."""
    wind = Disturbance("w", 0.13, "rad/s^2", 0.9)
    assert wind.in_units({"w": "rpm"}) == wind


def test_a_force_by_the_name_of_an_output_is_tested_beside_the_outputs_noise():
    """Held at nothing, it leaves the sensor its noise: a level that is still has no disturbance."""
    rng = np.random.default_rng(3)
    m = casid.Model("tank")
    level, tau = m.state("level", "m"), m.parameter("tau", "s", start=8.0, lower=1.0)
    m.derivative(level, -level / tau)
    m.output("level", level, "m")
    y = np.exp(-np.arange(300) / 8.0) + 0.005 * rng.standard_normal(300)
    data = casid.Experiment(casid.Record({"level": y}, {"level": "m"}, Ts=1.0), {}, "r")
    model = with_balances(m)
    fit = minimize_simulation_error(SimulationError(model, [data]))
    assert p_value_of(Weighing([data]).estimated(fit), ["level"]) > 0.05


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_input_with_somewhat_more_noise_than_its_floor_has_no_disturbance_beside_it(seed):
    """The floor of 1200 samples errs by a tenth of the variance; the residual shows it to 5 %."""
    rng = np.random.default_rng(seed)
    N, noise = 1200, 0.3
    F = np.convolve(rng.standard_normal(N), np.ones(40) / 6, mode="same")
    y, level = np.empty(N), 0.0
    for i in range(N):
        y[i] = level
        level = np.exp(-0.5 * Ts) * level + (1 - np.exp(-0.5 * Ts)) / 0.5 * F[i]
    m = casid.Model("store")
    x, inflow = m.state("x", "m"), m.input("F", "m/s")
    a = m.parameter("a", "1/s", start=0.5, lower=0.1, upper=5.0)
    m.balance(x, "volume", inertia=1, terms=[inflow, -a * x], unit="m/s")
    m.output("y", x, "m")
    read = F + noise * rng.standard_normal(N)
    read_y = y + 0.02 * rng.standard_normal(N)
    data = casid.Record({"y": read_y, "F": read}, {"y": "m", "F": "m/s"}, Ts=Ts, name="store")
    data = [casid.Experiment(data, {}, "r")]
    fit = minimize_simulation_error(SimulationError(m, data, weights=np.ones(1)))
    at = Weighing(data).estimated(fit)
    less = replace(at, input_sd={"F": 0.9 * at.full.source_sd["F"]})
    assert p_value_of(less, ["F", "volume"]) > 0.2
    far = replace(at, input_sd={"F": 0.6 * at.full.source_sd["F"]})
    assert p_value_of(far, ["F", "volume"]) < 1e-6
