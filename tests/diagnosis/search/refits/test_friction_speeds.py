"""Dry friction reverses as sharply as the record shows, so that its size is not biased."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.adoption.friction_sharpness import with_sharp_friction_beside
from casid.diagnosis.search.adoption.refinement import Adoption, Refinement
from casid.diagnosis.search.candidates import Adopted, Candidate
from casid.diagnosis.search.rounds import Search
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.effects.balances.balance_effects import coulomb_friction

TS, FRICTION, SHARP = 0.005, 0.8, 0.015  # s, N, m/s


def slider() -> casid.Problem:
    m = casid.Model("slider")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold="zoh", known=True)
    mass = m.parameter("m", "kg", start=1.5, lower=0.1)
    d = m.parameter("d", "N s/m", start=1.0, lower=0.0)
    k = m.parameter("k", "N/m", start=15.0, lower=0.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[F, -d * v, -k * x])
    m.output("position", x, "m")
    return casid.Problem("slider", m, noise={"position": 2e-4})


def record(
    lag: float = 0.0,
    sharp: float = SHARP,
    TS: float = TS,
    duration: float = 8.0,
    falling: float = 0.0,
) -> casid.Record:
    """By SciPy: slow and fast motion, friction that reverses within 15 mm/s, a drive with a lag.

    The friction is larger by `falling` (N) as the motion begins, up to some 0.1 m/s.
    """
    rng = np.random.default_rng(1)
    t = TS * np.arange(round(duration / TS))
    F = 4.0 * np.sin(2 * np.pi * 0.41 * t) + 3.0 * np.sin(2 * np.pi * 0.13 * t)

    def slope(_: float, s: np.ndarray, force: float) -> list[float]:
        size = FRICTION + falling * np.exp(-((s[1] / 0.1) ** 2))
        return [s[1], force - 0.6 * s[1] - 12.0 * s[0] - size * np.tanh(s[1] / sharp)]

    def lagging(t: float, s: np.ndarray, force: float) -> list[float]:
        behind = s[2] * np.exp(-t / lag) if lag else 0.0
        return [*slope(t, s, force - behind), 0.0]

    state, x = np.zeros(3), np.empty(t.size)
    for i, force in enumerate(F):
        x[i] = state[0]
        found = solve_ivp(lagging, (0.0, TS), state, "LSODA", args=(force,), rtol=1e-7, atol=1e-9)
        following = F[min(i + 1, t.size - 1)]
        behind = state[2] * np.exp(-TS / lag) + following - force if lag else 0.0
        state = np.array([*found.y[:2, -1], behind])
    x += 2e-4 * rng.standard_normal(t.size)
    return casid.Record({"position": x, "F": F}, {"position": "m", "F": "N"}, TS)


@pytest.mark.slow
def test_the_size_of_dry_friction_is_within_its_error_and_nothing_is_invented():
    lines: list[str] = []
    found = casid.diagnose(slider(), record(), advise=False, progress=lines.append)
    assert [c.kind for c in found.causes] == ["coulomb_friction"]
    size = found.causes[0].parameters[0]
    assert size.std_error is not None
    assert size.value == pytest.approx(FRICTION, abs=4 * size.std_error)
    assert size.std_error < 0.02 * FRICTION
    assert any("choose how sharply" in line for line in lines)
    assert found.model is not None
    assert found.model.causes[0].constants["speed"] == pytest.approx(SHARP, rel=0.1)


@pytest.mark.slow
def test_a_short_record_is_simulated_in_finer_steps_for_a_sharper_reversal():
    """0.8 m/s^2 over 5 mm/s is 6 times a step of 40 ms: one that coarse could not follow it."""
    found = casid.diagnose(slider(), record(sharp=0.005, TS=0.04), advise=False)
    assert [c.kind for c in found.causes] == ["coulomb_friction"]
    assert found.model is not None
    assert found.model.causes[0].constants["speed"] < 0.016


@pytest.mark.slow
@pytest.mark.parametrize("lag", [0.06, 0.2])
def test_friction_beside_a_lag_is_as_sharp_as_alone(lag: float):
    """Whichever of the two is found first.

    About its largest value the gain, twice a log-likelihood ratio, falls by 1.5 where the speed is
    a quarter larger: a standard error of a fifth.
    """
    found = casid.diagnose(slider(), record(lag, duration=12.0), advise=False)
    assert {c.kind for c in found.causes} == {"actuator_lag", "coulomb_friction"}
    assert found.model is not None
    (friction,) = (c for c in found.model.causes if c.kind == "coulomb_friction")
    assert friction.constants["speed"] == pytest.approx(SHARP, rel=0.2)


@pytest.mark.slow
def test_friction_that_falls_as_the_motion_begins_is_no_matter_of_sharpness():
    found = casid.diagnose(slider(), record(falling=0.4), advise=False)
    assert {c.kind for c in found.causes} == {"coulomb_friction", "stribeck_friction"}


def sticking(friction: float = 1.2, Ts: float = 0.02) -> casid.Record:
    """Mass, spring and friction that holds at rest: Moreau's time stepping, 200 steps a sample."""
    rng = np.random.default_rng(0)
    t = Ts * np.arange(1500)
    tones = zip(rng.uniform(0.1, 1.2, 6), rng.uniform(0, 2 * np.pi, 6), strict=True)
    F = 2.6 * sum(np.sin(2 * np.pi * f * t + phase) for f, phase in tones)
    q, v, step, position = 0.0, 0.0, Ts / 200, np.empty(t.size)
    for i, force in enumerate(F):
        position[i] = q
        for _ in range(200):
            free = v + step * (force - 8.0 * q - 1.5 * v) / 2.0
            v = np.sign(free) * max(abs(free) - step * friction / 2.0, 0.0)
            q += step * v
    noisy = position + 2e-3 * rng.standard_normal(t.size)
    return casid.Record({"position": noisy, "F": F}, {"position": "m", "F": "N"}, Ts)


@pytest.mark.slow
def test_friction_that_sticks_is_sized_within_its_error_and_nothing_makes_up_for_it():
    """No smoothing is sharp enough: what the last halving moves counts in the error.

    Without it the size was three to seven standard errors too large.
    """
    found = casid.diagnose(replace(slider(), noise={}), sticking(), advise=False)
    assert [c.kind for c in found.causes] == ["coulomb_friction"]
    size = found.causes[0].parameters[0]
    assert size.std_error is not None
    assert size.value == pytest.approx(1.2, abs=3 * size.std_error)
    assert size.std_error < 0.003 * 1.2
    assert found.extended is not None
    assert "dry friction" in found.extended.uncertainty.assumes


def cart() -> casid.Model:
    m = casid.Model("cart")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold="zoh", known=True)
    d = m.parameter("d", "N s/m", start=1.0, lower=0.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=m.constant("m", 1.0, "kg"), terms=[F, -d * v])
    m.output("position", x, "m")
    return m


def driven_cart(friction: float, sharp: float, Ts: float = 0.1) -> casid.Record:
    """By SciPy: no spring takes the position back, so that every reversal leaves a step of it."""
    rng = np.random.default_rng(2)
    F, x, state = np.repeat(rng.uniform(-3, 3, 20), 8), np.empty(160), np.zeros(2)

    def slope(_: float, s: np.ndarray, force: float) -> list[float]:
        return [s[1], force - 0.5 * s[1] - friction * np.tanh(s[1] / sharp)]

    for i, force in enumerate(F):
        x[i] = state[0]
        state = solve_ivp(slope, (0.0, Ts), state, "LSODA", args=(force,), rtol=1e-7).y[:, -1]
    x += 1e-3 * rng.standard_normal(x.size)
    return casid.Record({"position": x, "F": F}, {"position": "m", "F": "N"}, Ts)


def test_a_disturbance_keeps_no_reversal_blunt():
    """Ten times too blunt, friction seems to leave a disturbance; as sharp as it is, none."""
    model, once = cart(), FitSettings(starts=1)
    split = split_records([casid.Experiment(driven_cart(0.5, 0.01))], 0.0)
    base = fit_model(model, split.fitted, once)
    weighing = Weighing(split.fitted).with_disturbances()
    at, units = weighing.weigh(model, base), base.criterion.weights
    refine = Refinement(Search(weighing, {}), split, once, units, at, base)
    effect = coulomb_friction(model, "force", 0.1)
    extended, names = effect.extended(model, starts={"F_c": 0.5})
    beside = weighing.weigh(extended, fit_model(extended, split.fitted, once, weights=units))
    blunt = Candidate(effect, names, extended, beside.fit, 0.0, 0.0, 9.0)
    assert beside.noise.source_sd["force"] > 0.01  # N
    found = Adoption((Adopted(blunt, 0.0, ()),), beside, beside.fit)
    sharp = with_sharp_friction_beside(refine, found)
    assert sharp.at.noise.source_sd["force"] == pytest.approx(0.0, abs=2e-3)
    assert sharp.adopted[0].candidate.effect.constants["speed"] == pytest.approx(0.01, rel=0.3)
    assert sharp.at.fit.values["F_c"] == pytest.approx(0.5, abs=0.005)
