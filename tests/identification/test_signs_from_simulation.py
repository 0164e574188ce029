"""A sign flip is a scale of -1: suspected where the parameters cannot follow, and mended."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import casid
from casid.estimation.simulation.fit import FitSettings
from casid.identification.channel_signs import negated
from casid.identification.signs_from_simulation import (
    WrongSign,
    better_by_chance,
    most_excited,
    wrong_sign,
)
from casid.model.effects.effect import KINDS
from casid.presentation import present
from problems import pendulum, roll_decay, ship
from problems.ship_4dof import Load, measure, random_steps, simulate

ONE = FitSettings(starts=1)

NO_SEARCH = sorted(KINDS - {"offset"})
"""Kinds that a diagnosis leaves out where what it says of the signs is at issue, and no cause."""


def pendulum_record(seed: int = 3) -> list[casid.Experiment]:
    return [casid.Experiment(pendulum.simulate(duration=10.0, seed=seed), {}, "run")]


def ship_records(seed: int = 1) -> list[casid.Experiment]:
    return ship.experiments(duration=8.0, seed=seed)


def suspected(problem: casid.Problem, records: list[casid.Experiment]) -> WrongSign | None:
    return wrong_sign(problem.model, records, ONE)


@pytest.mark.parametrize("channel", ["gyro", "accel"])
def test_one_input_and_one_output_share_the_suspicion(channel: str) -> None:
    """A linear model with zero at rest: -y from u is y from -u, so either sensor may be turned."""
    found = suspected(pendulum.problem, negated(pendulum_record(), channel))
    assert found is not None
    assert found.channel == "gyro"
    assert set(found.rivals) == {"accel"}
    assert found.after["gyro"] < 0.5 * found.before["gyro"]
    assert "scale of -1" in str(found)


@pytest.mark.slow
@pytest.mark.parametrize("channel", ["r", "accel"])
def test_the_yaw_gyro_and_the_accelerometer_of_a_ship_are_named(channel: str) -> None:
    found = suspected(ship.problem, negated(ship_records(), channel))
    assert found is not None
    assert found.channel == channel
    assert not found.rivals
    assert f"-record[{channel!r}]" in found.remedy


def test_the_mend_of_the_message_ends_the_suspicion() -> None:
    """With both: the record's channel replaced, and a derived channel in the problem file."""
    (wrong,) = negated(pendulum_record(), "accel")
    (found,) = [suspected(pendulum.problem, [wrong])]
    assert found is not None
    record = wrong.record
    line = found.remedy.split("in Python ")[1].split(";")[0]
    mended = eval(line, {"record": record})
    assert suspected(pendulum.problem, [casid.Experiment(mended, {}, "mended")]) is None
    code = found.remedy.split("in the problem file ")[1].split(", the file's")[0]
    derived = eval(f"dict({code})", {"casid": casid})["derived"]
    turned = record.with_channel("gyro_recorded", record["gyro"], "rad/s").without("gyro")
    model = pendulum.problem.model
    file = casid.Problem("mended", model, channels={"gyro_recorded": "gyro"}, derived=derived)
    assert suspected(file, [file.experiment(turned)]) is None


@pytest.mark.parametrize("seed", range(4))
def test_right_signs_are_not_suspected(seed: int) -> None:
    """At alpha = 0.05 and half the power: none of 12 records, three problems, one with drag."""
    dragged = pendulum.simulate(duration=20.0, d_2=0.4, seed=seed)
    assert suspected(pendulum.problem, pendulum_record(seed)) is None
    assert suspected(pendulum.problem, [casid.Experiment(dragged, {}, "drag")]) is None
    assert suspected(ship.problem, ship_records(seed)) is None


def test_signs_that_the_model_does_not_see_are_not_suspected() -> None:
    """A free decay has no input: negated, it is the decay from the other side."""
    records = roll_decay.problem.examples()
    for channel in roll_decay.problem.model.outputs:
        assert suspected(roll_decay.problem, negated(records, channel)) is None


def heated_room(unit: str) -> tuple[casid.Problem, list[casid.Experiment]]:
    """A room whose model has 60 times the heat, so that no sign explains the record."""
    m = casid.Model("room")
    outside, P = m.input("T_out", unit), m.input("P", "W", hold="zoh")
    T = m.state("T", unit)
    C = m.parameter("C", "kJ/K", start=900, lower=50, upper=2000)
    H = m.parameter("H", "W/K", start=40, lower=5, upper=500)
    m.balance(T, "air", inertia=C, terms=[60 * P, -H * (T - outside)])
    m.output("T", T, unit)
    zero = 273.15 if unit == "degC" else 0.0
    out = zero + 4 + 4 * np.sin(2 * np.pi * np.arange(400) / 144)
    heat = 1500.0 * (np.arange(400) // 20 % 2)
    inside = np.full(400, zero + 18.0)
    for k in range(399):
        inside[k + 1] = inside[k] + 600 / 900e3 * (heat[k] - 40 * (inside[k] - out[k]))
    inside += 0.05 * np.random.default_rng(1).standard_normal(400)
    channels = {"T": (inside, "K"), "T_out": (out, "K"), "P": (heat, "W")}
    units = {name: unit for name, (_, unit) in channels.items()}
    record = casid.Record({n: x for n, (x, _) in channels.items()}, units, Ts=600.0, name="room")
    return casid.Problem("room", m), [casid.Experiment(record, {}, "run")]


@pytest.mark.parametrize("unit", ["degC", "K"])
def test_no_sign_is_suspected_of_a_temperature_or_where_none_explains_the_misfit(unit: str) -> None:
    """Negated, T_out lowers the rms error from 89 K to 74 K; the record's own spread is 3.6 K."""
    problem, records = heated_room(unit)
    assert wrong_sign(problem, records, ONE) is None


def test_the_comparison_of_errors_has_its_level() -> None:
    """Equal errors: one-sided 5 % in 400 draws, within 3.5 binomial standard deviations (3.8 %)."""
    rng = np.random.default_rng(5)
    hits = [better_by_chance(rng.standard_normal(300)) < 0.05 for _ in range(400)]
    assert abs(np.mean(hits) - 0.05) < 3.5 * np.sqrt(0.05 * 0.95 / 400)


@pytest.mark.slow
def test_a_diagnosis_names_the_sign_first_and_goes_on_with_it_mended(tmp_path: Path) -> None:
    """Drag under a turned accelerometer: both are found, and the gain is measured held out."""
    record = pendulum.simulate(duration=15.0, d_2=0.4)
    wrong = negated([casid.Experiment(record, {}, "run")], "accel")
    found = casid.diagnose(pendulum.problem, wrong, starts=1, max_causes=1, advise=False)
    first = found.to_json()["causes"][0]
    assert (first["kind"], first["where"]) == ("sensor_scale", "gyro")
    assert first["parameters"]["scale"]["value"] == -1.0
    assert [a["where"] for a in first["alternatives"]] == ["accel"]
    assert [c.kind for c in found.causes[1:]] == ["quadratic_damping"]
    assert found.verdict == "deficient"
    assert "wrong sign" in str(found).splitlines()[1]
    assert "-record['gyro']" in found.advice
    after, before = (found.held_out[k]["gyro"] for k in ("extended_rmse", "baseline_rmse"))
    assert after < 0.2 * before
    # The figures show the record mended, and the baseline turned with it.
    view = found.records[0]
    assert view.extended is not None
    assert np.corrcoef(view.measured[:, 0], view.extended[:, 0])[0, 1] > 0.9
    page = found.write(tmp_path).read_text(encoding="utf-8")
    assert "wrong sign" in page.split('class="sentence"')[1][:200]


@pytest.mark.slow
def test_an_estimate_carries_the_suspicion_at_its_top() -> None:
    wrong = negated(pendulum_record(), "gyro")
    settings = FitSettings(starts=1, substeps=1, solver=casid.Solver(max_iterations=100))
    found = casid.identify(pendulum.problem, wrong, settings=settings)
    assert "wrong sign" in str(found).splitlines()[1]
    assert "wrong sign" in found.to_json()["suspects"][0]
    assert "wrong sign" in present(found, "page")


def test_an_estimate_from_right_signs_has_no_suspects() -> None:
    found = casid.identify(pendulum.problem, pendulum_record(), settings=ONE)
    assert found.suspects == ()


# -- a sign is wrong only against the fit that is reported, and only if turned it makes a model ----


def late_heater() -> tuple[casid.Problem, casid.Experiment]:
    """A heated block, on for 234 s of 366 s, under a sensor that lags by 25 s; the model has none.

    The loss begins at 10 W/K, 40 times too large: turned, the duty is matched by a time constant so
    short that a step a sample makes it grow.
    """
    m = casid.Model("block")
    u, T = m.input("duty", "1", hold="zoh"), m.state("T", "degC", start=25.6)
    C = m.parameter("C", "J/K", start=380, lower=0.1, upper=10000)
    H = m.parameter("H", "W/K", start=10, lower=0.01, upper=1000)
    P, outside = m.constant("P", 120, "W"), m.constant("T_a", 298.5, "K")
    m.balance(T, "heat", inertia=C, terms=[P * u, -H * (T - outside)])
    m.output("temperature", T, "degC")
    on, inside, shown = np.zeros(122), 298.6, np.full(122, 298.6)
    on[20:98] = 1.0
    for k in range(121):
        shown[k + 1] = shown[k]
        for _ in range(30):
            shown[k + 1] += 0.1 / 25 * (inside - shown[k + 1])
            inside += 0.1 / 620 * (120 * on[k] - 0.25 * (inside - 298.5))
    shown = np.round(shown / 0.0625) * 0.0625
    record = casid.Record(
        {"duty": on, "temperature": shown}, {"duty": "1", "temperature": "K"}, Ts=3
    )
    return casid.Problem("block", m), casid.Experiment(record, {}, "block")


def spin_up(kick: float = 2.0) -> tuple[casid.Problem, casid.Experiment]:
    """A motor that counts turns from a start that is far: torque and drag ten times too large."""
    m = casid.Model("motor")
    th, w = m.state("th", "rad"), m.state("w", "rad/s")
    torque = m.parameter("T_m", "N m", start=0.005, lower=0.0, upper=1.0)
    d = m.parameter("d", "N m s/rad", start=1e-5, lower=0.0, upper=1.0)
    m.derivative(th, w)
    m.balance(w, "torque", inertia=m.constant("J", 7.7e-6, "kg m^2"), terms=[torque, -d * w])
    m.output("count", m.constant("cpr", 63.66, "1/rad") * th, "1")
    t = 0.0025 * np.arange(224)
    turned = 0.5 * 160 * t**2 * (1 + 0.1 * np.sin(9 * t)) + kick * np.sqrt(t)
    record = casid.Record({"count": np.floor(1 + 63.66 * turned)}, {"count": "1"}, Ts=0.0025)
    return casid.Problem("motor", m), casid.Experiment(record, {}, "spin")


@pytest.mark.slow
@pytest.mark.parametrize("made", [late_heater, spin_up])
def test_no_sign_is_wrong_against_the_fit_that_is_reported(made) -> None:
    problem, record = made()
    assert casid.identify(problem, record).suspects == ()
    found = casid.diagnose(
        problem, record, hold_out=0, max_causes=1, without=NO_SEARCH, starts=1, advise=False
    )
    assert "wrong sign" not in found.sentence


# -- noise as large as the motion: instruments from the rudder tell the signs ----------------------

BUILT = ship.problem.with_known({"A_x": ship.TABLE_8_2["A_x"], "K_vdot": ship.TABLE_8_2["K_vdot"]})


def noisy_ship() -> list[casid.Experiment]:
    """The nonlinear ship with its calibration weight, steps of the rudder, a small unit's noise."""
    case = ship.LOAD_CASES["calibration"]
    motion = simulate(random_steps(60.0, angle=0.2, hold=1.5, seed=5), load=Load(**case))
    unit = measure(motion, seed=2)
    record = casid.Record(
        {n: unit[n] for n in ("gyro", "accel", "delta")} | {"r": -unit["yaw_gyro"]},
        {"gyro": "rad/s", "accel": "m/s^2", "delta": "rad", "r": "rad/s"},
        Ts=unit.Ts,
        name="run",
    )
    return [casid.Experiment(record, case, "calibration")]


@pytest.fixture(scope="module")
def noisy() -> list[casid.Experiment]:
    return noisy_ship()


@pytest.mark.parametrize("channel", ["r", "accel"])
def test_instruments_tell_a_sign_that_the_simulation_error_does_not(noisy, channel) -> None:
    found = wrong_sign(BUILT, negated(noisy, channel), ONE)
    assert found is not None
    assert found.channel == channel
    assert f"-record[{channel!r}]" in found.remedy
    if found.reference:
        assert found.reference == "delta"
        assert found.left < 0.1
        assert "Hansen's J of instruments from delta" in str(found)


def test_the_simulation_error_alone_leaves_the_yaw_gyro_in_doubt(noisy) -> None:
    """The one of the two that needs the reference, which is delta as it is declared noise-free."""
    found = wrong_sign(BUILT, negated(noisy, "r"), ONE)
    assert found is not None
    assert found.reference == "delta"
    assert found.after["gyro"] > 0.5**0.5 * found.before["gyro"]


def test_signs_of_the_noisy_ship_that_are_right_are_not_suspected(noisy) -> None:
    assert wrong_sign(BUILT, noisy, ONE) is None


@pytest.mark.slow
def test_an_estimate_from_the_noisy_ship_names_the_yaw_gyro(noisy) -> None:
    found = casid.identify(BUILT, negated(noisy, "r"), settings=ONE)
    (said,) = found.suspects
    assert "the channel r probably has the wrong sign" in said
    line = found.suspects[0].split("in Python ")[1].split(";")[0]
    record = eval(line, {"record": negated(noisy, "r")[0].record})
    mended = [casid.Experiment(record, noisy[0].known, "mended")]
    assert casid.identify(BUILT, mended, settings=ONE).suspects == ()


@pytest.mark.slow
def test_a_parameter_at_its_bound_is_never_called_adequate(noisy, monkeypatch) -> None:
    """The yaw gyro the wrong way round, had nothing suspected it: K_r, at most 0, ends at 0."""
    monkeypatch.setattr("casid.diagnosis.evidence.baseline.wrong_sign", lambda *_, **__: None)
    (turned,) = negated(noisy, "r")
    short = casid.Experiment(turned.record.between(0.0, 30.0), turned.known, turned.name)
    found = casid.diagnose(BUILT, [short], starts=1, max_causes=1, without=NO_SEARCH, advise=False)
    assert found.verdict == "undecided"
    assert "K_r at its upper bound (0 N m s/rad)" in found.sentence
    assert "signs" in found.advice
    assert "widen it" in found.advice
    assert "may be used" not in found.advice
    said = found.noise["r"]
    assert "implies up to" not in said or float(said.split("up to ")[1].split()[0]) < 1.0


# -- where nothing can be said of signs ------------------------------------------------------------


def noise_alone(*, steering: bool) -> list[casid.Experiment]:
    out = []
    for i, e in enumerate(ship_records()):
        rng = np.random.default_rng(i)
        record = e.record
        for n in record.names:
            values = 0.002 * rng.standard_normal(record.N)
            if n == "delta":
                values = 100 * values if steering else 0 * values
            record = record.with_channel(n, values, record.units[n])
        out.append(casid.Experiment(record, e.known, e.name))
    return out


@pytest.mark.parametrize("steering", [pytest.param(True, marks=pytest.mark.slow), False])
def test_no_sign_is_suspected_in_noise_alone(steering) -> None:
    assert wrong_sign(ship.problem, noise_alone(steering=steering), ONE) is None


def test_a_rudder_at_rest_is_named_before_any_sign() -> None:
    found = casid.diagnose(
        ship.problem, noise_alone(steering=False), starts=1, hold_out=0, advise=False
    )
    assert found.verdict == "undecided"
    assert "gyro, as far as fitted, is noise alone" in found.sentence
    assert "delta never moves: check its cable and mapping" in found.sentence
    assert "wrong sign" not in str(found)
    assert any(n.startswith("nominal: delta: constant at") for n in found.notes)


@pytest.mark.slow
def test_a_rudder_stuck_at_its_limit_is_told_with_the_estimate_and_the_diagnosis(tmp_path) -> None:
    """The calibrated ship's rudder turns for 3 s and stands for the other 3."""
    (e,) = ship.experiments(("calibration",), duration=6.0)
    delta = np.array(e.record["delta"])
    delta[150:] = 1.01 * np.abs(delta).max()
    stuck = casid.Experiment(e.record.with_channel("delta", delta, "rad"), e.known, e.name)
    told = "calibration: delta: 150 equal samples at the maximum"
    found = casid.identify(BUILT, [stuck], settings=ONE)
    assert any(w.startswith(told) for w in found.warnings)
    assert any("cut it off with a window" in w for w in found.warnings)
    whole = casid.diagnose(BUILT, [stuck], starts=1, max_causes=1, without=NO_SEARCH, advise=False)
    assert any(n.startswith(told) for n in whole.to_json()["notes"])
    assert told in str(whole)
    assert told in whole.write(tmp_path).read_text(encoding="utf-8")
    assert not any("equal samples" in w for w in casid.identify(BUILT, [e], settings=ONE).warnings)


def test_the_liveliest_stretch_may_be_the_end_of_a_record():
    """The record that moves most in its last 20 s, at a step that no decimal meets."""
    t = np.arange(2500) / 100.0
    quiet = np.where(t < 5.0, 0.0, np.sin(t)) * 1.0
    record = casid.Record({"y": quiet}, {"y": "rad"}, Ts=79.41 / 7941, name="end")
    part = most_excited(casid.Experiment(record), ("y",))
    assert part.record.N == 2000
    assert part.record.t[-1] == pytest.approx(record.t[-1])


def test_a_simulation_that_diverges_is_compared_all_the_same():
    """Squared errors of 1e265 have no squares; the better of two is told by their size alone."""
    worse = 1e265 * (1.0 + 0.1 * np.random.default_rng(1).random(500))
    assert better_by_chance(worse) < 1e-6
    assert better_by_chance(-worse) > 0.99
    assert better_by_chance(np.zeros(500)) == 1.0
