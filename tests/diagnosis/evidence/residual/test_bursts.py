"""A jump that stirs up a motion for a moment only is found at its own instant."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.diagnosis.evidence.residual.bursts import burst

TS, N, JUMP = 0.02, 700, 11.3
T = TS * np.arange(N)
OTHERS = (
    "hold time_delay sensor_lag sensor_scale sensor_bias saturation rectified missing_mode offset "
    "periodic_disturbance cogging deadzone backlash end_stop coulomb_friction stribeck_friction "
    "asymmetric_friction cubic_stiffness quadratic_stiffness cubic_damping quadratic_damping "
    "actuator_lag actuator_saturation unknown cross_axis parameter_drift scheduled_parameter"
).split()


def noise(seed: int, n: int = N) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(n) ** 2


def test_a_burst_begins_where_the_misfit_does():
    power = noise(1)
    power[300:320] += 60.0
    assert burst([power], [T])[0] == pytest.approx(T[300])


def test_a_burst_ends_where_the_misfit_does():
    power = noise(1)
    power[300:320] += 60.0
    assert burst([power], [T])[1] == pytest.approx(T[320])


def test_a_burst_that_lasts_to_the_end_of_a_record_has_none_of_its_own():
    power = noise(1)
    power[-20:] += 60.0
    assert burst([power], [T]) == pytest.approx([T[-20]])


def test_of_several_records_the_strongest_burst_counts_by_its_own_clock():
    weak, strong = noise(1), noise(2)
    weak[100:110] += 60.0
    strong[200:220] += 60.0
    assert burst([weak, strong], [T, T + 100.0])[0] == pytest.approx(104.0)


@pytest.mark.parametrize("seed", range(5))
def test_noise_has_no_burst(seed):
    assert not burst([noise(seed, 300)], [T[:300]])


def test_a_misfit_all_the_time_has_no_burst():
    assert not burst([noise(1) + 40 * np.sin(3 * T) ** 2], [T])


def test_what_the_initial_state_leaves_is_no_event():
    power = noise(1)
    power[:20] += 60.0
    assert not burst([power], [T])


def loaded_spring() -> tuple[casid.Problem, casid.Record]:
    """A load on a spring whose stiffness falls by a fifth: the load stays, the mass rings."""
    m = casid.Model("loaded spring")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold="zoh", known=True)
    K = m.parameter("K", "N/m", start=130.0, lower=10.0, upper=1000.0)
    c = m.parameter("c", "N s/m", start=5.0, lower=0.0, upper=100.0)
    M = m.parameter("M", "kg", start=1.2, lower=0.1, upper=10.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=M, terms=[F, -K * x, -c * v])
    m.output("load", K * x, "N")
    m.output("v", v, "m/s")
    rng = np.random.default_rng(1)
    F = np.repeat(rng.uniform(20.0, 40.0, N // 50), 50)
    state, rows = np.array([F[0] / 150, 0.0]), []
    for t, force in zip(T, F, strict=True):
        K = 150.0 if t < JUMP else 120.0
        rows.append((K * state[0], state[1]))
        A = np.array([[0.0, 1.0, 0.0], [-K, -5.0, force], [0.0, 0.0, 0.0]])
        state = (expm(A * TS) @ [*state, 1.0])[:2]
    load, speed = (np.array(rows) + rng.standard_normal((N, 2)) * [0.3, 0.02]).T
    record = casid.Record(
        {"F": F, "load": load, "v": speed}, {"F": "N", "load": "N", "v": "m/s"}, Ts=TS, name="run"
    )
    return casid.Problem("loaded spring", m, starts=1), record


@pytest.mark.slow
def test_a_stiffness_that_jumps_between_the_instants_of_a_coarse_search_is_found():
    problem, record = loaded_spring()
    d = casid.diagnose(problem, record, hold_out=0, max_causes=1, advise=False, without=OTHERS)
    (cause,) = d.causes
    assert (cause.kind, cause.where) == ("parameter_jump", "K")
    found = {p.name: p for p in cause.parameters}
    assert found["time"].value == pytest.approx(JUMP, abs=2 * TS)
    assert found["jump_K"].value == pytest.approx(-30.0, abs=3 * found["jump_K"].std_error)
