"""Balances as linear regressions: exact where they should be, refused where they are none."""

from __future__ import annotations

import numpy as np
import pytest

from casid.data.experiment import Experiment
from casid.data.record import Record
from casid.errors import DataError, IdentifiabilityError, ModelError
from casid.estimation.equation_error import equation_error
from casid.estimation.measured_motion import Butterworth
from casid.model.effects.balances.balance_effects import coulomb_friction, offset, quadratic_damping
from casid.model.effects.channels.channel_effects import hold
from casid.model.effects.channels.delays import time_delay
from casid.model.model import Model
from problems import emps, pendulum, roll_decay
from tests.support.shared import shared


def driven_mass(hold_known: str | None = None) -> Model:
    m = Model("driven mass")
    q, v = m.state("q", "m"), m.state("v", "m/s")
    F = m.input("F", "N")
    M = m.parameter("M", "kg", start=1.0, value=2.0 if hold_known == "M" else None)
    d = m.parameter("d", "N s/m", start=1.0)
    k = m.parameter("k", "N/m", start=1.0)
    m.derivative(q, v)
    m.balance(v, "force", inertia=M, terms=[F, -d * v, -k * q])
    m.output("q", q, "m")
    return m


def sine_record(Ts: float = 0.01, *, M: float = 2.0, d: float = 0.6, k: float = 5.0) -> Record:
    """A motion of three sines and the force that it takes: an exact solution of the balance."""
    t = Ts * np.arange(3000)
    q, v, a = np.zeros_like(t), np.zeros_like(t), np.zeros_like(t)
    for amplitude, w, phase in ((1.0, 0.7, 0.0), (0.3, 2.1, 1.0), (0.1, 4.3, 2.0)):
        q += amplitude * np.sin(w * t + phase)
        v += amplitude * w * np.cos(w * t + phase)
        a -= amplitude * w**2 * np.sin(w * t + phase)
    return Record({"q": q, "F": M * a + d * v + k * q}, {"q": "m", "F": "N"}, Ts=Ts, name="sines")


def test_noise_free_data_return_the_parameters_up_to_the_differences():
    """Central differences are low by (w Ts)^2/6, twice for the acceleration: 3e-4 at 4.3 rad/s."""
    e = Experiment(sine_record(), {}, "sines")
    fit = equation_error(driven_mass(), e, prefilter=None)
    for name, true in (("M", 2.0), ("d", 0.6), ("k", 5.0)):
        assert fit[name] == pytest.approx(true, rel=2 * (4.3 * 0.01) ** 2 / 6)


def test_halving_the_sample_time_quarters_the_error_of_the_differences():
    errors = []
    for Ts in (0.02, 0.01):
        e = Experiment(sine_record(Ts), {}, "sines")
        errors.append(abs(equation_error(driven_mass(), e, prefilter=None)["M"] - 2.0))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.3)


def test_a_zero_phase_filter_on_both_sides_leaves_the_regression_as_it_is():
    """The same linear filter on all signals of a linear balance preserves it (Ljung 1999, 7.5)."""
    e = Experiment(sine_record(), {}, "sines")
    plain = equation_error(driven_mass(), e, prefilter=None)
    filtered = equation_error(driven_mass(), e, prefilter=Butterworth(2.0), decimate=4)
    for name in ("M", "d", "k"):
        assert filtered[name] == pytest.approx(plain[name], rel=1e-3)


def test_the_estimate_is_equivariant_to_the_unit_of_the_force():
    r = sine_record()
    e = Experiment(r, {}, "a")
    scaled = Experiment(r.with_channel("F", 1000.0 * r["F"], "N"), {}, "b")
    one = equation_error(driven_mass(), e, prefilter=None)
    thousand = equation_error(driven_mass(), scaled, prefilter=None)
    for name in ("M", "d", "k"):
        assert thousand[name] == pytest.approx(1000.0 * one[name], rel=1e-9)


def test_values_known_in_one_record_only_move_to_its_known_side():
    r = sine_record()
    both = [Experiment(r, {"M": 2.0}, "known"), Experiment(r, {}, "free")]
    fit = equation_error(driven_mass(), both, prefilter=None)
    assert fit["M"] == pytest.approx(2.0, rel=1e-3)
    only = equation_error(driven_mass(), both[0], prefilter=None)
    assert "M" not in only.start
    assert only["k"] == pytest.approx(5.0, rel=1e-3)


def test_an_eliminated_input_leaves_the_balance_that_the_indirect_model_has():
    """(7.24): I_2 phi'' = -k phi - d phi' - S a_s, a regression once the angle is measured."""
    m = pendulum.direct_model()
    m.output("angle", m.symbol("phi"), "rad")
    model = m.eliminate("a_y", using="accel")
    record = pendulum.simulate(noise=0.0, duration=20.0)
    phi = np.concatenate([[0.0], np.cumsum(0.5 * (record["gyro"][1:] + record["gyro"][:-1]))])
    record = record.with_channel("angle", phi * record.Ts, "rad")
    fit = equation_error(model, Experiment(record, {}, "sim"), prefilter=None)
    # The cart's acceleration has kinks, where the differences of p are off by a sample: 2 %.
    assert fit["k"] == pytest.approx(10.39, rel=0.02)
    assert fit["I_x"] == pytest.approx(0.1385, rel=0.02)


def test_a_start_from_the_balances_lies_inside_the_bounds():
    e = Experiment(sine_record(d=-0.5), {}, "sines")
    m = driven_mass()
    m.parameters["d"] = type(m.parameters["d"])("d", "N s/m", 1.0, 0.0)
    fit = equation_error(m, e, prefilter=None)
    assert fit["d"] < 0
    assert fit.start["d"] == 0.0
    assert "outside its bounds" in str(fit)


# -- refusals ----------------------------------------------------------------------------------


def test_a_product_of_unknowns_is_refused_and_named():
    with pytest.raises(ModelError, match=r"not linear .*phi_0 times C_1.*known value"):
        equation_error(roll_decay.problem, roll_decay.problem.examples(), prefilter=None)


def test_a_state_that_nobody_measures_is_refused():
    with pytest.raises(DataError, match=r"state phi is neither .* measure it"):
        equation_error(pendulum.problem, pendulum.problem.examples(), prefilter=None)


def test_a_balance_without_a_known_term_tells_ratios_only():
    m = Model("free decay")
    q, v = m.state("q", "m"), m.state("v", "m/s")
    M, k = m.parameter("M", "kg"), m.parameter("k", "N/m")
    m.derivative(q, v)
    m.balance(v, "force", inertia=M, terms=[-k * q])
    m.output("q", q, "m")
    record = Record({"q": np.cos(0.05 * np.arange(400))}, {"q": "m"}, Ts=0.05)
    with pytest.raises(IdentifiabilityError, match=r"ratios only; give one parameter"):
        equation_error(m, Experiment(record, {}, "decay"), prefilter=None)


def test_one_sine_cannot_tell_mass_from_stiffness():
    """At a single frequency a = -w^2 q: two columns of the regression are one."""
    t = 0.05 * np.arange(2000)
    record = Record(
        {"q": np.sin(0.9 * t), "F": np.sin(0.9 * t)}, {"q": "m", "F": "N"}, Ts=0.05, name="one sine"
    )
    with pytest.raises(
        IdentifiabilityError, match=r"M.*k.*separately.*give one of them a known value"
    ):
        equation_error(driven_mass(), Experiment(record, {}, "one"), prefilter=None)


def test_what_a_balance_cannot_show_is_refused():
    m = driven_mass()
    e = Experiment(sine_record(), {}, "sines")
    with pytest.raises(ModelError, match=r"delay.*casid\.identify"):
        equation_error(m, e, prefilter=None, effects=[time_delay(m, "q", 0.1)])
    with pytest.raises(ModelError, match=r"F does between its samples.*leave that effect out"):
        equation_error(m, e, prefilter=None, effects=[hold(m, "F")])


@pytest.mark.parametrize(
    ("prefilter", "decimate", "what"),
    [
        (Butterworth(60.0), 1, r"cutoff_hz = 60 must lie between 0 and .* 50 Hz; lower it"),
        (None, 0, r"decimate = 0 must be a whole number"),
        (None, 100, r"too few.*widen the window"),
    ],
)
def test_preparation_that_the_record_cannot_bear_is_refused(prefilter, decimate, what):
    e = Experiment(sine_record(), {}, "sines")
    with pytest.raises(DataError, match=what):
        equation_error(driven_mass(), e, prefilter=prefilter, decimate=decimate)


def test_missing_samples_are_refused():
    r = sine_record()
    mask = np.zeros(r.N, dtype=bool)
    mask[7] = True
    with pytest.raises(DataError, match=r"output q misses samples.*t = 0\.07 s.*cut the record"):
        equation_error(
            driven_mass(), Experiment(r.mark_missing("q", mask), {}, "gap"), prefilter=None
        )


# -- measurements ------------------------------------------------------------------------------


def test_emps_gives_the_published_estimates():
    """IDIM-LS of the benchmark (Janot et al. 2019, sections 3.4-3.6), regressors before decimation.

    Published 95.1089 kg, 203.5034 N s/m, 20.3935 N, offset -3.1648 N on the side of the force
    (ours is a term of the balance: +), relative error 4.0834 %; 17.94 % without friction.
    """
    e = emps.problem.read(shared("data/emps/estimation.csv"))
    how = {"prefilter": Butterworth(100.0), "decimate": 10}
    linear = equation_error(emps.problem, e, **how)
    assert linear.relative_error["estimation"]["force"] == pytest.approx(0.1794, abs=2e-3)
    model = emps.problem.model
    friction = [coulomb_friction(model, "force", speed=1e-9), offset(model, "force")]
    fit = equation_error(emps.problem, e, **how, effects=friction)
    assert fit["M"] == pytest.approx(95.1089, abs=2 * 0.1085)
    assert fit["F_v"] == pytest.approx(203.5034, abs=2 * 1.146)
    assert fit["F_c"] == pytest.approx(20.3935, abs=2 * 0.1012)
    assert fit["F_0"] == pytest.approx(3.1648, abs=2 * 0.0444)
    assert fit.relative_error["estimation"]["force"] < 0.042


def test_drag_is_found_in_a_simulated_decay():
    """Up to the differences: low by (w Ts)^2/6 = 4e-4 for the rate, twice that for its rate."""
    model = roll_decay.problem.model.with_known(phi_0=0.0)
    e = Experiment(roll_decay.simulate(noise=0.0, C_3=0.0), {}, "decay")
    fit = equation_error(model, e, prefilter=None, effects=[quadratic_damping(model, "torque")])
    # Half a sample of curvature at each turn of the rate adds to the error of the drag.
    assert fit["d_2"] == pytest.approx(0.07, rel=0.01)
    assert fit["C_1"] == pytest.approx(6.06, rel=1e-3)
