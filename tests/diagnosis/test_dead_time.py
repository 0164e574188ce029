"""An input that acts late is one cause, however many sensors show it.

The records come from matrix exponentials between the corners of the late input, which share no code
with casid.
"""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.diagnosis import Alternative, Cause
from casid.diagnosis.search.candidates import name_of
from casid.diagnosis.verdict.sentences import verdict_sentence
from casid.estimation.estimate import Estimated
from casid.model.effects.channels.channel_effects import sensor_bias, sensor_lag
from casid.model.effects.channels.delays import dead_time, time_delay
from casid.model.effects.names import effect_words
from tests.support.driven_oscillator import TS, moved_late

N = 1500
OUTPUTS = ("position", "speed")


def problem(kind: str, *, known: bool, outputs: tuple[str, ...] = OUTPUTS) -> casid.Problem:
    m = casid.Model("oscillator")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    force = m.input("force", "N", hold=kind, known=known)
    k, d = m.parameter("k", "N/m", start=40.0), m.parameter("d", "N s/m", start=1.0)
    mass = m.parameter("m", "kg", start=1.5, lower=0.1)
    m.derivative(x, v)
    m.balance(v, "force balance", inertia=mass, terms=[-k * x, -d * v, force])
    if "position" in outputs:
        m.output("position", x, "m")
    if "speed" in outputs:
        m.output("speed", v, "m/s")
    return casid.Problem("oscillator", m, channels={n: n for n in ("force", *outputs)})


def record(kind: str, delay: float, seed: int = 1) -> casid.Record:
    """What acts is the recorded force of `delay` seconds ago, before the record its first value.

    With a negative delay the force is recorded late.
    """
    rng = np.random.default_rng(seed)
    given = 10 * np.repeat(rng.uniform(-1, 1, N // 15 + 20), 15)[: N + 200]
    if kind == "foh":
        given = np.convolve(given, np.hanning(9) / np.hanning(9).sum(), "same")
    whole = int(np.floor(delay / TS))
    y = moved_late(given[np.clip(np.arange(-1, N + 1) - whole, 0, None)], delay / TS - whole, kind)
    y += 0.01 * y.std(axis=0) * rng.standard_normal((N, 2))
    columns = {"force": given[:N], "position": y[:, 0], "speed": y[:, 1]}
    return casid.Record(columns, {"force": "N", "position": "m", "speed": "m/s"}, Ts=TS)


def diagnosed(kind: str, delay: float, *, known: bool, outputs=OUTPUTS) -> casid.Diagnosis:
    used = record(kind, delay)
    used = used.without(*(n for n in OUTPUTS if n not in outputs))
    return casid.diagnose(problem(kind, known=known, outputs=outputs), used, advise=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "samples"), [("zoh", 0.4), ("foh", 2.37), ("foh", 30.7), ("zoh", 60.7)]
)
def test_a_late_command_is_one_cause_of_what_both_sensors_show(kind: str, samples: float) -> None:
    """Less than a sample, half a period of the motion and a whole one."""
    d = diagnosed(kind, samples * TS, known=True)
    (cause,) = d.causes
    assert (cause.kind, cause.where) == ("time_delay", "force")
    (p,) = cause.parameters
    assert p.name == "dead_time_force"
    assert p.value == pytest.approx(samples * TS, abs=4 * p.std_error)
    assert p.std_error < 0.01 * TS
    assert cause.sentence == "the input force acts late, by a dead time"
    assert "acting force = [new: force(t - dead_time_force)]" in str(d.model.equations())


@pytest.mark.slow
@pytest.mark.parametrize(("delay", "name"), [(0.053, "dead_time_force"), (-0.053, "delay_force")])
def test_a_measured_input_acts_late_or_is_recorded_late(delay: float, name: str) -> None:
    d = diagnosed("foh", delay, known=False)
    (cause,) = d.causes
    assert (cause.kind, cause.where) == ("time_delay", "force")
    (p,) = cause.parameters
    assert p.name == name
    assert p.value == pytest.approx(abs(delay), abs=4 * p.std_error + 0.02 * TS)
    said = "acts later than it is recorded" if delay > 0 else "is recorded later than it acts"
    assert said in cause.sentence


@pytest.mark.slow
def test_of_one_output_a_late_command_and_a_late_sensor_are_the_same() -> None:
    """Only the time between the two is in the data."""
    d = diagnosed("zoh", 2.37 * TS, known=True, outputs=("position",))
    (cause,) = d.causes
    assert {"time_delay in force", "time_delay in position"} <= set(cause.tied)
    assert cause.parameters[0].value == pytest.approx(2.37 * TS, abs=0.02 * TS)


@pytest.mark.slow
def test_an_advance_of_an_input_that_may_act_late_is_no_further_alternative() -> None:
    for delay in (0.053, -0.053):
        d = diagnosed("foh", delay, known=False, outputs=("position",))
        for cause in d.causes:
            assert not [a for a in cause.alternatives if a.why.startswith("an advance of force")]


def test_the_two_delays_of_an_input_have_words_that_tell_them_apart() -> None:
    model = problem("foh", known=False).model
    late, recorded = dead_time(model, "force", 1.0), time_delay(model, "force", 1.0)
    assert name_of(late) == effect_words(*late.key) == "dead time of force (it acts late)"
    assert name_of(recorded) == "delay of the record of force (its sensor is late)"
    assert effect_words(*recorded.key) == "delay of force"
    other = Alternative("time_delay", "force", 0.5, "as well", late.description)
    cause = Cause("time_delay", "position", 1e-9, (), (other,), sentence="it is late")
    text = verdict_sentence("deficient", [cause], {}, "", problem("foh", known=False))
    assert "delay of position or dead time of force (it acts late)" in text


@pytest.mark.parametrize("make", [dead_time, time_delay, sensor_lag])
def test_the_delay_of_a_pulse_width_is_a_time_and_no_width(make):
    """A servo's pulse in microseconds: a dead time of 39 ms was written as 3.92e+04 us."""
    m = casid.Model("servo")
    pulse, x = m.input("pulse", "us", hold="zoh"), m.state("x", "deg")
    k, tau = m.parameter("k", "deg/us", start=0.1), m.parameter("tau", "s", start=0.1)
    m.derivative(x, (k * pulse - x) / tau)
    m.output("x", x, "deg")
    new, names = make(m, "pulse", 0.5).extended(m)
    assert new.unit_of(names[0]) == "s"
    found = Cause("time_delay", "pulse", 0.01, (Estimated(names[0], 0.04, "s"),))
    assert found.in_units(new.declared_units).parameters[0].unit == "s"
    found = Cause("sensor_bias", "pulse", 0.01, (Estimated("bias", 1e-5, "s"),))
    assert found.in_units(new.declared_units).parameters[0].value == pytest.approx(10.0)
    shifted, (bias, *_) = sensor_bias(m, "pulse").extended(m)
    assert shifted.unit_of(bias) == "us"
