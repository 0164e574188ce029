"""An acceleration that is written as forces responds to forces that are missing, too."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid.model.written_accelerations import with_written_accelerations


def sledge(output, *, unit="m/s^2"):
    """A mass on a spring under gravity; `output` makes its sensor's expression of the symbols."""
    m = casid.Model("sledge")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    u = m.input("u", "N", hold="zoh", known=True)
    M, g = m.constant("M", 2.0, "kg"), m.constant("g", 9.81, "m/s^2")
    k = m.parameter("k", "N/m", start=40.0, lower=0.0)
    d = m.parameter("d", "N s/m", start=1.0, lower=0.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=M, terms=[u, -k * x, -d * v, -M * g])
    m.output("a", output(m, x, v, u, M, g, k, d), unit)
    return m


def difference(one, other) -> float:
    """The largest difference of two models' outputs at random points."""
    a, b = one.explicit(), other.explicit()
    f = ca.Function("f", [a.x, a.u, a.p], [a.h - b.h])
    rng, worst = np.random.default_rng(1), 0.0
    for _ in range(5):
        x, u, p = (rng.uniform(0.5, 2.0, s.numel()) for s in (a.x, a.u, a.p))
        worst = max(worst, abs(float(f(x, u, p))))
    return worst


@pytest.mark.parametrize(
    ("output", "rest"),
    [
        (lambda m, x, v, u, M, g, k, d: (u - k * x - d * v) / M, "g"),
        (lambda m, x, v, u, M, g, k, d: (d * v - u + k * x) / M, "g"),
        (lambda m, x, v, u, M, g, k, d: (u - k * x - d * v) / M - g, ""),
        (lambda m, x, v, u, M, g, k, d: (u - k * x - d * v) / M + 3 * g, "g"),
    ],
)
def test_all_forces_over_the_mass_are_the_derivative_and_a_rest(output, rest):
    m = sledge(output)
    new, found = with_written_accelerations(m)
    assert found == {"a": "force"}
    expression = new.outputs["a"][0]
    assert ca.which_depends(expression, m.der(m.symbol("v")))[0]
    assert ("g" in str(expression)) == bool(rest)
    assert difference(m, new) < 1e-9


@pytest.mark.parametrize(
    ("output", "unit"),
    [
        (lambda m, x, v, u, M, g, k, d: (u - k * x) / M, "m/s^2"),  # not the damper's force
        (lambda m, x, v, u, M, g, k, d: m.der(v) + g, "m/s^2"),  # as it should be
        (lambda m, x, v, u, M, g, k, d: u - k * x - d * v, "N"),  # a load cell
        (lambda m, x, v, u, M, g, k, d: u / M, "m/s^2"),
    ],
)
def test_other_outputs_stay_as_they_are(output, unit):
    m = sledge(output, unit=unit)
    assert with_written_accelerations(m) == (m, {})


@pytest.mark.slow
def test_a_missing_force_is_found_where_the_accelerometer_is_written_as_forces():
    """A side wind from 10 s on a car: its force reaches the accelerometer, and is no other's."""
    m = casid.Model("side wind")
    v, u = m.state("v", "m/s"), m.input("u", "N", hold="zoh", known=True)
    c = m.parameter("c", "N s/m", start=300.0, lower=0.0)
    M = m.constant("M", 1000.0, "kg")
    m.balance(v, "side", inertia=M, terms=[u, -c * v])
    m.output("speed", v, "m/s")
    m.output("acc", (u - c * v) / M, "m/s^2")
    rng = np.random.default_rng(2)
    N, Ts = 400, 0.05
    push = 300.0 * np.repeat(rng.choice([-1.0, 1.0], N // 10), 10)
    speed, acc, now = np.zeros(N), np.zeros(N), 0.0
    for i in range(N):
        force = push[i] + (120.0 if i >= 200 else 0.0)
        speed[i], acc[i] = now, (force - 400.0 * now) / 1000.0
        now += (force / 400.0 - now) * (1 - np.exp(-0.4 * Ts))
    channels = {
        "u": push,
        "speed": speed + 0.02 * rng.standard_normal(N),
        "acc": acc + 0.03 * rng.standard_normal(N),
    }
    record = casid.Record(channels, {"u": "N", "speed": "m/s", "acc": "m/s^2"}, Ts)
    d = casid.diagnose(casid.Problem("side wind", m), record, starts=1, max_causes=1, advise=False)
    assert [(c.kind, c.where) for c in d.causes] == [("offset", "side")]
    size = d.causes[0].parameters[0]
    assert abs(size.value - 120.0) < 3 * size.std_error
    assert "acc is written as the known forces of the side balance" in " ".join(d.notes)
