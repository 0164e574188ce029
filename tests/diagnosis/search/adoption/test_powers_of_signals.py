"""The power of a signal by which a parameter changes is that which all causes together show."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.diagnosis.evidence.records.signal_sizes import sizes_of
from casid.diagnosis.evidence.whitening.fit_points import moved
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.robust_errors import std_error
from casid.diagnosis.search.adoption.powers_of_signals import with_better_powers
from casid.diagnosis.search.adoption.refinement import Adoption, Refinement, whole_fit
from casid.diagnosis.search.candidates import Adopted
from casid.diagnosis.search.rounds import Search
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import fit_model
from casid.model.effects.effect import Effect, Spread
from casid.model.effects.parameter_effects import (
    has_powers,
    power_scheduled_parameter,
    scheduled_parameter,
)
from casid.model.effects.state_schedules import (
    inhibited_parameter,
    is_inhibited,
    state_scheduled_parameter,
)

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


def record(law: str, samples: int = 800) -> casid.Record:
    """Samples of 1 s from a full cell whose resistance falls with the charge z."""
    rng = np.random.default_rng(3)
    current = np.repeat(rng.choice([-1.0, 0.0, 2.0, 5.0], samples // 10), 10)
    z, v, voltage = 0.9, 0.0, np.empty(current.size)
    decay = np.exp(-1.0 / 20.0)
    for k, i in enumerate(current.tolist()):
        R_0 = {
            "line": 0.03 - 0.02 * z,
            "parabola": 0.03 - 0.02 * z**2,
            "fall": 0.03 / (1 + z**2),
            "vertex": 0.02 + 0.04 * (1 - z) ** 2,
        }
        voltage[k] = 3.5 + 0.5 * z - R_0[law] * i - v
        v = decay * v + (1 - decay) * 0.015 * i
        z -= i / 2000.0
    voltage += NOISE * rng.standard_normal(current.size)
    return casid.Record({"I": current, "V": voltage}, {"I": "A", "V": "V"}, 1.0)


LAWS = {"line": (1, True), "parabola": (2, True), "fall": (2, False)}  # power, is straight


def refinement(model: casid.Model, data: casid.Record, recorded: dict[str, str]) -> Refinement:
    """The steps from what is adopted, of a model that is fitted as it is."""
    split = split_records([casid.Experiment(data)], 0.3)
    weighing = Weighing(split.fitted)
    base = fit_model(model, split.fitted, ONCE)
    at, units = weighing.weigh(model, base), base.criterion.weights
    return Refinement(Search(weighing, recorded), split, ONCE, units, at, base)


def adopted(of: Refinement, effect: Effect, step: float) -> Adoption:
    """One effect as it is adopted, from a step of its size."""
    cause = of.search.refitting.refit(of.start, effect, step)
    assert cause is not None
    fit = whole_fit(cause.model, of.split, ONCE, of.units, cause.fit.values)
    extended = of.search.weighing.weigh(cause.model, fit, rounds=1)
    return Adoption((Adopted(cause, 1e-9, (), of.start),), extended, fit)


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
    of = refinement(model, record(true), {})
    power, is_straight = LAWS[named]
    size = sizes_of(of.start, {}).motion_of(model.symbol("z") ** power)
    effect = state_scheduled_parameter(model, "R_0", "z", size, power, is_straight=is_straight)
    before = adopted(of, effect, -0.01)
    found = with_better_powers(of, before)
    (kept,) = found.adopted
    constants = kept.candidate.effect.constants
    assert (constants["power"], bool(constants["straight"])) == LAWS[true]
    assert (found is before) is (true == named)
    assert found.fit is not None
    assert before.fit is not None
    assert kept.candidate.names[0] in found.fit.values
    assert found.fit.solution.value <= before.fit.solution.value
    if true == "line":
        error = abs(found.fit.values["slope_R_0_z"] + 0.02)
        # Of N = 560 samples with a current of 2.7 A RMS, whose z spreads by 0.08 about its mean.
        assert error < 4 * NOISE / (560**0.5 * 2.7 * 0.08)


def pulled(law: str) -> casid.Record:
    """Samples of 0.02 s of 0.5 kg on a spring that a magnet pulls, whose force is C(i) i^2."""
    rng = np.random.default_rng(5)
    current = np.repeat(rng.uniform(0.0, 4.0, 60), 20)
    C = {"line": 1.6 - 0.25 * current, "levels off": 2.0 / (1 + current / 3.0)}[law]
    A = np.array([[0.0, 1.0], [-80.0, -2.0]])  # k/m, d/m
    held = expm(np.block([[A, np.array([[0.0], [2.0]])], [np.zeros((1, 3))]]) * 0.02)
    x, path = np.zeros(2), np.empty(current.size)
    for k, force in enumerate(C * current**2):
        path[k] = x[0]
        x = held[:2, :2] @ x + held[:2, 2] * force
    y = path + NOISE * rng.standard_normal(current.size)
    return casid.Record({"i": current, "y": y}, {"i": "A", "y": "m"}, 0.02)


def magnet() -> casid.Model:
    """The same with one C."""
    m = casid.Model("magnet")
    i = m.input("i", "A", hold="zoh", known=True)
    x, v = m.state("x", "m"), m.state("v", "m/s")
    C = m.parameter("C", "N/A^2", start=1.0, lower=0.01)
    k, d = m.parameter("k", "N/m", start=35.0), m.parameter("d", "N s/m", start=0.8)
    m.derivative(x, v)
    m.balance(v, "force", inertia=m.constant("m", 0.5, "kg"), terms=[C * i**2, -k * x, -d * v])
    m.output("y", x, "m")
    return m


@pytest.mark.parametrize("true", ["line", "levels off"])
@pytest.mark.parametrize("named", ["line", "levels off"])
def test_a_gain_falls_with_its_input_in_proportion_or_levels_off(true: str, named: str) -> None:
    model = magnet()
    of = refinement(model, pulled(true), {})
    size = sizes_of(of.start, {}).motion_of(model.symbol("i"))
    if named == "line":
        before = adopted(of, state_scheduled_parameter(model, "C", "i", size), -0.1)
    else:
        before = adopted(of, inhibited_parameter(model, "C", "i", size), 0.1)
    found = with_better_powers(of, before)
    kept = found.adopted[0].candidate
    assert is_inhibited(kept.effect) is (true == "levels off")
    assert found.fit is not None
    value = {"line": -0.25, "levels off": 1 / 3}[true]
    assert abs(found.fit.values[kept.names[0]] - value) < 4 * std_error(found.fit, kept.names[0])


@pytest.mark.slow
def test_a_magnet_whose_iron_saturates_is_named_by_its_gain() -> None:
    found = casid.diagnose(casid.Problem("magnet", magnet()), pulled("line"), starts=1)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("scheduled_parameter", "C~i")
    (slope,) = cause.parameters
    assert abs(slope.value + 0.25) < 4 * slope.std_error


@pytest.mark.parametrize("named", ["line", "fall"])
def test_slope_and_curvature_that_are_missing_together_are_one_parabola(named: str) -> None:
    """R_0 = 0.02 ohm + 0.04 ohm (1 - z)^2: no law of z that has its vertex at 0 leaves noise."""
    model = cell()
    of = refinement(model, record("vertex", 1500), {})
    power, is_straight = LAWS[named]
    size = sizes_of(of.start, {}).motion_of(model.symbol("z") ** power)
    effect = state_scheduled_parameter(model, "R_0", "z", size, power, is_straight=is_straight)
    found = with_better_powers(of, adopted(of, effect, -0.01))
    (kept,) = found.adopted
    assert kept.candidate.names == ("curvature_R_0_z", "vertex_R_0_z")
    assert found.fit is not None
    for name, true in zip(kept.candidate.names, (0.04, 1.0), strict=True):
        error = std_error(found.fit, name)
        assert abs(found.fit.values[name] - true) < 4 * error < 0.2


def heater() -> casid.Model:
    """A heater that loses heat to the air around it, of 0 degC."""
    m = casid.Model("heater")
    T, power = m.state("T", "degC", start=30.0), m.input("P", "W", hold="zoh", known=True)
    UA = m.parameter("UA", "W/K", start=5.0, lower=0.1)
    zero = m.constant("T_0", 273.15, "K")
    m.balance(T, "heat", inertia=m.constant("C", 900.0, "J/K"), terms=[power, -UA * (T - zero)])
    m.output("T_h", T, "degC")
    return m


def in_wind(law: str) -> casid.Record:
    """500 samples of 20 s; the loss goes with the wind to the power 0.8, or along a line."""
    rng, h = np.random.default_rng(5), 20.0
    wind, power = (np.repeat(rng.uniform(*ends, 25), 20) for ends in ((0.5, 8.0), (0.0, 400.0)))
    loss = 6.0 * (wind / 4) ** 0.8 if law == "power" else 2.0 + wind
    T, decay = np.empty(500), np.exp(-loss * h / 900.0)
    T[0] = 40.0
    for k in range(499):
        T[k + 1] = power[k] / loss[k] + (T[k] - power[k] / loss[k]) * decay[k]
    T += 273.15 + 0.05 * rng.standard_normal(500)
    channels = {"P": power, "wind": wind, "T_h": T}
    return casid.Record(channels, {"P": "W", "wind": "m/s", "T_h": "K"}, h)


@pytest.mark.parametrize(
    ("true", "named"),
    [
        ("power", "line"),
        ("line", "power"),
        pytest.param("power", "power", marks=pytest.mark.slow),
        pytest.param("line", "line", marks=pytest.mark.slow),
    ],
)
def test_a_parameter_goes_with_a_power_of_a_channel_where_the_record_says_so(
    true: str, named: str
) -> None:
    model = heater()
    of = refinement(model, in_wind(true), {"wind": "m/s"})
    spread = sizes_of(of.start, {"wind"}).channels["wind"]
    laws = {"line": scheduled_parameter, "power": power_scheduled_parameter}
    effect = laws[named](model, "UA", "wind", "m/s", spread)
    before = adopted(of, effect, {"line": 1.0, "power": 0.5}[named])
    found = with_better_powers(of, before)
    (kept,) = found.adopted
    assert found.fit is not None
    size, error = (
        found.fit.values[kept.candidate.names[0]],
        std_error(found.fit, kept.candidate.names[0]),
    )
    label, value = {"line": ("slope", 1.0), "power": ("exponent", 0.8)}[true]
    assert kept.candidate.names == (f"{label}_UA_wind",)
    assert (found is before) is (true == named)
    assert abs(size - value) < 4 * error < 0.02


def test_a_power_is_sought_within_its_bounds_whatever_the_slope_promises() -> None:
    """Beside a loss that was fitted near 0 the slope is that of a power of 60."""
    model = heater()
    of = refinement(model, in_wind("power"), {"wind": "m/s"})
    spread = sizes_of(of.start, {"wind"}).channels["wind"]
    before = adopted(of, scheduled_parameter(model, "UA", "wind", "m/s", spread), 1.0)
    assert before.fit is not None
    x = before.fit.x.copy()
    x[before.fit.criterion.names.index("UA")] = 0.1
    small = moved(before.fit, before.fit.criterion, x)
    found = with_better_powers(of, replace(before, fit=small))
    (kept,) = found.adopted
    assert kept.candidate.names == ("exponent_UA_wind",)
    assert not of.search.attempts.failed


def test_no_power_of_a_signal_that_changes_its_sign_or_of_a_temperature() -> None:
    assert has_powers(Spread(1.0, 0.0, 2.0), "m/s")
    assert has_powers(Spread(-1.0, -2.0, 0.0), "m/s")
    assert not has_powers(Spread(0.5, -1.0, 2.0), "m/s")
    assert not has_powers(Spread(290.0, 280.0, 300.0), "K")
