"""A fit leaves a model that knows its values, its records and what was added to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import casid
from casid.estimation.errors_in_variables.error_bars import robust_bars
from casid.estimation.fitted.equations import equations_of
from casid.estimation.simulation.fit import fit_model
from casid.estimation.simulation_estimate import ASSUMES, estimate_of
from casid.model.clock_signals import StepAt
from casid.model.effects.balances.balance_effects import quadratic_damping
from casid.model.effects.balances.periodic import periodic_disturbance
from casid.model.effects.channels.actuator_effects import actuator_lag
from casid.model.effects.channels.channel_effects import hold, sensor_lag
from casid.model.effects.channels.delays import dead_time, time_delay
from casid.model.effects.effect import Motion
from casid.model.effects.parameter_effects import parameter_jump
from casid.model.effects.state_schedules import state_scheduled_parameter
from tests.support.fitted_models import driven_mass

TS = 0.02


def record(
    *, seed: int = 3, N: int = 400, k: float = 50.0, name: str = "run", later: float | None = None
) -> casid.Record:
    """Steps of force on 2 kg, 1.5 N s/m and `k`, stepped by Euler's method at 0.1 ms.

    From 4 s on the stiffness is `later`, where it is given.
    """
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.normal(0.0, 4.0, N // 25 + 1), 25)[:N]
    x, v, position = 0.05, -0.1, np.empty(N)
    for i in range(N):
        position[i] = x
        if later is not None and i * TS >= 4.0:
            k = later
        for _ in range(200):
            v += TS / 200 * (force[i] - k * x - 1.5 * v) / 2.0
            x += TS / 200 * v
    position += 1e-3 * rng.normal(size=N)
    units = {"force": "N", "position": "m"}
    return casid.Record({"force": force, "position": position}, units, Ts=TS, name=name)


@pytest.fixture(scope="module")
def estimate() -> casid.Estimate:
    problem = casid.Problem("oscillator", driven_mass(), {"position": "x_mm:mm"}, starts=1)
    return casid.identify(problem, record())


def test_every_parameter_of_the_fitted_model_has_its_estimated_value(estimate):
    fitted = estimate.model
    assert all(p.is_known for p in fitted.model.parameters.values())
    assert fitted.values == {n: estimate[n] for n in ("d", "k", "m")}
    assert fitted.initial_states == {n: estimate[f"{n}(0)"] for n in ("x", "v")}
    assert fitted.Ts == TS
    assert fitted.covariance_names == ("d", "k", "x(0)", "v(0)")
    assert np.array_equal(fitted.covariance, estimate.covariance)
    assert fitted.channels.columns == {"position": "x_mm:mm"}


def test_a_record_keeps_the_values_that_hold_in_it_alone():
    """Two springs, one mass: each record has its own stiffness, and the model their mean."""
    records = [record(k=50.0, name="soft"), record(k=60.0, name="stiff", seed=4)]
    problem = casid.Problem("oscillator", driven_mass(), starts=1)
    fitted = casid.identify(problem, records, settings=casid.FitSettings(starts=1, own=["k"])).model
    soft, stiff = (r.known["k"] for r in fitted.records)
    assert (soft, stiff) == pytest.approx((50.0, 60.0), rel=0.01)
    assert fitted.values["k"] == pytest.approx((soft + stiff) / 2)


EFFECTS = {
    "late output": lambda m: time_delay(m, "position", 0.2),
    "late input": lambda m: time_delay(m, "force", 0.2),
    "lag of the sensor": lambda m: sensor_lag(m, "position", 0.3),
    "lag of the actuator": lambda m: actuator_lag(m, "force", 0.3),
    "other hold": lambda m: hold(m, "force"),
    "jump": lambda m: parameter_jump(m, "k", 4.013),
}


@pytest.mark.parametrize("effect", EFFECTS)
def test_the_residuals_of_the_fitted_model_are_those_of_the_fit_to_the_last_bit(effect):
    """Stages, holds and generated inputs are part of the model, not of the fit that found them."""
    plain = driven_mass()
    extended = EFFECTS[effect](plain).extend(plain, starts={"delay_position": 0.03})
    problem = casid.Problem("oscillator", extended, starts=1)
    run = record()
    fit = fit_model(extended, [casid.Experiment(run)], casid.FitSettings(starts=1), throw=False)
    model = estimate_of(problem, fit, bars=robust_bars(fit, ASSUMES)).model
    at = fit.criterion.simulated(fit.x, 0)
    used = fit.criterion.data[0].used[:, 0]
    assert used.sum() > 300
    assert np.array_equal(model.residuals(run)["position"][used], at.residual[used, 0])
    simulated = model.simulate(run)
    assert np.array_equal(np.column_stack([simulated["x"], simulated["v"]]), at.x)


def test_a_simulation_from_arrays_needs_names_units_and_lengths_to_be_right(estimate):
    model = estimate.model
    force = np.ones(50)
    run = model.simulate({"force": force}, x0={"x": 0.0, "v": 0.0})
    assert run.units == {"force": "N", "position": "m", "x": "m", "v": "m/s"}
    assert (run.N, run.Ts) == (50, TS)
    # Static deflection F / k is reached from rest with the overshoot of a second-order system.
    k, d = model.values["k"], model.values["d"]
    long = model.simulate({"force": np.ones(2000)}, x0=[0.0, 0.0])
    zeta = d / (2 * np.sqrt(k * 2.0))
    overshoot = np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2))
    assert long["position"][-1] == pytest.approx(1 / k, rel=1e-3)
    assert long["position"].max() == pytest.approx((1 + overshoot) / k, rel=1e-3)
    with pytest.raises(casid.DataError, match="samples of force are missing"):
        model.simulate({"torque": force})
    with pytest.raises(casid.DataError, match="all of one length"):
        model.simulate({"force": np.ones((50, 2))})
    with pytest.raises(casid.ModelError, match="which is no state; did you mean 'v'|no state"):
        model.simulate({"force": force}, x0={"V": 0.0})
    with pytest.raises(casid.ModelError, match="give 2 finite ones, of x, v"):
        model.simulate({"force": force}, x0=[1.0])
    with pytest.raises(casid.DataError, match="sampled every 0.02 s, not every 0.1 s"):
        model.simulate(record(), Ts=0.1)
    with pytest.raises(casid.ModelError, match="no parameter 'kk' to set"):
        model.simulate({"force": force}, known={"kk": 1.0})


def test_a_coarser_sample_time_is_integrated_with_as_many_steps_a_second(estimate):
    held = np.repeat(np.random.default_rng(1).normal(size=40), 5)
    fine = estimate.model.simulate({"force": held}, x0=[0.0, 0.0])
    coarse = estimate.model.simulate({"force": held[::5]}, x0=[0.0, 0.0], Ts=5 * TS)
    assert coarse["position"] == pytest.approx(fine["position"][::5], rel=1e-9, abs=1e-15)


def test_a_record_that_was_not_fitted_starts_from_the_state_that_simulates_it_best(estimate):
    """Its initial state is estimated for residuals; a simulation starts as the first record."""
    other = record(seed=9)
    model = estimate.model
    assert np.std(model.residuals(other)["position"]) == pytest.approx(1e-3, rel=0.1)
    away = {"x": 1.0, "v": 0.0}
    assert model.simulate(other, x0=away)["position"][0] == 1.0
    assert model.simulate(other)["x"][0] == estimate["x(0)"]


def test_a_jump_acts_on_the_clock_of_the_fitted_record_alone():
    plain = driven_mass()
    jump = parameter_jump(plain, "k", 4.0)
    problem = casid.Problem("oscillator", jump.extend(plain, starts={"jump_k": 5.0}), starts=1)
    model = casid.identify(problem, record()).model
    assert model.model.inputs["step at 4 s"].signal == StepAt(4.0, is_held=True)
    apart = {"force": record()["force"]}
    same = model.simulate(apart, on_clock=True)
    assert np.array_equal(same["position"], model.simulate(record())["position"])
    with pytest.warns(UserWarning, match="step at 4 s: belongs to the clock of .*on_clock=True"):
        silent = model.simulate(apart)
    without = model.simulate(apart, known={"jump_k": 0.0}, on_clock=False)
    assert np.array_equal(silent["position"], without["position"])
    assert not np.array_equal(same["position"], without["position"])


def test_a_jump_acts_in_another_window_of_the_fitted_record(tmp_path: Path):
    """A stiffness that is 20 % larger from 4 s on, fitted to 6 s and simulated in the rest."""
    whole = record(N=800, k=50.0, later=60.0)
    plain = driven_mass()
    jump = parameter_jump(plain, "k", 4.0)
    problem = casid.Problem("oscillator", jump.extend(plain, starts={"jump_k": 5.0}), starts=1)
    fitted, later = whole.between(0.0, 6.0), whole.between(8.0, 15.9)
    model = casid.identify(problem, fitted).model
    left = model.residuals(later)["position"]
    assert np.std(left) == pytest.approx(1e-3, rel=0.15)
    compared = model.compare(later)
    assert not compared.notes
    elsewhere = casid.Record(later.channels, later.units, later.Ts, later.t0, name="elsewhere")
    with pytest.warns(UserWarning, match="does not act in elsewhere"):
        silent = model.compare(elsewhere)
    name = model.name
    assert silent.fit[name]["position"] < compared.fit[name]["position"] - 5
    assert "step at 4 s: belongs to the clock of" in str(silent)
    acting = model.compare(elsewhere, on_clock=True)
    assert acting.fit == compared.fit
    assert not acting.notes
    again = casid.load(model.save(tmp_path / "model.casid"))
    assert np.array_equal(again.residuals(later)["position"], left)


def test_without_a_noise_model_a_prediction_is_the_simulation(estimate):
    """The predictor of an output-error model uses no output (Ljung 1999, (4.25))."""
    run = record()
    for horizon in (1, 7, None):
        predicted = estimate.model.predict(run, horizon)
        assert np.array_equal(predicted["position"], estimate.model.simulate(run)["position"])
    with pytest.raises(casid.DataError, match="horizon = 0; give a whole number"):
        estimate.model.predict(run, 0)


def test_residuals_are_missing_where_the_measurement_is(estimate):
    mask = np.arange(400) == 7
    found = estimate.model.residuals(record().mark_missing("position", mask))
    assert np.array_equal(found.is_missing("position"), mask)


def test_draws_for_arviz_have_the_mean_and_spread_of_the_estimate(estimate):
    pytest.importorskip("arviz")
    found = estimate.to_inference_data(draws=4000, seed=1).posterior
    assert set(found.data_vars) == {"d", "k", "x(0)", "v(0)"}
    assert found["k"].shape == (1, 4000)
    assert found["k"].attrs["units"] == "N/m"
    error = estimate.parameter("k").std_error
    assert float(found["k"].mean()) == pytest.approx(estimate["k"], abs=4 * error / 4000**0.5)
    assert float(found["k"].std()) == pytest.approx(error, rel=0.05)


def test_the_equations_mark_what_was_added():
    """A delay is no term of an equation, and is marked as a whole; the changed ones come twice."""
    plain = driven_mass()
    extended = quadratic_damping(plain, "force").extend(plain, starts={"d_2": 0.1})
    extended = time_delay(extended, "position", 0.2).extend(extended)
    found = equations_of(extended, plain)
    assert str(found).splitlines() == [
        "dx/dt = v",
        "(m) dv/dt = -k * x - d * v + force + [new: -d_2 * |v| * v]   [N]",
        "position = x   [m]",
        "measured position = [new: position(t - delay_position)]   [the sensor is late]",
    ]
    assert [str(e) for e in found.before] == ["(m) dv/dt = -k * x - d * v + force   [N]"]
    assert [e.name for e in found.changed] == ["force", "delay of position"]
    latex = found.latex().splitlines()
    assert latex[1] == r"\dot{x} &= v \\"
    damped = r"- k \, x - d \, v + \mathrm{force} + \boxed{- d_{2} \, v \, \left|{v}\right|} \\"
    assert latex[2] == r"m\,\dot{v} &= " + damped
    assert not equations_of(plain).changed
    jump = equations_of(parameter_jump(plain, "m", 2.0).extend(plain), plain)
    assert [e.left_is_new for e in jump.changed] == [True]


def test_an_input_that_acts_late_and_lags_is_written_as_what_acts():
    """No input of casid's own, which carries a tangent, stands in an equation."""
    plain = driven_mass()
    late = dead_time(plain, "force", 0.2).extend(plain, starts={"dead_time_force": 0.1})
    both = actuator_lag(late, "force", 0.5).extend(late, starts={"tau_force": 0.1})
    assert str(equations_of(both, plain)).splitlines() == [
        "dx/dt = v",
        "(m) dv/dt = -k * x - d * v + [new: acting force]   [N]",
        "position = x   [m]",
        "acting force = [new: force(t - dead_time_force)]   [the input acts late]",
        "acting force = [new: force behind a lag of tau_force]   [the actuator lags]",
    ]


def test_what_keeps_a_division_finite_is_not_shown():
    """k (k - s m)/(k - s x^2), of which the denominator has 1e-150 besides."""
    plain = driven_mass()
    size = Motion(0.1, 0.0, 0.2, 0.05)
    found = equations_of(state_scheduled_parameter(plain, "k", "x", size, 2).extend(plain), plain)
    (equation,) = found.changed
    (term,) = [t for t in equation.terms if t.is_new]
    for text in (term.text, term.latex, term.mathml):
        assert "150" not in text
    assert "k - curvature_k_x * x^2)" in term.text


def test_a_periodic_disturbance_is_written_with_the_time():
    """The middle of the record, from which it counts, and the turn; no generated input by name."""
    plain = driven_mass()
    found = equations_of(
        periodic_disturbance(plain, "force", 0.2, (0.0, 62940.0)).extend(plain), plain
    )
    (equation,) = found.changed
    assert [t.text for t in equation.terms if t.is_new] == [
        "a_cos * cos(2 pi * frequency * (t - 31470 s))",
        "a_sin * sin(2 pi * frequency * (t - 31470 s))",
    ]
    assert r"\cos{\left(2 \, \pi \, \text{(t - 31470 s)}" in found.latex()
    assert "<mi>&pi;</mi>" in equation.terms[-1].mathml
    assert "6.28" not in str(found) + found.latex() + "".join(t.mathml for t in equation.terms)


def test_models_are_compared_on_one_record_by_their_fit_in_per_cent(estimate):
    """A stiffness known 4 N/m too large costs what its simulation shows."""
    run = record(seed=5, name="fresh")
    wrong = casid.identify(driven_mass().with_known(k=54.0), record())
    found = estimate.model.compare(run, wrong)
    assert list(found.fit) == ["oscillator", "mass on a spring"]
    residual = estimate.model.residuals(run)["position"]
    spread = run["position"] - run["position"].mean()
    expected = 100 * (1 - np.linalg.norm(residual) / np.linalg.norm(spread))
    assert found.fit["oscillator"]["position"] == pytest.approx(expected, rel=1e-12)
    assert found.fit["mass on a spring"]["position"] < expected - 5
    assert found.to_frame().loc["oscillator", "position"] == pytest.approx(expected)
    assert "Fit to fresh, free simulation" in str(found)
    figure = found.plot()
    assert np.array_equal(figure.data[0].y, run["position"])
    assert figure.data[1].name == f"oscillator: {expected:.1f} %"
    with pytest.raises(casid.DataError, match="no channel 'force'"):
        estimate.model.compare(run.without("force"))
    assert list(estimate.model.compare(run, estimate).fit) == ["oscillator", "oscillator#2"]


def test_an_estimate_from_moments_leaves_a_model_that_starts_as_declared():
    """A regression estimates no initial state; its model settles at F / k, however biased k is."""
    found = casid.least_squares(driven_mass(), casid.Experiment(record(N=2000))).estimate
    model = found.model
    assert model.values == {"d": found["d"], "k": found["k"], "m": 2.0}
    assert model.initial_states == {"x": 0.0, "v": 0.0}
    assert model.Ts == TS
    assert np.array_equal(model.covariance, found.covariance)
    held = model.simulate({"force": np.ones(20_000)})["position"]
    assert held[-1] == pytest.approx(1 / found["k"], rel=1e-6)


def test_segments_of_multiple_shooting_start_where_the_fit_has_them():
    run = record()
    settings = casid.FitSettings(starts=1, segments=5)
    fit = fit_model(driven_mass(), [casid.Experiment(run)], settings, throw=False)
    found = estimate_of(
        casid.Problem("oscillator", driven_mass()), fit, bars=robust_bars(fit, ASSUMES)
    )
    model = found.model
    drawn = found.sample(lambda values: values["k"], draws=2000).values
    assert np.std(drawn) == pytest.approx(found.parameter("k").std_error, rel=0.1)
    assert model.records[0].nodes.shape == (5, 2)
    assert model.covariance_names == ("d", "k", "x(0)", "v(0)")
    residual = fit.criterion.simulated(fit.x, 0).residual
    assert np.array_equal(model.residuals(run)["position"], residual[:, 0])


@pytest.mark.slow
def test_a_diagnosis_leaves_the_model_with_its_causes_for_the_record_as_it_is():
    """A wrong sign was negated before the fit; in the model it is a factor of the sensor."""
    run = record(N=1500)
    turned = run.with_channel("position", -run["position"], "m")
    found = casid.diagnose(
        casid.Problem("oscillator", driven_mass(), starts=1), turned, advise=False
    )
    assert [(c.kind, c.where) for c in found.model.causes] == [("sensor_scale", "position")]
    assert found.model.values["scale_position"] == -2.0
    assert np.std(found.model.residuals(turned)["position"]) == pytest.approx(1e-3, rel=0.1)
    assert found.model.baseline.values["k"] == found.baseline["k"]
    fit = found.model.compare(turned).to_frame()["position"]
    assert fit.iloc[0] > 99.0 > 50.0 > fit.iloc[1]


def test_a_table_with_empty_cells_is_compared_without_them_and_simulated_whatever_its_outputs(
    estimate,
):
    model = estimate.model
    frame = record().to_frame().rename(columns={"position": "x_mm"})
    frame.attrs.clear()
    frame["x_mm"] *= 1e3
    whole = model.simulate(frame)
    gaps = frame.copy()
    gaps.loc[gaps.index[[5, 6, 200]], "x_mm"] = np.nan
    compared = model.compare(gaps)
    assert np.flatnonzero(np.isnan(compared.measured[:, 0])).tolist() == [5, 6, 200]
    for spoilt in (np.nan, np.inf, "off"):
        outputs = gaps.astype({"x_mm": object})
        outputs["x_mm"] = spoilt
        assert np.array_equal(model.simulate(outputs)["position"], whole["position"])
        with pytest.raises(casid.DataError, match="'x_mm'"):
            model.compare(outputs)
    inputs = frame.copy()
    inputs.loc[inputs.index[100:300], "force"] = np.nan
    with pytest.raises(casid.DataError, match="force"):
        model.simulate(inputs)
