"""One event is named once, by the effect that explains it best at its instant."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid
from casid.diagnosis.evidence.scores.score_tests import score_test
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.adoption.event_renaming import with_last_event_renamed
from casid.diagnosis.search.adoption.refinement import Adoption, Refinement
from casid.diagnosis.search.candidates import Adopted, Candidate
from casid.diagnosis.search.rounds import Search
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.effects.clock_effects import offset_step
from casid.model.effects.parameter_effects import parameter_jump

TS, N, NOISE, WHEN = 0.1, 160, 1e-3, 6.0  # s, m, s
MASS, LOAD, STIFFNESS, DAMPING = 5.0, 1.5, 60.0, 4.0  # kg, kg, N/m, N s/m
ONCE = FitSettings(starts=1)


def scales() -> casid.Model:
    """What hangs from a spring, and is pushed: its mass weighs, and is inert."""
    m = casid.Model("scales")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold="zoh", known=True)
    mass = m.parameter("m", "kg", start=4.0, lower=0.5)
    d = m.parameter("d", "N s/m", start=3.0, lower=0.0)
    k = m.constant("k", STIFFNESS, "N/m")
    g = m.constant("g", 9.81, "m/s^2")
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[F, mass * g, -k * x, -d * v])
    m.output("position", x, "m")
    return m


def record(lost: float, pushed: float) -> casid.Record:
    """By SciPy: from an instant on a load is `lost` (kg), or the scales are `pushed` by a force."""
    rng = np.random.default_rng(5)
    F, x, state = np.repeat(rng.uniform(-20, 20, N // 5), 5), np.empty(N), np.zeros(2)

    def slope(_: float, s: np.ndarray, mass: float, force: float) -> list[float]:
        return [s[1], (force + mass * 9.81 - STIFFNESS * s[0] - DAMPING * s[1]) / mass]

    for i in range(N):
        x[i] = state[0]
        after = TS * i > WHEN - TS / 2
        now = (MASS - lost * after, F[i] + pushed * after)
        state = solve_ivp(slope, (0.0, TS), state, "LSODA", args=now, rtol=1e-7).y[:, -1]
    x += NOISE * rng.standard_normal(N)
    return casid.Record({"position": x, "F": F}, {"position": "m", "F": "N"}, TS)


def renamed(of: casid.Record, force: float) -> Adoption:
    """After a force that sets in at that instant was adopted."""
    model, split = scales(), split_records([casid.Experiment(of)], 0.3)
    base = fit_model(model, split.fitted, ONCE)
    weighing, units = Weighing(split.fitted), base.criterion.weights
    at = weighing.weigh(model, base)
    search = Search(weighing, {})
    effect = offset_step(model, "force", WHEN - TS / 2)
    jumps = [parameter_jump(model, name, WHEN - 1.0) for name in ("m", "d")]
    search.first_table = score_test(at.fit, [effect, *jumps], input_sd=at.input_sd)
    refine = Refinement(search, split, ONCE, units, at, base)
    extended, names = effect.extended(model, starts={"F_0": force})
    fit = fit_model(extended, split.fitted, ONCE, weights=units)
    cause = Adopted(Candidate(effect, names, extended, fit, 0.0, 0.0, 9.0), 0.0, ())
    return with_last_event_renamed(refine, Adoption((cause,), weighing.weigh(extended, fit), fit))


def test_a_load_that_is_taken_off_is_no_force():
    found = renamed(record(lost=LOAD, pushed=0.0), -9.81 * LOAD)
    (cause,) = found.adopted
    assert cause.candidate.effect.key == ("parameter_jump", "m")
    assert found.fit is not None
    assert found.fit.values["jump_m"] == pytest.approx(-LOAD, rel=0.03)
    assert not cause.rivals
    assert cause.candidate.score is not None
    assert cause.candidate.gain > 10 * cause.candidate.cost  # its own, not that of the force


def test_a_force_that_sets_in_stays_one():
    (cause,) = renamed(record(lost=0.0, pushed=15.0), 15.0).adopted
    assert cause.candidate.effect.kind == "offset"
