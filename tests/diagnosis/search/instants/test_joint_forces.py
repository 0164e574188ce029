"""A gust acts at one point of a body: one force, which pushes and turns it."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid.model.effects.clock_effects import at_instant, joint_offset_step

TS, N, BEGIN, END, FORCE, ARM = 0.05, 1000, 10.0, 17.0, 0.4, 0.6  # SI
M, J, A, D = 2.0, 1.0, 3.0, 1.0  # mass, inertia, damping of drift and turn
REST = (
    "sensor_scale hold time_delay actuator_lag sensor_lag missing_mode scheduled_parameter "
    "periodic_disturbance quadratic_damping cubic_damping unknown end_stop saturation outliers "
    "actuator_saturation rectified backlash deadzone cross_axis parameter_drift extra_input "
    "coulomb_friction asymmetric_friction stribeck_friction sensor_bias"
).split()


def hull() -> casid.Problem:
    """A body that drifts and turns, steered by a rudder astern."""
    m = casid.Model("hull")
    v, r = m.state("v", "m/s"), m.state("r", "rad/s")
    u = m.input("u", "N", hold="zoh", known=True)
    arm, mass, inertia = (
        m.constant(*c) for c in (("arm", 1.5, "m"), ("m", M, "kg"), ("J", J, "kg m^2"))
    )
    a = m.parameter("a", "N s/m", start=2.0, lower=0.0)
    d = m.parameter("d", "N m s/rad", start=0.5, lower=0.0)
    m.balance(v, "drift", inertia=mass, terms=[u, -a * v])
    m.balance(r, "turn", inertia=inertia, terms=[-arm * u, -d * r])
    m.output("speed", v, "m/s")
    m.output("gyro", r, "rad/s")
    return casid.Problem("hull", m)


def record() -> casid.Record:
    """Sampled exactly: force and moment are constant within each sample."""
    rng = np.random.default_rng(8)
    u = np.repeat(rng.uniform(-1.0, 1.0, N // 20), 20)
    gust = FORCE * ((np.arange(N) * TS >= BEGIN - 1e-9) & (np.arange(N) * TS < END - 1e-9))
    v, r = np.zeros(N), np.zeros(N)
    for k in range(N - 1):
        for x, push, c, inertia in (
            (v, u[k] + gust[k], A, M),
            (r, -1.5 * u[k] + ARM * gust[k], D, J),
        ):
            x[k + 1] = push / c + (x[k] - push / c) * np.exp(-c / inertia * TS)
    v, r = (x + 2e-3 * rng.standard_normal(N) for x in (v, r))
    units = {"u": "N", "speed": "m/s", "gyro": "rad/s"}
    return casid.Record({"u": u, "speed": v, "gyro": r}, units, Ts=TS)


@pytest.mark.slow
def test_a_gust_is_one_force_in_two_balances():
    """Force, lever arm and both instants, within four standard errors."""
    (cause,) = casid.diagnose(hull(), record(), starts=1, advise=False, without=REST).causes
    assert (cause.kind, cause.where) == ("offset", "drift and turn")
    sizes = {p.name: p for p in cause.parameters}
    for name, true in (("F_0", FORCE), ("ratio_turn", ARM), ("time", BEGIN), ("end", END)):
        p = sizes[name]
        assert abs(p.value - true) < 4 * p.std_error


@pytest.mark.parametrize("end", [None, END])
def test_one_force_gives_the_second_balance_its_lever_arm(end: float | None):
    model = hull().model
    effect = at_instant(joint_offset_step(model, ("drift", "turn"), ARM, 3.0, end), model, 2.0, end)
    assert effect.constants["time"] == 2.0
    new = effect.extend(model, starts={"F_0": FORCE})
    casid.Problem("hull with a gust", new)  # its units agree
    added = [new.balances[name].terms[-1] for name in ("drift", "turn")]
    symbols = ca.symvar(ca.vertcat(*added))
    steps = [n for n in new.inputs if n not in model.inputs]
    values = {"F_0": FORCE, "ratio_turn": ARM} | {n: float(i == 0) for i, n in enumerate(steps)}
    forces = ca.Function("f", symbols, added)(*[values[s.name()] for s in symbols])
    assert [float(f) for f in forces] == pytest.approx([FORCE, ARM * FORCE])
