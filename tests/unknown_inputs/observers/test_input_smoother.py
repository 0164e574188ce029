"""Unknown inputs estimated from a record: smoothed, and by the inverse run both ways in time."""

from __future__ import annotations

from typing import Any

import control
import numpy as np
import pytest
from scipy.stats import binom

from casid.data.record import Record
from casid.errors import DataError, ModelError
from casid.linear.filtering.split_dynamics import split_dynamics
from casid.unknown_inputs.observers.decoupled_observer import decoupled_observer
from casid.unknown_inputs.observers.input_smoother import reconstruct_input
from casid.unknown_inputs.observers.noncausal_inverse import noncausal_inverse
from casid.unknown_inputs.observers.unknown_input_system import UnknownInputSystem
from problems import pendulum

Array = np.ndarray[Any, Any]


def oscillator(C: Any = ((1.0, 0.0),), F: Any = ((0.0,),)) -> UnknownInputSystem:
    """A mass on a spring, pushed by something known and a force that is not, sampled at 0.05 s."""
    A, E = np.array([[0.0, 1.0], [-4.0, -0.4]]), np.array([[0.0], [1.0]])
    C, F = np.array(C), np.array(F)
    names = ("pos",) if len(C) == 1 else tuple(f"y{i + 1}" for i in range(len(C)))
    return UnknownInputSystem(
        A,
        E,
        E,
        C,
        F,
        F,
        states=("x", "v"),
        known=("push",),
        unknown=("force",),
        outputs=names,
        holds={"push": "zoh"},
        units={"force": "N", "push": "N"},
    ).sampled(0.05)


def run(
    s: UnknownInputSystem, u: Array, w: Array, x0: Array, sd: float, rng: np.random.Generator
) -> Record:
    """Noisy outputs for known inputs u (N, nk) and unknown ones w (N, nu)."""
    x, y = x0, []
    for k, f in zip(u, w, strict=True):
        y.append(s.C @ x + s.D @ k + s.F @ f)
        x = s.A @ x + s.B @ k + s.E @ f
    noisy = np.array(y) + sd * rng.standard_normal((len(y), s.ny))
    columns = dict(zip(s.outputs, noisy.T, strict=True)) | dict(zip(s.known, u.T, strict=True))
    units = {n: "N" if n in s.known else "1" for n in columns}
    return Record(columns, units, Ts=s.Ts)


def smooth_force(N: int, rng: np.random.Generator) -> Array:
    t = 0.05 * np.arange(N)
    phase = rng.uniform(0, 2 * np.pi, 3)
    force = sum(np.sin(w * t + p) for w, p in zip((0.4, 1.1, 2.3), phase, strict=True))
    return np.asarray(force)[:, None]


# -- smoothing -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_smoother_s_standard_deviations_cover_the_input_as_often_as_they_say() -> None:
    """Independent records; the number covered at one time is binomial, with 99.9 % limits."""
    s = oscillator()
    M, N, sd, rate = 120, 60, 0.05, 2.0
    rng = np.random.default_rng(4)
    inside = np.zeros(N)
    for _ in range(M):
        w = np.cumsum(np.r_[3.0, rate * np.sqrt(s.Ts) * np.ones(N - 1)] * rng.standard_normal(N))
        x0 = rng.standard_normal(2)
        record = run(s, rng.standard_normal((N, 1)), w[:, None], x0, sd, rng)
        e = reconstruct_input(
            s,
            record,
            noise={"pos": sd},
            rate={"force": rate},
            start_sd={"x": 1.0, "v": 1.0, "force": 3.0},
        )
        inside += np.abs(e["force"] - w) < e.std_error("force")
    low, high = binom.ppf([0.0005, 0.9995], M, 0.6827)
    for t in (0, 10, 30, 50, N - 1):
        assert low <= inside[t] <= high


def test_known_inputs_do_not_change_the_estimate() -> None:
    """Superposition: the same force and noise with and without a push, the same estimate."""
    s = oscillator()
    w = smooth_force(200, np.random.default_rng(1))
    found = []
    for push in (0.0, 10.0):
        rng = np.random.default_rng(2)
        record = run(s, push * np.ones((200, 1)), w, np.zeros(2), 0.01, rng)
        told = {"noise": {"pos": 0.01}, "rate": {"force": 2.0}}
        both = reconstruct_input(s, record, **told), noncausal_inverse(s).run(record, band=8.0)
        found.append([e["force"] for e in both])
    scale = np.max(np.abs(found[0][0]))
    # The start of the bounded motion differs from rest by what a diffuse prior lets through.
    np.testing.assert_allclose(found[0][0], found[1][0], atol=0.02 * scale)
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one[60:140], other[60:140], atol=1e-3 * scale)


def test_noise_and_rate_are_found_where_they_are_not_given() -> None:
    """Relative errors of maximum likelihood levels: sd over 40 records measured once, 3 % and 8 %;
    here the standard error of a white noise level from N samples, 1/sqrt(2 N), times a few."""
    s = oscillator()
    rng = np.random.default_rng(1)
    N = 2000
    w = np.cumsum(2.0 * np.sqrt(s.Ts) * rng.standard_normal((N, 1)), axis=0)
    record = run(s, rng.standard_normal((N, 1)), w, np.ones(2), 0.02, rng)
    e = reconstruct_input(s, record)
    assert e.levels["noise of pos"] == pytest.approx(0.02, rel=4 / np.sqrt(2 * N))
    assert e.levels["rate of force"] == pytest.approx(2.0, rel=0.15)
    assert any("rate of force" in a for a in e.assumed)
    assert "standard deviation" in str(e)


def test_known_inputs_of_an_unstable_system_are_taken_out_without_growing() -> None:
    """The response to known inputs is the bounded one, part of it backward in time."""
    A = np.array([[1.1, 0.2], [0.0, 0.8]])
    E = np.array([[0.3], [1.0]])
    s = UnknownInputSystem(
        A, E, E, np.eye(2), np.zeros((2, 1)), np.zeros((2, 1)), 0.1, known=("push",)
    )
    rng = np.random.default_rng(0)
    N, x = 600, np.zeros(2)
    push, y, force = rng.standard_normal(N), np.empty((N, 2)), np.empty(N)
    for t in range(N):  # the unknown input stabilises the system: feedback that nobody told of
        y[t], force[t] = x, -0.9 * x[0] + 0.3 * np.sin(0.05 * t)
        x = A @ x + E[:, 0] * (push[t] + force[t])
    assert np.max(np.abs(y)) < 50
    noisy = y + 0.01 * rng.standard_normal(y.shape)
    record = Record(
        {"y1": noisy[:, 0], "y2": noisy[:, 1], "push": push},
        {"y1": "1", "y2": "1", "push": "1"},
        Ts=0.1,
    )
    e = reconstruct_input(s, record, noise={"y1": 0.01, "y2": 0.01}, rate={"u1": 3.0})
    inner = slice(5, -5)
    assert np.std((e["u1"] - force)[inner]) < 0.1 * np.std(force)


def test_missing_samples_widen_the_band_and_nothing_else() -> None:
    s = oscillator()
    rng = np.random.default_rng(2)
    record = run(s, np.zeros((300, 1)), smooth_force(300, rng), np.zeros(2), 0.01, rng)
    gap = (np.arange(300) > 140) & (np.arange(300) < 160)
    levels = {"noise": {"pos": 0.01}, "rate": {"force": 1.0}}
    whole = reconstruct_input(s, record, **levels)
    holed = reconstruct_input(s, record.mark_missing("pos", gap), **levels)
    assert holed.std_error("force")[150] > 1.2 * whole.std_error("force")[150]
    np.testing.assert_allclose(holed["force"][:60], whole["force"][:60], atol=1e-3)


def test_a_model_of_the_input_s_spectrum_beats_the_random_walk_where_it_is_right() -> None:
    """A resonant input: second-order noise at 3 rad/s; the smoother that knows it errs less."""
    s = oscillator()
    rng = np.random.default_rng(6)
    shape = control.ss(control.tf([3.0], [1, 0.3, 9.0]))
    from scipy.linalg import expm

    from casid.linear.filtering.noisy_system import sample_noise

    Ad, Q = expm(shape.A * s.Ts), sample_noise(shape.A, shape.B @ shape.B.T, s.Ts)
    root = np.linalg.cholesky(Q)
    N, z = 800, np.zeros(2)
    w = np.empty((N, 1))
    for t in range(N):
        w[t] = shape.C @ z
        z = Ad @ z + root @ rng.standard_normal(2)
    record = run(s, np.zeros((N, 1)), w, np.zeros(2), 0.05, rng)
    told = reconstruct_input(
        s, record, models={"force": shape}, noise={"pos": 0.05}, rate={"force": 1.0}
    )
    walk = reconstruct_input(s, record, noise={"pos": 0.05})
    error = [np.std(e["force"] - w[:, 0]) for e in (told, walk)]
    assert error[0] < error[1]
    z_score = (told["force"] - w[:, 0]) / told.std_error("force")
    # Correlated over about a period, 40 samples: 20 independent ones, sd of their spread 1/sqrt(40)
    assert np.std(z_score) == pytest.approx(1.0, abs=3.5 / np.sqrt(40))
    with pytest.raises(ModelError, match="give one output and D = 0"):
        reconstruct_input(s, record, models={"force": control.ss([], [], [], 1.0)})
    other = control.ss(shape.A, shape.B, shape.C, 0, 0.2)
    with pytest.raises(ModelError, match="has Ts = 0.2 s, the record 0.05 s"):
        reconstruct_input(s, record, models={"force": other})


# -- the noncausal inverse -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("C", "backward"),
    [
        ([[1.0, 0.0]], 0),  # position: a sampling zero near -1, inside
        ([[3.0, 1.0]], 0),
        ([[-3.0, 1.0]], 1),  # zero at s = 3
        ([[1.0, 0.0], [-3.0, 1.0]], 0),  # two outputs: no common zero
    ],
)
def test_the_noncausal_inverse_returns_the_input_exactly_without_noise(
    C: list[list[float]], backward: int
) -> None:
    s = oscillator(C, np.zeros((len(C), 1)))
    inverse = noncausal_inverse(s)
    assert len(inverse.backward_zeros) == backward
    rng = np.random.default_rng(3)
    N = 4000
    w = rng.standard_normal((N, 1))
    record = run(s, rng.standard_normal((N, 1)), w, rng.standard_normal(2), 0.0, rng)
    e = inverse.run(record, noise=dict.fromkeys(s.outputs, 1e-3))
    inside = np.zeros(N, dtype=bool)
    start, end = inverse.split.settling(1e-10)
    inside[start : N - end - inverse.delay] = True
    assert inside.sum() > 300
    np.testing.assert_allclose(e["force"][inside], w[inside, 0], atol=1e-7)
    assert np.all(np.isinf(e.std_error("force")[~e.valid]))


def test_the_inverse_s_response_is_the_inverse_of_the_response() -> None:
    """L(z) G(z) = I on the unit circle, tall systems and unstable zeros too."""
    for C in ([[-3.0, 1.0]], [[1.0, 0.0], [-3.0, 1.0]]):
        s = oscillator(C, np.zeros((len(C), 1)))
        inverse = noncausal_inverse(s)
        w = np.linspace(0.1, 60.0, 40)
        z = np.exp(1j * w * s.Ts)
        G = s.C @ np.linalg.solve(z[:, None, None] * np.eye(2) - s.A, s.E) + s.F
        np.testing.assert_allclose(inverse.response(w) @ G, np.ones((40, 1, 1)), atol=1e-8)


def test_the_inverse_s_standard_deviation_is_that_of_the_noise_in_it() -> None:
    """Samples so far apart that they are independent: sd of a sample variance sqrt(2 / M)."""
    s = oscillator([[-3.0, 1.0]])
    inverse = noncausal_inverse(s)
    rng = np.random.default_rng(8)
    N, apart = 60_000, 150
    record = Record(
        {"pos": 0.01 * rng.standard_normal(N), "push": np.zeros(N)},
        {"pos": "1", "push": "N"},
        Ts=s.Ts,
    )
    for band in (None, 6.0):
        e = inverse.run(record, noise={"pos": 0.01}, band=band)
        sample = e["force"][e.valid][::apart]
        sd = float(e.std_error("force")[N // 2])
        M = len(sample)
        assert np.mean(sample**2) == pytest.approx(sd**2, rel=3.5 * np.sqrt(2 / M))


def test_a_band_limited_estimate_says_where_the_input_stands_out_of_the_noise() -> None:
    """Force below 2.3 rad/s; the double integration makes noise grow with frequency."""
    s = oscillator()
    rng = np.random.default_rng(5)
    N = 4000
    w = smooth_force(N, rng)
    record = run(s, np.zeros((N, 1)), w, np.zeros(2), 1e-3, rng)
    inverse = noncausal_inverse(s)
    gain = inverse.amplification(np.array([0.5, 5.0, 50.0]), {"pos": 1e-3})[:, 0]
    assert gain[0] < gain[1] < gain[2]
    e = inverse.run(record, noise={"pos": 1e-3}, band=8.0)
    low, high = e.band[0] or (0.0, 0.0)
    assert low <= 2.3 <= high < 8.0
    z = (e["force"] - w[:, 0])[e.valid] / e.std_error("force")[e.valid]
    assert np.std(z) == pytest.approx(1.0, abs=0.25)  # held force and cut band cost little
    added = e.added_to(record)
    assert added.units["force"] == "N"
    assert added.is_missing("force").sum() == (~e.valid).sum()


@pytest.mark.parametrize("C", [[[-3.0, 1.0]], [[3.0, 1.0]]])
def test_standard_deviations_hold_from_the_first_valid_sample_to_the_last(
    C: list[list[float]],
) -> None:
    """Large unknown starts; an rms of M errors deviates by 1/sqrt(2 M), transients by a tenth."""
    s = oscillator(C)
    inverse = noncausal_inverse(s)
    M, N, rng = 60, 500, np.random.default_rng(0)
    scores = np.empty((M, 3))
    for i in range(M):
        w = smooth_force(N, rng)
        record = run(s, np.zeros((N, 1)), w, 3 * rng.standard_normal(2), 0.01, rng)
        e = inverse.run(record, noise={"pos": 0.01})
        z = ((e["force"] - w[:, 0]) / e.std_error("force"))[e.valid]
        scores[i] = z[0], z[len(z) // 2], z[-1]
    rms = np.sqrt(np.mean(scores**2, axis=0))
    np.testing.assert_allclose(rms, 1.0, atol=3.5 / np.sqrt(2 * M) + 0.1)


def test_without_unstable_zeros_the_inverse_has_the_observer_s_states() -> None:
    """Both are exact without noise; the inverse's free gain H is an observer's gain."""
    s = oscillator([[1.0, 0.0], [-3.0, 1.0]], np.zeros((2, 1)))
    observer, inverse = decoupled_observer(s, poles=[0.6, 0.5]), noncausal_inverse(s)
    assert inverse.delay == 1  # the observer needs y[t+1], too, or its derivative
    rng = np.random.default_rng(9)
    record = run(s, np.zeros((300, 1)), rng.standard_normal((300, 1)), np.ones(2), 0.0, rng)
    e = inverse.run(record, noise={"y1": 1.0, "y2": 1.0})
    late = slice(inverse.split.settling(1e-10)[0] + 50, 290)
    np.testing.assert_allclose(e.x[late], observer.run(record).x[late], atol=1e-8)


def test_smoother_and_inverse_agree_where_the_noise_is_small() -> None:
    """With next to no noise the prior does not matter."""
    s = oscillator([[-3.0, 1.0]])
    rng = np.random.default_rng(11)
    w = smooth_force(600, rng)
    record = run(s, np.zeros((600, 1)), w, np.zeros(2), 1e-6, rng)
    smoothed = reconstruct_input(s, record, noise={"pos": 1e-6}, rate={"force": 5.0})
    inverted = noncausal_inverse(s).run(record, noise={"pos": 1e-6})
    middle = slice(200, 400)
    np.testing.assert_allclose(smoothed["force"][middle], inverted["force"][middle], atol=2e-3)


def test_a_split_recursion_is_a_solution_whatever_its_eigenvalues() -> None:
    rng = np.random.default_rng(0)
    A = rng.standard_normal((5, 5))
    v = rng.standard_normal((200, 5))
    assert np.any(np.abs(np.linalg.eigvals(A)) > 1)
    x = split_dynamics(A).run(v)
    np.testing.assert_allclose(x[1:], x[:-1] @ A.T + v[:-1], atol=1e-9 * np.max(np.abs(x)))
    assert np.max(np.abs(x)) < 1e3


def test_the_cart_s_acceleration_is_told_by_the_pendulum_s_two_sensors() -> None:
    """A telegraph through a lag is no random walk: the band is checked for its size alone."""
    reference = pendulum.telegraph(3000, 0.01, amplitude=0.3, rng=np.random.default_rng(1))
    record = pendulum.simulate(ref=reference, noise=0.01)
    values = {name: pendulum.TABLE_7_2[name] for name in ("k", "d", "I_x")}
    truth = pendulum.motion(reference, 0.01, 5, m=0.0, d_2=0.0, **values)[2]
    noise = {"gyro": 0.01, "accel": 0.01}
    smoothed = reconstruct_input(pendulum.linear_model(), record, values=values, noise=noise)
    inverse = noncausal_inverse(pendulum.linear_model(), Ts=0.01, values=values, noise=noise)
    inverted = inverse.run(record, noise=noise, band=20.0)
    for e in (smoothed, inverted):
        error = (e["a_y"] - truth)[e.valid]
        assert np.std(error) < 0.06 * np.std(truth)
        sd = float(np.median(e.std_error("a_y")[e.valid]))
        assert 0.5 < np.std(error) / sd < 2.0
        assert e.units["a_y"] == "m/s^2"


# -- bad input, figures ----------------------------------------------------------------------------


def test_inputs_that_cannot_be_recovered_are_named() -> None:
    s = oscillator()
    twice = UnknownInputSystem(
        s.A, s.B, np.hstack([s.E, 2 * s.E]), s.C, s.D, np.zeros((1, 2)), s.Ts,
        known=s.known, outputs=s.outputs, unknown=("wind", "wave"),
    )  # fmt: skip
    record = run(
        s, np.zeros((50, 1)), np.zeros((50, 1)), np.zeros(2), 0.1, np.random.default_rng(0)
    )
    for attempt in (lambda: reconstruct_input(twice, record), lambda: noncausal_inverse(twice)):
        with pytest.raises(ModelError, match="wind, wave cannot be recovered from pos"):
            attempt()


def test_a_zero_on_the_unit_circle_is_named() -> None:
    """Velocity of a mass on a spring, its mean never tells a constant force: zero at z = 1."""
    s = oscillator([[0.0, 1.0]])
    with pytest.raises(ModelError, match=r"zero z = 1 \(.*rad/s\) on the unit circle") as refusal:
        noncausal_inverse(s)
    assert "use reconstruct_input" in str(refusal.value)
    rng = np.random.default_rng(1)
    record = run(s, np.zeros((200, 1)), np.ones((200, 1)), np.zeros(2), 0.01, rng)
    e = reconstruct_input(s, record, noise={"pos": 0.01}, rate={"force": 0.1})
    assert np.all(np.abs(e["force"] - 1.0) < 4 * e.std_error("force"))  # and little is claimed


def test_reconstruction_that_is_asked_wrongly_is_refused_with_its_mend() -> None:
    s = oscillator()
    rng = np.random.default_rng(0)
    record = run(s, np.zeros((50, 1)), np.zeros((50, 1)), np.zeros(2), 0.1, rng)
    inverse = noncausal_inverse(s)
    with pytest.raises(ModelError, match="rate names 'forc'; did you mean 'force'"):
        reconstruct_input(s, record, rate={"forc": 1.0})
    with pytest.raises(ModelError, match="noise of pos is 0.0; give a positive number"):
        reconstruct_input(s, record, noise={"pos": 0.0})
    with pytest.raises(DataError, match="50 samples, but transients.*longer record"):
        noncausal_inverse(oscillator([[-0.2, 1.0]])).run(record)
    gap = record.mark_missing("pos", np.arange(50) == 7)
    with pytest.raises(DataError, match="missing at sample 7.*reconstruct_input"):
        inverse.run(gap)
    with pytest.raises(DataError, match="between 0 and 62.83 rad/s"):
        inverse.run(record, band=100.0)
    slow = UnknownInputSystem(
        -np.eye(1), np.zeros((1, 0)), np.eye(1), np.eye(1), np.zeros((1, 0)), np.zeros((1, 1))
    )
    with pytest.raises(ModelError, match="give the record's sample time, Ts="):
        noncausal_inverse(slow)
