"""What a diagnosis says to do next follows from its reason, and what has no name is described."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import casid
from casid.diagnosis.advice.recommendation import advice
from casid.diagnosis.calibration.calibration import Calibration
from casid.diagnosis.diagnosis import Alternative, Cause
from casid.diagnosis.evidence.disturbances import Disturbance
from casid.diagnosis.facts import Facts
from casid.diagnosis.verdict.cause import Doubts, Ranked
from casid.diagnosis.verdict.gain import changes, improves
from casid.diagnosis.verdict.not_accepted import NOT_ACCEPTED
from casid.diagnosis.verdict.remainder import Moved
from casid.diagnosis.verdict.sentences import (
    noise_text,
    says,
    says_kind,
    separates,
    verdict_sentence,
    why_alternative,
)
from casid.estimation.estimate import Estimated
from casid.model.effects.balances.balance_effects import coulomb_friction, offset, quadratic_damping
from casid.model.effects.channels.channel_effects import hold, sensor_bias
from casid.model.effects.clock_effects import bias_drift, offset_step, with_duration
from casid.model.effects.names import effect_words, law_of
from casid.model.effects.parameter_effects import parameter_drift
from casid.model.quantities import p_statement
from casid.model.units import unit_quotient
from casid.report.figures.style import short_label
from casid.report.pages.remainder_parts import moved_table
from problems import pendulum
from tests.support.samples import changed
from tests.support.samples import deficient as small


def converter(unit: str, rate: str) -> casid.Model:
    """A balance in `unit` that decays: of a coil, a body or a room."""
    m = casid.Model("decaying")
    x = m.state("x", rate)
    p = m.parameter("p", unit_quotient(unit, rate), start=1.0)
    inertia = m.parameter("J", unit_quotient(unit, unit_quotient(rate, "s")), value=1.0)
    m.balance(x, "balance", inertia=inertia, terms=[-p * x], unit=unit)
    m.output("y", x, rate)
    return m


@pytest.mark.parametrize(
    ("unit", "rate", "name", "sentence"),
    [
        (
            "V",
            "A",
            "constant voltage that opposes x in the balance balance",
            "a constant voltage that opposes x, as a dead voltage or a brush drop does, is missing "
            "in the balance balance",
        ),
        (
            "W",
            "K",
            "constant heat flow that opposes x in the balance balance",
            "a constant heat flow that opposes x is missing in the balance balance",
        ),
        (
            "N",
            "m/s",
            "dry friction in the balance balance",
            "dry (Coulomb) friction acts in the balance balance",
        ),
    ],
)
def test_dry_friction_is_a_matter_of_forces_alone(unit, rate, name, sentence):
    """What stands in a balance of voltages and reverses with the current is no friction."""
    effect = coulomb_friction(converter(unit, rate), "balance", 0.1)
    assert effect.kind == "coulomb_friction"
    assert says(effect) == sentence
    law = law_of(effect.kind, effect.description)
    ranked = Ranked(*effect.key, 0.1, 0.1, None, "named", "", law)
    assert effect_words(*effect.key, description=ranked.law) == name
    assert short_label(effect_words(*effect.key, description=ranked.law), 80) == name.replace(
        " in the balance balance", ", balance"
    )
    alternatives = (Alternative("offset", "balance", 0.5, "as well"),)
    cause = Cause(*effect.key, 1e-9, (), alternatives, description=effect.description)
    said = advice("deficient", [cause], (), "")
    assert said.startswith(f"To separate {name} from constant term in the balance balance: ")
    assert ("friction" in said) is (unit == "N")


@pytest.mark.parametrize(
    ("unit", "rate", "what", "symbols"),
    [
        ("V", "A", "voltage", ("V_c", "V_0")),
        ("W", "K", "heat flow", ("Q_c", "Q_0")),
        ("W", "W", "power", ("P_c", "P_0")),  # of a turbine that lags behind its valve
        ("N", "m/s", "force", ("F_c", "F_0")),
        ("N m", "rad/s", "torque", ("F_c", "tau_0")),
        ("1/s", "1", "term", ("c_c", "c_0")),
    ],
)
def test_a_constant_is_called_by_what_its_balance_is_of(unit, rate, what, symbols):
    model = converter(unit, rate)
    constant, opposing = offset(model, "balance"), coulomb_friction(model, "balance", 0.1)
    assert (opposing.parameters[0].name, constant.parameters[0].name) == symbols
    assert says(constant) == f"a constant {what} acts in the balance balance"
    law = law_of(constant.kind, constant.description)
    assert effect_words(*constant.key, description=law) == f"constant {what} in the balance balance"
    assert ("rests" in separates("offset", "balance", law)) is (what in ("force", "torque", "term"))
    later = offset_step(model, "balance", 3.0)
    assert says(later).startswith(f"a constant {what} sets in during the record")
    words = effect_words(*later.key, description=later.description)
    assert words == f"constant {what} in the balance balance (step)"
    over = offset_step(model, "balance", 3.0, 5.0)
    words = effect_words("offset", "balance", description=over.description)
    assert words == f"constant {what} in the balance balance for a while"
    assert with_duration(over, 1.0) is over
    jolt = with_duration(offset_step(model, "balance", 3.0, 3.02), 0.02)
    words = effect_words("offset", "balance", description=jolt.description)
    assert words == f"constant {what} in the balance balance for one sample"
    at = f"a constant {what} acts in the balance balance for one sample, at 3.00 s"
    assert says(jolt) == f"{at}: an impulse of that times 0.02 s"


@pytest.mark.parametrize(
    ("unit", "rate", "law"),
    [
        ("V", "A", "voltage"),
        ("W", "K", "heat flow"),
        ("W", "J", "power"),
        ("m^3/s", "m", "flow"),
        ("mol/s", "mol", "amount flow"),
    ],
)
def test_a_law_is_called_by_what_its_balance_is_of(unit, rate, law):
    effect = quadratic_damping(converter(unit, rate), "balance")
    words = effect_words(*effect.key, description=effect.description)
    assert words == f"{law} that grows with the square of x in the balance balance"


def test_a_place_that_the_law_has_already_is_not_said_twice():
    law = "a heat flow that grows with the square of T1-Ta"
    said = effect_words("quadratic_damping", "T1-Ta", description=law)
    assert said == "heat flow that grows with the square of T1-Ta"
    effect = replace(quadratic_damping(converter("W", "K"), "balance"), where="x", description=law)
    assert says(effect) == f"{law} is missing in the x balance"
    assert says(replace(effect, where="T1-Ta")) == f"{law} is missing"
    assert effect_words("unknown", "T1-Ta: sqrt|(T1-Ta)|").endswith("like sqrt|T1-Ta| in T1-Ta")


@pytest.mark.parametrize(
    ("kind", "where", "said"),
    [
        ("rectified", "speed", "speed passes through zero, beside a sensor that shows its sign"),
        ("scheduled_parameter", "k~T", "records in each of which T is held, at different values"),
        ("scheduled_parameter", "k", "records in each of which the state is held"),
        ("extra_input", "wind: force", "a record in which wind moves"),
        ("sensor_bias", "pressure", "pressure is known, at rest or beside a reference instrument"),
    ],
)
def test_the_next_record_names_the_channel_that_it_is_about(kind, where, said):
    assert said in separates(kind, where)


def test_two_courses_of_an_input_between_its_samples_have_two_names():
    m = pendulum.problem.model
    (channel, *_) = (n for n, u in m.inputs.items() if u.kind == "measured")
    names = {
        effect_words(*e.key, description=e.description)
        for e in (hold(m, channel, toward) for toward in ("zoh", "bandlimited"))
    }
    of = f"inter-sample behaviour of {channel}"
    assert names == {f"{of} (held)", f"{of} (band-limited)"}


def test_what_a_record_does_not_separate_is_said_once_for_several_causes():
    one = small().causes[0]
    assert one.tied
    text = verdict_sentence("deficient", [one, one], {}, "", pendulum.problem)
    assert text.startswith("The model lacks one of these, and this record does not separate them: ")
    assert text.count("this record does not separate") == 1
    assert "; and one of these: " in text


def test_where_nothing_is_named_no_named_causes_are_included():
    """The errors beside are those with the nearest effect of the catalogue, which is not named."""
    part = {"baseline_rmse": {"gyro": 0.1}, "extended_rmse": {"gyro": 0.12}}
    unknown = replace(small().causes[0], kind="unknown", parameters=(), alternatives=())
    text = verdict_sentence("deficient", [unknown], part, "", pendulum.problem)
    assert "named causes" not in text
    assert "Including the nearest effect of the catalogue raises the RMS error of gyro" in text
    text = verdict_sentence("deficient", [unknown, small().causes[0]], part, "", pendulum.problem)
    assert "Including the named causes raises the RMS error of gyro" in text


@pytest.mark.parametrize(
    ("after", "is_raised"), [(0.093, False), (0.12, False), (0.14, True), (0.05, False)]
)
def test_an_error_that_stays_below_its_noise_floor_is_not_raised(after: float, is_raised: bool):
    """Noise of an input, integrated, leaves less than its floor to a fit and a short record."""
    part = {"baseline_rmse": {"gyro": 0.085}, "extended_rmse": {"gyro": after}}
    part["noise_floor"] = {"gyro": 0.126}
    text = verdict_sentence("deficient", [small().causes[0]], part, "", pendulum.problem)
    assert ("raises the RMS error" in text) == is_raised
    assert improves(part) == (not is_raised)


def test_of_many_that_may_be_the_cause_the_first_are_named():
    """Eleven in all: four and the seven others."""
    one = small().causes[0]
    rivals = [Alternative("extra_input", f"channel_{i}", 0.4, "as well") for i in range(10)]
    many = replace(one, alternatives=tuple(rivals))
    text = verdict_sentence("deficient", [many], {}, "", pendulum.problem)
    assert "channel_2 as a further input or one of 7 others" in text
    assert "channel_3" not in text


@pytest.mark.parametrize(
    ("after", "said"),
    [(0.101, ""), (0.12, "raises the RMS error of gyro"), (0.05, "lowers the RMS error of gyro")],
)
def test_an_error_that_rises_by_a_hundredth_is_not_said_to_rise(after: float, said: str):
    part = {"baseline_rmse": {"gyro": 0.1}, "extended_rmse": {"gyro": after}}
    text = verdict_sentence("deficient", [small().causes[0]], part, "", pendulum.problem)
    assert said in text
    assert ("RMS error" in text) is bool(said)


@pytest.mark.parametrize(
    "why",
    [
        "gyro is zero in every sample that is fitted: check the sensor, its cable and the mapping",
        "gyro is constant, and what moves lies in the held-out part: fit the part that moves "
        "(--window, or --hold-out 0)",
        "the fitted part hides nothing, but the simulation of gyro is wrong where it was not "
        "fitted: diagnose what was held out by itself (--window, or its file)",
    ],
)
def test_where_the_reason_carries_its_own_mend_no_longer_record_is_asked_for(why):
    said = advice("undecided", [], (), why)
    assert said == "Correct what the reason above names, then diagnose again."


def test_where_the_record_says_too_little_more_of_it_is_asked_for():
    why = "12 samples are too few to judge a model with 4 unknowns; 40 are the least"
    assert advice("undecided", [], (), why).startswith("Record longer")


UNKNOWN = Alternative("unknown", "torque", 0.2, "explains as much", "p^3")
NAMED = Cause(
    "quadratic_damping", "torque", 1e-9, (), (UNKNOWN,), sentence="damping grows with the rate"
)


def test_a_rival_without_a_name_is_told_by_what_it_is_like():
    assert "from unidentified term in torque (p^3):" in advice("deficient", [NAMED], (), "")
    famous = replace(UNKNOWN, kind="coulomb_friction", description="friction")
    said = advice("deficient", [replace(NAMED, alternatives=(famous,))], (), "")
    assert "from dry friction in the torque balance:" in said


def test_the_text_describes_what_has_no_name_and_tells_the_notes_of_a_calibration():
    unknown = replace(NAMED, kind="unknown", description="a torque like p^3", alternatives=())
    calibration = Calibration(
        problem="a",
        alpha=0.05,
        requested=200,
        levels=np.full(40, 0.5),
        smallest=np.full(40, 0.5),
        alarms=np.zeros(40, bool),
        seed=0,
        undecided=3,
        is_interrupted=True,
    )
    text = str(changed(small(), causes=(NAMED, unknown), calibration=calibration))
    rival = "or unidentified term in torque (p^3) [unknown] (p = 0.2 against the named one)"
    assert f"{rival}: explains as much" in text
    assert "2. unidentified term in torque [unknown] (p = 1.0e-09): a torque like p^3" in text
    assert "interrupted: 40 of 200 null records were done" in text
    assert "undecided null records, not counted as alarms: 3" in text


@pytest.mark.parametrize(
    ("p_value", "said"),
    [(0.2, "[unknown] (p = 0.2 against the named one): e"), (1.0, "[unknown]: e")],
)
def test_a_p_value_that_speaks_for_neither_is_left_out(p_value: float, said: str):
    cause = replace(NAMED, alternatives=(replace(UNKNOWN, p_value=p_value),))
    assert said in str(changed(small(), causes=(cause,)))


@pytest.mark.parametrize(
    ("gap", "p_value", "said"),
    [(0.0, 0.5, "equally well"), (1.5, 0.3, "as well (BIC 1.5 worse)"),
     (9.0, 0.1, "the misfit worse (BIC 9.0 w"), (-33.3, 0.9, "the misfit better (BIC 33.3 better)"),
     (71.2, 0.8, "fits as closely, but noise of inputs has a part in that (BIC 71.2 worse)")],
)  # fmt: skip
def test_an_alternative_is_described_as_its_bic_says(gap: float, p_value: float, said: str):
    """BIC counts what is left without the part of the inputs' noise; p counts all of it."""
    effect = SimpleNamespace(kind="offset", is_on_the_clock=False)
    best, other = (SimpleNamespace(merit=m, effect=effect) for m in (gap, 0.0))
    assert said in why_alternative(best, rival_of(other, p_value))


def test_what_is_over_again_is_no_step():
    effect = SimpleNamespace(kind="offset", is_on_the_clock=True, shape="step", end=None)
    best, other = effect_at(effect), rival_of(effect_at(effect))
    assert why_alternative(best, other).startswith("as a step, ")
    effect.end = 40.0
    assert why_alternative(best, other).startswith("explains")


def rival_of(candidate: SimpleNamespace, p_value: float = 0.5) -> SimpleNamespace:
    return SimpleNamespace(candidate=candidate, p_value=p_value)


def effect_at(effect: SimpleNamespace) -> SimpleNamespace:
    return SimpleNamespace(merit=0.0, effect=effect)


def test_of_effects_that_were_not_accepted_the_text_has_three_and_counts_the_others():
    notes = tuple(f"effect {i} {NOT_ACCEPTED}: too weak" for i in range(8))
    found = changed(small(), notes=("the first", *notes, "the last"), not_accepted=notes)
    text = str(found)
    assert text.count(NOT_ACCEPTED) == 3
    assert "5 other effects likewise: the report and diagnosis.json have all notes" in text
    assert "the first" in text
    assert "the last" in text


@pytest.mark.parametrize(
    ("value", "Ts", "said"),
    [(109373.5416, 300.0, "time = 30.4 h"), (27.9912, 0.01, "time = 27.99 s"),
     (160.02, 0.1, "time = 160.0 s"), (1.2e6, 600.0, "time = 13.89 d")],
)  # fmt: skip
def test_an_instant_has_the_digits_that_its_sample_time_resolves(value, Ts, said):
    time = Estimated("time", value, "s", note="searched", resolution=Ts)
    limit = Estimated("limit", 2.0, "W", note="not identifiable at the estimate")
    text = str(changed(small(), causes=(replace(NAMED, parameters=(time, limit)),)))
    assert f"{said}, limit = 2 W (not identifiable at the estimate)" in text


def test_another_variant_of_the_same_effect_leaves_nothing_open():
    """Two ways that one input may move between its samples."""
    other = Alternative("hold", "u", 0.3, "explains as much", "band-limited")
    cause = Cause("hold", "u", 1e-9, (), (other,), sentence="the input u is linear")
    assert cause.tied == ()
    assert "separate" not in advice("deficient", [cause], (), "")


def test_a_hold_is_declared_in_the_problem_file_and_needs_no_other_actuator():
    m = casid.Model("probe")
    m.derivative(m.state("z", "m"), m.input("eta", "m/s"))
    effect = hold(m, "eta", "bandlimited")
    assert 'between its samples (hold="bandlimited"), unlike in the model' in says(effect)
    cause = Cause("hold", "eta", 1e-4, (), description=effect.description)
    said = advice("deficient", [cause], (), "")
    line = 'Declare hold="bandlimited" for eta in the problem file: no equation changes.'
    assert said == f"{line} Then diagnose again."
    both = advice("deficient", [cause, replace(NAMED, alternatives=())], (), "")
    assert both.startswith(f"{line} Use the extended model")
    assert "sampling rate" not in both


def test_a_residual_that_is_noise_implies_nothing_of_an_input():
    m = casid.Model("probe")
    m.derivative(m.state("z", "m"), m.input("u", "m/s"))
    m.output("z", m.symbol("z"), "m")
    columns = {"u": np.arange(9.0), "z": np.zeros(9)}
    record = casid.Record(columns, {"u": "m/s", "z": "m"}, Ts=1.0)
    at: Any = SimpleNamespace(
        model=m,
        input_sd={"u": 0.01},
        full=SimpleNamespace(
            output_sd=np.array([0.1]), source_sd={"u": 0.3}, floor=lambda _: np.array([0.12])
        ),
        criterion=SimpleNamespace(outputs=("z",), experiments=[casid.Experiment(record, {}, "r")]),
    )
    assert "the residual implies up to 0.3 m/s" in noise_text(at)["u"]
    assert noise_text(at, is_all=True)["u"] == "white input noise 10 mm/s"
    assert noise_text(at)["z"] == "white output noise 0.1 m"
    at.input_sd["u"] = 1e-9  # no logger has it, and the estimate ended next to zero
    assert noise_text(at)["u"].startswith("no white noise found; the residual implies up to 0.3")


def test_an_output_whose_noise_ended_at_zero_has_none_instead_of_nanometres():
    m = casid.Model("probe")
    m.derivative(m.state("z", "m"), m.input("u", "m/s"))
    m.output("z", m.symbol("z"), "m")
    record = casid.Record({"z": np.zeros(9)}, {"z": "m"}, Ts=1.0)
    at: Any = SimpleNamespace(
        model=m,
        input_sd={},
        full=SimpleNamespace(
            output_sd=np.array([1e-9]), source_sd={}, floor=lambda _: np.array([0.02])
        ),
        criterion=SimpleNamespace(outputs=("z",), experiments=[casid.Experiment(record, {}, "r")]),
    )
    assert noise_text(at)["z"].startswith("no white output noise found")


def test_what_was_not_named_extends_nothing_and_the_advice_does_not_say_so():
    unknown = Cause("unknown", "torque", 1e-3, ())
    said = advice("deficient", [unknown], (), "")
    assert said.startswith("No term was found to add: look for what the residual follows")
    assert "extended model" not in said
    assert "Use the extended model" in advice(
        "deficient", [unknown, replace(NAMED, alternatives=())], (), ""
    )


def test_a_bias_that_grows_is_another_effect_than_a_constant_one():
    """Where one sensor's constant bias may be another's drift, not only the place is open."""
    m = pendulum.indirect_model()
    constant, grows = sensor_bias(m, "gyro"), bias_drift(m, "gyro", (0.0, 9.0))
    later = offset_step(m, "torque", 4.0)
    assert effect_words(*constant.key, description=constant.description) == "bias of gyro"
    drift = Alternative(grows.kind, "accel", 0.6, "alike", grows.description)
    assert drift.words == "bias of accel (drift)"
    step = effect_words(later.kind, later.where, description=later.description)
    assert step == "constant torque in the torque balance (step)"
    cause = Cause(constant.kind, "gyro", 1e-9, (), (drift,), sentence="gyro has a constant bias")
    text = verdict_sentence("deficient", [cause], {}, "", pendulum.problem)
    assert "same effect" not in text
    assert "bias of gyro or bias of accel (drift)" in text


SPIKES = Cause("outliers", "gyro", 1e-9, (Estimated("share", 0.01, "1"),), sentence="it has spikes")
ALONE = replace(NAMED, alternatives=())
DISAGREE = Doubts(
    disagreements=("the records disagree on k by more than their errors (chi^2 is 9 times ...",)
)
UNEXPLAINED = Doubts(is_more_than_noise=True)


def test_where_spoilt_samples_and_nothing_with_a_name_were_found_there_is_no_model_to_use():
    unknown = Cause("unknown", "torque", 1e-3, ())
    said = advice("deficient", [SPIKES, unknown], (), "")
    assert said.startswith("Correct the sensor or the logger, or mark these samples as missing. No")
    assert "extended model" not in said


def test_a_model_with_the_same_errors_is_not_recommended():
    said = advice("deficient", [ALONE], (), "", is_same=True)
    assert said.startswith("Keep the present model: the extended one has the same errors.")


@pytest.mark.parametrize(("after", "is_changed"), [(0.1, False), (0.10004, False), (0.099, True)])
def test_an_error_is_the_same_to_its_third_digit(after: float, is_changed: bool):
    part = {"baseline_rmse": {"gyro": 0.1}, "extended_rmse": {"gyro": after}}
    assert changes(part) is is_changed


def test_records_that_disagree_on_what_was_named_are_diagnosed_apart_first():
    """What acts in one record alone, as a wind, has no place in a model of all of them."""
    first = "Diagnose each record by itself, and look for what differs between them"
    for causes in ([ALONE], [NAMED]):
        together = advice("deficient", causes, (), "")
        apart = advice("deficient", causes, (), "", doubts=DISAGREE)
        assert apart == f"{first}: {DISAGREE.said}. {together}"


def test_on_what_records_disagree_is_said_beside_what_was_named():
    """A cause in one of two records is not all that is wrong where another parameter fits each."""
    apart = "the records disagree on k by more than their errors."
    for cause, said in ((ALONE, "Beside that, "), (SPIKES, "They do not explain all: ")):
        text = verdict_sentence("deficient", [cause], {}, "", pendulum.problem, doubts=DISAGREE)
        assert said + apart in text
        assert "disagree" not in verdict_sentence("deficient", [cause], {}, "", pendulum.problem)


@pytest.mark.parametrize(
    ("doubts", "said", "todo"),
    [
        (UNEXPLAINED, "but the remainder is not random.", "Use the model with care"),
        (DISAGREE, "but the records disagree on k by", "Diagnose each record by itself"),
    ],
)
def test_what_contradicts_the_model_is_said_where_no_cause_was_found(
    doubts: Doubts, said: str, todo: str
):
    text = verdict_sentence("adequate", [], {}, "", pendulum.problem, doubts=doubts)
    assert said in text
    told = advice("adequate", [], ("constant torque in the torque balance",), "", doubts=doubts)
    assert told.startswith(todo)
    spoilt = advice("deficient", [SPIKES], (), "", doubts=doubts)
    assert f"They do not explain all: {doubts.said}." in spoilt
    for each in (text, told, spoilt):
        assert "othing in this record contradicts" not in each
        assert "may be used" not in each
    assert "nothing in this record contradicts" in advice("deficient", [SPIKES], (), "")


WIND = Disturbance("torque", 0.3, "N m", 1.0)
LEFT_TO_IT = Doubts(poor=("gyro in sea (11 %)",))


def test_wrong_samples_do_not_hide_what_is_known_of_the_model_without_them() -> None:
    """Spikes alone, and a disturbance that moves nine tenths of the output."""
    told = partial(verdict_sentence, "deficient", [SPIKES], {})
    alone = told("", pendulum.problem)
    text = told("", pendulum.problem, [WIND], doubts=LEFT_TO_IT)
    assert text.startswith(alone)
    assert f"They do not explain all: {LEFT_TO_IT.said}." in text
    assert "gyro in sea (11 %)" in LEFT_TO_IT.said
    assert f"{WIND.sentence[1:]}." in text
    bound = "the fit holds k at its lower bound (0 N m/rad)"
    assert told(bound, pendulum.problem).endswith(f"without them is not known: {bound}.")


def test_a_drift_says_between_which_instants_it_is_and_where_the_parameter_has_its_value():
    m = casid.Model("probe")
    k = m.parameter("k", "1/s", start=1.0)
    z = m.state("z", "m")
    m.derivative(z, -k * z)
    m.output("z", z, "m")
    said = says(parameter_drift(m, "k", (0.0, 210.0)))
    assert said.startswith("the parameter k drifts during the record")
    assert "from 0 s to 3.5 min, its value the one in the middle" in said


@pytest.mark.parametrize(
    ("where", "words"),
    [
        ("torque", "the restoring torque is not linear"),
        ("p", "the restoring term of the p balance is not linear"),
        ("body", "the restoring term of the body balance is not linear"),
    ],
)
def test_what_restores_is_called_by_the_balance_only_where_that_is_a_force(where, words):
    assert words in says_kind("cubic_stiffness", where)


def test_a_bias_says_over_what_it_grows_and_with_which_sign_a_command_acts():
    m = casid.Model("room")
    c, q = m.state("c", "ppm"), m.input("q", "m^3/h", hold="zoh", known=True)
    m.balance(c, "CO2", inertia=m.parameter("V", "m^3", start=200), terms=[q * (420e-6 - c)])
    m.output("co2", c, "ppm")
    drifting = says(bias_drift(m, "co2", (0.0, 240000.0)))
    assert drifting.endswith("grows steadily (its size is what it grows to from 0 s to 2.78 d)")
    assert "acts beside its zero, as q - bias_q (an error of" in says(sensor_bias(m, "q"))


def test_a_p_value_below_what_can_be_computed_is_said_to_be():
    """It is bounded where it is computed, and is not 1e-300."""
    text = str(changed(small(), causes=(replace(NAMED, p_value=1e-300),)))
    assert "(p < 1e-300)" in text
    assert "1.0e-300" not in text
    assert p_statement(0.0) == p_statement(1e-300) == "p < 1e-300"
    assert p_statement(0.0123) == "p = 0.012"


def test_a_cause_that_sets_in_has_its_own_row_among_the_candidates():
    """What sets in and what was always there are two effects in one balance, of two p-values."""
    cause = Cause("offset", "torque", 1e-78, (), description="a constant torque sets in")
    step = Ranked("offset", "torque: step", 0.02, 0.54, 2900.0, "named")
    steady = Ranked("offset", "torque", 0.05, 0.81, None, "not significant")
    d = changed(small(), causes=(replace(cause, shape="step"),), ranking=(step, steady))
    facts = Facts.of(d)
    assert facts.p_value("offset", "torque: step") == 1e-78
    assert facts.p_value("offset", "torque") == 0.81


def test_a_moved_parameter_is_measured_in_the_larger_of_both_errors():
    """As the caption beside it says: the error before is often the larger one."""
    moved = Moved("k", "N/m", 10.0, 16.0, std_error_after=1.0, std_error_before=2.0)
    assert moved.shift == pytest.approx(3.0)
    assert "the larger of those before and after" in moved_table(changed(small())).caption
