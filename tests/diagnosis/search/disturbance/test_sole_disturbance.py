"""Nothing is sought where a random disturbance is all that a model leaves; a cause always is."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.gain_under_disturbance import (
    gains_under_disturbance,
    unwhitened,
)
from casid.diagnosis.evidence.scores.signature_columns import extended_columns
from casid.diagnosis.evidence.whitening import prewhitening
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted, minus_log_likelihood
from casid.diagnosis.search.disturbance.disturbance_price import (
    price_of,
    with_lines_beside_disturbances,
)
from casid.diagnosis.search.disturbance.sole_disturbance import sole_disturbance
from casid.diagnosis.search.instants.jump_times import placed_by_tangents
from casid.diagnosis.search.instants.temporary_changes import temporary_changes
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import DISTURBED, RESTARTS
from casid.estimation.disturbances.disturbance_estimation import with_disturbance_spectra
from casid.estimation.holdout import split_records
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.variances import error_over_noise
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.balances.balance_effects import quadratic_damping
from casid.model.effects.clock_effects import offset_step
from casid.model.effects.effect import Effect
from tests.diagnosis.search.noise_assumptions.test_disturbance_rival import hull, record
from tests.diagnosis.test_effects_in_time import T, slide
from tests.diagnosis.test_effects_in_time import record as loaded
from tests.support.heated_vessel import changed_vessel, vessel


def noisy(of: casid.Record, sd: float = 0.012) -> casid.Record:
    """The same with sensors that have more noise: the waves are some six times theirs."""
    rng = np.random.default_rng(7)
    moved = {n: of[n] + sd * rng.standard_normal(of.N) for n in ("roll", "rate")}
    return casid.Record({"fin": of["fin"], **moved}, of.units, Ts=of.Ts)


def started(of: casid.Record, model: casid.Model | None = None) -> tuple[Search, Weighted, Fit]:
    """A model, by default that of a hull in a sea, before anything is sought."""
    model = model or hull().model
    split = split_records([casid.Experiment(of, {}, "run")], 0.3)
    weighing = Weighing(split.fitted)
    base = fit_model(model, split.fitted, FitSettings(starts=1))
    return Search(weighing, {}), weighing.weigh(model, base), base


def assert_exact_instants_gain(bare: Weighted, start: Weighted, *, rough: Effect, exact: Effect):
    """Beside the disturbance, an effect pays for itself at its exact instants, and there alone."""
    at = replace(bare, fit=bare.unbiased or bare.fit)
    columns = extended_columns(replace(at.fit, criterion=unwhitened(at)), [rough, exact])
    needed = 0.5 * price_of(exact.cost, start.criterion.n_samples, 50)
    gains = [
        max(gains_under_disturbance(at, columns, [i], known={}, passing=needed, under=start.noise))
        for i in (0, 1)
    ]
    assert gains[0] < needed < gains[1]


@pytest.mark.slow
def test_a_sea_alone_leaves_nothing_to_seek() -> None:
    search, start, base = started(noisy(record(1)))
    alone = sole_disturbance(search, start, base)
    assert alone is not None
    assert list(alone.noise.spectra) == ["moment"]


def test_a_drag_in_a_sea_has_to_be_sought() -> None:
    search, start, base = started(noisy(record(3, drag=1.5)))
    assert sole_disturbance(search, start, base) is None


@pytest.mark.slow
@pytest.mark.parametrize("drag", [0.0, 1.5])
def test_in_a_sea_of_many_times_the_noise_refits_tell_whether_anything_has_to_be_sought(
    drag: float,
) -> None:
    search, start, base = started(record(3, drag=drag))
    assert error_over_noise(base, start.noise) > RESTARTS.far
    assert (sole_disturbance(search, start, base) is None) == (drag > 0.0)


def with_engine(size: float, w: float) -> casid.Record:
    """In linear waves the line of an engine [rad/s^2, rad/s] adds its own response."""
    sea = noisy(record(1))
    rate = size / w * np.sin(w * sea.Ts * np.arange(sea.N))
    roll = -size / w**2 * np.cos(w * sea.Ts * np.arange(sea.N))
    moved = {"fin": sea["fin"], "roll": sea["roll"] + roll, "rate": sea["rate"] + rate}
    return casid.Record(moved, sea.units, Ts=sea.Ts)


def test_a_line_beside_a_sea_is_sought() -> None:
    search, start, base = started(with_engine(0.04, 6.0))  # above the roll and its waves
    assert sole_disturbance(search, start, base) is None


@pytest.mark.slow
@pytest.mark.parametrize("engine", [0.0, 0.3])
def test_likelihoods_tell_a_line_from_waves_where_what_each_leaves_does_not(engine: float) -> None:
    """Most of the misfit lies in a band that counts as a few samples, of a line as of waves."""
    search, start, base = started(with_engine(engine, 1.2))
    table = search.table(start, [])
    lines = [s for s in table.peaks if s.effect.kind == "periodic_disturbance"]
    found = [replace(c, gain=0.0) for c in search.refits_of(start, lines)]
    assert found
    judged = with_lines_beside_disturbances(search, base, found, len(table.tested))
    assert (judged[0].merit > 0) == (engine > 0)


def aired(seed: int, window: float) -> tuple[Search, Weighted, Fit]:
    """A room's CO2 in ppm, whose leak wanders; a window [m^3/h] stands open for 70 minutes.

    V dC/dt = g n - (fan + leak) C, in steps of a minute that are exact for a held flow.
    """
    rng = np.random.default_rng(seed)
    N, volume, gives, leak, slow = 900, 240.0, 20_000.0, 40.0, 0.95
    people, fan = np.repeat(rng.integers(0, 12, (2, N // 30)), 30, axis=1)
    fan = 60.0 + 20.0 * fan
    wander, level, course = 0.0, 200.0, []
    for k in range(N):
        course.append(level)
        wander = slow * wander + 3.0 * np.sqrt(1 - slow**2) * rng.normal()
        flow = fan[k] + leak + wander + window * (330 <= k < 400)
        settled = gives * people[k] / flow
        level = settled + (level - settled) * np.exp(-flow / volume / 60)
    shown = np.array(course) + 6.0 * rng.normal(size=N)
    m = casid.Model("room")
    C, n = m.state("C", "ppm", start=200.0), m.input("n", "1", hold="zoh", known=True)
    q = m.input("fan", "m^3/h", hold="zoh", known=True)
    g = m.parameter("g", "L/h", start=15.0, lower=1.0)
    leaks = m.parameter("leak", "m^3/h", start=20.0, lower=0.0)
    m.balance(C, "air", inertia=m.constant("V", volume, "m^3"), terms=[g * n, -(q + leaks) * C])
    m.output("CO2", C, "ppm")
    units = {"n": "1", "fan": "m^3/s", "CO2": "1"}
    of = casid.Record({"n": people, "fan": fan / 3600, "CO2": shown / 1e6}, units, Ts=60.0)
    return started(of, m)


def test_what_is_over_again_gains_beside_a_disturbance_at_its_exact_instants() -> None:
    """Scores place it by instants 48 minutes apart: what these leave passes for a disturbance."""
    search, start, base = aired(4, window=60.0)
    bare = search.under_disturbance(base)
    rough = temporary_changes(start, search.table(start, []))[0].effect
    exact = placed_by_tangents(start, rough)
    near = 0.2 * 48 * 60.0
    assert abs(exact.constants["time"] - 330 * 60.0) < near
    assert abs(exact.constants["end"] - 400 * 60.0) < near
    assert_exact_instants_gain(bare, start, rough=rough, exact=exact)


@pytest.mark.slow
def test_a_load_that_sets_in_gains_beside_a_disturbance_at_its_exact_instant() -> None:
    """A slow force follows it, but for the moment at which it leaps; of steps 2.7 s apart, all."""
    model, of = slide().model, loaded(load=0.2 * (T >= 21.0))
    search, start, base = started(of, model)
    bare = search.under_disturbance(base)
    assert minus_log_likelihood(bare) < minus_log_likelihood(start)
    rough = offset_step(model, "force", 21.5)
    exact = placed_by_tangents(start, rough)
    assert exact.variant == pytest.approx(21.0, abs=0.3 * of.Ts)
    assert_exact_instants_gain(bare, start, rough=rough, exact=exact)
    assert sole_disturbance(search, start, base) is None


def heated(seed: int, *, late: float = 0.0, wander: float = 0.0) -> tuple[Search, Weighted, Fit]:
    """A collector [degC]: sun through clouds, and an inlet that swings slowly and comes `late` [s].

    C T' = eta G - UA (T - 20) + w (T_in - T) + d, exact for held inputs, d [W] wandering slowly.
    """
    rng = np.random.default_rng(seed)
    N, Ts, C, eta, UA, w, slow = 900, 20.0, 24e3, 3.5, 17.0, 150.0, 0.99
    t, decay = Ts * np.arange(N), np.exp(-(UA + w) * Ts / C)
    sun = np.repeat(rng.uniform(100.0, 900.0, N // 30), 30)
    inlet = 30.0 + 1.5 * np.sin(t / 1300.0)
    felt = 30.0 + 1.5 * np.sin((t - late) / 1300.0)
    T, d, course = 30.0, 0.0, []
    for k in range(N):
        course.append(T)
        d = slow * d + wander * np.sqrt(1 - slow**2) * rng.normal()
        settled = (eta * sun[k] + UA * 20.0 + w * felt[k] + d) / (UA + w)
        T = settled + (T - settled) * decay
    m = casid.Model("collector")
    x = m.state("T", "degC", start=30.0)
    G, T_in = m.input("G", "W/m^2", hold="zoh"), m.input("T_in", "degC")
    area = m.parameter("A", "m^2", start=3.0, lower=0.1)
    loss = m.parameter("UA", "W/K", start=15.0, lower=0.0)
    store = m.parameter("C", "kJ/K", start=20.0, lower=1.0)
    flow, air = m.constant("w", w, "W/K"), m.constant("T_a", 293.15, "K")
    m.balance(x, "heat", inertia=store, terms=[area * G, -loss * (x - air), flow * (T_in - x)])
    m.output("T", x, "degC")
    noise = rng.standard_normal((3, N))
    signals = {
        "G": sun + 2.0 * noise[0],
        "T_in": inlet + 273.15 + 0.03 * noise[1],
        "T": np.array(course) + 273.15 + 0.06 * noise[2],
    }
    of = casid.Record(signals, {"G": "W/m^2", "T_in": "K", "T": "K"}, Ts=Ts)
    return started(of, m)


@pytest.mark.slow
def test_an_inlet_that_comes_late_is_no_slow_disturbance() -> None:
    """d(t) = w (T_in(t - L) - T_in(t)): a slow swing of its own, and of a single number.

    To first order in L a disturbance explains it as well; refitted, L pays for itself.
    """
    search, start, base = heated(1, late=100.0)
    assert sole_disturbance(search, start, base) is None


@pytest.mark.slow
def test_a_slow_disturbance_beside_a_slow_inlet_leaves_nothing_to_seek() -> None:
    search, start, base = heated(1, wander=15.0)
    alone = sole_disturbance(search, start, base)
    assert alone is not None
    assert list(alone.noise.spectra) == ["heat"]


def circuit(bias: float, N: int = 2000) -> tuple[casid.Record, casid.Model]:
    """A coil, a capacitor with a diode across it, and a current that reads too high by `bias` [A].

    5 mH, 12 Ohm, 2 uF beside 400 Ohm. Noise of 10 mV and 0.3 mA; a quarter of a microsecond a step.
    """
    L, R, C, leak, Ts, steps = 5e-3, 12.0, 2e-6, 400.0, 2e-5, 80
    rng, h = np.random.default_rng(4), Ts / steps
    source = np.repeat(rng.integers(-3, 4, N // 50 + 1) / 2, 50)[:N]
    v, i, course = 0.0, 0.0, []
    for k in range(N):
        course.append((v, i))
        for _ in range(steps):
            i += h / L * (source[k] - R * i - v)
            v += h / C * (i - v / leak - 1e-6 * (math.exp(v / 0.12) - 1))
    shown = np.array(course).T + rng.standard_normal((2, N)) * [[0.01], [3e-4]]
    m = casid.Model("circuit")
    u = m.input("source", "V", hold="zoh", known=True)
    q, j = m.state("v", "V"), m.state("i", "A")
    at = {"C": (1.8e-6, "A s/V"), "R_p": (350.0, "Ohm"), "R": (10.0, "Ohm"), "L": (4e-3, "H")}
    p = {n: m.parameter(n, unit, start=start, lower=0.1 * start) for n, (start, unit) in at.items()}
    diode = m.constant("I_s", 1e-6, "A") * (ca.exp(q / m.constant("V_t", 0.12, "V")) - 1)
    m.balance(q, "charge", inertia=p["C"], terms=[j, -q / p["R_p"], -diode], unit="A")
    m.balance(j, "coil", inertia=p["L"], terms=[u, -p["R"] * j, -q], unit="V")
    m.output("capacitor", q, "V")
    m.output("current", j, "A")
    units = {"source": "V", "capacitor": "V", "current": "A"}
    columns = {"source": source, "capacitor": shown[0], "current": shown[1] + bias}
    return casid.Record(columns, units, Ts=Ts), m


def test_a_constant_is_a_simpler_explanation_than_a_disturbance_slower_than_the_record() -> None:
    """Which follows it, so that beside the disturbance the constant gains nothing."""
    search, start, base = started(*circuit(bias=3e-4))
    bare = search.under_disturbance(base)
    assert bare.noise.spectra
    assert sole_disturbance(search, start, base) is None


@pytest.mark.slow
def test_no_candidate_is_refitted_in_a_sea() -> None:
    said: list[str] = []
    found = casid.diagnose(hull(), noisy(record(2)), advise=False, progress=said.append)
    assert (found.verdict, found.causes) == ("adequate", ())
    assert said
    assert not [line for line in said if line.startswith("refit")]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
def test_a_step_gains_most_of_what_the_refit_of_an_effect_gains_beside_a_sea(seed: int) -> None:
    """At the model without a drag the tangent of one, in a sea that makes it curved, is no more.

    What gains less than a share of what pays for an effect in its first step is not followed. Both
    likelihoods are maxima over the sea's spectrum, of which each is found to half a unit.
    """
    search, start, base = started(record(seed, drag=1.5))
    bare = search.under_disturbance(base)
    at = replace(bare, fit=bare.unbiased or bare.fit)
    drag = quadratic_damping(start.model, "moment")
    plain = extended_columns(replace(at.fit, criterion=unwhitened(at)), [drag])
    gain = max(gains_under_disturbance(at, plain, [0], known={}, passing=1.0))
    model, _ = drag.extended(start.model)
    beside = search.weighing.with_disturbances()
    fit = fit_model(model, search.weighing.experiments, FitSettings(starts=1))
    refitted = minus_log_likelihood(bare) - minus_log_likelihood(beside.weigh(model, fit, rounds=1))
    assert refitted > 10.0
    assert DISTURBED.followed * refitted < gain < refitted + 1.0


def test_an_effect_pays_by_its_parameters_and_for_the_choice_among_many() -> None:
    """Chen and Chen, Biometrika 95 (2008) 759-771, with gamma = 1: k log n + 2 log(tested)."""
    assert price_of(2, 1000, 50) == pytest.approx(2 * np.log(1000) + 2 * np.log(50))
    assert price_of(1, 1000, 0) == pytest.approx(np.log(1000))


def test_a_sea_is_found_next_to_the_truth_where_a_far_residual_shows_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Fitted without a disturbance the model may err so that forces look white."""
    search, _, base = started(record(1))
    asked: list[bool] = []

    def hidden_at_first(noise: NoiseModel, *args: Any, **kwargs: Any) -> NoiseModel:
        asked.append(True)
        if len(asked) == 1:
            return noise
        return with_disturbance_spectra(noise, *args, **kwargs)

    monkeypatch.setattr(prewhitening, "with_disturbance_spectra", hidden_at_first)
    beside = search.weighing.with_disturbances()
    assert list(beside.weigh(base.criterion.model, base, rounds=1).noise.spectra) == ["moment"]


def craft(gust: float, N: int = 1200) -> tuple[casid.Record, casid.Model]:
    """A multirotor that holds its height while `gust` [N] pushes it from 20 to 30 s; 20 Hz.

    1.5 kg, a thrust of 30 N at full throttle, a drag of 0.6 N s/m, a height with 8 cm of noise.
    """
    rng, Ts, g = np.random.default_rng(2), 0.05, 9.81
    ref = np.repeat(rng.uniform(2.0, 12.0, N // 60), 60)
    z, w, total = ref[0], 0.0, 0.0
    rows = []
    for k in range(N):
        error = ref[k] - z
        total += Ts * 0.1 * error
        throttle = float(np.clip(0.49 + 0.1 * error + total - 0.1 * w, 0.05, 1.0))
        push = gust if 20.0 <= k * Ts < 30.0 else 0.0
        rows.append((throttle, z + 0.08 * rng.normal()))
        for _ in range(4):
            middle = w + Ts / 8 * ((30.0 * throttle + push - 0.6 * w) / 1.5 - g)
            z += Ts / 4 * middle
            w += Ts / 4 * ((30.0 * throttle + push - 0.6 * middle) / 1.5 - g)
    m = casid.Model("height of a multirotor")
    h, v = m.state("h", "m"), m.state("v", "m/s")
    u = m.input("throttle", "1", hold="zoh", known=True)
    k_T = m.parameter("k_T", "N", start=25.0, lower=1.0)
    d = m.parameter("d", "N s/m", start=0.3, lower=0.0)
    m.derivative(h, v)
    m.balance(v, "lift", inertia=1.5, terms=[k_T * u, -1.5 * g, -d * v], unit="N")
    m.output("height", h, "m")
    units = {"throttle": "1", "height": "m"}
    columns = dict(zip(units, np.array(rows).T, strict=True))
    return casid.Record(columns, units, Ts=Ts), m


@pytest.mark.slow
def test_a_push_that_the_parameters_followed_has_to_be_sought() -> None:
    """Tangents at a fit far from the record misplace it, and what is left is a slow disturbance."""
    search, start, base = started(*craft(gust=3.0))
    assert error_over_noise(base, start.noise) > RESTARTS.far
    assert sole_disturbance(search, start, base) is None


def test_a_change_is_sought_though_a_bias_of_the_sensor_scores_higher() -> None:
    search, start, base = started(changed_vessel(3, share=0.4, flow=6.0), vessel().model)
    best = max(search.table(start, []).tested, key=lambda s: s.unrobust * s.effect.sets_in)
    assert best.effect.kind == "sensor_bias"
    assert sole_disturbance(search, start, base) is None


@pytest.mark.parametrize("seed", [1, 2])
def test_a_slow_flow_of_heat_alone_leaves_nothing_to_seek(seed: int) -> None:
    search, start, base = started(changed_vessel(seed, share=0.0, flow=6.0), vessel().model)
    assert sole_disturbance(search, start, base) is not None
