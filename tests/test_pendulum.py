"""The pendulum of chapter 7: its direct and indirect models, its references, its experiments."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from casid.dimensions import check_units
from problems import pendulum
from problems.pendulum import TABLE_7_2

VALUES = {key: TABLE_7_2[key] for key in ("k", "d", "I_x")}


def functions(model):
    """x, u, all parameters by name -> dx/dt and outputs."""
    e = model.explicit()
    call = ca.Function("m", [e.x, e.u, e.p], [e.f, e.h])

    def at(x, u, **values):
        p = [values.get(n, model.parameters[n].value) for n in e.parameters]
        return tuple(np.array(v).ravel() for v in call(x, u, p))

    return at


def drawn(rng):
    """Every parameter of the model, away from its nominal value."""
    nominal = {**TABLE_7_2, "I_xm": 0.01, "g": 9.81}
    return {key: value * rng.uniform(0.7, 1.3) for key, value in nominal.items()}


@pytest.mark.parametrize("make", [pendulum.linear_model, pendulum.nonlinear_model])
def test_the_units_of_the_direct_models_agree(make):
    check_units(make())


def test_the_linear_model_is_the_state_space_of_the_thesis():
    """(7.16), entry by entry, at random values of all ten parameters."""
    rng = np.random.default_rng(1)
    at = functions(pendulum.linear_model())
    for _ in range(5):
        v = drawn(rng)
        S = v["M"] * v["z_g"] + v["m"] * v["z_m"]
        I_1 = v["I_x"] + v["M"] * v["z_g"] ** 2 + v["I_xm"] + v["m"] * v["z_m"] ** 2
        It_1, spring = I_1 / v["z_s"], v["k"] + S * v["g"]
        A = [[0, 1], [-spring / I_1, -v["d"] / I_1]]
        C = [[0, 1], [-spring / It_1 + v["g"], -v["d"] / It_1]]
        columns = [at(x, [0.0], **v) for x in ([1.0, 0.0], [0.0, 1.0])]
        f_u, h_u = at([0.0, 0.0], [1.0], **v)
        np.testing.assert_allclose(np.array([f for f, _ in columns]).T, A, rtol=1e-12)
        np.testing.assert_allclose(np.array([h for _, h in columns]).T, C, rtol=1e-12)
        np.testing.assert_allclose(f_u, [0, S / I_1], rtol=1e-12)
        np.testing.assert_allclose(h_u, [0, (S - It_1) / It_1], rtol=1e-12, atol=1e-15)


def test_the_nonlinear_model_is_newtons_and_the_linear_one_its_tangent_at_rest():
    """(7.9) and (7.14) at large angles; (7.10) is the Jacobian at phi = phi' = a_y = 0."""
    rng = np.random.default_rng(2)
    large, small = functions(pendulum.nonlinear_model()), functions(pendulum.linear_model())
    for _ in range(5):
        v = drawn(rng)
        S = v["M"] * v["z_g"] + v["m"] * v["z_m"]
        I_1 = v["I_x"] + v["M"] * v["z_g"] ** 2 + v["I_xm"] + v["m"] * v["z_m"] ** 2
        phi, p, a_y = rng.uniform(-1.5, 1.5), *rng.standard_normal(2)
        across = v["g"] * np.sin(phi) - a_y * np.cos(phi)  # along the sensor's axis
        p_dot = (-v["k"] * phi - v["d"] * p - S * across) / I_1
        f, h = large([phi, p], [a_y], **v)
        np.testing.assert_allclose(f, [p, p_dot], rtol=1e-12)
        np.testing.assert_allclose(h, [p, v["z_s"] * p_dot + across], rtol=1e-12)
        step = 1e-5
        for i in range(3):
            e = step * np.eye(3)[i]
            ahead, behind = large(e[:2], e[2:], **v), large(-e[:2], -e[2:], **v)
            linear = small(np.eye(3)[i][:2], np.eye(3)[i][2:], **v)
            for up, down, slope in zip(ahead, behind, linear, strict=True):
                # central difference: step^2 / 6 times third derivatives of order S g / I_1
                np.testing.assert_allclose((up - down) / (2 * step), slope, atol=1e-8)


def test_both_direct_models_leave_the_same_indirect_model():
    """(7.24) is exact at any angle: sin(phi) and cos(phi) a_y leave together with a_y."""
    rng = np.random.default_rng(3)
    from_large = functions(pendulum.nonlinear_model().eliminate("a_y", using="accel"))
    indirect = functions(pendulum.indirect_model())
    for _ in range(5):
        v, x, a_s = drawn(rng), rng.uniform(-1.4, 1.4, 2), rng.standard_normal(1)
        np.testing.assert_allclose(from_large(x, a_s, **v)[0], indirect(x, a_s, **v)[0], rtol=1e-9)


def test_a_later_stage_can_seek_the_load_within_physical_bounds():
    model = pendulum.indirect_model().with_unknown(m=0.1, z_m=-0.3)
    model = model.with_known(k=TABLE_7_2["k"], d=TABLE_7_2["d"], I_x=TABLE_7_2["I_x"])
    free = {n: p for n, p in model.parameters.items() if not p.is_known}
    assert {n: (p.lower, p.start, p.upper) for n, p in free.items()} == {
        "m": (0.0, 0.1, 5.0),
        "z_m": (-2.0, -0.3, 0.0),
    }


def test_a_telegraph_has_the_covariance_of_a_poisson_switch():
    """E[r(t) r(t + tau)] = A^2 exp(-2 |tau| / hold): an even number of switches returns the sign.

    Averages over 2e5 s with a correlation time of 0.5 s: sd (2 * 0.5 / 2e5)^(1/2) = 0.0022 A^2 at
    most; four of them are allowed.
    """
    Ts, N, A = 0.1, 2_000_000, 0.3
    r = pendulum.telegraph(N, Ts, amplitude=A, hold=1.0, rng=np.random.default_rng(4))
    assert set(np.unique(r)) == {-A, A}
    assert abs(r.mean()) < 4 * 0.0022 * A
    for lag in (1, 5, 20):
        covariance = np.mean(r[lag:] * r[:-lag])
        expected = A**2 * np.exp(-2 * lag * Ts)
        assert covariance == pytest.approx(expected, abs=4 * 0.0022 * A**2)


def test_a_load_case_tells_what_is_known_and_its_mass_acts():
    """At a constant a_y the pendulum leans by phi = S a_y / (k + S g), to second order in phi."""
    plain, loaded = pendulum.experiments(duration=2.0)
    assert (dict(plain.known), dict(loaded.known)) == ({"m": 0.0}, {})
    assert dict(pendulum.experiments(duration=2.0, load_known=True)[1].known) == {"m": 0.2}
    a_y = 0.1
    for mass in (0.0, 0.2):
        record = pendulum.simulate(ref=np.full(4000, a_y), m=mass, d=2.0, noise=0.0)
        S = TABLE_7_2["M"] * TABLE_7_2["z_g"] + mass * TABLE_7_2["z_m"]
        phi = S * a_y / (TABLE_7_2["k"] + S * 9.81)
        accel = 9.81 * np.sin(phi) - a_y * np.cos(phi)  # at rest: z_s phi'' = 0
        # At rest (7.9) reads k phi = S (a_y cos(phi) - g sin(phi)): relative error phi^2.
        assert abs(record["gyro"][-1]) < 1e-8
        assert record["accel"][-1] == pytest.approx(accel, rel=3 * phi**2 + 1e-6)


def test_experiments_are_the_same_for_the_same_seed_and_differ_between_load_cases():
    first, again = (pendulum.experiments(duration=3.0, seed=5) for _ in range(2))
    other = pendulum.experiments(duration=3.0, seed=6)
    for a, b, c in zip(first, again, other, strict=True):
        np.testing.assert_array_equal(a.record["gyro"], b.record["gyro"])
        assert np.abs(a.record["gyro"] - c.record["gyro"]).max() > 1e-3
    assert np.abs(first[0].record["gyro"] - first[1].record["gyro"]).max() > 1e-3
