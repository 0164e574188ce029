"""The simulators behind the tests, checked against theory and against scipy's own integrator."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.signal import lsim

from tests.support import truth
from tests.support.truth import UnreachableStrength, cart_pendulum, mass_spring_damper, roll_decay


def inertias(t: dict[str, float], m: float) -> tuple[float, float, float]:
    """Return S, I_1 (7.8) and I_2 (7.25) with load m, rigid at z_m."""
    S = t["M"] * t["z_g"] + m * t["z_m"]
    I_1 = t["I_x"] + t["M"] * t["z_g"] ** 2 + m * t["z_m"] ** 2
    return S, I_1, I_1 - t["z_s"] * S


def test_pendulum_agrees_with_an_adaptive_integrator():
    """Direct form (7.10), two nonlinear torques, the cart's lag as a third state.

    Runge-Kutta of order 4, h = 2 ms, w = 7 rad/s: about (h w)^5 / 120 a step, 1e-8 over the decay
    time; where quadratic damping changes sign h^3 times the jump of its curvature, below 1e-7.
    """
    record = cart_pendulum(
        "quadratic_damping", seed=3, duration=20.0, size=0.2, second=("cubic_stiffness", 1.0)
    )
    c, p = record.clean, record.truth
    t, ref = record.columns["t"], record.columns["ref"]
    S, I_1, _ = inertias(p, 0.0)

    def slope(_: float, x: list[float], r: float) -> list[float]:
        phi, phid, a_y = x
        torque = -p["size"] * abs(phid) * phid - p["second_size"] * phi**3
        restoring = (p["k"] + S * p["g"]) * phi + p["d"] * phid
        return [phid, (S * a_y - restoring + torque) / I_1, (r - a_y) / 0.2]

    jumps = [0, *(np.flatnonzero(np.diff(ref)) + 1), t.size - 1]
    x = [c["phi"][0], c["phid"][0], c["a_y"][0]]
    assert len(jumps) > 10
    for a, b in zip(jumps[:-1], jumps[1:], strict=True):
        run = solve_ivp(
            slope, t[[a, b]], x, "DOP853", t[a : b + 1], args=(ref[a],), rtol=1e-10, atol=1e-12
        )
        x = run.y[:, -1]
        for row, name in zip(run.y, ("phi", "phid", "a_y"), strict=True):
            np.testing.assert_allclose(row, c[name][a : b + 1], atol=1e-6, rtol=0)


def test_eliminating_the_cart_acceleration_gives_the_indirect_model():
    """I_2 phidd = -k phi - d phid - S a_s (7.24), exact for every sample of noise-free signals."""
    record = cart_pendulum("none", seed=5, duration=20.0, load=truth.M_LOAD)
    c, p = record.clean, record.truth
    S, _, I_2 = inertias(p, truth.M_LOAD)
    right = -p["k"] * c["phi"] - p["d"] * c["phid"] - S * c["accel"]
    np.testing.assert_allclose(I_2 * c["phidd"], right, atol=1e-12)  # rounding: terms near 1 N m
    a_y = truth.Z_S * c["phidd"] + truth.G * c["phi"] - c["accel"]  # (7.14)
    decay = math.exp(-0.01 / 0.2)
    held = decay * a_y[:-1] + (1 - decay) * record.columns["ref"][:-1]
    np.testing.assert_allclose(a_y[1:], held, atol=1e-11)


@pytest.mark.parametrize("kind", ["quadratic_damping", "coulomb_friction", "cubic_stiffness"])
def test_an_effect_is_what_the_indirect_model_leaves_over(kind: str):
    """A torque enters (7.24) unchanged; friction is its sign law above a creep of 0.005 rad/s."""
    record = cart_pendulum(kind, 1.0, seed=6)
    c, p = record.clean, record.truth
    S, _, I_2 = inertias(p, 0.0)
    torque = I_2 * c["phidd"] + p["k"] * c["phi"] + p["d"] * c["phid"] + S * c["accel"]
    law = {
        "quadratic_damping": -np.abs(c["phid"]) * c["phid"],
        "coulomb_friction": -np.sign(c["phid"]),
        "cubic_stiffness": -(c["phi"] ** 3),
    }[kind]
    sliding = np.abs(c["phid"]) > 0.03  # tanh(6) = 1 - 1.2e-5
    assert sliding.mean() > 0.5
    np.testing.assert_allclose(
        torque[sliding], p["size"] * law[sliding], atol=2e-5 * abs(p["size"])
    )


def test_a_load_that_comes_on_changes_the_model_at_one_time():
    record = cart_pendulum("parameter_jump", 1.0, seed=4, where="m")
    c, p, t = record.clean, record.truth, record.columns["t"]
    assert 0.2 * t[-1] <= p["t_jump"] <= 0.8 * t[-1]
    for now, m in ((t < p["t_jump"] - 1e-6, 0.0), (t > p["t_jump"] - 1e-6, p["size"])):
        S, _, I_2 = inertias(p, m)
        left = I_2 * c["phidd"] + p["k"] * c["phi"] + p["d"] * c["phid"] + S * c["accel"]
        np.testing.assert_allclose(left[now], 0.0, atol=1e-11)


PENDULUM_STRENGTHS = [
    ("quadratic_damping", 1.0),
    ("coulomb_friction", 0.5),
    ("cubic_stiffness", 3.0),
    ("deadzone", 1.0),
    ("extra_input", 5.0),
    ("periodic_disturbance", 0.5),
    ("parameter_jump", 1.0),
    ("parameter_drift", 0.5),
    ("scheduled_parameter", 0.5),
    ("sensor_bias", 1.5),
    ("time_delay", 0.5),
    ("sensor_lag", 0.5),
    ("saturation", 2.0),
    ("outliers", 0.5),
]


@pytest.mark.parametrize(("kind", "strength"), PENDULUM_STRENGTHS)
def test_the_strength_asked_for_is_the_strength_found(kind: str, strength: float):
    record = cart_pendulum(kind, strength, seed=11, duration=40.0)
    assert record.strength == pytest.approx(strength, rel=0.05)
    assert record.kind == kind
    assert record.second is None


@pytest.mark.slow
def test_strength_is_the_misfit_of_an_ordinary_five_parameter_refit():
    """The same number from a different program: lsim at 100 Hz, gain and initial state free too.

    The first-order hold at 100 Hz errs by (w T)^2 / 12 = 0.1 % of the gyro, mostly in the gain.
    """
    record = cart_pendulum("cubic_stiffness", 3.0, seed=12, duration=30.0)
    c, p, t = record.clean, record.truth, record.columns["t"]
    S, _, I_2 = inertias(p, 0.0)

    def residual(theta: np.ndarray) -> np.ndarray:
        k, d, s = np.array([p["k"], p["d"], S]) / I_2 * theta[:3]
        system = ([[0.0, 1.0], [-k, -d]], [[0.0], [-s]], [[0.0, 1.0]], [[0.0]])
        return lsim(system, c["accel"], t, X0=theta[3:])[1] - c["phid"]

    fit = least_squares(residual, [1.0, 1.0, 1.0, c["phi"][0], c["phid"][0]])
    assert np.sqrt(np.mean(fit.fun**2)) / record.noise == pytest.approx(3.0, rel=0.05)


def test_a_record_without_effect_leaves_nothing():
    """1e-3 of the noise: a first-order hold of 2 ms errs by (w h)^2 / 12 = 6e-5 of the gyro."""
    assert cart_pendulum("none", seed=13).strength < 1e-3
    assert roll_decay("none", seed=13).strength < 1e-6
    assert mass_spring_damper("none", seed=13).strength < 1e-3


def test_the_seed_decides_everything():
    a, b = (cart_pendulum("parameter_jump", 1.0, seed=7, duration=20.0) for _ in range(2))
    assert dict(a.truth) == dict(b.truth)
    for name in a.columns:
        np.testing.assert_array_equal(a.columns[name], b.columns[name])
    other = cart_pendulum("parameter_jump", 1.0, seed=8, duration=20.0)
    assert other.truth["k"] != a.truth["k"]


def test_records_of_one_seed_differ_by_their_effect_alone():
    """Constants, excitation and noise do not depend on the effect: cases can be paired."""
    none = cart_pendulum("none", seed=9, duration=20.0)
    bias = cart_pendulum("sensor_bias", 2.0, seed=9, duration=20.0)
    size = bias.truth["size"]
    np.testing.assert_allclose(bias.columns["gyro"] - none.columns["gyro"], size, atol=1e-12)
    np.testing.assert_array_equal(bias.columns["accel"], none.columns["accel"])


def test_noise_is_white_and_has_the_stated_standard_deviation():
    """The sample sd of N normal numbers has relative standard error 1 / sqrt(2 N); four of them."""
    record = cart_pendulum("none", seed=10, noise=0.02)
    e = np.stack(
        [record.columns[n] - record.clean[c] for n, c in (("gyro", "phid"), ("accel",) * 2)]
    )
    N = e.shape[1]
    np.testing.assert_allclose(e.std(axis=1), 0.02, rtol=4 / math.sqrt(2 * N))
    correlations = [np.corrcoef(e)[0, 1], *(np.corrcoef(x[1:], x[:-1])[0, 1] for x in e)]
    np.testing.assert_allclose(correlations, 0.0, atol=4 / math.sqrt(N))


def test_a_constant_torque_is_absorbed_by_the_initial_angle():
    """phi -> phi - tau/k turns (7.24) with a torque into (7.24) without: nothing to be seen."""
    with pytest.raises(UnreachableStrength, match="Ask for less.*or give `size`"):
        cart_pendulum("offset", 0.5, seed=1, duration=20.0)
    given = cart_pendulum("offset", seed=1, duration=20.0, size=0.3)
    assert given.truth["size"] == 0.3
    assert given.strength < 0.01


def test_a_delay_is_the_same_signal_a_fraction_of_a_sample_later():
    """Hermite at 100 Hz errs by T^4 / 384 times the fourth derivative, here of order 1e4 rad/s^5.

    The kinks that jumps of the reference leave lie on samples, never inside an interval.
    """
    record = cart_pendulum("time_delay", seed=2, duration=20.0, size=0.0137, noise=1e-9)
    c, t = record.clean, record.columns["t"]
    later = CubicHermiteSpline(t, c["phid"], c["phidd"])(t[5:] - 0.0137)
    np.testing.assert_allclose(record.columns["gyro"][5:], later, atol=1e-6)


def test_a_lag_obeys_its_differential_equation():
    """T yd + y = phid; central differences err by T h^2 / 6 times the third derivative, 1e-4."""
    record = cart_pendulum("sensor_lag", seed=2, duration=20.0, size=0.02, noise=1e-9)
    y = record.columns["gyro"]
    left = y[1:-1] + 0.02 * (y[2:] - y[:-2]) / 0.02
    np.testing.assert_allclose(left, record.clean["phid"][1:-1], atol=1e-3)


def test_outliers_are_isolated_and_one_in_a_hundred():
    none = cart_pendulum("none", seed=15)
    record = cart_pendulum("outliers", 1.0, seed=15)
    at = np.flatnonzero(record.columns["gyro"] != none.columns["gyro"])
    assert at.size == round(0.01 * none.columns["t"].size)
    assert np.diff(at).min() >= 4


def test_noise_is_added_before_clipping():
    record = cart_pendulum("saturation", 2.0, seed=16)
    gyro, level = record.columns["gyro"], record.truth["level"]
    assert np.abs(gyro).max() == level
    assert np.sum(np.abs(gyro) == level) > 10


def test_two_effects_keep_their_own_sizes():
    one = cart_pendulum("cubic_stiffness", 1.0, seed=17, duration=20.0)
    both = cart_pendulum(
        "cubic_stiffness", 1.0, seed=17, duration=20.0, second=("sensor_bias", 1.0)
    )
    assert both.truth["size"] == one.truth["size"]
    assert both.second is not None
    assert both.second[:2] == ("sensor_bias", "gyro")
    assert both.second[2] == pytest.approx(1.0, rel=0.05)
    # The bias is all but orthogonal to an odd, zero-mean misfit: strengths add as squares.
    assert both.strength_joint == pytest.approx(math.sqrt(2.0), rel=0.1)


def test_linear_roll_decay_is_the_damped_cosine():
    record = roll_decay("none", seed=18)
    p, t = record.truth, record.columns["t"]
    s, w = p["zeta"] * p["w"], p["w"] * math.sqrt(1 - p["zeta"] ** 2)
    envelope = (p["phi0"] - p["heel"]) * np.exp(-s * t)
    expected = p["heel"] + envelope * (np.cos(w * t) + s / w * np.sin(w * t))
    np.testing.assert_allclose(record.clean["phi"], expected, atol=1e-9)


@pytest.mark.parametrize("kind", ["quadratic_damping", "cubic_stiffness", "coulomb_friction"])
def test_roll_decay_meets_its_strength(kind: str):
    assert roll_decay(kind, 1.0, seed=19).strength == pytest.approx(1.0, rel=0.05)


def test_both_in_roll_decay_is_quadratic_damping_with_cubic_stiffness():
    record = roll_decay("both", 1.0, seed=20)
    assert record.kind == "quadratic_damping"
    assert record.second is not None
    assert record.second[0] == "cubic_stiffness"
    assert record.second[2] == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize("signal", ["telegraph", "multisine"])
def test_mass_under_held_force_follows_the_exact_recursion(signal: str):
    """Zero-order hold: x[n+1] = A x[n] + B F[n], A and B from one matrix exponential."""
    record = mass_spring_damper("none", seed=21, duration=20.0, signal=signal)
    c, p = record.clean, record.truth
    augmented = np.zeros((3, 3))
    augmented[0, 1] = 1.0
    augmented[1] = [-p["k"] / p["m"], -p["d"] / p["m"], 1 / p["m"]]
    AB = expm(0.01 * augmented)[:2]
    state = np.stack([c["position"], c["velocity"], c["force"]])
    np.testing.assert_allclose(state[:2, 1:], AB @ state[:, :-1], atol=1e-10)


@pytest.mark.parametrize("kind", truth.MASS_EFFECTS[1:])
def test_mass_spring_damper_meets_its_strength(kind: str):
    """Position itself is measured: here a constant force is visible."""
    record = mass_spring_damper(kind, 1.0, seed=22, duration=30.0)
    assert record.strength == pytest.approx(1.0, rel=0.05)


def test_csv_returns_the_columns_to_nine_digits(tmp_path):
    record = cart_pendulum("none", seed=23, duration=5.0)
    truth.write_csv(record, tmp_path / "case.csv")
    table = np.genfromtxt(tmp_path / "case.csv", delimiter=",", names=True)
    assert table.dtype.names == tuple(record.columns)
    for name, column in record.columns.items():
        np.testing.assert_allclose(table[name], column, rtol=1e-8, atol=1e-12)


def test_unknown_effects_are_refused_with_the_list():
    with pytest.raises(ValueError, match="choose one of none, amplitude_damping"):
        cart_pendulum("gremlins", 1.0)
    with pytest.raises(ValueError, match="choose k, d, m"):
        cart_pendulum("parameter_jump", 1.0, where="g")
    with pytest.raises(ValueError, match="multiple of 0.01"):
        cart_pendulum("none", Ts=0.004)
