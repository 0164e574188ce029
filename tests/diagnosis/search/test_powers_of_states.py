"""The power of a state by which a parameter changes is that which all causes together show."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.prewhitening import Weighing
from casid.diagnosis.evidence.signal_sizes import sizes_of
from casid.diagnosis.search.candidates import Adopted
from casid.diagnosis.search.powers_of_states import with_better_powers
from casid.diagnosis.search.refinement import Adoption, Refinement, whole_fit
from casid.diagnosis.search.rounds import Search
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import fit_model
from casid.model.effects.parameter_effects import state_scheduled_parameter

ONCE = casid.FitSettings(starts=1)
NOISE = 1e-3  # V


def cell() -> casid.Model:
    """A cell with an open-circuit voltage of 3.5 V + 0.5 V of charge, one pair and a resistance."""
    m = casid.Model("cell")
    current = m.input("I", "A", hold="zoh")
    charge, v = m.state("z", "1"), m.state("v", "V")
    R_0 = m.parameter("R_0", "ohm", start=0.02, lower=0.001)
    R_1 = m.parameter("R_1", "ohm", start=0.02, lower=0.001)
    capacity = m.parameter("C", "A s/V", start=1500.0, lower=10.0)
    m.derivative(charge, -current / m.constant("Q", 2000.0, "A s"))
    m.balance(v, "pair", inertia=capacity, terms=[current, -v / R_1])
    E, slope = m.constant("E", 3.5, "V"), m.constant("slope", 0.5, "V")
    m.output("V", E + slope * charge - R_0 * current - v, "V")
    return m


def record(law: str) -> casid.Record:
    """800 samples of 1 s from a full cell whose resistance falls with the charge z."""
    rng = np.random.default_rng(3)
    current = np.repeat(rng.choice([-1.0, 0.0, 2.0, 5.0], 80), 10)
    z, v, voltage = 0.9, 0.0, np.empty(current.size)
    decay = np.exp(-1.0 / 20.0)
    for k, i in enumerate(current.tolist()):
        R_0 = {"line": 0.03 - 0.02 * z, "parabola": 0.03 - 0.02 * z**2, "fall": 0.03 / (1 + z**2)}
        voltage[k] = 3.5 + 0.5 * z - R_0[law] * i - v
        v = decay * v + (1 - decay) * 0.015 * i
        z -= i / 2000.0
    voltage += NOISE * rng.standard_normal(current.size)
    return casid.Record({"I": current, "V": voltage}, {"I": "A", "V": "V"}, 1.0)


LAWS = {"line": (1, True), "parabola": (2, True), "fall": (2, False)}  # power, is straight


SUCCESSIVE = [("line", "parabola"), ("parabola", "fall"), ("fall", "line")]


@pytest.mark.parametrize(
    ("true", "named"),
    [
        pair if pair in SUCCESSIVE else pytest.param(*pair, marks=pytest.mark.slow)
        for pair in itertools.product(LAWS, LAWS)
    ],
)
def test_the_law_is_that_of_the_record_whichever_was_named(true: str, named: str) -> None:
    model = cell()
    split = split_records([casid.Experiment(record(true))], 0.3)
    weighing = Weighing(split.fitted)
    base = fit_model(model, split.fitted, ONCE)
    at, units = weighing.weigh(model, base), base.criterion.weights
    of = Refinement(Search(weighing, {}), split, ONCE, units, at, base)
    power, is_straight = LAWS[named]
    size = sizes_of(at, {}).motion_of(model.symbol("z") ** power)
    effect = state_scheduled_parameter(model, "R_0", "z", size, power, is_straight=is_straight)
    cause = of.search.refitting.refit(at, effect, -0.01)
    assert cause is not None
    fit = whole_fit(cause.model, split, ONCE, units, cause.fit.values)
    extended = weighing.weigh(cause.model, fit, rounds=1)
    before = Adoption((Adopted(cause, 1e-9, (), at),), extended, fit)
    found = with_better_powers(of, before)
    (kept,) = found.adopted
    constants = kept.candidate.effect.constants
    assert (constants["power"], bool(constants["straight"])) == LAWS[true]
    assert (found is before) is (true == named)
    assert found.fit is not None
    assert kept.candidate.names[0] in found.fit.values
    assert found.fit.solution.value <= fit.solution.value
    if true == "line":
        error = abs(found.fit.values["slope_R_0_z"] + 0.02)
        # Of N = 560 samples with a current of 2.7 A RMS, whose z spreads by 0.08 about its mean.
        assert error < 4 * NOISE / (560**0.5 * 2.7 * 0.08)
