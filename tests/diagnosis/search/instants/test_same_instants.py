"""What acts between two bodies at an instant: a push, a coupling that slips."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.model.effects.clock_effects import clock_effects_of, offset_step
from casid.model.effects.places.place import is_zero
from casid.model.effects.places.places import places_of

TS, N = 0.02, 1500
M1, M2, K, D, GROUND, LOSS = 1.0, 0.7, 60.0, 0.4, 40.0, 0.6  # SI
NOISE = 4e-4  # m
REST = (
    "hold time_delay actuator_lag sensor_lag scheduled_parameter periodic_disturbance "
    "quadratic_damping cubic_damping unknown end_stop saturation outliers actuator_saturation "
    "rectified backlash deadzone cross_axis parameter_drift extra_input coulomb_friction "
    "asymmetric_friction stribeck_friction missing_mode"
).split()


def carriage() -> casid.Problem:
    """A carriage on a spring and a load that a coupling joins to it; both positions measured."""
    m = casid.Model("carriage")
    x1, x2 = m.state("x1", "m"), m.state("x2", "m")
    v1, v2 = m.state("v1", "m/s"), m.state("v2", "m/s")
    u = m.input("u", "N", hold="zoh", known=True)
    m1, m2 = m.constant("m1", M1, "kg"), m.constant("m2", M2, "kg")
    k, c = m.parameter("k", "N/m", start=50.0), m.parameter("c", "N/m", start=50.0)
    d, b = m.parameter("d", "N s/m", start=0.5), m.parameter("b", "N s/m", start=0.5)
    m.derivative(x1, v1)
    m.derivative(x2, v2)
    m.balance(v1, "frame", inertia=m1, terms=[u, -c * x1, -b * v1, -k * (x1 - x2), -d * (v1 - v2)])
    m.balance(v2, "load", inertia=m2, terms=[k * (x1 - x2), d * (v1 - v2)])
    m.output("left", x1, "m")
    m.output("right", x2, "m")
    return casid.Problem("carriage", m)


def record(push: np.ndarray, seed: int = 3) -> casid.Record:
    """Sampled exactly: the input and the push between the two (N,) hold within each sample."""
    A = np.array(
        [
            [0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [-(GROUND + K) / M1, K / M1, -(LOSS + D) / M1, D / M1],
            [K / M2, -K / M2, D / M2, -D / M2],
        ]
    )
    B = np.array([[0.0, 0.0], [0.0, 0.0], [1 / M1, 1 / M1], [0.0, -1 / M2]])
    held = expm(np.block([[A, B], [np.zeros((2, 6))]]) * TS)
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-2.0, 2.0, N // 25), 25)
    x = np.zeros((N, 4))
    for i in range(N - 1):
        x[i + 1] = held[:4, :4] @ x[i] + held[:4, 4:] @ [u[i], push[i]]
    y = x[:, :2] + NOISE * rng.standard_normal((N, 2))
    units = {"u": "N", "left": "m", "right": "m"}
    return casid.Record({"u": u, "left": y[:, 0], "right": y[:, 1]}, units, Ts=TS)


def test_a_force_that_sets_in_between_two_bodies_acts_in_both_balances():
    model = carriage().model
    effect = offset_step(model, "v1-v2", 4.0, 5.0)
    assert "acts on x1-x2 between frame and load for a while" in effect.description
    wide = effect.extend(model)
    F_0 = wide.symbol("F_0")
    slopes = [ca.jacobian(wide.balances[n].total, F_0) for n in ("frame", "load")]
    assert is_zero(slopes[0] + slopes[1])
    assert not is_zero(slopes[0])


def test_forces_set_in_in_every_balance_and_between_the_bodies():
    model = carriage().model
    elements = [p for p in places_of(model) if p.is_relative]
    found = clock_effects_of(model, (0.0, 30.0), elements=elements)
    assert {e.where for e in found if e.kind == "offset"} == {"frame", "load", "v1-v2"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("begin", "end", "force"), [(12.0, 12.26, 1.5), (9.0, None, 0.4)], ids=["push", "slip"]
)
def test_what_sets_in_between_two_bodies_is_named_there(begin, end, force):
    """A coupling of stiffness k that slips by s pushes with k s from then on."""
    t = np.arange(N) * TS
    push = force * ((t >= begin - 1e-9) & (t < (end or np.inf) - 1e-9))
    found = casid.diagnose(carriage(), record(push), starts=1, advise=False, without=REST)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("offset", "v1-v2")
    size = cause.parameters[0]
    assert abs(size.value - force) < 4 * size.std_error
