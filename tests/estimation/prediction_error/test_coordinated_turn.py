"""Extended Kalman smoothing, and speeds from tracks by the coordinated turn.

The truth is integrated or drawn here by numpy; where the model is linear, the smoother's answer is
that of one dense Gaussian, conditioned.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from analysis.kvlcc2_zigzag.study import smoothed
from casid.data.record import Record
from casid.errors import DataError, ModelError
from casid.estimation.prediction_error.coordinated_turn import (
    OUTPUTS,
    coordinated_turn,
    rounding_error,
    smooth_track,
)
from casid.linear.filtering.extended_smoother import ExtendedSmoother, StochasticModel
from casid.linear.filtering.noisy_system import sample_noise
from tests.support.shared import shared

F = np.array([[1.0, 0.1], [-0.2, 0.95]])
C = np.array([[1.0, 0.0], [0.5, 2.0]])
G = np.array([0.1, 0.4])


def linear() -> StochasticModel:
    """An oscillator, so that everything is Gaussian and known."""
    return StochasticModel(
        "oscillator",
        {"a": "m", "b": "m/s"},
        {"one": "m", "two": "m"},
        {"push": "m", "noise": "m"},
        lambda x: ca.DM(F) @ x,
        lambda x, level: level[0] ** 2 * (ca.DM(G) @ ca.DM(G).T),
        lambda x: ca.DM(C) @ x,
        lambda level: ca.vertcat(level[1] ** 2, 4 * level[1] ** 2),
    )


def test_of_a_linear_model_the_smoother_is_the_conditional_mean_and_covariance() -> None:
    rng = np.random.default_rng(1)
    N, push, noise = 25, 0.7, 0.3
    x0, P0 = np.array([1.0, -0.5]), np.array([[0.5, 0.1], [0.1, 0.3]])
    used = rng.random((N, 2)) > 0.2
    known = rng.uniform(0.0, 0.5, (N, 2))
    y = rng.normal(size=(N, 2))
    # All states as one Gaussian vector, from the recursion's own definition.
    mean, cov = np.zeros((N, 2)), np.zeros((N, 2, N, 2))
    m, P = x0, P0
    for t in range(N):
        mean[t], cov[t, :, t] = m, P
        ahead = P
        for s in range(t + 1, N):
            ahead = F @ ahead
            cov[s, :, t], cov[t, :, s] = ahead, ahead.T
        m, P = F @ m, F @ P @ F.T + push**2 * np.outer(G, G)
    big = cov.reshape(2 * N, 2 * N)
    H = np.kron(np.eye(N), C)[used.ravel()]
    R = np.diag((np.array([noise**2, 4 * noise**2]) + known**2).ravel()[used.ravel()])
    S = H @ big @ H.T + R
    e = y.ravel()[used.ravel()] - H @ mean.ravel()
    expected = mean.ravel() + big @ H.T @ np.linalg.solve(S, e)
    covariance = big - big @ H.T @ np.linalg.solve(S, H @ big)

    smoother = ExtendedSmoother(linear())
    levels = {"push": push, "noise": noise}
    found = smoother.smooth(np.where(used, y, np.nan), levels, x0, P0, used=used, known=known)
    np.testing.assert_allclose(found.x.ravel(), expected, rtol=0, atol=1e-10)
    blocks = covariance.reshape(N, 2, N, 2)[np.arange(N), :, np.arange(N)]
    np.testing.assert_allclose(found.P, blocks, rtol=0, atol=1e-10)
    density = multivariate_normal.logpdf(e, cov=S)
    assert found.log_likelihood == pytest.approx(density, rel=1e-11)
    np.testing.assert_array_equal(found.innovations[~used], 0.0)
    np.testing.assert_allclose(found["b"], found.x[:, 1])


def test_the_levels_found_are_the_most_likely_and_near_the_true_ones() -> None:
    rng = np.random.default_rng(2)
    N, truth = 2000, {"push": 0.7, "noise": 0.3}
    x, y = np.zeros(2), np.empty((N, 2))
    for t in range(N):
        y[t] = C @ x + rng.normal(size=2) * truth["noise"] * np.array([1.0, 2.0])
        x = F @ x + truth["push"] * rng.normal() * G
    smoother, P0 = ExtendedSmoother(linear()), 1e-6 * np.eye(2)
    found = smoother.fit(y, {"push": 0.01, "noise": 5.0}, np.zeros(2), P0)
    for name, value in truth.items():
        error = found.relative_errors[name]
        assert error < 0.05
        assert abs(np.log(found.values[name] / value)) < 4 * error
        for factor in (1 - error, 1 + error):
            # One standard error aside it is lower by about 1/2 (curvature = information).
            beside = found.values | {name: found.values[name] * factor}
            lower = smoother.smooth(y, beside, np.zeros(2), P0).log_likelihood
            assert 0.2 < found.log_likelihood - lower < 1.0
    only = smoother.fit(y, found.values | {"push": 0.5}, np.zeros(2), P0, free=["noise"])
    assert only.values["push"] == 0.5
    assert only.log_likelihood < found.log_likelihood
    assert smoother.fit(y, truth, np.zeros(2), P0, free=[]).values == truth


def motion(t: float, state: Any, u: float, v: float, r: float) -> Any:
    psi = state[2]
    return np.array([u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi), r])


def runge_kutta(state: Any, dt: float, inputs: Any) -> Any:
    """One classical step of (1), the inputs (3, 3) at its beginning, middle and end."""
    k1 = motion(0, state, *inputs[0])
    k2 = motion(0, state + dt / 2 * k1, *inputs[1])
    k3 = motion(0, state + dt / 2 * k2, *inputs[1])
    k4 = motion(0, state + dt * k3, *inputs[2])
    return state + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


@pytest.mark.parametrize("r", [0.0, 1e-7, -0.03, 0.039, 0.041, 1.5])
def test_one_sample_of_the_model_is_the_motion_with_constant_speeds(r: float) -> None:
    Ts, u, v = 1.0, 2.0, -0.3
    model = coordinated_turn(Ts)
    x = ca.SX.sym("x", 6)
    step = ca.Function("f", [x], [model.transition(x), ca.jacobian(model.transition(x), x)])
    found, slope = (np.array(o) for o in step([5.0, -1.0, 0.7, r, u, v]))
    state = np.array([5.0, -1.0, 0.7])
    for _ in range(200):  # the step's error is (r Ts / 200)^4: below 4e-9
        state = runge_kutta(state, Ts / 200, [[u, v, r]] * 3)
    np.testing.assert_allclose(found[:3, 0], state, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(found[3:, 0], [r, u, v])
    assert np.all(np.isfinite(slope))


def test_the_process_noise_of_a_straight_course_is_that_of_the_linear_system() -> None:
    Ts, psi, u, v, q = 0.7, 0.4, 2.0, -0.3, (0.2, 0.05, 0.1)  # surge, yaw, sway
    model = coordinated_turn(Ts)
    x, level = ca.SX.sym("x", 6), ca.SX.sym("l", 5)
    process = ca.Function("Q", [x, level], [model.process(x, level)])
    found = np.array(process([0, 0, psi, 0, u, v], [*q, 1.0, 1.0]))
    c, s = np.cos(psi), np.sin(psi)
    A = np.zeros((6, 6))
    A[0, 2], A[1, 2] = -(u * s + v * c), u * c - v * s
    A[0, 4], A[0, 5], A[1, 4], A[1, 5], A[2, 3] = c, -s, s, c, 1.0
    W = np.diag([0, 0, 0, q[1] ** 2, q[0] ** 2, q[2] ** 2])
    np.testing.assert_allclose(found, sample_noise(A, W, Ts), rtol=0, atol=1e-15)


TRUE = {"surge": 0.05, "yaw": 0.01, "sway": 0.03, "position": 0.2, "heading": 0.01}


def drawn(N: int, Ts: float, seed: int) -> tuple[Record, Any]:
    """A track whose speeds wander as (2) says, ten fine steps a sample, and its (N, 6) states."""
    rng = np.random.default_rng(seed)
    fine, dt = 10, Ts / 10
    state, speeds = np.zeros(3), np.array([2.0, 0.0, 0.0])  # u, v, r
    size = np.array([TRUE["surge"], TRUE["sway"], TRUE["yaw"]]) * np.sqrt(dt)
    x = np.empty((N, 6))
    for t in range(N):
        x[t] = [*state, speeds[2], speeds[0], speeds[1]]
        for _ in range(fine):
            after = speeds + size * rng.normal(size=3)
            state = runge_kutta(state, dt, [speeds, (speeds + after) / 2, after])
            speeds = after
    noise = np.array([TRUE["position"]] * 2 + [TRUE["heading"]])
    y = x[:, :3] + noise * rng.normal(size=(N, 3))
    return Record(dict(zip(OUTPUTS, y.T, strict=True)), dict(OUTPUTS), Ts=Ts), x


@pytest.mark.slow
def test_errors_of_smoothed_speeds_are_as_large_as_said() -> None:
    """Mean squares of normalised errors, at instants so far apart that they are independent."""
    squares: dict[str, list[float]] = {"U": [], "u": [], "v": [], "r": []}
    for seed in range(12):
        record, x = drawn(300, 0.5, seed)
        track = smooth_track(record, levels=TRUE)
        for k in range(25, 300, 50):  # 25 s: many times the memory of the smoother, about 3 s
            truth = {"U": np.hypot(x[k, 4], x[k, 5]), "r": x[k, 3], "u": x[k, 4], "v": x[k, 5]}
            sd = {
                "U": track.U_sd,
                "u": track.u_sd,
                "v": track.v_sd,
                "r": track.smoothed.std_error("r"),
            }
            for name, list_ in squares.items():
                list_.append(((getattr(track, name)[k] - truth[name]) / sd[name][k]) ** 2)
    for name, values in squares.items():  # chi-squared / n has the variance 2 / n
        assert abs(np.mean(values) - 1) < 4 * np.sqrt(2 / len(values)), name


@pytest.mark.slow
def test_levels_of_a_track_are_found_within_their_errors() -> None:
    record, x = drawn(1500, 0.5, 100)
    track = smooth_track(record)
    for name, value in TRUE.items():
        error = track.levels.relative_errors[name]
        assert 0 < error < 0.4
        assert abs(np.log(track.levels.values[name] / value)) < 4 * error, name
    assert not track.notes
    assert "surge" in str(track)
    assert any("Rauch" in line for line in track.references())
    # With levels so near to the truth the speeds are as good as with the true ones: 10 % of a
    # level moves them by a small part of their standard deviation.
    stated = smooth_track(record, levels=TRUE)
    assert np.sqrt(np.mean(((track.u - stated.u) / stated.u_sd) ** 2)) < 0.5


def zigzag(
    noise: Any, seed: int, *, Ts: float = 0.5, N: int = 600, missing: bool = False
) -> tuple[Record, Any, Any, Any]:
    """A ship in a zigzag that slows down in its turns; no random walk, but sines.

    `noise` (N, 3) or (3,): standard deviations, stated to the smoother as well. Returns the record
    and the true u, v, psi.
    """
    fine = 10
    t = np.arange(N * fine * 2 + 1) * Ts / fine / 2  # middles of steps, too
    r = 0.02 * np.sin(0.06 * t)
    u, v = 8 - 1.0 * np.sin(0.06 * t) ** 2, -30 * r
    speeds, state = np.column_stack([u, v, r]), np.array([0.0, 0.0, 3.0])
    x = np.empty((N, 3))
    for k in range(N):
        x[k] = state
        for i in range(2 * fine * k, 2 * fine * (k + 1), 2):
            state = runge_kutta(state, Ts / fine, speeds[i : i + 3])
    rng = np.random.default_rng(seed)
    y = x + noise * rng.normal(size=x.shape)
    masks = {}
    if missing:
        masks = {name: rng.random(N) < 0.2 for name in OUTPUTS}
        masks["psi"][200:216] = True  # 8 s without a compass
    every = slice(0, 2 * fine * N, 2 * fine)
    channels = dict(zip(OUTPUTS, y.T, strict=True))
    record = Record(channels, dict(OUTPUTS), Ts=Ts, missing=masks)
    return record, u[every], v[every], x[:, 2]


@pytest.mark.slow
def test_a_zigzag_is_smoothed_though_samples_miss_and_noise_is_unequal() -> None:
    noise = np.tile([0.3, 0.3, 0.004], (600, 1))
    noise[300:450, 0] = 3.0  # one coordinate is ten times worse for a while
    record, u, v, _ = zigzag(noise, 3, missing=True)
    track = smooth_track(record, known=dict(zip(OUTPUTS, noise.T, strict=True)))
    error = track.u - u
    # The slope of a line over 10 s has the error 0.3 sqrt(12 / 20^3) / 0.5 = 0.023 m/s, ten times
    # that in the quarter where x is worse, were the memory not longer there.
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert np.mean(np.abs(error) < 2 * track.u_sd) > 0.9
    assert np.mean(np.abs(track.v - v) < 2 * track.v_sd) > 0.9
    assert np.mean(np.abs(track.U - np.hypot(u, v)) < 2 * track.U_sd) > 0.9
    worse = np.median(track.u_sd[330:420]) / np.median(track.u_sd[100:180])
    assert worse > 1.3


def test_headings_that_jump_by_two_pi_change_nothing() -> None:
    record, *_ = zigzag(np.array([0.3, 0.3, 0.004]), 4, N=200)
    levels = {"surge": 0.05, "yaw": 0.003, "sway": 0.05, "position": 0.3, "heading": 0.004}
    plain = smooth_track(record, levels=levels)
    wrapped = record.with_channel("psi", (record["psi"] + np.pi) % (2 * np.pi) - np.pi, "rad")
    assert np.ptp(wrapped["psi"]) > 6  # the zigzag starts at 3 rad: it does jump
    again = smooth_track(wrapped, levels=levels)
    np.testing.assert_allclose(again.u, plain.u, rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.cos(again.course), np.cos(plain.course), rtol=0, atol=1e-9)


def test_a_model_without_drift_takes_the_heading_for_the_course() -> None:
    record, u, v, psi = zigzag(np.array([0.1, 0.1, 0.002]), 5, N=400)
    with_drift = smooth_track(record)
    U, course = np.hypot(u, v), psi + np.arctan2(v, u)
    assert np.sqrt(np.mean((with_drift.U - U) ** 2)) < 0.05
    assert np.sqrt(np.mean((with_drift.course - course) ** 2)) < 0.01
    along = record.with_channel("psi", course, "rad")
    without = smooth_track(along, drifts=False, levels={"heading": 0.002})
    np.testing.assert_array_equal(without.U, without.u)
    np.testing.assert_array_equal(without.U_sd, without.u_sd)
    np.testing.assert_array_equal(without.v, 0.0)
    assert np.sqrt(np.mean((without.U - U) ** 2)) < 0.05


def test_at_rest_the_course_means_little_and_the_track_says_so() -> None:
    rng = np.random.default_rng(6)
    y = rng.normal(size=(200, 3)) * [0.1, 0.1, 0.01]
    record = Record(dict(zip(OUTPUTS, y.T, strict=True)), dict(OUTPUTS), Ts=1.0)
    levels = {"surge": 0.01, "sway": 0.01, "yaw": 0.001, "position": 0.1, "heading": 0.01}
    track = smooth_track(record, levels=levels)
    assert any("below twice its standard deviation" in note for note in track.notes)
    assert np.all(np.isfinite(track.U_sd))


def test_what_cannot_be_smoothed_is_refused_with_a_mend() -> None:
    record, *_ = zigzag(np.array([0.3, 0.3, 0.004]), 7, N=50)
    degrees = Record(
        {n: record[n] for n in OUTPUTS}, {"x": "m", "y": "m", "psi": "m"}, Ts=record.Ts
    )
    with pytest.raises(DataError, match=r"psi of a track is in rad; choose the channel"):
        smooth_track(degrees)
    with pytest.raises(ModelError, match="no output 'heading'; there are x, y, psi"):
        smooth_track(record, {"heading": "psi"})
    with pytest.raises(ModelError, match="no level 'wind'; there are surge, yaw, sway"):
        smooth_track(record, levels={"wind": 1.0})
    blind = record.mark_missing("psi", np.arange(50) > 2)
    with pytest.raises(DataError, match="psi has fewer than 4 samples .* widen the window"):
        smooth_track(blind)
    smoother = ExtendedSmoother(linear())
    y, levels = np.zeros((5, 2)), {"push": 1.0, "noise": 1.0}
    with pytest.raises(DataError, match=r"give \(N, 2\) for one, two"):
        smoother.smooth(y.T, levels, np.zeros(2), np.eye(2))
    bad = y.copy()
    bad[3, 0] = np.nan
    with pytest.raises(DataError, match="one is not finite at sample 3; mark it as missing"):
        smoother.smooth(bad, levels, np.zeros(2), np.eye(2))
    with pytest.raises(ModelError, match="level 'noise' is missing; give a value for each"):
        smoother.smooth(y, {"push": 1.0}, np.zeros(2), np.eye(2))
    with pytest.raises(ModelError, match="level push = 0; give a positive number"):
        smoother.smooth(y, {"push": 0.0, "noise": 1.0}, np.zeros(2), np.eye(2))
    with pytest.raises(ModelError, match="no level 'pull' to estimate"):
        smoother.fit(y, levels, np.zeros(2), np.eye(2), free=["pull"])


def test_the_error_of_a_rounded_number_is_that_of_its_last_digit() -> None:
    rng = np.random.default_rng(8)
    for exact, unit in (
        (rng.uniform(1000, 9999, 4000), 10.0),
        (rng.uniform(-9.99, -1, 4000), 0.01),
    ):
        written = np.array([float(f"{v:.3g}") for v in exact])
        np.testing.assert_allclose(rounding_error(written[:5]), unit / np.sqrt(12))
        # The variance of a uniform error's square is unit^4 / 180: a relative sd of 0.89 / sqrt(N).
        mean = np.mean((written - exact) ** 2 / rounding_error(written) ** 2)
        assert abs(mean - 1) < 4 * np.sqrt(0.8 / 4000)
    assert rounding_error(np.zeros(1))[0] > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["zz_10", "zz_20"])
def test_the_surge_speed_of_a_real_zigzag_is_within_a_tenth_of_a_metre_per_second(
    name: str,
) -> None:
    """Positions written with three digits: to 10 m, beyond a kilometre. The speeds recorded are
    earth-fixed; every fourth sample is enough, as the rounding changes but every ninth.
    """
    track, d = smoothed(shared(f"data/kvlcc2_marin_free/{name}.csv").parent, name)
    psi = np.deg2rad(d["psi_deg"])
    surge = d["u_mps"] * np.cos(psi) + d["v_mps"] * np.sin(psi)
    error = track.u - surge
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert 0.5 < np.sqrt(np.mean((error / track.u_sd) ** 2)) < 1.3
    sway = d["v_mps"] * np.cos(psi) - d["u_mps"] * np.sin(psi)
    assert np.sqrt(np.mean((track.v - sway) ** 2)) < 0.1
    assert np.std(track.r - np.deg2rad(d["r_degps"])) < 0.05 * np.std(np.deg2rad(d["r_degps"]))
