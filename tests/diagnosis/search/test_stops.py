"""The position of a stop is one that can be measured, in the coordinate of the model."""

from __future__ import annotations

import numpy as np
import pytest

import casid

TS, N, MASS, DAMPING, STIFFNESS, STOP = 0.05, 1000, 2.0, 0.8, 9.0, 40.0  # SI


def slide() -> casid.Problem:
    """A sprung slide that is driven; nothing limits its motion."""
    m = casid.Model("slide")
    F = m.input("F", "N", known=True)
    x, v = m.state("x", "m"), m.state("v", "m/s")
    mass = m.parameter("m", "kg", start=1.5, lower=0.1, upper=20.0)
    d = m.parameter("d", "N s/m", start=0.5, lower=0.0, upper=20.0)
    k = m.constant("k", STIFFNESS, "N/m")
    m.derivative(x, v)
    m.balance(v, "slide", inertia=mass, terms=[F, -d * v, -k * x])
    m.output("position", x, "m")
    return casid.Problem("slide", m)


def record(lower: float, upper: float) -> casid.Record:
    """Runge-Kutta with a tenth of the sample time; soft stops at both positions."""
    rng, h = np.random.default_rng(0), TS / 10
    t = np.arange(N) * TS
    w, phase = np.linspace(0.5, 6.0, 25), rng.uniform(0, 2 * np.pi, 25)
    F = 0.7 * np.cos(np.outer(t, w) + phase).sum(axis=1)

    def slope(s: np.ndarray, force: float) -> np.ndarray:
        stop = STOP * (max(lower - s[0], 0.0) - max(s[0] - upper, 0.0))
        return np.array([s[1], (force - DAMPING * s[1] - STIFFNESS * s[0] + stop) / MASS])

    s, x = np.zeros(2), np.empty(N)
    for k in range(N):
        x[k] = s[0]
        for j in range(10):
            f = [np.interp(t[k] + (j + c) * h, t, F) for c in (0.0, 0.5, 1.0)]
            k1 = slope(s, f[0])
            k2 = slope(s + 0.5 * h * k1, f[1])
            k3 = slope(s + 0.5 * h * k2, f[1])
            k4 = slope(s + h * k3, f[2])
            s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    x = x + 0.003 * rng.standard_normal(N)
    return casid.Record({"F": F, "position": x}, {"F": "N", "position": "m"}, Ts=TS)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stops", "says"),
    [
        ({"limit": 0.08}, "where x is above limit"),  # passed over nearly half of the motion
        ({"limit_lower": -0.3, "limit_upper": 0.45}, "where x is below limit_lower or above"),
    ],
)
def test_a_stop_is_found_at_its_position(stops: dict[str, float], says: str) -> None:
    lower, upper = stops.get("limit_lower", -np.inf), stops.get("limit_upper", stops.get("limit"))
    assert upper is not None
    found = casid.diagnose(slide(), record(lower, upper), advise=False)
    assert [(c.kind, c.where) for c in found.causes] == [("end_stop", "slide")]
    cause = found.causes[0]
    assert says in cause.description
    sizes = {p.name: p for p in cause.parameters}
    for name, true in {"k_stop": STOP, **stops}.items():
        error = sizes[name].std_error
        assert error is not None
        assert sizes[name].value == pytest.approx(true, abs=3 * error), name
