"""The pendulum of chapter 7: its direct and indirect models, its references, its experiments."""

from __future__ import annotations

import pickle

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

import casid
from analysis.pendulum_study.records import BlockFilter, PendulumRecords, low_pass, sampled_exactly
from casid.model.dimensions import check_units
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


# -- the study's records -------------------------------------------------------------------------


def held_chain(m):
    """Matrices of x[t+1] = A x[t] + b ref[t] by one matrix exponential, x = phi, phi', a_y."""
    v = TABLE_7_2
    S = v["M"] * v["z_g"] + m * v["z_m"]
    I_1 = v["I_x"] + v["M"] * v["z_g"] ** 2 + m * v["z_m"] ** 2
    torque = np.array([-(v["k"] + S * 9.81), -v["d"], S]) / I_1
    generator = np.zeros((4, 4))
    generator[:3, :3] = [[0, 1, 0], torque, [0, 0, -1 / 0.2]]
    generator[2, 3] = 1 / 0.2
    E = expm(0.01 * generator)
    return E[:3, :3], E[:3, 3], v["z_s"] * torque + [9.81, 0, -1]


@pytest.mark.parametrize("m", [0.0, 0.2])
def test_the_linear_chain_is_sampled_without_an_error_of_integration(m):
    """The modes agree with the matrix exponential to rounding, over 20 000 samples."""
    ref = pendulum.telegraph(20_000, 0.01, amplitude=0.3, rng=np.random.default_rng(5))
    gyro, accel = sampled_exactly(ref, m=m)
    A, b, c = held_chain(m)
    x, path = np.zeros(3), np.empty((ref.size, 3))
    for t, r in enumerate(ref):
        path[t] = x
        x = A @ x + b * r
    np.testing.assert_allclose(gyro, path[:, 1], atol=1e-13 * np.abs(gyro).max())
    np.testing.assert_allclose(accel, path @ c, atol=1e-13 * np.abs(accel).max())


def test_the_nonlinear_truth_departs_from_the_linear_one_with_the_cube_of_the_amplitude():
    """sin, cos are odd and even: the first term beside the linear response is of third order.

    Doubling A multiplies the departure by 8 (1 + c A^2); at A = 0.05 the correction is the
    departure itself, below 1 %. Integration errors, 1e-9 of the response, stay far below.
    """
    departure = []
    for amplitude in (0.05, 0.1):
        runs = [
            PendulumRecords(amplitude, N=3000, noise=0.0, truth=truth).clean["loaded"]
            for truth in ("linear", "nonlinear")
        ]
        departure.append(np.abs(runs[0]["gyro"] - runs[1]["gyro"]).max())
        assert departure[-1] < 0.01 * np.abs(runs[0]["gyro"]).max()
    assert departure[1] / departure[0] == pytest.approx(8.0, rel=0.02)


def test_two_passes_of_the_filter_square_its_gain():
    f = np.array([0.0, 0.5, 1.0, 2.0, 6.0, 20.0])
    once, twice = low_pass(1), low_pass(2)
    assert (once.half, twice.half) == (10, 20)
    np.testing.assert_allclose(twice.gain(f), once.gain(f) ** 2, atol=1e-14)
    assert once.gain(0.0) == pytest.approx(1.0, abs=1e-14)
    with pytest.raises(casid.DataError, match=r"use 2 \(forward and backward\) or 1"):
        low_pass(3)


@pytest.mark.parametrize(("taps", "N"), [(21, 500), (21, 501), (41, 37), (3, 100), (1, 9)])
def test_filtering_in_blocks_is_convolution(taps, N):
    rng = np.random.default_rng(6)
    h, x, beside = rng.standard_normal(taps), rng.standard_normal(N + taps - 1), rng.random(N)
    block = BlockFilter(h, N)
    block.input[:] = x
    expected = np.convolve(x, h, mode="valid") + beside
    np.testing.assert_allclose(block(np.empty(N), beside), expected, atol=1e-13)


def test_a_run_is_the_clean_signals_and_white_noise_behind_the_filter():
    """Covariance of filtered white noise: sigma^2 (h * h reversed), at lags 0 to 40.

    A covariance over N = 60 000 samples has standard deviation below sigma^2 sum(h^2) (60/N)^(1/2)
    (the noise decorrelates within 30 samples): 3 % of its value at lag 0; four are allowed.
    """
    study = PendulumRecords(0.3, N=60_000, seed=3)
    drawn = study.draw(study.generator(0))
    h = study.low_pass.taps
    expected = 0.01**2 * np.correlate(h, h, mode="full")[h.size - 1 :]
    for case in study.cases:
        for channel in ("gyro", "accel"):
            noise = drawn[case][channel] - study.clean[case][channel]
            for lag in (0, 1, 2, 5, 10, 20, 40):
                covariance = np.mean(noise[lag:] * noise[: noise.size - lag])
                assert covariance == pytest.approx(expected[lag], abs=0.12 * expected[0])
        assert drawn[case]["ref"] is study.clean[case]["ref"]
    a, b = (drawn["nominal"][c] - study.clean["nominal"][c] for c in ("gyro", "accel"))
    assert abs(np.mean(a * b)) < 0.12 * expected[0]


def test_a_run_is_the_same_whoever_draws_it_and_when():
    study = PendulumRecords(0.3, N=500, seed=4)
    other = pickle.loads(pickle.dumps(study))
    first = {c: drawn["gyro"].copy() for c, drawn in study.draw(study.generator(7)).items()}
    study.draw(study.generator(8))
    for case, drawn in other.draw(other.generator(7)).items():
        np.testing.assert_array_equal(drawn["gyro"], first[case])
    nominal, loaded = study.experiments(7)
    np.testing.assert_array_equal(loaded.record["gyro"], first["loaded"])
    assert (dict(nominal.known), dict(loaded.known)) == ({"m": 0.0}, {})
    assert np.abs(first["nominal"] - first["loaded"]).max() > 1e-3
    for case, drawn in study.draw(study.generator(np.random.SeedSequence(9))).items():
        again = other.draw(other.generator(np.random.SeedSequence(9)))
        np.testing.assert_array_equal(drawn["gyro"], again[case]["gyro"])


def test_an_unknown_truth_is_refused():
    with pytest.raises(casid.DataError, match="use 'linear' or 'nonlinear'"):
        PendulumRecords(truth="cubic")


def test_constrained_least_squares_is_biased_as_published():
    """Digest of 7.5.1, A = 0.3: least squares gives m = 0.181 +- 0.002, I_x above, d within 1e-4.

    (7.41) and (7.47) are lines through theta, so the constrained least squares are one-dimensional.
    Five runs of 150 000 samples: the mean of m has a standard error of 0.001.
    """
    v, T = TABLE_7_2, 0.01
    S, k = v["M"] * v["z_g"], v["k"]

    def along(record, row, value):
        """Least squares of y[t] = -a1 y[t-1] - a2 y[t-2] + b0 (u[t] - u[t-2]), row theta = value"""
        y, u = record["gyro"], record["accel"]
        Phi = np.stack([-y[1:-1], -y[:-2], u[2:] - u[:-2]], axis=1)
        at = row * value / (row @ row)
        free = np.linalg.svd(row[None, :])[2][1:].T
        return at + free @ np.linalg.lstsq(Phi @ free, y[2:] - Phi @ at, rcond=None)[0]

    def continuous(theta):
        """(7.36)"""
        a1, a2, b0 = theta
        scale = 1 - a1 + a2
        return 4 / T * (1 - a2) / scale, 8 / T * b0 / scale

    study, found = PendulumRecords(0.3), []
    for run in range(5):
        drawn = study.draw(study.generator(run))
        theta = along(drawn["nominal"], np.array([-S / k, -S / k, -2 * T]), S / k)  # (7.41)
        alpha, beta = continuous(theta)
        d, I_x = -S * alpha / beta, -S / beta - S * (v["z_g"] - v["z_s"])  # (7.37)
        theta = along(drawn["loaded"], np.array([d / k, d / k + T, 0.0]), T - d / k)  # (7.47)
        alpha, beta = continuous(theta)
        w = alpha * (I_x + v["M"] * v["z_g"] ** 2) + d * (beta * v["z_s"] - 1)
        found.append([I_x, d, -((beta * d + alpha * S) ** 2) / (alpha * w)])  # (7.38)
    I_x, d, m = np.mean(found, axis=0)
    assert m == pytest.approx(0.181, abs=0.004)
    assert 0.1385 < I_x < 0.1388
    assert d == pytest.approx(0.1067, abs=4e-4)
