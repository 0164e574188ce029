"""The minimiser of the simulation error is what theory says, however it is computed."""

from __future__ import annotations

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.signal import cont2discrete

import casid
from casid.estimation.simulation.channels.sensor_dynamics import delay_columns
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.records.signals import window_cuts
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.channels.channel_effects import saturation, sensor_lag
from casid.model.effects.channels.delays import time_delay

TRUE = {"m": 2.0, "d": 1.5, "k": 50.0}
TS = 0.02


def oscillator(**known: float) -> casid.Model:
    m = casid.Model("mass on a spring")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    force = m.input("force", "N", hold="zoh", known=True)
    mass = m.parameter("m", "kg", start=1.5, lower=0.1, upper=20.0)
    d = m.parameter("d", "N s/m", start=1.0, lower=0.0)
    k = m.parameter("k", "N/m", start=40.0, lower=0.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[-k * x, -d * v, force])
    m.output("position", x, "m")
    return m.with_known(**known) if known else m


EXACT = casid.FitSettings(starts=1, substeps=8)
"""Step 2.5 ms at 5 rad/s: the integration error, (w h)^4 / 120, is 2e-10."""


def problem(model: casid.Model | None = None) -> casid.Problem:
    return casid.Problem(name="oscillator", model=model or oscillator(), starts=1)


def experiment(
    *, N: int = 500, noise: float = 0.0, seed: int = 3, name: str = "r", **values: float
) -> casid.Experiment:
    """Steps of force; the response by scipy's exact discretisation."""
    p = {**TRUE, **values}
    rng = np.random.default_rng(seed)
    F = np.repeat(rng.normal(0.0, 4.0, N // 25 + 1), 25)[:N]
    A = np.array([[0.0, 1.0], [-p["k"] / p["m"], -p["d"] / p["m"]]])
    B = np.array([[0.0], [1 / p["m"]]])
    a, b, *_ = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), TS, method="zoh")
    x, y = np.array([0.05, -0.1]), np.empty(N)
    for i in range(N):
        y[i] = x[0]
        x = a @ x + b[:, 0] * F[i]
    y += noise * rng.normal(size=N)
    record = casid.Record(
        {"force": F, "position": y}, {"force": "N", "position": "m"}, Ts=TS, name=name
    )
    return casid.Experiment(record, {}, name)


def test_noise_free_data_return_the_true_parameters():
    e = casid.identify(problem(), experiment(), settings=EXACT)
    for name, value in TRUE.items():
        assert e[name] == pytest.approx(value, rel=1e-6)
    assert e["x(0)"] == pytest.approx(0.05, rel=1e-6)
    assert e["v(0)"] == pytest.approx(-0.1, rel=1e-6)
    assert e.is_converged


@pytest.mark.parametrize("segments", [3, 10])
def test_single_and_multiple_shooting_share_one_optimum(segments):
    """Continuity holds at the solution, so the criterion is the same there (Bock 1983)."""
    data = experiment(noise=0.01)
    one, many = (
        casid.identify(
            problem(), data, settings=casid.FitSettings(starts=1, segments=s, substeps=2)
        )
        for s in (1, segments)
    )
    for name in (*TRUE, "x(0)", "v(0)"):
        a, b = one.parameter(name), many.parameter(name)
        assert b.value == pytest.approx(a.value, rel=1e-5, abs=1e-3 * a.std_error)
        # The number of lags (Andrews) follows the scores of all unknowns, so may differ.
        assert b.std_error == pytest.approx(a.std_error, rel=0.05)
    assert many.rmse["r"]["position"] == pytest.approx(one.rmse["r"]["position"], rel=1e-7)


def test_ipopt_and_sqpmethod_find_the_same_optimum():
    data = experiment(noise=0.01)
    a, b = (
        casid.identify(
            problem(),
            data,
            settings=casid.FitSettings(starts=1, substeps=1, solver=casid.Solver(name)),
        )
        for name in ("ipopt", "sqpmethod")
    )
    for name in TRUE:
        # Both stop where the scaled gradient is small: a thousandth of a standard error.
        assert b[name] == pytest.approx(a[name], abs=2e-3 * a.parameter(name).std_error)


def with_delay() -> casid.Model:
    return oscillator().extend(time_delay(oscillator(), "position", 0.2))


def with_input_delay() -> casid.Model:
    m = oscillator()
    m.inputs["force"] = replace(m.inputs["force"], kind="measured", hold="foh")
    return m.extend(time_delay(m, "force", 0.2))


def with_dead_time() -> casid.Model:
    return oscillator().extend(time_delay(oscillator(), "force", 0.2))


def with_clipping() -> casid.Model:
    return oscillator().extend(saturation(oscillator(), "position", 0.08))


@pytest.mark.parametrize(
    ("model", "own"),
    [
        (oscillator, None),
        (with_delay, ("delay_position", 0.053)),
        (with_input_delay, ("delay_force", 0.053)),
        (with_dead_time, ("dead_time_force", 0.053)),
        (with_clipping, ("limit_position", 0.07)),
    ],
    ids=["plain", "delayed output", "delayed input", "late command", "clipped output"],
)
def test_the_gradient_is_that_of_the_criterion_as_computed(model, own):
    criterion = SimulationError(model(), [experiment(noise=0.01)], substeps=1)
    x = criterion.start
    if own:
        x[criterion.names.index(own[0])] = own[1]
    at = criterion.evaluate(x)
    assert criterion.value_alone(x) == pytest.approx(at.value, rel=1e-12)
    _, _, jac = criterion.simulate(x, 0, tangent=True)
    for i, v in enumerate(criterion.variables):
        h = 1e-6 * v.scale if v.scale < 1 else 1e-6
        up, down = x.copy(), x.copy()
        up[i] += h
        down[i] -= h
        slope = (criterion.evaluate(up).value - criterion.evaluate(down).value) / (2 * h)
        # Truncation, rounding, and (clipping) a sample that passes the limit within h.
        size = np.sqrt(at.hessian[i, i] * at.value)
        assert at.gradient[i] == pytest.approx(slope, abs=1e-4 * size)
        column = (criterion.simulate(up, 0)[0] - criterion.simulate(down, 0)[0]) / (2 * h)
        assert np.abs(jac[:, :, i] - column).mean() < 1e-4 * np.abs(column).max()


def test_the_delay_of_an_output_and_of_an_input_are_found_where_they_are():
    """A position that comes 2.5 samples late: interpolated between samples, not rounded to one."""
    smooth = np.sin(np.arange(800) * TS * 2.0) + np.sin(np.arange(800) * TS * 4.3)
    fine = SimulationError(with_input_delay(), [_smooth(smooth, smooth)], substeps=4)
    x = fine.start
    for name, value in TRUE.items():
        x[fine.names.index(name)] = value
    y, _, _ = fine.simulate(x, 0)
    x[fine.names.index("delay_force")] = 0.0
    found = casid.identify(
        problem(with_delay()),
        _smooth(smooth, delay_columns(y[:, 0], 2.5)),
        settings=casid.FitSettings(starts=1, substeps=4),
    )
    # Straight lines between samples, against a held force, shift the input by half a sample.
    assert found["delay_position"] == pytest.approx((2.5 - 0.5) * TS, abs=0.05 * TS)
    found = casid.identify(
        problem(with_input_delay()),
        _smooth(delay_columns(smooth, 2.5), y[:, 0]),
        settings=casid.FitSettings(starts=1, substeps=4),
    )
    assert found["delay_force"] == pytest.approx(2.5 * TS, abs=0.05 * TS)
    assert found["k"] == pytest.approx(TRUE["k"], rel=1e-3)


def _smooth(force: np.ndarray, position: np.ndarray) -> casid.Experiment:
    record = casid.Record(
        {"force": force, "position": position}, {"force": "N", "position": "m"}, Ts=TS
    )
    return casid.Experiment(record, {}, "r")


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 2.75, -1.6])
def test_cubic_convolution_delays_quadratics_exactly(delay):
    """Third-order convergence (Keys 1981): no error below the cubic term."""
    k = np.arange(40.0)
    y = 0.5 * k**2 - 3 * k + 2
    s = k - delay
    inner = slice(6, -6)
    assert delay_columns(y, delay)[inner] == pytest.approx(
        (0.5 * s**2 - 3 * s + 2)[inner], abs=1e-10
    )
    assert delay_columns(y, delay, derivative=True)[inner] == pytest.approx(
        (s - 3)[inner], abs=1e-10
    )
    stacked = np.column_stack([y, 2 * y])
    assert delay_columns(stacked, delay)[:, 1] == pytest.approx(2 * delay_columns(y, delay))


def test_experiments_that_share_nothing_are_fitted_as_if_alone():
    a, b = experiment(noise=0.01, name="a"), experiment(noise=0.01, m=3.0, seed=4, name="b")
    together = casid.identify(
        problem(), [a, b], settings=casid.FitSettings(starts=1, own=("m", "d", "k"))
    )
    for e in (a, b):
        alone = casid.identify(problem(), e, settings=casid.FitSettings(starts=1))
        for name in TRUE:
            assert together[f"{name}@{e.name}"] == pytest.approx(
                alone[name], abs=2e-3 * alone.parameter(name).std_error
            )


@pytest.mark.slow
def test_a_shared_spring_and_a_mass_of_each_record_are_told_apart():
    a, b = experiment(name="a"), experiment(m=3.0, seed=4, name="b")
    e = casid.identify(problem(), [a, b], settings=replace(EXACT, own=("m",)))
    assert e["k"] == pytest.approx(50.0, rel=1e-6)
    assert e["m@a"] == pytest.approx(2.0, rel=1e-6)
    assert e["m@b"] == pytest.approx(3.0, rel=1e-6)


def test_a_second_record_of_the_same_length_divides_the_variance_by_about_two():
    a, b = experiment(noise=0.01, N=2000), experiment(noise=0.01, N=2000, seed=5, name="b")
    one, both = casid.identify(problem(), a), casid.identify(problem(), [a, b])
    for name in TRUE:
        ratio = one.parameter(name).std_error / both.parameter(name).std_error
        assert ratio == pytest.approx(np.sqrt(2), rel=0.25)  # the two excitations differ


def test_a_parameter_at_its_bound_is_named_and_has_no_standard_error():
    model = oscillator()
    model.parameters["k"] = replace(model.parameters["k"], start=70.0, lower=60.0)
    e = casid.identify(problem(model), experiment(noise=0.01))
    k = e.parameter("k")
    assert k.value == pytest.approx(60.0, rel=1e-6)
    assert k.std_error is None
    assert "lower bound" in k.note
    assert any(w.startswith("k is at its lower bound") for w in e.warnings)
    assert e.parameter("m").std_error > 0


def test_a_nonlinear_equality_is_honoured_by_the_estimate_and_by_its_covariance():
    """zeta = 0.075 exactly, d^2 = 4 zeta^2 m k: the estimate moves on that surface only."""
    zeta = TRUE["d"] / (2 * np.sqrt(TRUE["m"] * TRUE["k"]))

    def damping_ratio(s):
        return s["d"] ** 2 - 4 * zeta**2 * s["m"] * s["k"]

    settings = casid.FitSettings(starts=1, constraints=(damping_ratio,))
    e = casid.identify(problem(), experiment(noise=0.01), settings=settings)
    free = casid.identify(problem(), experiment(noise=0.01), settings=casid.FitSettings(starts=1))
    assert e["d"] / (2 * np.sqrt(e["m"] * e["k"])) == pytest.approx(zeta, rel=1e-6)
    normal = np.zeros(len(e.covariance_names))
    for name, value in (
        ("d", 2 * e["d"]),
        ("m", -4 * zeta**2 * e["k"]),
        ("k", -4 * zeta**2 * e["m"]),
    ):
        normal[e.covariance_names.index(name)] = value
    along = float(np.sqrt(max(normal @ e.covariance @ normal, 0.0)))
    assert along < 1e-5 * 2 * e["d"] * free.parameter("d").std_error
    assert e.parameter("d").std_error < free.parameter("d").std_error


def test_an_unknown_gain_leaves_only_ratios_and_the_refusal_names_them():
    """m x'' + d x' + k x = b u has d/m, k/m, b/m: one direction of four is unseen."""
    m = casid.Model("gain unknown")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    u = m.input("force", "N", hold="zoh", known=True)
    mass, d = m.parameter("m", "kg", start=1.5), m.parameter("d", "N s/m", start=1.0)
    k, b = m.parameter("k", "N/m", start=40.0), m.parameter("b", "1", start=0.8)
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[-k * x, -d * v, b * u])
    m.output("position", x, "m")
    with pytest.raises(casid.IdentifiabilityError) as refused:
        casid.identify(problem(m), experiment(noise=0.01))
    text = str(refused.value)
    assert re.search(r"rank 5 of 6", text)
    for ratio in ("d/m", "k/m", "b/m"):
        assert ratio in text
    assert "give one of them a known value" in text
    e = casid.identify(problem(m.with_known(b=1.0)), experiment(), settings=EXACT)
    assert e["m"] == pytest.approx(2.0, rel=1e-6)


def test_a_parameter_that_moves_no_output_is_named_with_its_mend():
    model = oscillator()
    model.parameter("unused", "N", start=1.0)
    with pytest.raises(casid.IdentifiabilityError, match="unused does not move any output.*known"):
        casid.identify(problem(model), experiment(noise=0.01))


def upside_down() -> casid.Model:
    m = casid.Model("inverted pendulum")
    x, v = m.state("x", "rad"), m.state("v", "rad/s")
    u = m.input("u", "rad/s^2", hold="zoh", known=True)
    a = m.parameter("a", "1/s^2", start=80.0, lower=1.0)
    d = m.parameter("d", "1/s", start=0.5, lower=0.0)
    m.derivative(x, v)
    m.balance(v, "torque", inertia=1, terms=[a * x, -d * v, u], unit="rad/s^2")
    m.output("angle", x, "rad")
    return m


def balanced(N: int = 4000, Ts: float = 0.02) -> casid.Experiment:
    """a = 100 1/s^2, held upright by feedback; in open loop it falls as exp(9.5 t)."""
    rng = np.random.default_rng(3)
    a, b, *_ = cont2discrete(
        (np.array([[0.0, 1.0], [100.0, -1.0]]), np.array([[0.0], [1.0]]), np.eye(2),
         np.zeros((2, 1))), Ts, method="zoh"
    )  # fmt: skip
    x, u, y = np.zeros(2), np.empty(N), np.empty(N)
    level = np.repeat(rng.normal(0.0, 5.0, N // 15 + 1), 15)
    for i in range(N):
        y[i] = x[0]
        u[i] = -150.0 * x[0] - 15.0 * x[1] + level[i]
        x = a @ x + b[:, 0] * u[i]
    record = casid.Record(
        {"u": u, "angle": y + 1e-3 * rng.normal(size=N)}, {"u": "rad/s^2", "angle": "rad"}, Ts=Ts
    )
    return casid.Experiment(record, {}, "balanced")


def test_an_unstable_model_needs_multiple_shooting():
    """exp(9.5 * 80) overflows; over a quarter of a second it is 11 (Bock 1983)."""
    with pytest.raises(casid.SolveError, match="at the start; change the start"):
        fit_model(upside_down(), [balanced()], casid.FitSettings(starts=1))
    settings = casid.FitSettings(starts=1, segments=40, substeps=1)
    e = casid.identify(problem(upside_down()), balanced(N=500), settings=settings)
    assert e.is_converged
    for name, value in (("a", 100.0), ("d", 1.0)):
        p = e.parameter(name)
        assert p.value == pytest.approx(value, abs=4 * p.std_error)
    assert e["a"] == pytest.approx(100.0, rel=0.02)


def test_the_order_of_records_does_not_matter():
    a, b = experiment(noise=0.01, name="a"), experiment(noise=0.01, seed=4, name="b")
    one, two = casid.identify(problem(), [a, b]), casid.identify(problem(), [b, a])
    for name in TRUE:
        assert two[name] == pytest.approx(one[name], abs=2e-3 * one.parameter(name).std_error)


def test_samples_marked_missing_have_no_part_in_the_estimate():
    data = experiment(noise=0.01)
    mask = np.zeros(data.record.N, dtype=bool)
    mask[100:150] = True
    wild = np.where(mask, 1e3, data.record["position"])
    spoilt = replace(data.record, channels={**data.record.channels, "position": wild})
    a = casid.identify(problem(), casid.Experiment(spoilt.mark_missing("position", mask), {}, "r"))
    b = casid.identify(
        problem(), casid.Experiment(data.record.mark_missing("position", mask), {}, "r")
    )
    assert [a[n] for n in TRUE] == pytest.approx([b[n] for n in TRUE], rel=1e-9)


def test_a_known_value_of_one_record_is_used_there_and_not_estimated():
    e = experiment(m=3.0)
    fit = casid.identify(
        problem(oscillator(m=2.0)),
        casid.Experiment(e.record, {"m": 3.0}, "heavier"),
        settings=EXACT,
    )
    assert fit["k"] == pytest.approx(50.0, rel=1e-6)


def test_too_few_samples_for_the_unknowns_are_refused_with_the_mend():
    with pytest.raises(casid.DataError, match="too few for 5 unknowns.*widen the window"):
        casid.identify(problem(), experiment(N=5))


def test_a_missing_channel_is_refused_with_the_mapping_to_give():
    e = experiment()
    with pytest.raises(casid.DataError, match="--map position="):
        casid.identify(problem(), casid.Experiment(e.record.without("position"), {}, "r"))


def test_the_criterion_is_half_the_weighted_sum_of_squares():
    criterion = SimulationError(oscillator(), [experiment(noise=0.01)], weights=np.array([7.0]))
    x = criterion.start
    y, _, _ = criterion.simulate(x, 0)
    r = 7.0 * (criterion.data[0].y - y)
    assert criterion.evaluate(x).value == pytest.approx(0.5 * float(np.sum(r**2)), rel=1e-12)


def test_several_starts_agree_where_the_criterion_has_one_minimum():
    fit = minimize_simulation_error(
        SimulationError(oscillator(), [experiment(noise=0.01)]), starts=3, seed=3
    )
    assert fit.starts_tried == 3
    assert fit.starts_agreeing >= 2


# ---------------------------------------------------------------------- what is given


def test_a_model_alone_is_identified_as_a_problem_of_it() -> None:
    """And a diagnosis, which asks for more, says how to make one."""
    e = experiment(noise=1e-3)
    alone = casid.identify(oscillator(), e, settings=EXACT)
    whole = casid.identify(problem(), e, settings=EXACT)
    assert alone.problem == "mass on a spring"
    assert [alone[n] for n in TRUE] == [whole[n] for n in TRUE]
    record = casid.identify(oscillator(), e.record, settings=EXACT)
    assert record["k"] == whole["k"]
    with pytest.raises(
        casid.ModelError, match=r"model mass on a spring .*casid.Problem\(name, mod"
    ):
        casid.diagnose(oscillator(), e)  # type: ignore[arg-type]
    with pytest.raises(casid.ModelError, match=r"'m.py' is no problem; .*casid.load_problem\(path"):
        casid.identify("m.py", e)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("channel", "unit", "words"),
    [
        ("position", "rad", "'rad', but mass on a spring has it in 'm' (1 against m"),
        ("force", "m/s^2", "'m/s^2', but mass on a spring has it in 'N' (m/s^2 against kg m/s^2"),
    ],
)
def test_a_channel_of_another_dimension_is_refused(channel: str, unit: str, words: str) -> None:
    e = experiment(noise=1e-3)
    record = e.record
    wrong = replace(record, units={**record.units, channel: unit})
    with pytest.raises(casid.DataError, match=re.escape(words)) as refusal:
        casid.identify(problem(), wrong)
    mend = re.search(r"units=(\{.*\})\)", str(refusal.value))
    assert mend is not None
    assert f"channel {channel} " in str(refusal.value)
    mended = replace(wrong, units={**wrong.units, **eval(mend[1])})
    assert casid.identify(problem(), mended, settings=EXACT)["k"] == pytest.approx(50, rel=0.01)


def test_angles_are_numbers_but_cycles_are_no_radians() -> None:
    """rad/s and 1/s are one dimension; Hz, in which 2 pi hides, is refused as it is from a file."""
    m = casid.Model("coasting")
    p, d = m.state("p", "rad/s"), m.parameter("d", "1/s", start=0.5)
    m.derivative(p, -d * p)
    m.output("gyro", p, "rad/s")
    gyro = np.exp(-0.7 * 0.05 * np.arange(100))
    for unit in ("1/s", "rad/s"):
        record = casid.Record({"gyro": gyro}, {"gyro": unit}, Ts=0.05)
        assert casid.identify(m, record)["d"] == pytest.approx(0.7, rel=1e-4)
    with pytest.raises(casid.DataError, match=r"'Hz', but coasting has it in 'rad/s'.*true unit"):
        casid.identify(m, casid.Record({"gyro": gyro}, {"gyro": "Hz"}, Ts=0.05))


def test_an_initial_state_stays_near_the_motion_where_a_late_sensor_hides_it():
    """A first-order lag whose start has died out before the first sample that counts.

    The delay may be up to 2 s, ten time constants: what the record says of the initial state is
    noise, thousands of times as large.
    """
    m = casid.Model("lag")
    x, u = m.state("x", "m"), m.input("u", "m", hold="zoh")
    tau = m.parameter("tau", "s", start=0.3, lower=0.01)
    m.derivative(x, (u - x) / tau)
    m.output("y", x, "m")
    model = m.extend(time_delay(m, "y", 2.0))
    rng = np.random.default_rng(4)
    held = rng.standard_normal(20).repeat(20)
    y, path = np.zeros(400), 0.0
    for k in range(400):
        y[k] = path
        path = held[k] + (path - held[k]) * np.exp(-0.05 / 0.2)
    y = np.r_[np.zeros(6), y[:-6]] + 0.05 * rng.standard_normal(400)  # 0.3 s late
    record = casid.Record({"u": held, "y": y}, {"u": "m", "y": "m"}, Ts=0.05)
    fit = fit_model(model, [casid.Experiment(record)], casid.FitSettings(starts=1), throw=False)
    assert fit.values["delay_y"] == pytest.approx(0.3, abs=0.03)
    assert abs(fit.values["x(0)"]) < 3 * np.ptp(held)


def test_a_record_begins_in_what_a_late_sensor_shows_first_where_the_model_is_singular():
    """A magnet pulls with C i^2 / x^2: at x = 0, the declared start, it has no derivative."""
    m = casid.Model("levitated ball")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    i = m.input("i", "A", hold="zoh", known=True)
    C = m.parameter("C", "N m^2/A^2", value=8e-5)
    weight = m.constant("weight", 1.2, "N")
    m.derivative(x, v)
    m.balance(v, "force", inertia=m.constant("m", 0.12, "kg"), terms=[weight, -C * i**2 / x**2])
    m.output("gap", x, "m")
    N, gap = 60, 0.01
    columns = {"i": np.full(N, gap * np.sqrt(1.2 / 8e-5)), "gap": np.full(N, gap)}
    record = casid.Record(columns, {"i": "A", "gap": "m"}, Ts=1e-3, name="rest")
    slow = m.extend(sensor_lag(m, "gap", longest=0.015)).with_known(lag_gap=1e-3)
    criterion = SimulationError(slow, [casid.Experiment(record, {}, "rest")])
    assert not criterion.data[0].used[:5].any()  # they count for nothing in the fit
    assert criterion.start[criterion.names.index("x(0)")] == pytest.approx(gap)
    y, *_ = criterion.simulate(criterion.start, 0)
    assert y[-1, 0] == pytest.approx(gap, rel=1e-6)


def test_a_state_that_equations_divide_by_is_named_where_it_begins_at_zero():
    """A flow into a volume that nobody measures and that has no start: F / V is infinite."""
    m = casid.Model("fed tank")
    c, V = m.state("c", "kg/m^3", start=1.0), m.state("V", "m^3")
    F = m.input("F", "m^3/s", known=True)
    k = m.parameter("k", "1/s", start=0.1)
    m.derivative(c, -k * c - F / V * c)
    m.derivative(V, F)
    m.output("c", c, "kg/m^3")
    record = casid.Record(
        {"F": np.full(50, 0.01), "c": np.linspace(1, 0.5, 50)},
        {"F": "m^3/s", "c": "kg/m^3"},
        Ts=1.0,
    )
    with pytest.raises(casid.SolveError, match="V begins at 0") as caught:
        fit_model(m, [casid.Experiment(record)], FitSettings(starts=1), check_rank=False)
    assert 'm.state("V", ..., start=1.0)' in str(caught.value)


def test_a_state_whose_root_flows_out_is_named_where_it_begins_at_zero():
    """The root of an empty tank's level has a finite value and no finite slope: no fit begins."""
    m = casid.Model("outflow of a tank")
    h, q = m.state("h", "m"), m.input("q", "m^3/s", known=True)
    A = m.parameter("A", "m^2", start=2.0, lower=0.1, upper=10)
    C = m.constant("C", 0.01, "m^2.5/s")
    m.balance(h, "tank", inertia=A, terms=[q, -C * ca.sqrt(h)])
    m.output("outflow", C * ca.sqrt(h), "m^3/s")
    record = casid.Record(
        {"q": np.full(50, 0.01), "outflow": np.linspace(0.005, 0.008, 50)},
        {"q": "m^3/s", "outflow": "m^3/s"},
        Ts=1.0,
    )
    data = [casid.Experiment(record)]
    with pytest.raises(casid.SolveError, match="h begins at 0.*no finite slope") as caught:
        fit_model(m, data, FitSettings(starts=1))
    assert 'm.state("h", ..., start=1.0)' in str(caught.value)


def test_windows_are_as_even_as_whole_samples_allow_and_none_is_too_short():
    for n in range(1, 400):
        for window in range(1, 60):
            cuts = window_cuts(n, window)
            lengths = np.diff(cuts)
            assert cuts[0] == 0
            assert cuts[-1] == n
            assert np.ptp(lengths) <= 1
            assert lengths.min() >= min(window, n)
