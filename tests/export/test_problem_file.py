"""The fitted model as a problem file: it reads like one, and its fit is the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import casid
from casid.estimation.fitted.fitted_model import FittedModel
from casid.model.effects.balances.balance_effects import quadratic_damping
from casid.model.effects.balances.missing_parts import missing_mode
from casid.model.effects.balances.periodic import periodic_disturbance
from casid.model.effects.channels.channel_effects import sensor_bias, sensor_scale
from casid.model.effects.parameter_effects import parameter_drift, parameter_jump
from problems import emps, pendulum, roll_decay
from tests.support.fitted_models import (
    assert_same,
    extended_emps,
    extended_pendulum,
    extended_roll_decay,
    fitted_model,
)

ONE_START = casid.FitSettings(starts=1)


def reloaded(fitted: FittedModel, folder: Path) -> casid.Problem:
    """The problem of the file that a fitted model is written to."""
    return casid.load_problem(fitted.to_problem_file(folder / "problem.py"))


def simulate_both(fitted: FittedModel, problem: casid.Problem) -> tuple[np.ndarray, np.ndarray]:
    """Outputs of the fitted model, and of the problem's with the same values, under one input."""
    N, rng = 300, np.random.default_rng(8)
    recorded = [n for n, u in fitted.model.inputs.items() if u.kind != "generated"]
    inputs = {n: 0.1 * np.cumsum(rng.standard_normal(N)) for n in recorded} or N
    again = replace(fitted, model=problem.model.with_si_values(fitted.si_values))
    runs = [m.simulate(inputs, on_clock=True) for m in (fitted, again)]
    names = list(fitted.model.outputs)
    return tuple(np.column_stack([r[n] for n in names]) for r in runs)  # type: ignore[return-value]


@pytest.mark.parametrize("make", [extended_pendulum, extended_roll_decay, extended_emps])
def test_the_file_has_the_same_model(make: Callable[[], FittedModel], tmp_path: Path) -> None:
    fitted = make()
    problem = reloaded(fitted, tmp_path)
    free = {n for n, p in problem.model.parameters.items() if not p.is_known}
    assert free == set(fitted.covariance_names)
    starts = {n: p.start for n, p in problem.model.parameters.items()}
    assert {n: starts[n] for n in free} == {n: fitted.values[n] for n in free}
    assert_same(*simulate_both(fitted, problem), 1e-12)


def test_the_file_reads_as_a_person_writes_it(tmp_path: Path) -> None:
    lines = extended_pendulum().to_problem_file(tmp_path / "p.py").read_text().splitlines()
    for line in (
        '"""pendulum: the model with what a diagnosis found missing in example.',
        "- quadratic damping in the torque balance [quadratic_damping]: d_2",
        'phi = model.state("phi", "rad", start=0.01)',
        'I_x = model.parameter("I_x", "kg m^2", start=0.1385, lower=0.081, upper=2)'
        "  # std. error 0.001",
        "        -d_2 * ca.fabs(p) * p,  # quadratic damping in the torque balance, "
        "found by the diagnosis",
        'model.output("accel", z_s * model.der(p) + g * phi - a_y, "m/s^2")',
        'model = model.eliminate("a_y", using="accel")',
        '    channels={"gyro": "gyro:rad/s", "accel": "accel:m/s^2"},',
    ):
        assert line in lines
    assert max(map(len, lines)) <= 100


def test_the_fit_of_the_file_is_the_fit_that_it_was_written_from(tmp_path: Path) -> None:
    """To what the solver's tolerance leaves, a thousandth of the standard errors."""
    model = quadratic_damping(roll_decay.problem.model, "torque").extend(roll_decay.problem.model)
    record = roll_decay.simulate(duration=20.0)
    before = casid.identify(replace(roll_decay.problem, model=model), record, settings=ONE_START)
    assert before.model is not None
    problem = reloaded(before.model, tmp_path)
    after = casid.identify(problem, record, settings=ONE_START)
    for name in ("B_1", "C_1", "phi_0", "d_2"):
        p, q = before.parameter(name), after.parameter(name)
        assert p.std_error is not None
        assert abs(p.value - q.value) < 1e-3 * p.std_error
        assert q.std_error == pytest.approx(p.std_error, rel=1e-3)
    assert (problem.channels, problem.time) == (roll_decay.problem.channels, "t_s")


def test_what_happens_to_whole_columns_is_an_extension(tmp_path: Path) -> None:
    """Delays, lags, limits and holds of inputs and outputs; a bias and a scale are terms."""
    fitted = fitted_model(
        pendulum.problem,
        [
            lambda m: casid.time_delay(m, "gyro", 0.1),
            lambda m: casid.time_delay(m, "accel", 0.1),
            lambda m: casid.hold(m, "accel"),
            lambda m: sensor_bias(m, "accel"),
            lambda m: sensor_scale(m, "accel"),
        ],
        {
            "k": 10.4,
            "d": 0.1,
            "I_x": 0.14,
            "delay_gyro": 0.023,
            "delay_accel": 0.012,
            "ramp_accel": 0.3,
            "bias_accel": 0.1,
            "scale_accel": 0.05,
        },
        x0=(0.01, 0.02),
        Ts=0.01,
        N=300,
    )
    problem = reloaded(fitted, tmp_path)
    assert_same(*simulate_both(fitted, problem), 1e-10)
    text = (tmp_path / "problem.py").read_text()
    assert 'casid.time_delay(model, "gyro", longest=0.1)' in text
    assert "with_unknown(delay_gyro=0.023)" in text


def test_the_hold_of_an_output_that_takes_the_place_of_an_input_is_declared(tmp_path: Path) -> None:
    """As it was found by a diagnosis: band-limited, and nothing else."""
    fitted = fitted_model(
        pendulum.problem,
        [lambda m: casid.hold(m, "accel", "bandlimited")],
        {"k": 10.4, "d": 0.1, "I_x": 0.14, "smooth_accel": 1.0},
        x0=(0.01, 0.02),
        Ts=0.01,
        N=300,
    )
    problem = reloaded(fitted, tmp_path)
    assert fitted.model.acting_hold("accel") == problem.model.inputs["accel"].hold == "bandlimited"
    text = (tmp_path / "problem.py").read_text()
    assert 'model = model.eliminate("a_y", using="accel", hold="bandlimited")' in text
    assert "casid.hold" not in text


def test_actuators_parts_and_limits_are_written(tmp_path: Path) -> None:
    fitted = fitted_model(
        emps.problem,
        [
            lambda m: casid.actuator_lag(m, "force", 0.1),
            lambda m: missing_mode(m, "force", 30.0),
            lambda m: casid.sensor_lag(m, "q", 0.1),
            lambda m: casid.saturation(m, "q", 0.002),
        ],
        {"M": 95.0, "F_v": 200.0, "tau_force": 0.01, "J_m": 3.0, "omega_m": 30.0, "zeta_m": 0.05}
        | {"lag_q": 0.02, "limit_q": 0.001},
        x0=(0.0, 0.001, 0.0, 0.0),
        Ts=0.002,
        N=300,
    )
    problem = reloaded(fitted, tmp_path)
    assert set(problem.model.states) == {"q", "v", "q_m", "v_m"}
    assert_same(*simulate_both(fitted, problem), 1e-10)


def test_a_lag_that_several_commands_share_is_written_once(tmp_path: Path) -> None:
    m = casid.Model("lift")
    w, g = m.state("w", "m/s"), m.constant("g", 9.81, "m/s^2")
    thrusts = [m.input(n, "N", hold="zoh", known=True) for n in ("front", "rear")]
    drag = m.parameter("d", "N s/m", start=0.3)
    m.balance(w, "lift", inertia=1.2, terms=[*thrusts, -drag * w, -1.2 * g], unit="N")
    m.output("climb", w, "m/s")
    fitted = fitted_model(
        casid.Problem("lift", m),
        [lambda m: casid.actuator_lag(m, ["front", "rear"], 0.5)],
        {"d": 0.4, "tau_front_rear": 0.06},
        x0=(0.0,),
        Ts=0.02,
        N=300,
    )
    problem = reloaded(fitted, tmp_path)
    assert (tmp_path / "problem.py").read_text().count(
        'casid.actuator_lag(m, ["front", "rear"]'
    ) == 1
    assert_same(*simulate_both(fitted, problem), 1e-12)


def test_what_depends_on_the_clock_is_written(tmp_path: Path) -> None:
    fitted = fitted_model(
        pendulum.problem,
        [
            lambda m: parameter_jump(m, "k", 1.2345),
            lambda m: parameter_drift(m, "d", (0.0, 3.0)),
            lambda m: periodic_disturbance(m, "torque", 1.7, (0.0, 3.0)),
        ],
        {"k": 10.4, "d": 0.1, "I_x": 0.14, "jump_k": 1.5, "drift_d": 0.05}
        | {"a_cos": 0.02, "a_sin": -0.03, "frequency": 1.72},
        x0=(0.01, 0.02),
        Ts=0.01,
        N=300,
    )
    problem = reloaded(fitted, tmp_path)
    assert_same(*simulate_both(fitted, problem), 1e-12)
    assert "casid.StepAt(time=1.2345, is_held=True)" in (tmp_path / "problem.py").read_text()


def test_numbers_are_in_the_declared_units(tmp_path: Path) -> None:
    m = casid.Model("spring")
    x, v = m.state("x", "mm", start=2.0), m.state("v", "mm/s")
    k = m.parameter("k", "N/mm", start=3.0, lower=1.0, upper=9.0)
    M = m.constant("M", 500.0, "gram")
    T = m.parameter("T", "degC", value=20.0)
    alpha = m.parameter("alpha", "1/K", value=0.001)
    m.derivative(x, v)
    m.balance(v, "force", inertia=M, terms=[-k * (1 + alpha * T) * x])
    m.output("position", x, "mm")
    problem = casid.Problem("spring", m)
    fitted = fitted_model(problem, [], {"k": 2500.0}, x0=(0.003, 0.0), Ts=0.001, N=300)
    fitted = replace(fitted, model=m.with_si_values({"k": 2500.0}))
    text = fitted.to_problem_file(tmp_path / "problem.py").read_text()
    for line in (
        'x = m.state("x", "mm", start=3)',
        'k = m.parameter("k", "N/mm", start=2.5, lower=1, upper=9)  # std. error 1e-06',
        'M = m.constant("M", 500, "gram")',
        'T = m.parameter("T", "degC", value=20)',
    ):
        assert line in text.splitlines()
    again = casid.load_problem(tmp_path / "problem.py").model
    values = again.nominal_values
    values = again.in_declared_units(values)
    assert_allclose(list(values.values()), list(fitted.values.values()), rtol=1e-12)
    assert again.outputs["position"][1] == "m"
    assert again.unit_of("position") == "mm"


def test_load_cases_come_from_the_records(tmp_path: Path) -> None:
    fitted = extended_pendulum()
    records = [
        replace(fitted.records[0], name=f"{case}:{case}.csv", known={"m": mass})
        for case, mass in (("nominal", 0.0), ("loaded", 0.2))
    ]
    problem = reloaded(replace(fitted, records=tuple(records)), tmp_path)
    assert {k: dict(v) for k, v in problem.load_cases.items()} == {
        "nominal": {"m": 0.0},
        "loaded": {"m": 0.2},
    }


def test_a_function_of_the_users_own_is_refused(tmp_path: Path) -> None:
    m = casid.Model("driven")
    x = m.state("x", "m")
    w = m.generated_input("wind", "m/s", np.sin)
    m.derivative(x, w - m.parameter("a", "1/s") * x)
    m.output("x_measured", x, "m")
    fitted = fitted_model(casid.Problem("driven", m), [], {"a": 1.0}, x0=(0.0,), Ts=0.1, N=50)
    with pytest.raises(casid.ModelError, match=r"'wind' is a Python function.*casid.StepAt"):
        fitted.to_problem_file(tmp_path / "problem.py")


def test_a_problem_file_that_may_be_written_by_hand_is_not_written_over_unasked(
    tmp_path: Path,
) -> None:
    path = tmp_path / "pendulum.py"
    path.write_text("# by hand\n")
    with pytest.raises(casid.DataError, match=r"pendulum.py exists; .*force=True"):
        extended_pendulum().to_problem_file(path)
    assert path.read_text() == "# by hand\n"
    assert casid.load_problem(extended_pendulum().to_problem_file(path, force=True)).name
