"""A law stated as a rate of change is a balance, which effects enter; a definition is none."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid
from casid.model.effects.balances.balance_effects import offset
from casid.model.rate_laws import with_balances
from casid.model.units import same_dimension


def swing(*, stated: str) -> casid.Model:
    """A mass on a spring, its law stated as a rate or as a balance."""
    m = casid.Model("swing")
    x, v, F = m.state("x", "m"), m.state("v", "m/s"), m.input("F", "N", known=True)
    total, mass = m.state("total", "m s", initial=0.0), m.constant("mass", 2.0, "kg")
    k = m.parameter("k", "N/m", start=40.0, lower=1.0, upper=500.0)
    d = m.parameter("d", "N s/m", start=1.0, lower=0.0, upper=50.0)
    m.derivative(x, v)
    m.derivative(total, x)
    if stated == "rate":
        m.derivative(v, F / mass - (k / mass) * x - (d / mass) * v)
    else:
        m.balance(v, "v", inertia=mass, terms=[F, -k * x, -d * v])
    m.output("x", x, "m")
    return m


def test_the_law_is_a_balance_and_positions_and_integrals_are_not():
    m = with_balances(swing(stated="rate"))
    assert list(m.balances) == ["v"]
    assert m.position_of("v") == "x"
    assert len(m.balances["v"].terms) == 3
    assert same_dimension(m.balances["v"].unit, "m/s^2")


@pytest.mark.parametrize(
    ("of", "coefficient", "other", "shown"),
    [
        ("degC", "1/h", "1", "degC/h"),
        ("mm", "1/day", "mm/day", "mm/day"),
        ("mm", "1/s", "mm/s", "m/s"),
        ("mm", "1/h", "mm/s", "m/s"),
    ],
)
def test_a_law_is_shown_in_the_unit_of_time_of_its_parameters(
    of: str, coefficient: str, other: str, shown: str
) -> None:
    m = casid.Model("store")
    z, k = m.state("z", of), m.parameter("k", coefficient, start=0.1)
    m.derivative(z, -k * z + (m.parameter("f", other) if other != "1" else 0.0))
    m.output("z_m", z, of)
    balanced = with_balances(m)
    assert balanced.balances["z"].shown_unit == shown
    extended, (name,) = offset(balanced, "z").extended(balanced)
    assert extended.unit_of(name) == shown


def test_the_equations_are_the_same_and_the_model_given_is_left_alone():
    stated = swing(stated="rate")
    m = with_balances(stated)
    assert not stated.balances
    e, f = stated.explicit(), m.explicit()
    rng = np.random.default_rng(1)
    at = [rng.uniform(0.5, 2.0, n.numel()) for n in (e.x, e.u, e.p)]
    rates = [ca.Function("f", [s.x, s.u, s.p], [s.f])(*at).full() for s in (e, f)]
    assert rates[0] == pytest.approx(rates[1], rel=1e-14)


def test_a_model_without_a_law_that_is_estimated_is_returned_as_it_is():
    m = casid.Model("integral")
    x, u = m.state("x", "1"), m.input("u", "1/s", known=True)
    m.derivative(x, u)
    m.output("y", m.parameter("gain", "1", start=1.0) * x, "1")
    assert with_balances(m) is m


@pytest.mark.slow
def test_a_cause_is_named_alike_in_a_law_stated_either_way():
    """Drag of 0.8 N s^2/m^2 on 2 kg: 0.4 /m in a law of the acceleration."""
    Ts, N = 0.05, 600
    rng = np.random.default_rng(5)
    F = np.repeat(rng.uniform(-20, 20, N // 15), 15)
    z, x = np.zeros(2), np.empty(N)

    def rate(_t, s, force=0.0):
        return [s[1], (force - 50.0 * s[0] - 1.5 * s[1] - 0.8 * abs(s[1]) * s[1]) / 2.0]

    for k in range(N):
        x[k] = z[0]
        line = (F[k], F[min(k + 1, N - 1)] - F[k])
        z = solve_ivp(
            lambda t, s, line=line: rate(t, s, line[0] + line[1] * t / Ts),
            (0, Ts),
            z,
            rtol=1e-9,
            atol=1e-12,
        ).y[:, -1]
    x += 0.002 * rng.standard_normal(N)
    record = casid.Record({"F": F, "x": x}, {"F": "N", "x": "m"}, Ts=Ts)
    for stated, size in (("rate", 0.4), ("balance", 0.8)):
        problem = casid.Problem("swing", swing(stated=stated))
        found = casid.diagnose(problem, record, starts=1, advise=False).causes
        assert [(c.kind, c.where) for c in found] == [("quadratic_damping", "v")]
        d_2 = found[0].parameters[0]
        assert abs(d_2.value - size) < 4 * d_2.std_error
