"""The next experiment is predicted from what acted in the last, and judged by signatures."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import casid
from casid.diagnosis.advice.fitted_motion import FittedMotion
from casid.diagnosis.advice.next_experiment import (
    Proposal,
    Suspect,
    advice_sentence,
    next_experiment,
    predicted_table,
    record_length_text,
)
from casid.diagnosis.advice.planned_records import Planner
from casid.diagnosis.evidence.scores.score_tests import score_test
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.errors import DataError
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.effects.balances.balance_effects import (
    coulomb_friction,
    cubic_stiffness,
    quadratic_damping,
)
from casid.model.effects.channels.delays import time_delay
from casid.model.effects.effect import Spread
from casid.model.effects.names import place_words
from casid.model.effects.parameter_effects import parameter_jump, scheduled_parameter
from problems import pendulum, roll_decay
from tests.support import truth

NOISE = 0.01


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (37.4, "37 s"),
        (108.0, "110 s"),
        (3.0e4, "8.3 h"),
        (5.53e7, "640 days"),
        (2e8, "6.3 years"),
    ],
)
def test_the_length_of_a_record_has_two_digits_and_no_exponent(seconds: float, text: str) -> None:
    assert record_length_text(seconds) == text


def weighed(problem: casid.Problem, hidden: truth.TruthRecord, known: dict) -> Weighted:
    columns = {n: np.asarray(c) for n, c in hidden.columns.items() if n != "t"}
    record = casid.Record(
        columns, {n: hidden.units[n] for n in columns}, Ts=hidden.Ts, name="record"
    )
    experiments = [casid.Experiment(record, known)]
    fit = fit_model(problem.model, experiments, FitSettings(starts=1))
    return Weighing(experiments).weigh(problem.model, fit)


@pytest.fixture(scope="module")
def hidden() -> truth.TruthRecord:
    return truth.cart_pendulum(seed=3, duration=30, Ts=0.02, noise=NOISE)


@pytest.fixture(scope="module")
def at(hidden) -> Weighted:
    return weighed(pendulum.problem, hidden, {"m": 0.0})


@pytest.fixture(scope="module")
def planner(at) -> Planner:
    return Planner(FittedMotion(pendulum.problem, at))


def stiffness_and_inertia(at: Weighted) -> list[Suspect]:
    """Both moved by the yaw rate: at the resonance, one is the other with the sign turned."""
    c = at.criterion.experiments[0].record["yaw_rate"]
    spread = Spread(float(c.mean()), float(c.min()), float(c.max()))
    made = [
        scheduled_parameter(at.model, name, "yaw_rate", "rad/s", spread) for name in ("k", "I_x")
    ]
    return [Suspect(e, size) for e, size in zip(made, (0.1, 0.001), strict=True)]


def test_what_acted_is_the_cart_s_acceleration_and_gives_the_record_back(planner, hidden):
    """The unknown input follows from the accelerometer; the direct model then has both sensors."""
    acting = planner.motion.acting(0)
    assert list(acting) == ["a_y"]
    # a_y = z_s phi'' + g phi - a_s: the accelerometer's noise, once itself, by half through phi''
    # and about once through phi, whose resonance gathers it; and the parameters' small errors.
    error = acting["a_y"] - hidden.clean["a_y"]
    assert np.std(error) < 4 * NOISE
    assert np.std(error) < 0.05 * np.std(hidden.clean["a_y"])
    start = planner.motion.initial(0)
    record = planner.motion.simulated(0, acting, np.array(list(start.values())))
    # Straight lines between samples of a_y are not those between samples of a_s: 2 % at most.
    for channel in ("gyro", "accel"):
        left = record[channel] - hidden.columns[channel]
        assert np.std(left) < 0.02 * np.std(hidden.columns[channel]) + NOISE


def test_the_same_again_has_the_signatures_of_the_record_at_hand(planner, at):
    effects = [
        quadratic_damping(at.model, "torque"),
        cubic_stiffness(at.model, "torque"),
        time_delay(at.model, "gyro", 0.2),
    ]
    here = score_test(at.fit, effects, input_sd={}, draws=50)
    there = predicted_table(planner.again(), at, effects)
    np.testing.assert_allclose(there.cosines, here.cosines, atol=1e-3)
    ratio = [a.energy / b.energy for a, b in zip(there.scores, here.scores, strict=True)]
    # The noise is linearised about the same point: what differs is rounding in the fit's start.
    np.testing.assert_allclose(ratio, 1.0, rtol=1e-2)


def test_amplitude_shows_a_power_of_the_motion_by_that_power_and_leaves_angles(planner, at):
    """Energies of one unit: |p| p by 2^4, phi^3 by 2^6; the angle of two linear causes stays.

    Inputs keep their small means, so that the motion is not quite doubled.
    """
    effects = [quadratic_damping(at.model, "torque"), cubic_stiffness(at.model, "torque")]
    effects += [s.effect for s in stiffness_and_inertia(at)]
    one, two = (predicted_table(planner.larger(f), at, effects) for f in (1.0, 2.0))
    ratio = [b.energy / a.energy for a, b in zip(one.scores, two.scores, strict=True)]
    np.testing.assert_allclose(ratio, [16, 64, 4, 4], rtol=2e-2)
    np.testing.assert_allclose(two.cosines[2:, 2:], one.cosines[2:, 2:], atol=1e-2)


def test_in_a_free_decay_nothing_acts(planner):
    planned = planner.free_decay()
    large, small = (e.record for e in planned.experiments)
    z_s, g = -0.218, 9.81
    p_dot = np.gradient(large["gyro"], large.Ts)
    assert planned.initial[0]["phi"] - planned.initial[1]["phi"] != 0
    # Where nothing acts a_s = z_s phi'' + g phi; phi is the integral of the gyro.
    phi = planned.initial[0]["phi"] + np.cumsum(large["gyro"]) * large.Ts
    left = large["accel"] - (z_s * p_dot + g * phi)
    assert np.std(left[2:-2]) < 0.1 * np.std(large["accel"])
    assert large.duration < 15.0 + 1e-9  # half of 30 s at the most
    assert np.ptp(small["gyro"]) < np.ptp(large["gyro"])


def test_a_multisine_keeps_the_strength_and_stays_in_its_bands(planner):
    made = planner.around()
    (_, low), (high, top) = made.bands
    record = made.experiments[0].record
    assert low < planner.motion.main_frequency() < high < top
    # The gyro's spectrum shows what acts: little between the bands, once the start has died out.
    y = record["gyro"][record.N // 2 :]
    f = np.fft.rfftfreq(len(y), record.Ts)
    power = np.abs(np.fft.rfft(y * np.hanning(len(y)))) ** 2
    gap = (f > 1.15 * low) & (f < high / 1.15)
    wide = planner.wider_band().experiments[0].record["gyro"][record.N // 2 :]
    there = np.abs(np.fft.rfft(wide * np.hanning(len(wide)))) ** 2
    assert power[gap].mean() < 0.1 * there[gap].mean()


def test_a_further_sensor_never_hides_a_cause(planner, at):
    effects = [s.effect for s in stiffness_and_inertia(at)]
    before = predicted_table(planner.again(), at, effects)
    for name in ("phi", "a_y"):
        after = predicted_table(planner.sensor(name), at, effects)
        for a, b in zip(after.scores, before.scores, strict=True):
            assert a.energy > 0.999 * b.energy


def test_stiffness_and_a_load_are_told_beside_the_resonance(at):
    """At one frequency phi'' = -w^2 phi, and a load is a change of stiffness; beside it, it is not.

    More of the same changes no angle.
    """
    suspects = [
        Suspect(parameter_jump(at.model, name, 15.0), size)
        for name, size in (("k", 0.3), ("m", 0.05))
    ]
    advice = next_experiment(pendulum.problem, at, suspects)
    by_name = {p.name: p for p in advice.proposals}
    assert advice.now.cosine > 0.98
    best = advice.proposals[0]
    assert best.name == "beside the resonance"
    assert best.gain_factor > 5
    assert best.is_clearer(advice.now)
    assert "both sides of the resonance" in advice.sentence
    assert "jump of k from jump of m" in advice.sentence
    same = by_name["larger amplitude"]
    assert same.gain_factor == pytest.approx(1.0, abs=0.05)
    assert same.record_length == pytest.approx(advice.now.record_length / 4, rel=0.1)
    # No time to jump: a release that is over before shows neither.
    assert by_name["free decay"].record_length == np.inf
    names = {"wider band", "slower", "longer record", "second load: loaded"}
    assert names | {"sensor of phi", "sensor of a_y"} <= set(by_name)


def test_the_table_and_the_numbers_hold_every_proposal(at):
    advice = next_experiment(pendulum.problem, at, stiffness_and_inertia(at))
    plain = json.loads(json.dumps(advice.to_json()))
    assert [p["name"] for p in plain["proposals"]] == [p.name for p in advice.proposals]
    for p in advice.proposals:
        assert p.name in str(advice)
    clear = [p.is_clearer(advice.now) for p in advice.proposals]
    assert clear == sorted(clear, reverse=True)  # clearer ones first


def test_two_names_of_one_thing_are_told_by_no_experiment(at):
    one = quadratic_damping(at.model, "torque")
    other = replace(one, kind="drag")
    advice = next_experiment(pendulum.problem, at, [Suspect(one, 0.01), Suspect(other, 0.01)])
    assert all(p.record_length == np.inf for p in advice.proposals)
    assert "No experiment considered separates" in advice.sentence
    compared = f"each of the {len(advice.proposals)} that were predicted from the fitted model"
    assert compared in advice.sentence
    assert "small effects of the two change the outputs alike once" in advice.sentence
    assert "may separate them" in advice.sentence
    assert json.loads(json.dumps(advice.to_json()))["now"]["energy_needed"] is None


@pytest.mark.parametrize(
    ("cosines", "said"),
    [
        ([1.0, -1.0], "each of the 2 that were predicted from the fitted model, small effects of"),
        ([1.0, 0.3], "change the outputs alike, or not at all, once"),
        ([1.0], "the one that was predicted"),
        ([], "none could be predicted from the fitted model"),
    ],
)
def test_of_no_experiment_that_separates_causes_it_is_said_what_was_compared(cosines, said):
    """At right angles two causes are separated, unless the parameters absorb one of them."""
    pair = (("offset", "force"), ("sensor_bias", "x"))
    now, *planned = (
        Proposal("p", "do", pair, c, np.inf, np.inf, 1.0, 9.0) for c in [1.0, *cosines]
    )
    sentence = advice_sentence(["an offset", "a bias"], now, planned)
    assert said in sentence
    assert "the same in all" not in sentence


def planned(name: str, length: float, gain: float = 1.0, seconds: float = 86400.0) -> Proposal:
    """An experiment that takes so long, beside a present record of `seconds`."""
    pair, limit = (("offset", "heat"), ("sensor_bias", "T")), max(10 * seconds, 3600.0)
    return Proposal(name, name, pair, 0.99, 1e3, length, gain, seconds, limit=limit)


@pytest.mark.parametrize(
    ("now", "others", "said"),
    [
        pytest.param(
            19.0,
            [("larger", 20.0, 1.0)],
            "No experiment of a reasonable length (here up to 10 days, 10 times the present "
            "records) separates an offset from a bias: the shortest of those considered, the same "
            "experiment again, would take about 19 days. Determine one of them independently",
            id="all too long",
        ),
        pytest.param(
            np.inf,
            [("slow", 5000.0, 4.0), ("larger", 70.0, 1.0)],
            "the shortest of those considered, larger, would take about 70 days.",
            id="a clearer one is longer still",
        ),
        pytest.param(
            4700.0,
            [("larger", 4600.0, 1.0)],
            "No realistic record length separates an offset from a bias: every experiment "
            "considered would take more than 100 days. Determine one of them independently",
            id="so long that its length is not stated",
        ),
        pytest.param(
            5000.0,
            [("decay", 9000.0, 4.0), ("sensor", 2.5, 2.0)],
            "To separate an offset from a bias: sensor. About 2.5 days would suffice, where the "
            "same experiment would not do in 10 days; 2 times as large a share of their effects "
            "tells them apart there.",
            id="a better one is not",
        ),
        pytest.param(
            4.0,
            [("decay", np.inf, 0.0)],
            "repeat the same experiment for 4 days: no other experiment considered is clearly",
            id="nothing but the same",
        ),
        pytest.param(
            4.0,
            [("shorter by a tenth", 3.6, 1.0), ("by a quarter", 3.0, 1.2)],
            "repeat the same experiment for 4 days: no other experiment considered is clearly",
            id="a little shorter is no advice",
        ),
        pytest.param(
            4.0,
            [("beside", 3.6, 9.0)],
            "beside. About 3.6 days would suffice, as of the same experiment; 9 times as large a",
            id="clearer in as much time",
        ),
        pytest.param(
            0.2,
            [("longer", 0.2, 1.0)],
            "repeat the experiment and diagnose both records together: by prediction the present",
            id="the present record should do",
        ),
        pytest.param(
            0.2,
            [("longer", 0.2, 9.0)],
            "To separate an offset from a bias: longer; 9 times as large a share of their effects",
            id="a clearer one than the present record, which should do",
        ),
    ],
)
def test_no_record_is_advised_that_nobody_would_make(now, others, said):
    """A day was recorded; ten days are the limit, and a record of 190 days is no advice."""
    again = planned("again", now * 86400.0)
    proposals = [planned(name, days * 86400.0, gain) for name, days, gain in others]
    assert said in advice_sentence(["an offset", "a bias"], again, proposals)


def test_an_hour_is_no_unreasonable_record_whatever_the_present_one_lasts():
    again, larger = (planned(n, s, seconds=20.0) for n, s in (("again", 3e3), ("larger", 2.9e3)))
    said = advice_sentence(["an offset", "a bias"], again, [larger])
    assert "repeat the same experiment for 50 min" in said


def test_one_cause_alone_or_twice_is_refused(at):
    one = Suspect(quadratic_damping(at.model, "torque"), 0.01)
    for suspects in ([one], [one, one]):
        with pytest.raises(DataError, match="at least two, each once"):
            next_experiment(pendulum.problem, at, suspects)


def test_a_system_on_which_nothing_acts_can_be_released_or_measured_better():
    hidden = truth.roll_decay(seed=2, duration=30)
    at = weighed(roll_decay.problem, hidden, {})
    suspects = [
        Suspect(quadratic_damping(at.model, next(iter(at.model.balances))), 0.05),
        Suspect(coulomb_friction(at.model, next(iter(at.model.balances)), 0.01), 0.001),
    ]
    advice = next_experiment(roll_decay.problem, at, suspects)
    assert {p.name for p in advice.proposals} == {"free decay", "sensor of p"}


def first_order(at_period: float) -> Weighted:
    """A store that a slow sine fills and empties, T' = (u - T) / tau, its time constant 20 s."""
    m = casid.Model("store")
    T, u = m.state("T", "K"), m.input("u", "K", known=True)
    m.balance(T, "heat", inertia=m.parameter("tau", "s", start=20.0), terms=[u, -T], unit="K")
    m.output("T", T, "K")
    t = np.arange(800.0)
    w = 2 * np.pi / at_period
    lag = np.arctan(20 * w)
    y = np.sin(w * t - lag) / np.hypot(1, 20 * w)
    noise = 0.01 * np.random.default_rng(0).standard_normal(800)
    record = casid.Record({"u": np.sin(w * t), "T": y + noise}, {"u": "K", "T": "K"}, Ts=1.0)
    fit = fit_model(m, [casid.Experiment(record)], FitSettings(starts=1))
    return Weighing([casid.Experiment(record)]).weigh(m, fit)


def test_a_record_of_a_first_order_system_is_no_shorter_than_a_period_and_has_no_resonance():
    """A sine of 200 s: no fraction of it is advised, and nothing is said to resonate."""
    at = first_order(200.0)
    motion = FittedMotion(casid.Problem("store", at.model), at, 0)
    assert motion.period() == pytest.approx(200.0)
    assert not motion.resonates(0.0, np.inf)
    (name,) = at.model.balances
    suspects = [
        Suspect(quadratic_damping(at.model, name), 0.5),
        Suspect(parameter_jump(at.model, "tau", 400.0), 5.0),
    ]
    advice = next_experiment(casid.Problem("store", at.model), at, suspects)
    assert all(p.record_length >= 200.0 for p in (advice.now, *advice.proposals))
    by_name = {p.name: p.description for p in advice.proposals}
    assert "free decays of " in by_name["free decay"]
    assert "released from the largest recorded initial state and" in by_name["free decay"]
    assert by_name["larger amplitude"] == "the same excitation, twice as large"
    assert not any("resonance" in p.description for p in advice.proposals)


def test_another_load_and_a_sensor_are_said_with_units(planner):
    """What may be changed is a known value; what is no load case is no load "changed"."""
    made = planner.load("k changed", {"k": 15.0})
    assert made.description == "a second record with k = 15 N m/rad, analysed with the present one"
    made = planner.load("loaded", planner.motion.problem.load_cases["loaded"])
    assert "a second record under the load loaded (m = " in made.description
    assert re.search(r"\(noise [0-9.]+ m?rad\)", planner.sensor("phi").description)


def test_a_lightly_damped_pendulum_resonates_near_what_it_moves_at(planner):
    f = planner.motion.main_frequency()
    assert planner.motion.resonates(f / 1.6, f * 1.6)
    assert not planner.motion.resonates(10 * f, 100 * f)


@pytest.fixture(scope="module")
def lift() -> Planner:
    """A pump moves a load on oil that rings at 2.5 Hz, up and down once in 20 s."""
    m = casid.Model("lift")
    Q, x, v = m.input("Q", "l/min", known=True), m.state("x", "mm"), m.state("v", "mm/s")
    p, A = m.state("p", "bar"), m.constant("A", 20, "cm^2")
    d, C = m.parameter("d", "N s/m", start=3000.0), m.parameter("C", "cm^3/bar", value=2.0)
    m.derivative(x, v)
    mass = m.parameter("M", "kg", value=800.0)
    m.balance(v, "force", inertia=mass, terms=[A * p, -d * v], unit="N")
    m.balance(p, "flow", inertia=C, terms=[Q, -A * v], unit="m^3/s")
    m.output("x", x, "mm")
    m.output("p", p, "bar")
    rng, Ts, t = np.random.default_rng(1), 0.02, 0.02 * np.arange(2000)
    flow = 1e-4 * np.sin(2 * np.pi * t / 20)
    area, z, out = 2e-3, np.zeros(3), np.empty((len(t), 2))
    F = np.array([[0, 1, 0], [0, -3000 / 800, area / 800], [0, -area / 2e-11, 0]])
    for i, q in enumerate(flow):
        out[i] = z[0], z[2]
        for _ in range(100):
            z = z + Ts / 100 * (F @ z + np.array([0, 0, q / 2e-11]))
    noisy = out + rng.normal(size=out.shape) * (1e-4, 1e3)
    record = casid.Record(
        {"Q": flow, "x": noisy[:, 0], "p": noisy[:, 1]}, {"Q": "m^3/s", "x": "m", "p": "Pa"}, Ts
    )
    experiments = [casid.Experiment(record, {})]
    fit = fit_model(m, experiments, FitSettings(starts=1))
    at = Weighing(experiments).weigh(m, fit)
    return Planner(FittedMotion(casid.Problem("lift", m), at))


def test_a_resonance_far_from_what_moves_most_is_not_what_an_excitation_keeps_away_from(lift):
    """The lift goes up and down at 0.05 Hz; its oil rings at 2.5 Hz."""
    assert lift.motion.main_frequency() < 0.1
    assert lift.motion.resonates(2.0, 3.0)
    made = lift.around()
    assert made is None or made.name == "beside the main frequency"


def test_a_position_that_nothing_restores_is_not_what_decays(lift):
    """Released at another height the load stays there; its speed and its pressure die out."""
    made = lift.free_decay()
    assert "released from the largest recorded p, v and" in made.description
    starts = made.initial
    assert starts[0]["x"] == pytest.approx(starts[1]["x"])
    assert abs(starts[0]["v"] - starts[1]["v"]) > 0.01


def test_a_parameter_that_depends_on_something_is_said_in_words():
    assert place_words("K~i") == "the dependence of K on i"
    assert place_words("torque") == "torque"
